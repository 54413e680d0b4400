"""Which effects of a joint model are needed? Evidence from refits without them.

The Bayes factor of an effect follows from the minima of the objective with and without it, all
other effects refitted, in the Laplace approximation:

    ln B = J_without − J_with − ½ (ln det A_with − ln det A_without) + ½ ln det Λ + m ln 2

over the coefficients that are not held at zero by their sign; Λ is their prior precision, and each
of the m coefficients that cannot be negative has twice the prior density.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._types import FloatArray
from ..effects.effect import CandidateModel, Key
from ..effects.form_error import with_form_error
from ..schemas.effects import FORM_ERROR_STD, MIN_SEVERITY
from . import probability
from .joint_model import FRICTIONS, JointModel, transient_rows
from .normal_equations import Solution
from .probability import Probability

DENSE_NAMES = (*FRICTIONS, "torque_ripple")
"""Effects that the joint model has from the start."""
SIZE_SPREAD = 0.4
"""Standard deviation of the logarithm of a friction's size, by the form of its curve, of which
another friction may take a part."""
VARIANCE_FREEDOM = 2.0
"""Degrees of freedom of the prior of the variance during a transient effect, by the scatter of the
variance over tenths of a recording: 2 to 4 for hobby servos, KR300 and TX40, 8 in the median of 12
splits of real recordings."""


@dataclass(frozen=True)
class EffectEvidence:
    """Evidence for an effect of a joint model.

    Attributes:
        members: Numbers of the regression's effects (several waves are one effect).
        freedom: Number of their coefficients.
        log_bayes_factor: Of the model with it over the model without.
        growth: RMS torque by which the residual of each joint grows without it, √(r² − r₀²) with
            the RMS residuals r without it and r₀ with it [N m], shape (n,).
        size: The largest of them over `regression.sigma` of its joint [1]; of an effect that
            acts for some of the time, of the rows in which it acts.
        is_in_model: Whether it is in the model that was selected.
        spoils_prediction: Whether it is not, because rows to which it is not fitted are predicted
            worse with it.
        by_errors: Log Bayes factor that errors of the positions alone give it.
    """

    members: tuple[int, ...]
    models: tuple[CandidateModel, ...]
    freedom: int
    log_bayes_factor: float
    growth: FloatArray
    size: float
    is_in_model: bool = True
    spoils_prediction: bool = False
    by_errors: float = 0.0

    @property
    def key(self) -> Key:
        """Effect and joint."""
        return self.models[0].key

    @property
    def effect(self) -> str:
        """Name of the effect."""
        return self.key[0]

    @property
    def joint(self) -> int | None:
        """Index of the joint; None for an effect of no single joint."""
        return self.key[1]

    @property
    def is_needed(self) -> bool:
        """True if the effect is more probable than not, and large enough to matter."""
        if self.effect in DENSE_NAMES:
            return self.log_bayes_factor > 0.0 and self.size > MIN_SEVERITY
        return probability.rare_probability(self.log_bayes_factor, self.size).value > 0.5


def left_out(evidence: Sequence[EffectEvidence]) -> frozenset[int]:
    """Return the numbers of the effects that are not in the selected model."""
    return frozenset(number for e in evidence if not e.is_in_model for number in e.members)


def effect_groups(model: JointModel) -> dict[Key, tuple[int, ...]]:
    """Return the regression's effects by name and joint."""
    groups: dict[Key, tuple[int, ...]] = {}
    for i, m in enumerate(model.models):
        groups[m.key] = (*groups.get(m.key, ()), i)
    return groups


def probabilities(n: int, evidence: Sequence[EffectEvidence]) -> dict[Key, Probability]:
    """Return the probability of every effect; the odds of frictions are shared over the joints."""
    out = {
        e.key: probability.rare_probability(e.log_bayes_factor, e.size)
        for e in evidence
        if e.effect not in DENSE_NAMES
    }
    for name in DENSE_NAMES:
        members = [e for e in evidence if e.effect == name]
        shared = shared_probabilities(n, [e.log_bayes_factor for e in members])
        for e, p in zip(members, shared, strict=True):
            counts = (
                1.0 if e.is_in_model else probability.by_size(e.size, MIN_SEVERITY, SIZE_SPREAD)
            )
            out[e.key] = Probability(p, float(counts))
    return out


def shared_probabilities(n: int, log_bayes_factors: Sequence[float]) -> list[float]:
    """Return the probabilities of one kind of friction, or of ripple."""
    factors = np.full(n, -np.inf)
    factors[: len(log_bayes_factors)] = log_bayes_factors
    return probability.friction_probabilities(factors)[: len(log_bayes_factors)].tolist()


