"""Motion, torque and contact wrenches of a robot in single or double support, by Pinocchio.

It shares no dynamics with what the optimiser differentiates: the closed chains are solved sample by
sample with Pinocchio's Jacobians, the forces are those of its recursive Newton-Euler algorithm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..robot.floating_base import FloatingMotion, FloatingRobot
from ..robot.inertial_parameters import Parameters
from ..trajectory.rest_to_rest import PhaseProfile
from .support_problem import profile_duration
from .support_stance import BASE_COORDINATES as BASE
from .support_stance import Foot, Stance, base_pose, solve_leg


@dataclass(frozen=True)
class SupportSamples:
    """A motion in support at N times.

    Attributes:
        t: Times [s]. Shape (N,).
        base: Base coordinates. Shape (N, 6).
        base_rate: Their time derivatives. Shape (N, 6).
        motion: Poses, velocities and accelerations of base and joints.
        torque: Nominal joint torques without Coulomb friction, which jumps between samples.
            Shape (N, n) [N m].
        wrenches: Force and moment of the ground on each foot, at the centre of its sole and in the
            axes of the sole. Shape (N, feet, 6) [N, N m].
        closure_error: Largest error of a foot's pose [m and rad].
    """

    t: FloatArray
    base: FloatArray
    base_rate: FloatArray
    motion: FloatingMotion
    torque: FloatArray
    wrenches: FloatArray
    closure_error: float

    @property
    def joint_velocity(self) -> FloatArray:
        """Joint velocities. Shape (N, n)."""
        return self.motion.velocity[:, BASE:]

    @property
    def joint_acceleration(self) -> FloatArray:
        """Joint accelerations. Shape (N, n)."""
        return self.motion.acceleration[:, BASE:]


def support_samples(
    robot: FloatingRobot,
    stance: Stance,
    parameters: Parameters,
    profile: PhaseProfile,
    t: FloatArray,
) -> SupportSamples:
    """Compute a motion in support with its forces.

    Args:
        robot: The robot.
        stance: The feet and the standing pose.
        parameters: Its standard parameters, for friction and rotor inertia of its joints.
        profile: Motion of the independent coordinates.
        t: Times [s]. Shape (N,).
    """
    count, n = len(t), robot.n
    places = stance.independent
    x = np.zeros((3, count, BASE + n))
    for order in range(3):
        x[order][:, places] = profile.at(t, order)
    q, v, a = np.empty((count, 7 + n)), np.empty((count, BASE + n)), np.empty((count, BASE + n))
    data, joint_data = robot.model.createData(), robot.joint_robot.model.createData()
    force = np.empty((count, BASE + n))
    wrenches = np.empty((count, len(stance.feet), 6))
    previous, worst = stance.pose.copy(), 0.0
    others = places[places >= BASE] - BASE
    for i in range(count):
        pose = base_pose(x[0, i])
        joints = previous.copy()
        joints[others] = x[0, i, BASE:][others]
        for foot in stance.feet:
            joints, error = solve_leg(robot.joint_robot, joint_data, foot, pose, joints)
            worst = max(worst, error)
        previous = joints
        q[i] = np.concatenate([pin.SE3ToXYZQUAT(pose), joints])
        v[i], a[i] = x[1, i], x[2, i]
        v[i, :BASE], a[i, :BASE] = _base_rates(*x[:, i, :BASE])
        _close_chains(robot, data, stance, q[i], v[i], a[i])
        force[i] = pin.rnea(robot.model, data, q[i], v[i], a[i])
        ground = pose.act(pin.Force(force[i, :BASE]))
        shared = share_wrench(stance, ground.linear, ground.angular)
        pin.computeJointJacobians(robot.model, data, q[i])
        for k, (foot, (f, m)) in enumerate(zip(stance.feet, shared, strict=True)):
            R = foot.in_world.rotation.T
            wrenches[i, k] = np.concatenate([R @ f, R @ m])
            body = int(foot.joints[-1]) + 2
            jacobian = pin.getJointJacobian(robot.model, data, body, pin.LOCAL)
            local = foot.in_body.act(pin.Force(wrenches[i, k])).vector
            force[i, BASE:] -= (jacobian.T @ local)[BASE:]
    torque = force[:, BASE:] + _drive_torque(parameters, v[:, BASE:], a[:, BASE:])
    motion = FloatingMotion(q[:, :7], q[:, 7:], v, a)
    base, base_rate = x[0, :, :BASE], x[1, :, :BASE]
    return SupportSamples(t, base, base_rate, motion, torque, wrenches, worst)


def exported_motion(
    robot: FloatingRobot,
    stance: Stance,
    parameters: Parameters,
    profile: PhaseProfile,
    rate: float,
) -> FloatingMotion:
    """Return the rows of a motion as exported, without the last one.

    Args:
        robot: The robot.
        stance: The feet and the standing pose.
        parameters: Its standard parameters.
        profile: Motion of the independent coordinates.
        rate: Rows per second [Hz].
    """
    t = np.arange(round(profile_duration(profile) * rate)) / rate
    return support_samples(robot, stance, parameters, profile, t).motion


def _drive_torque(parameters: Parameters, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """Return the nominal torque of rotor inertia, viscous friction and offset. Shape (N, n)."""
    columns = {"rotor_inertia": ddq, "viscous": dq, "offset": np.ones_like(dq)}
    out = np.zeros_like(dq)
    for kind in set(parameters.drive) & set(columns):
        out += parameters.nominal[parameters.block(kind)] * columns[kind]
    return out


def _base_rates(b: FloatArray, db: FloatArray, ddb: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the velocity of the base link in its own axes, and its time derivative.

    Args:
        b: Base coordinates. Shape (6,).
        db: Their velocities. Shape (6,).
        ddb: Their accelerations. Shape (6,).
    """
    R = pin.rpy.rpyToMatrix(*b[3:])
    jacobian = pin.rpy.computeRpyJacobian(b[3:], pin.LOCAL)
    rate = pin.rpy.computeRpyJacobianTimeDerivative(b[3:], db[3:], pin.LOCAL)
    linear, angular = R.T @ db[:3], jacobian @ db[3:]
    return (
        np.concatenate([linear, angular]),
        np.concatenate(
            [R.T @ ddb[:3] - np.cross(angular, linear), jacobian @ ddb[3:] + rate @ db[3:]]
        ),
    )


