"""Regression equations of a floating-base robot: rows of its base and of its joints.

The six base rows are the sum of the contact wrenches in the axes of the world about the origin of
the base link; joint row j is the torque of the joint plus the torque of the contact wrenches. Both
sides pass the same zero-phase low-pass filter, as in `regression`.

The pose of the base is filtered in ℝ³ for the position and in ℝ⁴ for the quaternion, whose sign is
continuous, and then projected on unit quaternions: a chart of rotations without a singularity. With
the filtered quaternion u, its exact derivatives u̇, ü and s = |u|,

    ω = 2 vec(ū u̇)/s²,   ω̇ = 2 vec(ū ü)/s² − 2 ω (u·u̇)/s²

are the angular velocity and acceleration in the axes of the base link (ū: conjugate).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..errors import UnusableInput
from ..recordings import Recording
from ..recordings.floating_signals import WORLD
from ..robot import floating_base
from ..robot.base_parameters import Base
from ..robot.floating_base import FloatingMotion, FloatingRobot, Rows
from ..robot.inertial_parameters import Parameters
from ..robot.samples import Samples
from .lowpass import (
    FRICTION_BANDWIDTH_RATIO,
    MOTION_BANDWIDTH_RATIO,
    Grid,
    LowPassFilter,
)
from .regression import IdentificationModel, TorqueEquations, filtered_friction
from .segments import split_into_chunks, too_short

CHUNK_SAMPLES = 4096
"""Number of samples that are processed together, to bound memory."""


@dataclass(frozen=True)
class FloatingModel:
    """Dynamic model of a floating-base robot whose parameters are identified.

    Attributes:
        robot: The robot.
        parameters: Its standard parameters ψ.
        base: Its base parameters θ = B ψ in the rows.
        rows: Rows of the equations.
        contacts: Frames of the contact wrenches, in the order of the offsets.
        widths: Speed scale of each joint's smooth Coulomb friction. Shape (n,) [rad/s or m/s].
    """

    robot: FloatingRobot
    parameters: Parameters
    base: Base
    rows: Rows
    contacts: tuple[str, ...]
    widths: FloatArray

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self.robot.name

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the rows: `wrench.fx`, … for the base, `tau.<joint>` for the joints."""
        names = [f"wrench.{axis}" for axis in floating_base.WRENCH]
        return tuple([*names, *self.robot.row_names[6:]][self.rows.selection(self.robot.n)])

    def row_units(self) -> tuple[str, ...]:
        """Return the unit of each row."""
        return self.robot.row_units()[self.rows.selection(self.robot.n)]


@dataclass(frozen=True)
class FloatingEquations:
    """Rows of y = Γ θ + N b at twice the cutoff frequency.

    Attributes:
        equations: y and Γ, with "torque" of the rows in `FloatingModel.joints`.
        offsets: N, columns of the constant offsets b of the contact wrenches' sensors, six of each
            contact in its frame. Shape (N, r, 6 contacts).
    """

    equations: TorqueEquations
    offsets: FloatArray

    def __len__(self) -> int:
        return len(self.equations)


def require_rows(recording: Recording, rows: Rows) -> None:
    """Check that a recording holds the quantities of the rows.

    Raises:
        UnusableInput: Wrenches or torques are missing.
    """
    if rows.has_base and not recording.contacts:
        raise UnusableInput(
            f"{recording.source}: has no contact wrench for the base rows; record "
            "wrench.<frame>.fx … mz or wrench.world.fx … mz, or name the columns with --columns "
            "wrench.world.fx=COLUMN,…"
        )
    if rows.has_joints:
        _ = recording.torque  # raises where a joint has none
        if WORLD in recording.contacts:
            raise UnusableInput(
                f"{recording.source}: wrench.world does not say on which link it acts, which joint "
                "rows need; name the frame of the contact (wrench.<frame>.fx …), or use --rows base"
            )


def available_rows(recordings: Sequence[Recording]) -> Rows:
    """Return the rows that all recordings hold.

    Raises:
        UnusableInput: They hold neither wrenches nor torques of all joints.
    """
    has_base = all(recording.contacts for recording in recordings)
    has_joints = all(
        WORLD not in recording.contacts
        and all(recording.has("tau", j) or recording.has("current", j) for j in recording.joints)
        for recording in recordings
    )
    if not has_base and not has_joints:
        require_rows(next(r for r in recordings if not r.contacts), Rows.BASE)
    return Rows.BOTH if has_base and has_joints else Rows.BASE if has_base else Rows.JOINTS


# -- motion ----------------------------------------------------------------------------------------


