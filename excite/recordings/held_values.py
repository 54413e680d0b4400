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
"""Smallest regular interval between updates of held values [rows]: values that change in
consecutive rows are not held."""
MAX_INTERVAL_ERROR = 0.5
"""Deviation of an interval from the usual one, over it, that is regular [1]: an update that arrives
late or early by a quarter of the interval changes two of them."""
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
    updates = {}
    for name, value in block.values.items():
        updated = None if name in SLOW else find_updates(value)
        if updated is not None:
            updates[name] = updated
    required = [name for name in REQUIRED if name in updates]
    if not required:
        return block, []
    # of equal rates, the first: positions are interpolated only where torques are slower
    slowest = max(required, key=lambda name: round(updates[name].interval))
    kept = block.rows(updates[slowest].rows)
    values = dict(kept.values)
    for name, updated in updates.items():
        if not np.isin(updates[slowest].rows, updated.rows).all():
            held = block.values[name][updated.rows]
            values[name] = spline_columns(block.t[updated.rows], held, kept.t)
    step = float(np.median(np.diff(block.t)))
    return Block(kept.t, values, block.remarks), [_remark(updates, step)]


def _remark(updates: dict[str, Updates], step: float) -> Remark:
    """State the refresh rate of each quantity that is held, with the time between rows [s]."""
    rates = [
        f"every {updated.interval:.3g} rows ({1.0 / (updated.interval * step):.3g} Hz)"
        for updated in updates.values()
    ]
    subjects = [SUBJECTS.get(name, name) for name in updates]
    first, *others = [f"{subject} {rate}" for subject, rate in zip(subjects, rates, strict=True)]
    text = ", ".join([first.replace(" every", " are refreshed every"), *others])
    text += "; rows in between repeat them and are not used"
    return Remark(RemarkKind.HELD, text, repaired=True)


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
    is_clear = np.asarray(clear.any(axis=1))[is_update]
    intervals = np.diff(rows)[is_clear[1:] & is_clear[:-1]]
    if len(intervals) < MIN_CLEAR_UPDATES:
        return None
    usual = float(np.median(intervals))
    regular = np.asarray(np.abs(intervals - usual) <= MAX_INTERVAL_ERROR * usual)
    regular &= intervals >= MIN_INTERVAL
    if regular.mean() < MIN_REGULAR_SHARE:
        return None
    interval = float(intervals[regular].mean())
    longest = (1.0 + MAX_INTERVAL_ERROR) * usual
    return Updates(_with_unchanged_updates(rows, interval, longest, len(values)), interval)


def _with_unchanged_updates(
    rows: IntArray, interval: float, longest: float, count: int
) -> IntArray:
    """Add updates that change no value: before, between and after those that do.

    Args:
        rows: Rows at which a value changes. Shape (M,).
        interval: Rows between updates [1].
        longest: Largest number of rows between consecutive updates [1].
        count: Number of all rows.
    """
    before = int(rows[0] / interval)
    after = int((count - 1 - rows[-1]) / interval)
    between = np.diff(rows)
    parts = np.where(between > longest, np.round(between / interval), 1.0).astype(int)
    numbers = np.concatenate([[0], np.cumsum(parts)])
    places = np.concatenate(
        [
            rows[0] - interval * np.arange(before, 0, -1),
            np.interp(np.arange(numbers[-1] + 1), numbers, rows),
            rows[-1] + interval * np.arange(1, after + 1),
        ]
    )
    return np.asarray(np.round(places).astype(int))
