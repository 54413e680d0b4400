"""Candidates for rare effects, scored by the evidence that each adds to a joint model."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from ..effects import EFFECTS, EFFECTS_BY_NAME
from ..effects.effect import CandidateModel, Key
from . import contact_search, probability, ripple_search
from .flexible_models import flexible_models
from .joint_model import FRICTIONS, JointModel
from .posterior import DENSE_NAMES
from .regression import CandidateBatch, CandidateFit

MIN_CANDIDATE_EVIDENCE = 5.0
"""Log Bayes factor before the weights are renewed from which a candidate is tried."""
RANKING_SHARE = 0.25
"""Share of independent rows in the residual of a complete model, at least."""
EQUIVALENT_SHARE = 0.05
"""Probability over that of the chosen effect from which another one is its equivalent."""
TIE = -probability.RARE_TEMPERATURE * float(np.log(EQUIVALENT_SHARE))
"""Difference of log Bayes factors up to which two candidates are equivalent; both are tried."""
BATCH_SIZE = 64
"""Models whose columns are computed before they are put together: both are in memory at once."""


@dataclass(frozen=True)
class Candidate:
    """A candidate model with its fit on top of a joint model.

    Attributes:
        share: Share of independent rows in a usual residual; that of an effect that is left out
            looks correlated.
    """

    model: CandidateModel
    fit: CandidateFit
    share: float

    @property
    def log_bayes_factor(self) -> float:
        """Log Bayes factor for the candidate, before the choice among its shapes."""
        return self.fit.gain - self._occam

    @cached_property
    def evidence(self) -> float:
        """The same with the share of independent rows that a complete model would have."""
        return max(RANKING_SHARE / self.share, 1.0) * self.fit.gain - self._occam

    @property
    def log_evidence(self) -> float:
        """Log Bayes factor with the variance that remains next to it at each joint."""
        assert self.fit.log_gain is not None
        return self.fit.log_gain - self._occam

    @property
    def _occam(self) -> float:
        """Log Occam factor of its coefficients, and of its alternatives."""
        return self.fit.log_occam_factor + float(np.log(self.model.alternatives))

    @property
    def is_plausible(self) -> bool:
        """True if its coefficients are physically possible."""
        return self.model.is_plausible(self.fit.coefficients)


@dataclass(frozen=True)
class CandidateShapes:
    """Candidate models with their columns over the motions of a joint model.

    Attributes:
        models: Those whose columns are not zero.
        batches: Their columns, of `BATCH_SIZE` models each.
    """

    models: tuple[CandidateModel, ...]
    batches: tuple[CandidateBatch, ...]

    @classmethod
    def of(cls, joint: JointModel, shapes: Iterable[CandidateModel]) -> CandidateShapes:
        """Compute the columns of some models."""
        kept: list[CandidateModel] = []
        batches, remaining = [], iter(shapes)
        while batch := list(itertools.islice(remaining, BATCH_SIZE)):
            columns = joint.columns_of(batch)
            kept += (shape for shape, c in zip(batch, columns, strict=True) if c is not None)
            if usable := [c for c in columns if c is not None]:
                batches.append(CandidateBatch.of(usable, joint.regression.moving))
        return cls(tuple(kept), tuple(batches))

    def fitted(self, joint: JointModel) -> list[Candidate]:
        """Return the candidates, each fitted alone on top of a joint model of the same motions."""
        regression, models = joint.regression, iter(self.models)
        out: list[Candidate] = []
        for batch in self.batches:
            of_batch = list(itertools.islice(models, len(batch.parts)))
            fits = regression.candidates(batch, any(_changes_link(m.effect) for m in of_batch))
            out += (
                Candidate(shape, fit, regression.independent_share)
                for shape, fit in zip(of_batch, fits, strict=True)
            )
        return out


@dataclass(frozen=True)
class Ranking:
    """All candidates of an effect at a joint, fitted one by one on top of a joint model.

    Attributes:
        plausible: Those with physically possible coefficients.
        count: Number of all shapes that were tried, each as likely.
    """

    plausible: tuple[Candidate, ...]
    count: int

    @property
    def best(self) -> Candidate:
        """The plausible candidate with the most evidence."""
        return max(self.plausible, key=lambda c: c.evidence)

    def other_forms(self, chosen: Candidate) -> list[Ranking]:
        """Return the shapes of each other form of the effect: of other nonlinear parameters."""
        forms: dict[frozenset[str], list[Candidate]] = {}
        for candidate in self.plausible:
            forms.setdefault(frozenset(candidate.model.values), []).append(candidate)
        forms.pop(frozenset(chosen.model.values), None)
        return [Ranking(tuple(members), self.count) for members in forms.values()]

    @cached_property
    def evidence(self) -> float:
        """Evidence of one effect whose shape is one of those tried."""
        return self._of_one([c.evidence for c in self.plausible])

    @cached_property
    def log_evidence(self) -> float:
        """The same with the variance that remains next to each."""
        return self._of_one([c.log_evidence for c in self.plausible])

    def _of_one(self, of_shapes: Sequence[float]) -> float:
        """Mean evidence of all shapes that were tried, of which these are plausible."""
        return float(special.logsumexp(of_shapes) - np.log(self.count))


class CandidateColumns:
    """Columns of all candidates over the motions of a joint model.

    They are computed once, with the first joint model, and rank the candidates on top of later ones
    as well; the best of them are computed anew. Contacts alone are sought again.
    """

    def __init__(self, model: JointModel, trusted: bool) -> None:
        shapes: list[CandidateModel] = []
        absorbed: list[CandidateModel] = []
        for effect in EFFECTS:
            if effect.name not in DENSE_NAMES:
                for shape in effect.candidates(model.motions):
                    if trusted or not shape.is_absorbed:
                        (absorbed if shape.is_absorbed else shapes).append(shape)
        shapes += ripple_search.encoder_errors(model)
        shapes += flexible_models(model.motions, model.regression.sigma)
        self._shapes = CandidateShapes.of(model, shapes)
        self._absorbed = CandidateShapes.of(model, absorbed)
        self._contacts = CandidateShapes.of(model, ())
        self._latest: tuple[JointModel, dict[Key, float], dict[Key, Ranking]] | None = None

    def seek_contacts(self, model: JointModel) -> None:
        """Renew the candidates for contacts: the times at which most remains."""
        self._contacts = CandidateShapes.of(model, contact_search.contacts(model))

    def _rankings(self, model: JointModel, groups: Iterable[CandidateShapes]) -> dict[Key, Ranking]:
        """Return the ranking of the shapes of every effect at every joint that the model lacks."""
        plausible: dict[Key, list[Candidate]] = {}
        counts: dict[Key, int] = {}
        present = {shape.form for shape in model.models}
        for candidate in itertools.chain(*(group.fitted(model) for group in groups)):
            if candidate.model.form in present:
                continue
            key = candidate.model.key
            counts[key] = counts.get(key, 0) + 1
            if candidate.is_plausible:
                plausible.setdefault(key, []).append(candidate)
        return {key: Ranking(tuple(shapes), counts[key]) for key, shapes in plausible.items()}

    def scored(self, model: JointModel) -> tuple[dict[Key, float], dict[Key, Ranking]]:
        """Return the evidence of every effect at every joint, and the ranking of its shapes.

        Those of contacts alone are computed again for the model of the call before.
        """
        if self._latest is None or self._latest[0] is not model:
            self._latest = model, *self._scored(model)
        contacts = self._rankings(model, (self._contacts,))
        _, scores, rankings = self._latest
        return scores | _scores(contacts), rankings | contacts

    def _scored(self, model: JointModel) -> tuple[dict[Key, float], dict[Key, Ranking]]:
        """Scores and rankings of all effects but contacts.

        Where the base model is trusted, frictions fit a part of what is wrong with it: load
        friction of several joints, or all frictions of one joint. An effect that a refit would
        absorb therefore competes for the place of all load friction, and for that of all frictions
        of its joint, as well; one with evidence there that is like theirs is tried.
        """
        rankings = self._rankings(model, (self._shapes, self._absorbed))
        scores = _scores(rankings)
        is_seen = {key for key, score in scores.items() if score > MIN_CANDIDATE_EVIDENCE}
        for joint in (None, *range(model.n)) if self._absorbed.models else ():
            kept = [
                i
                for i, shape in enumerate(model.models)
                if shape.effect not in FRICTIONS
                or (shape.effect != "load_friction" if joint is None else shape.joint != joint)
            ]
            if len(kept) == len(model.models):
                continue
            reduced = model.keeping(kept)
            # frictions that nothing needs are no merit of what would take their place
            lost = max(model.log_evidence - reduced.log_evidence, 0.0)
            absorbed = self._rankings(reduced, (self._absorbed,))
            unhidden = _scores(absorbed)
            for key, ranking in absorbed.items():
                if key in is_seen:
                    continue  # no friction hides it
                evidence = unhidden[key] - lost
                if evidence > -TIE and unhidden[key] > MIN_CANDIDATE_EVIDENCE:
                    evidence = max(evidence, float(np.nextafter(MIN_CANDIDATE_EVIDENCE, np.inf)))
                if joint in (None, key[1]) and evidence > scores.get(key, -np.inf):
                    scores[key], rankings[key] = evidence, ranking
        return scores, rankings


def is_of_link(effect: str) -> bool:
    """Tell whether an effect acts on a link."""
    return effect in EFFECTS_BY_NAME and EFFECTS_BY_NAME[effect].of_link


def _changes_link(effect: str) -> bool:
    """Tell whether an effect is a change of a link, which a refit of the base model absorbs."""
    return is_of_link(effect) and EFFECTS_BY_NAME[effect].prior_only


def _scores(rankings: Mapping[Key, Ranking]) -> dict[Key, float]:
    """Return the evidence of every effect at every joint.

    Changes of links differ by the variance that remains next to each: that of one link, as a
    payload, explains a part of that of another, of all joints but the last, or most of each. By the
    weights without it, that is hardly worse than all of it.
    """
    scores = {key: ranking.evidence for key, ranking in rankings.items()}
    changes = [key for key in scores if _changes_link(key[0])]
    highest = max((scores[key] for key in changes), default=0.0)
    most = max((rankings[key].log_evidence for key in changes), default=0.0)
    return scores | {key: highest - (most - rankings[key].log_evidence) for key in changes}


def tuned(model: JointModel, ranking: Ranking) -> Candidate:
    """Return the best candidate of an effect at a joint, nonlinear parameters optimised.

    The best of each form is optimised: between two points of its grid it may explain more than a
    form of more parameters, or a function of state.
    """
    best = optimised(model, ranking.best)
    others = [
        optimised(model, form.best)
        for form in ranking.other_forms(ranking.best)
        if form.best.model.nonlinear is not None
    ]
    return max([best, *others], key=lambda c: c.evidence)


def optimised(model: JointModel, candidate: Candidate) -> Candidate:
    """Return a candidate for the present joint model, with its nonlinear parameters optimised."""

    def fitted(shape: CandidateModel) -> Candidate | None:
        return next(iter(CandidateShapes.of(model, [shape]).fitted(model)), None)

    def gain(shape: CandidateModel) -> float:
        trial = fitted(shape)
        return trial.fit.gain if trial is not None and trial.is_plausible else -np.inf

    current = fitted(candidate.model)
    if current is None or current.model.nonlinear is None:
        return current or candidate
    best = fitted(current.model.nonlinear.optimised(gain))
    if best is None or not best.is_plausible or best.fit.gain < current.fit.gain:
        return current
    return best
