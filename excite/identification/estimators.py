"""Base parameters from the equations: least squares, weighted by what the noise turns out to be, or robust against outliers.

θ̂ solves Σ Γᵀ Σ⁻¹ ρ(τ − Γθ) = 0; its covariance is the sandwich A⁻¹ S A⁻¹, A the slope of these equations and S the
covariance of their left side under noise of the colour found (Huber 1981, chapter 7; White 1980).
"""

from __future__ import annotations

import dataclasses
import enum
from dataclasses import dataclass, field

import numpy as np

from ..errors import UnusableInput
from .noise_spectrum import NoiseSpectrum, covariance_root, noise_spectrum
from .regression import TorqueEquations

Array = np.ndarray
HUBER_THRESHOLD = 1.345
"""Standard deviations beyond which a residual counts by its size, not its square: 95 % efficient where noise is normal (Huber 1981)."""
PASSES = 3
ROBUST_PASSES = 30
SPREAD = 0.6744897501960817  # median of |x| for a standard normal x
NOTHING = 1e-9
"""Size of a column, relative to the largest, at which it is zero."""
RANK = 1e-9
"""Relative singular value, columns at unit length, below which a combination of parameters counts as not shown at all."""
BLOCK = 4096


class Method(enum.Enum):
    """How rows are weighted."""

    OLS = "ols"  # all alike
    WLS = "wls"  # by each joint's noise
    FULL = "full"  # by the noise's covariance over the joints
    HUBER = "huber"  # by each joint's noise, outliers bounded
    IV = "iv"  # by each joint's noise, with instruments instead of Γᵀ


@dataclass(frozen=True)
class Estimate:
    """Base parameters by the data alone.

    theta: θ̂; 0 in directions the data doesn't show at all. Shape (p,). root: R with RᵀR = the inverse of its covariance, the
    information there is in θ. Shape (r, p). covariance: of θ̂, ∞ on the diagonal where a hidden direction has part. Shape (p, p).
    scale: C with Σ = C Cᵀ, noise over the joints. Shape (n, n) [N m]. colour: of weighted residuals. residual: τ − Γ θ̂. Shape (N, n).
    freedom: rows less parameters. outliers: share of rows whose weight robust estimation halved or more.
    beside: coefficients of the nuisances.
    """

    method: Method
    theta: Array
    root: Array
    covariance: Array
    scale: Array
    colour: NoiseSpectrum
    residual: Array
    freedom: float
    outliers: float = 0.0
    beside: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def noise(self) -> Array:
        """Standard deviation of what the model leaves, per joint. Shape (n,) [N m]."""
        return np.sqrt(np.sum(self.scale**2, axis=1))


@dataclass(frozen=True)
class LeastSquaresFit:
    """Weighted least squares.

    theta: Shape (p,). half: H with H Hᵀ = (Σ ΓᵀΣ⁻¹Γ)⁺. Shape (p, r). inward: takes θ to the coordinates of H. Shape (r, p).
    leverage: trace of the hat matrix per joint. Shape (n,). size: norm of each weighted column. Shape (p,). hidden: directions
    not shown. Shape (p − r, p).
    """

    theta: Array
    half: Array
    inward: Array
    leverage: Array
    size: Array
    hidden: Array


def whiten(rows: Array, scale: Array) -> Array:
    """C⁻¹ times rows, over the joints. Shapes (N, n, …)."""
    inverse = np.linalg.inv(scale)
    if np.count_nonzero(inverse) == len(inverse):
        return np.asarray(rows * np.diag(inverse).reshape(1, -1, *[1] * (rows.ndim - 2)))
    return np.einsum("ij,tj...->ti...", inverse, rows)


def joint_triangular_factors(equations: TorqueEquations) -> Array:
    """R of each joint's own [Γ | τ], which any weights of the joints can be applied to. Shape (n, p + 1, p + 1)."""
    n, p = equations.n, equations.regressor.shape[2]
    out = np.zeros((n, p + 1, p + 1))
    for joint in range(n):
        seen = np.append(np.any(equations.regressor[:, joint] != 0.0, axis=0), True)
        R = np.zeros((0, int(seen.sum())))
        for start in range(0, len(equations), BLOCK):
            part = slice(start, start + BLOCK)
            own = np.concatenate(
                [
                    equations.regressor[part, joint][:, seen[:-1]],
                    equations.torque[part, joint, None],
                ],
                axis=1,
            )
            R = np.asarray(np.linalg.qr(np.vstack([R, own]), mode="r"))
        out[joint][np.ix_(np.arange(len(R)), np.flatnonzero(seen))] = R
    return out


