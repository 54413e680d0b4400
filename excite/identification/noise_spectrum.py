"""Noise of the torque equations: variance per joint, correlation of joints, and spectrum.

Rows are weighted by Σ^{-1/2}, Σ the covariance over the joints at one time. The spectrum is left
out of the weights, because a residual that is unmodelled physics would turn a whitening filter
against the low frequencies that matter. It enters the uncertainty: the spectrum of the weighted
residual gives the covariance of every score. As a fit explains most of the power at the
frequencies of the motion, the power at each frequency is divided by the degrees of freedom that
remain there. Deviations between repeated periods, which no fit has changed, are added where they
agree with the residual.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._types import BoolArray, FloatArray, IntArray
from .regression import RowLayout

MIN_BIN_WIDTH_HZ = 0.1
"""Smallest width of a bin of the spectrum [Hz]."""
LONG_RECORDING_ROWS = 10_000
"""Number of rows from which on bins are LONG_RECORDING_BIN_FACTOR times as wide, to save time."""
LONG_RECORDING_BIN_FACTOR = 5.0
"""Width of a bin for long recordings over MIN_BIN_WIDTH_HZ."""
MIN_BIN_FREEDOM = 12.0
"""Degrees of freedom over which a density is averaged, at least: its relative error is then
√(2/12) = 0.4."""
MAX_GRAM_NUMBERS = 1 << 25
"""Numbers of the products of scores that are held at once (256 MiB); joints are processed in groups
of that size."""
WINDOW_ROWS = 2048
"""Number of rows of a long segment that are transformed together."""
MIN_AGREEMENT_PROBABILITY = 1e-3
"""p-value below which a residual is larger than the deviations between periods, which are then not
used for that joint."""


@dataclass(frozen=True)
class NoiseSpectrum:
    """Spectral densities of weighted noise; their mean up to the Nyquist frequency is the variance.

    Attributes:
        frequency: Centres of the bins. Shape (F,) [Hz].
        density: Density per joint. Shape (F, n).
        repeated: True for joints whose repeated periods contributed. Shape (n,).
    """

    frequency: FloatArray
    density: FloatArray
    repeated: BoolArray


def covariance_root(
    residual: FloatArray, leverage: FloatArray, rows: IntArray, resolution: FloatArray
) -> FloatArray:
    """Estimate C with Σ = C Cᵀ, the covariance of residuals over the joints.

    Args:
        residual: Residual torque, 0 in rows that do not count. Shape (N, n) [N m].
        leverage: Trace of the hat matrix per joint. Shape (n,).
        rows: Number of rows of each joint that count. Shape (n,).
        resolution: Smallest standard deviation of each joint's torque error, that of its rounding,
            which no other joint shares. Shape (n,) [N m].

    Returns:
        Shape (n, n) [N m].
    """
    variance = np.sum(residual**2, axis=0) / np.maximum(rows - leverage, 1.0)
    covariance = residual.T @ residual / len(residual) + np.diag(resolution**2)
    size = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(size, size)
    return np.linalg.cholesky(correlation) * np.sqrt(variance + resolution**2)[:, None]


def noise_spectrum(
    equations: RowLayout,
    residual: FloatArray,
    rows: FloatArray,
    noise_root: FloatArray,
    instruments: FloatArray | None = None,
    resolution: FloatArray | None = None,
) -> tuple[NoiseSpectrum, FloatArray]:
    """Estimate the spectrum of weighted residuals and the covariance of the scores Σₜ Zₜᵀ uₜ.

    The covariance follows from the densities by Parseval's theorem.

    Args:
        equations: Layout of the rows, as of torque equations.
        residual: Weighted residual u. Shape (N, n).
        rows: Weighted regressor in coordinates where the information is 1. Shape (N, n, r).
        noise_root: C with Σ = C Cᵀ. Shape (n, n) [N m].
        instruments: Z if it is not the regressor. Shape (N, n, q).
        resolution: Smallest standard deviation of each joint's torque error, whose density is
            added; 0 by default. Shape (n,) [N m].

    Returns:
        The spectrum, and the covariance of the scores. Shape (q, q).
    """
    n, rate = equations.n, equations.rate
    longest = max(length for _, length, _ in _windows(equations))
    finest = (
        MIN_BIN_WIDTH_HZ
        if len(equations) < LONG_RECORDING_ROWS
        else LONG_RECORDING_BIN_FACTOR * MIN_BIN_WIDTH_HZ
    )
    count = max(2, int(0.5 * rate / max(finest, rate / longest)))
    rounding = np.zeros(n)
    if resolution is not None:
        rounding = np.sum((np.linalg.inv(noise_root) * resolution) ** 2, axis=1)
    scores = rows if instruments is None else instruments
    gram_numbers = count * scores.shape[2] ** 2
    group_size = max(1, MAX_GRAM_NUMBERS // gram_numbers)
    densities, agreements = [], []
    covariance: FloatArray = np.zeros((scores.shape[2],) * 2)
    for start in range(0, n, group_size):
        joints = range(start, min(start + group_size, n))
        density, agrees, grams = _group_spectrum(
            equations, residual, rows, noise_root, instruments, count, joints
        )
        density = density + rounding[joints]
        densities.append(density)
        agreements.append(agrees)
        covariance += np.einsum("fj,fjpq->pq", density, grams)
    spectrum = NoiseSpectrum(
        (np.arange(count) + 0.5) * 0.5 * rate / count,
        np.concatenate(densities, axis=1),
        np.concatenate(agreements),
    )
    return spectrum, covariance


def _group_spectrum(
    equations: RowLayout,
    residual: FloatArray,
    rows: FloatArray,
    noise_root: FloatArray,
    instruments: FloatArray | None,
    count: int,
    joints: range,
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Densities of some joints, agreement with periods, and scores' products in each bin.

    Args:
        equations: Layout of the rows, as of torque equations.
        residual: Weighted residual. Shape (N, n).
        rows: Weighted regressor. Shape (N, n, r).
        noise_root: C with Σ = C Cᵀ. Shape (n, n) [N m].
        instruments: Z if it is not the regressor. Shape (N, n, q).
        count: Number of bins F.
        joints: The m joints.

    Returns:
        Densities, shape (F, m); True where repeated periods contribute, shape (m,); ZᵀZ, shape
        (F, m, q, q).
    """
    width = (rows if instruments is None else instruments).shape[2]
    power, freedom, spread, repeats = (np.zeros((count, len(joints))) for _ in range(4))
    grams = np.zeros((count, len(joints), width, width))
    inverse = np.linalg.inv(noise_root)
    for part, length, (periods, deviations) in _windows(equations):
        # the noise of a mean period is periodic; of a long window the ends do not matter
        points = length if periods or length >= WINDOW_ROWS // 2 else 2 * length
        bins = np.minimum(
            (np.arange(points // 2 + 1) / points * 2.0 * count).astype(int), count - 1
        )
        sides = np.full(len(bins), 2.0)
        sides[0], sides[-1] = 1.0, 2.0 if points % 2 else 1.0
        share = length / points
        for k, joint in enumerate(joints):
            periodogram = np.abs(np.fft.rfft(residual[part, joint], points)) ** 2 / length
            X = _transformed(rows[part, joint], points)
            fitted = np.sum(np.abs(X) ** 2, axis=1) / length
            np.add.at(power[:, k], bins, share * periodogram)
            counted = float(np.mean(equations.moving[part, joint]))
            np.add.at(freedom[:, k], bins, share * np.maximum(counted - fitted, 0.0))
            Z = X if instruments is None else _transformed(instruments[part, joint], points)
            Z = Z * np.sqrt(sides / points)[:, None]
            for f, first in zip(*np.unique(bins, return_index=True), strict=True):
                block = Z[first : first + int(np.sum(bins == f))]
                parted = np.vstack([block.real, block.imag])
                grams[f, k] += parted.T @ parted
        if deviations is not None:
            between = np.abs(deviations @ inverse.T) ** 2 / length / periods
            between = between[:, :, joints.start : joints.stop]
            np.add.at(spread, bins[1 : 1 + between.shape[1]], between.sum(axis=0))
            np.add.at(repeats, bins[1 : 1 + between.shape[1]], float(periods - 1))
    agrees = _agrees_with_periods(power, freedom, spread, repeats)
    return _smoothed(power + agrees * spread, freedom + agrees * repeats), agrees, grams


def _windows(
    equations: RowLayout,
) -> Iterator[tuple[slice, int, tuple[int, NDArray[np.complex128] | None]]]:
    """Yield segments, long ones in windows treated as independent.

    Yields:
        Rows, number of rows, and number of periods with their deviations.
    """
    for stretch, periods, deviations in zip(
        equations.stretches(), equations.periods, equations.repeats, strict=True
    ):
        length = stretch.stop - stretch.start
        parts = 1 if periods else -(-length // WINDOW_ROWS)
        edges = np.linspace(stretch.start, stretch.stop, parts + 1).astype(int)
        for low, high in itertools.pairwise(edges):
            yield slice(low, high), int(high - low), (periods, deviations)


def _transformed(rows: FloatArray, points: int) -> NDArray[np.complex128]:
    """Fourier coefficients along the first axis; columns that are zero throughout are skipped."""
    nonzero = np.any(rows != 0.0, axis=0)
    out = np.zeros((points // 2 + 1, rows.shape[1]), complex)
    out[:, nonzero] = np.fft.rfft(np.ascontiguousarray(rows[:, nonzero].T), points).T
    return out


def _agrees_with_periods(
    power: FloatArray, freedom: FloatArray, spread: FloatArray, repeats: FloatArray
) -> BoolArray:
    """True for joints whose residual is not larger than the deviations between periods (F test)."""
    from scipy import stats  # slow to import

    total = repeats.sum(axis=0)
    if not total.any():
        return np.zeros(power.shape[1], bool)
    ratio = (
        power.sum(axis=0)
        / freedom.sum(axis=0)
        / np.maximum(spread.sum(axis=0) / np.maximum(total, 1e-300), 1e-300)
    )
    probability = stats.f.sf(ratio, 2.0 * freedom.sum(axis=0), 2.0 * total)
    return np.asarray(probability > MIN_AGREEMENT_PROBABILITY)


def _smoothed(power: FloatArray, freedom: FloatArray) -> FloatArray:
    """Power over freedom; a bin is joined with neighbours until it has MIN_BIN_FREEDOM."""
    out = np.empty_like(power)
    count = len(power)
    P, F = (np.vstack([np.zeros(x.shape[1]), np.cumsum(x, axis=0)]) for x in (power, freedom))
    for joint in range(power.shape[1]):
        enough = min(MIN_BIN_FREEDOM, 0.5 * F[-1, joint])
        for k in range(count):
            reach = 0
            while True:
                low, high = max(0, k - reach), min(count, k + reach + 1)
                if 2.0 * (F[high, joint] - F[low, joint]) >= enough or high - low == count:
                    break
                reach += 1
            out[k, joint] = (P[high, joint] - P[low, joint]) / max(
                F[high, joint] - F[low, joint], 1e-300
            )
    return out
