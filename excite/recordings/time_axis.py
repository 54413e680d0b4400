"""Time axis of a recording: order and repetition of rows, unit, time step, gaps and resampling."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.parameter_names import plural
from .block import Block
from .remark import Remark, RemarkKind, shown_time

STEP_TOLERANCE = 0.02
"""Relative deviation from the usual time step up to which a step counts as even [1]."""
MAX_FILLED_STEPS = 5
"""Number of usual steps above which a step is a gap; fewer missing rows are interpolated."""
MAX_STEP = 0.5
"""Time step from which time is in another unit [s]: 2 rows a second, or 2 kHz in ms."""
MIN_STEP = 1e-6
"""Shortest plausible time step of a recording [s]: a million rows a second."""
UNITS = (("ms", 1e3, 2e2), ("µs", 1e6, 2e5), ("ns", 1e9, np.inf))
"""Units of time other than the second, their number in a second, and the largest plausible step."""
MAX_DELAYED_STEPS = 50
"""Number of usual steps by which a row may be out of order; more is a clock that starts again."""
MIN_SPACING = 0.25
"""Distance of two rows over the time step below which interpolation amplifies noise [1]."""
MAX_UNTIMED_SHARE = 0.1
"""Largest share of rows without a time [1]."""
MAX_REPEATED_SHARE = 0.2
"""Largest share of rows that repeat a time with other positions [1]."""
MAX_GAP_SHARE = 0.01
"""Largest share of steps that are gaps [1]."""
MIN_TOLERATED_GAPS = 3
"""Number of gaps that is tolerated in any recording."""
FIRST_RATE_ROWS = 64
"""Number of rows from which the rate is first estimated."""
MAX_RATE_ERROR = 0.01
"""Error of the rate that is first corrected [1]."""
TRIED_RATES = 17
"""Number of rates that are tried for a number of rows: with the best, the numbers of the first and
the last row err by up to an eighth of a row."""
MIN_COHERENCE = 0.2
"""Smallest |Σ exp(2πi f t)|/N of stamps on an even grid [1]: exp(−2π²σ²) for stamps that err by
σ = 0.29 rows. Where the rate of rows changes it is 0.01, in recordings of real machines at a fixed
rate above 0.6."""
MAX_STAMP_ERROR = 0.5
"""Standard deviation of stamps about an even grid over its step above which the grid is not that of
the rows [1]: they are then nearer to other rows."""
MIN_GRID_ROWS = 20
"""Shortest run without a gap by which a grid is judged [rows]."""
GRID_ROUNDING = 1e-6
"""Distance of a row from the grid that counts as rounding, over the time step [1]."""


@dataclass(frozen=True)
class TimeGrid:
    """Even grid t_k = origin + k · step.

    Attributes:
        step: Time step [s].
        origin: Time of the first row [s].
    """

    step: float
    origin: float


def sort_rows(source: str, block: Block) -> tuple[Block, list[Remark]]:
    """Sort rows by time and remove repeated times.

    Rows without a time are dropped. Of rows with the same time the first is kept.

    Args:
        source: Name of the recording, for messages.
        block: Rows as they were read.

    Raises:
        UnusableInput: More than 10 % of the rows have no time; few rows go back by more than 50
            steps, as where a clock starts again; or more than 20 % of the rows repeat a time with
            other positions, as where a clock is too coarse.
    """
    remarks = []
    has_time = np.isfinite(block.t)
    if not has_time.all():
        untimed = int((~has_time).sum())
        if untimed > MAX_UNTIMED_SHARE * len(has_time):
            raise UnusableInput(
                f"{source}: {untimed} of {len(has_time)} rows have no time; record it with every "
                "row"
            )
        block = block.rows(has_time)
        text = f"{untimed} rows without a time are dropped"
        remarks.append(Remark(RemarkKind.CLOCK, text, repaired=True))
    steps = np.diff(block.t)
    delayed = np.flatnonzero(steps < 0.0)
    if len(delayed):
        usual = float(np.median(np.abs(steps)))
        worst = delayed[np.argmin(steps[delayed])]
        is_restart = -steps[worst] > MAX_DELAYED_STEPS * usual
        if is_restart and len(delayed) <= max(1, len(steps) // 100):
            raise UnusableInput(
                f"{source}: time goes back from {shown_time(block.t[worst])} to "
                f"{shown_time(block.t[worst + 1])} s; are these two recordings? Give each its own "
                "file"
            )
        start, end = float(block.t[delayed[0]]), float(block.t[delayed[-1]])
        block = block.rows(np.argsort(block.t, kind="stable"))
        text = f"{len(delayed)} rows out of order are sorted by time"
        remarks.append(Remark(RemarkKind.ORDER, text, start=start, end=end, repaired=True))
    repeated = np.flatnonzero(np.diff(block.t) == 0.0) + 1
    if len(repeated):
        q = block.values["q"]
        differing = int((q[repeated] != q[repeated - 1]).any(axis=1).sum())
        if differing > MAX_REPEATED_SHARE * len(q):
            raise UnusableInput(
                f"{source}: {differing} of {len(q)} rows repeat the time of the row before with "
                "other positions; log the time with more digits"
            )
        first = float(block.t[repeated[0]])
        block = block.rows(np.setdiff1d(np.arange(len(q)), repeated, assume_unique=True))
        text = f"{len(repeated)} rows that repeat a time are dropped "
        text += f"({differing} with other positions)"
        remarks.append(Remark(RemarkKind.REPEATED, text, start=first, end=first, repaired=True))
    return block, remarks


def find_grid(
    source: str, t: FloatArray, freezes: FloatArray | None = None, *, complete: bool = False
) -> TimeGrid:
    """Estimate the time step: the median, then the mean over the rows without gaps.

    Args:
        source: Name of the recording, for messages.
        t: Increasing times. Shape (N,) [s].
        freezes: Increasing times within gaps that are left by dropped rows, not by the stamps.
            Shape (F,) [s]; None: there are none.
        complete: True if no rows are missing but in gaps, as where repeated rows are dropped: times
            between rows are then uneven by themselves, and their mean is the step, unless the rows
            lie on an even grid: those between them were lost, and the last one was repeated.

    Raises:
        UnusableInput: The median is 0.5 s or longer, which is another unit of time, or shorter than
            1 µs; or more than 1 % of the steps are other gaps, as of stamps of arrival.
    """
    steps = np.diff(t)
    if not len(steps):
        raise UnusableInput(
            f"{source}: has {plural(len(t), 'row')} with distinct times; record more"
        )
    usual = float(np.median(steps))
    if usual >= MAX_STEP:
        unit, factor = next((u, f) for u, f, largest in UNITS if usual <= largest)
        raise UnusableInput(
            f"{source}: the usual time step is {usual:g}; is time in {unit}? Divide it by "
            f"{factor:g}, seconds are needed"
        )
    if usual < MIN_STEP:
        raise UnusableInput(
            f"{source}: the usual time step is {usual:g} s, more than a million rows a second; is "
            "time in another unit? Seconds are needed"
        )
    is_short = steps <= (MAX_FILLED_STEPS + 0.5) * usual
    is_gap = ~is_short
    if freezes is not None:
        is_gap &= np.diff(np.searchsorted(freezes, t)) == 0
    if is_gap.sum() > max(MAX_GAP_SHARE * len(steps), MIN_TOLERATED_GAPS):
        raise UnusableInput(
            f"{source}: {int(is_gap.sum())} of {len(steps)} time steps are longer than "
            f"{MAX_FILLED_STEPS} usual ones ({usual:.3g} s); "
            "use the time of measurement, not of arrival"
        )
    step = mean_step(t)
    if complete:
        mean = float(steps[is_short].mean())
        runs = [run for run in gap_free_slices(t, usual) if run.stop - run.start > MIN_GRID_ROWS]

        def is_even(period: float) -> bool:
            return all(row_numbers(t[run], period) is not None for run in runs)

        step = step if is_even(step) and not is_even(mean) else mean
    return TimeGrid(step, float(t[0]))


def mean_step(t: FloatArray) -> float:
    """Return the mean time step without gaps, missing rows counted by `row_numbers` [s].

    A single difference of two Unix times is rounded to 0.2 µs, a share of 2e-4 of a millisecond.

    Args:
        t: Increasing times. Shape (N,) [s].
    """
    steps = np.diff(t)
    usual = float(np.median(steps))
    short = steps[steps <= (MAX_FILLED_STEPS + 0.5) * usual]
    counts = np.round(short / usual)
    step = float(short.sum() / counts.sum())
    if (counts == 1.0).all():
        return step
    numbers = [row_numbers(t[run], step) for run in gap_free_slices(t, usual)]
    counted = sum(float(number[-1] - number[0]) for number in numbers if number is not None)
    return step if any(number is None for number in numbers) else float(short.sum() / counted)


def row_numbers(t: FloatArray, step: float) -> FloatArray | None:
    """Number rows that were measured at even times, missing rows counted.

    A missing row shifts all later stamps by a whole step; the error of a single stamp does not. The
    number of missing rows before each row is therefore the nondecreasing sequence that fits the
    stamps best (isotonic regression), rounded.

    Args:
        t: Increasing stamps without gaps. Shape (N,) [s].
        step: Time step, to about 1 % [s].

    Returns:
        Numbers of the nearest even times, shape (N,) [1]; None if the stamps lie on no even grid.
    """
    from scipy.optimize import isotonic_regression  # slow to import

    stamps, rows = t - t[0], np.arange(len(t))
    frequency, phase, coherence = _frequency_of_rows(stamps, 1.0 / step)
    turns = frequency * stamps - phase
    numbers = rows + np.round(isotonic_regression(turns - rows).x)
    if coherence < MIN_COHERENCE or np.std(turns - numbers) > MAX_STAMP_ERROR:
        return None
    return np.asarray(numbers, float)


def _frequency_of_rows(stamps: FloatArray, frequency: float) -> tuple[float, float, float]:
    """Find the rate of rows with the largest |Σ exp(2πi f t)|, which missing rows leave as it is.

    Args:
        stamps: Increasing times. Shape (N,) [s].
        frequency: The rate, to about 1 % [Hz].

    Returns:
        The rate f [Hz], the mean phase of f · t [turns], and |Σ exp(2πi f t)|/N [1].
    """
    count = min(FIRST_RATE_ROWS, len(stamps))
    while True:
        # half the width of the main lobe, which narrows with the number of rows
        tried = min(1.0 / count, MAX_RATE_ERROR) * np.linspace(-1.0, 1.0, TRIED_RATES)
        frequencies = frequency * (1.0 + tried)
        sums = [np.exp(2j * np.pi * f * stamps[:count]).sum() for f in frequencies]
        best = int(np.argmax(np.abs(sums)))
        frequency = float(frequencies[best])
        if count == len(stamps):
            mean = complex(sums[best]) / count
            return frequency, float(np.angle(mean)) / (2.0 * np.pi), abs(mean)
        count = min(2 * count, len(stamps))


def gap_free_slices(t: FloatArray, step: float) -> list[slice]:
    """Return the slices of rows between gaps.

    Args:
        t: Increasing times. Shape (N,) [s].
        step: Usual time step [s].
    """
    cuts = np.flatnonzero(np.diff(t) > (MAX_FILLED_STEPS + 0.5) * step) + 1
    bounds = [0, *cuts.tolist(), len(t)]
    return [slice(a, b) for a, b in pairwise(bounds)]


def resample(block: Block, grid: TimeGrid) -> tuple[Block, list[Remark]]:
    """Resample rows on an even grid, separately between gaps.

    Rows are kept as they are if no step between gaps deviates by more than 2 %. Otherwise all are
    interpolated by cubic splines, which also fills up to 5 missing rows. Rows closer than a quarter
    of a step to the row before are dropped first because a spline would follow the noise of their
    slope. A single row between gaps is dropped.

    Args:
        block: Rows with increasing times.
        grid: The grid.
    """
    runs = gap_free_slices(block.t, grid.step)
    remarks = _gap_remarks(block.t, runs)
    steps = np.concatenate([np.diff(block.t[run]) for run in runs])
    uneven = np.flatnonzero(np.abs(steps / grid.step - 1.0) > STEP_TOLERANCE)
    if not len(uneven):
        return block, remarks
    missing = int(np.round(steps.sum() / grid.step)) - len(steps)
    steps_range = f"{steps.min():.4g} to {steps.max():.4g} s"
    text = f"time steps from {steps_range} are resampled on an even grid of {grid.step:.6g} s"
    if missing > 0:
        text += f"; {plural(missing, 'missing row')} {'is' if missing == 1 else 'are'} filled"
    is_short = np.diff(block.t) <= (MAX_FILLED_STEPS + 0.5) * grid.step
    start, end = block.t[:-1][is_short][uneven[[0, -1]]]
    remarks.append(
        Remark(RemarkKind.JITTER, text, start=float(start), end=float(end), repaired=True)
    )
    parts = [_interpolate(block.rows(run), grid) for run in runs if run.stop - run.start > 1]
    t = np.concatenate([part.t for part in parts])
    values = {name: np.concatenate([part.values[name] for part in parts]) for name in block.values}
    return Block(t, values, block.remarks), remarks


def _gap_remarks(t: FloatArray, runs: list[slice]) -> list[Remark]:
    if len(runs) == 1:
        return []
    starts, ends = t[[run.stop - 1 for run in runs[:-1]]], t[[run.start for run in runs[1:]]]
    longest = int(np.argmax(ends - starts))
    number = "1 gap" if len(starts) == 1 else f"{len(starts)} gaps"
    text = (
        f"{number} of more than {MAX_FILLED_STEPS} rows, the longest "
        f"{ends[longest] - starts[longest]:.4g} s, split the recording"
    )
    start, end = float(starts[longest]), float(ends[longest])
    return [Remark(RemarkKind.GAP, text, start=start, end=end, repaired=True)]


def _interpolate(block: Block, grid: TimeGrid) -> Block:
    """Interpolate rows without a gap on the grid by cubic splines."""
    block = block.rows(np.diff(block.t, prepend=-np.inf) >= MIN_SPACING * grid.step)
    first = np.ceil((block.t[0] - grid.origin) / grid.step - GRID_ROUNDING)
    last = np.floor((block.t[-1] - grid.origin) / grid.step + GRID_ROUNDING)
    t = grid.origin + grid.step * np.arange(first, last + 1)
    values = {name: spline_columns(block.t, value, t) for name, value in block.values.items()}
    return Block(t, values, block.remarks)


def spline_columns(t: FloatArray, values: FloatArray, times: FloatArray) -> FloatArray:
    """Interpolate columns by natural cubic splines; constant outside, NaN in missing values.

    Args:
        t: Increasing times of the values. Shape (N,) [s].
        values: Values, NaN where one is missing. Shape (N, n).
        times: Times at which values are wanted. Shape (M,) [s].

    Returns:
        Values, NaN next to missing ones. Shape (M, n).
    """
    from scipy.interpolate import CubicSpline  # slow to import

    inside = np.clip(times, t[0], t[-1])
    out = np.full((len(times), values.shape[1]), np.nan)
    for i, column in enumerate(values.T):
        known = np.isfinite(column)
        if known.sum() < 2:
            continue
        out[:, i] = CubicSpline(t[known], column[known], bc_type="natural")(inside)
        if not known.all():  # longer runs of missing values stay missing
            out[np.interp(inside, t, known.astype(float)) < 1.0, i] = np.nan
    return out
