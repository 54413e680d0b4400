"""Rigid-body dynamics by MuJoCo: mass matrix, bias, inverse dynamics, Jacobian and energy."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from .urdf_tree import UrdfTree

GRAVITY = (0.0, 0.0, -9.81)
"""Gravity in the base frame [m/s²]."""


@dataclass(frozen=True)
class RigidBodyDynamics:
    """Dynamics M(q) q̈ + h(q, q̇) = τ of a kinematic tree, without friction and rotors.

    Attributes:
        tree: The robot that it was built from.
        joints: Names of the n movable joints, in MuJoCo's order.
        model: MuJoCo model.
        data: MuJoCo work space; it holds no state between calls.
    """

    tree: UrdfTree
    joints: tuple[str, ...]
    model: Any
    data: Any

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def mass_and_bias(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mass matrix and bias torque at one state.

        Args:
            q: Position, shape (n,) [rad or m].
            v: Velocity, shape (n,).

        Returns:
            Mass matrix, shape (n, n) [kg m²], and bias torque, shape (n,) [N m].
        """
        import mujoco

        model, data = self.model, self.data
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_comVel(model, data)
        mass, bias = np.empty((self.n, self.n)), np.empty(self.n)
        mujoco.mj_fullM(model, data, mass)
        mujoco.mj_rne(model, data, 0, bias)
        return mass, bias

    def inverse_dynamics(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the torque that a motion needs. Shapes (N, n) to (N, n) [N m]."""
        import mujoco

        model, data = self.model, self.data
        out, torque = np.empty(q.shape), np.empty(self.n)
        for k in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 1, torque)
            out[k] = torque
        return out

    def centre_of_mass_jacobian(self, q: FloatArray, joint: str) -> FloatArray:
        """Return ∂(centre of mass)/∂q of the link that a joint moves.

        Args:
            q: Positions, shape (N, n) [rad or m].
            joint: Name of the joint.

        Returns:
            Jacobian along the motion, shape (N, 3, n) [m].
        """
        import mujoco

        model, data = self.model, self.data
        body = int(model.jnt_bodyid[self.joints.index(joint)])
        out, part = np.empty((len(q), 3, self.n)), np.empty((3, self.n))
        for k in range(len(q)):
            data.qpos[:] = q[k]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacBodyCom(model, data, part, None, body)
            out[k] = part
        return out


def build_dynamics(
    tree: UrdfTree,
    joints: Sequence[str],
    lock: Mapping[str, float] | None = None,
    gravity: Sequence[float] = GRAVITY,
) -> RigidBodyDynamics:
    """Compile the dynamics of a robot.

    Args:
        tree: The robot.
        joints: Names of the joints that move.
        lock: Positions of the other joints, which are locked [rad or m]; 0 where not stated.
        gravity: Gravity in the base frame, shape (3,) [m/s²].

    Raises:
        UnusableInput: MuJoCo refuses the robot, or a joint does not exist.
    """
    import mujoco

    locked_tree = tree
    for name in set(tree.joints) - set(joints):
        locked_tree = locked_tree.with_locked_joint(name, (lock or {}).get(name, 0.0))
    for name in joints:
        locked_tree.joint_element(name)
    model = compile_model(locked_tree, gravity)
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    return RigidBodyDynamics(
        locked_tree, tuple(str(model.joint(i).name) for i in range(model.njnt)), model, data
    )


def compile_model(
    tree: UrdfTree, gravity: Sequence[float], alter: Callable[[Any], None] = lambda spec: None
) -> Any:
    """Compile a MuJoCo model of a tree whose movable joints all move.

    Args:
        tree: The robot.
        gravity: Gravity in the base frame, shape (3,) [m/s²].
        alter: Changes the specification before it is compiled.

    Raises:
        UnusableInput: MuJoCo refuses the robot.
    """
    import mujoco

    root = ElementTree.fromstring(tree.xml)
    options = ElementTree.Element("mujoco")
    # MuJoCo's compiler alters masses and inertias that it finds implausible: they are set exactly
    # afterwards
    compiler = {
        "discardvisual": "true",
        "fusestatic": "false",
        "balanceinertia": "true",
        "boundmass": "1e-9",
        "boundinertia": "1e-12",
    }
    ElementTree.SubElement(options, "compiler", compiler)
    root.insert(0, options)
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
        alter(spec)
        model = spec.compile()
    except ValueError as error:
        raise UnusableInput(
            f"{tree.source}: MuJoCo cannot compile it ({' '.join(str(error).split())}); "
            "correct the URDF"
        ) from error
    model.opt.gravity[:] = gravity
    for body in range(1, model.nbody):
        _set_body(model, body, tree.pseudo_inertia(str(model.body(body).name)))
    return model


def _set_body(model: Any, body: int, pseudo_inertia: FloatArray) -> None:
    """Set mass, centre of mass and principal moments of a body from its pseudo-inertia."""
    import mujoco

    mass = float(pseudo_inertia[3, 3])
    centre = pseudo_inertia[:3, 3] / mass if mass > 0.0 else np.zeros(3)
    second = pseudo_inertia[:3, :3] - mass * np.outer(centre, centre)
    moments, axes = np.linalg.eigh(np.trace(second) * np.eye(3) - second)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(axes).ravel())
    model.body_mass[body], model.body_ipos[body] = mass, centre
    model.body_iquat[body], model.body_inertia[body] = quaternion, moments
