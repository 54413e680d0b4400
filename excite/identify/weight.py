"""How much the prior counts: γ by evidence, or by what predicts blocks of the recording that were left out.

Evidence: with ψ ~ N(ψ₀, (2γG)⁻¹) the whitened data R θ̂ ~ N(R Bψ₀, 1 + R B (2γG)⁻¹ (R B)ᵀ); γ is where that is most likely
(MacKay 1992). Bodies and drives have a γ each: a URDF knows masses to some per cent and friction often not at all.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..parameters import Parameters
from .consistent import Prior, metric_matrix

Array = np.ndarray
FINE = {"xatol": 0.02, "fatol": 1e-3}
STARTS = ((4.0, -12.0), (2.0, 0.0))
RANGE = ((1e-4, 1e6), (1e-14, 1e6))
"""γ of bodies and of drives at the least and at the most. The scale of a drive whose nominal value is 0 may be off by a thousand."""


def evidence(parameters: Parameters, root: Array, target: Array, prior: Prior) -> tuple[float, float]:
    """The most likely (γ of bodies, γ of drives), within RANGE. root: R B. Shape (m, P). target: R θ̂. Shape (m,)."""
    from scipy import optimize  # slow to import

    edge = 10 * parameters.bodies
    surprise = target - root @ prior.nominal
    unit = metric_matrix(parameters, Prior(prior.nominal, prior.distance, 0.5, np.full(parameters.count - edge, 0.5)))
    half = np.zeros_like(unit)  # x with ψ − ψ₀ = half x has covariance 1/(2γ)
    for i in range(0, edge, 10):
        half[i : i + 10, i : i + 10] = np.linalg.inv(np.linalg.cholesky(unit[i : i + 10, i : i + 10])).T
    index = np.arange(edge, parameters.count)
    half[index, index] = unit[index, index] ** -0.5
    rows = np.concatenate([root @ half, surprise[:, None]], axis=1)

    def unlikely(logs: Array) -> float:
        weights = np.repeat(2.0 * np.exp(logs), np.array([edge, parameters.count - edge]))
        stacked = np.vstack([rows, np.concatenate([np.diag(np.sqrt(weights)), np.zeros((len(weights), 1))], axis=1)])
        R = np.linalg.qr(stacked, mode="r")
        return float(np.sum(np.log(np.abs(np.diag(R)[:-1]))) - 0.5 * np.sum(np.log(weights)) + 0.5 * R[-1, -1] ** 2)

    bounds = [(float(low), float(high)) for low, high in np.log(RANGE)]
    found = min(
        (optimize.minimize(unlikely, start, method="Nelder-Mead", bounds=bounds, options=FINE) for start in STARTS),
        key=lambda result: float(result.fun),
    )
    bodies, drives = np.exp(found.x)
    return float(bodies), float(drives)


def held_out(fit: Callable[[float, int], float], start: float, folds: int) -> tuple[float, list[tuple[float, float]]]:
    """γ with the least error on blocks left out, and every (γ, error) tried. fit: (γ, fold) -> squared error there."""
    tried = [(g, sum(fit(g, fold) for fold in range(folds))) for g in start * 10.0 ** np.arange(-4.0, 4.5, 0.5)]
    return min(tried, key=lambda pair: pair[1])[0], tried
