"""Robots whose base moves freely: legged robots, humanoids and humans on force plates.

The equations of motion of such a robot have six rows of its base and a row per joint (Lee, Kwon,
Wensing & Park, eq. 12):

    Σᵢ Jᵢᵀ Wᵢ + Sᵀ τ = Y(x, ν, ν̇) ψ

with the pose of the base and the joint positions in x, the contact wrenches Wᵢ and the joint
torques τ. The six base rows alone have the same structurally identifiable parameters as all rows.

Positions are a pose (x, y, z of the origin of the base link in the world, quaternion x, y, z, w)
and n joint positions; velocities are the spatial velocity of the base link in its own axes (linear,
then angular) and n joint velocities; accelerations are the time derivatives of these six and n
numbers, as Pinocchio defines them for a free flyer. Base rows are a force and a moment in the axes
of the base link at its origin.
"""

from __future__ import annotations

import enum
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from .._types import BoolArray, FloatArray, IntArray
from ..errors import ExciteWarning, UnusableInput, UnusableRobot
from . import base_parameters, inertial_parameters
from . import robot as robots
from .base_parameters import COUNTING_SPEEDS, RECURSION_TOLERANCE, Base
from .dynamics import BLOCK_NUMBERS
from .inertial_parameters import COULOMB_WIDTH, Parameters, of_pseudo_inertia, pseudo_inertia
from .limits import Limits, resolve_with_assumptions
from .link_inertia import LinkInertia
from .robot import GRAVITY, Payload, Robot

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
"""Components of a wrench [N, N m]."""
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""Components of a pose: position [m] and unit quaternion, as in the columns `base.x`, …"""


class Rows(enum.Enum):
    """Rows of the equations of motion, named as on the command line."""

    BASE = "base"
    JOINTS = "joints"
    BOTH = "both"

    @property
    def has_base(self) -> bool:
        """True if the six rows of the base are among them."""
        return self is not Rows.JOINTS

    @property
    def has_joints(self) -> bool:
        """True if the rows of the joints are among them."""
        return self is not Rows.BASE

    def selection(self, n: int) -> slice:
        """Return the places of these rows among the 6 + n rows."""
        return slice(0 if self.has_base else 6, 6 + n if self.has_joints else 6)


@dataclass(frozen=True)
class FloatingMotion:
    """Motion of a floating-base robot at N times.

    Attributes:
        pose: Pose of the base: position [m], unit quaternion x, y, z, w. Shape (N, 7).
        q: Joint positions. Shape (N, n) [rad or m].
        velocity: Velocity of the base, then of the joints. Shape (N, 6 + n).
        acceleration: Time derivative of `velocity`. Shape (N, 6 + n).
    """

    pose: FloatArray
    q: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    def __len__(self) -> int:
        return len(self.q)

    def rows(self, which: BoolArray | IntArray | slice) -> FloatingMotion:
        """Return the times that `which` selects."""
        return FloatingMotion(
            self.pose[which], self.q[which], self.velocity[which], self.acceleration[which]
        )


@dataclass(frozen=True)
class FloatingRobot:
    """A robot whose base moves freely.

    Attributes:
        joint_robot: The same robot with its base fixed: joints, links, limits.
        model: Pinocchio model whose first joint is a free flyer.
        structure: The model with exact placements; see `exact_placement`.
        base_link: Name of the link that the free flyer moves.
        bodies: Index in the model of each body that has a mass; the base is 1.
        links: Name of the link of each of these bodies.
    """

    joint_robot: Robot
    model: pin.Model
    structure: pin.Model
    base_link: str
    bodies: tuple[int, ...]
    links: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self.joint_robot.name

    @property
    def source(self) -> str:
        """Path of its file, or name of the built-in model."""
        return self.joint_robot.source

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the n moving joints."""
        return self.joint_robot.joints

    @property
    def n(self) -> int:
        """Number of moving joints."""
        return self.joint_robot.n

    @property
    def mass(self) -> float:
        """Mass of the robot [kg]."""
        return float(sum(self.model.inertias[i].mass for i in self.bodies))

    @property
    def row_names(self) -> tuple[str, ...]:
        """Names of the 6 + n rows: `base.fx`, …, `tau.<joint>`, …"""
        return (*(f"base.{axis}" for axis in WRENCH), *(f"tau.{joint}" for joint in self.joints))

    def row_units(self) -> tuple[str, ...]:
        """Return the unit of each of the 6 + n rows."""
        joints = (entry.unit("N m") for entry in self.joint_robot.entries)
        return (*("N",) * 3, *("N m",) * 3, *joints)

    def configurations(self, motion: FloatingMotion) -> FloatArray:
        """Return the coordinates of the model. Shape (N, nq)."""
        return np.hstack([motion.pose, self.joint_robot.expand(motion.q)])

    def model_velocities(self, values: FloatArray) -> FloatArray:
        """Return rates of the model's coordinates. Shapes (N, 6 + n) -> (N, nv)."""
        return np.hstack([values[:, :6], values[:, 6:] @ self.joint_robot.spread.T])

    def frame(self, name: str) -> int:
        """Index in the model of the frame of a link, else of a joint.

        Raises:
            UnusableInput: There is none; the message lists similar names.
        """
        if self.model.existFrame(name, pin.FrameType.BODY):
            return int(self.model.getFrameId(name, pin.FrameType.BODY))
        self.joint_robot.frame(name)  # raises if there is none
        return int(self.model.getFrameId(name))


