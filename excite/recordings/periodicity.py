"""Find the window in which a recorded motion repeats, and check the stated period.

A recording begins with idle time, the controller's approach and a ramp; the periodic part follows.
The position difference over one period T

    d_j(t) = q_j(t + T) − q_j(t)

is noise while the motion repeats, and of the size of the motion elsewhere.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from .missing_values import true_runs
from .recording import MIN_ROWS, Recording
from .remark import Remark, RemarkKind, shown_time

MAX_DIFFERENCE = 0.03
"""Largest |d| over the range of a joint at which the motion counts as repeated [1]. Industrial
controllers repeat a motion to 0.1 % of its range, hobby servos to 2 %; an error of the period of
1 % of the motion's time scale gives 6 %."""
NOISE_FACTOR = 6.0
"""Largest |d| within the window over its median there [1]. It excludes the end of a ramp, which
joins the periodic part smoothly."""
MIN_DIFFERENCE = 1e-3
"""|d| over the range of a joint below which the motion counts as repeated at any noise [1]."""
MIN_MOTION_SHARE = 0.2
"""Smallest range of at least one joint within the window over its range in the recording [1]: a
standstill repeats with every period and is no periodic part."""
SEARCH_RATE = 25.0
"""Sampling rate of the search for a period [Hz]: the motion of an arm lies below 10 Hz."""
SEARCH_RATIO = 8.0
"""Largest ratio of the detected period to the stated one, and of the stated one to it [1]."""
MAX_TRIED_PERIODS = 1500
"""Largest number of periods that are tried."""
WINDOW_STARTS = 32
"""Number of compared start times of the whole periods."""
MAX_SEARCHED_ROWS = 20_000
"""Largest number of rows of the search, 13 minutes at SEARCH_RATE."""
MIN_REPEATED_TIME_SHARE = 0.9
"""Smallest repeated time over the longest one at which a shorter period is preferred [1]: a motion
repeats with every multiple of its period."""
REFINEMENTS = 4
"""Largest number of Gauss-Newton steps that refine a period."""
REFINEMENT_ROWS = 50_000
"""Largest number of rows, spread evenly, that a refinement uses: their noise changes a period by
less than 1e-7 of its length."""
CONVERGED = 1e-9
"""Relative change of the period in a Gauss-Newton step after which it is not refined further
[1]."""
PERIOD_ERROR = 0.01
"""Error of a period that is found, over the step, by which no row is lost: it is of the order of
1e-3 where the recording has a few thousand rows."""
MIN_PERIOD = 1.0
"""Shortest period of the search where none is stated [s]."""
MAX_PERIOD = 60.0
"""Longest period of that search [s]: excitations of arms take 3 to 30 s."""
MAX_UNSTATED_DIFFERENCE = 2e-3
"""Largest RMS of d over the range at which a motion without a stated period is averaged [1]: the
tracking error of a controller. Motions that differ by more were not planned to repeat."""
MAX_REFINEMENT = 0.05
"""Largest relative change of a period by its refinement [1]; beyond it Gauss-Newton has left the
minimum in which it started."""
MIN_OVERLAP = 0.25
"""Smallest length of a stated window beyond one period, over the period, at which the period can be
checked [1]."""
PERIOD_TOLERANCE = 2e-3
"""Relative deviation of the detected period from the stated one up to which the stated one is kept
[1]: the clocks of two computers differ by less than 1e-4."""


@dataclass(frozen=True)
class Repetition:
    """Window in which a motion repeats.

    Attributes:
        period: Period [s].
        window: Start and end [s].
        difference: Root mean square of d over the range, at the worst joint [1].
    """

    period: float
    window: tuple[float, float]
    difference: float


