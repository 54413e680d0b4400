"""Padding of signals at their ends, for filters that reach beyond them."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray


def pad_by_reflection(x: FloatArray, before: int, after: int) -> FloatArray:
    """Continue a signal at both ends by odd reflection, 2 x₀ − x₋ₖ.

    Args:
        x: Evenly sampled signals. Shape (N, …).
        before: Number of rows to add at the start, less than N.
        after: Number of rows to add at the end, less than N.

    Returns:
        The signals with value and slope continuous at the ends. Shape (before + N + after, …).
    """
    head = 2.0 * x[0] - x[before:0:-1]
    tail = 2.0 * x[-1] - x[-2 : -after - 2 : -1]
    return np.concatenate([head, x, tail])
