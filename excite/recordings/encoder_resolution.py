"""Encoder resolution, estimated from recorded positions before they are resampled."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray

MIN_CHANGE = 1e-12
"""Change between two rows below which a position counts as unchanged [rad or m]."""
MAX_MULTIPLE = 50.0
"""Largest multiple of the smallest change that is compared with whole multiples [1]; larger ones
show the digits that a file omits."""
MIN_CHANGES = 20
"""Number of changes from which a resolution can be estimated."""
MULTIPLE_TOLERANCE = 0.1
"""Deviation from a whole multiple that is allowed [1]."""
MULTIPLE_SHARE = 0.99
"""Share of the changes that must be whole multiples [1]."""
REPEATED_SHARE = 0.02
"""Share of rows that repeat a position from which the smallest changes are taken as resolution
[1]."""


def quantization_noise(positions: FloatArray) -> FloatArray:
    """Estimate the standard deviation of the quantization error of each joint, resolution/√12.

    Args:
        positions: Positions as they were read. Shape (M, n) [rad or m].

    Returns:
        Standard deviations, 0 where no resolution shows. Shape (n,) [rad or m].
    """
    return smallest_steps(positions) / np.sqrt(12.0)


def smallest_steps(values: FloatArray) -> FloatArray:
    """Estimate the resolution of signals: the common step of their changes, else, where values
    repeat, the smallest change.

    Args:
        values: Signals as they were read. Shape (M, n).

    Returns:
        Steps, 0 where no resolution shows. Shape (n,).
    """
    return np.array([_resolution(_changes(value), len(value)) for value in values.T])


def estimate_resolution(positions: FloatArray) -> FloatArray:
    """Estimate the step of which all changes of a joint's position are whole multiples.

    Args:
        positions: Positions as they were read. Shape (M, n) [rad or m].

    Returns:
        Steps, 0 where changes are no multiples of anything. Shape (n,) [rad or m].
    """
    return np.array([_common_step(_changes(q)) for q in positions.T])


def _changes(q: FloatArray) -> FloatArray:
    changes = np.abs(np.diff(q))
    return np.asarray(changes[changes > MIN_CHANGE])


def _common_step(changes: FloatArray) -> float:
    """Step of which most changes are whole multiples, 0 without one."""
    smallest = float(changes.min(initial=np.inf))
    small = changes[changes < MAX_MULTIPLE * smallest]
    multiple = np.round(small / smallest)
    is_multiple = np.abs(small / smallest - multiple) < MULTIPLE_TOLERANCE
    return (
        float(np.median(small / multiple))
        if len(small) > MIN_CHANGES and np.mean(is_multiple) > MULTIPLE_SHARE
        else 0.0
    )


def _resolution(changes: FloatArray, samples: int) -> float:
    """The common step; without one, the smallest change where positions repeat, else 0."""
    repeats = samples - 1 - len(changes) > REPEATED_SHARE * samples
    smallest = float(np.percentile(changes, 1.0)) if len(changes) and repeats else 0.0
    return _common_step(changes) or smallest