def _close_chains(
    robot: FloatingRobot,
    data: pin.Data,
    stance: Stance,
    q: FloatArray,
    v: FloatArray,
    a: FloatArray,
) -> None:
    """Set velocities and accelerations of the support legs so that the feet do not move."""
    pin.computeJointJacobians(robot.model, data, q)
    jacobians = []
    for foot in stance.feet:
        body = int(foot.joints[-1]) + 2
        columns = BASE + foot.joints
        jacobian = np.asarray(pin.getJointJacobian(robot.model, data, body, pin.LOCAL)).copy()
        v[columns] = a[columns] = 0.0
        v[columns] = -np.linalg.solve(jacobian[:, columns], jacobian @ v)
        jacobians.append((body, columns, jacobian[:, columns]))
    pin.forwardKinematics(robot.model, data, q, v, a)
    for body, columns, jacobian in jacobians:
        a[columns] = -np.linalg.solve(jacobian, data.a[body].vector)


def share_wrench(
    stance: Stance, force: FloatArray, moment: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Share the wrench of the ground between the feet, as `support_model.contact_wrenches` states.

    Args:
        stance: The feet.
        force: Force of the ground, in the world. Shape (3,) [N].
        moment: Its moment about the origin of the world. Shape (3,) [N m].

    Returns:
        Force and moment about the centre of its sole of each foot, in the world.
    """
    centres = [np.array(foot.in_world.translation) for foot in stance.feet]
    if len(centres) == 1:
        return [(force, moment - np.cross(centres[0], force))]
    line = centres[1] - centres[0]
    # zero-moment point on the ground: n × (M − p × f) = 0 with the vertical n
    pressure = np.array([-moment[1], moment[0]]) / force[2]
    share = float((pressure - centres[0][:2]) @ line[:2] / (line @ line))
    middle = centres[0] + share * line
    remaining = moment - np.cross(middle, force)
    return [((1.0 - share) * force, (1.0 - share) * remaining), (share * force, share * remaining)]


def sole_friction_use(foot: Foot, friction: float, wrenches: FloatArray) -> FloatArray:
    """Return the moment about the vertical that a sole transmits over what friction allows.

    It is the closed form of Caron, Pham and Nakamura (ICRA 2015) for a friction pyramid inside the
    friction cone.

    Args:
        foot: The foot.
        friction: Coefficient of friction [1].
        wrenches: Wrenches at the centre of its sole. Shape (N, 6).

    Returns:
        The ratio, at most 1 where the sole does not turn. Shape (N,).
    """
    fx, fy, fz, mx, my, mz = wrenches.T
    X, Y, mu = foot.half_length, foot.half_width, friction / np.sqrt(2.0)
    upper = mz + np.abs(Y * fx + mu * mx) + np.abs(X * fy + mu * my)
    lower = -mz + np.abs(Y * fx - mu * mx) + np.abs(X * fy - mu * my)
    return np.asarray(np.maximum(upper, lower) / (mu * (X + Y) * fz))
