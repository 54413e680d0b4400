"""Estimates of the effects of a joint model: probability, size, parameters, and what is like them.

Uncertainty is that of the joint posterior of all coefficients, of the nonlinear parameters, which
are linearised, and of the form of the effect (`Effect.form_std`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from .._types import FloatArray, IntArray
from ..effects import delay, nonlinear_viscous
from ..effects.effect import CandidateModel, Key
from ..effects.recorded_motion import FittedRobot, position_range
from ..effects.spring import CURVE_WAVES
from ..schemas.effects import MIN_SEVERITY
from . import joint_model, posterior, probability, recording_chain
from .final_model import FinalModel
from .fitted_effects import FittedEffect
from .flexible_models import UNMODELLED
from .joint_model import FRICTIONS, JointModel
from .normal_equations import Solution
from .posterior import DENSE_NAMES, EffectEvidence
from .probability import Probability
from .regression import Columns, rms
from .selection import RareEffect
from .unmodelled import UnmodelledTorque

DRAWS = 400
"""Draws from the posterior."""
FORM_STD = 0.2
"""Relative standard deviation of an effect's torque, and of a parameter whose effect states none,
by the form of the effect."""
EXCHANGEABLE = ("stribeck", "nonlinear_viscous")
"""Frictions that are one curve with two names: each may take a part of the other."""
LOG_STEP = 0.02
"""Step of the derivative by the logarithm of a nonlinear parameter, over its prior standard
deviation."""
MAX_LOG_CHANGE = 1.0
"""Largest change of the logarithm of a nonlinear parameter in a draw; about its prior."""
ALIKE_CORRELATION = -0.6
"""Posterior correlation of the torques of two effects below which one may stand for the other."""
PERCENTILES = (15.87, 84.13)
"""Percentiles of the normal distribution one standard deviation below and above the mean."""
MIN_PROBABILITY = 0.5
"""Probability from which an effect is a finding (the contract's value)."""
MAX_LOG_STD = 3.0
"""Largest standard deviation of the logarithm of a severity that is stated: a factor of 140 either
way says that nothing is known."""
QUANTILE = 1.645
"""Quantile of the normal distribution of a 90 % interval."""


class Rejection(StrEnum):
    """Why an effect that had some evidence is no finding."""

    TOO_SMALL = "too small against the noise"
    EXPLAINED_AS_WELL = "another effect explains it as well"
    NEXT_TO_UNKNOWN = "next to unknown torque, of which it may be a part"
    SPOILS_PREDICTION = "spoils the prediction of recordings it is not fitted to"
    PRIOR_IN_DOUBT = "the parameters of the prior are in doubt, and it may be a part of their error"
    ERRORS_OF_POSITIONS = "noise or steps of the recorded positions look like it"
    WEAK_EVIDENCE = "weak evidence"
    WEAK_FRICTION = "weak evidence: other friction curves look like it"


@dataclass(frozen=True)
class EffectEstimate(EffectEvidence):
    """An effect at a joint, asserted or merely considered.

    Attributes:
        probable: Its probability, as a product.
        coefficients: Coefficients of its models in the joint model; empty if it is not in it.
        severity: RMS torque that a refit of the base model does not absorb, over the residual of
            the joint model, in the joint with the largest [1]; `size` is that beyond what all other
            effects could stand for.
        relative_std: Relative standard deviation of its torque [1].
        parameters: Value and standard deviation by name.
        main_model: The largest of its models, whose parameters they are; None if not estimated.
        saved: Its models with the coefficients of the saved model; empty if it is not saved.
        equivalents: Names of effects that these recordings cannot tell from it.
    """

    probable: Probability = field(kw_only=True)
    coefficients: tuple[FloatArray, ...] = ()
    severity: float = 0.0
    relative_std: float = 0.0
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    main_model: CandidateModel | None = None
    equivalents: tuple[str, ...] = ()
    saved: tuple[FittedEffect, ...] = ()

    @classmethod
    def of(cls, evidence: EffectEvidence, probable: Probability, **values: Any) -> EffectEstimate:
        """Return an estimate with some evidence."""
        return cls(**vars(evidence), probable=probable, **values)

    @property
    def in_joint_model(self) -> tuple[FittedEffect, ...]:
        """Its models with their coefficients in the joint model."""
        return tuple(map(FittedEffect, self.models, self.coefficients))

    @property
    def reported(self) -> tuple[FittedEffect, ...]:
        """Its models with the saved coefficients, or with those of the joint model."""
        return self.saved or self.in_joint_model

    @property
    def probability(self) -> float:
        """Probability that the effect, or one of its equivalents, is there."""
        return self.probable.value

    @property
    def severity_interval(self) -> tuple[float, float]:
        """90 % interval of the severity, which is positive and wrong by a factor."""
        spread = float(np.exp(QUANTILE * self.relative_std))
        return self.severity / spread, self.severity * spread

    @property
    def asserted(self) -> bool:
        """True if it is probable enough to be reported as a finding."""
        return self.is_in_model and self.probability >= MIN_PROBABILITY

    @property
    def needed(self) -> bool:
        """True if the joint model needs it, and it is a friction or asserted."""
        return self.asserted or (self.is_in_model and self.effect in FRICTIONS)

    @property
    def rejection(self) -> Rejection:
        """Reason why it is no finding: of a less probable effect, its least probable factor."""
        if self.spoils_prediction:
            return Rejection.SPOILS_PREDICTION
        if self.effect in DENSE_NAMES and self.size < MIN_SEVERITY:
            return Rejection.TOO_SMALL
        if self.probability >= MIN_PROBABILITY:
            return Rejection.EXPLAINED_AS_WELL
        weak = Rejection.WEAK_FRICTION if self.effect in FRICTIONS else Rejection.WEAK_EVIDENCE
        if self.by_errors > self.log_bayes_factor:
            weak = Rejection.ERRORS_OF_POSITIONS
        factors = {
            Rejection.TOO_SMALL: self.probable.size,
            weak: self.probable.evidence,
            Rejection.EXPLAINED_AS_WELL: self.probable.share,
            Rejection.NEXT_TO_UNKNOWN: self.probable.known,
            Rejection.PRIOR_IN_DOUBT: self.probable.prior,
        }
        return min(factors, key=lambda reason: factors[reason])


def estimate_effects(
    model: JointModel, rare: Sequence[RareEffect], evidence: Sequence[EffectEvidence]
) -> list[EffectEstimate]:
    """Estimate all effects of a joint model."""
    posterior_of = _Posterior(model, model.regression.without(posterior.left_out(evidence)))
    probabilities = posterior.probabilities(model.n, evidence)
    likeness = _likeness(posterior_of, evidence)
    in_model = {e.key for e in evidence if e.is_in_model}
    out = []
    for entry in evidence:
        if entry.effect == UNMODELLED:
            continue
        estimate = EffectEstimate.of(entry, probabilities[entry.key])
        names = list(likeness.get(entry.key, ()))
        if entry.is_in_model:
            estimate = posterior_of.estimate(estimate)
        rare_effect = next((r for r in rare if r.key == entry.key), None)
        if rare_effect is not None:
            share, others = rare_effect.share(in_model)
            estimate = replace(estimate, probable=replace(estimate.probable, share=share))
            names += others
        if entry.is_in_model:
            names += _displaced(model, entry, evidence)
        names += _same_by_definition(model, estimate)
        out.append(replace(estimate, equivalents=tuple(dict.fromkeys(names))))
    return [*out, *_clock_delay(posterior_of)]


def as_saved(effects: Sequence[EffectEstimate], final: FinalModel) -> list[EffectEstimate]:
    """Return estimates with the parameters of the saved effects on the saved base model."""
    out = []
    for effect in effects:
        saved = tuple(part for part in final.effects if part.shape.key == effect.key)
        parameters = effect.parameters
        main = _saved_form(effect.main_model, saved)
        if main is not None:
            parameters = _saved_parameters(main, final.motions[0].fitted_robot, parameters)
        out.append(replace(effect, parameters=parameters, saved=saved))
    return out


def _saved_form(model: CandidateModel | None, saved: Sequence[FittedEffect]) -> FittedEffect | None:
    """Return the saved effect of the form of a model; None if there is none."""
    if model is None:
        return None
    exact = model.exact or model
    for part in saved:
        # where it is continued beyond the recorded speeds, it has one value more
        values = {k: v for k, v in part.shape.values.items() if k != nonlinear_viscous.LINE_SHARE}
        if replace(part.shape, values=values).form == exact.form:
            return part
    return None


def _saved_parameters(
    saved: FittedEffect, base: FittedRobot, joint_fit: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Return the parameters of a saved effect, with standard deviations; none if not plausible.

    With the distance d of a value from that of the joint fit, its mean squared error is the
    variance of the joint fit, with the error of the form at the saved value, and d².
    """
    if not saved.shape.is_plausible(saved.coefficients):
        return {}
    values, form = saved.shape.parameters(saved.coefficients, base), saved.shape.definition.form_std
    out = {}
    for key, (mean, std) in joint_fit.items():
        value = float(values[key])
        if np.isfinite(value):
            of_form = form.get(key, FORM_STD) ** 2 * (value**2 - mean**2)
            out[key] = value, float(np.sqrt(max(std**2 + of_form + (value - mean) ** 2, 0.0)))
    return out


def _same_by_definition(model: JointModel, estimate: EffectEstimate) -> tuple[str, ...]:
    """Names of effects of the same form: drag and convex viscous friction; waves and springs."""
    effect, shapes = estimate.effect, estimate.models
    if effect == "drag":
        return ("nonlinear_viscous",)
    exponent, _ = estimate.parameters.get("exponent", (0.0, 0.0))
    if effect == "nonlinear_viscous" and exponent > 1.0:
        return ("drag",)
    if effect == "spring" and any({"waves", "order"} & set(s.values) for s in shapes):
        return ("torque_ripple",)
    if effect == "torque_ripple" and estimate.joint is not None:
        low, high = position_range(model.motions, estimate.joint)
        if all(s.values["order"] * (high - low) < np.pi * CURVE_WAVES[-1] for s in shapes):
            return ("spring",)
    return ()


def with_unmodelled(
    effects: Sequence[EffectEstimate],
    model: JointModel,
    unmodelled: Sequence[UnmodelledTorque],
) -> list[EffectEstimate]:
    """Return estimates, the most probable first, in view of torque that no effect explains.

    Where torque of size u remains at a joint, an effect that explains torque of size s beyond all
    others may be a part of the same unnamed thing. By the share s²/(s² + u²) its probability is
    that of its evidence; otherwise that of the other joints' evidence for a friction, or 0.
    """
    left = np.zeros(model.n)
    for entry in unmodelled:
        left[entry.joint] = entry.size / model.regression.sigma[entry.joint]
    out = []
    for effect in effects:
        u = float(left.max() if effect.joint is None else left[effect.joint])
        size = effect.size
        known = 1.0
        if effect.is_in_model and u > 0.0:
            share = size**2 / (size**2 + u**2)
            by_others = _by_other_joints(effect, effects, model.n)
            known = share + (1.0 - share) * by_others / max(effect.probability, 1e-300)
        out.append(replace(effect, probable=replace(effect.probable, known=known)))
    return sorted(out, key=lambda e: (-e.probability, -e.log_bayes_factor))


def with_doubts_about_prior(
    effects: Sequence[EffectEstimate], residual: FloatArray, refit: FloatArray
) -> list[EffectEstimate]:
    """Return estimates whose probabilities take account of errors of the trusted parameters.

    Any effect but the usual frictions can explain a part of these errors. Their size follows from
    the RMS residuals r of the joint model and r₁ of the base model refit without the prior, both of
    shape (n,) [N m]. An effect that explains torque of size s is more than a part of them with the
    probability Σ s²/r₁² / Σ (s² + max(r² − r₁², 0))/r₁² over the joints on which it acts.
    """
    errors = np.maximum(residual**2 - refit**2, 0.0)
    weights = 1.0 / np.maximum(refit**2, 1e-300)

    def share(estimate: EffectEstimate) -> float:
        if estimate.effect in DENSE_NAMES:
            return 1.0
        size = estimate.growth**2
        weight = np.where(size > 0.0, weights, 0.0)
        return float(weight @ size) / max(float(weight @ (size + errors)), 1e-300)

    return [replace(e, probable=replace(e.probable, prior=share(e))) for e in effects]


def _by_other_joints(effect: EffectEstimate, effects: Sequence[EffectEstimate], n: int) -> float:
    """Probability of an effect without its own evidence, by that of the robot's other joints."""
    if effect.effect not in DENSE_NAMES:
        return 0.0
    others = [
        e.log_bayes_factor for e in effects if e.effect == effect.effect and e.joint != effect.joint
    ]
    return posterior.shared_probabilities(n, [0.0, *others])[0]


def _displaced(
    model: JointModel, present: EffectEvidence, evidence: Sequence[EffectEvidence]
) -> list[str]:
    """Names of rare effects that the model had, and would need if it had not an effect."""
    left_out, joints = posterior.left_out(evidence), model.regression.joints_of
    acting = joints(present.members)
    return [
        absent.effect
        for absent in evidence
        if absent.effect not in (*DENSE_NAMES, UNMODELLED, present.effect)
        and not absent.is_in_model
        and acting & joints(absent.members)
        and posterior.evidence_of(
            model, absent.members, (left_out | set(present.members)) - set(absent.members)
        ).is_needed
    ]


def _clock_delay(posterior_of: _Posterior) -> list[EffectEstimate]:
    """The delay of the clock."""
    model, seconds = posterior_of.model, posterior_of.model.chain.delay
    if not seconds:
        return []
    factor, std = joint_model.delay_evidence(model, seconds)
    change = np.zeros(len(posterior_of.solution.coefficients))
    change[model.delay_place] = seconds
    torque = posterior_of.torque_beyond_base(change)
    severity = float((torque / model.regression.sigma).max())
    is_large = abs(seconds) > recording_chain.MIN_DELAY and severity > MIN_SEVERITY
    evidence = EffectEvidence(
        members=(),
        models=(delay.clock_delay(),),
        freedom=1,
        log_bayes_factor=factor,
        growth=torque,
        size=severity,
        is_in_model=is_large,
    )
    return [
        EffectEstimate.of(
            evidence,
            probability.rare_probability(factor, severity),
            coefficients=(np.array([seconds]),),
            severity=severity,
            relative_std=min(float(np.hypot(std / abs(seconds), FORM_STD)), MAX_LOG_STD),
            parameters={"seconds": (seconds, std)},
        )
    ]


class _Posterior:
    """Posterior of the coefficients of a joint model."""

    def __init__(self, model: JointModel, solution: Solution) -> None:
        self.model, self.solution = model, solution
        regression = model.regression
        p = regression.base_count
        weighted = solution.information - regression.prior_matrix
        base = np.delete(np.arange(p), [model.delay_place, model.filter_place])
        base = base[np.diag(weighted)[base] > 0.0]  # that of a known width is nothing
        self._base = base
        self._weighted = weighted
        a = weighted[np.ix_(base, base)] + 1e-9 * np.diag(np.diag(weighted)[base])
        self._base_inverse = np.linalg.pinv(a, rcond=1e-12, hermitian=True)

    def places(self, effects: Sequence[int]) -> IntArray:
        """Return the active coefficients of some effects."""
        slices = self.model.regression.slices
        all_places = np.concatenate([np.arange(slices[e].start, slices[e].stop) for e in effects])
        return np.asarray(all_places[self.solution.active[all_places]])

    def projected(self, first: IntArray, second: IntArray) -> FloatArray:
        """Return a block of the information after elimination of the base model alone."""
        w, base = self._weighted, self._base
        return np.asarray(
            w[np.ix_(first, second)]
            - w[np.ix_(first, base)] @ self._base_inverse @ w[np.ix_(base, second)]
        )

    def shared_power(self, first: IntArray, second: IntArray) -> float:
        """Return the posterior covariance of two torques beyond the base model, over all rows."""
        return float(
            np.sum(self.solution.covariance(first, second) * self.projected(first, second))
        )

    def estimate(self, estimate: EffectEstimate) -> EffectEstimate:
        """Return an estimate of an effect of the model with its size and its parameters."""
        effects, slices = estimate.members, self.model.regression.slices
        places = self.places(effects)
        if not len(places):
            return replace(estimate, is_in_model=False)
        torque = self.torque_beyond_base(self.solution.at(places))
        severity = float((torque / self.model.regression.sigma).max())
        form = posterior.SIZE_SPREAD if estimate.effect in EXCHANGEABLE else FORM_STD
        main = max((e for e in effects if len(self.places([e]))), key=self.relative_size)
        return replace(
            estimate,
            coefficients=tuple(self.solution.coefficients[slices[e]] for e in effects),
            severity=severity,
            relative_std=min(float(np.hypot(self.relative_std(effects), form)), MAX_LOG_STD),
            main_model=self.model.models[main],
            parameters=self.parameters(effects, main),
        )

    def draws(self, places: IntArray) -> FloatArray:
        """Return draws of active coefficients, shape (DRAWS, k)."""
        covariance = self.solution.covariance(places, places)
        values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        normal = np.random.default_rng(0).normal(size=(DRAWS, len(places)))
        out = self.solution.coefficients[places] + normal @ root.T
        bounded = self.model.regression.nonnegative[places]
        out[:, bounded] = np.maximum(out[:, bounded], 0.0)
        return np.asarray(out)

    def torque_beyond_base(self, change: FloatArray) -> FloatArray:
        """Return the RMS torque of coefficients, shape (K,), beyond the base model, (n,) [N m]."""
        regression, places = self.model.regression, np.flatnonzero(change)
        shared = self._weighted[np.ix_(self._base, places)] @ change[places]
        beyond = change.copy()
        beyond[self._base] -= self._base_inverse @ shared
        return rms(regression.torque_along(beyond), regression.moving)

    def relative_std(self, effects: Sequence[int]) -> float:
        """Return the relative standard deviation of an effect's torque along its estimate."""
        places = self.places(effects)
        c = self.solution.coefficients[places]
        along = self.projected(places, places) @ c
        variance = float(along @ self.solution.covariance(places, places) @ along)
        return float(np.sqrt(max(variance, 0.0)) / max(float(c @ along), 1e-300))

    def parameters(self, effects: Sequence[int], main: int) -> dict[str, tuple[float, float]]:
        """Return the parameters of a model of an effect, with standard deviations.

        There are none where its coefficients, next to those of other effects, are not plausible.
        """
        draws = self.draws(self.places(effects))
        shape, base = self.model.models[main], self.model.motions[0].fitted_robot
        part = self.model.regression.slices[main]
        places = self.places([main])
        columns = np.searchsorted(self.places(effects), places)
        c = self.solution.coefficients[part]
        if not shape.is_plausible(shape.plain(c)):
            return {}
        values = shape.parameters(shape.plain(c), base)
        cloud = []
        shift, log_std = self._nonlinear(shape, c, places)
        logs = log_std * np.random.default_rng(2).normal(size=len(draws))
        for draw, log in zip(draws, logs.tolist(), strict=True):
            changed = c.copy()
            changed[places - part.start] = draw[columns] + shift * log
            moved = shape
            if shape.nonlinear is not None and log:
                factor = float(np.exp(np.clip(log, -MAX_LOG_CHANGE, MAX_LOG_CHANGE)))
                moved = shape.nonlinear.at(shape.nonlinear.value * factor)
            cloud.append(moved.parameters(shape.plain(changed), base))
        form = shape.definition.form_std
        out = {}
        for key, value in values.items():
            if not np.isfinite(value):
                continue
            low, high = np.nanpercentile([p[key] for p in cloud], PERCENTILES)
            std = np.hypot(0.5 * (high - low), form.get(key, FORM_STD) * abs(value))
            out[key] = (float(value), float(std))
        return out

    def relative_size(self, effect: int) -> float:
        """Return the weighted square of an effect's torque beyond the base model."""
        places = self.places([effect])
        c = self.solution.coefficients[places]
        return float(c @ self.projected(places, places) @ c)

    def _nonlinear(
        self, shape: CandidateModel, c: FloatArray, places: IntArray
    ) -> tuple[FloatArray, float]:
        """Change of coefficients per logarithm of the effect's nonlinear parameter, and its std."""
        none = np.zeros(len(places)), 0.0
        if shape.nonlinear is None:
            return none
        parameter = shape.nonlinear
        prior_std = min(float(np.log(parameter.high / parameter.low)), 1.0)
        size = LOG_STEP * prior_std
        up, down = (
            self.model.columns(parameter.at(parameter.value * float(np.exp(step))))
            for step in (size, -size)
        )
        if up is None or down is None or up.joints != down.joints or up.count > len(c):
            return none
        values = tuple(
            ((a - b) @ c[: up.count] / (2.0 * size))[:, None]
            for a, b in zip(up.values, down.values, strict=True)
        )
        change = Columns(up.joints, values, np.zeros(1, bool), np.ones(1))
        slope, information = self.model.regression.sensitivity(change, self.solution)
        slope = slope[np.searchsorted(np.flatnonzero(self.solution.active), places)]
        return slope, float(1.0 / np.sqrt(prior_std**-2.0 + max(information, 0.0)))


def _likeness(posterior_of: _Posterior, evidence: Sequence[EffectEvidence]) -> dict[Key, list[str]]:
    """Names of effects at the same joint that may stand for each effect of the model."""
    places = {
        e.key: posterior_of.places(e.members)
        for e in evidence
        if e.effect != UNMODELLED and e.is_in_model
    }
    places = {key: active for key, active in places.items() if len(active)}
    power = {key: posterior_of.shared_power(a, a) for key, a in places.items()}

    def are_alike(first: Key, second: Key) -> bool:
        if first[0] == second[0] or first[1] != second[1]:
            return False
        size = np.sqrt(max(power[first] * power[second], 1e-300))
        shared = posterior_of.shared_power(places[first], places[second])
        return bool(shared < ALIKE_CORRELATION * size)

    return {first: [second[0] for second in places if are_alike(first, second)] for first in places}
