"""Delay between torque and position, joint by joint: τ(t − d) ≈ τ − d τ̇, τ̇ of the fitted torque, beside a refit of everything."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from .estimators import Estimate, least_squares
from .lowpass import Grid, LowPassFilter
from .regression import TorqueEquations

Array = np.ndarray
MOST = 20_000
"""Rows that settle a delay."""


@dataclass(frozen=True)
class TorqueDelay:
    """seconds: how much later torque was recorded than its position, per joint. deviation: its standard error. Shapes (n,)."""

    seconds: Array
    deviation: Array

    @property
    def common(self) -> tuple[float, float]:
        """Weighted mean over the joints and its standard error [s]: the delay of the whole clock, if they agree."""
        weight = 1.0 / np.maximum(self.deviation, 1e-12) ** 2
        return float(weight @ self.seconds / weight.sum()), float(weight.sum() ** -0.5)


def estimate_delay(equations: TorqueEquations, estimate: Estimate) -> TorqueDelay:
    """Delays from columns −dτ̂/dt added to the regressor, one a joint."""
    equations = equations if len(equations) <= MOST else equations.rows(slice(0, MOST))
    n, p = equations.n, equations.regressor.shape[2]
    slope = np.zeros_like(equations.torque)
    fitted = equations.predicted(estimate.theta)
    for stretch, periods in zip(equations.stretches(), equations.periods, strict=True):
        part = fitted[stretch]
        band = LowPassFilter(0.499 * equations.rate, equations.rate, len(part), periodic=periods > 0)
        slope[stretch] = band.low(part, Grid.RECORDED, 1)
    added = np.zeros((len(slope), n, n))
    added[:, range(n), range(n)] = -slope
    wider = dataclasses.replace(
        equations, regressor=np.concatenate([equations.regressor, added], axis=2)
    )
    fit = least_squares(wider, estimate.scale)
    return TorqueDelay(fit.theta[p:], np.linalg.norm(fit.half[p:], axis=1))
