"""Padding of signals at their ends, for filters that reach beyond them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .._types import FloatArray

RESPONSE_PADDING = 32
"""Rows by which a signal is continued at either end before it passes a filter, at least; the
impulse responses of a shift by less than a row, and of filters of recorded torque, are shorter."""


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


def pad_to_fast_length(x: FloatArray, reach: int) -> tuple[FloatArray, int]:
    """Continue a signal by odd reflection, to a length with a fast Fourier transform.

    Args:
        x: Evenly sampled signals. Shape (N, …).
        reach: Number of rows to add at either end, at least; fewer if the signal has fewer.

    Returns:
        The signals, and the row at which they begin.
    """
    from scipy.fft import next_fast_len  # slow to import

    count, head = len(x), min(reach, len(x) - 1)
    tail = min(next_fast_len(count + 2 * head, real=True) - count - head, count - 1)
    return pad_by_reflection(x, head, tail), head


def with_response(
    x: FloatArray,
    response: Callable[[int], NDArray[np.complex128]],
    periodic: bool = False,
) -> FloatArray:
    """Return signals that have passed a filter.

    Args:
        x: Evenly sampled signals. Shape (N, …).
        response: Frequency response at the frequencies of `rfftfreq`, by the number of rows.
        periodic: Whether the signals repeat; otherwise their ends are continued by reflection.

    Returns:
        The filtered signals. Shape (N, …).
    """
    columns = x.reshape(len(x), -1)
    nonzero = np.flatnonzero(columns.any(axis=0))  # most of a regressor is zero by structure
    lines, head = columns[:, nonzero], 0
    if not periodic:
        lines, head = pad_to_fast_length(lines, RESPONSE_PADDING)
    out, count = np.zeros(columns.shape), len(lines)
    passed = np.fft.irfft(np.fft.rfft(lines.T) * response(count), count)
    out[:, nonzero] = passed[:, head : head + len(x)].T
    return out.reshape(x.shape)
