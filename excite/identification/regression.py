"""Regression equations τ = Γ θ of recordings, both sides filtered (Lee, Wensing & Park, eq. 9)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._types import BoolArray, FloatArray, IntArray
from ..robot.base_parameters import Base
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from ..robot.samples import Samples
from .lowpass import MOTION_BANDWIDTH_RATIO, Grid, LowPassFilter, friction_speed
from .segments import RecordingSegment, split_into_chunks, too_short
from .standstill import MIN_STANDSTILL_COARSE, LargestMotion, moving_rows

BLOCK_ROWS = 4096
"""Number of samples whose regressor is held in memory at a time."""
MIN_NOISE_FREEDOM = 2
"""Degrees of freedom ν of the residual of a joint, on average, that must be exceeded: up to 2, the
mean of 1/σ̂², a joint's weight, is infinite for σ̂² ~ σ² χ²_ν/ν."""


@dataclass(frozen=True)
class IdentificationModel:
    """Dynamic model whose parameters are identified.

    Attributes:
        robot: The robot.
        parameters: Its standard parameters ψ.
        base: Its base parameters θ = B ψ.
        widths: Speed scale of each joint's smooth Coulomb friction tanh(q̇/width). Shape (n,)
            [rad/s or m/s].
    """

    robot: Robot
    parameters: Parameters
    base: Base
    widths: FloatArray

    def friction_columns(self) -> dict[int, int]:
        """Map the columns of Γ that are Coulomb friction alone to their joints."""
        if "coulomb" not in self.parameters.drive:
            return {}
        block = self.parameters.block("coulomb")
        return {
            k: int(place) - block.start
            for k, place in enumerate(self.base.independent)
            if block.start <= place < block.stop
        }


@dataclass(frozen=True, kw_only=True)
class RowLayout:
    """Rows of segments that follow each other.

    Attributes:
        moving: Rows of each joint that count: False where a joint with Coulomb friction stands
            still. Shape (N, n).
        starts: Row at which each segment begins, the first being 0.
        periods: Number of periods that each segment is the mean of; 0 if it is not periodic.
        repeats: For each segment, Fourier coefficients of each period's torque minus the mean, at
            the frequencies of the rows above 0. Shape (periods, (N − 1)/2, n), or None.
        rate: Rate of the rows [Hz].
    """

    moving: BoolArray
    starts: tuple[int, ...]
    periods: tuple[int, ...]
    repeats: tuple[NDArray[np.complex128] | None, ...]
    rate: float

    def __len__(self) -> int:
        return len(self.moving)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.moving.shape[1])

    def stretches(self) -> Iterator[slice]:
        """Yield the rows of each segment."""
        for start, stop in zip(self.starts, (*self.starts[1:], len(self)), strict=True):
            yield slice(start, stop)


@dataclass(frozen=True, kw_only=True)
class TorqueEquations(RowLayout):
    """Rows of τ = Γ θ at twice the cutoff frequency.

    Attributes:
        torque: Filtered torque. Shape (N, n) [N m].
        regressor: Filtered Γ. Shape (N, n, p).
        slopes: Derivative of torque with respect to the logarithm of the Coulomb width, over the
            Coulomb friction. Shape (N, n).
        motion: Motion at the rows.
        time: Time of each row. Shape (N,) [s].
        sources: Name of each segment's recording.
        hertz: Cutoff frequency [Hz].
    """

    torque: FloatArray
    regressor: FloatArray
    slopes: FloatArray
    motion: Samples
    time: FloatArray
    sources: tuple[str, ...]
    hertz: float

    def rows(self, which: slice) -> TorqueEquations:
        """Return a range of rows as one aperiodic segment."""
        return dataclasses.replace(
            self,
            torque=self.torque[which],
            regressor=self.regressor[which],
            slopes=self.slopes[which],
            moving=self.moving[which],
            motion=self.motion.rows(which),
            time=self.time[which],
            starts=(0,),
            sources=self.sources[:1],
            periods=(0,),
            repeats=(None,),
        )

    def without_standstill(self) -> TorqueEquations:
        """Return the equations with zeros in the rows that do not count."""
        if self.moving.all():
            return self
        return dataclasses.replace(
            self,
            torque=np.where(self.moving, self.torque, 0.0),
            regressor=np.where(self.moving[:, :, None], self.regressor, 0.0),
            slopes=np.where(self.moving, self.slopes, 0.0),
        )

    def predicted(self, theta: FloatArray) -> FloatArray:
        """Return the torque Γ θ. Shape (N, n) [N m]."""
        out: FloatArray = self.regressor @ theta
        return out


