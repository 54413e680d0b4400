"""Standstill of joints: friction at rest takes any value up to the breakaway torque."""

from __future__ import annotations

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..recordings.missing_values import true_runs
from .segments import RecordingSegment

STANDSTILL_SPEED_RATIO = 0.01
"""Speed below which a joint stands still, over its largest speed."""
BREAKAWAY_TRAVEL_RATIO = 0.02
"""Travel after a standstill until friction is no longer static, over the joint's range."""
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


def moving_rows(
    segment: RecordingSegment,
    q: FloatArray,
    dq: FloatArray,
    rows: IntArray,
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
        shortest: Duration from which a standstill counts, unless the encoder is coarse [s].
        reach: Time before and after a standstill of more than this time at which the rows do not
            count either [s].

    Returns:
        Shape (N, n).
    """
    rate, resolved = segment.rate, MIN_RESOLVED_STEPS * np.sqrt(12.0) * float(segment.encoder.max())
    out = np.empty((len(rows), q.shape[1]), bool)
    for j, speed in enumerate(dq.T):
        travel = STANDSTILL_SPEED_RATIO * float(np.abs(speed).max()) * MIN_STANDSTILL
        standstill = shortest if travel > resolved else MIN_STANDSTILL_COARSE
        # a standstill may go on from the end of a period to its beginning
        turns = 2 if segment.periodic else 1
        moving = _moving(
            np.tile(q[:, j], turns),
            np.tile(speed, turns),
            int(standstill * rate),
            int(reach * rate),
        )
        out[:, j] = moving.reshape(turns, -1)[:, rows].all(axis=0)
    return out


def far_from_rest(dq: FloatArray, rows: IntArray, reach: int) -> BoolArray:
    """Return the rows at which a joint neither stands still nor reverses within some samples.

    Args:
        dq: Low-passed velocities. Shape (M, n) [rad/s or m/s].
        rows: Sample of each row. Shape (N,).
        reach: Number of samples before and after a row.

    Returns:
        Shape (N, n).
    """
    at_rest = _is_still(dq)
    at_rest[1:] |= np.sign(dq[1:]) != np.sign(dq[:-1])
    out = np.empty((len(rows), dq.shape[1]), bool)
    for j, column in enumerate(at_rest.T):
        places = np.flatnonzero(column)
        first, last = (np.searchsorted(places, rows + shift) for shift in (-reach, reach + 1))
        out[:, j] = first == last
    return out


def _is_still(dq: FloatArray) -> BoolArray:
    """Samples at which each joint stands still, shape (M, …)."""
    return np.asarray(np.abs(dq) < STANDSTILL_SPEED_RATIO * np.abs(dq).max(axis=0))


def _moving(q: FloatArray, dq: FloatArray, standstill: int, reach: int) -> BoolArray:
    """Samples at which a joint moves: neither at standstill nor still close to where it stood.

    Args:
        q: Joint position, shape (M,).
        dq: Joint velocity, shape (M,).
        standstill: Number of samples from which a standstill counts.
        reach: Number of samples before and after a standstill of more than that number which do
            not count either.
    """
    out, breakaway = np.ones(len(q), bool), BREAKAWAY_TRAVEL_RATIO * float(np.ptp(q))
    for start, end in true_runs(_is_still(dq)).tolist():
        if end - start <= standstill:
            continue
        around = reach if end - start > reach else 0
        away = np.abs(q[end:] - q[end - 1]) > breakaway
        broken_away = end + int(np.argmax(away)) if away.any() else len(q)
        out[max(start - around, 0) : max(broken_away, end + around)] = False
    return out
