"""Columns of small regressions."""

from __future__ import annotations

import numpy as np

from excite.diagnosis.regression import Columns


def columns_on_all_joints(
    torque: np.ndarray, nonnegative: np.ndarray, prior_std: np.ndarray
) -> Columns:
    """Return columns that act on every joint.

    Args:
        torque: Torque per unit of each coefficient, shape (N, n, k).
        nonnegative: Coefficients that cannot be negative, shape (k,).
        prior_std: Prior standard deviation of each coefficient, shape (k,).
    """
    n = torque.shape[1]
    return Columns(tuple(range(n)), tuple(torque.swapaxes(0, 1)), nonnegative, prior_std)
