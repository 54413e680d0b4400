"""The noise of the torque equations: how large in each joint, how much alike in them, and how coloured in time.

Rows are weighted by Σ^{-1/2}, Σ the covariance over the joints at one time. Colour is left out of the weights, because a residual
that is physics and not noise would turn a whitening filter against the low frequencies that matter, but not out of the
uncertainty: the spectrum of the weighted residual says how uncertain every score is. A fit takes away most where the motion has
its power; each frequency's power is therefore divided by the degrees of freedom left there, and what differs between repeated
periods, which no fit has touched, is added where it tells the same story.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .regression import TorqueEquations

Array = np.ndarray
RESOLUTION = 0.1
"""Width of a spectrum's bins, at the least [Hz]; of LONG recordings five times as much."""
LONG = 10_000
FREEDOM = 12.0
"""Degrees of freedom that a density is averaged over, at the least."""
WINDOW = 2048
"""Rows of a long stretch that are transformed together."""
DOUBT = 1e-3
"""Probability, were the model right, of a residual so much larger than the spread between periods that the spread is left out."""


@dataclass(frozen=True)
class NoiseSpectrum:
    """Densities of n series of weighted noise; their mean up to half the rate of rows is the variance.

    frequency: Shape (F,) [Hz]. density: Shape (F, n). repeated: joints for which repeated periods bear it out. Shape (n,).
    """

    frequency: Array
    density: Array
    repeated: Array


def covariance_root(residual: Array, leverage: Array) -> Array:
    """C with Σ = C Cᵀ, of residuals over the joints. leverage: trace of the hat matrix per joint. Shape (n, n) [N m]."""
    deviation = np.sqrt(
        np.maximum(np.sum(residual**2, axis=0) / np.maximum(len(residual) - leverage, 1.0), 1e-300)
    )
    unit = residual / np.sqrt(np.mean(residual**2, axis=0))
    return np.linalg.cholesky(unit.T @ unit / len(residual)) * deviation[:, None]


def noise_spectrum(
    equations: TorqueEquations, series: Array, rows: Array, scale: Array, instruments: Array | None = None
) -> tuple[NoiseSpectrum, Array]:
    """Densities of weighted residuals, and the covariance of the scores Σₜ Zₜᵀ uₜ that noise of such densities has (Parseval).

    rows: weighted regressor in coordinates where the information is 1. Shape (N, n, r). instruments: Z where it is another. Shape
    (N, n, q). Returns the covariance in Z's coordinates. Shape (q, q).
    """
    n, rate = equations.n, equations.rate
    longest = max(length for _, length, _ in _windows(equations))
    finest = RESOLUTION if len(equations) < LONG else 5.0 * RESOLUTION
    count = max(2, int(0.5 * rate / max(finest, rate / longest)))
    power, freedom, spread, repeats = (np.zeros((count, n)) for _ in range(4))
    scores = rows if instruments is None else instruments
    grams = np.zeros((count, n, scores.shape[2], scores.shape[2]))
    inverse = np.linalg.inv(scale)
    for part, length, (periods, deviations) in _windows(equations):
        # the noise of a mean period goes round; of a long window the ends don't matter
        points = length if periods or length >= WINDOW // 2 else 2 * length
        where = np.minimum(
            (np.arange(points // 2 + 1) / points * 2.0 * count).astype(int), count - 1
        )
        sides = np.full(len(where), 2.0)
        sides[0], sides[-1] = 1.0, 2.0 if points % 2 else 1.0
        share = length / points
        for joint in range(n):
            own = np.abs(np.fft.rfft(series[part, joint], points)) ** 2 / length
            X = _transformed(rows[part, joint], points)
            taken = np.sum(np.abs(X) ** 2, axis=1) / length
            np.add.at(power[:, joint], where, share * own)
            np.add.at(freedom[:, joint], where, share * np.maximum(1.0 - taken, 0.0))
            Z = X if instruments is None else _transformed(instruments[part, joint], points)
            Z = Z * np.sqrt(sides / points)[:, None]
            for k, first in zip(*np.unique(where, return_index=True), strict=True):
                block = Z[first : first + int(np.sum(where == k))]
                parted = np.vstack([block.real, block.imag])
                grams[k, joint] += parted.T @ parted
        if deviations is not None:
            between = np.abs(deviations @ inverse.T) ** 2 / length / periods
            np.add.at(spread, where[1 : 1 + between.shape[1]], between.sum(axis=0))
            np.add.at(repeats, where[1 : 1 + between.shape[1]], float(periods - 1))
    alike = _alike(power, freedom, spread, repeats)
    density = _smoothed(power + alike * spread, freedom + alike * repeats)
    found = NoiseSpectrum((np.arange(count) + 0.5) * 0.5 * rate / count, density, alike)
    return found, np.einsum("fj,fjpq->pq", density, grams)


def _windows(equations: TorqueEquations) -> Iterator[tuple[slice, int, tuple[int, Array | None]]]:
    """Stretches, long ones in parts that count as independent: their rows, how many, periods and deviations."""
    for stretch, periods, deviations in zip(
        equations.stretches(), equations.periods, equations.repeats, strict=True
    ):
        length = stretch.stop - stretch.start
        parts = 1 if periods else -(-length // WINDOW)
        edges = np.linspace(stretch.start, stretch.stop, parts + 1).astype(int)
        for low, high in itertools.pairwise(edges):
            yield slice(low, high), int(high - low), (periods, deviations)


def _transformed(rows: Array, points: int) -> Array:
    """Fourier coefficients along the first axis; columns that are zero by structure stay so."""
    seen = np.any(rows != 0.0, axis=0)
    out = np.zeros((points // 2 + 1, rows.shape[1]), complex)
    out[:, seen] = np.fft.rfft(np.ascontiguousarray(rows[:, seen].T), points).T
    return out


def _alike(power: Array, freedom: Array, spread: Array, repeats: Array) -> Array:
    """Joints whose residual is no larger than the spread between periods explains (an F test)."""
    from scipy import stats  # slow to import

    total = repeats.sum(axis=0)
    if not total.any():
        return np.zeros(power.shape[1], bool)
    ratio = (
        power.sum(axis=0)
        / freedom.sum(axis=0)
        / np.maximum(spread.sum(axis=0) / np.maximum(total, 1e-300), 1e-300)
    )
    return np.asarray(stats.f.sf(ratio, 2.0 * freedom.sum(axis=0), 2.0 * total) > DOUBT)


def _smoothed(power: Array, freedom: Array) -> Array:
    """Power over freedom, each bin with as many neighbours as it takes to have FREEDOM of them."""
    out = np.empty_like(power)
    count = len(power)
    P, F = (np.vstack([np.zeros(x.shape[1]), np.cumsum(x, axis=0)]) for x in (power, freedom))
    for joint in range(power.shape[1]):
        enough = min(FREEDOM, 0.5 * F[-1, joint])
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
