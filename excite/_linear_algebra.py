"""Pseudo-inverses of tall matrices whose columns have different units."""

from __future__ import annotations

import numpy as np

Array = np.ndarray
RANK = 1e-8
"""Relative singular value, of columns at unit length, below which a direction is rounding noise."""


def factors(columns: Array) -> tuple[Array, Array]:
    """Orthonormal Q and S with Γ⁺ = S Qᵀ, with relative tolerance, columns at unit length. Shapes
    (m, p) -> (m, r), (p, r)."""
    size = np.linalg.norm(columns, axis=0)
    size[size <= 1e-9 * size.max(initial=0.0)] = np.inf
    u, s, vt = np.linalg.svd(columns / size, full_matrices=False)
    kept = s > RANK * s.max(initial=0.0)
    return u[:, kept], (vt[kept] / s[kept, None]).T / size[:, None]


def inverse(columns: Array) -> Array:
    """Γ⁺. Shapes (m, p) -> (p, m)."""
    q, s = factors(columns)
    return np.asarray(s @ q.T)
