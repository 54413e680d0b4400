"""The time axis: its unit, order, repeats, jitter and gaps."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..errors import UnusableInput
from .block import Block
from .remark import Kind, Remark

Array = np.ndarray
EVEN = 0.02
"""Steps that deviate less than this share from the usual one count as even."""
GAP = 5
"""Time that more than so many usual steps leave out is a gap; fewer are interpolated."""
SLOWEST = 0.5
"""Longest plausible step of a recording [s]: 2 rows a second."""
FASTEST = 1e-6
"""Shortest plausible step of a recording [s]: a million rows a second."""
BACK = 50
"""Rows may be late by so many usual steps; a longer way back is a clock that starts again."""
CLOSE = 0.2
"""Share of the step below which two times are too close for interpolation."""
MOST_BAD = 0.1
MOST_REPEATED = 0.2
MOST_GAPS = 0.01


@dataclass(frozen=True)
class Clock:
    """The even grid t = origin + k step [s] that a recording's rows are put on."""

    step: float
    origin: float


def order(source: str, block: Block) -> tuple[Block, list[Remark]]:
    """Rows with a time, in order, each time once.

    Rows whose time is no number are dropped (an error above 10 %). Late rows are sorted in; an
    error where a few rows go back by more than 50 steps, as where a clock starts again. Rows that
    repeat a time with the same positions are dropped; with others too, the first is kept, an error
    above 20 % (a clock too coarse for the rate).
    """
    remarks = []
    known = np.isfinite(block.t)
    if not known.all():
        lost = int((~known).sum())
        if lost > MOST_BAD * len(known):
            raise UnusableInput(
                f"{source}: {lost} of {len(known)} rows have no time; record it with every row"
            )
        block = block.rows(known)
        remarks.append(Remark(Kind.CLOCK, f"{lost} rows without a time are dropped", repaired=True))
    steps = np.diff(block.t)
    late = np.flatnonzero(steps < 0.0)
    if len(late):
        usual = float(np.median(np.abs(steps)))
        worst = late[np.argmin(steps[late])]
        if -steps[worst] > BACK * usual and len(late) <= max(1, len(steps) // 100):
            raise UnusableInput(
                f"{source}: time goes back from {block.t[worst]:.6g} to {block.t[worst + 1]:.6g} "
                "s; "
                "are these two recordings? Give each its own file"
            )
        start, end = float(block.t[late[0]]), float(block.t[late[-1]])
        block = block.rows(np.argsort(block.t, kind="stable"))
        remarks.append(
            Remark(
                Kind.ORDER,
                f"{len(late)} rows out of order are sorted by time",
                start=start,
                end=end,
                repaired=True,
            )
        )
    again = np.flatnonzero(np.diff(block.t) == 0.0) + 1
    if len(again):
        q = block.values["q"]
        differing = int((q[again] != q[again - 1]).any(axis=1).sum())
        if differing > MOST_REPEATED * len(q):
            raise UnusableInput(
                f"{source}: {differing} of {len(q)} rows repeat the time of the row before with "
                "other positions; "
                "log the time with more digits"
            )
        where = float(block.t[again[0]])
        block = block.rows(np.setdiff1d(np.arange(len(q)), again, assume_unique=True))
        text = (
            f"{len(again)} rows that repeat a time are dropped ({differing} with other positions)"
        )
        remarks.append(Remark(Kind.REPEATED, text, start=where, end=where, repaired=True))
    return block, remarks


def measure(source: str, t: Array) -> Clock:
    """The usual step of increasing times: the median, then the mean over the rows without gaps.

    A median step above 0.5 s is no rate of a robot: an error that says by what the time should be
    divided. So is one below 1 µs, and a clock of which more than 1 % of the steps are gaps, as
    where stamps come in bunches.
    """
    steps = np.diff(t)
    if not len(steps):
        raise UnusableInput(f"{source}: has {len(t)} rows with a time of their own; record more")
    usual = float(np.median(steps))
    if usual > SLOWEST:
        unit, factor = next(
            (u, f)
            for u, f, most in (("ms", 1e3, 2e2), ("µs", 1e6, 2e5), ("ns", 1e9, np.inf))
            if usual <= most
        )
        raise UnusableInput(
            f"{source}: the usual time step is {usual:g}; is time in {unit}? Divide it by "
            f"{factor:g}, seconds are needed"
        )
    if usual < FASTEST:
        raise UnusableInput(
            f"{source}: the usual time step is {usual:g} s, more than a million rows a second; is "
            "time in another unit? Seconds are needed"
        )
    short = steps <= (GAP + 0.5) * usual
    if (~short).sum() > max(MOST_GAPS * len(steps), 3):
        raise UnusableInput(
            f"{source}: {int((~short).sum())} of {len(steps)} time steps are longer than {GAP} "
            f"usual ones ({usual:.3g} s); "
            "use the time of measurement, not of arrival"
        )
    counted = np.maximum(np.round(steps[short] / usual), 0.0).sum()
    return Clock(float(steps[short].sum() / counted), float(t[0]))


def pieces(t: Array, step: float) -> list[slice]:
    """Runs of rows between gaps: no step in them is longer than 5 usual ones."""
    cuts = np.flatnonzero(np.diff(t) > (GAP + 0.5) * step) + 1
    bounds = [0, *cuts.tolist(), len(t)]
    return [slice(a, b) for a, b in pairwise(bounds)]


def even(block: Block, clock: Clock) -> tuple[Block, list[Remark]]:
    """Rows on the clock's grid, piece by piece; gaps stay.

    Where no step within a piece deviates by more than 2 % the rows are kept as they are. Else all
    are interpolated by cubic splines, which also fills up to 5 missing rows. Beforehand rows closer
    than a fifth of a step to the one before are dropped: the slope between such is noise, and a
    spline would follow it. A piece of one row is dropped.
    """
    runs = pieces(block.t, clock.step)
    remarks = _gaps(block.t, runs)
    steps = np.concatenate([np.diff(block.t[run]) for run in runs])
    uneven = np.flatnonzero(np.abs(steps / clock.step - 1.0) > EVEN)
    if not len(uneven):
        return block, remarks
    lost = int(np.round(steps.sum() / clock.step)) - len(steps)
    text = f"time steps from {steps.min():.4g} to {steps.max():.4g} s are put on an even grid of {clock.step:.6g} s by interpolation"  # noqa: E501
    where = block.t[:-1][np.diff(block.t) <= (GAP + 0.5) * clock.step][uneven[[0, -1]]]
    text += f"; {lost} missing rows are filled" if lost > 0 else ""
    remarks.append(
        Remark(Kind.JITTER, text, start=float(where[0]), end=float(where[1]), repaired=True)
    )
    filled = [_on_grid(block.rows(run), clock) for run in runs if run.stop - run.start > 1]
    t = np.concatenate([part.t for part in filled])
    values = {name: np.concatenate([part.values[name] for part in filled]) for name in block.values}
    return Block(t, values, block.remarks), remarks


def _gaps(t: Array, runs: list[slice]) -> list[Remark]:
    if len(runs) == 1:
        return []
    starts, ends = t[[run.stop - 1 for run in runs[:-1]]], t[[run.start for run in runs[1:]]]
    longest = int(np.argmax(ends - starts))
    number = "1 gap" if len(starts) == 1 else f"{len(starts)} gaps"
    text = f"{number} of more than {GAP} rows, the longest {ends[longest] - starts[longest]:.4g} s, split the recording"  # noqa: E501
    return [
        Remark(
            Kind.GAP, text, start=float(starts[longest]), end=float(ends[longest]), repaired=True
        )
    ]


def _on_grid(block: Block, clock: Clock) -> Block:
    from scipy.interpolate import CubicSpline  # slow to import

    block = block.rows(np.diff(block.t, prepend=-np.inf) >= CLOSE * clock.step)
    first = np.ceil((block.t[0] - clock.origin) / clock.step - 1e-6)
    last = np.floor((block.t[-1] - clock.origin) / clock.step + 1e-6)
    t = clock.origin + clock.step * np.arange(first, last + 1)
    inside = np.clip(t, block.t[0], block.t[-1])
    values = {}
    for name, value in block.values.items():
        out = np.full((len(t), value.shape[1]), np.nan)
        for i, column in enumerate(value.T):
            there = np.isfinite(column)
            if there.sum() < 2:
                continue
            out[:, i] = CubicSpline(block.t[there], column[there], bc_type="natural")(inside)
            if not there.all():  # a longer lack stays one
                out[np.interp(inside, block.t, there.astype(float)) < 1.0, i] = np.nan
        values[name] = out
    return Block(t, values, block.remarks)