def check_repetition(recording: Recording) -> Recording:
    """Check the stated period against the motion, and find the window in which it repeats.

    A stated window is kept if the motion repeats within it; otherwise the window is searched. If
    the motion repeats with another period, as at reduced speed, that period is used. If the motion
    does not repeat, the period is dropped and no periods are averaged.

    Args:
        recording: A recording, whose sidecar may state a period.

    Returns:
        The recording with a period and a window that fit the motion, or with neither, and a remark
        on each change.
    """
    stated = recording.sidecar
    if stated.period is None:
        return recording
    period = stated.period
    if _is_confirmed(recording, period, stated.periodic):
        return recording
    repetition = find_window(recording, period)
    if repetition is not None and abs(repetition.period / period - 1.0) <= PERIOD_TOLERANCE:
        repetition = _with_stated_period(repetition, period)
        if stated.periodic is None:
            return _with_repetition(recording, repetition, None)
        text = (
            f"the motion does not repeat with the period {period:g} s in the whole of the stated "
            f"window, {_span(stated.periodic)}, but in {_span(repetition.window)}, which is used"
        )
        return _with_repetition(recording, repetition, text)
    detected = repetition or find_period(recording, period)
    if detected is not None:
        ratio = 100.0 * period / detected.period
        speed = f" (it ran at {ratio:.3g} % of that speed)" if abs(ratio - 100.0) > 1.0 else ""
        text = (
            f"the motion repeats after {detected.period:.5g} s and not after the stated "
            f"{period:.5g} s{speed}; it is averaged over the period that was found, in "
            f"{_span(detected.window)}"
        )
        return _with_repetition(recording, detected, text)
    return _without_repetition(recording, period)


def _with_stated_period(repetition: Repetition, period: float) -> Repetition:
    """The repetition with the stated period, and with the same number of periods."""
    start, end = repetition.window
    end = start + (end - start) * period / repetition.period
    return dataclasses.replace(repetition, period=period, window=(start, end))


def _is_confirmed(recording: Recording, period: float, window: tuple[float, float] | None) -> bool:
    """Return True if the motion repeats in the stated window, or the recording is shorter than two
    periods and cannot contradict it."""
    if recording.t[-1] - recording.t[0] + recording.step < 2.0 * period:
        return True
    if window is None or _contradicts(recording, period, window):
        return False
    return abs(_refined(recording, period, window) / period - 1.0) <= PERIOD_TOLERANCE


def _without_repetition(recording: Recording, period: float) -> Recording:
    """The recording without its period, and a remark on the joint that contradicts it most."""
    stated = recording.sidecar
    worst = _worst_difference(recording, period, stated.periodic)
    joint = "" if worst is None else f"; joint '{recording.joints[worst[0]]}' differs by "
    size = "" if worst is None else f"{100.0 * worst[1]:.0f} % of its range after one period"
    text = (
        f"the motion does not repeat with the stated period {period:g} s{joint}{size}; no periods "
        "are averaged. Check --period, or the period in the .json file"
    )
    sidecar = dataclasses.replace(stated, period=None, periodic=None)
    remark = Remark(RemarkKind.PERIOD, text, repaired=True)
    return dataclasses.replace(recording, sidecar=sidecar, remarks=(*recording.remarks, remark))


def with_detected_period(recording: Recording) -> Recording:
    """Return the recording with the period of its motion, where none is stated.

    The period is used if the RMS of d is below MAX_UNSTATED_DIFFERENCE at every joint.
    """
    if recording.sidecar.period is not None or any(
        remark.kind is RemarkKind.PERIOD for remark in recording.remarks
    ):
        return recording  # stated, or stated and refuted
    repetition = find_period(recording, None)
    if repetition is None or repetition.difference > MAX_UNSTATED_DIFFERENCE:
        return recording
    text = (
        f"the motion repeats every {repetition.period:.5g} s in {_span(repetition.window)}, "
        f"with a deviation of {100.0 * repetition.difference:.2g} % of its range; its periods are "
        "averaged"
    )
    start, end = repetition.window
    sidecar = dataclasses.replace(
        recording.sidecar, period=repetition.period, periodic=repetition.window
    )
    remark = Remark(RemarkKind.PERIOD, text, None, start, end)
    return dataclasses.replace(recording, sidecar=sidecar, remarks=(*recording.remarks, remark))


def _span(window: tuple[float, float]) -> str:
    return f"{shown_time(window[0])} to {shown_time(window[1])} s"


