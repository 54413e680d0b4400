"""A robot that stands on its soles on a floor, simulated by MuJoCo with contact and friction.

The base is free; nothing but the forces of the floor holds it. The joints have position servos with
the planned torque as feed-forward. MuJoCo solves for the contact forces, which are recorded as
ideal force sensors in the feet would measure them. All signals pass the same filter without a delay
before they are sampled, as in a data logger.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import signal
from scipy.interpolate import make_interp_spline

from .._types import FloatArray, IntArray
from ..errors import CheckFailed
from .actuator import JointActuators, sample_actuators
from .mujoco_dynamics import build_dynamics, compile_model
from .urdf_tree import UrdfTree

LEAST_CONTROL_RATE = 2000.0
"""Least number of control cycles and integration steps a second [Hz]; contact forces then follow
within the time constant of the floor."""
FLOOR_TIME_CONSTANT = 0.005
"""Time constant in which a penetration of the floor is removed [s]: ten steps, MuJoCo asks for two
at least. A foot that carries 50 kg sinks in by less than a millimetre."""
FRICTION_TIME_CONSTANT = 0.001
"""Time constant in which friction stops a joint [s]: two steps, MuJoCo asks for no less. With
twenty times that, joints creep at 0.1 rad/s where friction should hold them."""
IMPEDANCE_RATIO = 10.0
"""Stiffness of friction over that of the normal force [1], so that feet creep less under load."""
SOLE_THICKNESS = 0.02
"""Thickness of the box of a sole [m]; only its lower face touches the floor."""
SERVO_DEFLECTION = 0.05
"""Position error at which a servo gives the torque limit [rad or m]. With less stiffness at the
ankles, gravity overturns a robot."""
SETTLING_TIME = 1.0
"""Time for which the robot stands before the recording begins [s]."""
ANTI_ALIASING_SHARE = 0.4
"""Cutoff frequency of the filter before the recording over its rate [1]. Corners of a sole that
touch and lift make the contact forces of rigid feet noisy at hundreds of Hz."""
ANTI_ALIASING_ORDER = 8
"""Order of this filter, which is passed forwards and backwards [1]."""
FALL_DISTANCE = 0.1
"""Distance of the base link from its planned place at which the robot is falling [m]: more than
half of the length of a sole."""


@dataclass(frozen=True)
class Sole:
    """Rectangle by which a link touches the floor.

    Attributes:
        link: Name of the link, whose z axis is normal to the sole.
        centre: Centre of the rectangle in the frame of the link. Shape (3,) [m].
        half_length: Half of its length along x [m].
        half_width: Half of its width along y [m].
    """

    link: str
    centre: FloatArray
    half_length: float
    half_width: float


@dataclass(frozen=True)
class PlannedMotion:
    """The motion that a standing robot is to follow, from rest.

    Attributes:
        t: Times from 0, evenly spaced. Shape (N,) [s].
        pose: Pose of the base link: position [m], unit quaternion x, y, z, w. Shape (N, 7).
        q: Joint positions. Shape (N, n) [rad or m].
        torque: Joint torques by the nominal model. Shape (N, n) [N m or N].
    """

    t: FloatArray
    pose: FloatArray
    q: FloatArray
    torque: FloatArray


@dataclass(frozen=True)
class StandingRecord:
    """A simulated motion without noise.

    Attributes:
        t: Times. Shape (N,) [s].
        pose: Pose of the base link: position [m], unit quaternion x, y, z, w. Shape (N, 7).
        q: Joint positions. Shape (N, n) [rad or m].
        torque: Torques of the actuators, with their offsets. Shape (N, n) [N m or N].
        wrenches: Force and moment of the floor on each sole's link, in the axes of the link and
            about its origin. Shape (N, soles, 6) [N, N m].
        total_wrench: Their sum, in the axes of the world and about its origin. Shape (N, 6).
        tracking_error: Largest difference from the planned position of each joint. Shape (n,).
        slip: Largest distance of a sole's centre from where it stood at the start [m].
    """

    t: FloatArray
    pose: FloatArray
    q: FloatArray
    torque: FloatArray
    wrenches: FloatArray
    total_wrench: FloatArray
    tracking_error: FloatArray
    slip: float


@dataclass(frozen=True)
class StandingRobot:
    """A robot with a free base, actuators and soles.

    Attributes:
        tree: Links with their true inertias.
        joints: Names of the n joints, in MuJoCo's order.
        model: MuJoCo model with floor and soles; the free joint of the base comes first.
        soles: The soles.
        bodies: Index in the model of the link of each sole. Shape (soles,).
        actuators: Rotor inertia, friction and offset of the joints.
        torque_limit: Largest torque of each joint. Shape (n,) [N m or N].
        stiffness: Gain of the position error of each servo. Shape (n,) [N m/rad or N/m].
        damping: Gain of the velocity error. Shape (n,) [N m s/rad or N s/m].
    """

    tree: UrdfTree
    joints: tuple[str, ...]
    model: Any
    soles: tuple[Sole, ...]
    bodies: IntArray
    actuators: JointActuators
    torque_limit: FloatArray
    stiffness: FloatArray
    damping: FloatArray

    def follow(self, planned: PlannedMotion, rate: float) -> StandingRecord:
        """Simulate the robot along a motion.

        Args:
            planned: The motion, with joints in the order of this robot.
            rate: Rows of the record per second [Hz].

        Raises:
            CheckFailed: The robot falls.
        """
        import mujoco

        model, data = self.model, mujoco.MjData(self.model)
        cycles = int(np.ceil(LEAST_CONTROL_RATE / rate))
        step = model.opt.timestep = 1.0 / (rate * cycles)
        count = int(np.floor(planned.t[-1] * rate + 1e-9)) + 1
        times = step * np.arange((count - 1) * cycles + 1)
        position, forward = (make_interp_spline(planned.t, x) for x in (planned.q, planned.torque))
        target, speed, torque = position(times), position.derivative()(times), forward(times)
        place = make_interp_spline(planned.t, planned.pose[:, :3])(times)
        data.qpos[:] = [*planned.pose[0, :3], *planned.pose[0, [6, 3, 4, 5]], *planned.q[0]]
        for _ in range(round(SETTLING_TIME / step)):
            self._advance(data, target[0], 0.0 * speed[0], torque[0])
        start, slip, n, soles = self._sole_centres(data), 0.0, len(self.joints), len(self.soles)
        q, applied = np.empty((len(times), 7 + n)), np.empty((len(times), n))
        wrenches, total = np.empty((len(times), soles, 6)), np.empty((len(times), 6))
        for k in range(len(times)):
            q[k] = data.qpos
            applied[k] = self._advance(data, target[k], speed[k], torque[k])
            wrenches[k], total[k] = self._wrenches(data)
            distance = float(np.linalg.norm(q[k, :3] - place[k]))
            if not distance < FALL_DISTANCE:
                raise CheckFailed(
                    f"{self.tree.source}: the simulated robot falls at {times[k]:.2f} s, where its "
                    f"base link is {1e3 * distance:.0f} mm from its planned place; design with a "
                    "larger --cop-margin, or lower --model-error"
                )
            moved = np.linalg.norm(self._sole_centres(data) - start, axis=1)
            slip = max(slip, float(moved.max()))
        filter_sections = signal.butter(
            ANTI_ALIASING_ORDER, ANTI_ALIASING_SHARE * rate, fs=1.0 / step, output="sos"
        )

        def sampled(x: FloatArray) -> FloatArray:
            return np.asarray(signal.sosfiltfilt(filter_sections, x, axis=0)[::cycles])

        pose = sampled(np.column_stack([q[:, :3], q[:, 4:7], q[:, 3]]))
        pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1)[:, None]
        return StandingRecord(
            np.arange(count) / rate,
            pose,
            sampled(q[:, 7:]),
            sampled(applied) + self.actuators.offset,
            sampled(wrenches),
            sampled(total),
            np.abs(q[:, 7:] - target).max(axis=0),
            slip,
        )

    def _advance(
        self, data: Any, target: FloatArray, speed: FloatArray, forward: FloatArray
    ) -> FloatArray:
        """Advance by a step with the servos' torque, which is returned. Shape (n,)."""
        import mujoco

        applied = forward + self.stiffness * (target - data.qpos[7:])
        applied += self.damping * (speed - data.qvel[6:])
        applied = np.clip(applied, -self.torque_limit, self.torque_limit)
        data.qfrc_applied[6:] = applied
        mujoco.mj_step(self.model, data)
        return applied

    def _sole_centres(self, data: Any) -> FloatArray:
        """Centres of the soles in the world. Shape (soles, 3) [m]."""
        axes = data.xmat[self.bodies].reshape(-1, 3, 3)
        centres = np.array([sole.centre for sole in self.soles])
        return np.asarray(data.xpos[self.bodies] + np.einsum("sij,sj->si", axes, centres))

    def _wrenches(self, data: Any) -> tuple[FloatArray, FloatArray]:
        """Contact forces of the last step: sum on each sole, and the sum of all.

        Returns:
            In the axes of the soles' links about their origins, shape (soles, 6); in the axes of
            the world about its origin, shape (6,).
        """
        contact = data.contact
        loaded = contact.efc_address >= 0
        places = contact.efc_address[loaded, None] + np.arange(3)
        # of the floor, the first geometry, on the sole; the axes are rows of `frame`
        axes = contact.frame[loaded].reshape(-1, 3, 3)
        force = np.einsum("ci,cij->cj", data.efc_force[places], axes)
        point, body = contact.pos[loaded], self.model.geom_bodyid[contact.geom[loaded, 1]]
        about_origin = np.hstack([force, np.cross(point, force)])
        out = np.empty((len(self.soles), 6))
        for sole, link in enumerate(self.bodies):
            f, m = about_origin[body == link].sum(axis=0).reshape(2, 3)
            R = data.xmat[link].reshape(3, 3)
            out[sole, :3], out[sole, 3:] = f @ R, (m - np.cross(data.xpos[link], f)) @ R
        return out, about_origin.sum(axis=0)


