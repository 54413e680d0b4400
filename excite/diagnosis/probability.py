"""Calibrated probabilities of effects, from their evidence and their size.

No effect of a real robot has exactly the form of its model, so that evidence for one is tempered;
evidence against it is not, since that has nothing to do with its form:

    frictions that any joint may have:  P = σ(max(ln B, 0)/T + min(ln B, 0) + λ_j)
    all others:                         P = σ(ln B / T′ + λ′) Φ(ln(s/s₀)/w)

σ(x) = 1/(1 + exp(−x)), Φ is the normal distribution, s the RMS torque beyond what all other effects
could explain, over the noise. A maker's gears are alike, so that the odds follow from the other
joints of the robot: with their probabilities P_k, λ_j = ln (ΣP_k + a)/(n − 1 − ΣP_k + b), the log
odds of a Beta(a, b) prior, iterated over all joints (an empirical Bayes estimate).
`scripts/calibrate.py` fits the constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from .._types import FloatArray

TEMPERATURE = 40.0
"""Temperature T of frictions that any joint may have."""
SHARED_COUNTS = (0.2, 0.5)
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


@dataclass(frozen=True)
class Probability:
    """Probability of an effect, the product of what has to be true.

    Attributes:
        evidence: That it is not noise, by its evidence, and that of other joints for a friction.
        size: That it is larger than errors of the forms of others; 1 for a friction of
            the model, and that it counts for any other.
        share: That it, or one of its equivalents, is there, and no other effect in its place.
        known: That it is no part of torque that no effect explains.
        prior: That it is no part of an error of the trusted parameters.
    """

    evidence: float
    size: float = 1.0
    share: float = 1.0
    known: float = 1.0
    prior: float = 1.0

    @property
    def value(self) -> float:
        """The product."""
        return self.evidence * self.size * self.share * self.known * self.prior


def friction_probabilities(log_bayes_factors: FloatArray) -> FloatArray:
    """Return the probability of a friction at every joint of a robot, shape (n,).

    ln B of the friction at every joint has the same shape; −∞ where it is absent.
    """
    a, b = SHARED_COUNTS
    evidence = tempered(log_bayes_factors, TEMPERATURE)
    out = np.asarray(special.expit(evidence))
    for _ in range(SHARED_ROUNDS):
        others = out.sum() - out
        odds = np.log((others + a) / (len(out) - 1 - others + b))
        out = np.asarray(special.expit(evidence + odds))
    return out


def rare_probability(log_bayes_factor: float, size: float) -> Probability:
    """Return the probability of any other effect, of a size over the noise [1]."""
    return Probability(float(by_evidence(log_bayes_factor)), float(by_size(size)))


def tempered(log_bayes_factors: FloatArray, temperature: float = RARE_TEMPERATURE) -> FloatArray:
    """Return evidence at several joints, tempered where it is for an effect."""
    return np.where(log_bayes_factors > 0.0, log_bayes_factors / temperature, log_bayes_factors)


def beyond_errors(log_bayes_factor: float, by_errors: float) -> float:
    """Return the evidence ln B for an effect beyond that which errors of the positions give it.

    Errors that give it the log Bayes factor N, with coefficients c of c²/(2 σ²) = N, multiply their
    variance σ² by 1 + 2 N: the evidence is ln B/(1 + 2 N). Evidence against it is not theirs.
    """
    return (
        log_bayes_factor / (1.0 + 2.0 * by_errors) if log_bayes_factor > 0.0 else log_bayes_factor
    )


def by_evidence(log_bayes_factor: float | FloatArray) -> FloatArray:
    """Return the probability of any other effect that is large, σ(ln B / T′ + λ′)."""
    return np.asarray(
        special.expit(np.asarray(log_bayes_factor) / RARE_TEMPERATURE + RARE_LOG_ODDS)
    )


def by_size(
    size: float | FloatArray, least: float = RARE_SIZE, spread: float = RARE_SPREAD
) -> FloatArray:
    """Return the probability Φ(ln(s/s₀)/w) that an effect is large enough.

    By default, for evidence for any effect other than a friction to be its own. s is the RMS torque
    beyond all that other effects could explain, over the noise; s₀ is the `least` of it, at which
    that is as probable as not; w is the `spread` of its logarithm.
    """
    size_odds = np.log(np.maximum(np.asarray(size), 1e-9) / least) / spread
    return np.asarray(special.ndtr(size_odds))
