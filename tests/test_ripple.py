"""Orders of waves over a joint's angle."""

from __future__ import annotations

import numpy as np
import pytest

from excite.diagnose.catalogue import ripple

Array = np.ndarray


@pytest.mark.parametrize("order", [12.0, 14.0, 16.0])
def test_an_order_is_found_that_the_base_has_taken_most_of(order):
    """Over a sixth of a turn, which waves and powers of the base nearly span: the wave alone is strongest where the base takes least."""
    rng = np.random.default_rng(3)
    q = 0.65 * np.sin(np.linspace(0.0, 47.0, 800))
    base = np.linalg.qr(np.column_stack([q**k for k in range(6)] + [np.cos(3.0 * q), np.sin(5.0 * q)]))[0]
    torque = np.cos(order * q + 1.0) + 0.03 * rng.normal(size=len(q))
    left, grid, step = torque - base @ (base.T @ torque), np.arange(7.0, 60.0, 1.6), 1.6

    def waves(which: Array) -> Array:
        return np.exp(1j * np.outer(which, q))

    beside, bare = (ripple._peaks(waves, (grid, waves(grid), step), left, b)[0] for b in (base, np.zeros((len(q), 0))))
    assert beside == pytest.approx(order, abs=0.25) and abs(bare - order) > 0.5
