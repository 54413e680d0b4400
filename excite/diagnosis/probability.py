"""Calibrated probabilities of effects, from their evidence.

The log Bayes factor of an effect is tempered, because no effect of a real robot has exactly the
form of its model, and added to prior log odds:

    P = 1/(1 + exp(−(ln B / T + λ)))

λ of the frictions that any joint may have is shared over the joints of a robot, since a maker's
gears are alike: with posterior probabilities P_j of n joints, λ = ln (ΣP_j + a)/(n − ΣP_j + b), the
log odds of a Beta(a, b) prior, iterated (an empirical Bayes estimate). λ of all others is constant.
T, a, b and λ are fitted by `scripts/calibrate.py`.
"""

from __future__ import annotations

import numpy as np

from .._types import FloatArray

TEMPERATURE = 40.0
"""Temperature T of the log Bayes factors."""
SHARED_COUNTS = (2.0, 1.0)
"""Counts a and b of the Beta prior of frictions that any joint may have."""
RARE_LOG_ODDS = -8.0
"""Prior log odds of any other effect at a joint, in which the search over its forms is included."""
SHARED_ROUNDS = 50
"""Iterations of the shared odds."""


def probability(log_bayes_factor: float | FloatArray, log_odds: float | FloatArray) -> FloatArray:
    """Return the probability of an effect.

    Args:
        log_bayes_factor: ln B.
        log_odds: Prior log odds λ.
    """
    x = np.asarray(log_bayes_factor, float) / TEMPERATURE + log_odds
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * np.clip(x, -700.0, 700.0))))


def shared_log_odds(log_bayes_factors: FloatArray) -> float:
    """Return the log odds of an effect that the joints of a robot share.

    Args:
        log_bayes_factors: ln B of the effect at every joint, shape (n,); −∞ where it is absent.
    """
    a, b = SHARED_COUNTS
    n, odds = len(log_bayes_factors), 0.0
    for _ in range(SHARED_ROUNDS):
        expected = float(np.sum(probability(log_bayes_factors, odds)))
        odds = float(np.log((expected + a) / (n - expected + b)))
    return odds
