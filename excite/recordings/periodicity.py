"""Where a recorded motion repeats, and whether it does so with the period that is stated.

A recording begins with idle time, the controller's approach and a ramp, and only then repeats. The
position one period later tells where:

    d_j(t) = q_j(t + T) − q_j(t),

which is noise while the motion repeats with the period T, and of the size of the motion elsewhere.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray
from .missing_values import true_runs
from .recording import MIN_ROWS, Recording
from .remark import Remark, RemarkKind

MAX_DIFFERENCE = 0.03
"""Largest |d| over the range of a joint that counts as repeated [1]. Controllers repeat a motion to
0.1 % of its range and hobby servos to 2 %; a period that is wrong by 1 % of the motion's time scale
gives 6 %."""
NOISE_FACTOR = 6.0
"""|d| over its median where the motion repeats, up to which the window is extended [1]: it excludes
the end of a ramp, which joins the motion smoothly."""
MIN_DIFFERENCE = 1e-3
"""|d| over the range of a joint that always counts as repeated [1], whatever the noise."""
MIN_MOTION_SHARE = 0.2
"""Range of a joint within the window over its range in the recording, at least at one joint [1]:
what stands still repeats, too."""
SEARCH_RATE = 25.0
"""Rate at which other periods are searched [Hz]: the motion of an arm lies below 10 Hz."""
SEARCH_RATIO = 8.0
"""Largest ratio of the period that is found to the one that is stated, and its inverse [1]."""
MAX_SEARCHED = 1500
"""Number of periods that are tried at most."""
WINDOW_STARTS = 32
"""Number of starts of the whole periods that are compared."""
MAX_SEARCHED_ROWS = 20_000
"""Number of rows in which they are searched at most: 13 minutes."""
BEST_SHARE = 0.9
"""Share of the longest repeated time from which a shorter period is preferred [1]: a motion repeats
with every multiple of its period."""
REFINEMENTS = 4
"""Gauss-Newton steps by which a period is refined."""
MIN_PERIOD = 1.0
"""Shortest period that is searched where none is stated [s]."""
MAX_PERIOD = 60.0
"""Longest such period [s]: excitations of arms take 3 to 30 s."""
MAX_UNSTATED_DIFFERENCE = 2e-3
"""RMS of d over the range up to which a motion whose period is not stated is averaged [1]: the
tracking error of a controller. Motions that differ by more are no repetition by design."""
MAX_REFINEMENT = 0.05
"""Largest relative change of a period by its refinement [1]: from further away it is not the
nearest minimum."""
MIN_OVERLAP = 0.25
"""Length of a stated window beyond one period, over the period, from which the period can be
checked [1]."""
PERIOD_TOLERANCE = 2e-3
"""Relative deviation of the period that the data show, from the stated one, that is not remarked
[1]: between two computers' clocks it is below 1e-4."""


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

    A stated window in which the motion does repeat is kept. A window that is not stated, or does
    not fit, is found; if the motion repeats with another period, as where the robot ran at reduced
    speed, that one is used. If it does not repeat at all, the period is dropped, so that nothing is
    averaged.

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
        repetition = dataclasses.replace(repetition, period=period)
        if stated.periodic is None:
            return _with_repetition(recording, repetition, None)
        text = (
            f"the motion does not repeat with the period {period:g} s in the whole of the stated "
            f"window, {_span(stated.periodic)}, but in {_span(repetition.window)}, which is used"
        )
        return _with_repetition(recording, repetition, text)
    other = repetition or find_period(recording, period)
    if other is not None:
        ratio = 100.0 * period / other.period
        speed = f" (it ran at {ratio:.3g} % of that speed)" if abs(ratio - 100.0) > 1.0 else ""
        text = (
            f"the motion repeats after {other.period:.5g} s and not after the stated "
            f"{period:.5g} s{speed}; it is averaged over the period that was found, in "
            f"{_span(other.window)}"
        )
        return _with_repetition(recording, other, text)
    return _without_repetition(recording, period)