def build_standing_robot(
    tree: UrdfTree,
    base_link: str,
    soles: Sequence[Sole],
    friction: float,
    joint_limits: dict[str, tuple[float, float]],
    gravity: Sequence[float],
    rng: np.random.Generator,
) -> StandingRobot:
    """Build a robot with random actuators that stands on a floor in the plane z = 0.

    Args:
        tree: Links with their true inertias; all movable joints move.
        base_link: Root of the tree.
        soles: The soles.
        friction: Coefficient of friction of soles and floor [1].
        joint_limits: Velocity and torque limit of each joint.
        gravity: Gravity in the world. Shape (3,) [m/s²].
        rng: Generator of the actuators.

    Raises:
        UnusableInput: MuJoCo refuses the robot.
    """
    import mujoco

    def stand(spec: Any) -> None:
        spec.body(base_link).add_freejoint()
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], contype=1, conaffinity=0
        )
        for sole in soles:
            spec.body(sole.link).add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=[sole.half_length, sole.half_width, 0.5 * SOLE_THICKNESS],
                pos=sole.centre + np.array([0.0, 0.0, 0.5 * SOLE_THICKNESS]),
                contype=0,
                conaffinity=1,
                mass=0.0,
            )

    fixed = build_dynamics(tree, tree.joints, gravity=gravity)
    velocity, torque = np.array([joint_limits[name] for name in fixed.joints]).T
    actuators = sample_actuators(fixed, velocity, torque, rng)
    model = compile_model(tree, gravity, stand)
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    model.opt.impratio = IMPEDANCE_RATIO
    model.geom_solref[:, 0] = FLOOR_TIME_CONSTANT
    model.geom_friction[:, 0] = friction
    model.dof_armature[6:] = actuators.inertia
    model.dof_damping[6:] = actuators.viscous
    model.dof_frictionloss[6:] = actuators.coulomb
    model.dof_solref[6:, 0] = FRICTION_TIME_CONSTANT
    mujoco.mj_setConst(model, mujoco.MjData(model))
    stiffness = torque / SERVO_DEFLECTION
    return StandingRobot(
        tree,
        fixed.joints,
        model,
        tuple(soles),
        np.array([model.body(sole.link).id for sole in soles]),
        actuators,
        torque,
        stiffness,
        2.0 * np.sqrt(stiffness * actuators.inertia),
    )
