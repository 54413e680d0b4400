"""Noise of the torque residual, from what differs when a motion is repeated.

Timestamp jitter and encoder quantisation disturb the model's side of the equation as well as the
measured torque, so it is the residual, measured minus predicted, whose repetitions are compared
(after Swevers et al., IEEE Trans. Robot. Autom. 13, 1997, who compare torques).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .._types import BoolArray, FloatArray
from ..effects.recorded_motion import RecordedMotion, split_by_motion
from ..identification import segments
from ..identification.lowpass import MOTION_BANDWIDTH_RATIO, Grid
from ..identification.regression import IdentificationModel, filtered_regressor
from ..recordings import Recording, periodicity, quantization
from ..recordings.missing_values import true_runs
from ..recordings.padding import pad_by_reflection
from .blocks import sandwiched

Draw = Callable[[np.random.Generator], FloatArray]
"""Draws the residual that encoder steps alone would leave, shape (N, n)."""
Period = tuple[float, tuple[float, float]]
"""Period of a motion [s], and start and end of the window in which it repeats [s]."""
DRAWS = 3
"""Random draws of the encoders' quantisation errors."""
MIN_PERIODS = 1.2
"""Periods that a recording must contain to show its noise by repetition."""
WINDOWS = 40
"""Windows into which a difference of periods is divided."""
USUAL_QUANTILE = 0.6
"""Quantile of the windows' mean squares that stands for noise."""
MAX_WINDOW_RATIO = 12.0
"""Mean square over that quantile from which a window is not noise."""
WINDOW_PASSES = 4
"""Iterations of the exclusion of windows."""
JITTER_STANDARD_ERRORS = 2.0
"""Standard errors that are added to the growth of noise with momentum."""
MAX_MOTION_SHARE = 0.6
"""Largest frequency of the motion, over the cutoff, above which the residual shows its noise."""
FILTERED_SHARE = 0.95
"""Share of the residual's power above the motion that lies below the cutoff of a file that was
filtered before."""
SPECTRUM_PERIODS = 40.0
"""Length of the windows of the spectrum, in periods of the cutoff frequency."""
SHIFT_PADDING = 32
"""Rows by which a signal is continued before it is shifted."""


@dataclass(frozen=True)
class NoiseEstimate:
    """Residual of a perfect model below the cutoff frequency, per joint.

    Attributes:
        floor: RMS noise [N m], shape (n,).
        method: "periods" if it was found by repetition, else "differences".
        clock: Mean square beyond the floor's that timestamp jitter causes where momentum is larger
            than where the floor was found [(N m)²], shape (n,).
        steps: RMS of the model torque's error by encoder quantisation, which repeats with the
            motion [N m], shape (n,).
        periods: By recording that repeats: its period and window.
    """

    floor: FloatArray
    method: str
    clock: FloatArray
    steps: FloatArray
    periods: Mapping[str, Period] = field(default_factory=dict)

    @property
    def noise_rms(self) -> FloatArray:
        """RMS that a right model may leave, with quantisation and jitter [N m], shape (n,)."""
        return np.asarray(np.sqrt(self.floor**2 + 2.0 * self.steps**2 + self.clock))


def estimate_noise(
    model: IdentificationModel,
    motions: Sequence[RecordedMotion],
    residuals: Sequence[FloatArray],
    recordings: Sequence[Recording],
) -> NoiseEstimate:
    """Estimate the noise of a residual from what does not repeat.

    Where nothing repeats, the residual's spectral density above the motion gives a lower bound.

    Args:
        model: The base model.
        motions: Motions of the recordings.
        residuals: Torque residual of each, shapes (N, n) [N m].
        recordings: The recordings.
    """
    spectral = _spectral_noise(motions, residuals)
    draws = quantization_residuals(model, motions)
    rows = np.concatenate(draws) if draws else np.zeros((1, len(spectral)))
    steps = np.sqrt(np.mean(rows**2, axis=0))
    periods = {
        recording.source: period
        for recording in recordings
        if (period := estimate_period(recording))
    }
    lower_bound = NoiseEstimate(
        _with_steps(spectral, steps),
        "differences",
        np.zeros(len(spectral)),
        steps,
        periods,
    )
    return _refined_by_repetition(lower_bound, motions, residuals)


