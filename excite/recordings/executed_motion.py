"""Alignment of a recording with the trajectory that was executed.

A recorder runs before the motion starts and after it ends, the controller first brings the robot to
the start pose, and an operator may run at reduced speed. The recorded positions are compared with
the commanded motion, time-scaled by the speed and shifted:

    E(ℓ, s) = Σ_k ‖q(ℓ + k Δ) − q_c(s k Δ)‖²,

over all shifts ℓ of a coarse grid, and the best of them is refined by Gauss-Newton in ℓ and s.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray, IntArray
from ..errors import UnusableInput
from ..trajectory.rest_to_rest import Motion, SegmentKind
from ..trajectory.trajectory_file import Trajectory
from . import periodicity
from .recording import Recording
from .remark import Remark, RemarkKind

COARSE_STEP = 0.04
"""Step of the shifts that are tried [s]: the motion of an arm lies below 10 Hz."""
MIN_OVERLAP = 0.5
"""Share of the shorter of recording and motion that must overlap [1]."""
SEARCHED_SPEEDS = np.arange(0.05, 1.2001, 0.01)
"""Speeds that are tried where the recording does not repeat, over the planned one [1]."""
REFINEMENTS = 12
"""Gauss-Newton steps for shift and speed."""
REFINED_ROWS = 4000
"""Number of rows that they use at most."""
MAX_DEVIATION = 0.1
"""RMS deviation from the commanded motion over its standard deviation, at which the recording is
still one of that motion [1]. Controllers follow to 1 %; another motion deviates by 100 %."""
UNCHANGED_SPEED = 2e-3
"""Deviation of the speed from the planned one that is not reported [1]."""


@dataclass(frozen=True)
class ExecutedMotion:
    """A trajectory as it was executed during a recording.

    Attributes:
        motion: Commanded motion at the speed of the trajectory file.
        start: Time at which it starts, on the recording's clock [s].
        speed: Speed over the planned one [1].
        deviation: RMS deviation of the recorded positions over the standard deviation of the
            commanded ones, per joint. Shape (n,).
    """

    motion: Motion
    start: float
    speed: float
    deviation: FloatArray

    @property
    def end(self) -> float:
        """Time at which the motion ends [s]."""
        return self.start + self.motion.duration / self.speed

    @property
    def period(self) -> float:
        """Period at the executed speed [s]."""
        return self.motion.fourier.period / self.speed

    def periodic_window(self, recording: Recording) -> tuple[float, float]:
        """Return start and end of the periodic part within a recording [s].

        Both are widened by up to a row, so that no period is lost by rounding.
        """
        part = self.motion.segment(SegmentKind.FOURIER)
        start, end = (self.start + time / self.speed for time in (part.start, part.end))
        start, end = start - 0.5 * recording.step, end + recording.step
        return max(start, float(recording.t[0])), min(end, float(recording.t[-1]))


def apply_trajectory(recording: Recording, trajectory: Trajectory, source: str) -> Recording | None:
    """Take period, window and commanded positions of a recording from the executed trajectory.

    Args:
        recording: The recording.
        trajectory: The trajectory.
        source: Its file, for messages.

    Returns:
        The recording with a remark about the alignment; None if it holds another motion.

    Raises:
        UnusableInput: The trajectory moves other joints.
    """
    if trajectory.joints != recording.joints:
        raise UnusableInput(
            f"{source}: moves {', '.join(trajectory.joints)}, but {recording.source} was read for "
            f"{', '.join(recording.joints)}; choose them with --joints"
        )
    executed = find_motion(recording, trajectory.motion)
    if executed is None:
        return None
    window = executed.periodic_window(recording)
    qref = recording.qref
    if qref is None:
        qref = executed.motion.at(executed.speed * (recording.t - executed.start))
    changed = abs(executed.speed - 1.0) > UNCHANGED_SPEED
    text = (
        f"the motion of {source} begins {executed.start - recording.t[0]:.4g} s after the "
        f"recording and follows it within {100.0 * executed.deviation.max():.2g} % (RMS)"
    )
    if changed:
        text += (
            f"; it ran at {100.0 * executed.speed:.4g} % of the planned speed, so its period is "
            f"{executed.period:.5g} s"
        )
    remark = Remark(RemarkKind.EXECUTED, text, None, executed.start, executed.end, repaired=changed)
    sidecar = dataclasses.replace(recording.sidecar, period=executed.period, periodic=window)
    return dataclasses.replace(
        recording, sidecar=sidecar, qref=qref, remarks=(*recording.remarks, remark)
    )


def find_motion(recording: Recording, motion: Motion) -> ExecutedMotion | None:
    """Find a commanded motion in a recording.

    Args:
        recording: The recording.
        motion: The motion as planned.

    Returns:
        The motion with the shift and the speed that fit best; None if none fits.
    """
    best: ExecutedMotion | None = None
    for candidate, speed in _candidates(recording, motion):
        shift = _best_shift(recording, candidate, speed)
        if shift is None:
            continue
        executed = _refined(recording, candidate, shift, speed)
        if best is None or executed.deviation.max() < best.deviation.max():
            best = executed
    if best is None or best.deviation.max() > MAX_DEVIATION:
        return None
    return best


def _candidates(recording: Recording, motion: Motion) -> Iterator[tuple[Motion, float]]:
    """Yield motions with the periods that the recording may hold, and their speeds."""
    repetition = periodicity.find_window(recording, motion.fourier.period)
    repetition = repetition or periodicity.find_period(recording, motion.fourier.period)
    if repetition is None:
        yield motion, 1.0
        scores = [
            (_shift_score(recording, motion, float(speed))[1], float(speed))
            for speed in SEARCHED_SPEEDS
        ]
        yield motion, min(scores)[1]
        return
    speed = motion.fourier.period / repetition.period
    yield motion, speed
    periods = int((repetition.window[1] - repetition.window[0]) / repetition.period + 0.05)
    for count in {periods, periods + 1} - {motion.periods, 0}:  # the window may miss a noisy period
        yield with_periods(motion, count), speed


def with_periods(motion: Motion, periods: int) -> Motion:
    """Return the same motion with another number of periods."""
    longer = (periods - motion.periods) * motion.fourier.period
    segments, is_behind = [], False
    for segment in motion.segments:
        start = segment.start + (longer if is_behind else 0.0)
        is_behind = is_behind or segment.kind == "fourier"
        end = segment.end + (longer if is_behind else 0.0)
        segments.append(dataclasses.replace(segment, start=start, end=end))
    return dataclasses.replace(motion, periods=periods, segments=tuple(segments))


def _best_shift(recording: Recording, motion: Motion, speed: float) -> float | None:
    """Start of the motion on the recording's clock by the coarse grid [s]."""
    shift, score = _shift_score(recording, motion, speed)
    return shift if np.isfinite(score) else None


