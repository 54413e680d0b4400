"""Values that are refreshed more slowly than rows are written.

A logger that runs faster than the controller writes each position or torque several times. Such a
staircase is no motion: its steps exceed velocity limits, and its values are older than their stamps
by up to one refresh. The first row of each update is the measurement; the rows behind it repeat it.

A joint at rest and a coarse encoder at low speed repeat values, too. They differ from a refresh in
two ways: the value does not change by several resolution steps at once, and the time between
changes depends on the speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import FloatArray, IntArray
from .block import Block
from .encoder_resolution import MIN_CHANGE, smallest_steps
from .missing_values import REQUIRED, SLOW
from .remark import Remark, RemarkKind
from .time_axis import spline_columns

CLEAR_STEPS = 3.0
"""Change between two rows over the resolution from which a joint clearly moves [1]. A coarse
encoder that repeats values at low speed changes by one step, with noise by two."""
MIN_CLEAR_UPDATES = 20
"""Smallest number of intervals between updates from which a refresh rate is estimated."""
MIN_INTERVAL = 2.0
"""Smallest usual interval between updates of held values [rows]."""
MAX_INTERVAL_ERROR = 0.25
"""Deviation of an interval from the usual one that is regular, if it exceeds one row [1]: the
clocks of the logger and of the controller are not locked."""
MIN_REGULAR_SHARE = 0.9
"""Share of regular intervals between clear updates of held values [1]."""
SUBJECTS = {
    "q": "positions",
    "dq": "velocities",
    "tau": "torques",
    "current": "currents",
    "qref": "commanded positions",
    "qlink": "positions on the link's side",
}
"""Quantities, as remarks name them."""


@dataclass(frozen=True)
class Updates:
    """Rows at which a group of columns is refreshed.

    Attributes:
        rows: First row of each update. Shape (M,).
        interval: Mean number of rows between updates [1].
    """

    rows: IntArray
    interval: float


def keep_updates(block: Block) -> tuple[Block, list[Remark]]:
    """Keep one row of each update of positions, torques and currents.

    The slowest of these quantities determines the rows. Other quantities that are held are
    interpolated between their own updates by cubic splines.

    Args:
        block: Rows with increasing times.

    Returns:
        The rows, and a remark; the rows as they are if each holds new values.
    """
    updates = {
        name: found
        for name, value in block.values.items()
        if name not in SLOW and (found := find_updates(value)) is not None
    }
    required = [name for name in REQUIRED if name in updates]
    if not required:
        return block, []
    slowest = max(required, key=lambda name: updates[name].interval)
    rows = updates[slowest].rows
    kept = block.rows(rows)
    values = dict(kept.values)
    for name, found in updates.items():
        if not np.isin(rows, found.rows).all():
            held = block.values[name][found.rows]
            values[name] = spline_columns(block.t[found.rows], held, kept.t)
    step = float(np.median(np.diff(block.t)))
    parts = [
        f"every {updates[name].interval:.3g} rows ({1.0 / (updates[name].interval * step):.3g} Hz)"
        for name in updates
    ]
    subjects = [SUBJECTS.get(name, name) for name in updates]
    others = "".join(f", {s} {p}" for s, p in zip(subjects[1:], parts[1:], strict=True))
    text = (
        f"{subjects[0]} are refreshed {parts[0]}{others}; rows in between repeat them and are "
        "not used"
    )
    return Block(kept.t, values, block.remarks), [Remark(RemarkKind.HELD, text, repaired=True)]


def find_updates(values: FloatArray) -> Updates | None:
    """Find the rows at which columns that are refreshed together hold new values.

    Intervals are judged between updates at which a joint clearly moves. Where no value changes, as
    at standstill, updates are assumed at the same interval.

    Args:
        values: A quantity of all joints. Shape (N, n).

    Returns:
        The updates; None if they are irregular, or as frequent as rows.
    """
    known = np.where(np.isfinite(values), values, np.nan)
    changes = np.nan_to_num(np.abs(np.diff(known, axis=0)))
    changes[changes <= MIN_CHANGE] = 0.0
    is_update = (changes > 0.0).any(axis=1)
    rows = np.flatnonzero(is_update) + 1
    clear = (changes > 0.0) & (changes >= CLEAR_STEPS * smallest_steps(known))
    is_clear = clear.any(axis=1)[is_update]
    intervals = np.diff(rows)[is_clear[1:] & is_clear[:-1]]
    if len(intervals) < MIN_CLEAR_UPDATES:
        return None
    usual = float(np.median(intervals))
    regular = np.abs(intervals - usual) <= max(1.0, MAX_INTERVAL_ERROR * usual)
    if usual < MIN_INTERVAL or regular.mean() < MIN_REGULAR_SHARE:
        return None
    interval = float(intervals[regular].mean())
    return Updates(_with_unchanged_updates(rows, interval, len(values)), interval)


def _with_unchanged_updates(rows: IntArray, interval: float, count: int) -> IntArray:
    """Add updates that change no value: before, between and after those that do.

    Args:
        rows: Rows at which a value changes. Shape (M,).
        interval: Rows between updates [1].
        count: Number of all rows.
    """
    before = int(rows[0] / interval)
    after = int((count - 1 - rows[-1]) / interval)
    parts = np.maximum(np.round(np.diff(rows) / interval), 1.0).astype(int)
    between = np.interp(
        np.arange(parts.sum() + 1), np.concatenate([[0], np.cumsum(parts)]), rows.astype(float)
    )
    places = np.concatenate(
        [
            rows[0] - interval * np.arange(before, 0, -1),
            between,
            rows[-1] + interval * np.arange(1, after + 1),
        ]
    )
    return np.asarray(np.round(places).astype(int))