def _refined_by_repetition(
    estimate: NoiseEstimate,
    motions: Sequence[RecordedMotion],
    residuals: Sequence[FloatArray],
) -> NoiseEstimate:
    """Noise from the repetitions of residuals; unchanged if nothing repeats."""
    periods = estimate.periods
    repetitions = [
        repetition
        for motion, residual in zip(motions, residuals, strict=True)
        if motion.segment.source in periods
        for repetition in _repetitions(motion, residual, periods[motion.segment.source])
    ]
    if not repetitions:
        return estimate
    spread = np.sqrt(np.mean([repetition.square for repetition in repetitions], axis=0))
    return replace(
        estimate,
        floor=_with_steps(spread, estimate.steps),
        method="periods",
        clock=_jitter_noise(repetitions, motions),
    )


def _with_steps(spread: FloatArray, steps: FloatArray) -> FloatArray:
    """Noise and encoder quantisation together, shape (n,)."""
    return np.asarray(np.sqrt(np.maximum(spread, 1e-12) ** 2 + steps**2))


def _spectral_noise(
    motions: Sequence[RecordedMotion], residuals: Sequence[FloatArray]
) -> FloatArray:
    """RMS of white noise below the cutoff with the median density above the motion, shape (n,).

    The cutoff is that of this filter, or the lower one of a file that was filtered before.
    """
    from scipy import signal  # slow to import

    squares, rows = np.zeros(residuals[0].shape[1]), 0
    for motion, residual in zip(motions, residuals, strict=True):
        rate, hertz = motion.band.rate_of(Grid.KEPT), motion.band.hertz
        length = min(len(residual), max(16, int(SPECTRUM_PERIODS * rate / hertz)))
        frequency, density = signal.welch(residual, rate, nperseg=length, axis=0)
        start = min(segments.motion_bandwidth(motion.segment), MAX_MOTION_SHARE * hertz)
        above = (frequency > start) & (frequency <= hertz)
        for j in range(len(squares)):
            share = np.cumsum(density[above, j]) / max(float(density[above, j].sum()), 1e-300)
            last = int(np.searchsorted(share, FILTERED_SHARE))
            usable = density[above, j][: last + 1]
            edge = float(frequency[above][min(last, int(above.sum()) - 1)])
            squares[j] += len(residual) * edge * float(np.median(usable))
        rows += len(residual)
    return np.asarray(np.sqrt(np.maximum(squares / max(rows, 1), 1e-24)))


@dataclass(frozen=True)
class _Repetition:
    """Difference between two periods of a motion.

    Attributes:
        change: Difference of the residual over √2, shape (N, n).
        momentum: Squared momentum, shape (N, n).
        usual: Rows from which noise is estimated, shape (N,).
        square: Mean square there, without friction that warms up, shape (n,).
    """

    change: FloatArray
    momentum: FloatArray
    usual: BoolArray
    square: FloatArray


def _repetitions(motion: RecordedMotion, residual: FloatArray, period: Period) -> list[_Repetition]:
    """The repetition in a motion, or none if the motion is too short; residual (N, n) [N m]."""
    first, later, inside = _two_periods(motion, residual, period)
    rows = len(residual) - len(later)
    if inside.sum() < 0.15 * rows or inside.sum() < 20:
        return []
    change = (later - first)[inside] / np.sqrt(2.0)
    return [_without_drift(change, motion, inside)]


