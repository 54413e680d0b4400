"""Optimality criteria: functions of the spectrum of the information matrix.

λ = eigenvalues of I·H₀⁻¹ (geometric, Lee, Wensing & Park, eq. 20) or of I in an orthonormal base (plain). All smooth criteria are
one family: with s_ρ = Σ λ^{−ρ}, A is ρ = 1, D is ρ → 0 and E is ρ → ∞ of log(s_ρ)/ρ; the condition number joins both
ends of the spectrum. Each has an exact gradient with respect to the information matrix.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ..robot.base_parameters import Base

Array = np.ndarray


class Criterion(Enum):
    """What a design optimises; the value says the command line's name."""

    A = "a"
    D = "d"
    E = "e"
    COND = "cond"
    COND_REGRESSOR = "cond_regressor"


MAXIMISED_CRITERIA = (Criterion.D, Criterion.E)
MIN_SPECTRUM_RATIO = 1e-6
"""Spectra narrower than this keep ten digits when the matrix is squared."""


@dataclass(frozen=True)
class Weighting:
    """The matrices that turn regressor rows into information in coordinates where the criterion is a spectrum.

    columns: W, information is Wᵀ (Σ Yᵀ Σ⁻¹ Y) W. Shape (P, p).
    noise: standard deviation of torque per joint. Shape (n,) [N m].
    support: per joint the parameters its torque can depend on, its descendants' and its own drive's; None for all.
    """

    columns: Array
    noise: Array
    support: tuple[Array, ...] | None = None

    def rows(self, Y: Array) -> Array:
        """A with AᵀA the mean information per sample. Shapes (N, n, P) -> (n N, p), joint by joint."""
        samples, joints, count = Y.shape
        scale = 1.0 / (np.sqrt(samples) * self.noise)
        if self.support is None:
            return (
                np.ascontiguousarray(np.swapaxes(Y, 0, 1) * scale[:, None, None]).reshape(-1, count)
                @ self.columns
            )
        out = np.empty((joints, samples, self.columns.shape[1]))
        for j, seen in enumerate(self.support):
            np.matmul(Y[:, j, seen], scale[j] * self.columns[seen], out=out[j])
        return out.reshape(joints * samples, -1)

    def seed(self, Y: Array, slope: Array) -> Array:
        """Gradient with respect to Y of a function of AᵀA whose gradient is `slope`. Shapes (N, n, P), (p, p) -> (N, n, P)."""
        kernel = self.columns @ slope @ self.columns.T
        factor = 2.0 / (len(Y) * self.noise**2)
        if self.support is None:
            return (Y @ kernel) * factor[:, None]
        out = np.zeros(Y.shape)
        for j, seen in enumerate(self.support):
            out[:, j, seen] = Y[:, j, seen] @ (factor[j] * kernel[np.ix_(seen, seen)])
        return out

    def root(self, given: Array) -> Array:
        """G with GᵀG = Wᵀ given W, `given` an information matrix in standard parameters. Shapes (P, P) -> (p, p)."""
        values, vectors = np.linalg.eigh(self.columns.T @ given @ self.columns)
        return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))).T)


def criterion_weighting(criterion: Criterion, base: Base, noise: Array, *, plain: bool) -> Weighting:
    """Coordinates in which `criterion` is evaluated."""
    if criterion is Criterion.COND_REGRESSOR:
        return Weighting(base.selection, np.ones_like(noise))
    return Weighting(base.plain if plain else base.geometric, noise)


def criterion_value(criterion: Criterion, spectrum: Array) -> float:
    """The criterion of a spectrum in ascending order. inf or 0 where a direction is not seen at all."""
    low, high = float(spectrum[0]), float(spectrum[-1])
    if criterion is Criterion.E:
        return max(low, 0.0)
    if low <= 0.0:
        return -np.inf if criterion is Criterion.D else np.inf
    if criterion is Criterion.A:
        return float(np.sum(1.0 / spectrum))
    if criterion is Criterion.D:
        return float(np.sum(np.log(spectrum)))
    return float(np.sqrt(high / low)) if criterion is Criterion.COND_REGRESSOR else high / low


def _spectrum(rows: Array) -> tuple[Array, Array]:
    """Eigenvalues and vectors of AᵀA; from A itself where directions are seen so unequally that its square loses digits."""
    square = rows.T @ rows
    try:
        pivots = np.diag(np.linalg.cholesky(square)) ** 2
    except np.linalg.LinAlgError:
        pivots = np.zeros(1)
    if (
        pivots.min() > MIN_SPECTRUM_RATIO * pivots.max()
    ):  # cheap, and hardly ever wrong; the eigenvalues have the last word
        values, vectors = np.linalg.eigh(square)
        if values[0] > MIN_SPECTRUM_RATIO * values[-1]:
            return values, vectors
    _, singular, right = np.linalg.svd(np.linalg.qr(rows, mode="r"))
    return np.maximum(singular**2, 1e-28 * singular[0] ** 2), right.T


