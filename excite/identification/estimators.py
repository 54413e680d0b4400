"""Estimators of base parameters: least squares, robust and instrumental estimation.

The estimate solves Σ Γᵀ Σ⁻¹ ρ(τ − Γθ) = 0. Its covariance is the sandwich A⁻¹ S A⁻¹, A the
derivative of the left side with respect to θ and S the covariance of the left side under noise of
the estimated spectrum (Huber, "Robust Statistics", 1981, chapter 7; White, Econometrica 48(4),
1980).
"""

from __future__ import annotations

import dataclasses
import enum
from dataclasses import dataclass, field

import numpy as np

from .._types import FloatArray, IntArray
from ..errors import UnusableInput
from .noise_spectrum import NoiseSpectrum, covariance_root, noise_spectrum
from .regression import MIN_NOISE_FREEDOM, TorqueEquations

HUBER_THRESHOLD = 1.345
"""Residual in standard deviations above which its loss grows linearly: 95 % efficient for normal
noise (Huber 1981)."""
VARIANCE_ITERATIONS = 3
"""Number of alternations between least squares and the variances of the joints."""
MAX_HUBER_ITERATIONS = 30
"""Number of reweighting iterations of the robust estimator, at most."""
HUBER_TOLERANCE = 1e-4
"""Change of θ in standard deviations below which the robust estimator has converged."""
NORMAL_MEDIAN_DEVIATION = 0.6744897501960817
"""Median of |x| for a standard normal x: converts a median absolute residual to a deviation."""
ZERO_COLUMN_RATIO = 1e-9
"""Norm of a column of Γ, relative to the largest, below which it counts as zero: rounding in the
derivatives of a resting joint's position."""
RANK_TOLERANCE = 1e-9
"""Relative singular value of Γ, columns scaled to unit norm, below which a combination of
parameters counts as not excited."""
TORQUE_RESOLUTION = 2.0**-16 / np.sqrt(12.0)
"""Smallest standard deviation of a joint's torque error over its largest torque: the quantisation
error of 16 bits. A constant torque, as of a joint at rest or where it was not measured, has no
deviation by which its rows could be weighted."""
BLOCK_ROWS = 4096
"""Number of rows that are orthogonalised at a time."""
CONFIDENCE_LEVEL = 0.95
"""Probability that an interval covers the true value."""


class Method(enum.Enum):
    """Estimators, named as on the command line.

    OLS: all rows have equal weight. WLS: weights by each joint's noise variance. FULL: weights by
    the covariance of the noise over the joints. HUBER: as WLS, with the influence of outliers
    bounded. IV: as WLS, with instruments in the place of Γᵀ.
    """

    OLS = "ols"
    WLS = "wls"
    FULL = "full"
    HUBER = "huber"
    IV = "iv"


@dataclass(frozen=True)
class Estimate:
    """Base parameters estimated from the data alone.

    Attributes:
        method: The estimator.
        theta: θ̂; 0 in directions that the data do not excite. Shape (p,).
        information_root: R with RᵀR the inverse of the covariance of θ̂. Shape (r, p).
        covariance: Covariance of θ̂, ∞ on the diagonal where a parameter takes part in a direction
            that is not excited. Shape (p, p).
        noise_root: C with noise covariance Σ = C Cᵀ over the joints by which rows were weighted; 1
            for `Method.OLS`. Shape (n, n) [N m].
        noise_spectrum: Spectrum of the weighted residuals.
        residual: τ − Γ θ̂, 0 in rows that do not count. Shape (N, n) [N m].
        degrees_of_freedom: Number of rows minus number of parameters.
        outliers: Share of rows whose weight the robust estimator halved or more.
        nuisance_coefficients: Coefficients of the nuisance columns. Shape (k,).
    """

    method: Method
    theta: FloatArray
    information_root: FloatArray
    covariance: FloatArray
    noise_root: FloatArray
    noise_spectrum: NoiseSpectrum
    residual: FloatArray
    degrees_of_freedom: float
    outliers: float = 0.0
    nuisance_coefficients: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def noise(self) -> FloatArray:
        """Standard deviation of the residual per joint. Shape (n,) [N m]."""
        if self.method is Method.OLS:  # all rows have the weight 1, whatever their noise
            rows = np.count_nonzero(self.residual, axis=0)
            freedom = self.degrees_of_freedom * rows / max(float(rows.sum()), 1.0)
            return np.sqrt(np.sum(self.residual**2, axis=0) / np.maximum(freedom, 1e-300))
        return np.sqrt(np.sum(self.noise_root**2, axis=1))