def build_equations(
    model: IdentificationModel, segments: Iterable[RecordingSegment], hertz: float
) -> TorqueEquations:
    """Build the equations of all segments below a cutoff frequency.

    The mean of P periods has the weight of one period, although its noise variance is P times
    smaller: the model error of a real robot does not average out. Where it dominates, the weight P
    makes predictions of other motions worse, and intervals too small.

    Args:
        model: The model to identify.
        segments: Segments of recordings.
        hertz: Cutoff frequency [Hz].

    Raises:
        UnusableInput: All segments are shorter than the margins that the filter discards.
    """
    parts, motions = list[TorqueEquations](), list[_SegmentMotion]()
    starts, count = list[tuple[int, RecordingSegment, int]](), 0
    segments = list(segments)
    for segment in segments:
        band = segment.band(hertz)
        chunks = list(_chunk_equations(model, segment, band))
        if chunks:
            time = np.concatenate([chunk.time for chunk in chunks])
            motions.append(_segment_motion(segment, band, time))
            starts.append((count, segment, sum(map(len, chunks))))
            count += starts[-1][2]
            parts += chunks
    if not segments:
        raise too_short("recordings", 0.0, hertz)
    if not parts:
        longest = max(segments, key=lambda segment: len(segment) / segment.rate)
        needed = 2.0 * longest.band(hertz).margin / longest.rate
        # base parameters, and the width of each joint's Coulomb friction
        rows = model.base.count // model.robot.n + 1 + MIN_NOISE_FREEDOM + 1
        raise too_short(longest.source, needed, hertz, longest, rows)
    return TorqueEquations(
        torque=np.concatenate([part.torque for part in parts]),
        regressor=np.concatenate([part.regressor for part in parts]),
        slopes=np.concatenate([part.slopes for part in parts]),
        moving=_moving_rows(model, motions),
        motion=Samples(
            *(
                np.concatenate([getattr(part.motion, name) for part in parts])
                for name in ("q", "dq", "ddq")
            )
        ),
        time=np.concatenate([part.time for part in parts]),
        starts=tuple(start for start, _, _ in starts),
        sources=tuple(segment.source for _, segment, _ in starts),
        periods=tuple(segment.periods for _, segment, _ in starts),
        repeats=tuple(_period_deviations(segment, rows) for _, segment, rows in starts),
        hertz=hertz,
        rate=max(part.rate for part in parts),
    )


