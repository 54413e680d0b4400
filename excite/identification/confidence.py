"""How sure: intervals that cover, from the covariance of the data alone."""

from __future__ import annotations

import numpy as np

from .estimators import Estimate

Array = np.ndarray
CONFIDENCE_LEVEL = 0.95


def student_quantile(freedom: float, level: float = CONFIDENCE_LEVEL) -> float:
    """Student's t for a two-sided interval: the noise was estimated too."""
    from scipy import stats  # slow to import

    return float(stats.t.ppf(0.5 + 0.5 * level, max(freedom, 1.0)))


def interval_half_widths(estimate: Estimate, combinations: Array, level: float = CONFIDENCE_LEVEL) -> Array:
    """Half-widths of the intervals of linear combinations of θ; inf where the data doesn't show one. Shapes (m, p) -> (m,)."""
    hidden = ~np.isfinite(np.diag(estimate.covariance))
    covariance = np.where(np.isfinite(estimate.covariance), estimate.covariance, 0.0)
    deviation = np.sqrt(
        np.maximum(np.einsum("mi,ij,mj->m", combinations, covariance, combinations), 0.0)
    )
    deviation[np.any(np.abs(combinations[:, hidden]) > 0.0, axis=1)] = np.inf
    return student_quantile(estimate.freedom, level) * deviation