def _stacked(parts: Array) -> Array:
    """R of parts on top of each other. Shape (n, m, p + 1) -> (≤ p + 1, p + 1)."""
    return np.asarray(np.linalg.qr(parts.reshape(-1, parts.shape[2]), mode="r"))


def triangular_factor(equations: TorqueEquations, scale: Array) -> Array:
    """R of all weighted rows' [Γ | τ]. Shape (≤ p + 1, p + 1)."""
    white = dataclasses.replace(
        equations,
        torque=whiten(equations.torque, scale),
        regressor=whiten(equations.regressor, scale),
    )
    return _stacked(joint_triangular_factors(white))


def _solved(joined: Array, parts: Array) -> LeastSquaresFit:
    """Least squares by the triangle of all rows. parts: of each joint's weighted rows, for the leverages."""
    p = joined.shape[1] - 1
    root, right = joined[:p, :p].copy(), joined[:p, p]
    size = np.linalg.norm(root, axis=0)
    nothing = size <= NOTHING * size.max(
        initial=0.0
    )  # rounding in the derivatives of a joint at rest is no motion
    root[:, nothing], size[nothing] = 0.0, 1.0
    U, s, Vt = np.linalg.svd(root / size)
    rank = int(np.sum(s > RANK * max(float(s[0]), 1e-300)))
    half = (Vt[:rank].T / s[:rank]) / size[:, None]
    theta = half @ (U[:, :rank].T @ right)
    inward = s[:rank, None] * Vt[:rank] * size
    return LeastSquaresFit(
        theta,
        half,
        inward,
        np.sum((parts[:, :, :p] @ half) ** 2, axis=(1, 2)),
        size,
        Vt[rank:] / size,
    )


def least_squares(equations: TorqueEquations, scale: Array, weights: Array | None = None) -> LeastSquaresFit:
    """argmin ‖W^½ C⁻¹(τ − Γθ)‖², of least norm in units of the columns' sizes where columns depend on one another."""
    if weights is None and np.count_nonzero(scale) == len(scale):
        parts = joint_triangular_factors(equations) / np.diag(scale)[:, None, None]
        return _solved(_stacked(parts), parts)
    white = dataclasses.replace(
        equations,
        torque=whiten(equations.torque, scale),
        regressor=whiten(equations.regressor, scale),
    )
    if weights is not None:
        root = np.sqrt(weights)
        white = dataclasses.replace(
            white, torque=white.torque * root, regressor=white.regressor * root[:, :, None]
        )
    parts = joint_triangular_factors(white)
    return _solved(_stacked(parts), parts)


def _reweighted(parts: Array, passes: int, rows: int) -> tuple[LeastSquaresFit, Array]:
    """Least squares and the joints' noise in turn, from the joints' triangles alone: Fit, C diagonal."""
    scale = np.ones(len(parts))
    fit = _solved(_stacked(parts), parts)
    for _ in range(passes):
        left = parts[:, :, -1] - parts[:, :, :-1] @ fit.theta
        scale = np.sqrt(
            np.maximum(np.sum(left**2, axis=1) / np.maximum(rows - fit.leverage, 1.0), 1e-300)
        )
        own = parts / scale[:, None, None]
        fit = _solved(_stacked(own), own)
    return fit, np.diag(scale)


def estimate(
    equations: TorqueEquations,
    method: Method = Method.WLS,
    *,
    instruments: Array | None = None,
    nuisance: Array | None = None,
) -> Estimate:
    """θ̂ by `method`.

    instruments: Z for Method.IV, correlated with Γ and not with the noise. Shape (N, n, p), or (N, n, p + k) with instruments of the
    nuisances, which else are their own. nuisance: columns that explain
    torque too and are nobody's parameter, such as the slope by a friction's width: θ̂ is unbiased by them and as uncertain as
    they make it. Shape (N, n, k).
    """
    if nuisance is not None:
        wider = dataclasses.replace(
            equations, regressor=np.concatenate([equations.regressor, nuisance], axis=2)
        )
        if instruments is not None and instruments.shape[2] == equations.regressor.shape[2]:
            instruments = np.concatenate([instruments, nuisance], axis=2)
        return _marginal(estimate(wider, method, instruments=instruments), equations)
    fit, scale = _reweighted(
        joint_triangular_factors(equations), 0 if method is Method.OLS else PASSES, len(equations)
    )
    if method is Method.FULL:
        scale = covariance_root(equations.torque - equations.predicted(fit.theta), fit.leverage)
        fit = least_squares(equations, scale)
    if method is Method.HUBER:
        return _huber(equations, fit, scale)
    if method is Method.IV:
        if instruments is None:
            raise UnusableInput("instruments: the estimator needs some; see instruments.build")
        return _instrumental(equations, fit, scale, instruments)
    left = whiten(equations.torque - equations.predicted(fit.theta), scale)
    return _assembled(method, equations, fit, fit.theta, scale, left)