def _with_repetition(recording: Recording, repetition: Repetition, text: str | None) -> Recording:
    """The recording with a period and a window, and a remark where it was stated otherwise."""
    sidecar = dataclasses.replace(
        recording.sidecar, period=repetition.period, periodic=repetition.window
    )
    start, end = repetition.window
    remarks = recording.remarks
    if text is not None:
        remarks = (*remarks, Remark(RemarkKind.PERIOD, text, None, start, end, repaired=True))
    return dataclasses.replace(recording, sidecar=sidecar, remarks=remarks)


def _contradicts(recording: Recording, period: float, window: tuple[float, float]) -> bool:
    """Return True if the motion within a window, one period later, differs from itself."""
    rows = _rows_between(recording, window[0], window[1] - period)
    t = recording.t[rows]
    if len(t) < MIN_ROWS or t[-1] - t[0] < MIN_OVERLAP * period:
        return False
    difference, known = _relative_difference(recording, period, rows)
    if known.sum() < MIN_ROWS:
        return False
    # the window may include the ends of the ramps: the median judges the periodic part
    return bool(np.median(difference[known].max(axis=1)) > MAX_DIFFERENCE)


def _worst_difference(
    recording: Recording, period: float, window: tuple[float, float] | None
) -> tuple[int, float] | None:
    """Joint with the largest median of |d| over its range, and that ratio."""
    start, end = window or (float(recording.t[0]), float(recording.t[-1]))
    rows = _rows_between(recording, start, end - period)
    if rows.stop <= rows.start:
        return None
    difference, known = _relative_difference(recording, period, rows)
    if not known.any():
        return None
    typical = np.median(difference[known], axis=0)
    return int(np.argmax(typical)), float(typical.max())


def _rows_between(recording: Recording, start: float, end: float) -> slice:
    """Rows with start ≤ t ≤ end, within the error of a period that is found."""
    first = int(np.searchsorted(recording.t, start))
    end += PERIOD_ERROR * recording.step
    return slice(first, max(first, int(np.searchsorted(recording.t, end, side="right"))))


def _relative_difference(
    recording: Recording, period: float, rows: slice
) -> tuple[FloatArray, BoolArray]:
    """|d| over the range of each joint, 0 for joints that stand still, and True where it is known.

    M rows -> shapes (M, n), (M,).
    """
    later = _one_period_later(recording, period, rows)
    difference = later.interpolate(recording.q) - recording.q[rows]
    return np.abs(difference) / _ranges(recording), later.known


def _ranges(recording: Recording) -> FloatArray:
    """Range of each joint, ∞ for joints that move less than a thousandth of the others."""
    ranges = np.asarray(np.ptp(recording.q, axis=0), float)
    return np.where(ranges > 1e-3 * max(float(ranges.max()), 1e-12), ranges, np.inf)


@dataclass(frozen=True)
class _LaterTimes:
    """Linear interpolation of a recording at the times of M rows, one period later.

    Attributes:
        after: Index of the first row behind each time. Shape (M,).
        weight: Weight of that row; the row before has the remainder. Shape (M, 1).
        known: True where the time is within the recording and not in a gap. Shape (M,).
    """

    after: IntArray
    weight: FloatArray
    known: BoolArray

    def interpolate(self, values: FloatArray) -> FloatArray:
        """Interpolate columns at the times. Shape (N, n) -> (M, n)."""
        before = values[self.after - 1]
        return np.asarray(before + self.weight * (values[self.after] - before))


def _one_period_later(recording: Recording, period: float, rows: slice) -> _LaterTimes:
    """Locate the times of rows, one period later."""
    t = recording.t
    later = t[rows] + period
    after = np.clip(np.searchsorted(t, later), 1, len(t) - 1)
    spacing = t[after] - t[after - 1]
    known = (later <= t[-1] + PERIOD_ERROR * recording.step) & (spacing < 2.5 * recording.step)
    weight = np.clip((later - t[after - 1]) / spacing, 0.0, 1.0)
    return _LaterTimes(after, weight[:, None], known)


