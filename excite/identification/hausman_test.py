"""Durbin-Wu-Hausman test of whether instruments are needed, robust to coloured noise.

The part of Γ that the instruments do not explain, V̂ = Γ − Z Ẑ, is added to the regression of
torque on Γ. If position noise is in Γ and in the residual, V̂ explains some of the residual
(Hausman, Econometrica 46(6), 1978; Wooldridge, "Econometric Analysis of Cross Section and Panel
Data", 6.2.1; for robots Janot, Vandanjon & Gautier, IEEE Trans. Control Systems Technology 22(1),
2014). The coefficients of V̂ are tested by Wald's statistic with the covariance of `estimators`,
which accounts for the noise spectrum.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from .estimators import Estimate, LeastSquaresFit, Method, estimate, least_squares, whiten
from .regression import TorqueEquations

SIGNIFICANCE_LEVEL = 0.05
"""p-value below which the test is significant."""
MAX_BIAS = 0.5
"""Bias in standard deviations that is tolerated: 95 % intervals then cover 92 %."""
TESTED_POWER_SHARE = 0.99
"""Share of the power of V̂ held by the principal directions that are tested, in coordinates where
the information is 1. The others are nearly combinations of the columns of Γ: they add degrees of
freedom and no power to the test."""
MIN_SINE = 1e-6
"""Sine of the angle between the spaces of Γ and Z below which a direction is not tested."""


@dataclass(frozen=True)
class HausmanTest:
    """Result of the test.

    Attributes:
        statistic: Wald's statistic, χ² distributed if least squares is not biased.
        degrees_of_freedom: Degrees of freedom of χ².
        p_value: p-value.
        largest_shift: Largest difference of a base parameter between the two estimates, in standard
            deviations of the instrumental one, and the index of that parameter.
        strength: Smallest cosine of an angle between the spaces of Γ and Z: 1 for perfect
            instruments; near 0 the instrumental estimate is meaningless.
    """

    statistic: float
    degrees_of_freedom: int
    p_value: float
    largest_shift: tuple[float, int]
    strength: float

    @property
    def is_significant(self) -> bool:
        """True if the residual correlates with what the instruments do not explain of Γ.

        The cause is position noise or physics missing from the model.
        """
        return self.p_value < SIGNIFICANCE_LEVEL

    @property
    def needs_instruments(self) -> bool:
        """True if the test is significant and a base parameter is biased by more than MAX_BIAS."""
        return self.is_significant and self.largest_shift[0] > MAX_BIAS

    @property
    def summary(self) -> str:
        """The result in one line."""
        test = (
            f"Durbin-Wu-Hausman: χ² = {self.statistic:.3g} with {self.degrees_of_freedom} degrees "
            f"of freedom, p = {self.p_value:.2g}"
        )
        shift = f"{self.largest_shift[0]:.2g} standard deviations"
        if self.needs_instruments:
            return (
                f"{test}: position noise biases least squares by up to {shift}; use --estimator iv"
            )
        if self.is_significant:
            return f"{test}: significant, but the bias is at most {shift}; least squares suffices"
        return f"{test}: no evidence that least squares needs instruments"


def durbin_wu_hausman(
    least_squares_estimate: Estimate,
    instrumental_estimate: Estimate,
    equations: TorqueEquations,
    instruments: FloatArray,
    nuisance: FloatArray | None = None,
) -> HausmanTest:
    """Test least squares against instrumental variables.

    Args:
        least_squares_estimate: Estimate of the equations by least squares.
        instrumental_estimate: Estimate of the same equations by instruments.
        equations: The equations.
        instruments: Z, as for `estimators.estimate`. Shape (N, n, p) or (N, n, p + k).
        nuisance: Nuisance columns, as for `estimators.estimate`. Shape (N, n, k).
    """
    from scipy import stats  # slow to import

    if nuisance is not None:
        if instruments.shape[2] == equations.regressor.shape[2]:
            instruments = np.concatenate([instruments, nuisance], axis=2)
        equations = dataclasses.replace(
            equations, regressor=np.concatenate([equations.regressor, nuisance], axis=2)
        )
    equations = equations.without_standstill()
    instruments = np.where(equations.moving[:, :, None], instruments, 0.0)
    noise_root = least_squares_estimate.noise_root
    fit = least_squares(equations, noise_root)
    V, sines, strength = _unexplained(equations, fit, noise_root, instruments)
    power = np.cumsum(sines**2) / max(float(np.sum(sines**2)), 1e-300)
    tested = min(int(np.sum(power < TESTED_POWER_SHARE)) + 1, int(np.sum(sines > MIN_SINE)))
    shift = _largest_shift(least_squares_estimate, instrumental_estimate)
    if tested == 0:
        return HausmanTest(0.0, 0, 1.0, shift, strength)
    p = equations.regressor.shape[2]
    extended = dataclasses.replace(
        equations, regressor=np.concatenate([equations.regressor, V[:, :, :tested]], axis=2)
    )
    refit = estimate(
        extended, Method.FULL if np.count_nonzero(noise_root) > len(noise_root) else Method.WLS
    )
    extra = refit.theta[p:]
    statistic = float(extra @ np.linalg.solve(refit.covariance[p:, p:], extra))
    return HausmanTest(statistic, tested, float(stats.chi2.sf(statistic, tested)), shift, strength)


def _unexplained(
    equations: TorqueEquations,
    fit: LeastSquaresFit,
    noise_root: FloatArray,
    instruments: FloatArray,
) -> tuple[FloatArray, FloatArray, float]:
    """Part of Γ that the instruments do not explain.

    Returns:
        V̂ in its principal directions, largest first, shape (N, n, r); their sines, shape (r,); the
        smallest cosine between the spaces of Γ and Z.
    """
    r = fit.half.shape[1]
    rows = whiten(equations.regressor @ fit.half, noise_root).reshape(-1, r)
    Z = whiten(instruments, noise_root).reshape(len(rows), -1)
    size = np.linalg.norm(Z, axis=0)
    Z = Z[:, size > 0.0] / size[size > 0.0]
    Q, R = np.linalg.qr(Z)  # first, so that only the factor R needs a singular value decomposition
    U, s, _ = np.linalg.svd(R)
    U = Q @ U[:, s > 1e-9 * s[0]]
    unexplained = rows - U @ (U.T @ rows)
    cosines = np.linalg.svd(U.T @ rows, compute_uv=False)
    _, sines, Vt = np.linalg.svd(np.linalg.qr(unexplained)[1])
    principal = (unexplained @ Vt.T).reshape(*equations.torque.shape, r)
    unweighted = np.einsum("ij,tjr->tir", noise_root, principal)
    return unweighted, sines, float(cosines[-1]) if len(cosines) == r else 0.0


def _largest_shift(
    least_squares_estimate: Estimate, instrumental_estimate: Estimate
) -> tuple[float, int]:
    """Largest difference of a parameter in standard deviations, and its index."""
    deviation = np.sqrt(np.diag(instrumental_estimate.covariance))
    with np.errstate(invalid="ignore"):
        shift = np.where(
            np.isfinite(deviation) & (deviation > 0.0),
            np.abs(least_squares_estimate.theta - instrumental_estimate.theta) / deviation,
            0.0,
        )
    return float(shift.max()), int(shift.argmax())
