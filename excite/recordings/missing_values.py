"""Missing values: short runs are interpolated, longer ones left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..errors import UnusableInput
from ..robot.parameter_names import plural
from .block import QUANTITIES, Block
from .column_names import column_of
from .remark import Remark, RemarkKind

MAX_INTERPOLATED_ROWS = 5
"""Longest run of missing values that is interpolated."""
MAX_MISSING_SHARE = 0.5
"""Largest share of missing values of a joint's position, torque or current [1]."""
REQUIRED = ("q", "tau", "current")
"""Quantities without which a row is of no use."""
SLOW = ("temperature",)
"""Quantities that change little between sparse samples."""


def fill_missing(source: str, joints: Sequence[str], block: Block) -> tuple[Block, list[Remark]]:
    """Interpolate short runs of missing values in time and drop rows that are of no use.

    A run of more than MAX_INTERPOLATED_ROWS rows without q, tau or current is dropped, which leaves
    a gap; in other quantities it stays without values, except in slow ones, which are interpolated.
    A column without any value means that the joint lacks the quantity. ±inf counts as missing.

    Args:
        source: Name of the recording, for messages.
        joints: Names of the joints.
        block: Rows as they were read.

    Raises:
        UnusableInput: A joint has no position, or more than half of its positions, torques or
            currents are missing.
    """
    remarks: list[Remark] = []
    values = dict(block.values)
    keep = np.ones(len(block), bool)
    for name, value in block.values.items():
        missing = ~np.isfinite(value)
        if not missing.any():
            continue
        values[name] = value.copy()
        for i in np.flatnonzero(missing.any(axis=0)).tolist():
            is_signal = name not in QUANTITIES
            joint = column_of(name, i, joints) if is_signal else joints[i]
            share = float(missing[:, i].mean())
            too_many = share > MAX_MISSING_SHARE
            if too_many and is_signal:
                raise UnusableInput(
                    f"{source}: column '{joint}': {100 * share:.0f} % are no numbers; record them"
                )
            if too_many and (name == "q" or (name in REQUIRED and share < 1.0)):
                raise UnusableInput(
                    f"{source}: joint '{joint}': {100 * share:.0f} % of {name} are no numbers; "
                    "record them, or leave it out with --joints"
                )
            known = ~missing[:, i]
            if not known.any():
                values[name][:, i] = np.nan
                continue
            if name in SLOW:
                values[name][:, i] = np.interp(block.t, block.t[known], value[known, i])
                continue
            column, is_long = _interpolated(block.t, values[name][:, i], missing[:, i])
            values[name][:, i] = column
            if name in REQUIRED or is_signal:
                keep &= ~is_long
            remarks.append(_remark(name, joint, block.t, missing[:, i], is_long))
    filled = Block(block.t, values, block.remarks)
    return (filled if keep.all() else filled.rows(keep)), remarks


def true_runs(flags: BoolArray) -> IntArray:
    """Return the first index and the end (exclusive) of each run of True. Shape (runs, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2)


def _interpolated(
    t: FloatArray, column: FloatArray, missing: BoolArray
) -> tuple[FloatArray, BoolArray]:
    """Interpolate the short inner runs of a column.

    Returns:
        The column, NaN in longer runs and in runs at its ends, and a mask of these. Shape (N,).
    """
    is_long = np.zeros(len(t), bool)
    for start, end in true_runs(missing):
        if end - start > MAX_INTERPOLATED_ROWS or start == 0 or end == len(t):
            is_long[start:end] = True
    is_short = missing & ~is_long
    out = np.where(is_long, np.nan, column)
    out[is_short] = np.interp(t[is_short], t[~missing], column[~missing])
    return out, is_long


def _remark(name: str, joint: str, t: FloatArray, missing: BoolArray, is_long: BoolArray) -> Remark:
    is_signal = name not in QUANTITIES
    subject = "" if is_signal else f"joint '{joint}': "
    count = plural(int(missing.sum()), "missing value")
    text = f"{subject}{count} of {joint if is_signal else name}"
    interpolated = int((missing & ~is_long).sum())
    if interpolated:
        text += f", {interpolated} interpolated"
    if is_long.any():
        outcome = "dropped with their rows" if name in REQUIRED or is_signal else "left out"
        text += f", {int(is_long.sum())} in longer runs {outcome}"
    first, last = np.flatnonzero(missing)[[0, -1]]
    place = None if is_signal else joint
    return Remark(RemarkKind.MISSING, text, place, float(t[first]), float(t[last]), repaired=True)
