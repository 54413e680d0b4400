"""Are instruments needed? The Durbin-Wu-Hausman test in its regression form, robust to coloured noise.

What of Γ the instruments do not explain, V̂ = Γ − Z Ẑ, is added to the regression of torque on Γ: if the noise of positions is in Γ and in
the residual, V̂ explains some of the latter (Hausman, Econometrica 1978; Wooldridge, Econometric Analysis, 6.2.1; for robots Janot et al.,
IEEE TCST 2014). Its coefficients are tested by Wald's statistic with the covariance of `estimators`, which knows the noise's colour.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from .estimators import Estimate, LeastSquaresFit, Method, estimate, least_squares, whiten
from .regression import TorqueEquations

Array = np.ndarray
LEVEL = 0.05
MATTERS = 0.5
"""Standard deviations of bias that 95 % intervals can bear: they cover 92 %."""
POWER = 0.99
"""Of V̂, in coordinates where the information is 1, the fewest principal directions are tested that hold this share of its power: those
that are left are nearly combinations of Γ's columns, add degrees of freedom and find nothing."""
NEGLIGIBLE = 1e-6
"""Sine of the angle between the spaces of Γ and Z below which a direction is no difference at all."""


@dataclass(frozen=True)
class HausmanTest:
    """statistic: Wald's, χ² of `freedom` degrees of freedom where least squares isn't biased. p: its p-value.

    shift: largest difference of a base parameter by the two estimates, in standard deviations by instruments, and where. strength: smallest
    cosine of an angle between the spaces of Γ and Z, 1: perfect instruments; near 0 θ̂ by instruments means nothing.
    """

    statistic: float
    freedom: int
    p: float
    shift: tuple[float, int]
    strength: float

    @property
    def significant(self) -> bool:
        """Whether the residual has to do with what in Γ the instruments don't explain: noise of positions, or physics the model lacks."""
        return self.p < LEVEL

    @property
    def needed(self) -> bool:
        """Whether that is so and moves a base parameter far enough to matter."""
        return self.significant and self.shift[0] > MATTERS

    @property
    def words(self) -> str:
        """One line."""
        test = f"Durbin-Wu-Hausman: χ² = {self.statistic:.3g} with {self.freedom} degrees of freedom, p = {self.p:.2g}"
        if self.needed:
            return f"{test}: noise of positions moves least squares by up to {self.shift[0]:.2g} standard deviations; take instruments"
        if self.significant:
            return f"{test}: significant, but moves nothing by more than {self.shift[0]:.2g} standard deviations; least squares will do"
        return f"{test}: no sign that least squares needs instruments"


def durbin_wu_hausman(
    ls: Estimate,
    iv: Estimate,
    equations: TorqueEquations,
    instruments: Array,
    nuisance: Array | None = None,
) -> HausmanTest:
    """Test least squares against instruments. ls, iv: estimates of the same equations by both. instruments, nuisance:
    as for `estimate`. Shapes (N, n, p) or (N, n, p + k), (N, n, k).
    """
    from scipy import stats  # slow to import

    if nuisance is not None:
        if instruments.shape[2] == equations.regressor.shape[2]:
            instruments = np.concatenate([instruments, nuisance], axis=2)
        equations = dataclasses.replace(
            equations, regressor=np.concatenate([equations.regressor, nuisance], axis=2)
        )
    fit = least_squares(equations, ls.scale)
    V, sines, strength = _unexplained(equations, fit, ls.scale, instruments)
    power = np.cumsum(sines**2) / max(float(np.sum(sines**2)), 1e-300)
    tested = min(int(np.sum(power < POWER)) + 1, int(np.sum(sines > NEGLIGIBLE)))
    shift = _shift(ls, iv)
    if tested == 0:
        return HausmanTest(0.0, 0, 1.0, shift, strength)
    p = equations.regressor.shape[2]
    wide = dataclasses.replace(
        equations, regressor=np.concatenate([equations.regressor, V[:, :, :tested]], axis=2)
    )
    found = estimate(
        wide, Method.FULL if np.count_nonzero(ls.scale) > len(ls.scale) else Method.WLS
    )
    extra = found.theta[p:]
    statistic = float(extra @ np.linalg.solve(found.covariance[p:, p:], extra))
    return HausmanTest(statistic, tested, float(stats.chi2.sf(statistic, tested)), shift, strength)


def _unexplained(
    equations: TorqueEquations, fit: LeastSquaresFit, scale: Array, instruments: Array
) -> tuple[Array, Array, float]:
    """V̂ in its principal directions, largest first. Shape (N, n, r); the sines that belong to them. Shape (r,); the smallest cosine."""
    r = fit.half.shape[1]
    rows = whiten(equations.regressor @ fit.half, scale).reshape(-1, r)
    Z = whiten(instruments, scale).reshape(len(rows), -1)
    size = np.linalg.norm(Z, axis=0)
    Z = Z[:, size > 0.0] / size[size > 0.0]
    Q, R = np.linalg.qr(Z)  # first, so that all that is long is done once
    U, s, _ = np.linalg.svd(R)
    U = Q @ U[:, s > 1e-9 * s[0]]
    left = rows - U @ (U.T @ rows)
    cosines = np.linalg.svd(U.T @ rows, compute_uv=False)
    _, sines, Vt = np.linalg.svd(np.linalg.qr(left)[1])
    principal = (left @ Vt.T).reshape(*equations.torque.shape, r)
    unweighted = np.einsum("ij,tjr->tir", scale, principal)
    return unweighted, sines, float(cosines[-1]) if len(cosines) == r else 0.0


def _shift(ls: Estimate, iv: Estimate) -> tuple[float, int]:
    deviation = np.sqrt(np.diag(iv.covariance))
    with np.errstate(invalid="ignore"):
        moved = np.where(
            np.isfinite(deviation) & (deviation > 0.0), np.abs(ls.theta - iv.theta) / deviation, 0.0
        )
    return float(moved.max()), int(moved.argmax())