def filtered_motion(
    recording: Recording,
    robot: FloatingRobot,
    band: LowPassFilter,
    grid: Grid,
    bandwidth_ratio: float = MOTION_BANDWIDTH_RATIO,
) -> FloatingMotion:
    """Filter the motion of a gap-free recording and differentiate it.

    Where the recording has a gyroscope or an accelerometer at the base, its signals stand in place
    of the derivatives of the pose.

    Args:
        recording: Recording without gaps.
        robot: The robot, for gravity.
        band: Filter of these samples.
        grid: Grid of the result.
        bandwidth_ratio: Cutoff of positions over the cutoff of the filter.

    Returns:
        The motion at the samples of `grid`.
    """
    pose = pose_of(recording)
    joints, base = band.transform(recording.q), band.transform(pose)
    q, dq, ddq = (joints.filter(grid, order, bandwidth_ratio) for order in range(3))
    x, dx, ddx = (base.filter(grid, order, bandwidth_ratio) for order in range(3))
    u, du, ddu = x[:, 3:], dx[:, 3:], ddx[:, 3:]
    square = np.einsum("ti,ti->t", u, u)[:, None]
    angular = 2.0 * _relative(u, du) / square
    angular_rate = (
        2.0 * (_relative(u, ddu) - angular * np.einsum("ti,ti->t", u, du)[:, None]) / square
    )
    filtered_pose = np.hstack([x[:, :3], u / np.sqrt(square)])
    to_base = rotations(filtered_pose).transpose(0, 2, 1)
    linear = np.einsum("tij,tj->ti", to_base, dx[:, :3])
    acceleration = np.einsum("tij,tj->ti", to_base, ddx[:, :3])
    if "gyroscope" in recording.signals:
        gyroscope = band.transform(recording.signals["gyroscope"])
        angular, angular_rate = (gyroscope.filter(grid, k, bandwidth_ratio) for k in range(2))
    if "accelerometer" in recording.signals:
        force = band.filter(
            recording.signals["accelerometer"], grid, bandwidth_ratio=bandwidth_ratio
        )
        acceleration = force + to_base @ np.asarray(robot.model.gravity.linear)
    # the derivative of the velocity's components in the moving axes of the base
    linear_rate = acceleration - np.cross(angular, linear)
    return FloatingMotion(
        filtered_pose,
        q,
        np.hstack([linear, angular, dq]),
        np.hstack([linear_rate, angular_rate, ddq]),
    )


def pose_of(recording: Recording) -> FloatArray:
    """Return the recorded poses of the base. Shape (N, 7).

    Raises:
        UnusableInput: There are none.
    """
    if recording.base is None:
        raise UnusableInput(f"{recording.source}: has no pose of the base; record base.x … base.qw")
    return recording.base


def _relative(u: FloatArray, v: FloatArray) -> FloatArray:
    """Vector part of the quaternion product ū v, components x, y, z, w. Shapes (N, 4) -> (N, 3)."""
    return np.asarray(u[:, 3:] * v[:, :3] - v[:, 3:] * u[:, :3] - np.cross(u[:, :3], v[:, :3]))


def rotations(pose: FloatArray) -> FloatArray:
    """Return the rotation matrices of unit quaternions x, y, z, w. Shapes (N, 7) -> (N, 3, 3)."""
    x, y, z, w = pose[:, 3:].T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=1),
            np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=1),
            np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )


# -- wrenches --------------------------------------------------------------------------------------


def contact_maps(
    robot: FloatingRobot, motion: FloatingMotion, contacts: Sequence[str], rows: Rows
) -> FloatArray:
    """Return the matrices that map contact wrenches to the rows.

    Args:
        robot: The robot.
        motion: N poses and joint positions.
        contacts: Frames of the wrenches, or "world".
        rows: The rows; of the world's wrench the base rows only.

    Returns:
        Shape (N, r, 6 contacts).
    """
    which = rows.selection(robot.n)
    out = np.zeros((len(motion), 6 + robot.n, 6 * len(contacts)))
    world_axes = rotations(motion.pose)
    frames = [None if name == WORLD else robot.frame(name) for name in contacts]
    lever = np.zeros((len(motion), 3, 3))
    x, y, z = motion.pose[:, :3].T
    lever[:, 0, 1], lever[:, 0, 2], lever[:, 1, 2] = -z, y, -x
    lever -= lever.transpose(0, 2, 1)
    for k, frame in enumerate(frames):
        if frame is None:
            out[:, :6, 6 * k : 6 * k + 6] = np.eye(6)
            out[:, 3:6, 6 * k : 6 * k + 3] = -lever
    if any(frame is not None for frame in frames):
        model, data = robot.model, robot.model.createData()
        spread = robot.joint_robot.spread
        for t, q in enumerate(robot.configurations(motion)):
            for k, frame in enumerate(frames):
                if frame is None:
                    continue
                jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL)
                block = out[t, :, 6 * k : 6 * k + 6]
                block[:3] = world_axes[t] @ jacobian[:, :3].T
                block[3:6] = world_axes[t] @ jacobian[:, 3:6].T
                block[6:] = spread.T @ jacobian[:, 6:].T
    return out[:, which]


