"""Least squares whose errors are told between blocks of rows: noise that forgets within a block has any colour (Liang & Zeger 1986)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Array = np.ndarray


def sandwiched(blocks: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Coefficients and their covariance A⁻¹ Σ s sᵀ A⁻¹, s a block's share of Aᵀ(y − Ax). blocks: columns and right side of each,
    (m, k) and (m,). Shapes (k,), (k, k)."""
    A, y = (
        np.concatenate([columns for columns, _ in blocks]),
        np.concatenate([right for _, right in blocks]),
    )
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = np.inf  # what is nowhere is nothing, for sure
    inverse = np.linalg.pinv((A / size).T @ (A / size), rcond=1e-10) / np.outer(size, size)
    found = inverse @ (A.T @ y)
    scores = np.array([columns.T @ (right - columns @ found) for columns, right in blocks])
    return found, inverse @ (scores.T @ scores) @ inverse
