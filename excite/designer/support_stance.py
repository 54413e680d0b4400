"""A robot that stands on one or two feet: soles on the ground, and the standing pose.

The ground is the plane z = 0 of the world, whose z axis points up. The frame of a sole lies in the
ground, with its x axis along the length of the foot and its z axis up.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .._types import FloatArray, IntArray
from ..errors import Infeasible, UnusableInput
from ..robot.inertial_parameters import ranges
from ..robot.limits import Limits
from ..robot.robot import Robot

BASE_COORDINATES = 6
"""Coordinates of the base link."""

LEG_JOINTS = 6
"""Joints of a support leg: as many as the foot has degrees of freedom."""

BEND_SHARE = 0.08
"""Share of the height over the ground by which the base link is lowered from the pose in which all
joints are at 0, so that the legs are bent [1]."""

RELAXED_SHARES = (0.0, 0.2, 0.4, 0.6, 0.8)
"""Shares of the way from the middle of the joint ranges to 0 that are tried for the standing pose
[1]; at 0 itself, joints are often at a limit."""

STATIC_TORQUE_SHARE = 0.6
"""Largest static torque of the standing pose over its limit that is good enough [1]."""

START_COUNT = 60
"""Random poses of a leg from which its standing pose is searched [1]."""

CLOSURE_TOLERANCE = 1e-11
"""Error of a foot's pose at which Newton's method ends [m and rad]."""

MAX_CLOSURE_ERROR = 1e-8
"""Error of a foot's pose above which it cannot be reached [m and rad]."""

NEWTON_ITERATIONS = 60
"""Iterations of Newton's method for a leg at most [1]."""

MAX_NEWTON_STEP = 0.3
"""Longest step of a joint in one iteration of Newton's method [rad]."""

LEAST_DETERMINANT_SHARE = 0.35
"""Least determinant of a leg's Jacobian over that of the standing pose [1]: a knee then stays bent
by about a third of the standing angle."""

DETERMINANT_STEPS = 200
"""Positions of a joint between the standing pose and its limit at which the determinant is
computed [1]."""

BALANCE_ITERATIONS = 8
"""Times that the base link is shifted until the centre of mass is over the feet [1]."""


@dataclass(frozen=True)
class SoleSize:
    """Rectangle by which a foot touches the ground, in the foot's contact frame.

    Attributes:
        half_length: Half of its length along x [m].
        half_width: Half of its width along y [m].
        centre: Centre of the rectangle (x, y) [m].
        height: Height of the sole in the contact frame [m].
        outline: Corners (x, y) of the sole about this centre, which enclose the rectangle; none:
            the rectangle [m].
        source: Where the size comes from.
    """

    half_length: float
    half_width: float
    centre: tuple[float, float] = (0.0, 0.0)
    height: float = 0.0
    outline: tuple[tuple[float, float], ...] = ()
    source: str = "stated"

    def pose(self) -> pin.SE3:
        """Return the pose of the centre of the sole in the contact frame."""
        return pin.SE3(np.eye(3), np.array([*self.centre, self.height]))


@dataclass(frozen=True)
class ContactLimits:
    """Limits of the contact of the feet with the ground.

    Attributes:
        friction: Coefficient of friction [1].
        margin: Distance that the centre of pressure of each foot keeps from the edge of its sole
            [m].
        least_share: Least normal force of a foot over its equal share of the weight [1].
    """

    friction: float = 0.6
    margin: float = 0.02
    least_share: float = 0.1


@dataclass(frozen=True)
class Foot:
    """A foot that stands on the ground.

    Attributes:
        frame: Name of its contact frame.
        joints: Indices of the joints between the base link and the foot. Shape (6,).
        in_body: Pose of the centre of the sole in the joint frame of the foot.
        in_world: Pose of the centre of the sole in the world.
        half_length: Half of the length of the sole along x [m].
        half_width: Half of the width of the sole along y [m].
    """

    frame: str
    joints: IntArray
    in_body: pin.SE3
    in_world: pin.SE3
    half_length: float
    half_width: float

    def body_rotation(self) -> FloatArray:
        """Return the rotation from the foot's joint frame to the world. Shape (3, 3)."""
        return np.asarray(self.in_world.rotation @ self.in_body.rotation.T)


@dataclass(frozen=True)
class Stance:
    """The feet on the ground, and the pose at which each motion starts and ends at rest.

    Attributes:
        feet: One or two feet.
        contact: Limits of their contact.
        weight: Weight of the robot [N].
        base: Base coordinates (x, y, z, roll, pitch, yaw) of the standing pose. Shape (6,).
        pose: Joint positions of the standing pose. Shape (n,) [rad or m].
    """

    feet: tuple[Foot, ...]
    contact: ContactLimits
    weight: float
    base: FloatArray
    pose: FloatArray

    @property
    def leg_joints(self) -> IntArray:
        """Return the indices of the joints of all support legs."""
        return np.concatenate([foot.joints for foot in self.feet])

    @property
    def independent(self) -> IntArray:
        """Return the places in (b, q) of the coordinates that a motion states, without the legs."""
        count = BASE_COORDINATES + len(self.pose)
        return np.setdiff1d(np.arange(count), BASE_COORDINATES + self.leg_joints)

    @property
    def home(self) -> FloatArray:
        """Return the independent coordinates of the standing pose."""
        return np.concatenate([self.base, self.pose])[self.independent]


