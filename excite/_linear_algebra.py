"""Triangles of tall matrices, and their pseudo-inverse where columns have different units."""

from __future__ import annotations

import numpy as np

from ._types import FloatArray

RANK_TOLERANCE = 1e-8
"""Smallest singular value that counts, relative to the largest, with columns of unit length [1]:
about the square root of the precision of double numbers."""


def triangle(rows: FloatArray) -> FloatArray:
    """Return R of the QR factorisation: the fewest rows with the same RᵀR. Shape (≤ p, p)."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def factors(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Factor the pseudo-inverse of a matrix: Γ⁺ = S Qᵀ with orthonormal columns of Q.

    The columns are scaled to unit length before the singular value decomposition, so that the rank
    does not depend on their units.

    Args:
        columns: Γ. Shape (m, p).

    Returns:
        Q, shape (m, r), and S, shape (p, r), where r is the numerical rank.
    """
    size = np.linalg.norm(columns, axis=0)
    size[size <= 1e-9 * size.max(initial=0.0)] = np.inf
    u, s, vt = np.linalg.svd(columns / size, full_matrices=False)
    kept = s > RANK_TOLERANCE * s.max(initial=0.0)
    return u[:, kept], (vt[kept] / s[kept, None]).T / size[:, None]


def inverse(columns: FloatArray) -> FloatArray:
    """Return the pseudo-inverse Γ⁺ of a matrix. Shape (m, p) -> (p, m)."""
    q, s = factors(columns)
    return np.asarray(s @ q.T)
