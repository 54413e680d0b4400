"""Positions and torques in different rows, as in a table that merges messages of several topics.

PlotJuggler and scripts that join topics by their stamps write a row for each message, in which the
columns of all other topics are empty.
"""

from __future__ import annotations

import numpy as np

from .._types import BoolArray, FloatArray
from ..robot.robot import Robot
from .block import QUANTITIES, Block
from .held_values import SUBJECTS
from .missing_values import SLOW
from .position_wraps import unwrap_steps
from .remark import Remark, RemarkKind
from .time_axis import MAX_FILLED_STEPS
from .unsigned_values import POSITIONS

MAX_SHARED = 0.5
"""Share of the values of a column in rows with a position below which the column belongs to other
rows [1]: messages of several topics have a common stamp by chance alone."""


def join_rows(block: Block, robot: Robot) -> tuple[Block, list[Remark]]:
    """Interpolate quantities that are never in one row with the positions at the times of these.

    The rows are those of the joint with the most positions. Values are interpolated over their own
    stamps by piecewise cubics that keep between two neighbours (Fritsch and Carlson 1980), since
    two messages may arrive at nearly the same time, and a glitch must stay one; there is none in
    gaps of more than five mean steps.

    Args:
        block: Rows as they were read.
        robot: Robot whose joints are recorded.

    Returns:
        The rows with a position, and a remark; the rows as they are if they hold all quantities.
    """
    known = {name: np.isfinite(value) for name, value in block.values.items()}
    has_time = np.isfinite(block.t)
    counts = (known["q"] & has_time[:, None]).sum(axis=0)
    reference = known["q"][:, int(np.argmax(counts))] & has_time
    apart = {name: _is_apart(rows & has_time[:, None], reference) for name, rows in known.items()}
    names = [name for name in QUANTITIES if name not in SLOW and name in apart]
    moved = [name for name in names if apart[name].any()]
    if not moved or not set(block.values) <= set(QUANTITIES):
        return block, []
    times = block.t[reference]
    values = {}
    for name, value in block.values.items():
        values[name] = value[reference].copy()
        for i in np.flatnonzero(apart[name]):
            measured = known[name][:, i] & has_time
            is_angle = name in POSITIONS and robot.entries[i].kind != "prismatic"
            values[name][:, i] = interpolate_signal(
                block.t[measured], value[measured, i], times, is_angle=is_angle
            )
    if "q" in moved:
        text = (
            "signals of the joints are in different rows, as messages of several topics are; they "
            "are interpolated at the times of one joint's positions"
        )
    else:
        subjects = " and ".join(SUBJECTS[name] for name in moved)
        text = (
            f"positions and {subjects} are in different rows, as messages of several topics are; "
            f"{subjects} are interpolated at the times of the positions"
        )
    remark = Remark(RemarkKind.MISSING, text, repaired=True)
    return Block(times, values, block.remarks, row=block.row, locked=block.locked), [remark]


def _is_apart(rows: BoolArray, reference: BoolArray) -> BoolArray:
    """Return which columns have most of their values in other rows than a reference. Shape (n,)."""
    count = rows.sum(axis=0)
    shared = (rows & reference[:, None]).sum(axis=0)
    return np.asarray((count > 1) & (shared < MAX_SHARED * np.minimum(count, reference.sum())))


def interpolate_signal(
    t: FloatArray, values: FloatArray, times: FloatArray, *, is_angle: bool
) -> FloatArray:
    """Interpolate a column; NaN outside its stamps and in its gaps. Shape (M,).

    Args:
        t: Stamps. Shape (N,) [s].
        values: Values. Shape (N,).
        times: Times at which values are wanted. Shape (M,) [s].
        is_angle: True for a position of a revolute joint, which may be wrapped.
    """
    stamps, first = np.unique(t, return_index=True)
    if len(stamps) < 2:
        return np.full(len(times), np.nan)
    from scipy.interpolate import PchipInterpolator  # slow to import

    known = values[first]
    smooth = unwrap_steps(known)[0] if is_angle else known
    # wrapped again like the value before: `position_wraps` judges and remarks the steps
    latest = np.clip(np.searchsorted(stamps, times, side="right") - 1, 0, None)
    out = np.asarray(PchipInterpolator(stamps, smooth)(times)) + (known - smooth)[latest]
    behind = np.clip(np.searchsorted(stamps, times), 1, len(stamps) - 1)
    steps = np.diff(stamps)
    is_gap = steps[behind - 1] > (MAX_FILLED_STEPS + 0.5) * np.mean(steps)
    out[is_gap | (times < stamps[0]) | (times > stamps[-1])] = np.nan
    return out