def in_world_axes(rows_of_base: FloatArray, pose: FloatArray) -> FloatArray:
    """Rotate base rows from the axes of the base link to those of the world. Shapes (N, 6, …)."""
    rotation = rotations(pose)
    return np.concatenate(
        [
            np.einsum("tij,tj...->ti...", rotation, rows_of_base[:, :3]),
            np.einsum("tij,tj...->ti...", rotation, rows_of_base[:, 3:6]),
        ],
        axis=1,
    )


def about_world_origin(wrench: FloatArray, pose: FloatArray) -> FloatArray:
    """Move wrenches in world axes from the base's origin to the world's. Shape (N, 6)."""
    moment = wrench[:, 3:] + np.cross(pose[:, :3], wrench[:, :3])
    return np.hstack([wrench[:, :3], moment])


def about_base_origin(wrench: FloatArray, pose: FloatArray) -> FloatArray:
    """Move wrenches in world axes from the world's origin to the base's. Shape (N, 6)."""
    moment = wrench[:, 3:] - np.cross(pose[:, :3], wrench[:, :3])
    return np.hstack([wrench[:, :3], moment])


# -- equations -------------------------------------------------------------------------------------


def build_equations(
    model: FloatingModel, recordings: Iterable[Recording], hertz: FloatArray
) -> FloatingEquations:
    """Build the equations of all gap-free segments, each row below its cutoff frequency.

    Args:
        model: The model to identify.
        recordings: Recordings with the model's contacts.
        hertz: Cutoff frequency of each row. Shape (r,) [Hz].

    Raises:
        UnusableInput: All segments are shorter than the margins that the filter discards.
    """
    parts, offsets, starts, sources, count = [], [], list[int](), list[str](), 0
    longest, source, margin = 0.0, "", 0.0
    for recording in recordings:
        for segment in recording.segments():
            begin = count
            band = RowFilter.of(segment, hertz)
            if len(segment) / segment.rate > longest:
                longest, source = len(segment) / segment.rate, recording.source
                margin = 2.0 * band.margin / segment.rate
            for equations, columns in _segment_equations(model, segment, band):
                parts.append(equations)
                offsets.append(columns)
                count += len(equations)
            if count > begin:
                starts.append(begin)
                sources.append(recording.source)
    if not parts:
        raise too_short(source, margin, float(hertz.min()))
    motion = Samples(
        *(np.concatenate([getattr(p.motion, name) for p in parts]) for name in ("q", "dq", "ddq"))
    )
    equations = dataclasses.replace(
        parts[0],
        torque=np.concatenate([part.torque for part in parts]),
        regressor=np.concatenate([part.regressor for part in parts]),
        slopes=np.concatenate([part.slopes for part in parts]),
        moving=np.concatenate([part.moving for part in parts]),
        motion=motion,
        time=np.concatenate([part.time for part in parts]),
        starts=tuple(starts),
        sources=tuple(sources),
        periods=(0,) * len(starts),
        repeats=(None,) * len(starts),
    )
    return FloatingEquations(equations, np.concatenate(offsets))


