"""Evidence between effects that may explain the same torque.

The members of a class are compared one at a time, each without the others and jointly with all
other effects of the model, which are refitted:

    ln B_ab = ln p(τ | a, not b) − ln p(τ | b, not a)

in the Laplace approximation of `posterior`. The log odds are ln B_ab/T′ with the temperature T′ of
`probability`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from ..effects import EFFECTS_BY_NAME
from ..effects.effect import CandidateModel, Key
from ..effects.form_error import with_form_error
from ..schemas.effects import CONFUSABLE_PAIRS
from . import probability, rare_candidates
from .estimates import EffectEstimate
from .joint_model import JointModel
from .rare_candidates import Candidate, CandidateShapes

MIN_OPTIMISED_SHARE = 0.3
"""Evidence on the grid over that of the strongest member from which a rival is optimised."""
DECIDED_LOG_ODDS = float(np.log(1.0 / rare_candidates.EQUIVALENT_SHARE))
"""Log odds from which a pair is decided [nat]: the rival is no equivalent any more."""


def log_odds(log_bayes_factor: float) -> float:
    """Return calibrated log odds between two effects [nat]."""
    return log_bayes_factor / probability.RARE_TEMPERATURE


def not_excluded(
    model: JointModel, effects: Sequence[EffectEstimate], trusted: bool
) -> dict[Key, dict[str, float]]:
    """Return the log Bayes factor of each finding over every rival that is not excluded.

    Rivals are its equivalents, and the effects with which it is often confused and which the model
    does not have at the joint anyway. If the base model is trusted, these may be effects that a
    refit of it absorbs. Only another effect of no single joint is a rival of such an effect.
    """
    out = {}
    for finding in (effect for effect in effects if effect.asserted):
        names = list(finding.equivalents)
        if finding.joint is not None:
            present = {e.effect for e in effects if e.needed and e.joint == finding.joint}
            pairs = [pair for pair in CONFUSABLE_PAIRS if finding.effect in pair]
            names += [
                name
                for name in itertools.chain(*pairs)
                if name not in present and (trusted or not EFFECTS_BY_NAME[name].prior_only)
            ]
        if not names:
            continue
        names = list(dict.fromkeys(names))
        evidence = compare(model, effects, finding.joint, (finding.effect, *names))
        factors = {name: evidence[finding.effect] - evidence[name] for name in names}
        out[finding.key] = {
            name: factor
            for name, factor in factors.items()
            if name in finding.equivalents or log_odds(factor) < DECIDED_LOG_ODDS
        }
    return out


def compare(
    model: JointModel, effects: Sequence[EffectEstimate], joint: int | None, names: Sequence[str]
) -> dict[str, float]:
    """Return the log evidence of the model with each member of a class alone, up to a constant.

    An effect that the joint model lacks enters with its best plausible form; one that has none
    counts like no effect.
    """
    needed = {e.key for e in effects if e.needed}
    members = {
        name: [m for m in model.models if m.effect == name and _is_at(m, joint)] for name in names
    }
    excluded = {id(m) for group in members.values() for m in group}
    kept = [i for i, m in enumerate(model.models) if m.key in needed and id(m) not in excluded]
    reduced = model.keeping(kept)
    present = {
        name: CandidateShapes.of(reduced, (m.exact or m for m in group)).fitted(reduced)
        for name, group in members.items()
    }
    strongest = max((c.evidence for group in present.values() for c in group), default=0.0)
    varied = {
        name: _varied(reduced, group or _best_form(reduced, name, joint, strongest))
        for name, group in present.items()
    }
    together = reduced.with_effects([m for group in varied.values() for m in group])
    regression = together.regression
    log_evidence = {}
    for name, group in varied.items():
        others = [i for i, m in enumerate(together.models) if i >= len(kept) and m not in group]
        log_evidence[name] = regression.log_evidence(regression.without(others))
    return log_evidence


def _is_at(shape: CandidateModel, joint: int | None) -> bool:
    """Tell whether a model belongs to a joint, or to the whole robot."""
    return joint is None or shape.joint in (None, joint)


def _best_form(
    reduced: JointModel, name: str, joint: int | None, strongest: float
) -> list[Candidate]:
    """Return the best plausible form of an effect, optimised if it may come near the strongest."""
    forms = EFFECTS_BY_NAME[name].candidates(reduced.motions)
    shapes = CandidateShapes.of(reduced, (shape for shape in forms if _is_at(shape, joint)))
    plausible = [candidate for candidate in shapes.fitted(reduced) if candidate.is_plausible]
    if not plausible:
        return []
    best = max(plausible, key=lambda c: c.evidence)
    if best.evidence < MIN_OPTIMISED_SHARE * strongest:
        return [best]
    return [rare_candidates.optimised(reduced, best)]


def _varied(reduced: JointModel, group: Sequence[Candidate]) -> list[CandidateModel]:
    """Return the models of an effect with the discrepancy of its form, which all members have."""
    out = []
    for candidate in group:
        shape, c = candidate.model, candidate.fit.coefficients
        bounded = shape.nonnegative or (False,) * len(c)
        varied = with_form_error(shape, reduced.motions, np.where(bounded, np.maximum(c, 0.0), c))
        out.append(varied if reduced.columns(varied) is not None else shape)
    return out