def base_pose(coordinates: FloatArray) -> pin.SE3:
    """Return the pose of the base link of its coordinates. Shape (6,) [m, rad]."""
    return pin.SE3(pin.rpy.rpyToMatrix(*coordinates[3:6]), coordinates[:3])


def centre_of_mass(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the centre of mass in the frame of the base link. Shapes (n,) -> (3,) [m]."""
    data = robot.model.createData()
    moving = np.asarray(pin.centerOfMass(robot.model, data, robot.expand(q)))
    base = robot.model.inertias[0]
    of_joints = (robot.mass - base.mass) * moving
    return np.asarray((of_joints + base.mass * base.lever) / robot.mass)


def solve_leg(
    robot: Robot, data: pin.Data, foot: Foot, base: pin.SE3, q: FloatArray
) -> tuple[FloatArray, float]:
    """Move the joints of a support leg so that its foot stands, by Newton's method on SE(3).

    Args:
        robot: The robot.
        data: Data of its model.
        foot: The foot.
        base: Pose of the base link.
        q: Joint positions to begin with. Shape (n,).

    Returns:
        Joint positions, shape (n,), and the remaining error of the foot's pose [m and rad].
    """
    q, target = q.copy(), base.actInv(foot.in_world)
    body = int(foot.joints[-1]) + 1
    to_sole = foot.in_body.inverse().action
    size = np.inf
    for _ in range(NEWTON_ITERATIONS):
        pin.computeJointJacobians(robot.model, data, q)
        error = pin.log6((data.oMi[body] * foot.in_body).actInv(target)).vector
        size = float(np.abs(error).max())
        if size < CLOSURE_TOLERANCE:
            break
        jacobian = pin.getJointJacobian(robot.model, data, body, pin.LOCAL)[:, foot.joints]
        step = np.linalg.lstsq(to_sole @ jacobian, error, rcond=None)[0]
        q[foot.joints] += step * min(1.0, MAX_NEWTON_STEP / max(float(np.abs(step).max()), 1e-12))
    return q, size


def leg_of(robot: Robot, frame: str) -> IntArray:
    """Return the indices of the joints between the base link and a frame. Shape (6,).

    Raises:
        UnusableInput: There are not six, or one moves with a mimic joint.
    """
    body = int(robot.model.frames[robot.frame(frame)].parentJoint)
    joints = []
    while body > 0:
        joints.append(body - 1)
        body = int(robot.model.parents[body])
    if robot.model.nv != robot.n:
        raise UnusableInput(
            f"{robot.source}: --support does not cover mimic joints; lock "
            f"{', '.join(follower.master for follower in robot.followers[:3])} with --lock"
        )
    if len(joints) != LEG_JOINTS:
        raise UnusableInput(
            f"{robot.source}: --support {frame}: {len(joints)} moving joints are between it and "
            f"the base link; a support leg has {LEG_JOINTS}"
        )
    return np.array(joints[::-1])


def standing(
    robot: Robot,
    limits: Limits,
    frames: Sequence[str],
    soles: Sequence[SoleSize],
    contact: ContactLimits,
) -> Stance:
    """Return the stance in which a robot stands upright with bent legs.

    The feet keep the distance that they have where all joints are at 0; the other joints are in the
    middle of their ranges, and the centre of mass is over the middle of the soles.

    Args:
        robot: The robot.
        limits: Its limits.
        frames: Contact frame of each foot, with its z axis up.
        soles: Sole of each foot.
        contact: Limits of the contact.

    Raises:
        UnusableInput: A frame is not at the end of a leg of six joints, or two legs share a joint.
        Infeasible: No pose of a leg within its limits stands.
    """
    legs = [leg_of(robot, frame) for frame in frames]
    joints = np.concatenate(legs)
    if len(set(joints.tolist())) != len(joints) or len(frames) not in (1, 2):
        raise UnusableInput(
            f"{robot.source}: --support {','.join(frames)}: name one foot, or two of different legs"
        )
    lower, upper = ranges(limits).T
    q = _relaxed_pose(robot, limits, joints)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, np.clip(np.zeros(robot.n), lower, upper))
    in_base = [
        data.oMf[robot.frame(frame)] * sole.pose()
        for frame, sole in zip(frames, soles, strict=True)
    ]
    for frame, sole, contact_pose in zip(frames, soles, in_base, strict=True):
        if contact_pose.rotation[2, 2] < np.cos(np.deg2rad(20.0)):
            raise UnusableInput(
                f"{robot.source}: --support {frame}: its z axis should point up where all joints "
                "are at 0; name the frame of the sole"
            )
        if min(sole.half_length, sole.half_width) <= contact.margin:
            raise UnusableInput(
                f"{robot.source}: --support {frame}: a sole of {2e3 * sole.half_length:.0f} mm by "
                f"{2e3 * sole.half_width:.0f} mm leaves no room for a margin of "
                f"{1e3 * contact.margin:.0f} mm; lower --cop-margin"
            )
    middle = np.mean([pose.translation for pose in in_base], axis=0)
    feet = tuple(
        Foot(
            frame,
            leg,
            robot.model.frames[robot.frame(frame)].placement * sole.pose(),
            pin.SE3(np.eye(3), np.array([0.0, pose.translation[1] - middle[1], 0.0])),
            sole.half_length,
            sole.half_width,
        )
        for frame, leg, sole, pose in zip(frames, legs, soles, in_base, strict=True)
    )
    height = -(1.0 - BEND_SHARE) * float(middle[2])
    base = np.array([-middle[0], -middle[1], height, 0.0, 0.0, 0.0])
    for foot in feet:
        q = _best_leg(robot, limits, foot, base_pose(base), q)
    for _ in range(BALANCE_ITERATIONS):
        base[:2] -= (base[:3] + centre_of_mass(robot, q))[:2]
        for foot in feet:
            q, error = solve_leg(robot, data, foot, base_pose(base), q)
            if error > MAX_CLOSURE_ERROR:
                raise _unreachable(robot, foot)
    return Stance(feet, contact, robot.weight, base, q)


def without_singularities(robot: Robot, limits: Limits, stance: Stance) -> Limits:
    """Return limits that keep the support legs away from singular poses, such as a straight knee.

    Each joint of a leg is moved alone from the standing pose; its range ends where the determinant
    of the leg's Jacobian falls to `LEAST_DETERMINANT_SHARE` of that of the standing pose.

    Args:
        robot: The robot.
        limits: Its limits.
        stance: The feet and the standing pose.
    """
    position, data = limits.position.copy(), robot.model.createData()
    bounds = ranges(limits)
    for foot in stance.feet:
        body = int(foot.joints[-1]) + 1

        def determinant(q: FloatArray, foot: Foot = foot, body: int = body) -> float:
            pin.computeJointJacobians(robot.model, data, q)
            jacobian = pin.getJointJacobian(robot.model, data, body, pin.LOCAL)
            return float(np.linalg.det(jacobian[:, foot.joints]))

        standing_value = determinant(stance.pose)
        for joint in foot.joints:
            for side, bound in enumerate(bounds[joint]):
                for value in np.linspace(stance.pose[joint], bound, DETERMINANT_STEPS)[1:]:
                    q = stance.pose.copy()
                    q[joint] = value
                    if determinant(q) / standing_value < LEAST_DETERMINANT_SHARE:
                        position[joint, side] = value
                        break
    return dataclasses.replace(limits, position=position)


def _relaxed_pose(robot: Robot, limits: Limits, legs: IntArray) -> FloatArray:
    """Return the pose between the middle of the ranges and 0 with moderate static torques.

    Of the poses on this line it is the first in which no joint outside the legs needs more than
    `STATIC_TORQUE_SHARE` of its torque limit, else the one that needs least.

    Args:
        robot: The robot.
        limits: Its limits.
        legs: Joints of the legs, which are at 0. Shape (m,).
    """
    lower, upper = ranges(limits).T
    middle, zero = 0.5 * (lower + upper), np.clip(np.zeros(robot.n), lower, upper)
    others = np.setdiff1d(np.arange(robot.n), legs)
    data = robot.model.createData()
    best, least = zero, np.inf
    for share in RELAXED_SHARES:
        q = middle + share * (zero - middle)
        q[legs] = zero[legs]
        torque = pin.computeGeneralizedGravity(robot.model, data, robot.expand(q))
        largest = float(np.max(np.abs(torque / limits.torque)[others], initial=0.0))
        if largest < least:
            best, least = q, largest
        if least <= STATIC_TORQUE_SHARE:
            break
    return best


def _best_leg(robot: Robot, limits: Limits, foot: Foot, base: pin.SE3, q: FloatArray) -> FloatArray:
    """Return the standing pose of a leg that is farthest from its limits; others keep theirs."""
    lower, upper = ranges(limits)[foot.joints].T
    rng, data = np.random.default_rng(0), robot.model.createData()
    best, best_room = None, 0.0
    for _ in range(START_COUNT):
        guess = q.copy()
        guess[foot.joints] = rng.uniform(lower, upper)
        solved, error = solve_leg(robot, data, foot, base, guess)
        leg = solved[foot.joints]
        room = float(np.min(np.minimum(leg - lower, upper - leg)))
        if error < MAX_CLOSURE_ERROR and room > best_room:
            best, best_room = solved, room
    if best is None:
        raise _unreachable(robot, foot)
    return best


def _unreachable(robot: Robot, foot: Foot) -> Infeasible:
    """Return the error that no pose of a leg stands."""
    names = ", ".join(robot.joints[j] for j in foot.joints)
    return Infeasible(
        f"{robot.source}: --support {foot.frame}: no pose within the limits of {names} stands; "
        "widen their position limits"
    )