def select(model: JointModel) -> list[EffectEvidence]:
    """Return the evidence of all effects, the least needed left out one after the other.

    An effect that is left out has the evidence with which it left.
    """
    groups = effect_groups(model)
    regression = model.regression
    omitted: set[int] = set()
    for key in [key for key in groups if key[0] not in DENSE_NAMES]:
        omitted |= judge(model, key, omitted)[1]
    hidden = [key for key, members in groups.items() if set(members) <= omitted]
    out = [evidence_of(model, groups[key]) for key in hidden]
    evidence = {
        key: evidence_of(model, members, omitted)
        for key, members in groups.items()
        if key not in hidden
    }
    while evidence:
        unneeded = [key for key, entry in evidence.items() if not entry.is_needed]
        if not unneeded:
            break
        key = min(unneeded, key=lambda k: evidence[k].log_bayes_factor)
        out.append(evidence.pop(key))
        omitted |= set(groups[key])
        touched = regression.joints_of(groups[key])
        for other in evidence:
            if touched & regression.joints_of(groups[other]):
                evidence[other] = evidence_of(model, groups[other], omitted)
    # one that is doubtful only next to a form error stays: it is a part of the friction curve
    for joint in range(model.n):
        evidence |= _next_to_form_errors(model, joint, omitted, evidence)
    return [*evidence.values(), *(replace(e, is_in_model=False) for e in out)]


def _next_to_form_errors(
    model: JointModel, joint: int, left_out: Collection[int], evidence: Mapping[Key, EffectEvidence]
) -> dict[Key, EffectEvidence]:
    """Return the evidence of a joint's frictions, each next to the form errors of larger ones."""
    frictions = sorted(
        (e for key, e in evidence.items() if key[0] in FRICTIONS and key[1] == joint),
        key=lambda e: -e.log_bayes_factor,
    )
    if len(frictions) < 2:
        return {}
    regression = model.regression.copy()
    extended = replace(model, regression=regression)
    out: dict[Key, EffectEvidence] = {}
    omitted = set(left_out)
    for larger, smaller in itertools.pairwise(frictions):
        larger_only = regression.without({*omitted, *smaller.members})
        for number in larger.members:
            c = larger_only.coefficients[regression.slices[number]]
            if not c.any():
                continue  # a form that is not used here
            columns = model.columns(with_form_error(model.models[number], model.motions, c))
            if columns is not None:
                regression.add(columns.after(len(c)))
        judged = evidence_of(extended, smaller.members, omitted)
        if judged.size < MIN_SEVERITY:  # too small to be evidence; the robot's other joints decide
            judged = replace(judged, log_bayes_factor=min(judged.log_bayes_factor, 0.0))
        out[smaller.key] = judged
        if not judged.is_needed:
            omitted |= set(smaller.members)
    return out


def judge(
    model: JointModel, key: Key, left_out: Collection[int] = ()
) -> tuple[EffectEvidence, frozenset[int]]:
    """Return the evidence of an effect without the frictions that hide it, and all that leave.

    The joint model has all frictions from the start, and one that nearly has the form of the effect
    has taken its torque, or one kind of friction has at several joints. Of two such explanations
    the one with less evidence leaves, the friction without which the effect grows most first, until
    the effect is needed or none remains. Frictions that are needed next to the effect come back. If
    the effect is not needed, `left_out` is returned as given.
    """
    groups, regression = effect_groups(model), model.regression
    joints = regression.joints_of(groups[key])
    frictions = {
        k: g
        for k, g in groups.items()
        if k[0] in FRICTIONS and k[1] in joints and not set(g) <= set(left_out)
    }
    for kind in FRICTIONS:
        members = [g for k, g in frictions.items() if k[0] == kind]
        if len(members) > 1:
            frictions[kind, None] = tuple(itertools.chain(*members))
    out = frozenset(left_out)
    first = result = evidence_of(model, groups[key], out)
    while not result.is_needed:
        rivals = {}
        for k, g in frictions.items():
            if set(g) <= out:
                continue
            if evidence_of(model, g, out).log_bayes_factor < result.log_bayes_factor:
                rivals[k] = evidence_of(model, groups[key], out | set(g))
        if not rivals:
            return first, frozenset(left_out)
        chosen = max(rivals, key=lambda k: rivals[k].size)
        out, result = out | set(frictions[chosen]), rivals[chosen]
    for k in [k for k, g in frictions.items() if k[1] is not None and set(g) <= out]:
        more = out - set(groups[k])
        again = evidence_of(model, groups[key], more)
        if evidence_of(model, groups[k], more).is_needed and again.is_needed:
            out, result = more, again
    return result, out