@dataclass(frozen=True)
class LeastSquaresFit:
    """Solution of a weighted least-squares problem.

    Attributes:
        theta: Solution. Shape (p,).
        half: H with H Hᵀ = (Σ ΓᵀΣ⁻¹Γ)⁺. Shape (p, r).
        inward: Matrix that maps θ to the coordinates of H. Shape (r, p).
        leverage: Trace of the hat matrix per joint. Shape (n,).
        size: Norm of each weighted column. Shape (p,).
        hidden: Basis of the directions that are not excited. Shape (p − r, p).
    """

    theta: FloatArray
    half: FloatArray
    inward: FloatArray
    leverage: FloatArray
    size: FloatArray
    hidden: FloatArray


def torque_resolution(torque: FloatArray) -> FloatArray:
    """Return the smallest standard deviation of each joint's torque error. Shape (n,) [N m].

    A joint whose `torque` (N, n) is 0 throughout has that of the joint with the largest torque.
    """
    largest = np.abs(torque).max(axis=0)
    return TORQUE_RESOLUTION * np.where(largest > 0.0, largest, largest.max() or 1.0)


def whiten(rows: FloatArray, noise_root: FloatArray) -> FloatArray:
    """Multiply rows by C⁻¹ over the joints. Shapes (N, n, …)."""
    inverse = np.linalg.inv(noise_root)
    if np.count_nonzero(inverse) == len(inverse):
        return np.asarray(rows * np.diag(inverse).reshape(1, -1, *[1] * (rows.ndim - 2)))
    return np.einsum("ij,tj...->ti...", inverse, rows)


def joint_triangular_factors(equations: TorqueEquations) -> FloatArray:
    """Compute the QR factor R of each joint's [Γ | τ], to which weights of joints can be applied.

    Returns:
        Shape (n, p + 1, p + 1).
    """
    n, p = equations.n, equations.regressor.shape[2]
    out = np.zeros((n, p + 1, p + 1))
    for joint in range(n):
        nonzero = np.append(np.any(equations.regressor[:, joint] != 0.0, axis=0), True)
        R = np.zeros((0, int(nonzero.sum())))
        for start in range(0, len(equations), BLOCK_ROWS):
            part = slice(start, start + BLOCK_ROWS)
            block = np.concatenate(
                [
                    equations.regressor[part, joint][:, nonzero[:-1]],
                    equations.torque[part, joint, None],
                ],
                axis=1,
            )
            R = np.asarray(np.linalg.qr(np.vstack([R, block]), mode="r"))
        out[joint][np.ix_(np.arange(len(R)), np.flatnonzero(nonzero))] = R
    return out


def _stacked(factors: FloatArray) -> FloatArray:
    """Return the QR factor R of stacked factors. Shape (n, m, p + 1) -> (≤ p + 1, p + 1)."""
    return np.asarray(np.linalg.qr(factors.reshape(-1, factors.shape[2]), mode="r"))


def triangular_factor(equations: TorqueEquations, noise_root: FloatArray) -> FloatArray:
    """Compute the QR factor R of all weighted rows of [Γ | τ]. Shape (≤ p + 1, p + 1)."""
    rows = equations.without_standstill()
    white = dataclasses.replace(
        rows,
        torque=whiten(rows.torque, noise_root),
        regressor=whiten(rows.regressor, noise_root),
    )
    return _stacked(joint_triangular_factors(white))


