"""Why an effect that had some evidence is no finding, in words.

The probability of an effect is a product (`probability`, `estimates`): that of its evidence, that
of its size, the share that no other effect takes, and the share that unmodelled torque leaves. The
smallest factor is the reason. An effect that is probable on its own, and yet not in the model, is
too small, predicts recordings that it is not fitted to worse, or is not needed next to others.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from . import cross_validation, posterior, probability
from .diagnosis import Diagnosis
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
WEAK_EVIDENCE = "weak evidence"
"""Reason: noise may well look like it."""
WEAK_FRICTION = "weak evidence: other friction curves look like it"
"""Reason: a friction whose evidence does not outweigh the error of its form."""


def reason(diagnosis: Diagnosis, estimate: EffectEstimate) -> str:
    """Return why an effect is no finding.

    Args:
        diagnosis: The diagnosis.
        estimate: An effect of it that is not asserted.
    """
    if estimate.spoils_prediction:
        return SPOILS_PREDICTION
    if estimate.probability >= MIN_PROBABILITY:
        if estimate.unique_severity < MIN_SEVERITY:
            return TOO_SMALL
        return EXPLAINED_AS_WELL if _predicts(diagnosis, estimate) else SPOILS_PREDICTION
    if estimate.effect in FRICTIONS:
        if estimate.unique_severity < MIN_SEVERITY:
            return TOO_SMALL
        alone = _by_evidence(diagnosis, estimate)
        return NEXT_TO_UNKNOWN if alone >= MIN_PROBABILITY else WEAK_FRICTION
    factors = _factors(diagnosis, estimate)
    return min(factors, key=lambda words: factors[words])


def _predicts(diagnosis: Diagnosis, estimate: EffectEstimate) -> bool:
    """Tell whether an effect lowers the error on recordings to which it is not fitted."""
    model = diagnosis.model
    needed = {(e.effect, e.joint) for e in diagnosis.effects if e.needed}
    numbers = posterior.effect_groups(model).get((estimate.effect, estimate.joint), ())
    others = {
        number
        for key, group in posterior.effect_groups(model).items()
        if key not in needed
        for number in group
    }
    return not numbers or cross_validation.pays(model, numbers, others - set(numbers))


def _by_evidence(diagnosis: Diagnosis, estimate: EffectEstimate) -> float:
    """Return the probability of a friction or ripple by its evidence and that of other joints."""
    alike = [e for e in diagnosis.effects if e.effect == estimate.effect]
    shared = posterior.shared_probabilities(diagnosis.model.n, [e.log_bayes_factor for e in alike])
    return shared[alike.index(estimate)]


def _factors(diagnosis: Diagnosis, estimate: EffectEstimate) -> dict[str, float]:
    """Return the factors of the probability of an effect that is no friction, by their reason."""
    size = max(estimate.unique_severity, 1e-9)
    factor = estimate.log_bayes_factor
    if estimate.effect in DENSE_NAMES:
        if size < MIN_SEVERITY:
            return {TOO_SMALL: 0.0}
        evidence = alone = _by_evidence(diagnosis, estimate)
    else:
        logit = factor / probability.RARE_TEMPERATURE + probability.RARE_LOG_ODDS
        evidence = float(special.expit(logit))
        alone = float(probability.rare_probability(factor, size))
    remaining = max(
        (
            u.size / diagnosis.model.regression.sigma[u.joint]
            for u in diagnosis.unmodelled
            if estimate.joint in (None, u.joint)
        ),
        default=0.0,
    )
    shared = float(np.clip(estimate.probability / max(alone, 1e-300), 0.0, 1.0))
    known = size**2 / (size**2 + remaining**2)
    if shared > known:  # the effect was never in the model: unmodelled torque does not count
        known = 1.0
    return {
        TOO_SMALL: alone / max(evidence, 1e-300),
        WEAK_EVIDENCE: evidence,
        EXPLAINED_AS_WELL: shared / known,
        NEXT_TO_UNKNOWN: known,
    }