def find_window(recording: Recording, period: float) -> Repetition | None:
    """Find the longest window in which a motion repeats with a period.

    Args:
        recording: The recording.
        period: Period [s].

    Returns:
        The window, of two periods at least; None if there is none.
    """
    rows = _rows_between(recording, float(recording.t[0]), float(recording.t[-1]) - period)
    t = recording.t[rows]
    if len(t) < MIN_ROWS:
        return None
    difference, known = _relative_difference(recording, period, rows)
    runs = _repeating_runs(recording, period, t, known & (difference < MAX_DIFFERENCE).all(axis=1))
    if not runs:
        return None
    first, end = max(runs, key=lambda run: t[run[1] - 1] - t[run[0]])
    noise = np.median(difference[first:end][known[first:end]], axis=0)
    limit = np.clip(NOISE_FACTOR * noise, MIN_DIFFERENCE, MAX_DIFFERENCE)
    inside = known & (difference < limit).all(axis=1)
    inside[:first] = inside[end:] = False
    # single rows beyond the limit are noise: only the ends of the window are cut off
    kept = _repeating_runs(recording, period, t, _closed(inside, recording, period))
    first, end = max(kept, key=lambda run: t[run[1] - 1] - t[run[0]], default=(first, end))
    rms = np.sqrt(np.mean(difference[first:end][known[first:end]] ** 2, axis=0))
    window = (float(t[first]), min(float(t[end - 1]) + period, float(recording.t[-1])))
    refined = _refined(recording, period, window)
    return Repetition(refined, _whole_periods(recording, refined, window), float(rms.max()))


def _whole_periods(
    recording: Recording, period: float, window: tuple[float, float]
) -> tuple[float, float]:
    """Return the whole periods within a window that repeat best.

    A ramp joins the motion smoothly: its last rows repeat in position, yet not in torque.
    """
    # the last row of a period is one step before its end
    length = period * int((window[1] - window[0] + recording.step) / period + 1e-6)
    slack = window[1] - window[0] - length
    if length < 2.0 * period or slack < recording.step:
        return window
    rows = _rows_between(recording, window[0], window[1] - period)
    t = recording.t[rows]
    difference, known = _relative_difference(recording, period, rows)
    square = np.where(known, np.sum(difference**2, axis=1), 0.0)
    total = np.concatenate([[0.0], np.cumsum(square)])
    # a window starts at a row, or averaging would lose its last period to rounding
    choices = recording.t[_rows_between(recording, window[0], window[0] + slack)]
    starts = choices[np.unique(np.linspace(0, len(choices) - 1, WINDOW_STARTS).astype(int))]
    ends = starts + length - period
    costs = total[np.searchsorted(t, ends, side="right")] - total[np.searchsorted(t, starts)]
    start = float(starts[int(np.argmin(costs))])
    return start, start + length


def _closed(flags: BoolArray, recording: Recording, period: float) -> BoolArray:
    """Flags with runs of False shorter than a fiftieth of a period set to True."""
    out = flags.copy()
    for first, end in true_runs(~flags):
        if first > 0 and end < len(flags) and (end - first) * recording.step < 0.02 * period:
            out[first:end] = True
    return out


def _repeating_runs(
    recording: Recording, period: float, t: FloatArray, repeats: BoolArray
) -> list[tuple[int, int]]:
    """Runs of rows that repeat for a period or more, and in which a joint moves."""
    ranges = _ranges(recording)
    out = []
    for first, end in true_runs(_closed(repeats, recording, period)):
        if t[end - 1] - t[first] < period * (1.0 - 1e-3) - recording.step:
            continue
        rows = _rows_between(recording, t[first], t[end - 1])
        if (np.ptp(recording.q[rows], axis=0) > MIN_MOTION_SHARE * ranges).any():
            out.append((int(first), int(end)))
    return out


