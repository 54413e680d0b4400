"""Calibrated probabilities of effects, from their evidence and their size.

No effect of a real robot has exactly the form of its model, so that evidence for one is tempered:
it also explains a part of what another form leaves. Evidence against it is not, since that has
nothing to do with its form. What is small against the noise is no evidence for a rare effect:

    frictions that any joint may have:  P = σ(max(ln B, 0)/T + min(ln B, 0) + λ)
    all others:                         P = σ(ln B / T′ + λ′) Φ(ln(s/s₀)/w)

σ(x) = 1/(1 + exp(−x)), Φ is the normal distribution, s the RMS torque beyond what all other effects
could stand for, over the noise. λ is shared over the joints of a robot, since a maker's gears are
alike: with posterior probabilities P_j of n joints, λ = ln (ΣP_j + a)/(n − ΣP_j + b), the log odds
of a Beta(a, b) prior, iterated (an empirical Bayes estimate). `scripts/calibrate.py` fits the
constants.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from .._types import FloatArray

TEMPERATURE = 40.0
"""Temperature T of frictions that any joint may have."""
SHARED_COUNTS = (0.5, 1.0)
"""Counts a and b of their Beta prior."""
RARE_TEMPERATURE = 5.0
"""Temperature T′ of all other effects."""
RARE_LOG_ODDS = -5.0
"""Their prior log odds λ′ at a joint; the search over their forms is included."""
RARE_SIZE = 0.8
"""Size s₀ at which one is as probable as not, over the noise."""
RARE_SPREAD = 0.35
"""Spread w of the logarithm of that size."""
SHARED_ROUNDS = 50
"""Iterations of the shared odds."""


def friction_probability(
    log_bayes_factor: float | FloatArray, log_odds: float | FloatArray
) -> FloatArray:
    """Return the probability of a friction that any joint may have.

    Args:
        log_bayes_factor: ln B.
        log_odds: Prior log odds λ.
    """
    factor = np.asarray(log_bayes_factor)
    tempered = np.maximum(factor, 0.0) / TEMPERATURE + np.minimum(factor, 0.0)
    return np.asarray(special.expit(tempered + log_odds))


def shared_log_odds(log_bayes_factors: FloatArray) -> float:
    """Return the log odds of a friction that the joints of a robot share.

    Args:
        log_bayes_factors: ln B of the friction at every joint, shape (n,); −∞ where it is absent.
    """
    a, b = SHARED_COUNTS
    n, odds = len(log_bayes_factors), 0.0
    for _ in range(SHARED_ROUNDS):
        expected = float(np.sum(friction_probability(log_bayes_factors, odds)))
        odds = float(np.log((expected + a) / (n - expected + b)))
    return odds


def rare_probability(log_bayes_factor: float | FloatArray, size: float | FloatArray) -> FloatArray:
    """Return the probability of any other effect.

    Args:
        log_bayes_factor: ln B.
        size: RMS torque beyond what all other effects could stand for, over the noise.
    """
    evidence = special.expit(np.asarray(log_bayes_factor) / RARE_TEMPERATURE + RARE_LOG_ODDS)
    size_odds = np.log(np.maximum(np.asarray(size), 1e-9) / RARE_SIZE) / RARE_SPREAD
    return np.asarray(evidence * special.ndtr(size_odds))