def _marginal(wide: Estimate, equations: TorqueEquations) -> Estimate:
    """The estimate of the parameters alone, nuisances integrated out: their block of the covariance, and its inverse's root."""
    p = equations.regressor.shape[2]
    # information left in θ when the nuisances are free: rows of R that have no part in them
    Q = np.linalg.qr(wide.root[:, p:], mode="complete")[0]
    nuisances = np.linalg.matrix_rank(wide.root[:, p:])
    root = Q[:, nuisances:].T @ wide.root[:, :p]
    theta, covariance = wide.theta[:p], wide.covariance[:p, :p]
    return dataclasses.replace(
        wide, theta=theta, root=root, covariance=covariance, beside=wide.theta[p:]
    )


def _assembled(
    method: Method,
    equations: TorqueEquations,
    fit: LeastSquaresFit,
    theta: Array,
    scale: Array,
    score: Array,
    slope: float = 1.0,
    outliers: float = 0.0,
) -> Estimate:
    """The estimate with its sandwich: in coordinates H the slope is `slope`, so the covariance is H S Hᵀ/slope²."""
    inside = whiten(equations.regressor @ fit.half, scale)
    spectrum, spread = noise_spectrum(equations, score, inside, scale)
    spread = spread / slope**2
    residual = equations.torque - equations.predicted(theta)
    root = np.linalg.solve(np.linalg.cholesky(spread), fit.inward)
    covariance = with_unidentified_variances(fit.half @ spread @ fit.half.T, fit)
    freedom = float(score.size - fit.half.shape[1])
    return Estimate(method, theta, root, covariance, scale, spectrum, residual, freedom, outliers)


def with_unidentified_variances(covariance: Array, fit: LeastSquaresFit) -> Array:
    """The covariance with ∞ where a parameter has part in what the data doesn't show."""
    touched = np.any(np.abs(fit.hidden * fit.size) > 1e-6, axis=0)
    out = covariance.copy()
    out[touched, touched] = np.inf
    return out


def _huber(equations: TorqueEquations, fit: LeastSquaresFit, scale: Array) -> Estimate:
    """Iteratively reweighted, with a scale by the median so that outliers don't widen it."""
    theta = fit.theta
    for _ in range(ROBUST_PASSES):
        left = whiten(equations.torque - equations.predicted(theta), scale)
        scale = scale * (np.median(np.abs(left), axis=0) / SPREAD)[:, None]
        left = whiten(equations.torque - equations.predicted(theta), scale)
        found = least_squares(
            equations, scale, np.minimum(1.0, HUBER_THRESHOLD / np.maximum(np.abs(left), 1e-300))
        )
        moved, theta = found.theta - theta, found.theta
        if np.linalg.norm(found.inward @ moved) < 1e-4:
            break
    left = whiten(equations.torque - equations.predicted(theta), scale)
    plain = least_squares(equations, scale)
    size = np.abs(left)
    slope, outliers = float(np.mean(size <= HUBER_THRESHOLD)), float(np.mean(size > 2.0 * HUBER_THRESHOLD))
    return _assembled(
        Method.HUBER, equations, plain, theta, scale, np.clip(left, -HUBER_THRESHOLD, HUBER_THRESHOLD), slope, outliers
    )


def _instrumental(equations: TorqueEquations, fit: LeastSquaresFit, scale: Array, instruments: Array) -> Estimate:
    """θ̂ = (Σ Zᵀ Σ⁻¹ Γ)⁻¹ Σ Zᵀ Σ⁻¹ τ (Janot, Vandanjon & Gautier 2014), in coordinates H of what the recording shows."""
    inside, Z = (whiten(x @ fit.half, scale) for x in (equations.regressor, instruments))
    torque = whiten(equations.torque, scale)
    product = np.einsum("tip,tiq->pq", Z, inside, optimize=True)
    values = np.linalg.svd(product, compute_uv=False)
    if values[-1] < RANK * values[0]:
        raise UnusableInput(
            "instruments: show less of the robot than its recorded motion does; take another estimator"
        )
    theta = fit.half @ np.linalg.solve(product, np.einsum("tip,ti->p", Z, torque, optimize=True))
    left = whiten(equations.torque - equations.predicted(theta), scale)
    spectrum, scores = noise_spectrum(equations, left, inside, scale, Z)
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
        scale,
        spectrum,
        residual,
        float(left.size - fit.half.shape[1]),
    )