def _unit_columns(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the columns divided by their norms, and the norms; zero columns have the norm 1."""
    size = np.linalg.norm(matrix, axis=0)
    zero = size <= ZERO_COLUMN_RATIO * size.max(initial=0.0)
    size[zero] = 1.0
    return np.where(zero, 0.0, matrix / size), size


def _rank(singular_values: FloatArray) -> int:
    """Return the number of excited directions."""
    largest = float(singular_values.max(initial=0.0))
    return int(np.sum(singular_values > RANK_TOLERANCE * max(largest, 1e-300)))


def _solved(factor: FloatArray, joint_factors: FloatArray) -> LeastSquaresFit:
    """Solve least squares from the QR factor of all rows; joint factors give the leverages."""
    p = factor.shape[1] - 1
    right = factor[:p, p]
    unit, size = _unit_columns(factor[:p, :p])
    U, s, Vt = np.linalg.svd(unit)
    rank = _rank(s)
    half = (Vt[:rank].T / s[:rank]) / size[:, None]
    theta = half @ (U[:, :rank].T @ right)
    inward = s[:rank, None] * Vt[:rank] * size
    return LeastSquaresFit(
        theta,
        half,
        inward,
        np.sum((joint_factors[:, :, :p] @ half) ** 2, axis=(1, 2)),
        size,
        Vt[rank:] / size,
    )


def least_squares(
    equations: TorqueEquations, noise_root: FloatArray, weights: FloatArray | None = None
) -> LeastSquaresFit:
    """Minimise ‖W^½ C⁻¹(τ − Γθ)‖².

    Of several minima the one of minimum norm is returned, columns scaled to unit norm.

    Args:
        equations: The equations.
        noise_root: C. Shape (n, n) [N m].
        weights: Diagonal of W. Shape (N, n); all 1 by default.
    """
    if weights is None and np.count_nonzero(noise_root) == len(noise_root):
        factors = joint_triangular_factors(equations) / np.diag(noise_root)[:, None, None]
        return _solved(_stacked(factors), factors)
    white = dataclasses.replace(
        equations,
        torque=whiten(equations.torque, noise_root),
        regressor=whiten(equations.regressor, noise_root),
    )
    if weights is not None:
        root = np.sqrt(weights)
        white = dataclasses.replace(
            white, torque=white.torque * root, regressor=white.regressor * root[:, :, None]
        )
    factors = joint_triangular_factors(white)
    return _solved(_stacked(factors), factors)


def _reweighted(
    factors: FloatArray, iterations: int, rows: IntArray, resolution: FloatArray
) -> tuple[LeastSquaresFit, FloatArray]:
    """Alternate between least squares and the joints' noise variances.

    Args:
        factors: QR factor of each joint's [Γ | τ]. Shape (n, p + 1, p + 1).
        iterations: Number of alternations.
        rows: Number of rows of each joint. Shape (n,).
        resolution: See `torque_resolution`. Shape (n,) [N m].

    Returns:
        The fit, and C, diagonal.
    """
    deviation = np.ones(len(factors))
    fit = _solved(_stacked(factors), factors)
    for _ in range(iterations):
        residual = factors[:, :, -1] - factors[:, :, :-1] @ fit.theta
        variance = np.sum(residual**2, axis=1) / np.maximum(rows - fit.leverage, 1.0)
        deviation = np.sqrt(variance + resolution**2)
        weighted = factors / deviation[:, None, None]
        fit = _solved(_stacked(weighted), weighted)
    return fit, np.diag(deviation)


def estimate(
    equations: TorqueEquations,
    method: Method = Method.WLS,
    *,
    instruments: FloatArray | None = None,
    nuisance: FloatArray | None = None,
) -> Estimate:
    """Estimate base parameters.

    Args:
        equations: The equations.
        method: The estimator.
        instruments: Z for `Method.IV`: correlated with Γ, uncorrelated with the noise. Shape
            (N, n, p), or (N, n, p + k) with instruments of the nuisance columns, which otherwise
            are their own instruments.
        nuisance: Columns that explain torque and belong to no parameter of θ, such as the
            derivative by a friction width. They are estimated jointly and integrated out, so that
            θ̂ is not biased by them and its covariance accounts for them. Shape (N, n, k).

    Raises:
        UnusableInput: There are not more equations than parameters and MIN_NOISE_FREEDOM for each
            joint, or instruments are missing or excite less than the recorded motion.
    """
    if nuisance is not None:
        extended = dataclasses.replace(
            equations, regressor=np.concatenate([equations.regressor, nuisance], axis=2)
        )
        if instruments is not None and instruments.shape[2] == equations.regressor.shape[2]:
            instruments = np.concatenate([instruments, nuisance], axis=2)
        return _marginal(estimate(extended, method, instruments=instruments), equations)
    equations = equations.without_standstill()
    resolution = torque_resolution(equations.torque)
    fit, noise_root = _reweighted(
        joint_triangular_factors(equations),
        0 if method is Method.OLS else VARIANCE_ITERATIONS,
        equations.moving.sum(axis=0),
        resolution,
    )
    rank, count = fit.half.shape[1], int(equations.moving.sum())
    moving = int(equations.moving.any(axis=0).sum())
    if count <= rank + MIN_NOISE_FREEDOM * moving:
        raise UnusableInput(
            f"recordings: {count} equations are too few for {rank} parameters and the noise of "
            f"{moving} joints with a band of {equations.hertz:.3g} Hz; record for longer or give a "
            "higher --band"
        )
    if method is Method.FULL:
        noise_root = covariance_root(
            equations.torque - equations.predicted(fit.theta),
            fit.leverage,
            equations.moving.sum(axis=0),
            resolution,
        )
        fit = least_squares(equations, noise_root)
    if method is Method.HUBER:
        return _huber(equations, fit, noise_root)
    if method is Method.IV:
        if instruments is None:
            raise UnusableInput(
                "estimator 'iv': needs instruments; see instruments.build_instruments"
            )
        counted = np.where(equations.moving[:, :, None], instruments, 0.0)
        return _instrumental(equations, fit, noise_root, counted)
    residual = whiten(equations.torque - equations.predicted(fit.theta), noise_root)
    return _assembled(method, equations, fit, fit.theta, noise_root, residual)


def _marginal(extended: Estimate, equations: TorqueEquations) -> Estimate:
    """Marginal estimate of θ: its block of the covariance, and the root of the block's inverse."""
    p = equations.regressor.shape[2]
    # information on θ with the nuisances unknown: the rows of R in which they take no part
    # (by singular values, as a zero or dependent column of R has no direction of its own in a QR)
    U, s, _ = np.linalg.svd(_unit_columns(extended.information_root)[0][:, p:])
    root = U[:, _rank(s) :].T @ extended.information_root[:, :p]
    theta, covariance = extended.theta[:p], extended.covariance[:p, :p]
    return dataclasses.replace(
        extended,
        theta=theta,
        information_root=root,
        covariance=covariance,
        nuisance_coefficients=extended.theta[p:],
    )


def _assembled(
    method: Method,
    equations: TorqueEquations,
    fit: LeastSquaresFit,
    theta: FloatArray,
    noise_root: FloatArray,
    score: FloatArray,
    slope: float = 1.0,
    outliers: float = 0.0,
) -> Estimate:
    """Estimate with its sandwich covariance H S Hᵀ/slope², as A = slope · 1 in coordinates H."""
    regressor = whiten(equations.regressor @ fit.half, noise_root)
    spectrum, spread = noise_spectrum(
        equations, score, regressor, noise_root, resolution=torque_resolution(equations.torque)
    )
    spread = spread / slope**2
    residual = equations.torque - equations.predicted(theta)
    root = np.linalg.solve(np.linalg.cholesky(spread), fit.inward)
    covariance = with_unidentified_variances(fit.half @ spread @ fit.half.T, fit)
    freedom = float(equations.moving.sum() - fit.half.shape[1])
    return Estimate(
        method, theta, root, covariance, noise_root, spectrum, residual, freedom, outliers
    )


def with_unidentified_variances(covariance: FloatArray, fit: LeastSquaresFit) -> FloatArray:
    """Set the variances to ∞ of parameters that take part in a direction that is not excited."""
    touched = np.any(np.abs(fit.hidden * fit.size) > 1e-6, axis=0)
    out = covariance.copy()
    out[touched, touched] = np.inf
    return out


def _huber(equations: TorqueEquations, fit: LeastSquaresFit, noise_root: FloatArray) -> Estimate:
    """Huber's estimator by reweighting, with deviations by the median, which resists outliers."""
    theta, resolution = fit.theta, torque_resolution(equations.torque)
    for _ in range(MAX_HUBER_ITERATIONS):
        residual = whiten(equations.torque - equations.predicted(theta), noise_root)
        size = np.where(equations.moving, np.abs(residual), np.nan)
        median = np.diag(noise_root) * np.nanmedian(size, axis=0)
        noise_root = np.diag(np.hypot(median / NORMAL_MEDIAN_DEVIATION, resolution))
        residual = whiten(equations.torque - equations.predicted(theta), noise_root)
        weights = np.minimum(1.0, HUBER_THRESHOLD / np.maximum(np.abs(residual), 1e-300))
        refit = least_squares(equations, noise_root, weights)
        change, theta = refit.theta - theta, refit.theta
        if np.linalg.norm(refit.inward @ change) < HUBER_TOLERANCE:
            break
    residual = whiten(equations.torque - equations.predicted(theta), noise_root)
    unweighted = least_squares(equations, noise_root)
    size = np.abs(residual[equations.moving])
    slope = float(np.mean(size <= HUBER_THRESHOLD))
    outliers = float(np.mean(size > 2.0 * HUBER_THRESHOLD))
    score = np.clip(residual, -HUBER_THRESHOLD, HUBER_THRESHOLD)
    return _assembled(
        Method.HUBER, equations, unweighted, theta, noise_root, score, slope, outliers
    )


def _instrumental(
    equations: TorqueEquations,
    fit: LeastSquaresFit,
    noise_root: FloatArray,
    instruments: FloatArray,
) -> Estimate:
    """θ̂ = (Σ Zᵀ Σ⁻¹ Γ)⁻¹ Σ Zᵀ Σ⁻¹ τ in coordinates H of the excited directions.

    Janot, Vandanjon & Gautier, "A generic instrumental variable approach for industrial robot
    identification", IEEE Trans. Control Systems Technology 22(1), 2014.
    """
    regressor, Z = (whiten(x @ fit.half, noise_root) for x in (equations.regressor, instruments))
    torque = whiten(equations.torque, noise_root)
    product = np.einsum("tip,tiq->pq", Z, regressor, optimize=True)
    values = np.linalg.svd(product, compute_uv=False)
    if values[-1] < RANK_TOLERANCE * values[0]:
        raise UnusableInput(
            "instruments: the reference motion excites fewer parameters than the recorded motion; "
            "use another --estimator"
        )
    theta = fit.half @ np.linalg.solve(product, np.einsum("tip,ti->p", Z, torque, optimize=True))
    white = whiten(equations.torque - equations.predicted(theta), noise_root)
    spectrum, scores = noise_spectrum(
        equations, white, regressor, noise_root, Z, resolution=torque_resolution(equations.torque)
    )
    inverse = np.linalg.inv(product)
    spread = inverse @ scores @ inverse.T
    root = np.linalg.solve(np.linalg.cholesky(spread), fit.inward)
    covariance = with_unidentified_variances(fit.half @ spread @ fit.half.T, fit)
    residual = equations.torque - equations.predicted(theta)
    return Estimate(
        Method.IV,
        theta,
        root,
        covariance,
        noise_root,
        spectrum,
        residual,
        float(equations.moving.sum() - fit.half.shape[1]),
    )


def student_quantile(freedom: float) -> float:
    """Return Student's t for a two-sided interval, as the noise variance is estimated too."""
    from scipy import stats  # slow to import

    return float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE_LEVEL, max(freedom, 1.0)))


def interval_half_widths(estimate: Estimate, combinations: FloatArray) -> FloatArray:
    """Compute half-widths of confidence intervals of linear combinations of θ.

    Args:
        estimate: The estimate.
        combinations: Coefficients of the combinations. Shape (m, p).

    Returns:
        Half-widths; ∞ for combinations that the data do not excite. Shape (m,).
    """
    hidden = ~np.isfinite(np.diag(estimate.covariance))
    covariance = np.where(np.isfinite(estimate.covariance), estimate.covariance, 0.0)
    deviation = np.sqrt(
        np.maximum(np.einsum("mi,ij,mj->m", combinations, covariance, combinations), 0.0)
    )
    deviation[np.any(np.abs(combinations[:, hidden]) > 0.0, axis=1)] = np.inf
    return student_quantile(estimate.degrees_of_freedom) * deviation
