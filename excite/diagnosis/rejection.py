"""Why an effect that had some evidence is no finding, in words.

The probability of an effect is a product (`probability.Probability`); its smallest factor is the
reason. An effect that is probable and yet not in the model is too small, predicts recordings that
it is not fitted to worse, or is not needed next to others.
"""

from __future__ import annotations

from .estimates import MIN_PROBABILITY, EffectEstimate
from .joint_model import FRICTIONS
from .posterior import DENSE_NAMES, MIN_SEVERITY

TOO_SMALL = "too small against the noise"
"""Reason: the torque that only this effect explains would hardly matter."""
EXPLAINED_AS_WELL = "another effect explains it as well"
"""Reason: the model does not need it next to the others."""
NEXT_TO_UNKNOWN = "next to unknown torque, of which it may be a part"
"""Reason: torque that no effect explains is larger."""
SPOILS_PREDICTION = "spoils the prediction of recordings it is not fitted to"
"""Reason: cross-validation."""
PRIOR_IN_DOUBT = "the parameters of the prior are in doubt, and it may be a part of their error"
"""Reason: identified anew, the base model alone explains more."""
ERRORS_OF_POSITIONS = "noise or steps of the recorded positions look like it"
"""Reason: next to such errors there is hardly evidence for the effect."""
WEAK_EVIDENCE = "weak evidence"
"""Reason: noise may well look like it."""
WEAK_FRICTION = "weak evidence: other friction curves look like it"
"""Reason: a friction whose evidence does not outweigh the error of its form."""


def reason(estimate: EffectEstimate) -> str:
    """Return why an effect is no finding."""
    if estimate.spoils_prediction:
        return SPOILS_PREDICTION
    if estimate.effect in DENSE_NAMES and estimate.size < MIN_SEVERITY:
        return TOO_SMALL
    if estimate.probability >= MIN_PROBABILITY:
        return EXPLAINED_AS_WELL
    probable = estimate.probable
    weak = WEAK_FRICTION if estimate.effect in FRICTIONS else WEAK_EVIDENCE
    if estimate.by_errors > estimate.log_bayes_factor:
        weak = ERRORS_OF_POSITIONS
    factors = {
        TOO_SMALL: probable.size,
        weak: probable.evidence,
        EXPLAINED_AS_WELL: probable.share,
        NEXT_TO_UNKNOWN: probable.known,
        PRIOR_IN_DOUBT: probable.prior,
    }
    return min(factors, key=lambda words: factors[words])
