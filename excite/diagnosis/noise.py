"""Noise of the torque residual, from what differs when a motion is repeated.

Timestamp jitter and encoder quantisation disturb the model's side of the equation as well as the
measured torque, so it is the residual, measured minus predicted, whose repetitions are compared
(after Swevers et al., IEEE Trans. Robot. Autom. 13, 1997, who compare torques).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import special

from .._types import BoolArray, FloatArray
from ..effects.recorded_motion import Motions, RecordedMotion, split_by_motion
from ..identification import segments
from ..identification.estimators import torque_resolution
from ..identification.lowpass import Grid
from ..identification.regression import IdentificationModel, filtered_regressor
from ..recordings import Recording, encoder_resolution, periodicity
from ..recordings.missing_values import true_runs
from ..recordings.padding import with_response
from . import position_errors
from .regression import rms

Period = tuple[float, tuple[float, float]]
"""Period of a motion [s], and start and end of the window in which it repeats [s]."""
DRAWS = 3
"""Random draws of the quantisation errors."""
NORMAL_QUANTILES = special.ndtri((np.arange(8) + 0.5) / 8)
"""Noise of the torque over its standard deviation, for the mean of its quantisation error."""
MIN_PERIODS = 1.2
"""Periods that a recording must contain to show its noise by repetition."""
MIN_REPEATED_SHARE = 0.15
"""Repeated rows that a recording must contain to show its noise by repetition, over the rows of a
period."""
MIN_REPEATED_ROWS = 20
"""Repeated rows in motion that a joint needs to show its noise by repetition."""
WINDOWS = 40
"""Windows into which a difference of periods, or noise above the cutoff, is divided."""
USUAL_QUANTILE = 0.6
"""Quantile of the windows' mean squares that stands for noise."""
MAX_WINDOW_RATIO = 12.0
"""Mean square over that quantile from which a window is not noise."""
WINDOW_PASSES = 4
"""Iterations of the exclusion of windows."""
MAX_MOTION_SHARE = 0.6
"""Largest frequency of the motion, over the cutoff, above which the residual shows its noise."""
FILTERED_SHARE = 0.95
"""Share of the residual's power above the motion that lies below the cutoff of a file that was
filtered before."""
SPECTRUM_PERIODS = 40.0
"""Length of the windows of the spectrum, in periods of the cutoff frequency."""


@dataclass(frozen=True)
class NoiseEstimate:
    """Residual of a perfect model below the cutoff frequency, per joint.

    Attributes:
        floor: RMS √(s² + e²) that a right model leaves, of noise s, which differs from period to
            period, and of quantisation e, which does not [N m], shape (n,); the resolution of
            torque where it is 0 throughout.
        method: "periods" if it was found by repetition, else "differences", the contract's name of
            an estimate by the spectral density above the motion.
        steps: RMS e of the residual by quantisation of positions and torque [N m], shape (n,).
        periods: By recording that repeats: its period and window.
    """

    floor: FloatArray
    method: str
    steps: FloatArray
    periods: Mapping[str, Period] = field(default_factory=dict)


def estimate_noise(
    model: IdentificationModel,
    motions: Motions,
    residuals: Sequence[FloatArray],
    recordings: Sequence[Recording],
) -> NoiseEstimate:
    """Estimate the noise of residuals, of shapes (N, n) [N m], from the part that does not repeat.

    Only the rows at which a joint moves count. Where nothing repeats, the residual's spectral
    density above the motion stands for that of the noise, which is not larger than the residual.
    """
    moving = np.concatenate([motion.moving for motion in motions])
    rows = np.concatenate(quantization_residuals(model, motions))
    steps = rms(rows, np.tile(moving, (DRAWS, 1)))
    residuals = [
        np.where(motion.moving, residual, 0.0)
        for motion, residual in zip(motions, residuals, strict=True)
    ]
    periods = {
        recording.source: period
        for recording in recordings
        if (period := estimate_period(recording))
    }
    squares = [
        square
        for motion, residual in zip(motions, residuals, strict=True)
        if motion.segment.source in periods
        and (square := _noise_square(motion, residual, periods[motion.segment.source])) is not None
    ]
    spread = _repetition_noise(squares, len(steps))
    is_repeated = np.isfinite(spread)
    if not is_repeated.all():
        spread = np.where(is_repeated, spread, _spectral_noise(motions, residuals))
    floor = np.sqrt(np.maximum(spread, 1e-12) ** 2 + steps**2)
    # the density may be larger above the motion than below, as of positions recorded in steps
    largest = np.maximum(rms(np.concatenate(residuals), moving), 1e-12)
    floor = np.where(is_repeated, floor, np.minimum(floor, largest))
    torque = np.concatenate([motion.torque for motion in motions])
    floor = np.where(torque.any(axis=0), floor, torque_resolution(torque))
    return NoiseEstimate(floor, "periods" if squares else "differences", steps, periods)


