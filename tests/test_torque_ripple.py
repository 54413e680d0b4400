"""Orders of torque ripple over a joint's angle."""

from __future__ import annotations

import numpy as np
import pytest

from excite._types import FloatArray
from excite.effects import torque_ripple

STEP = 1.6
GRID = np.arange(7.0, 60.0, STEP)


def strongest(q: FloatArray, residual: FloatArray, base: FloatArray) -> float:
    def waves(which: FloatArray) -> FloatArray:
        return np.exp(1j * np.outer(which, q))

    return torque_ripple.periodogram_peaks(waves, (GRID, waves(GRID), STEP), residual, base)[0]


@pytest.mark.parametrize("some", [slice(None), slice(None, None, 3)])
@pytest.mark.parametrize("order", [12.0, 14.0, 16.0])
def test_an_order_is_identified_that_the_base_model_mostly_absorbs(order, some):
    """Over a fifth of a turn, powers of the position nearly represent the ripple: without the base
    model, the periodogram has its maximum at another order."""
    rng = np.random.default_rng(3)
    q = 0.65 * np.sin(np.linspace(0.0, 47.0, 800))
    joint_columns = np.column_stack([q**k for k in range(6)] + [np.cos(3.0 * q), np.sin(5.0 * q)])
    gamma = np.stack([joint_columns, 0.1 * rng.normal(size=joint_columns.shape)], axis=1)
    torque = np.column_stack([np.cos(order * q + 1.0), np.zeros(len(q))]) + 0.03 * rng.normal(
        size=(len(q), 2)
    )
    fitted = torque - gamma @ np.linalg.lstsq(gamma.reshape(-1, 8), torque.ravel(), rcond=None)[0]
    residual, base = torque_ripple.without_base_columns(fitted[some], gamma[some], 0)
    with_base, without_base = (
        strongest(q[some], residual, base),
        strongest(q[some], fitted[some, 0], np.zeros((len(residual), 0))),
    )
    assert with_base == pytest.approx(order, abs=0.1) and abs(without_base - order) > 0.2


def test_a_joint_without_residual_gives_finite_columns():
    rng = np.random.default_rng(4)
    gamma, residual = (
        rng.normal(size=(300, 2, 5)),
        np.column_stack([rng.normal(size=300), np.zeros(300)]),
    )
    free, base = torque_ripple.without_base_columns(residual, gamma, 0)
    assert base.shape == (300, 5) and np.isfinite(free).all()