def _is_confirmed(recording: Recording, period: float, window: tuple[float, float] | None) -> bool:
    """Return True if a window is stated that repeats, or a second period is too long to show."""
    if recording.t[-1] - recording.t[0] < 2.0 * period:
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


def with_own_period(recording: Recording) -> Recording:
    """Return the recording with the period that its motion shows, where none is stated.

    It is used if the motion repeats with it precisely, within MAX_UNSTATED_DIFFERENCE.
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
    return f"{window[0]:.4g} to {window[1]:.4g} s"


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
    t = recording.t[(recording.t >= window[0]) & (recording.t <= window[1] - period)]
    if len(t) < MIN_ROWS or t[-1] - t[0] < MIN_OVERLAP * period:
        return False
    difference, known = _relative_difference(recording, period, t)
    if known.sum() < MIN_ROWS:
        return False
    # a stretch at the ends of a generous window may be a ramp: judge the middle of the motion
    return bool(np.median(difference[known].max(axis=1)) > MAX_DIFFERENCE)


def _worst_difference(
    recording: Recording, period: float, window: tuple[float, float] | None
) -> tuple[int, float] | None:
    """Joint with the largest median of |d| over its range, and that ratio."""
    start, end = window or (float(recording.t[0]), float(recording.t[-1]))
    t = recording.t[(recording.t >= start) & (recording.t <= end - period)]
    if not len(t):
        return None
    difference, known = _relative_difference(recording, period, t)
    if not known.any():
        return None
    typical = np.median(difference[known], axis=0)
    return int(np.argmax(typical)), float(typical.max())


def _relative_difference(
    recording: Recording, period: float, t: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """|d| over the range of each joint, 0 for joints that stand still, and where it is known.

    Shape (M,) of `t` -> (M, n), (M,).
    """
    difference, known = _difference(recording, period, t)
    return np.abs(difference) / _ranges(recording), known


def _ranges(recording: Recording) -> FloatArray:
    """Range of each joint, ∞ for joints that move less than a thousandth of the others."""
    ranges = np.asarray(np.ptp(recording.q, axis=0), float)
    return np.where(ranges > 1e-3 * max(float(ranges.max()), 1e-12), ranges, np.inf)


def _difference(recording: Recording, period: float, t: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Compute d(t), and True where both positions are measured."""
    later = t + period
    after = np.clip(np.searchsorted(recording.t, later), 1, len(recording.t) - 1)
    spacing = recording.t[after] - recording.t[after - 1]
    known = (later <= recording.t[-1] + 1e-9) & (spacing < 2.5 * recording.step)
    columns = [
        np.interp(later, recording.t, q) - np.interp(t, recording.t, q) for q in recording.q.T
    ]
    return np.column_stack(columns), known


def find_window(recording: Recording, period: float) -> Repetition | None:
    """Find the longest window in which a motion repeats with a period.

    Args:
        recording: The recording.
        period: Period [s].

    Returns:
        The window, of two periods at least; None if there is none.
    """
    t = recording.t[recording.t <= recording.t[-1] - period]
    if len(t) < MIN_ROWS:
        return None
    difference, known = _relative_difference(recording, period, t)
    runs = _repeating_runs(recording, period, t, known & (difference < MAX_DIFFERENCE).all(axis=1))
    if not runs:
        return None
    first, end = max(runs, key=lambda run: t[run[1] - 1] - t[run[0]])
    noise = np.median(difference[first:end][known[first:end]], axis=0)
    limit = np.clip(NOISE_FACTOR * noise, MIN_DIFFERENCE, MAX_DIFFERENCE)
    inside = known & (difference < limit).all(axis=1)
    inside[:first] = inside[end:] = False
    # single rows beyond the limit are noise: only those at the ends are cut off
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
    length = period * int((window[1] - window[0]) / period + 1e-6)
    slack = window[1] - window[0] - length
    if length < 2.0 * period or slack < recording.step:
        return window
    t = recording.t[(recording.t >= window[0]) & (recording.t <= window[1] - period)]
    difference, known = _relative_difference(recording, period, t)
    square = np.where(known, np.sum(difference**2, axis=1), 0.0)
    starts = window[0] + np.linspace(0.0, slack, WINDOW_STARTS)
    costs = [
        float(np.sum(square[(t >= start) & (t <= start + length - period)])) for start in starts
    ]
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
        rows = (recording.t >= t[first]) & (recording.t <= t[end - 1])
        if (np.ptp(recording.q[rows], axis=0) > MIN_MOTION_SHARE * ranges).any():
            out.append((int(first), int(end)))
    return out


