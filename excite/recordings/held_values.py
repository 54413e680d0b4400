"""Values that are refreshed more slowly than rows are written.

A logger that runs faster than the controller writes each position or torque several times. Such a
staircase is no motion: its steps exceed velocity limits, and its values are older than their stamps
by up to one refresh. The first row of each update is the measurement; the rows behind it repeat it.

A joint at rest and a coarse encoder at low speed repeat values, too. They differ from a refresh in
two ways: the value does not change by several resolution steps at once, and the time between
changes depends on the speed.

Where updates arrive irregularly, or more often than every second row, complete rows are compared:
all measured signals of all joints at once repeat the row before only if nothing was measured, while
the robot moves. A long repetition is a freeze of the source, whose rows are dropped in any case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from .block import Block
from .encoder_resolution import MIN_CHANGE, smallest_steps
from .missing_values import REQUIRED, SLOW
from .remark import Remark, RemarkKind, shown_time
from .time_axis import MAX_FILLED_STEPS, spline_columns

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
MIN_REPEATED_SHARE = 0.05
"""Share of clear intervals in which complete rows repeat the one before, from which repeated rows
are not used [1]. In the recordings of ten real machines it is at most 0.02."""
MIN_JUMP_SHARE = 0.5
"""Motion at the end of a freeze over the one at the speed before and after it [1]: a robot that
stood still in between continues with the motion of a single row."""
NOT_MEASURED = ("qref", *SLOW)
"""Quantities that do not count in a complete row: commands may be logged at another rate."""
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


def keep_updates(block: Block) -> tuple[Block, list[Remark], FloatArray]:
    """Keep one row of each update of positions, torques and currents.

    The slowest of these quantities determines the rows. Other quantities that are held are
    interpolated between their own updates by cubic splines.

    Args:
        block: Rows with increasing times.

    Returns:
        The rows, remarks, and a time within each freeze whose rows are dropped, shape (F,) [s]; the
        rows as they are if each holds new values.
    """
    updates = {}
    for name, value in block.values.items():
        updated = None if name in SLOW else find_updates(value)
        if updated is not None:
            updates[name] = updated
    required = [name for name in REQUIRED if name in updates]
    if not required:
        return _keep_new_rows(block)
    # of equal rates, the first: positions are interpolated only where torques are slower
    slowest = max(required, key=lambda name: round(updates[name].interval))
    kept = block.rows(updates[slowest].rows)
    values = dict(kept.values)
    for name, updated in updates.items():
        if not np.isin(updates[slowest].rows, updated.rows).all():
            held = block.values[name][updated.rows]
            values[name] = spline_columns(block.t[updated.rows], held, kept.t)
    step = float(np.median(np.diff(block.t)))
    new, remarks, freezes = _keep_new_rows(Block(kept.t, values, block.remarks))
    return new, [_remark(updates, step), *remarks], freezes


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


def _keep_new_rows(block: Block) -> tuple[Block, list[Remark], FloatArray]:
    """Drop complete rows that repeat the one before: all if they are frequent, else freezes.

    A row is complete if it holds torques or currents next to positions.

    Args:
        block: Rows with increasing times.

    Returns:
        As of `keep_updates`.
    """
    if not {"tau", "current"} & set(block.values):
        return block, [], np.empty(0)  # positions alone may be those of a slower tracker
    is_new = np.zeros(max(len(block) - 1, 0), bool)
    for name, value in block.values.items():
        if name not in NOT_MEASURED:
            is_same = (value[:-1] == value[1:]) | (np.isnan(value[:-1]) & np.isnan(value[1:]))
            is_new |= ~is_same.all(axis=1)
    rows = np.flatnonzero(is_new) + 1
    q = block.values["q"]
    steps = np.nan_to_num(np.abs(np.diff(q, axis=0)))
    is_clear = (steps > MIN_CHANGE) & (steps >= CLEAR_STEPS * smallest_steps(q))
    clear = np.asarray(is_clear.any(axis=1))
    intervals, in_motion = np.diff(rows), clear[rows - 1][1:] & clear[rows - 1][:-1]
    if in_motion.sum() < MIN_CLEAR_UPDATES:
        return block, [], np.empty(0)
    # against the median, as `find_grid` judges gaps: the mean contains the freezes
    usual = float(np.median(intervals[in_motion]))
    frozen = np.asarray(in_motion & (intervals > MAX_FILLED_STEPS * usual))
    frozen[frozen] = _jumps(steps, rows, np.flatnonzero(frozen), intervals)
    freezes = [slice(rows[k], rows[k + 1]) for k in np.flatnonzero(frozen)]
    remarks = _freeze_remarks(block.t, freezes)
    times = np.array([block.t[freeze.start : freeze.stop].mean() for freeze in freezes])
    held = intervals[in_motion & ~frozen]
    if (held > 1).mean() < MIN_REPEATED_SHARE:
        keep = np.ones(len(block), bool)
        for freeze in freezes:
            keep[freeze.start + 1 : freeze.stop] = False
        return (block.rows(keep) if freezes else block), remarks, times
    kept = _with_unchanged_updates(rows, float(held.mean()), float(held.max()), len(block), frozen)
    frequency = 1.0 / (float(held.mean()) * float(np.median(np.diff(block.t))))
    text = (
        f"{100.0 * (1.0 - 1.0 / held.mean()):.0f} % of the complete rows repeat the one before "
        f"while the robot moves: new values come every {held.mean():.3g} rows on average "
        f"({frequency:.3g} Hz); repeated rows are not used"
    )
    return block.rows(kept), [Remark(RemarkKind.REPEATED, text, repaired=True), *remarks], times


def _jumps(steps: FloatArray, rows: IntArray, places: IntArray, intervals: IntArray) -> BoolArray:
    """Return whether the robot went on during intervals without an update. Shape (F,).

    Args:
        steps: |change| of positions from each row to the next. Shape (N − 1, n) [rad or m].
        rows: Rows of updates. Shape (M,).
        places: Indices of the intervals. Shape (F,).
        intervals: Rows between updates. Shape (M − 1,).
    """
    jump, speed = steps[rows[places + 1] - 1], steps[rows[places] - 1]
    if len(places) and places[-1] + 2 < len(rows):
        speed = np.minimum(speed, steps[rows[places + 2] - 1])
    expected = MIN_JUMP_SHARE * intervals[places][:, None] * speed
    return np.asarray(((jump > expected) & (speed > 0.0)).any(axis=1))


def _freeze_remarks(t: FloatArray, freezes: Sequence[slice]) -> list[Remark]:
    """Name the longest of the times in which all signals are frozen while the robot moves."""
    if not freezes:
        return []
    longest = max(freezes, key=lambda rows: int(rows.stop - rows.start))
    start, end = float(t[longest.start]), float(t[longest.stop - 1])
    text = (
        f"all signals of all joints are frozen for {longest.stop - longest.start} rows, from "
        f"{shown_time(start)} to {shown_time(end)} s, while the robot moves"
    )
    text += f", and {len(freezes) - 1} more times" if len(freezes) > 1 else ""
    text += "; these rows are not used"
    return [Remark(RemarkKind.FROZEN, text, start=start, end=end, repaired=True)]


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
    rows: IntArray,
    interval: float,
    longest: float,
    count: int,
    frozen: BoolArray | None = None,
) -> IntArray:
    """Add updates that change no value: before, between and after those that do.

    Args:
        rows: Rows at which a value changes. Shape (M,).
        interval: Rows between updates [1].
        longest: Largest number of rows between consecutive updates [1].
        count: Number of all rows.
        frozen: Intervals without updates. Shape (M − 1,); None: there are none.
    """
    before = int(rows[0] / interval)
    after = int((count - 1 - rows[-1]) / interval)
    between = np.diff(rows)
    is_long = between > longest if frozen is None else (between > longest) & ~frozen
    parts = np.where(is_long, np.round(between / interval), 1.0).astype(int)
    numbers = np.concatenate([[0], np.cumsum(parts)])
    places = np.concatenate(
        [
            rows[0] - interval * np.arange(before, 0, -1),
            np.interp(np.arange(numbers[-1] + 1), numbers, rows),
            rows[-1] + interval * np.arange(1, after + 1),
        ]
    )
    return np.unique(np.round(places).astype(int))
