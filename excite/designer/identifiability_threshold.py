"""Decision whether a direction of the parameters is practically identifiable.

The command line states the default threshold, so this module imports nothing large.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .._types import BoolArray, FloatArray

IDENTIFIABLE_VARIANCE = 1e-2
"""Largest scale-free variance of an identifiable direction [1]: a standard deviation of about 10 %
(Lee, Kwon, Wensing and Park, section 4.4)."""


def is_identifiable(eigenvalues: FloatArray, threshold: float) -> BoolArray:
    """Return which directions are practically identifiable: those with 1/λ ≤ threshold.

    Args:
        eigenvalues: Eigenvalues λ of I·H₀⁻¹, 0 where a direction is not excited. Shape (p,).
        threshold: Largest scale-free variance of an identifiable direction [1].

    Returns:
        Mask of the directions. Shape (p,).
    """
    return eigenvalues * threshold >= 1.0