def find_period(recording: Recording, near: float | None) -> Repetition | None:
    """Find the period with which a motion repeats.

    Args:
        recording: The recording.
        near: Period from which the search starts, within a factor of SEARCH_RATIO [s]; None: all
            periods from MIN_PERIOD to MAX_PERIOD.

    Returns:
        The repetition with the shortest period among those that repeat for about the longest time;
        None if the motion does not repeat.
    """
    length = float(recording.t[-1] - recording.t[0])
    step = max(1.0 / SEARCH_RATE, recording.step)
    shortest, longest = (
        (MIN_PERIOD, MAX_PERIOD) if near is None else (near / SEARCH_RATIO, SEARCH_RATIO * near)
    )
    shortest, longest = max(shortest, MIN_ROWS * step), min(longest, 0.5 * length)
    if longest <= shortest:
        return None
    spacing = max(step, (longest - shortest) / MAX_SEARCHED)
    t = np.arange(recording.t[0], recording.t[-1], step)[:MAX_SEARCHED_ROWS]
    q = np.column_stack([np.interp(t, recording.t, column) for column in recording.q.T])
    scaled = (q - q.mean(axis=0)) / _ranges(recording)
    speed = np.abs(np.diff(scaled, axis=0, append=scaled[-1:])).max(axis=1)
    moves = speed > 0.1 * float(np.median(speed[speed > 0.0])) if (speed > 0.0).any() else speed > 0
    shifts = np.unique(np.round(np.arange(shortest, longest, spacing) / step).astype(int))
    repeated = np.zeros(len(shifts))
    # half a grid step of the period moves d by the speed times that
    allowed = MAX_DIFFERENCE + 0.5 * spacing / step * float(np.percentile(speed, 99.0))
    for k, shift in enumerate(shifts.tolist()):
        same = (np.abs(scaled[shift:] - scaled[:-shift]) < allowed).all(axis=1)
        repeated[k] = float(np.sum(same & moves[: len(same)])) + shift * bool(same.any())
        if np.sum(same & moves[: len(same)]) < 0.5 * shift:
            repeated[k] = 0.0
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
    long = peaks[repeated[peaks] >= BEST_SHARE * repeated[peaks].max()]
    others = [k for k in peaks.tolist() if k not in set(long.tolist())]
    return [*long.tolist(), *sorted(others, key=lambda k: -repeated[k])][:20]


def _refined(
    recording: Recording, period: float, window: tuple[float, float] | None = None
) -> float:
    """Refine a period by least squares over the rows of a window that repeat; None: of all."""
    start, end = window or (float(recording.t[0]), float(recording.t[-1]))
    scale, refined = 1.0 / _ranges(recording), period
    for _ in range(REFINEMENTS):
        t = recording.t[(recording.t >= start) & (recording.t <= end - refined)]
        if len(t) < MIN_ROWS:
            break
        difference, known = _difference(recording, refined, t)
        rate = np.column_stack(
            [
                np.interp(t + refined, recording.t, np.gradient(q, recording.t))
                for q in recording.q.T
            ]
        )
        near = known & (np.abs(difference * scale) < 4.0 * MAX_DIFFERENCE).all(axis=1)
        slope, offset = (rate * scale)[near], (difference * scale)[near]
        power = float(np.sum(slope**2))
        if power == 0.0:
            break
        refined -= float(np.sum(slope * offset)) / power
        if abs(refined / period - 1.0) > MAX_REFINEMENT:
            return period
    return refined