def load(
    source: str | Path | Robot,
    *,
    joints: str | Sequence[str] | None = None,
    lock: Mapping[str, float] | None = None,
    payload: Payload | None = None,
    gravity: Sequence[float] = GRAVITY,
    inertias: Mapping[str, LinkInertia] | None = None,
) -> FloatingRobot:
    """Load a robot with a free flyer between the world and its base link.

    Neither limits nor meshes are needed. Bodies without mass are allowed: they carry no parameters.

    Args:
        source: Path of a URDF, name of a built-in model, or a robot with a fixed base; the options
            below are then those of that robot.
        joints: Joints that move; None: all except mimic joints.
        lock: Positions of locked joints [rad or m].
        payload: Body attached to a link.
        gravity: Gravity in the world. Shape (3,) [m/s²].
        inertias: Inertia of links that state none.

    Raises:
        UnusableInput: The file cannot be used, or a joint or link is unknown.
        UnusableRobot: A body has an inertia but no mass, or no body has a mass.
    """
    robot = (
        source
        if isinstance(source, Robot)
        else robots.load(
            str(source),
            joints=joints,
            lock=lock,
            payload=payload,
            gravity=gravity,
            inertias=inertias,
            require_mass=False,
        )
    )
    model, structure = robots.free_flyer_models(robot)
    names = (_base_link(model), *robot.links)
    faults = [
        f"{robot.source}: link '{link}' has an inertia but the mass 0; correct its <mass> or "
        "remove its <inertial>"
        for link, body in zip(names, model.inertias[1:], strict=True)
        if body.mass == 0.0 and np.any(body.inertia)
    ]
    bodies = tuple(i for i in range(1, model.njoints) if model.inertias[i].mass > 0.0)
    if not bodies:
        faults.append(f"{robot.source}: no link has a mass; give its links an <inertial>")
    if faults:
        raise UnusableRobot(faults)
    return FloatingRobot(
        robot, model, structure, names[0], bodies, tuple(names[i - 1] for i in bodies)
    )


def _base_link(model: pin.Model) -> str:
    """Name of the link that the free flyer moves: the root of the tree."""
    return next(
        str(frame.name)
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and frame.parentJoint == 1
    )


# -- dynamics --------------------------------------------------------------------------------------


