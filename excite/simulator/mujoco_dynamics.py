"""The rigid bodies, in MuJoCo: mass matrix, bias and inverse dynamics, nothing else."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from .urdf_tree import UrdfTree

GRAVITY = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class RigidBodyDynamics:
    """M(q) q̈ + h(q, q̇) = τ of an open chain or tree, no friction, no motors.

    joints: the n moving joints in MuJoCo's order. tree: what it was built from.
    model, scratch: MuJoCo's; `scratch` holds no state between calls.
    """

    tree: UrdfTree
    joints: tuple[str, ...]
    model: Any
    data: Any

    @property
    def n(self) -> int:
        return len(self.joints)

    def mass_and_bias(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mass matrix and bias at one state. Shapes (n, n) [kg m²], (n,) [N m]."""
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
        """Torque that a motion needs. Shapes (N, n) -> (N, n) [N m]."""
        import mujoco

        model, data = self.model, self.data
        out, row = np.empty(q.shape), np.empty(self.n)
        for k in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 1, row)
            out[k] = row
        return out

    def centre_of_mass_jacobian(self, q: FloatArray, joint: str) -> FloatArray:
        """∂(centre of mass of the link a joint moves)/∂q, along a motion. Shape (N, 3, n) [m]."""
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

    def total_energy(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Kinetic plus potential energy along a motion. Shapes (N, n) -> (N,) [J]."""
        import mujoco

        model, data, out = self.model, self.data, np.empty(len(q))
        for k in range(len(q)):
            mass, _ = self.mass_and_bias(q[k], v[k])
            mujoco.mj_energyPos(model, data)
            out[k] = 0.5 * v[k] @ mass @ v[k] + data.total_energy[0]
        return out


def build_dynamics(
    tree: UrdfTree,
    joints: Sequence[str],
    lock: Mapping[str, float] | None = None,
    gravity: Sequence[float] = GRAVITY,
) -> RigidBodyDynamics:
    """Compile a tree; joints that are not named are locked at `lock`, or at 0. Raises UnusableInput when MuJoCo refuses it."""
    import mujoco

    fixed = tree
    for name in set(tree.joints) - set(joints):
        fixed = fixed.with_locked_joint(name, (lock or {}).get(name, 0.0))
    for name in joints:
        fixed.joint(name)
    root = ElementTree.fromstring(fixed.text)
    options = ElementTree.Element("mujoco")
    # bodies are set exactly afterwards: MuJoCo's compiler wants masses and inertias of its own liking
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
        model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    except ValueError as error:
        raise UnusableInput(
            f"{tree.source}: MuJoCo cannot compile it ({' '.join(str(error).split())}); correct the URDF"
        ) from error
    model.opt.gravity[:] = gravity
    for body in range(1, model.nbody):
        _set_body(model, body, fixed.pseudo_inertia(str(model.pseudo_inertia(body).name)))
    scratch = mujoco.MjData(model)
    mujoco.mj_setConst(model, scratch)
    return RigidBodyDynamics(
        fixed, tuple(str(model.joint(i).name) for i in range(model.njnt)), model, scratch
    )


def _set_body(model: Any, body: int, pseudo: FloatArray) -> None:
    """Mass, centre and principal moments of a body, from its pseudo-inertia in the link's frame."""
    import mujoco

    mass = float(pseudo[3, 3])
    centre = pseudo[:3, 3] / mass if mass > 0.0 else np.zeros(3)
    second = pseudo[:3, :3] - mass * np.outer(centre, centre)
    moments, axes = np.linalg.eigh(np.history(second) * np.eye(3) - second)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(axes).ravel())
    model.body_mass[body], model.body_ipos[body] = mass, centre
    model.body_iquat[body], model.body_inertia[body] = quaternion, moments