def _two_periods(
    motion: RecordedMotion, residual: FloatArray, period: Period
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """A residual and that one period later, and the rows of which both lie inside the window."""
    seconds, (low, high) = period
    rate = 1.0 / (motion.time[1] - motion.time[0])
    rows = int(np.floor(seconds * rate))
    later = shifted(residual, seconds * rate - rows)[rows:]
    inside = (motion.time[: len(later)] >= low) & (
        motion.time[rows : rows + len(later)] + 1.0 / rate <= high
    )
    return residual[: len(later)], later, inside


def products_of_periods(
    periods: Mapping[str, Period], motions: Sequence[RecordedMotion], residual: FloatArray
) -> FloatArray:
    """Return the products of a residual in two subsequent periods, shape (m, n) [(N m)²].

    Their mean is the power that repeats. Empty if nothing repeats.

    Args:
        periods: Period and window by recording.
        motions: The motions.
        residual: Their residual, shape (N, n) [N m].
    """
    out = [np.zeros((0, residual.shape[1]))]
    for motion, part in zip(motions, split_by_motion(residual, motions), strict=True):
        if motion.segment.source not in periods:
            continue
        first, later, inside = _two_periods(motion, part, periods[motion.segment.source])
        out.append((later * first)[inside])
    return np.concatenate(out)


def _squared_momentum(motion: RecordedMotion) -> FloatArray:
    """Squared momentum of what a joint moves, rotor included [(kg m²/s)²], shape (N, n).

    A sample read δ late has a position error q̇ δ and, to first order, a torque error (M q̇ δ)¨,
    which for white jitter is proportional to the momentum.
    """
    mass, speed = motion.derivatives[2], motion.coarse_samples.dq
    rotor_inertia = motion.fitted_robot.actuator_parameter("rotor_inertia")
    momentum = np.einsum("tij,tj->ti", mass, speed) + rotor_inertia * speed
    return np.square(motion.lowpass(momentum, Grid.COARSE))


def _without_drift(change: FloatArray, motion: RecordedMotion, inside: BoolArray) -> _Repetition:
    """A difference of periods without that of friction that warms up."""
    t = np.linspace(-1.0, 1.0, len(change))[:, None]
    groups = []
    for j in range(change.shape[1]):
        friction = motion.lowpass(np.column_stack([motion.sign(j), motion.samples.dq[:, j]]))[
            : len(inside)
        ][inside]
        columns = np.hstack([friction, friction * t])
        groups.append(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
    usual, remainder = np.ones(len(change), bool), np.empty(change.shape)
    for _ in range(WINDOW_PASSES):
        for j, columns in enumerate(groups):
            remainder[:, j] = (
                change[:, j]
                - columns @ np.linalg.lstsq(columns[usual], change[usual, j], rcond=1e-8)[0]
            )
        usual = _usual_rows(np.square(remainder))
    count = int(usual.sum())
    square = (
        np.mean(np.square(remainder[usual]), axis=0) * count / max(count - groups[0].shape[1], 1)
    )
    return _Repetition(remainder, _squared_momentum(motion)[: len(inside)][inside], usual, square)


def _jitter_noise(
    repetitions: Sequence[_Repetition], motions: Sequence[RecordedMotion]
) -> FloatArray:
    """Mean square noise by timestamp jitter beyond that in the floor, shape (n,).

    Jitter noise grows with the squared momentum and does not repeat.
    """
    change, momentum = (
        np.concatenate([getattr(repetition, name) for repetition in repetitions])
        for name in ("change", "momentum")
    )
    overall, used = (
        np.concatenate([_squared_momentum(motion) for motion in motions]),
        np.concatenate([repetition.momentum[repetition.usual] for repetition in repetitions]),
    )
    out = np.zeros(change.shape[1])
    for j in range(len(out)):
        mean = max(float(overall[:, j].mean()), 1e-300)
        out[j] = _noise_growth(momentum[:, j] / mean, change[:, j] ** 2) * max(
            1.0 - float(used[:, j].mean()) / mean, 0.0
        )
    return out


def _noise_growth(x: FloatArray, y: FloatArray) -> float:
    """Upper bound of the slope of noise power y over x, at most y's mean over x's.

    Rows are weighted by 1/(1 + x), so that few of large x do not dominate. Standard errors are
    those between blocks, since the noise is coloured.
    """
    columns, right = np.column_stack([np.ones(len(x)), x]) / (1.0 + x)[:, None], y / (1.0 + x)
    count = max(2, min(WINDOWS, len(x) // 8))
    solution, covariance = sandwiched(
        list(zip(np.array_split(columns, count), np.array_split(right, count), strict=True))
    )
    error = float(np.sqrt(covariance[1, 1]))
    return float(
        np.clip(solution[1] + JITTER_STANDARD_ERRORS * error, 0.0, y.mean() / max(x.mean(), 1e-300))
    )


def _usual_rows(square: FloatArray) -> BoolArray:
    """Rows outside the two longest runs of windows with large power on some joint: (N, n) -> (N,).

    A contact happens in one period, which differs from the one before and the one after. Timestamp
    jitter has large power wherever the motion is fast, in short windows, and is noise.
    """
    parts = np.array_split(square, max(1, min(WINDOWS, len(square) // 8)))
    means = np.array([part.mean(axis=0) for part in parts])
    large = (means > MAX_WINDOW_RATIO * np.quantile(means, USUAL_QUANTILE, axis=0)).any(axis=1)
    kept = np.ones(len(parts), bool)
    for start, end in sorted(true_runs(large).tolist(), key=lambda e: e[0] - e[1])[:2]:
        kept[start:end] = False
    return np.repeat(kept, [len(part) for part in parts])


def shifted(x: FloatArray, by: float) -> FloatArray:
    """Return x a fraction of a row later, by its Fourier series.

    The ends are continued by reflection.

    Args:
        x: Shape (N, n).
        by: Shift [rows].
    """
    if by < 1e-6:
        return x
    reach = min(SHIFT_PADDING, len(x) - 1)
    padded = pad_by_reflection(x, reach, reach)
    spectrum = (
        np.fft.rfft(padded, axis=0)
        * np.exp(2j * np.pi * np.fft.rfftfreq(len(padded)) * by)[:, None]
    )
    return np.asarray(np.fft.irfft(spectrum, len(padded), axis=0)[reach : reach + len(x)])


def estimate_period(recording: Recording) -> Period | None:
    """Return period and window of a recording, as stated or else as its positions show.

    None if it does not repeat often enough.
    """
    if recording.repetition is None:
        found = periodicity.find_period(recording, None)
        return None if found is None else (found.period, found.window)
    period, (start, end) = recording.repetition
    return recording.repetition if end - start >= MIN_PERIODS * period else None


def quantization_residuals(
    model: IdentificationModel, motions: Sequence[RecordedMotion]
) -> tuple[FloatArray, ...]:
    """Draw residuals of the base model by encoder quantisation alone.

    The error of each reading is unknown, but not its distribution: smoothed positions are quantised
    again, with random origins.

    Returns:
        `DRAWS` residuals of shape (N, n) [N m]; none if all encoders are fine.
    """
    if not any(motion.segment.encoder.any() for motion in motions):
        return ()
    rng = np.random.default_rng(0)
    errors = [_quantization_error(model, motion) for motion in motions]
    return tuple(np.concatenate([draw(rng) for draw in errors]) for _ in range(DRAWS))


def _quantization_error(model: IdentificationModel, motion: RecordedMotion) -> Draw:
    """Function that draws the residual of a motion; the unquantised regressor is shared."""
    step = motion.steps
    coarse = step > 0.0
    if not coarse.any():
        return lambda rng: np.zeros((len(motion), motion.n))
    segment = motion.segment
    smooth = np.where(
        segment.smoothed,
        segment.q,
        motion.band.transform(segment.q).filter(Grid.RECORDED, 0, MOTION_BANDWIDTH_RATIO),
    )
    exact = filtered_regressor(model, smooth, motion.band)[0]

    def draw(rng: np.random.Generator) -> FloatArray:
        positions, origin = smooth.copy(), rng.uniform(size=motion.n) * step
        positions[:, coarse] = (
            np.round((smooth + origin)[:, coarse] / step[coarse]) * step[coarse]
        ) - origin[coarse]
        for j in np.flatnonzero(segment.smoothed):
            positions[:, j] = quantization.smoothest_line(
                positions[:, j], float(step[j]), 1.0 / segment.rate
            )
        quantized = filtered_regressor(model, positions, motion.band)[0]
        return np.asarray((exact - quantized)[motion.kept] @ motion.theta)

    return draw