def _gain_of_transient(
    model: JointModel, shapes: Sequence[CandidateModel], reduced: Solution, current: Solution
) -> tuple[float, float]:
    """Return the log-likelihood gain of an effect that acts for some of the time, and its size.

    The error of a robot's model varies over time, and a transient effect is sought where the
    residual is largest. The residual variance in the rows in which it acts therefore has a prior,
    the inverse gamma distribution about σ_j² with ν degrees of freedom, truncated below σ_j²: a
    force that fits the usual error of the model in its interval does not make that error smaller.
    Other rows do not count:

        ½ Σ_j (ν + ρ N_j) ln((ν σ_j² + ρ E_j without the effect) / (ν σ_j² + ρ E_j with it))

    over the joints j, with N_j rows in which it acts, and their squared errors E_j ≥ N_j σ_j², less
    what another size of the friction of the joint would explain, within its form error η:

        E_j = r_jᵀr_j − (t_jᵀr_j)² / (t_jᵀt_j + σ_j²/(ρ η²)),   friction torque t_j, residual r_j

    Its size is that of the growth of E_j/N_j without it, over σ_j.
    """
    regression = model.regression
    acting = transient_rows(shapes, model.motions)[:, None] & regression.moving
    rows, share = acting.sum(axis=0), regression.independent_share
    friction = np.where(acting, _friction_torque(model, current) / regression.sigma, 0.0)
    of_friction = np.sum(friction**2, axis=0) + 1.0 / (share * FORM_ERROR_STD**2)

    def squared_error(solution: Solution) -> FloatArray:
        residual = np.where(acting, regression.residual(solution) / regression.sigma, 0.0)
        absorbed = np.sum(friction * residual, axis=0) ** 2 / of_friction
        return np.asarray(np.sum(residual**2, axis=0) - absorbed)

    without, with_ = squared_error(reduced), squared_error(current)
    unusual, usual = (np.maximum(squares, rows) for squares in (without, with_))
    gains = np.log((VARIANCE_FREEDOM + share * unusual) / (VARIANCE_FREEDOM + share * usual))
    growth = np.maximum(without - with_, 0.0) / np.maximum(rows, 1)
    gain = 0.5 * float((VARIANCE_FREEDOM + share * rows) @ gains)
    return gain, float(np.sqrt(growth.max()))


def _friction_torque(model: JointModel, solution: Solution) -> FloatArray:
    """Return the friction torque of every joint in a fit, shape (N, n) [N m]."""
    coefficients = np.zeros_like(solution.coefficients)
    for effect, part in zip(model.models, model.regression.slices, strict=True):
        if effect.effect in FRICTIONS:
            coefficients[part] = solution.coefficients[part]
    base = np.concatenate([motion.base_friction for motion in model.motions])
    return base + model.regression.torque_along(coefficients)


def evidence_of(
    model: JointModel, members: tuple[int, ...], left_out: Collection[int] = ()
) -> EffectEvidence:
    """Return the evidence of an effect, of all its waves, in a model without some others."""
    regression, current = model.regression, model.regression.without(left_out)
    coefficients = [current.coefficients[regression.slices[e]] for e in members]
    used = [len(c) for c in coefficients if c.any()]  # of two forms of a friction one acts
    shapes = tuple(model.models[e] for e in members)
    if not used:
        none = np.zeros(model.n)
        return EffectEvidence(members, shapes, sum(map(len, coefficients)), -np.inf, none, 0.0)
    reduced = regression.without([*left_out, *members])
    factor = regression.log_evidence(current) - regression.log_evidence(reduced)
    factor -= float(sum(np.log(shape.alternatives) for shape in shapes))
    before, after = (regression.residual_rms(s) for s in (reduced, current))
    growth = np.sqrt(np.maximum(before**2 - after**2, 0.0))
    size = float((growth / regression.sigma).max())
    if any(shape.interval is not None for shape in shapes):
        gain, size = _gain_of_transient(model, shapes, reduced, current)
        factor += gain - (reduced.objective - current.objective)
    by_errors = model.error_evidence.get(shapes[0].key, 0.0)
    factor = probability.beyond_errors(factor, by_errors)
    return EffectEvidence(members, shapes, sum(used), factor, growth, size, by_errors=by_errors)
