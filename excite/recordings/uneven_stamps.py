"""Uneven stamps of rows that were measured at even times.

A driver reads its joints at a fixed rate, and the stamps are written later: at publication, or at
the reception of a message. Interpolating positions at such stamps adds the error q̇ δ, δ the error
of a stamp. The positions tell which times are right: a motion is smooth in time, so its third
differences on an even grid are smallest with the true times.
"""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from .block import Block
from .remark import Remark, RemarkKind
from .time_axis import STEP_TOLERANCE, TimeGrid, gap_free_slices, row_numbers

MAX_ROUGHNESS_RATIO = 0.5
"""Mean squared third difference with even times over that with the stamps, below which the stamps
are taken to be wrong [1]. Where noise of the positions dominates both, the ratio is 1; true stamps
give 10 and more."""
MIN_RUN_ROWS = 8
"""Smallest number of rows of a gap-free run that is judged."""


def correct_uneven_stamps(block: Block, grid: TimeGrid) -> tuple[Block, list[Remark]]:
    """Move uneven stamps to the nearest times of an even grid if the positions are smoother there.

    Args:
        block: Rows with increasing times and finite positions.
        grid: The grid; each gap-free run of rows has its own offset from it.

    Returns:
        The rows with even times, and a remark; the rows as they are if their stamps fit better.
    """
    runs = [run for run in gap_free_slices(block.t, grid.step) if run.stop - run.start > 1]
    steps = np.concatenate([np.diff(block.t[run]) for run in runs] or [np.empty(0)])
    if not (np.abs(steps / grid.step - 1.0) > STEP_TOLERANCE).any():
        return block, []
    t = block.t.copy()
    by_stamp, by_grid = np.zeros(block.values["q"].shape[1]), np.zeros(block.values["q"].shape[1])
    for run in runs:
        if run.stop - run.start < MIN_RUN_ROWS:
            continue
        even = _nearest_even_times(block.t[run], grid.step)
        if even is None:
            return block, []
        t[run] = even
        by_stamp += _roughness(block.t[run], block.values["q"][run], grid.step)
        by_grid += _roughness(even, block.values["q"][run], grid.step)
    # joints that stand still show nothing; the others are weighted alike
    moving = by_stamp > 0.0
    ratio = np.mean(by_grid[moving] / by_stamp[moving]) if moving.any() else np.inf
    if ratio > MAX_ROUGHNESS_RATIO or not (np.diff(t) > 0.0).all():
        return block, []
    error = np.std(block.t - t)
    text = (
        f"time stamps deviate by {1e3 * error:.2g} ms (rms) from an even grid of "
        f"{grid.step:.6g} s, but the positions were measured at even times, which are used"
    )
    remark = Remark(RemarkKind.TIMESTAMP_JITTER, text, repaired=True)
    return Block(t, block.values, block.remarks), [remark]


def _nearest_even_times(t: FloatArray, step: float) -> FloatArray | None:
    """Times of an even grid that are nearest to the stamps; None if they lie on no such grid."""
    numbers = row_numbers(t, step)
    if numbers is None:
        return None
    line = np.polyfit(numbers, t - t[0], 1)
    return np.asarray(np.polyval(line, numbers) + t[0])


def _roughness(t: FloatArray, q: FloatArray, step: float) -> FloatArray:
    """Sum of squared third differences on an even grid. Shape (n,)."""
    from scipy.interpolate import CubicSpline  # slow to import

    count = int((t[-1] - t[0]) / step + 1e-6) + 1
    even = np.asarray(CubicSpline(t, q, axis=0)(t[0] + step * np.arange(count)))
    return np.asarray(np.sum(np.diff(even, 3, axis=0) ** 2, axis=0))
