"""Least squares with standard errors between blocks of rows, valid for noise of any colour.

Noise must decorrelate within a block (Liang & Zeger 1986).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._types import FloatArray

BLOCK_SECONDS = 1.0
"""Length of a block [s], longer than the correlation time of a servo's noise."""


def sandwiched(blocks: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Return least-squares coefficients and their sandwich covariance A⁻¹ Σ s sᵀ A⁻¹.

    Here s is a block's share of the score Aᵀ(y − Ax).

    Args:
        blocks: Columns, shape (m, k), and right side, shape (m,), of each block.

    Returns:
        Coefficients, shape (k,), and covariance, shape (k, k).
    """
    A, y = (
        np.concatenate([columns for columns, _ in blocks]),
        np.concatenate([right for _, right in blocks]),
    )
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = np.inf  # what is nowhere is nothing, for sure
    inverse = np.linalg.pinv((A / size).T @ (A / size), rcond=1e-10) / np.outer(size, size)
    estimate = inverse @ (A.T @ y)
    scores = np.array([columns.T @ (right - columns @ estimate) for columns, right in blocks])
    return estimate, inverse @ (scores.T @ scores) @ inverse
