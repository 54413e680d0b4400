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
MIN_RESOLVED_STEPS = 50.0
"""Encoder steps that a joint should be able to travel within `MIN_STANDSTILL`; below, the encoder
counts as coarse."""


def moving_rows(
    segment: RecordingSegment,
    q: FloatArray,
    dq: FloatArray,
    rows: IntArray,
    shortest: float = MIN_STANDSTILL,
) -> BoolArray:
    """Return the rows at which each joint moves.

    Args:
        segment: The segment of a recording.
        q: Its low-passed positions. Shape (M, n) [rad or m].
        dq: Its low-passed velocities. Shape (M, n) [rad/s or m/s].
        rows: Sample of each row. Shape (N,).
        shortest: Duration from which a standstill counts, unless the encoder is coarse [s].

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
        moving = _moving(np.tile(q[:, j], turns), np.tile(speed, turns), rate, standstill)
        out[:, j] = moving.reshape(turns, -1)[:, rows].all(axis=0)
    return out


def _moving(q: FloatArray, dq: FloatArray, rate: float, standstill: float) -> BoolArray:
    """Samples at which a joint moves: neither at standstill nor still close to where it stood.

    Args:
        q: Joint position, shape (M,).
        dq: Joint velocity, shape (M,).
        rate: Sample rate [Hz].
        standstill: Duration from which a standstill counts [s].
    """
    out, breakaway = np.ones(len(q), bool), BREAKAWAY_TRAVEL_RATIO * float(np.ptp(q))
    still = np.abs(dq) < STANDSTILL_SPEED_RATIO * np.abs(dq).max()
    for start, end in true_runs(still).tolist():
        if end - start > standstill * rate:
            away = np.abs(q[end:] - q[end - 1]) > breakaway
            out[start : end + int(np.argmax(away)) if away.any() else len(q)] = False
    return out