def _repetition_noise(squares: Sequence[FloatArray], joints: int) -> FloatArray:
    """RMS of mean squares (n,) of recordings, NaN where none shows the noise of a joint; (n,)."""
    known = np.reshape(squares, (-1, joints))
    count = np.isfinite(known).sum(axis=0)
    total = np.nansum(known, axis=0)
    return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _spectral_noise(motions: Motions, residuals: Sequence[FloatArray]) -> FloatArray:
    """RMS of white noise below the lower cutoff, with the density above the motion, shape (n,)."""
    from scipy import signal  # slow to import

    squares, rows = np.zeros((2, residuals[0].shape[1]))
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
        # rows at rest are zero, so that the power is that of the rows in motion
        rows += motion.moving.sum(axis=0)
    return np.asarray(np.sqrt(np.maximum(squares / np.maximum(rows, 1.0), 1e-24)))


def _noise_square(
    motion: RecordedMotion, residual: FloatArray, period: Period
) -> FloatArray | None:
    """Mean square change from a period to the next without warming, (n,); None if too short.

    NaN for joints that move in too few rows.
    """
    first, later, inside, moving = _two_periods(motion, residual, period)
    rows = len(residual) - len(later)
    if inside.sum() < max(MIN_REPEATED_SHARE * rows, MIN_REPEATED_ROWS):
        return None
    change = (later - first)[inside] / np.sqrt(2.0)
    return _square_without_drift(change, motion, inside, moving[inside])


