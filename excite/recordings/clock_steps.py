"""Backward steps of the clock: NTP corrections of a logger in the middle of a recording.

Sorting the rows by their stamps would interleave two stretches of the motion. Rows that are merely
logged late become smooth when they are sorted; rows after a clock step are smooth in the order of
the file and zigzag when they are sorted.
"""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from .block import Block
from .remark import Remark, RemarkKind, shown_time
from .time_axis import MAX_DELAYED_STEPS, MAX_FILLED_STEPS

MIN_STEPPED_ROWS = 3
"""Rows after a backward step that lie before the latest stamp, at least: fewer are late rows."""
MAX_VARIATION_RATIO = 0.5
"""Total variation of the positions in the order of the file over that in the order of the stamps
below which a backward step is one of the clock [1]. Interleaving two smooth stretches adds at least
their distance per row; sorting late rows lowers the variation, so the ratio is above 1."""


def remove_clock_steps(block: Block) -> tuple[Block, list[Remark]]:
    """Undo backward steps of the clock, and cut the recording there.

    The rows after a step are shifted so that time goes on by one usual step. As that is only known
    to within a step, MAX_FILLED_STEPS + 1 rows are left out, which leaves a gap that no filter
    crosses.

    Args:
        block: Rows in the order of the file.
    """
    steps = np.diff(block.t)
    backward = np.flatnonzero(steps < 0.0)
    if not len(backward):
        return block, []
    usual = float(np.nanmedian(np.abs(steps)))
    t, keep = block.t.copy(), np.ones(len(block), bool)
    remarks: list[Remark] = []
    for last in backward.tolist():
        back = float(t[last] - t[last + 1])
        if back <= 0.0 or not _is_clock_step(t, block.values["q"], last, usual):
            continue
        t[last + 1 :] += back + usual
        keep[last + 1 : last + 2 + MAX_FILLED_STEPS] = False
        text = (
            f"the clock steps back by {back + usual:.3g} s at {shown_time(block.t[last])} s; later "
            "rows are shifted by that, and the recording is cut there"
        )
        start, end = float(block.t[last + 1]), float(block.t[last])
        remarks.append(Remark(RemarkKind.CLOCK_STEP, text, start=start, end=end, repaired=True))
    if not remarks:
        return block, []
    return Block(t, block.values, block.remarks).rows(keep), remarks


def _is_clock_step(t: FloatArray, q: FloatArray, last: int, usual: float) -> bool:
    """Return True if rows around a backward step are smooth in the order of the file alone.

    Args:
        t: Stamps in the order of the file. Shape (N,) [s].
        q: Positions. Shape (N, n) [rad or m].
        last: Index of the row before the step.
        usual: Usual time step [s].
    """
    if t[last + 1] < np.nanmin(t[: last + 1]) + MAX_DELAYED_STEPS * usual:
        return False  # the log starts again
    reach = 2 * int((t[last] - t[last + 1]) / usual) + 2
    first, end = max(0, last + 1 - reach), min(len(t), last + 1 + reach)
    rows = np.arange(first, end)
    rows = rows[(t[first:end] >= t[last + 1]) & (t[first:end] <= t[last])]
    if np.sum(rows > last) < MIN_STEPPED_ROWS:
        return False
    positions = q[rows]
    in_file = np.nansum(np.abs(np.diff(positions, axis=0)))
    by_stamp = np.nansum(np.abs(np.diff(positions[np.argsort(t[rows], kind="stable")], axis=0)))
    return bool(in_file < MAX_VARIATION_RATIO * by_stamp)