def smooth_objective(criterion: Criterion, rows: Array, sharpness: float) -> tuple[float, Array]:
    """A smooth function of the information AᵀA to minimise, and its gradient with respect to that matrix.

    rows: A. Shape (m, p), m ≥ p.
    sharpness: ρ, how closely the extreme eigenvalues are followed by E and the condition numbers; as it
        grows the value tends to log(1/e), log cond or log cond². A (log a) and D (−d/p) are exact.
    """
    values, vectors = _spectrum(rows)
    logs = np.log(values)
    if criterion is Criterion.D:
        return -float(np.mean(logs)), -(vectors / (values * len(values))) @ vectors.T
    if criterion is Criterion.A:
        objective, slope = _soft_max(-logs, 1.0)
        return objective, -(vectors * (slope / values)) @ vectors.T
    low, low_slope = _soft_max(-logs, sharpness)
    if criterion is Criterion.E:
        return low, -(vectors * (low_slope / values)) @ vectors.T
    high, high_slope = _soft_max(logs, sharpness)
    return low + high, (vectors * ((high_slope - low_slope) / values)) @ vectors.T


def _soft_max(values: Array, sharpness: float) -> tuple[float, Array]:
    """log Σ exp(ρ v) / ρ and its gradient."""
    top = float(values.max())
    weights = np.exp(sharpness * (values - top))
    total = float(weights.sum())
    return top + np.log(total) / sharpness, weights / total


def information_eigenvalues(rows: Array) -> Array:
    """Ascending eigenvalues of AᵀA. Shapes (m, p) -> (p,)."""
    singular = np.linalg.svd(np.linalg.qr(rows, mode="r"), compute_uv=False)
    out = np.zeros(rows.shape[1])
    out[: len(singular)] = singular**2
    return np.sort(out)


def evaluate_criteria(
    blocks: Array | Iterable[Array], base: Base, noise: Array, given: Array | None = None
) -> dict[str, object]:
    """Evaluate all criteria of one motion, per sample, as the contract's `criteria` states them.

    Args:
        blocks: The regressor Y of all samples, or of consecutive ones block by block. Shape
            (N, n, P).
        base: Base parameters.
        noise: Standard deviation of torque per joint. Shape (n,) [N m].
        given: Information of earlier recordings over this motion's number of samples, in standard
            parameters. Shape (P, P).

    Returns:
        {"geometric": {criterion: value}, "plain": {criterion: value}, "cond_regressor": value}.
    """
    weights = {
        "geometric": criterion_weighting(Criterion.A, base, noise, plain=False),
        "plain": criterion_weighting(Criterion.A, base, noise, plain=True),
        "cond_regressor": criterion_weighting(Criterion.COND_REGRESSOR, base, noise, plain=True),
    }
    rows = _rows_of_all(weights, [blocks] if isinstance(blocks, np.ndarray) else blocks)
    out: dict[str, object] = {}
    for name in ("geometric", "plain"):
        known = [] if given is None else [weights[name].root(given)]
        eigenvalues = information_eigenvalues(np.vstack([rows[name], *known]))
        out[name] = {
            c.value: criterion_value(c, eigenvalues)
            for c in Criterion
            if c is not Criterion.COND_REGRESSOR
        }
    out["cond_regressor"] = criterion_value(
        Criterion.COND_REGRESSOR, information_eigenvalues(rows["cond_regressor"])
    )
    return out


def _rows_of_all(
    weights: Mapping[str, Weighting], blocks: Iterable[Array]
) -> dict[str, Array]:
    """A with AᵀA the mean information per sample of all blocks, for each weighting. Shape (m, p)."""
    rows: dict[str, Array] = {}
    count = 0
    for Y in blocks:
        here = {name: weighting.rows(Y) for name, weighting in weights.items()}
        total = count + len(Y)
        # A of both parts stacked, each scaled by the root of its share of the samples, and reduced
        shares = np.sqrt(count / total), np.sqrt(len(Y) / total)
        rows = (
            {n: _triangle(np.vstack([shares[0] * rows[n], shares[1] * here[n]])) for n in here}
            if rows
            else here
        )
        count = total
    return rows


def _triangle(rows: Array) -> Array:
    """R of the QR factorisation."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def select_criterion(criteria: Mapping[str, object], criterion: Criterion, *, plain: bool) -> float:
    """One number out of what `score` returns."""
    if criterion is Criterion.COND_REGRESSOR:
        return float(criteria["cond_regressor"])  # type: ignore[arg-type]
    return float(criteria["plain" if plain else "geometric"][criterion.value])  # type: ignore[index]


def information_matrix(Y: Array, noise: Array) -> Array:
    """Σₜ Yᵀ Σ⁻¹ Y over all samples, in standard parameters. Shapes (N, n, P) -> (P, P)."""
    rows = (Y / noise[:, None]).reshape(-1, Y.shape[2])
    out: Array = rows.T @ rows
    return out
