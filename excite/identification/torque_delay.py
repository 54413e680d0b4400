"""Delay d between torque and position: τ(t − d) ≈ τ − d τ̇, fitted with all parameters."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from . import estimators
from .estimators import Estimate
from .lowpass import Grid, LowPassFilter
from .regression import TorqueEquations

MAX_DELAY_ROWS = 20_000
"""Number of rows from which delays are estimated, at most."""


MIN_SIGNIFICANCE = 3.0
"""Standard errors from which a delay is told from none."""


@dataclass(frozen=True)
class TorqueDelay:
    """Delay of the torque signals.

    Attributes:
        seconds: Time by which torque is recorded later than the position. Shape (n,) [s].
        deviation: Standard error of the delay. Shape (n,) [s].
    """

    seconds: FloatArray
    deviation: FloatArray

    @property
    def common(self) -> tuple[float, float]:
        """Weighted mean over the joints and its standard error [s]."""
        weight = 1.0 / np.maximum(self.deviation, 1e-12) ** 2
        return float(weight @ self.seconds / weight.sum()), float(weight.sum() ** -0.5)

    @property
    def significant(self) -> FloatArray:
        """Delays that are told from none, 0 elsewhere. Shape (n,) [s]."""
        is_significant = np.abs(self.seconds) > MIN_SIGNIFICANCE * self.deviation
        return np.where(is_significant, self.seconds, 0.0)


def estimate_delay(equations: TorqueEquations, estimate: Estimate) -> TorqueDelay:
    """Estimate delays by columns −dτ̂/dt, one per joint, added to the regressor.

    Args:
        equations: The equations.
        estimate: Estimate of their parameters, which predicts τ̂.
    """
    n, p = equations.n, equations.regressor.shape[2]
    columns = np.zeros((len(equations), n, n))
    fitted = equations.predicted(estimate.theta)
    for stretch, periods in zip(equations.stretches(), equations.periods, strict=True):
        part, time = fitted[stretch], equations.time[stretch]
        rate = (len(part) - 1) / float(time[-1] - time[0])
        band = LowPassFilter(0.499 * rate, rate, len(part), periodic=periods > 0)
        columns[stretch, range(n), range(n)] = -band.filter(part, Grid.RECORDED, 1)
    extended = dataclasses.replace(
        equations, regressor=np.concatenate([equations.regressor, columns], axis=2)
    )
    if len(extended) > MAX_DELAY_ROWS:
        extended = extended.rows(slice(0, MAX_DELAY_ROWS))
    fit = estimators.estimate(extended)
    return TorqueDelay(fit.theta[p:], np.sqrt(np.diag(fit.covariance)[p:]))
