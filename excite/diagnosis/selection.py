"""Selection of rare effects, one at a time, on top of the joint model.

Every candidate is scored by the evidence that it adds for the whole robot, jointly with all that
the model has. The best enters, its nonlinear parameters optimised, and is judged after the weights
of the rows are renewed: an effect that is left out makes its own residual look correlated, and so
hides itself.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects.effect import CandidateModel, Key
from ..effects.recorded_motion import Motions
from ..identification.identification import Identification
from ..schemas.effects import FORM_ERROR_STD
from . import cross_validation, filter_search, joint_model, posterior, probability
from .filter_search import FilterFits
from .flexible_models import UNMODELLED, flexible_models
from .joint_model import FRICTIONS, JointModel
from .position_errors import PositionErrors
from .posterior import EffectEvidence
from .rare_candidates import (
    EQUIVALENT_SHARE,
    MIN_CANDIDATE_EVIDENCE,
    TIE,
    Candidate,
    CandidateColumns,
    CandidateShapes,
    Ranking,
    is_of_link,
    optimised,
    tuned,
)
from .regression import log_error_ratio

MAX_RESTARTS = 5
"""Fits of the frictions, each from the recording chain of the one before, until its delay settles:
presliding hysteresis and widths of Coulomb friction follow a delay slowly [1]. One or two were
needed where a delay was recorded; the limit is for motions in which it does not settle."""
MAX_RARE_EFFECTS = 8
"""Rare effects that are added at most."""
OPTIMISED_CANDIDATES = 4
"""Candidates whose nonlinear parameters are optimised before the best is chosen."""
LAST_RESORTS = (UNMODELLED, "contact")
"""Explanations that are tried when no other is left: a flexible model fits what remains, and the
time of a contact is chosen where most remains."""
MAX_REJECTIONS = 3
"""Candidates that are tried in vain before the next effect enters: of the catalogue at each joint,
until one enters there, of contacts and of flexible models on the whole robot."""


@dataclass(frozen=True)
class RareEffect:
    """An effect that was added to the joint model, and what else might be in its place.

    Attributes:
        evidence: Its log Bayes factor before it was added.
        before: Log Bayes factors, before it was added, of all other effects that were not tried in
            vain.
        after: The same after it was added; an effect that is not listed has none.
        final: Its log Bayes factor with the weights of the rows after it was added.
    """

    key: Key
    evidence: float
    before: Mapping[Key, float]
    after: Mapping[Key, float]
    final: float

    def share(self, present: Collection[Key] = ()) -> tuple[float, tuple[str, ...]]:
        """Return the probability that it is this effect or an equivalent, and the equivalents.

        Another effect k may be in place of the chosen one, or next to it: the weights of the three
        cases are exp(E/T), exp(E_k/T) and exp((E + E_k|chosen)/T). E and E_k are scaled to the
        weights of the rows that the chosen effect leaves. Neither the same effect on another link
        nor one of the effects `present` in the model is in its place.
        """
        odds, temperature = probability.RARE_LOG_ODDS, probability.RARE_TEMPERATURE
        scale = _scale(self.final, self.evidence)
        instead = {}
        for key, value in self.before.items():
            if key in present:
                continue
            jointly = max(self.after.get(key, -np.inf) / temperature + odds, -700.0)
            relative = scale * (value - self.evidence) / temperature - float(
                np.logaddexp(0.0, jointly)
            )
            instead[key] = float(np.exp(np.clip(relative, -700.0, 700.0)))
        alike = [
            key
            for key, weight in sorted(instead.items(), key=lambda entry: -entry[1])
            if weight > EQUIVALENT_SHARE
            and key[0] != UNMODELLED
            and (key[1] == self.key[1] or None in (key[1], self.key[1]))
        ]
        of_link = is_of_link(self.key[0])
        other_links = [key for key in instead if of_link and key[0] == self.key[0]]
        total = 1.0 + sum(instead.values())
        weight = 1.0 + sum(instead[key] for key in (*alike, *other_links))
        return weight / total, tuple(name for name, _ in alike)


def find_rare_effects(
    identified: Identification,
    motions: Motions,
    position_errors: PositionErrors,
    progress: Callable[[str], None],
) -> tuple[JointModel, tuple[RareEffect, ...], tuple[EffectEvidence, ...]]:
    """Fit the joint model, and add rare effects while there is evidence for one.

    With a trusted prior, effects that a refit absorbs can be found as well. Returns the joint
    model, its rare effects, and the evidence of some that are not added: those that are too small,
    or whose evidence errors of the positions give as well.
    """
    search = _Search(identified, motions, position_errors, progress)
    search.add_effects(CandidateColumns(search.model, bool(identified.options.trusted)))
    search.put_flexible_models()
    return search.model, tuple(search.effects), search.small_effects()


@dataclass(frozen=True)
class _Addition:
    """A candidate that has passed all tests.

    Attributes:
        evidence: Its evidence in that model.
    """

    shape: CandidateModel
    joint: JointModel
    evidence: EffectEvidence


class _Search:
    """Search for rare effects: the joint model, and effects that were added or tried in vain."""

    def __init__(
        self,
        identified: Identification,
        motions: Motions,
        position_errors: PositionErrors,
        progress: Callable[[str], None],
    ) -> None:
        self._identified, self._motions, self._progress = identified, motions, progress
        self._position_errors = position_errors
        self._error_evidence: dict[Key, float] = {}
        self._start, self.model = self._frictions()
        self._error_evidence |= self._position_errors.evidence((), self.model)
        self.model = replace(self.model, error_evidence=dict(self._error_evidence))
        self.effects: list[RareEffect] = []
        self._shapes: tuple[CandidateModel, ...] = ()
        self._rejected: dict[Key, float] = {}  # with the evidence by which they were tried
        self._in_vain: Counter[Key] = Counter()
        self._small: dict[Key, EffectEvidence] = {}

    def _frictions(self) -> tuple[JointModel, JointModel]:
        """Return the start of every fit and the fit of all frictions, whose delay has settled.

        The recording chain is that of all joints: evidence against a filter at one of them refutes
        it. A filter never has exactly the form of its model, so that evidence for it at a joint is
        tempered; a delay has.
        """
        filter_fits = FilterFits(self._identified, self._motions)
        start = filter_fits.chosen(self._position_errors.filter_evidence)
        model = self._fit((), start)
        if start.chain.filter is not None:
            plain = self._fit((), filter_fits.start)
            support = filter_search.evidence_for_chain(model, plain)
            is_refuted = bool(support.min() < -joint_model.MIN_ENTRY_EVIDENCE)
            if is_refuted or probability.tempered(support).sum() <= 0.0:
                start, model = filter_fits.start, plain
        for _ in range(MAX_RESTARTS):
            delay, (_, std) = model.chain.delay, joint_model.delay_evidence(model, 0.0)
            chain = joint_model.renewed_chain(model)
            if abs(chain.delay - delay) <= std:
                break
            start = filter_fits.started_from(model, chain)
            model = self._fit((), start)
            if abs(model.chain.delay - delay) <= std:
                break
        if model.chain.delay:
            punctual_start = filter_fits.started_from(model, model.chain.on_one_clock())
            punctual = self._fit((), punctual_start)
            if filter_search.evidence_for_chain(model, punctual).sum() <= 0.0:
                start, model = punctual_start, punctual
        return start, model

    def add_effects(self, candidates: CandidateColumns) -> None:
        """Add effects, the best one first, while there is evidence for one."""
        while len(self._shapes) < MAX_RARE_EFFECTS:
            scores, rankings = candidates.scored(self.model)
            if self.effects:
                self.effects[-1] = replace(self.effects[-1], after=dict(scores))
                self._keep_small(scores)
            chosen = self._best(self._promising(scores, rankings, False), scores, rankings)
            if chosen is None:
                # these last: they could stand for the sum of effects that are still to be found
                candidates.seek_contacts(self.model)
                scores, rankings = candidates.scored(self.model)
                chosen = self._best(self._promising(scores, rankings, True), scores, rankings)
            if chosen is None:
                return
            self._add(chosen, scores)

    def _keep_small(self, scores: Mapping[Key, float]) -> None:
        """Drop small effects whose torque the last effect explains; `scores` are next to that."""
        if self.effects[-1].key[0] != UNMODELLED:
            kept = {key for key, score in scores.items() if score > MIN_CANDIDATE_EVIDENCE}
            self._small = {key: small for key, small in self._small.items() if key in kept}

    def small_effects(self) -> tuple[EffectEvidence, ...]:
        """Return effects that are not added; of those of a joint the ones with most evidence."""
        added = posterior.effect_groups(self.model)
        factors = {
            key: small.log_bayes_factor for key, small in self._small.items() if key not in added
        }
        return tuple(
            self._small[key]
            for key, factor in factors.items()
            if factor > max(f for (_, joint), f in factors.items() if joint == key[1]) - TIE
        )

    def put_flexible_models(self) -> None:
        """Put flexible models in the place of effects of a joint that they explain better."""
        for joint in range(self.model.n):
            flexible = _better_flexible_model(self.model, joint)
            if flexible is None:
                continue
            columns = self.model.columns_of(self._shapes)
            kept = [i for i, c in enumerate(columns) if c is None or c.joints != (joint,)]
            shapes = (*(self._shapes[i] for i in kept), flexible.model)
            addition = self._judged(self._fit(shapes), flexible.model, None)
            if addition is not None:
                self.model, self._shapes = addition.joint, shapes
                factor = addition.evidence.log_bayes_factor
                unnamed = RareEffect(flexible.model.key, flexible.evidence, {}, {}, factor)
                self.effects = [*(self.effects[i] for i in kept), unnamed]

    def _fit(self, shapes: Sequence[CandidateModel], start: JointModel | None = None) -> JointModel:
        model = joint_model.fit(self._identified, self._motions, shapes, start or self._start)
        return replace(model, error_evidence=dict(self._error_evidence))

    def _promising(
        self, scores: Mapping[Key, float], rankings: Mapping[Key, Ranking], last_resorts: bool
    ) -> list[Key]:
        """Return the last resorts, or all others, that are to be tried, the best first."""
        added = [effect.key for effect in self.effects]
        promising = [
            key
            for key, evidence in scores.items()
            if (key[0] in LAST_RESORTS) is last_resorts
            and evidence > max(MIN_CANDIDATE_EVIDENCE, self._rejected.get(key, -np.inf) + TIE)
            and added.count(key) < rankings[key].best.model.definition.max_models
            and not any(_is_same_body(rankings[key].best.model, shape) for shape in self._shapes)
        ]
        return sorted(promising, key=lambda key: -scores[key])

    def _best(
        self, keys: Sequence[Key], scores: dict[Key, float], rankings: Mapping[Key, Ranking]
    ) -> _Addition | None:
        """Return the best of candidates in order of their evidence; None if none passes.

        The optimisation of their shapes is added to their evidence `scores`.
        """
        keys = [key for key in keys if self._in_vain[_place(key)] < MAX_REJECTIONS]
        first, others = keys[:OPTIMISED_CANDIDATES], keys[OPTIMISED_CANDIDATES:]
        # a shape between two grid points may explain more than another effect's best grid point
        shapes = {key: tuned(self.model, rankings[key]) for key in first}
        for key, candidate in shapes.items():
            scores[key] += max(candidate.evidence - rankings[key].best.evidence, 0.0)
        best: _Addition | None = None
        factors: dict[Key, float] = {}
        for key in sorted(shapes, key=lambda key: -scores[key]):
            if self._in_vain[_place(key)] >= MAX_REJECTIONS:
                continue
            if best is not None and scores[key] < scores[best.shape.key] - TIE:
                break
            self._small.pop(key, None)
            addition = self._tried(shapes[key].model, rankings[key])
            for form in rankings[key].other_forms(shapes[key]):
                # another form of similar evidence is not larger
                if addition is not None or key in self._small:
                    break
                if form.best.evidence > rankings[key].best.evidence - TIE:
                    addition = self._tried(tuned(self.model, form).model, form)
            if addition is None:
                self._rejected[key] = scores[key]
                self._in_vain[_place(key)] += 1
            else:
                factor = addition.evidence.log_bayes_factor - float(np.log(rankings[key].count))
                if factor > max(factors.values(), default=-np.inf):
                    best = addition
                factors[key] = factor
        if best is not None and is_of_link(best.shape.effect):
            # of other links that were fitted completely, that is the evidence
            chosen = best.shape.key
            scale = _scale(best.evidence.log_bayes_factor, scores[chosen])
            for key in (key for key in factors if is_of_link(key[0])):
                scores[key] = scores[chosen] + (factors[key] - factors[chosen]) / scale
        # contacts that are tried in vain are no reason to leave out a flexible model
        return self._best(others, scores, rankings) if best is None and others else best

    def _tried(self, shape: CandidateModel, ranking: Ranking) -> _Addition | None:
        """Add an effect to the joint model; None if it is to be left out again."""
        if not self._may_be_needed(shape):
            return None
        extended = self._fit((*self._shapes, shape))
        if "measured" in shape.values:
            shape, extended = self._chosen_again(shape, extended, ranking)
        elif shape.nonlinear is not None and shape.interval is None:
            shape, extended = self._optimised_again(shape, extended)
        elif (richer := shape.definition.richer(shape)) is not None:
            shape, extended = self._with_more_coefficients(shape, extended, richer)
        return self._judged(extended, shape, self.model)

    def _chosen_again(
        self, shape: CandidateModel, extended: JointModel, ranking: Ranking
    ) -> tuple[CandidateModel, JointModel]:
        """Choose among functions of the measured torque, which a joint model with one replaces."""
        reduced = _without(extended, shape)
        again = CandidateShapes.of(reduced, [c.model for c in ranking.plausible])
        plausible = tuple(c for c in again.fitted(reduced) if c.is_plausible)
        best = tuned(reduced, Ranking(plausible, ranking.count)).model if plausible else shape
        if best.values == shape.values:
            return shape, extended
        return best, self._fit((*self._shapes, best))

    def _optimised_again(
        self, shape: CandidateModel, extended: JointModel
    ) -> tuple[CandidateModel, JointModel]:
        """Optimise a nonlinear parameter next to all that is fitted with the effect."""
        reduced = _without(extended, shape)
        present = next(iter(CandidateShapes.of(reduced, [shape]).fitted(reduced)), None)
        if present is None:
            return shape, extended
        moved = optimised(reduced, present)
        if moved.evidence <= present.evidence:
            return shape, extended
        other = self._fit((*self._shapes, moved.model))
        gain = _evidence(other, shape.key) - _evidence(extended, shape.key)
        # a difference of form explains the square of its share of the evidence
        is_better = gain > FORM_ERROR_STD**2 * present.evidence
        return (moved.model, other) if is_better else (shape, extended)

    def _with_more_coefficients(
        self, shape: CandidateModel, extended: JointModel, richer: CandidateModel
    ) -> tuple[CandidateModel, JointModel]:
        """Choose a form with further coefficients if there is evidence for it.

        In the residual without the effect few rows looked independent, too few for them.
        """
        other = self._fit((*self._shapes, richer))
        is_better = _evidence(other, shape.key) > _evidence(extended, shape.key)
        if is_better and _is_plausible(other, posterior.effect_groups(other)[shape.key]):
            return richer, other
        return shape, extended

    def _may_be_needed(self, shape: CandidateModel) -> bool:
        """Tell whether there is evidence for an effect next to the present model."""
        extended = self.model.with_effects([shape])
        joint_model.reweight(extended.regression)
        return _evidence(extended, shape.key) > 0.0

    def _judged(
        self, extended: JointModel, shape: CandidateModel, before: JointModel | None
    ) -> _Addition | None:
        """Judge an effect of a joint model; None if it is to be left out again.

        `before` is the joint model that must not predict clearly better, if any.
        """
        key = shape.key
        members = posterior.effect_groups(extended).get(key)
        if members is None:
            return None
        evidence, replaced = posterior.judge(extended, key)
        joints = extended.motions[0].fitted_robot.robot.joints
        place = "" if key[1] is None else f" at {joints[key[1]]}"
        self._progress(
            f"{key[0].replace('_', ' ')}{place}: log Bayes factor {evidence.log_bayes_factor:.1f}, "
            f"size {evidence.size:.2f} × residual"
        )
        is_large = evidence.is_needed
        if not replace(evidence, size=np.inf).is_needed or not _is_plausible(extended, members):
            return None
        # it may also displace another effect, such as a wave, that predicts better
        is_predictive = cross_validation.gain(extended, replaced, extended, members) > 0.0 and (
            before is None or cross_validation.gain(extended, replaced, before, ()) > -TIE
        )
        if is_large and is_predictive and _is_seen_in_motion(extended, replaced, members):
            return self._beyond_position_errors(_Addition(shape, extended, evidence))
        if not is_large:
            self._note_small(replace(evidence, spoils_prediction=not is_predictive))
        return None

    def _beyond_position_errors(self, addition: _Addition) -> _Addition | None:
        """Return an addition without evidence by errors of the positions; None if none remains."""
        key, model = addition.shape.key, addition.joint
        shapes = [m.exact or m for m in model.models if m.key == key]
        by_errors = self._position_errors.evidence(shapes, model).get(key, 0.0)
        if not by_errors:
            return addition
        self._error_evidence[key] = by_errors
        self._progress(f"errors of the positions alone: log Bayes factor {by_errors:.1f}")
        model = replace(model, error_evidence=dict(self._error_evidence))
        evidence, _ = posterior.judge(model, key)
        if evidence.is_needed:
            return replace(addition, joint=model, evidence=evidence)
        self._note_small(evidence)
        return None

    def _note_small(self, evidence: EffectEvidence) -> None:
        """Note an effect that is not added, though there is evidence for it."""
        if evidence.effect not in LAST_RESORTS:
            self._small[evidence.key] = replace(evidence, members=(), is_in_model=False)

    def _add(self, chosen: _Addition, scores: Mapping[Key, float]) -> None:
        """Add an effect, and note what else might be in its place."""
        self.model, self._shapes = chosen.joint, (*self._shapes, chosen.shape)
        members = posterior.effect_groups(self.model)[chosen.shape.key]
        joints = self.model.regression.joints_of(members)
        for place in self._in_vain:
            if place[0] in LAST_RESORTS or place[1] is None or place[1] in joints:
                self._in_vain[place] = 0
        chosen_key = chosen.shape.key
        is_last_resort = chosen_key[0] in LAST_RESORTS
        others = {
            key: score
            for key, score in scores.items()
            if key != chosen_key
            and key not in self._rejected
            and (key[0] in LAST_RESORTS) is is_last_resort
        }
        factor = chosen.evidence.log_bayes_factor
        self.effects.append(RareEffect(chosen_key, scores[chosen_key], others, {}, factor))


def _better_flexible_model(model: JointModel, joint: int) -> Candidate | None:
    """Return the flexible model that explains a joint better than its rare effects and ripple."""
    replaced = [
        i
        for i, m in enumerate(model.models)
        if m.effect not in FRICTIONS and model.regression.joints_of([i]) == {joint}
    ]
    shapes = [model.models[i] for i in replaced]
    # several models of a spring are one spring, each wave has an order of its own
    named_effects = {m.effect for m in shapes} - {"torque_ripple"}
    count = len(named_effects) + sum(m.effect == "torque_ripple" for m in shapes)
    if count < 2:
        return None

    def without(left_out: Collection[int]) -> JointModel:
        return model.keeping([i for i in range(len(model.models)) if i not in left_out])

    reduced = without(replaced)
    named = model.log_evidence - reduced.log_evidence
    largest = model.log_evidence - min(without([i]).log_evidence for i in replaced)
    sigma = reduced.regression.residual_rms(reduced.solution)
    flexible = flexible_models(model.motions, sigma, [joint])
    # a smooth curve of the position is a spring
    shapes_tried = (shape for shape in flexible if shape.signature != "position")
    fitted = CandidateShapes.of(reduced, shapes_tried).fitted(reduced)
    best = max(fitted, key=lambda c: c.log_bayes_factor, default=None)
    needed = named
    if largest < 0.5 * named:
        # none is most of it, and each is as improbable beforehand as the flexible model
        improbability = -probability.RARE_TEMPERATURE * probability.RARE_LOG_ODDS
        needed += TIE - improbability * (count - 1)
    return best if best is not None and best.log_bayes_factor > needed else None


def _without(model: JointModel, shape: CandidateModel) -> JointModel:
    """Return a joint model without one of its rare effects; others of its name stay."""
    return model.keeping([i for i, m in enumerate(model.models) if (m.exact or m) is not shape])


def _evidence(model: JointModel, key: Key) -> float:
    """Return the log Bayes factor for an effect of a joint model; −∞ if the model has none."""
    is_there = key in posterior.effect_groups(model)
    return posterior.judge(model, key)[0].log_bayes_factor if is_there else -np.inf


def _scale(final: float, evidence: float) -> float:
    """Return how much larger evidence is by the weights of the rows that an effect leaves."""
    return max(final / max(evidence, 1e-9), 1.0)


def _place(key: Key) -> Key:
    """Return what limits the trials of a candidate: its kind of last resort, or its joint."""
    return (key[0], None) if key[0] in LAST_RESORTS else ("", key[1])


def _is_same_body(first: CandidateModel, second: CandidateModel) -> bool:
    """Tell whether two models are one load, one kinematic error, or one contact, on any link."""
    if first.effect != second.effect or not is_of_link(first.effect):
        return False
    if first.interval is None or second.interval is None:
        return True
    overlap = first.interval[0] < second.interval[1] and second.interval[0] < first.interval[1]
    return first.source == second.source and overlap


def _is_seen_in_motion(
    model: JointModel, replaced: Collection[int], members: Collection[int]
) -> bool:
    """Tell whether an effect, but for a contact, explains torque far from any rest of the joints.

    Friction at rest takes any value. An effect that explains this alone is worse than none as soon
    as the joints move.
    """
    if any(model.models[number].interval is not None for number in members):
        return True
    regression = model.regression
    present, absent = (
        regression.residual(regression.without(left_out)) for left_out in (replaced, members)
    )
    return bool(log_error_ratio(present, absent, model.far_from_rest).sum() >= 0.0)


def _is_plausible(model: JointModel, effects: Sequence[int]) -> bool:
    """Tell whether fitted coefficients are physically possible, without a form error."""
    regression = model.regression
    solution = regression.without((), model.form_places)
    return all(
        model.models[e].is_plausible(
            model.models[e].plain(solution.coefficients[regression.slices[e]])
        )
        for e in effects
    )
