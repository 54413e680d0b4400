"""Triangle of tall matrices."""

from __future__ import annotations

import numpy as np

from ._types import FloatArray


def triangle(rows: FloatArray) -> FloatArray:
    """Return R of the QR factorisation: the fewest rows with the same RᵀR. Shape (≤ p, p)."""
    return np.asarray(np.linalg.qr(rows, mode="r"))
