"""Orders of waves over a joint's angle."""

from __future__ import annotations

import numpy as np
import pytest

from excite.effects import torque_ripple

Array = np.ndarray
STEP = 1.6
GRID = np.arange(7.0, 60.0, STEP)


def strongest(q: Array, left: Array, base: Array) -> float:
    def waves(which: Array) -> Array:
        return np.exp(1j * np.outer(which, q))

    return torque_ripple._periodogram_peaks(waves, (GRID, waves(GRID), STEP), left, base)[0]


@pytest.mark.parametrize("some", [slice(None), slice(None, None, 3)])
@pytest.mark.parametrize("order", [12.0, 14.0, 16.0])
def test_an_order_is_found_that_the_base_has_taken_most_of(order, some):
    """Over a fifth of a turn, where powers of the place nearly say it: alone it is strongest where
    they say less."""
    rng = np.random.default_rng(3)
    q = 0.65 * np.sin(np.linspace(0.0, 47.0, 800))
    own = np.column_stack([q**k for k in range(6)] + [np.cos(3.0 * q), np.sin(5.0 * q)])
    gamma = np.stack([own, 0.1 * rng.normal(size=own.shape)], axis=1)
    torque = np.column_stack([np.cos(order * q + 1.0), np.zeros(len(q))]) + 0.03 * rng.normal(
        size=(len(q), 2)
    )
    fitted = torque - gamma @ np.linalg.lstsq(gamma.reshape(-1, 8), torque.ravel(), rcond=None)[0]
    left, base = torque_ripple._without_base(fitted[some], gamma[some], 0)
    beside, bare = (
        strongest(q[some], left, base),
        strongest(q[some], fitted[some, 0], np.zeros((len(left), 0))),
    )
    assert beside == pytest.approx(order, abs=0.1) and abs(bare - order) > 0.2


def test_a_joint_of_which_nothing_is_left_outweighs_no_other():
    rng = np.random.default_rng(4)
    gamma, left = (
        rng.normal(size=(300, 2, 5)),
        np.column_stack([rng.normal(size=300), np.zeros(300)]),
    )
    free, base = torque_ripple._without_base(left, gamma, 0)
    assert base.shape == (300, 5) and np.isfinite(free).all()
