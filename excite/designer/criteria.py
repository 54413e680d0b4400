"""Optimality criteria: functions of the eigenvalues of the information matrix.

λ are the eigenvalues of I·H₀⁻¹ (geometric criterion; Lee, Kwon, Wensing and Park, eq. 20) or of I
in an orthonormal base (plain criterion). The smooth criteria are one family: with s_ρ = Σ λ^{−ρ}, A
is ρ = 1, D is the limit ρ → 0 and E the limit ρ → ∞ of log(s_ρ)/ρ; the condition number combines
both ends of the spectrum. Each has an exact gradient with respect to the information matrix.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from .._linear_algebra import triangle
from .._types import FloatArray, IntArray
from ..robot.base_parameters import Base


class Criterion(Enum):
    """Criterion that a design optimises; its value is the name on the command line."""

    A = "a"
    D = "d"
    E = "e"
    COND = "cond"
    COND_REGRESSOR = "cond_regressor"


MAXIMISED_CRITERIA = (Criterion.D, Criterion.E)
"""Criteria whose largest value is the best; the others are minimised."""

MIN_SPECTRUM_RATIO = 1e-6
"""Smallest ratio of the extreme eigenvalues at which AᵀA still keeps ten digits of them [1]."""

MIN_EIGENVALUE_RATIO = 1e-28
"""Floor of the eigenvalues over the largest one, below which A itself holds no digits [1]."""


@dataclass(frozen=True)
class Weighting:
    """Coordinates in which a criterion is a function of the eigenvalues of the information.

    Attributes:
        columns: W; the information in these coordinates is Wᵀ (Σ Yᵀ Σ⁻¹ Y) W. Shape (P, p).
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].
        support: For each joint the indices of the parameters that its torque can depend on (those
            of its descendants and of its own actuator); None for all.
    """

    columns: FloatArray
    noise: FloatArray
    support: tuple[IntArray, ...] | None = None

    def rows(self, Y: FloatArray) -> FloatArray:
        """Return A, with AᵀA the mean information per sample.

        Args:
            Y: Regressor at N samples. Shape (N, n, P).

        Returns:
            Weighted rows, joint by joint. Shape (n·N, p).
        """
        samples, joints, count = Y.shape
        scale = 1.0 / (np.sqrt(samples) * self.noise)
        if self.support is None:
            return (
                np.ascontiguousarray(np.swapaxes(Y, 0, 1) * scale[:, None, None]).reshape(-1, count)
                @ self.columns
            )
        out = np.empty((joints, samples, self.columns.shape[1]))
        for j, columns in enumerate(self.support):
            np.matmul(Y[:, j, columns], scale[j] * self.columns[columns], out=out[j])
        return out.reshape(joints * samples, -1)

    def regressor_gradient(self, Y: FloatArray, slope: FloatArray) -> FloatArray:
        """Return the gradient with respect to the regressor of a function of AᵀA.

        Args:
            Y: Regressor at N samples. Shape (N, n, P).
            slope: Gradient of the function with respect to AᵀA. Shape (p, p).

        Returns:
            Gradient with respect to `Y`. Shape (N, n, P).
        """
        kernel = self.columns @ slope @ self.columns.T
        factor = 2.0 / (len(Y) * self.noise**2)
        if self.support is None:
            return (Y @ kernel) * factor[:, None]
        out = np.zeros(Y.shape)
        for j, columns in enumerate(self.support):
            out[:, j, columns] = Y[:, j, columns] @ (factor[j] * kernel[np.ix_(columns, columns)])
        return out

    def information_root(self, information: FloatArray) -> FloatArray:
        """Return G with GᵀG = Wᵀ I W.

        Args:
            information: Information matrix I in standard parameters. Shape (P, P).

        Returns:
            The root G. Shape (p, p).
        """
        values, vectors = np.linalg.eigh(self.columns.T @ information @ self.columns)
        return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))).T)


def criterion_weighting(
    criterion: Criterion, base: Base, noise: FloatArray, *, plain: bool
) -> Weighting:
    """Return the coordinates in which a criterion is evaluated.

    Args:
        criterion: The criterion.
        base: Base parameters of the robot.
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].
        plain: Use the Euclidean instead of the geometric metric.
    """
    if criterion is Criterion.COND_REGRESSOR:
        return Weighting(base.selection, np.ones_like(noise))
    return Weighting(base.plain if plain else base.geometric, noise)


def criterion_value(criterion: Criterion, eigenvalues: FloatArray) -> float:
    """Return the value of a criterion.

    Args:
        criterion: The criterion.
        eigenvalues: Ascending eigenvalues of the information. Shape (p,).

    Returns:
        The value; its worst possible value (infinite, or 0 for E) where an eigenvalue is 0.
    """
    low, high = float(eigenvalues[0]), float(eigenvalues[-1])
    if criterion is Criterion.E:
        return max(low, 0.0)
    if low <= 0.0:
        return -np.inf if criterion is Criterion.D else np.inf
    if criterion is Criterion.A:
        return float(np.sum(1.0 / eigenvalues))
    if criterion is Criterion.D:
        return float(np.sum(np.log(eigenvalues)))
    return float(np.sqrt(high / low)) if criterion is Criterion.COND_REGRESSOR else high / low


def spectrum(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues and eigenvectors of AᵀA, from A where squaring it would lose digits.

    Args:
        rows: A. Shape (m, p), m ≥ p.

    Returns:
        Ascending or descending positive eigenvalues, shape (p,), and eigenvectors as columns,
        shape (p, p).
    """
    square = rows.T @ rows
    try:
        pivots = np.diag(np.linalg.cholesky(square)) ** 2
    except np.linalg.LinAlgError:
        pivots = np.zeros(1)
    # the pivots are a cheap test that is hardly ever wrong; the eigenvalues decide
    if pivots.min() > MIN_SPECTRUM_RATIO * pivots.max():
        values, vectors = np.linalg.eigh(square)
        if values[0] > MIN_SPECTRUM_RATIO * values[-1]:
            return values, vectors
    _, singular, right = np.linalg.svd(np.linalg.qr(rows, mode="r"))
    return np.maximum(singular**2, MIN_EIGENVALUE_RATIO * singular[0] ** 2), right.T