def regressor(
    robot: FloatingRobot, parameters: Parameters, motion: FloatingMotion, rows: Rows = Rows.BOTH
) -> FloatArray:
    """Return Y of the selected rows at every time: wrench on the base and joint torque per unit of
    ψ.

    Memory and time are linear in the number of times; see `regressor_blocks` for long motions.

    Args:
        robot: The robot.
        parameters: Its standard parameters, see `standard_parameters`.
        motion: N times.
        rows: The rows.

    Returns:
        Shape (N, r, P) with r = 6, n or 6 + n.
    """
    model, data, joint_robot = robot.model, robot.model.createData(), robot.joint_robot
    places = np.concatenate([np.arange(10 * (i - 1), 10 * i) for i in robot.bodies])
    q = robot.configurations(motion)
    v, a = (robot.model_velocities(x) for x in (motion.velocity, motion.acceleration))
    which, n = rows.selection(robot.n), robot.n
    out = np.zeros((len(motion), which.stop - which.start, parameters.count))
    first = 6 if rows.has_base else 0
    simple = model.nv == 6 + n
    for t in range(len(motion)):
        full = pin.computeJointTorqueRegressor(model, data, q[t], v[t], a[t])
        if rows.has_base:
            out[t, :6, : len(places)] = full[:6, places]
        if rows.has_joints:
            joint_rows = full[6:, places]
            out[t, first:, : len(places)] = (
                joint_rows if simple else joint_robot.spread.T @ joint_rows
            )
    if rows.has_joints:
        dq, ddq = motion.velocity[:, 6:], motion.acceleration[:, 6:]
        columns = {
            "rotor_inertia": ddq,
            "viscous": dq,
            "coulomb": np.tanh(dq / COULOMB_WIDTH),
            "offset": np.ones_like(dq),
        }
        index = np.arange(n)
        for kind in parameters.drive:
            out[:, first + index, parameters.block(kind).start + index] = columns[kind]
    return out


