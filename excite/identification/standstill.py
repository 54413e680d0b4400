"""Standstill of joints: friction at rest takes any value up to the breakaway torque."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..recordings.missing_values import true_runs
from .segments import RecordingSegment

STANDSTILL_SPEED_RATIO = 0.01
"""Speed up to which a joint stands still, over its largest speed."""
BREAKAWAY_TRAVEL_RATIO = 0.02
"""Travel after a standstill until friction is no longer static, over the joint's range."""
HELD_SPEED_RATIO = 0.1
"""Largest speed in a segment of a joint that is held there and travels less than to its breakaway,
over its largest speed in all segments. With `BREAKAWAY_TRAVEL_RATIO`: a motion that small is meant
as one if its frequency is five times that of the largest motion."""
MIN_STANDSTILL = 0.06
"""Duration from which a joint at standstill is excluded [s]."""
MIN_STANDSTILL_COARSE = 0.2
"""The same for a coarse encoder, which hides how fast a joint reverses, and for the fit of the base
model, to which slow reversals are of use [s]."""
FILTER_REACH = 2.0
"""Time after a step from which a low-pass filter leaves 2 % of it, in periods of its cutoff."""
MIN_RESOLVED_STEPS = 50.0
"""Encoder steps that a joint should be able to travel within `MIN_STANDSTILL`; below, the encoder
counts as coarse."""


@dataclass(frozen=True)
class LargestMotion:
    """Largest motion of each joint in all segments that are fitted together.

    A joint may be held throughout a segment, which alone does not show that its motion is small.

    Attributes:
        speed: Largest speed. Shape (n,) [rad/s or m/s].
        travel: Largest travel within a segment. Shape (n,) [rad or m].
    """

    speed: FloatArray
    travel: FloatArray

    @classmethod
    def of(cls, motions: Iterable[tuple[FloatArray, FloatArray]]) -> LargestMotion:
        """Return the largest motion.

        Args:
            motions: Low-passed positions and velocities of each segment. Shapes (M, n).
        """
        speeds, travels = zip(
            *((np.abs(dq).max(axis=0), np.ptp(q, axis=0)) for q, dq in motions), strict=True
        )
        return cls(np.max(speeds, axis=0), np.max(travels, axis=0))

    def held(self, q: FloatArray, dq: FloatArray) -> BoolArray:
        """Return the joints that are held throughout a segment. Shape (n,).

        Args:
            q: Its low-passed positions. Shape (M, n) [rad or m].
            dq: Its low-passed velocities. Shape (M, n) [rad/s or m/s].
        """
        is_small = np.ptp(q, axis=0) <= BREAKAWAY_TRAVEL_RATIO * self.travel
        return is_small & (np.abs(dq).max(axis=0) <= HELD_SPEED_RATIO * self.speed)


def moving_rows(
    segment: RecordingSegment,
    q: FloatArray,
    dq: FloatArray,
    rows: IntArray,
    largest: LargestMotion,
    shortest: float = MIN_STANDSTILL,
    reach: float = 0.0,
) -> BoolArray:
    """Return the rows at which each joint moves.

    Friction at rest is unknown within ± the breakaway torque, and passes the low-pass filter into
    the rows before a stop and after it.

    Args:
        segment: The segment of a recording.
        q: Its low-passed positions. Shape (M, n) [rad or m].
        dq: Its low-passed velocities. Shape (M, n) [rad/s or m/s].
        rows: Sample of each row. Shape (N,).
        largest: Largest motion of the joints in all segments.
        shortest: Duration from which a standstill counts, unless the encoder is coarse [s].
        reach: Time before and after a standstill of more than this time at which the rows do not
            count either [s].

    Returns:
        Shape (N, n).
    """
    rate, resolved = segment.rate, MIN_RESOLVED_STEPS * np.sqrt(12.0) * float(segment.encoder.max())
    out = np.empty((len(rows), q.shape[1]), bool)
    still = _is_still(q, dq, largest)
    for j, speed in enumerate(np.abs(dq).max(axis=0)):
        travel = STANDSTILL_SPEED_RATIO * float(speed) * MIN_STANDSTILL
        standstill = shortest if travel > resolved else MIN_STANDSTILL_COARSE
        # a standstill may go on from the end of a period to its beginning
        turns = 2 if segment.periodic else 1
        moving = _moving(
            np.tile(q[:, j], turns),
            np.tile(still[:, j], turns),
            int(standstill * rate),
            int(reach * rate),
        )
        out[:, j] = moving.reshape(turns, -1)[:, rows].all(axis=0)
    return out


def far_from_rest(
    q: FloatArray, dq: FloatArray, rows: IntArray, largest: LargestMotion, reach: int
) -> BoolArray:
    """Return the rows at which a joint neither stands still nor reverses within some samples.

    Args:
        q: Low-passed positions. Shape (M, n) [rad or m].
        dq: Low-passed velocities. Shape (M, n) [rad/s or m/s].
        rows: Sample of each row. Shape (N,).
        largest: Largest motion of the joints in all segments.
        reach: Number of samples before and after a row.

    Returns:
        Shape (N, n).
    """
    at_rest = _is_still(q, dq, largest)
    at_rest[1:] |= np.sign(dq[1:]) != np.sign(dq[:-1])
    out = np.empty((len(rows), dq.shape[1]), bool)
    for j, column in enumerate(at_rest.T):
        places = np.flatnonzero(column)
        first, last = (np.searchsorted(places, rows + shift) for shift in (-reach, reach + 1))
        out[:, j] = first == last
    return out


def _is_still(q: FloatArray, dq: FloatArray, largest: LargestMotion) -> BoolArray:
    """Samples at which each joint stands still. Shape (M, n)."""
    is_slow = np.abs(dq) < STANDSTILL_SPEED_RATIO * np.abs(dq).max(axis=0)
    return np.asarray(is_slow | largest.held(q, dq))


def _moving(q: FloatArray, still: BoolArray, standstill: int, reach: int) -> BoolArray:
    """Samples at which a joint moves: neither at standstill nor still close to where it stood.

    Args:
        q: Joint position, shape (M,).
        still: Samples at which the joint stands still, shape (M,).
        standstill: Number of samples from which a standstill counts.
        reach: Number of samples before and after a standstill of more than that number which do
            not count either.
    """
    out, breakaway = np.ones(len(q), bool), BREAKAWAY_TRAVEL_RATIO * float(np.ptp(q))
    for start, end in true_runs(still).tolist():
        if end - start <= standstill:
            continue
        around = reach if end - start > reach else 0
        away = np.abs(q[end:] - q[end - 1]) > breakaway
        broken_away = end + int(np.argmax(away)) if away.any() else len(q)
        out[max(start - around, 0) : max(broken_away, end + around)] = False
    return out
