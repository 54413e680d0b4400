"""Selection of rare effects, one at a time, on top of the joint model.

Every candidate is scored by the evidence that it adds for the whole robot, jointly with all that
the model has. The best enters, its nonlinear parameters optimised, and is judged after the weights
of the rows are renewed: an effect that is left out makes its own residual look correlated, and so
hides itself.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .._types import FloatArray
from ..effects import EFFECTS, EFFECTS_BY_NAME
from ..effects.effect import CandidateModel
from ..effects.recorded_motion import RecordedMotion
from ..identification.identification import Identification
from . import cross_validation, joint_model, posterior, probability
from .candidate_fits import CandidateBatch, CandidateFit
from .flexible_models import UNMODELLED, flexible_models
from .joint_model import FRICTIONS, JointModel
from .posterior import DENSE_NAMES, EffectEvidence, Key

MAX_RARE_EFFECTS = 8
"""Rare effects that are added at most."""
OPTIMISED_CANDIDATES = 4
"""Candidates whose nonlinear parameters are optimised before the best is chosen."""
MIN_CANDIDATE_EVIDENCE = 5.0
"""Log Bayes factor before the weights are renewed from which a candidate is tried."""
MAX_MODELS = {"base_compliance": 2, "spring": 2, "position_friction": 2, "encoder_error": 2}
"""Models of one effect at one joint, where several describe it: modes of a base, waves of a curve;
1 of all others."""
LAST_RESORTS = (UNMODELLED, "contact")
"""Explanations that are tried when no other is left: a flexible model fits what remains, and the
time of a contact is chosen where most remains."""
RANKING_SHARE = 0.25
"""Share of independent rows in the residual of a complete model, at least."""
MAX_REJECTIONS = 3
"""Candidates of the catalogue, contacts and flexible models that are tried in vain, of each."""
EQUIVALENT_SHARE = 0.05
"""Probability over that of the chosen effect from which another one is its equivalent."""
TIE = -probability.RARE_TEMPERATURE * float(np.log(EQUIVALENT_SHARE))
"""Difference of log Bayes factors up to which two candidates are equivalent; both are tried."""


@dataclass(frozen=True)
class RareEffect:
    """An effect that was added to the joint model, and what else might be in its place.

    Attributes:
        key: Effect and joint.
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
        weights of the rows that the chosen effect leaves. The same effect on another link is no
        other effect.

        Args:
            present: Other effects of the model, which are there and not in its place.
        """
        odds, temperature = probability.RARE_LOG_ODDS, probability.RARE_TEMPERATURE
        scale = max(self.final / max(self.evidence, 1e-9), 1.0)
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
        of_link = _is_of_link(self.key[0])
        other_links = [key for key in instead if of_link and key[0] == self.key[0]]
        total = 1.0 + sum(instead.values())
        weight = 1.0 + sum(instead[key] for key in (*alike, *other_links))
        return weight / total, tuple(name for name, _ in alike)


@dataclass(frozen=True)
class Candidate:
    """A candidate model with its fit on top of a joint model.

    Attributes:
        model: The candidate.
        prior_std: Prior standard deviation of its coefficients, shape (k,).
        fit: Its fit.
        share: Share of independent rows in the residual. An effect that is left out makes the
            residual look correlated, so that the evidence is that of usual residuals.
    """

    model: CandidateModel
    prior_std: FloatArray
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
    def _occam(self) -> float:
        """Logarithm of the share of the prior volume that the data leave."""
        scaled = self.fit.information * np.outer(self.prior_std, self.prior_std)
        return 0.5 * float(np.linalg.slogdet(scaled)[1]) + float(np.log(self.model.alternatives))

    @property
    def is_plausible(self) -> bool:
        """True if its coefficients are physically possible."""
        return self.model.is_plausible(self.fit.coefficients)


@dataclass(frozen=True)
class CandidateShapes:
    """Candidate models with their columns over the motions of a joint model.

    Attributes:
        models: Those whose columns are not zero.
        prior_std: Prior standard deviation of the coefficients of each.
        batch: Their columns.
    """

    models: tuple[CandidateModel, ...]
    prior_std: tuple[FloatArray, ...]
    batch: CandidateBatch

    @classmethod
    def of(cls, joint: JointModel, shapes: Iterable[CandidateModel]) -> CandidateShapes:
        """Compute the columns of some models.

        Args:
            joint: The joint model over whose motions they are computed.
            shapes: The models.
        """
        computed = ((shape, joint.columns(shape)) for shape in shapes)
        kept = [(shape, columns) for shape, columns in computed if columns is not None]
        all_columns = [columns for _, columns in kept]
        return cls(
            tuple(shape for shape, _ in kept),
            tuple(columns.prior_std for columns in all_columns),
            CandidateBatch.of(all_columns, joint.regression.moving),
        )

    def fitted(self, joint: JointModel) -> list[Candidate]:
        """Return the candidates, each fitted alone on top of a joint model of the same motions."""
        regression = joint.regression
        fits = regression.candidates(self.batch)
        return [
            Candidate(shape, std, fit, regression.independent_share)
            for shape, std, fit in zip(self.models, self.prior_std, fits, strict=True)
        ]


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

    @cached_property
    def evidence(self) -> float:
        """Evidence of one effect whose shape is one of those tried; −∞ if none is plausible."""
        if not self.plausible:
            return -np.inf
        evidence = np.array([c.evidence for c in self.plausible])
        highest = float(evidence.max())
        return highest + float(np.log(np.exp(evidence - highest).sum() / self.count))


class CandidateColumns:
    """Columns of all candidates over the motions of a joint model.

    They are computed once, with the first joint model, and rank the candidates on top of later ones
    as well; the best of them are computed anew.
    """

    def __init__(self, model: JointModel, trusted: bool, names: Collection[str] = ()) -> None:
        self._trusted = trusted
        shapes: list[CandidateModel] = []
        torque = np.concatenate([motion.torque for motion in model.motions])
        noise_ratio = model.regression.sigma / np.maximum(torque.std(axis=0), 1e-300)
        for effect in EFFECTS:
            if effect.name in DENSE_NAMES or (effect.prior_only and not trusted):
                continue
            if names and effect.name not in names:
                continue
            shapes += (
                shape
                for shape in effect.candidates(model.motions)
                if shape.joint is None or noise_ratio[shape.joint] <= shape.max_noise_ratio
            )
        shapes += flexible_models(model.motions, model.regression.sigma)
        self._shapes = CandidateShapes.of(model, shapes)

    def _rankings(self, model: JointModel) -> dict[Key, Ranking]:
        """Return the ranking of the shapes of every effect at every joint.

        Args:
            model: The joint model on top of which they are fitted.
        """
        plausible: dict[Key, list[Candidate]] = {}
        counts: dict[Key, int] = {}
        for candidate in self._shapes.fitted(model):
            key = candidate.model.effect, candidate.model.joint
            counts[key] = counts.get(key, 0) + 1
            if candidate.is_plausible:
                plausible.setdefault(key, []).append(candidate)
        return {key: Ranking(tuple(plausible.get(key, ())), count) for key, count in counts.items()}

    def scored(self, model: JointModel) -> tuple[dict[Key, float], dict[Key, Ranking]]:
        """Return the evidence of every effect at every joint, and the ranking of its shapes.

        Where the base model is trusted, load friction of several joints fits a part of what is
        wrong with it. An effect that a refit would absorb therefore competes for the place of all
        load friction as well; one that cannot be told from load friction is tried.

        Args:
            model: The joint model on top of which they are fitted.
        """
        rankings = {key: r for key, r in self._rankings(model).items() if r.plausible}
        scores = {key: ranking.evidence for key, ranking in rankings.items()}
        if not self._trusted:
            return scores, rankings
        kept = [i for i, shape in enumerate(model.models) if shape.effect != "load_friction"]
        reduced = model.keeping(kept)
        lost = posterior.log_bayes_factor(model, reduced)
        for key, ranking in self._rankings(reduced).items():
            if key[0] == UNMODELLED or not EFFECTS_BY_NAME[key[0]].prior_only:
                continue
            evidence = ranking.evidence - lost
            if evidence > -TIE:
                evidence = max(evidence, float(np.nextafter(MIN_CANDIDATE_EVIDENCE, np.inf)))
            if evidence > scores.get(key, -np.inf):
                scores[key], rankings[key] = evidence, ranking
        return scores, rankings


def tuned(model: JointModel, ranking: Ranking) -> Candidate:
    """Return the best candidate of an effect at a joint, nonlinear parameters optimised.

    A resonance between two frequencies of the grid may explain more than a function of state.

    Args:
        model: The joint model.
        ranking: The candidates of the grid.
    """
    best = ranking.best
    out = optimised(model, best)
    if best.model.effect == UNMODELLED and best.model.nonlinear is None:
        resonances = [c for c in ranking.plausible if c.model.nonlinear is not None]
        if resonances:
            resonance = optimised(model, max(resonances, key=lambda c: c.evidence))
            return max(out, resonance, key=lambda c: c.evidence)
    return out


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


def find_rare_effects(
    identified: Identification,
    motions: Sequence[RecordedMotion],
    trusted: bool = False,
    names: Collection[str] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[JointModel, tuple[RareEffect, ...]]:
    """Fit the joint model, and add rare effects while there is evidence for one.

    Args:
        identified: The base model.
        motions: The motions to fit.
        trusted: Whether the base model is a trusted prior, so that effects that a refit absorbs can
            be found as well.
        names: Effects to look for; all when empty.
        progress: Called with a line of text for each candidate.

    Returns:
        The joint model and its rare effects.
    """
    rare: tuple[CandidateModel, ...] = ()
    effects: list[RareEffect] = []
    start = joint_model.first_round(identified, motions)
    model = joint_model.fit(identified, motions, start=start)
    rejected: set[Key] = set()
    candidates = CandidateColumns(model, trusted, names)
    while len(rare) < MAX_RARE_EFFECTS:
        scores, rankings = candidates.scored(model)
        if effects:
            effects[-1] = replace(effects[-1], after=scores)
        promising = sorted(
            (
                key
                for key, evidence in scores.items()
                if key not in rejected
                and evidence > MIN_CANDIDATE_EVIDENCE
                and [f.key for f in effects].count(key) < MAX_MODELS.get(key[0], 1)
                and not any(_is_same_body(rankings[key].best.model, shape) for shape in rare)
            ),
            key=lambda key: -scores[key],
        )
        chosen: tuple[Key, JointModel, CandidateModel, EffectEvidence] | None = None
        # these last: they could stand for the sum of effects that are still to be found
        for last in (False, True):
            group = [
                key
                for key in promising
                if (key[0] in LAST_RESORTS) is last and _tries(rejected, key) < MAX_REJECTIONS
            ]
            if chosen is not None:
                break
            # a shape between two grid points may explain more than another effect's best grid point
            best = {key: tuned(model, rankings[key]) for key in group[:OPTIMISED_CANDIDATES]}
            for key, candidate in best.items():
                scores[key] += max(candidate.evidence - rankings[key].best.evidence, 0.0)
            for key in sorted(best, key=lambda key: -scores[key]):
                if _tries(rejected, key) >= MAX_REJECTIONS:
                    continue
                if chosen is not None and scores[key] < scores[chosen[0]] - TIE:
                    break
                shape = best[key].model
                extended = joint_model.fit(identified, motions, (*rare, shape), start)
                evidence = _accepted(extended, key, progress)
                if evidence is None:
                    rejected.add(key)
                elif chosen is None or evidence.log_bayes_factor > chosen[3].log_bayes_factor:
                    chosen = key, extended, shape, evidence
        if chosen is None:
            break
        key, model, shape, evidence = chosen
        rare = (*rare, shape)
        others = {
            k: score
            for k, score in scores.items()
            if k != key and k not in rejected and (k[0] in LAST_RESORTS) is (key[0] in LAST_RESORTS)
        }
        effects.append(RareEffect(key, scores[key], others, {}, evidence.log_bayes_factor))
    return _with_better_flexible_models(identified, motions, start, model, rare, effects, progress)


def _with_better_flexible_models(
    identified: Identification,
    motions: Sequence[RecordedMotion],
    start: JointModel,
    model: JointModel,
    rare: tuple[CandidateModel, ...],
    effects: Sequence[RareEffect],
    progress: Callable[[str], None],
) -> tuple[JointModel, tuple[RareEffect, ...]]:
    """Put flexible models in the place of effects of a joint that they explain better.

    Args:
        identified: The base model.
        motions: The motions to fit.
        start: What starts every fit (`joint_model.first_round`).
        model: The joint model with all rare effects.
        rare: Their models.
        effects: The rare effects.
        progress: Called with a line of text for each flexible model.
    """
    for joint in range(model.n):
        flexible = _better_flexible_model(model, joint)
        if flexible is None:
            continue
        columns = [model.columns(shape) for shape in rare]
        kept = [i for i, c in enumerate(columns) if c is None or c.joints != (joint,)]
        shapes = (*(rare[i] for i in kept), flexible.model)
        extended = joint_model.fit(identified, motions, shapes, start)
        key = UNMODELLED, joint
        evidence = _accepted(extended, key, progress)
        if evidence is not None:
            model, rare = extended, shapes
            unnamed = RareEffect(key, flexible.evidence, {}, {}, evidence.log_bayes_factor)
            effects = [*(effects[i] for i in kept), unnamed]
    return model, tuple(effects)


def _better_flexible_model(model: JointModel, joint: int) -> Candidate | None:
    """Return the flexible model that explains a joint better than its rare effects and ripple.

    Torque of another form may have been taken apart by several effects of the joint alone, each of
    which explains a part of it, so that no flexible model has enough evidence jointly with them.

    Args:
        model: The joint model.
        joint: Index of the joint.
    """
    replaced = [
        i
        for i, m in enumerate(model.models)
        if m.effect not in FRICTIONS and model.regression.joints_of(i) == [joint]
    ]
    shapes = [model.models[i] for i in replaced]
    # several models of a spring are one spring, each wave has an order of its own
    named_effects = {m.effect for m in shapes} - {"torque_ripple"}
    count = len(named_effects) + sum(m.effect == "torque_ripple" for m in shapes)
    if count < 2:
        return None
    kept = [i for i in range(len(model.models)) if i not in replaced]
    reduced = model.keeping(kept)
    named = posterior.log_bayes_factor(model, reduced)
    sigma = reduced.regression.residual_rms(reduced.solution)
    flexible = flexible_models(model.motions, sigma, [joint])
    # a smooth curve of the position is a spring
    shapes_tried = (shape for shape in flexible if shape.signature != "position")
    fitted = CandidateShapes.of(reduced, shapes_tried).fitted(reduced)
    best = max(fitted, key=lambda c: c.log_bayes_factor, default=None)
    # each of them is as improbable beforehand as the flexible model
    improbability = -probability.RARE_TEMPERATURE * probability.RARE_LOG_ODDS
    needed = named - improbability * (count - 1) + TIE
    return best if best is not None and best.log_bayes_factor > needed else None


def _is_same_body(first: CandidateModel, second: CandidateModel) -> bool:
    """Tell whether two models are one load, one kinematic error, or one contact at a time.

    They may be on different links.
    """
    if first.effect != second.effect or not _is_of_link(first.effect):
        return False
    if first.interval is None or second.interval is None:
        return True
    overlap = first.interval[0] < second.interval[1] and second.interval[0] < first.interval[1]
    return first.source == second.source and overlap


def _is_of_link(effect: str) -> bool:
    """Tell whether an effect acts on a link."""
    return effect != UNMODELLED and EFFECTS_BY_NAME[effect].of_link


def _tries(rejected: Collection[Key], key: Key) -> int:
    """Return how many candidates were tried in vain of the kind of one: its last resort, or none.

    Args:
        rejected: Candidates that were tried in vain.
        key: The candidate.
    """

    def kind(k: Key) -> str:
        return k[0] if k[0] in LAST_RESORTS else ""

    return sum(kind(k) == kind(key) for k in rejected)


def _accepted(
    extended: JointModel, key: Key, progress: Callable[[str], None]
) -> EffectEvidence | None:
    """Return the evidence of an effect that was added; None if it is to be left out again."""
    members = posterior.effect_groups(extended).get(key)
    if members is None:
        return None
    result, replaced = posterior.judge(extended, key)
    joints = extended.motions[0].fitted_robot.robot.joints
    place = "" if key[1] is None else f" at {joints[key[1]]}"
    progress(
        f"{key[0].replace('_', ' ')}{place}: log Bayes factor {result.log_bayes_factor:.1f}, "
        f"size {result.size:.2f} × residual"
    )
    if (
        result.is_needed
        and _is_plausible(extended, members)
        and cross_validation.pays(extended, members, replaced=replaced)
    ):
        return result
    return None


def _is_plausible(model: JointModel, effects: Sequence[int]) -> bool:
    """Tell whether fitted coefficients are physically possible, without a form error.

    The model that is saved has no form error.
    """
    regression = model.regression
    solution = regression.without((), model.form_places)
    return all(
        model.models[e].is_plausible(
            model.models[e].plain(solution.coefficients[regression.slices[e]])
        )
        for e in effects
    )