def regressor_blocks(
    robot: FloatingRobot, parameters: Parameters, motion: FloatingMotion, rows: Rows = Rows.BOTH
) -> Iterator[FloatArray]:
    """Yield Y at consecutive times in blocks of bounded memory. Shape (≤ N, r, P) each."""
    which = rows.selection(robot.n)
    size = max(BLOCK_NUMBERS // ((which.stop - which.start) * parameters.count), 16)
    for start in range(0, len(motion), size):
        yield regressor(robot, parameters, motion.rows(slice(start, start + size)), rows)


# -- parameters ------------------------------------------------------------------------------------


def limits(robot: FloatingRobot, file: Path | None = None) -> Limits:
    """Limits of the joints, with assumed values where none is stated; they are scales only."""
    return resolve_with_assumptions(robot.joint_robot, file)


def standard_parameters(
    robot: FloatingRobot, limits_of_joints: Limits | None = None, drive: str | Iterable[str] = ()
) -> Parameters:
    """Return the standard parameters of all bodies with mass, and of joints.

    The number in the name of a body's parameter is that of the joint that moves it, from 1; the
    base is 0.

    Args:
        robot: The robot.
        limits_of_joints: Limits of the joints, for the scales of joint parameters; None: `limits`.
        drive: Kinds of joint parameters; base rows determine none.

    Raises:
        UnusableInput: `drive` names an unknown kind.
    """
    kinds = inertial_parameters.drive_kinds(drive)
    all_bodies = [body.toDynamicParameters() for body in robot.model.inertias[1:]]
    nominal: Mapping[str, FloatArray] = {}
    scale: Mapping[str, FloatArray] = {}
    if kinds:
        table = limits_of_joints or limits(robot)
        consistent = inertial_parameters.consistent_bodies(all_bodies)[1:]
        nominal, scale = inertial_parameters.drive_values(robot.joint_robot, table, consistent)
    return inertial_parameters.assembled_parameters(
        robot.joint_robot,
        kinds,
        [all_bodies[i - 1] for i in robot.bodies],
        robot.links,
        [i - 1 for i in robot.bodies],
        nominal,
        scale,
    )


def random_motion(robot: FloatingRobot, count: int, rng: np.random.Generator) -> FloatingMotion:
    """Unrelated states of base and joints, for counting ranks."""
    table = limits(robot)
    joints = base_parameters.random_motion(table, count, rng)
    speed = float(np.clip(np.median(table.velocity), *COUNTING_SPEEDS))
    quaternion = rng.normal(size=(count, 4))
    pose = np.hstack(
        [rng.normal(size=(count, 3)), quaternion / np.linalg.norm(quaternion, axis=1)[:, None]]
    )
    velocity = np.hstack([speed * rng.normal(size=(count, 6)), joints.dq])
    acceleration = np.hstack([4.0 * speed * rng.normal(size=(count, 6)), joints.ddq])
    return FloatingMotion(pose, joints.q, velocity, acceleration)


def find_base_parameters(
    robot: FloatingRobot, parameters: Parameters, rows: Rows = Rows.BOTH
) -> Base:
    """Base parameters that the selected rows determine, checked against the structure.

    Those of the base rows are those of all rows, joint parameters apart; joint rows alone do not
    contain the inertia of the base link. A warning says when the numerical and the structural
    number differ.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        rows: The rows.
    """
    which = rows.selection(robot.n)
    count = max(40, 4 * parameters.count // (which.stop - which.start) + 20)
    motion = random_motion(robot, count, np.random.default_rng(1))
    exact = FloatingRobot(
        robot.joint_robot,
        robot.structure,
        robot.structure,
        robot.base_link,
        robot.bodies,
        robot.links,
    )
    stacked = np.zeros((0, parameters.count))
    for Y in regressor_blocks(exact, parameters, motion, rows):
        block = np.vstack([stacked, Y.reshape(-1, parameters.count)])
        stacked = np.asarray(np.linalg.qr(block, mode="r"))
    base = base_parameters.base_of_columns(stacked, parameters)
    expected = base_count(robot, parameters, rows)
    if base.count != expected and robot.model.nv == 6 + robot.n:
        text = (
            f"{robot.source}: {base.count} base parameters are visible in the rows, {expected} "
            "exist by structure; the difference is left out (a length or an angle of the robot is "
            "nearly zero)"
        )
        warnings.warn(text, ExciteWarning, stacklevel=2)
    return base


def base_count(robot: FloatingRobot, parameters: Parameters, rows: Rows = Rows.BOTH) -> int:
    """Number of base parameters that the structure of the robot admits in the selected rows.

    The invisible changes are sums of transfers across single joints, as in `base_parameters`. Here
    a body attains all velocities, as its base does, which makes the recursion trivial; and only
    sums that leave bodies without mass as they are count. Of a robot with mimic joints it is an
    upper bound.
    """
    rotor, offset = "rotor_inertia" in parameters.drive, "offset" in parameters.drive
    model, joint_robot = robot.structure, robot.joint_robot.with_exact_placements()
    gravity = np.concatenate([np.asarray(model.gravity.linear), np.zeros(3)])
    columns = []
    if not rows.has_base:  # the inertia of the base is in no joint row
        columns += list(np.eye(10 * (model.njoints - 1))[:10])
    for body, axis in enumerate(joint_robot.axes(), start=2):
        moved = base_parameters.transfers(
            axis, np.eye(6), gravity, np.zeros((6, 0)), rotor and rows.has_joints, offset
        )
        placement, parent = model.jointPlacements[body], int(model.parents[body])
        for change in moved.T:
            column = np.zeros(10 * (model.njoints - 1))
            column[10 * (body - 1) : 10 * body] = change[:10]
            column[10 * (parent - 1) : 10 * parent] = -_in_parent(change[:10], placement)
            columns.append(column)
    basis = np.array(columns).reshape(-1, 10 * (model.njoints - 1)).T
    massless = [i for i in range(1, model.njoints) if i not in robot.bodies]
    places = [place for i in massless for place in range(10 * (i - 1), 10 * i)]
    values = np.linalg.svd(basis[places], compute_uv=False) if places else np.zeros(0)
    rank = int(np.sum(values > RECURSION_TOLERANCE * max(1.0, float(values[0])))) if places else 0
    joint_parameters = len(parameters.drive) * robot.n if rows.has_joints else 0
    return 10 * parameters.bodies + joint_parameters - (basis.shape[1] - rank)


def _in_parent(change: FloatArray, placement: pin.SE3) -> FloatArray:
    """Inertial parameters of a change of a body, in the frame of its parent. Shape (10,)."""
    pose = np.asarray(placement.homogeneous)
    return of_pseudo_inertia(pose @ pseudo_inertia(change) @ pose.T)


def require_frame(robot: FloatingRobot, name: str, source: str) -> None:
    """Check that a wrench is measured at a frame of the robot or at the world's origin.

    Raises:
        UnusableInput: There is no such frame.
    """
    if name == "world" or robot.model.existFrame(name):
        return
    from difflib import get_close_matches

    known = [str(frame.name) for frame in robot.model.frames]
    near = get_close_matches(name, known, 3) or known[-3:]
    raise UnusableInput(
        f"{source}: wrench.{name}: {robot.source} has no frame '{name}' (similar: "
        f"{', '.join(near)}); name a link, or 'world' for a wrench about the world's origin"
    )
