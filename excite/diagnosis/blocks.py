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
    """Return least-squares coefficients (k,) and their sandwich covariance A⁻¹ Σ s sᵀ A⁻¹, (k, k).

    The blocks have columns (m, k) and a right side (m,); s is the share of a block in the score
    Aᵀ(y − Ax).
    """
    A, y = (
        np.concatenate([columns for columns, _ in blocks]),
        np.concatenate([right for _, right in blocks]),
    )
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = np.inf  # a column of zeros: coefficient 0, variance 0
    inverse = np.linalg.pinv((A / size).T @ (A / size), rcond=1e-10) / np.outer(size, size)
    estimate = inverse @ (A.T @ y)
    scores = np.array([columns.T @ (right - columns @ estimate) for columns, right in blocks])
    return estimate, inverse @ (scores.T @ scores) @ inverse