@dataclass(frozen=True)
class RowFilter:
    """Low-pass filter of a gap-free recording with a cutoff frequency for each row.

    Attributes:
        band: Filter with the highest of them, which also determines the grids.
        hertz: Cutoff frequency of each row. Shape (r,) [Hz].
    """

    band: LowPassFilter
    hertz: FloatArray

    @staticmethod
    def of(segment: Recording, hertz: FloatArray) -> RowFilter:
        """Return the filter of a gap-free recording."""
        encoder = float(segment.quantization_noise.max())
        highest = float(hertz.max())
        return RowFilter(LowPassFilter(highest, segment.rate, len(segment), encoder=encoder), hertz)

    @property
    def margin(self) -> int:
        """Recorded samples to discard at each end, for the lowest of the cutoff frequencies."""
        step = self.band.steps(Grid.KEPT)
        lowest = dataclasses.replace(self.band, hertz=float(self.hertz.min())).margin
        return -(-lowest // step) * step

    def restricted(self, count: int) -> RowFilter:
        """Return the filter of `count` samples."""
        return dataclasses.replace(self, band=dataclasses.replace(self.band, count=count))

    def filter(self, x: FloatArray, to: Grid, source: Grid = Grid.RECORDED) -> FloatArray:
        """Filter rows, each with its cutoff frequency. Shapes (M, r, …)."""
        spectrum = self.band.transform(x, source)
        out: FloatArray | None = None
        for hertz in np.unique(self.hertz):
            filtered = spectrum.filter(to, 0, float(hertz) / self.band.hertz)
            out = np.empty(filtered.shape) if out is None else out
            rows = self.hertz == hertz
            out[:, rows] = filtered[:, rows]
        assert out is not None
        return out


def measured_rows(model: FloatingModel, recording: Recording, maps: FloatArray) -> FloatArray:
    """Return the left side of the equations at the samples of a recording. Shape (N, r).

    Args:
        model: The model.
        recording: The recording.
        maps: Matrices of `contact_maps`.
    """
    out = np.zeros((len(recording), len(model.joints)))
    if model.contacts:
        wrenches = np.hstack([recording.wrench(frame) for frame in model.contacts])
        out += np.einsum("trk,tk->tr", maps, wrenches)
    if model.rows.has_joints:
        out[:, -model.robot.n :] += recording.torque
    return out


def _segment_equations(
    model: FloatingModel, segment: Recording, band: RowFilter
) -> Iterator[tuple[TorqueEquations, FloatArray]]:
    """Yield the equations of a gap-free recording and the columns of offsets, chunk by chunk."""
    step = band.band.steps(Grid.KEPT)
    for samples, inner in split_into_chunks(segment, 3 * band.margin, step, CHUNK_SAMPLES):
        low = max(inner.start, band.margin if samples.start == 0 else 0)
        is_last = samples.stop == len(segment)
        high = min(inner.stop, samples.stop - samples.start - (band.margin if is_last else 0))
        kept = slice(-(-low // step), max(-(-high // step), 0))
        if kept.stop <= kept.start:
            continue
        chunk = segment.rows(samples)
        rows = band.restricted(len(chunk))
        part = rows.band
        recorded = filtered_motion(chunk, model.robot, part, Grid.RECORDED)
        maps = contact_maps(model.robot, recorded, model.contacts, model.rows)
        values = rows.filter(measured_rows(model, chunk, maps), Grid.KEPT)[kept]
        offsets = rows.filter(maps, Grid.KEPT)[kept]
        time = chunk.t[0] + np.arange(part.samples(Grid.KEPT))[kept] / part.rate_of(Grid.KEPT)
        gamma = filtered_regressor(model, chunk, rows)[kept]
        kept_motion = filtered_motion(chunk, model.robot, part, Grid.KEPT, 1.0).rows(kept)
        yield (
            TorqueEquations(
                torque=values,
                regressor=gamma,
                slopes=np.zeros(values.shape),
                moving=np.ones(values.shape, bool),
                motion=Samples(
                    kept_motion.q, kept_motion.velocity[:, 6:], kept_motion.acceleration[:, 6:]
                ),
                time=time,
                starts=(0,),
                sources=(segment.source,),
                periods=(0,),
                repeats=(None,),
                hertz=part.hertz,
                rate=part.rate_of(Grid.KEPT),
            ),
            offsets,
        )


def filtered_regressor(model: FloatingModel, recording: Recording, rows: RowFilter) -> FloatArray:
    """Compute the filtered base regressor of a gap-free recording at the kept rows.

    Returns:
        Γ, its base rows in the axes of the world. Shape (M, r, p).
    """
    band = rows.band
    motion = filtered_motion(recording, model.robot, band, Grid.COARSE)
    columns = model.base.independent
    blocks, start = [], 0
    for Y in floating_base.regressor_blocks(model.robot, model.parameters, motion, model.rows):
        block = Y[:, :, columns]
        if model.rows.has_base:
            pose = motion.pose[start : start + len(Y)]
            block[:, :6] = in_world_axes(block[:, :6], pose)
        blocks.append(block)
        start += len(Y)
    gamma = rows.filter(np.concatenate(blocks), Grid.KEPT, Grid.COARSE)
    friction = IdentificationModel(
        model.robot.joint_robot, model.parameters, model.base, model.widths
    ).friction_columns()
    if friction and model.rows.has_joints:
        speed = band.transform(recording.q).filter(Grid.RECORDED, 1, FRICTION_BANDWIDTH_RATIO)
        coulomb, _ = filtered_friction(model.widths, speed, band)
        first = 6 if model.rows.has_base else 0
        for k, joint in friction.items():
            gamma[:, :, k] = 0.0
            gamma[:, first + joint, k] = coulomb[:, joint]
    return gamma