def smooth_objective(
    criterion: Criterion, rows: FloatArray, sharpness: float
) -> tuple[float, FloatArray]:
    """Evaluate the smooth objective of a criterion, to be minimised, and its gradient.

    A (log a) and D (−d/p) are exact. The extreme eigenvalues of E and of the condition numbers are
    smoothed; as the sharpness grows the value tends to log(1/e), log cond or log cond².

    Args:
        criterion: The criterion.
        rows: A, with AᵀA the information. Shape (m, p), m ≥ p.
        sharpness: ρ, sharpness of the smoothed extreme eigenvalues [1].

    Returns:
        The objective, and its gradient with respect to AᵀA. Shape (p, p).
    """
    values, vectors = spectrum(rows)
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


def regularised_objective(
    criterion: Criterion, information: FloatArray
) -> tuple[float, FloatArray]:
    """Evaluate `smooth_objective` of A or D for information that contains a prior.

    The prior bounds the condition number, so that Cholesky's factorisation is precise enough; it is
    several times faster than the eigenvalues.

    Args:
        criterion: A or D.
        information: Information with the prior, positive definite. Shape (p, p).

    Returns:
        The objective, to be minimised, and its gradient with respect to the information.
        Shape (p, p).
    """
    factor = np.linalg.cholesky(information)
    half = np.linalg.solve(factor, np.eye(len(factor)))
    covariance = half.T @ half
    if criterion is Criterion.D:
        count = len(factor)
        return -2.0 * float(np.mean(np.log(np.diag(factor)))), -covariance / count
    trace = float(np.trace(covariance))
    return float(np.log(trace)), -(covariance @ covariance) / trace


def _soft_max(values: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
    """Return log(Σ exp(ρ v))/ρ and its gradient."""
    top = float(values.max())
    weights = np.exp(sharpness * (values - top))
    total = float(weights.sum())
    return top + np.log(total) / sharpness, weights / total


def information_eigenvalues(rows: FloatArray) -> FloatArray:
    """Return the ascending eigenvalues of AᵀA.

    Args:
        rows: A. Shape (m, p).

    Returns:
        Eigenvalues, 0 for directions without information. Shape (p,).
    """
    singular = np.linalg.svd(np.linalg.qr(rows, mode="r"), compute_uv=False)
    out = np.zeros(rows.shape[1])
    out[: len(singular)] = singular**2
    return np.sort(out)


def evaluate_criteria(
    blocks: FloatArray | Iterable[FloatArray],
    base: Base,
    noise: FloatArray,
    earlier_information: FloatArray | None = None,
) -> dict[str, object]:
    """Evaluate all criteria of one motion, per sample, as `criteria` of a trajectory file.

    Args:
        blocks: Regressor Y of all samples, or of consecutive samples block by block. Shape
            (N, n, P).
        base: Base parameters of the robot.
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].
        earlier_information: Information of earlier recordings over N, in standard parameters.
            Shape (P, P).

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
        known = (
            []
            if earlier_information is None
            else [weights[name].information_root(earlier_information)]
        )
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
    weights: Mapping[str, Weighting], blocks: Iterable[FloatArray]
) -> dict[str, FloatArray]:
    """Return A, with AᵀA the mean information per sample, for each weighting. Shape (m, p)."""
    rows: dict[str, FloatArray] = {}
    count = 0
    for Y in blocks:
        here = {name: weighting.rows(Y) for name, weighting in weights.items()}
        total = count + len(Y)
        # stack A of both parts, each scaled by the root of its share of the samples, and reduce it
        shares = np.sqrt(count / total), np.sqrt(len(Y) / total)
        rows = (
            {n: triangle(np.vstack([shares[0] * rows[n], shares[1] * here[n]])) for n in here}
            if rows
            else here
        )
        count = total
    return rows


def select_criterion(criteria: Mapping[str, object], criterion: Criterion, *, plain: bool) -> float:
    """Return the value of one criterion among those that `evaluate_criteria` returns."""
    if criterion is Criterion.COND_REGRESSOR:
        return float(criteria["cond_regressor"])  # type: ignore[arg-type]
    metric = "plain" if plain else "geometric"
    return float(criteria[metric][criterion.value])  # type: ignore[index]
