"""Correlation between the successive rows of a residual, which reduces their information."""

from __future__ import annotations

from .._types import FloatArray

MAX_LAG = 40
"""Lags of the autocorrelation that are summed [rows]."""
MIN_AUTOCORRELATION = 0.02
"""Autocorrelation at which the sum ends, about two standard errors of 10,000 rows."""


def correlation_length(x: FloatArray) -> float:
    """Return the number of successive rows of a signal that are worth one independent row.

    It is 1 + 2 Σ r_k over the autocorrelations r_k up to the first that is not significant.

    Args:
        x: The signal, with zeros where it does not count. Shape (N,).
    """
    power, length = float(x @ x), 1.0
    for lag in range(1, min(MAX_LAG, len(x) - 1)):
        correlation = float(x[lag:] @ x[:-lag]) / max(power, 1e-300)
        if correlation < MIN_AUTOCORRELATION:
            break
        length += 2.0 * correlation
    return length