def find_period(recording: Recording, expected: float | None) -> Repetition | None:
    """Find the period with which a motion repeats.

    Args:
        recording: The recording.
        expected: Period within a factor of SEARCH_RATIO of which is searched [s]; None: from
            MIN_PERIOD to MAX_PERIOD.

    Returns:
        The repetition with the shortest period among those that repeat for about the longest time;
        None if the motion does not repeat.
    """
    length = float(recording.t[-1] - recording.t[0])
    step = max(1.0 / SEARCH_RATE, recording.step)
    shortest, longest = (
        (MIN_PERIOD, MAX_PERIOD)
        if expected is None
        else (expected / SEARCH_RATIO, SEARCH_RATIO * expected)
    )
    shortest, longest = max(shortest, MIN_ROWS * step), min(longest, 0.5 * length)
    if longest <= shortest:
        return None
    spacing = max(step, (longest - shortest) / MAX_TRIED_PERIODS)
    t = np.arange(recording.t[0], recording.t[-1], step)[:MAX_SEARCHED_ROWS]
    # one row per joint, so that comparisons over the joints are fast
    q = np.array([np.interp(t, recording.t, column) for column in recording.q.T])
    scaled = (q - q.mean(axis=1, keepdims=True)) / _ranges(recording)[:, None]
    speed = np.abs(np.diff(scaled, axis=1, append=scaled[:, -1:])).max(axis=0)
    moves = speed > 0.1 * float(np.median(speed[speed > 0.0])) if (speed > 0.0).any() else speed > 0
    shifts = np.unique(np.round(np.arange(shortest, longest, spacing) / step).astype(int))
    repeated = np.zeros(len(shifts))
    # an error of the period of half a grid step changes d by the speed times that error
    allowed = MAX_DIFFERENCE + 0.5 * spacing / step * float(np.percentile(speed, 99.0))
    for k, shift in enumerate(shifts.tolist()):
        same = (np.abs(scaled[:, shift:] - scaled[:, :-shift]) < allowed).all(axis=0)
        count = int(np.sum(same & moves[: len(same)]))
        repeated[k] = count + shift if count >= 0.5 * shift else 0.0
    for k in _candidates(repeated):
        period = _refined(recording, float(shifts[k] * step))
        repetition = find_window(recording, period)
        if repetition is not None:
            return repetition
    return None


def _candidates(repeated: FloatArray) -> list[int]:
    """Local maxima of the repeated time, the shortest period of the longest times first."""
    if not repeated.any():
        return []
    padded = np.concatenate([[-1.0], repeated, [-1.0]])
    peaks = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]))
    peaks = peaks[repeated[peaks] > 0.5 * repeated.max()]
    long = peaks[repeated[peaks] >= MIN_REPEATED_TIME_SHARE * repeated[peaks].max()]
    others = [k for k in peaks.tolist() if k not in set(long.tolist())]
    return [*long.tolist(), *sorted(others, key=lambda k: -repeated[k])][:20]


def _refined(
    recording: Recording, period: float, window: tuple[float, float] | None = None
) -> float:
    """Refine a period by least squares over the repeated rows of a window; None: of all rows."""
    start, end = window or (float(recording.t[0]), float(recording.t[-1]))
    scale, refined = 1.0 / _ranges(recording), period
    velocity = np.gradient(recording.q, recording.t, axis=0)
    for _ in range(REFINEMENTS):
        rows = _rows_between(recording, start, end - refined)
        count = rows.stop - rows.start
        if count < MIN_ROWS:
            break
        rows = slice(rows.start, rows.stop, -(-count // REFINEMENT_ROWS))
        later = _one_period_later(recording, refined, rows)
        difference = (later.interpolate(recording.q) - recording.q[rows]) * scale
        repeated = later.known & (np.abs(difference) < 4.0 * MAX_DIFFERENCE).all(axis=1)
        slope, offset = (later.interpolate(velocity) * scale)[repeated], difference[repeated]
        power = float(np.sum(slope**2))
        if power == 0.0:
            break
        change = float(np.sum(slope * offset)) / power
        refined -= change
        if abs(refined / period - 1.0) > MAX_REFINEMENT:
            return period
        if abs(change) < CONVERGED * period:
            break
    return refined