def _shift_score(recording: Recording, motion: Motion, speed: float) -> tuple[float, float]:
    """Best shift [s], and the mean squared deviation over the variance of the motion there [1]."""
    t = np.arange(recording.t[0], recording.t[-1], COARSE_STEP)
    q = np.column_stack([np.interp(t, recording.t, column) for column in recording.q.T])
    commanded = motion.at(speed * np.arange(0.0, motion.duration / speed, COARSE_STEP))
    scale = 1.0 / np.maximum(np.std(commanded, axis=0), 1e-9)
    moves = np.std(commanded, axis=0) > 1e-3 * np.std(commanded, axis=0).max()
    q, commanded = (q * scale)[:, moves], (commanded * scale)[:, moves]
    fewest = int(MIN_OVERLAP * min(len(q), len(commanded)))
    # Σ‖q − c‖² = Σ‖q‖² + Σ‖c‖² − 2 Σ q·c over the overlap, by running sums and a correlation
    offsets = np.arange(-len(commanded) + 1, len(q))
    size = 1 << int(np.ceil(np.log2(len(q) + len(commanded))))
    products = np.fft.irfft(
        np.sum(
            np.fft.rfft(q, size, axis=0) * np.conj(np.fft.rfft(commanded, size, axis=0)), axis=1
        ),
        size,
    )[offsets % size]
    squares = [np.concatenate([[0.0], np.cumsum(np.sum(x**2, axis=1))]) for x in (q, commanded)]
    first, last = np.maximum(offsets, 0), np.minimum(offsets + len(commanded), len(q))
    error = (
        squares[0][last]
        - squares[0][first]
        + squares[1][last - offsets]
        - squares[1][first - offsets]
        - 2.0 * products
    )
    overlap = last - first
    score = np.where(
        overlap >= max(fewest, 2), error / np.maximum(overlap, 1) / max(q.shape[1], 1), np.inf
    )
    best = int(np.argmin(score))
    return float(recording.t[0] + offsets[best] * COARSE_STEP), float(score[best])


def _refined(recording: Recording, motion: Motion, start: float, speed: float) -> ExecutedMotion:
    """Refine shift and speed by Gauss-Newton over the recorded rows."""
    scale = 1.0 / np.maximum(np.std(motion.at(motion.grid(20.0)), axis=0), 1e-9)
    moves = scale < 1e3 * scale.min()
    for _ in range(REFINEMENTS):
        rows = _rows(recording, motion, start, speed)
        t = recording.t[rows]
        local = speed * (t - start)
        error = ((recording.q[rows] - motion.at(local)) * scale)[:, moves].ravel()
        rate = (motion.at(local, 1) * scale)[:, moves]
        jacobian = np.column_stack([(-speed * rate).ravel(), (rate * (t - start)[:, None]).ravel()])
        step = np.linalg.lstsq(jacobian, error, rcond=None)[0]
        start, speed = start + float(step[0]), speed + float(step[1])
        if abs(step[0]) < 1e-7 and abs(step[1]) < 1e-9:
            break
        if not 0.01 < speed < 10.0:
            break
    rows = _rows(recording, motion, start, speed)
    error = (recording.q[rows] - motion.at(speed * (recording.t[rows] - start))) * scale
    deviation = np.where(moves, np.sqrt(np.mean(error**2, axis=0)), 0.0)
    return ExecutedMotion(motion, start, speed, deviation)


def _rows(recording: Recording, motion: Motion, start: float, speed: float) -> IntArray:
    """Indices of recorded rows during the motion, REFINED_ROWS at most."""
    inside = np.flatnonzero(
        (recording.t >= start) & (recording.t <= start + motion.duration / speed)
    )
    if len(inside) < 2:
        return np.arange(len(recording))
    return inside[:: max(1, len(inside) // REFINED_ROWS)]
