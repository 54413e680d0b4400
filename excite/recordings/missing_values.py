"""Cells that are no number."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import UnusableInput
from .block import Block
from .remark import Kind, Remark

Array = np.ndarray
SHORT = 5
"""Longest run of rows without a number that is interpolated."""
MOST = 0.5
NEEDED, SLOW = ("q", "tau", "current"), ("temperature",)
"""Quantities without which a row is worth nothing; and those that are sampled now and then, and
change little in between."""


def fill(source: str, joints: Sequence[str], block: Block) -> tuple[Block, list[Remark]]:
    """Interpolate runs of up to 5 missing numbers in time; drop rows where q, tau or current lack
    longer, which leaves a gap.

    In the other quantities a longer run stays without numbers, but for what is slow. A column
    without any number is a joint that lacks the quantity. Error where a joint has no position at
    all, or where more than half of its positions, torques or currents are missing. ±inf is no
    number.
    """
    remarks: list[Remark] = []
    values = dict(block.values)
    keep = np.ones(len(block), bool)
    for name, value in block.values.items():
        bad = ~np.isfinite(value)
        if not bad.any():
            continue
        values[name] = value.copy()
        for i in np.flatnonzero(bad.any(axis=0)).tolist():
            joint, share = joints[i], float(bad[:, i].mean())
            if (name == "q" and share > MOST) or (name in NEEDED and MOST < share < 1.0):
                raise UnusableInput(
                    f"{source}: joint '{joint}': {100 * share:.0f} % of {name} are no numbers; "
                    "record them, or leave it out with --joints"
                )
            if share == 1.0:
                values[name][:, i] = np.nan
                continue
            if name in SLOW:
                values[name][:, i] = np.interp(block.t, block.t[~bad[:, i]], value[~bad[:, i], i])
                continue
            column, long = _filled(block.t, values[name][:, i], bad[:, i])
            values[name][:, i] = column
            if name in NEEDED:
                keep &= ~long
            remarks.append(_remark(name, joint, block.t, bad[:, i], long))
    filled = Block(block.t, values, block.remarks)
    return (filled if keep.all() else filled.rows(keep)), remarks


def runs(flags: Array) -> Array:
    """First row and end (exclusive) of each run of True. Shape (runs, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2)


def _filled(t: Array, column: Array, bad: Array) -> tuple[Array, Array]:
    """The column with its short inner runs interpolated, and where long ones are."""
    long = np.zeros(len(t), bool)
    for start, end in runs(bad):
        if end - start > SHORT or start == 0 or end == len(t):
            long[start:end] = True
    short = bad & ~long
    out = np.where(long, np.nan, column)
    out[short] = np.interp(t[short], t[~bad], column[~bad])
    return out, long


def _remark(name: str, joint: str, t: Array, bad: Array, long: Array) -> Remark:
    text = f"joint '{joint}': {int(bad.sum())} missing values of {name}"
    if (bad & ~long).any():
        text += f", {int((bad & ~long).sum())} interpolated"
    if long.any():
        text += f", {int(long.sum())} in longer runs {'dropped with their rows' if name in NEEDED else 'left out'}"  # noqa: E501
    where = np.flatnonzero(bad)[[0, -1]]
    return Remark(Kind.MISSING, text, joint, float(t[where[0]]), float(t[where[1]]), repaired=True)