def _two_periods(
    motion: RecordedMotion, residual: FloatArray, period: Period
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """A residual and that one period later, and where both lie inside the window and in motion.

    Shapes (m, n), (m, n), (m,) and (m, n).
    """
    seconds, (low, high) = period
    rate = 1.0 / (motion.time[1] - motion.time[0])
    rows = int(np.floor(seconds * rate))
    part = seconds * rate - rows  # of a row
    later = with_response(residual, lambda k: np.exp(2j * np.pi * part * np.fft.rfftfreq(k)))[rows:]
    inside = (motion.time[: len(later)] >= low) & (
        motion.time[rows : rows + len(later)] + 1.0 / rate <= high
    )
    moving = motion.moving[: len(later)] & motion.moving[rows : rows + len(later)]
    return residual[: len(later)], later, inside, moving


def products_of_periods(
    periods: Mapping[str, Period], motions: Motions, residual: FloatArray
) -> list[FloatArray]:
    """Return the products of a residual in two subsequent periods, by joint, (m,) [(N m)²].

    Their mean is the power that repeats in motion; empty if nothing repeats. The residual is of
    shape (N, n).
    """
    out = [[np.zeros(0)] for _ in range(residual.shape[1])]
    for motion, part in zip(motions, split_by_motion(residual, motions), strict=True):
        if motion.segment.source not in periods:
            continue
        first, later, inside, moving = _two_periods(motion, part, periods[motion.segment.source])
        for j, products in enumerate(out):
            counted = inside & moving[:, j]
            products.append(later[counted, j] * first[counted, j])
    return [np.concatenate(products) for products in out]


def _square_without_drift(
    change: FloatArray, motion: RecordedMotion, inside: BoolArray, moving: BoolArray
) -> FloatArray:
    """Mean square of a difference of periods without that of friction that warms up, shape (n,).

    NaN for joints that are in motion in too few rows of both periods, `moving`, shape (m, n).
    """
    t = np.linspace(-1.0, 1.0, len(change))[:, None]
    groups = []
    for j in range(change.shape[1]):
        friction = motion.lowpass(np.column_stack([motion.sign(j), motion.samples.dq[:, j]]))[
            : len(inside)
        ][inside]
        columns = np.hstack([friction, friction * t])
        groups.append(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
    usual, remainder = np.ones(len(change), bool), np.zeros(change.shape)
    out = np.full(change.shape[1], np.nan)
    for _ in range(WINDOW_PASSES):
        for j, columns in enumerate(groups):
            rows = usual & moving[:, j]
            remainder[:, j] = (
                change[:, j]
                - columns @ np.linalg.lstsq(columns[rows], change[rows, j], rcond=1e-8)[0]
            )
        usual = _usual_rows(np.square(remainder), moving)
    for j, columns in enumerate(groups):
        rows = usual & moving[:, j]
        if (count := int(rows.sum())) >= MIN_REPEATED_ROWS:
            out[j] = np.sum(np.square(remainder[rows, j])) / (count - columns.shape[1])
    return out


def _usual_rows(square: FloatArray, moving: BoolArray) -> BoolArray:
    """Rows outside the two longest runs of windows with large power on some joint: (N, n) -> (N,).

    A contact happens in one period, which differs from the one before and the one after. Timestamp
    jitter has large power wherever the motion is fast, in short windows, and is noise. The power of
    a joint in a window is that of its rows in motion; a window without any says nothing of it.
    """
    count = max(1, min(WINDOWS, len(square) // 8))
    parts = np.array_split(np.where(moving, square, 0.0), count)
    rows = np.array([part.sum(axis=0) for part in np.array_split(moving, count)])
    means = np.array([part.sum(axis=0) for part in parts]) / np.maximum(rows, 1)
    large = np.zeros(count, bool)
    for mean, is_known in zip(means.T, rows.T > 0, strict=True):
        if is_known.any():
            large |= mean > MAX_WINDOW_RATIO * np.quantile(mean[is_known], USUAL_QUANTILE)
    kept = np.ones(len(parts), bool)
    for start, end in sorted(true_runs(large).tolist(), key=lambda e: e[0] - e[1])[:2]:
        kept[start:end] = False
    return np.repeat(kept, [len(part) for part in parts])


def estimate_period(recording: Recording) -> Period | None:
    """Return the stated or visible period of a recording and its window; None if it has none."""
    if recording.repetition is None:
        repetition = periodicity.find_period(recording, None)
        return None if repetition is None else (repetition.period, repetition.window)
    period, (start, end) = recording.repetition
    return recording.repetition if end - start >= MIN_PERIODS * period else None


def quantization_residuals(model: IdentificationModel, motions: Motions) -> tuple[FloatArray, ...]:
    """Draw `DRAWS` residuals (N, n) [N m] of the base model by quantisation alone.

    The error of each position is unknown, but not its distribution: smoothed positions are
    quantised again, with random origins.
    """
    rng = np.random.default_rng(0)
    smooth = [position_errors.smooth_positions(motion) for motion in motions]
    exact = [
        filtered_regressor(model, positions, motion.band)[0]
        for motion, positions in zip(motions, smooth, strict=True)
    ]
    torque_errors = [_torque_error(motion) for motion in motions]

    def draw() -> Iterator[FloatArray]:
        for motion, positions, gamma, error in zip(
            motions, smooth, exact, torque_errors, strict=True
        ):
            if not motion.steps.any():
                yield error
                continue
            quantized = position_errors.quantized_positions(motion, positions, rng)
            change = gamma - filtered_regressor(model, quantized, motion.band)[0]
            yield change[motion.kept] @ motion.theta + error

    return tuple(np.concatenate(list(draw())) for _ in range(DRAWS))


def _torque_error(motion: RecordedMotion) -> FloatArray:
    """Residual of a motion by the quantisation of its torque, zero where no step shows, (N, n).

    The torque of the model is rounded to multiples of the step. Noise smooths the steps: the error
    that repeats with the motion is the mean over the noise that is seen above the cutoff.
    """
    torque, model = motion.segment.torque, motion.motor_torque
    step = encoder_resolution.estimate_resolution(torque)
    coarse = step > 0.0
    unit = np.where(coarse, step, 1.0)
    deviation = torque - model
    rough = deviation - motion.band.transform(deviation).filter(Grid.RECORDED)
    squares = [np.mean(part**2, axis=0) for part in np.array_split(rough, WINDOWS)]
    usual = np.quantile(squares, USUAL_QUANTILE, axis=0)
    noise = np.sqrt(np.maximum(usual - step**2 / 12.0, 0.0))
    rounded = np.mean([np.round((model + z * noise) / unit) for z in NORMAL_QUANTILES], axis=0)
    return motion.lowpass(np.where(coarse, rounded * unit - model, 0.0))