def _period_deviations(segment: RecordingSegment, rows: int) -> NDArray[np.complex128] | None:
    """Fourier coefficients of each period's torque minus the mean, scaled to a period of `rows`."""
    if segment.noise is None:
        return None
    return np.asarray(
        np.fft.rfft(segment.noise, axis=1)[:, 1 : (rows - 1) // 2 + 1] * (rows / len(segment))
    )


def kept_rows(segment: RecordingSegment, band: LowPassFilter) -> Iterator[tuple[slice, slice]]:
    """Yield the chunks of a segment and the kept rows of each chunk.

    Rows within the margin of an end, and rows that belong to another chunk, are not kept.

    Yields:
        Samples of the chunk, and the range of its rows on the kept grid.
    """
    step = band.steps(Grid.KEPT)
    for samples, inner in split_into_chunks(segment, 3 * band.margin, step):
        low = max(inner.start, band.margin if samples.start == 0 else 0)
        high = min(
            inner.stop,
            len(segment) - samples.start - (band.margin if samples.stop == len(segment) else 0),
        )
        kept = (
            slice(0, None) if segment.periodic else slice(-(-low // step), max(-(-high // step), 0))
        )
        if segment.periodic or kept.stop > kept.start:
            yield samples, kept


def _chunk_equations(
    model: IdentificationModel, segment: RecordingSegment, band: LowPassFilter
) -> Iterator[TorqueEquations]:
    """Yield the equations of a segment chunk by chunk."""
    for samples, kept in kept_rows(segment, band):
        part = dataclasses.replace(band, count=samples.stop - samples.start)
        torque = part.filter(segment.torque[samples], Grid.KEPT)[kept]
        time = (
            segment.start
            + samples.start / segment.rate
            + np.arange(part.samples(Grid.KEPT))[kept] / band.rate_of(Grid.KEPT)
        )
        gamma, slopes, motion = filtered_regressor(model, segment.q[samples], part)
        yield TorqueEquations(
            torque=torque,
            regressor=gamma[kept],
            slopes=slopes[kept],
            moving=np.ones(slopes[kept].shape, bool),
            motion=motion.rows(kept),
            time=time,
            starts=(0,),
            sources=(segment.source,),
            periods=(segment.periods,),
            repeats=(None,),
            hertz=band.hertz,
            rate=band.rate_of(Grid.KEPT),
        )


@dataclass(frozen=True)
class _SegmentMotion:
    """Low-passed motion of a segment at every recorded sample.

    Attributes:
        segment: The segment.
        q: Positions. Shape (M, n) [rad or m].
        dq: Velocities. Shape (M, n) [rad/s or m/s].
        rows: Sample of each row of the equations. Shape (N,).
    """

    segment: RecordingSegment
    q: FloatArray
    dq: FloatArray
    rows: IntArray


def _segment_motion(
    segment: RecordingSegment, band: LowPassFilter, time: FloatArray
) -> _SegmentMotion:
    """Low-pass the motion of a segment, whose rows are at given times, shape (N,) [s]."""
    position, speed = list[FloatArray](), list[FloatArray]()
    for samples, inner in split_into_chunks(segment, 3 * band.margin, band.steps(Grid.KEPT)):
        part = dataclasses.replace(band, count=samples.stop - samples.start)
        spectrum = part.transform(segment.q[samples])
        position.append(spectrum.filter(Grid.RECORDED, 0, MOTION_BANDWIDTH_RATIO)[inner])
        speed.append(friction_speed(segment.q[samples], part, spectrum)[inner])
    rows = np.rint((time - segment.start) * segment.rate).astype(int) % len(segment)
    return _SegmentMotion(segment, np.concatenate(position), np.concatenate(speed), rows)


def _moving_rows(model: IdentificationModel, motions: Sequence[_SegmentMotion]) -> BoolArray:
    """Rows of all segments that count, see `TorqueEquations.moving`. Shape (N, n).

    A joint with fewer rows in motion than there are parameters counts at all times, as its torque
    at rest says more, within ± its friction.
    """
    largest = LargestMotion.of((motion.q, motion.dq) for motion in motions)
    moving = np.concatenate(
        [
            moving_rows(
                motion.segment, motion.q, motion.dq, motion.rows, largest, MIN_STANDSTILL_COARSE
            )
            for motion in motions
        ]
    )
    out = np.ones((len(moving), model.robot.n), bool)
    joints = list(model.friction_columns().values())
    out[:, joints] = (moving | (moving.sum(axis=0) < model.base.count))[:, joints]
    return out


def filtered_regressor(
    model: IdentificationModel, q: FloatArray, band: LowPassFilter
) -> tuple[FloatArray, FloatArray, Samples]:
    """Compute the filtered base regressor along recorded positions.

    Args:
        model: The model.
        q: Positions at every recorded sample. Shape (samples, n).
        band: Filter of the stretch.

    Returns:
        Γ at the M kept rows, shape (M, n, p); the slopes by the Coulomb widths, shape (M, n), see
        `TorqueEquations.slopes`; the motion at the kept rows.
    """
    position = band.transform(q)
    samples = Samples(
        *(position.filter(Grid.COARSE, order, MOTION_BANDWIDTH_RATIO) for order in range(3))
    )
    blocks = [
        regressor(model.robot, model.parameters, samples.rows(slice(start, start + BLOCK_ROWS)))[
            :, :, model.base.independent
        ]
        for start in range(0, len(samples), BLOCK_ROWS)
    ]
    gamma = band.filter(np.concatenate(blocks), Grid.KEPT, source=Grid.COARSE)
    slopes = np.zeros(gamma.shape[:2])
    columns = model.friction_columns()
    if columns:  # from every recorded sample: the coarse grid does not resolve the friction steps
        coulomb, slopes = filtered_friction(model.widths, friction_speed(q, band, position), band)
        for k, joint in columns.items():
            gamma[:, :, k] = 0.0
            gamma[:, joint, k] = coulomb[:, joint]
    return gamma, slopes, Samples(*(position.filter(Grid.KEPT, order) for order in range(3)))


def filtered_friction(
    widths: FloatArray, speed: FloatArray, band: LowPassFilter
) -> tuple[FloatArray, FloatArray]:
    """Compute filtered tanh(q̇/width) and its derivative with respect to log width.

    Args:
        widths: Coulomb widths. Shape (n,) [rad/s or m/s].
        speed: Joint speeds at every recorded sample. Shape (samples, n).
        band: Filter of the stretch.

    Returns:
        Two arrays at the M kept rows. Shapes (M, n).
    """
    step = np.tanh(speed / widths)
    both = band.filter(
        np.concatenate([step, -(speed / widths) * (1.0 - step**2)], axis=1), Grid.KEPT
    )
    return both[:, : len(widths)], both[:, len(widths) :]
