"""The ends of an evenly sampled stretch, where a filter would look beyond it."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def reflected(x: Array, before: int, behind: int) -> Array:
    """Continued by so many rows, fewer than there are, by reflection through the ends. Shapes (N,
    …) -> (before + N + behind, …)."""
    return np.concatenate([2.0 * x[0] - x[before:0:-1], x, 2.0 * x[-1] - x[-2 : -behind - 2 : -1]])
