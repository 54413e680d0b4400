"""Estimates of the effects of a joint model: probability, size, parameters, and what is like them.

Uncertainty is that of the joint posterior of all coefficients, of the nonlinear parameters, which
are linearised, and of the form of the effect (`Effect.form_std`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._types import FloatArray, IntArray
from ..effects import EFFECTS_BY_NAME, delay
from ..effects.effect import CandidateModel
from ..effects.recorded_motion import position_range
from ..effects.spring import CURVE_WAVES
from . import joint_model, posterior, probability, recording_chain
from .columns import Columns
from .flexible_models import UNMODELLED
from .joint_model import FRICTIONS, JointModel
from .normal_equations import Solution
from .posterior import DENSE_NAMES, MIN_SEVERITY, EffectEvidence, Key
from .regression import rms
from .selection import RareEffect, SmallEffect
from .unmodelled import UnmodelledTorque

DRAWS = 400
"""Draws from the posterior."""
FORM_STD = 0.2
"""Relative standard deviation of an effect's torque, and of a parameter whose effect states none,
by the form of the effect."""
EXCHANGEABLE = ("stribeck", "nonlinear_viscous")
"""Frictions that are one curve with two names: each may take a part of the other."""
EXCHANGEABLE_STD = 0.4
"""The same for their torques."""
LOG_STEP = 0.02
"""Step of the derivative by the logarithm of a nonlinear parameter."""
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


@dataclass(frozen=True)
class EffectEstimate:
    """An effect at a joint, asserted or merely considered.

    Attributes:
        effect: Name.
        joint: Index of the joint; None for an effect of no single joint.
        models: Its models in the joint model.
        coefficients: Their coefficients.
        probability: That the effect, or one of its equivalents, is there.
        log_bayes_factor: Evidence for it.
        severity: RMS torque that a refit of the base model does not absorb, over the residual of
            the joint model, in the joint with the largest [1].
        severity_interval: Its 90 % interval.
        unique_severity: The same beyond what all other effects could stand for [1].
        parameters: Value and standard deviation by name.
        equivalents: Names of effects that these recordings cannot tell from it.
        needed: Whether the joint model needs it, and it is not doubtful.
        spoils_prediction: Whether it is known to predict rows worse to which it is not fitted.
    """

    effect: str
    joint: int | None
    models: tuple[CandidateModel, ...]
    coefficients: tuple[FloatArray, ...]
    probability: float
    log_bayes_factor: float
    severity: float
    severity_interval: tuple[float, float]
    unique_severity: float
    parameters: Mapping[str, tuple[float, float]]
    equivalents: tuple[str, ...]
    needed: bool
    spoils_prediction: bool = False

    @property
    def relative_std(self) -> float:
        """Relative standard deviation of its torque [1]."""
        low, high = self.severity_interval
        return float(np.log(high / low)) / (2.0 * QUANTILE) if low > 0.0 else 0.0

    @property
    def asserted(self) -> bool:
        """True if it is probable enough to be reported as a finding."""
        return self.needed and self.probability >= MIN_PROBABILITY


def estimate_effects(
    model: JointModel,
    rare: Sequence[RareEffect],
    left_out: Collection[int],
    evidence: Sequence[EffectEvidence],
) -> list[EffectEstimate]:
    """Estimate all effects of a joint model.

    Args:
        model: The joint model.
        rare: Its rare effects.
        left_out: Numbers of the effects that are not needed.
        evidence: Evidence of all effects.
    """
    posterior_of = _Posterior(model, model.regression.without(left_out))
    clock = _clock_delay(posterior_of)
    probabilities = posterior.probabilities(model.n, evidence)
    likeness = _likeness(posterior_of, evidence, left_out)
    in_model = {e.key for e in evidence if not set(e.effects) <= set(left_out)}
    out = []
    for entry in evidence:
        if entry.name == UNMODELLED:
            continue
        needed = not set(entry.effects) <= set(left_out)
        rivals = next((r for r in rare if r.key == entry.key), None)
        present = probabilities[entry.key]
        equivalents: tuple[str, ...] = ()
        draws = posterior_of.draws(entry.effects) if needed else None
        severity, interval, parameters = 0.0, (0.0, 0.0), {}
        if needed and draws is not None:
            severity = posterior_of.severity(entry.effects)
            form = EXCHANGEABLE_STD if entry.name in EXCHANGEABLE else FORM_STD
            std = float(np.hypot(posterior_of.relative_std(entry.effects), form))
            interval = _interval(severity, std)
            parameters = posterior_of.parameters(entry.effects, draws)
            equivalents = likeness.get(entry.key, ())
        if rivals is not None:
            share, names = rivals.share(in_model)
            present *= share
            equivalents = tuple(dict.fromkeys((*equivalents, *names)))
        equivalents = tuple(
            dict.fromkeys((*equivalents, *_same_by_definition(model, entry, parameters)))
        )
        models = tuple(model.models[i] for i in entry.effects)
        coefficients = tuple(
            np.asarray(posterior_of.solution.coefficients[model.regression.slices[i]])
            for i in entry.effects
        )
        out.append(
            EffectEstimate(
                entry.name,
                entry.joint,
                models,
                coefficients,
                present,
                entry.log_bayes_factor,
                severity,
                interval,
                entry.size,
                parameters,
                equivalents,
                needed,
            )
        )
    return [*out, *clock]


def small_effects(small: Sequence[SmallEffect]) -> list[EffectEstimate]:
    """Return estimates of effects that are too small to be in the joint model.

    Args:
        small: The effects.
    """
    return [
        EffectEstimate(
            effect.evidence.name,
            effect.evidence.joint,
            effect.models,
            effect.coefficients,
            posterior.probabilities(0, [effect.evidence])[effect.evidence.key],
            effect.evidence.log_bayes_factor,
            0.0,
            (0.0, 0.0),
            effect.evidence.size,
            {},
            (),
            needed=False,
            spoils_prediction=not effect.is_predictive,
        )
        for effect in small
    ]


def doubtful(effects: Sequence[EffectEstimate]) -> frozenset[Key]:
    """Return the rare effects that are less probable than not, which are not saved.

    They are needed, but another effect may well be in their place: what is not asserted is not to
    be predicted either.

    Args:
        effects: Estimates of all effects.
    """
    return frozenset(
        (effect.effect, effect.joint)
        for effect in effects
        if effect.needed and not effect.asserted and effect.effect not in FRICTIONS
    )


def without_doubtful(effects: Sequence[EffectEstimate]) -> list[EffectEstimate]:
    """Return estimates of which the doubtful ones are not needed.

    Args:
        effects: Estimates of all effects.
    """
    gone = doubtful(effects)
    return [replace(e, needed=e.needed and (e.effect, e.joint) not in gone) for e in effects]


def _same_by_definition(
    model: JointModel, entry: EffectEvidence, parameters: Mapping[str, tuple[float, float]]
) -> tuple[str, ...]:
    """Names of effects whose torque has the same form.

    Convex nonlinear viscous friction and drag are one thing at a joint (the contract). So are a
    wave of few periods over the range of a joint and a curve of its position.
    """
    if entry.name == "drag":
        return ("nonlinear_viscous",)
    if entry.name == "nonlinear_viscous" and parameters.get("exponent", (0.0, 0.0))[0] > 1.0:
        return ("drag",)
    shapes = [model.models[i] for i in entry.effects]
    if entry.name == "spring" and any({"waves", "order"} & set(s.values) for s in shapes):
        return ("torque_ripple",)
    if entry.name == "torque_ripple" and entry.joint is not None:
        low, high = position_range(model.motions, entry.joint)
        if all(s.values["order"] * (high - low) < np.pi * CURVE_WAVES[-1] for s in shapes):
            return ("spring",)
    return ()


def with_unmodelled(
    effects: Sequence[EffectEstimate],
    model: JointModel,
    unmodelled: Sequence[UnmodelledTorque],
) -> list[EffectEstimate]:
    """Return estimates whose probabilities take account of torque that no effect explains, the most
    probable first.

    Where torque of size u remains at a joint, an effect that explains torque of size s beyond all
    others may stand for a part of the same unnamed thing. By the share s²/(s² + u²) its probability
    is that of its evidence; otherwise that evidence is not its own, and what remains is what the
    other joints of the robot say about frictions, and nothing about all other effects.

    Args:
        effects: The estimates.
        model: The joint model.
        unmodelled: Torque that no effect of it explains.
    """
    left = np.zeros(model.n)
    for entry in unmodelled:
        left[entry.joint] = entry.size / model.regression.sigma[entry.joint]
    out = []
    for effect in effects:
        u = float(left.max() if effect.joint is None else left[effect.joint])
        present = effect.probability
        if effect.needed and u > 0.0:
            share = effect.unique_severity**2 / (effect.unique_severity**2 + u**2)
            present = share * present + (1.0 - share) * _by_other_joints(effect, effects, model.n)
        out.append(replace(effect, probability=present))
    return sorted(out, key=lambda e: (-e.probability, -e.log_bayes_factor))


def _by_other_joints(effect: EffectEstimate, effects: Sequence[EffectEstimate], n: int) -> float:
    """Probability of an effect without its own evidence, by that of the robot's other joints."""
    if effect.effect not in DENSE_NAMES:
        return 0.0
    others = [
        e.log_bayes_factor for e in effects if e.effect == effect.effect and e.joint != effect.joint
    ]
    return posterior.shared_probabilities(n, [0.0, *others])[0]


def _interval(severity: float, relative: float) -> tuple[float, float]:
    """90 % interval of a severity whose logarithm has a standard deviation.

    The form of an effect is wrong by a factor, and a severity is positive.
    """
    spread = QUANTILE * min(relative, MAX_LOG_STD)
    return severity * float(np.exp(-spread)), severity * float(np.exp(spread))


def _clock_delay(of: _Posterior) -> list[EffectEstimate]:
    """The delay of the clock."""
    model, seconds = of.model, of.model.chain.delay
    if not seconds:
        return []
    factor, std = joint_model.delay_evidence(model, seconds)
    change = np.zeros(len(of.solution.coefficients))
    change[model.delay_place] = seconds
    severity = of.severity_of(change)
    relative = float(np.hypot(std / abs(seconds), FORM_STD))
    present = float(probability.rare_probability(factor, severity))
    interval = _interval(severity, relative)
    return [
        EffectEstimate(
            "delay",
            None,
            (delay.clock_delay(),),
            (np.array([seconds]),),
            present,
            float(factor),
            severity,
            interval,
            severity,
            {"seconds": (seconds, std)},
            (),
            abs(seconds) > recording_chain.MIN_DELAY and severity > MIN_SEVERITY,
        )
    ]


class _Posterior:
    """Posterior of the coefficients of a joint model."""

    def __init__(self, model: JointModel, solution: Solution) -> None:
        self.model, self.solution = model, solution
        regression = model.regression
        self.active = np.flatnonzero(solution.active)
        p = regression.base_count
        weighted = solution.information - regression.prior_matrix
        base = np.delete(np.arange(p), [model.delay_place, *model.filter_places])
        self._base = base
        self._weighted = weighted
        a = weighted[np.ix_(base, base)] + 1e-9 * np.diag(np.diag(weighted)[base] + 1e-300)
        self._base_inverse = np.linalg.pinv(a, rcond=1e-12, hermitian=True)

    def places(self, effects: Sequence[int]) -> IntArray:
        """Return the active coefficients of some effects."""
        slices = self.model.regression.slices
        all_places = np.concatenate([np.arange(slices[e].start, slices[e].stop) for e in effects])
        return np.asarray(all_places[self.solution.active[all_places]])

    def covariance(self, first: IntArray, second: IntArray) -> FloatArray:
        """Return a block of the covariance."""
        right = np.zeros((len(self.active), len(second)))
        right[np.searchsorted(self.active, second), np.arange(len(second))] = 1.0
        return np.asarray(self.solution.solve(right)[np.searchsorted(self.active, first)])

    def projected(self, first: IntArray, second: IntArray) -> FloatArray:
        """Return a block of the information after elimination of the base model alone."""
        w, base = self._weighted, self._base
        return np.asarray(
            w[np.ix_(first, second)]
            - w[np.ix_(first, base)] @ self._base_inverse @ w[np.ix_(base, second)]
        )

    def draws(self, effects: Sequence[int]) -> FloatArray | None:
        """Return draws of the active coefficients, shape (DRAWS, k)."""
        places = self.places(effects)
        if not len(places):
            return None
        covariance = self.covariance(places, places)
        values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        normal = np.random.default_rng(0).normal(size=(DRAWS, len(places)))
        out = self.solution.coefficients[places] + normal @ root.T
        bounded = self.model.regression.nonnegative[places]
        out[:, bounded] = np.maximum(out[:, bounded], 0.0)
        return np.asarray(out)

    def severity(self, effects: Sequence[int]) -> float:
        """Return the RMS torque beyond the base model over the residual, of the largest joint."""
        places = self.places(effects)
        change = np.zeros(len(self.solution.coefficients))
        change[places] = self.solution.coefficients[places]
        return self.severity_of(change)

    def severity_of(self, change: FloatArray) -> float:
        """Return the same for given coefficients, shape (K,)."""
        regression, places = self.model.regression, np.flatnonzero(change)
        shared = self._weighted[np.ix_(self._base, places)] @ change[places]
        beyond = change.copy()
        beyond[self._base] -= self._base_inverse @ shared
        size = rms(regression.torque_along(beyond), regression.moving)
        return float((size / regression.sigma).max())

    def relative_std(self, effects: Sequence[int]) -> float:
        """Return the relative standard deviation of an effect's torque along its estimate."""
        places = self.places(effects)
        c = self.solution.coefficients[places]
        along = self.projected(places, places) @ c
        variance = float(along @ self.covariance(places, places) @ along)
        return float(np.sqrt(max(variance, 0.0)) / max(float(c @ along), 1e-300))

    def parameters(
        self, effects: Sequence[int], draws: FloatArray
    ) -> dict[str, tuple[float, float]]:
        """Return the parameters of the largest model of an effect, with standard deviations."""
        sizes = {e: self.relative_size(e) for e in effects if len(self.places([e]))}
        largest = max(sizes, key=lambda e: sizes[e])
        shape = self.model.models[largest]
        part = self.model.regression.slices[largest]
        places = self.places([largest])
        columns = np.searchsorted(self.places(effects), places)
        c = self.solution.coefficients[part]
        values = shape.parameters(c)
        cloud = []
        shift, log_std = self._nonlinear(shape, c, places)
        logs = log_std * np.random.default_rng(2).normal(size=len(draws))
        for draw, log in zip(draws, logs.tolist(), strict=True):
            changed = c.copy()
            changed[places - part.start] = draw[columns] + shift * log
            moved = shape
            if shape.nonlinear is not None and log:
                factor = float(np.exp(np.clip(log, -MAX_LOG_CHANGE, MAX_LOG_CHANGE)))
                moved = shape.nonlinear.model(shape.nonlinear.value * factor)
            cloud.append(moved.parameters(shape.plain(changed)))
        form = EFFECTS_BY_NAME[shape.effect].form_std
        out = {}
        for key, value in values.items():
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
        """Change of an effect's coefficients per logarithm of its nonlinear parameter, and its std.

        The nonlinear parameter has a prior of standard deviation 1 in the logarithm.
        """
        none = np.zeros(len(places)), 0.0
        if shape.nonlinear is None:
            return none
        parts = []
        for step in (LOG_STEP, -LOG_STEP):
            moved = shape.nonlinear.model(shape.nonlinear.value * float(np.exp(step)))
            columns = self.model.columns(moved)
            if columns is None or columns.count > len(c):
                return none
            parts.append((columns, c[: columns.count]))
        (up, cu), (down, _) = parts
        if up.joints != down.joints:
            return none
        values = tuple(
            ((a - b) @ cu / (2.0 * LOG_STEP))[:, None]
            for a, b in zip(up.values, down.values, strict=True)
        )
        change = Columns(up.joints, values, np.zeros(1, bool), np.ones(1))
        slope, information = self.model.regression.sensitivity(change, self.solution)
        place = np.searchsorted(self.active, places)
        return slope[place], float(1.0 / np.sqrt(1.0 + max(information, 0.0)))


def _likeness(
    of: _Posterior, evidence: Sequence[EffectEvidence], left_out: Collection[int]
) -> dict[Key, tuple[str, ...]]:
    """Names of effects at the same joint that may stand for each effect of the model."""
    needed = [
        e
        for e in evidence
        if e.name != UNMODELLED
        and not set(e.effects) <= set(left_out)
        and len(of.places(e.effects))
    ]
    out: dict[Key, tuple[str, ...]] = {}
    for first in needed:
        a = of.places(first.effects)
        variance = float(np.sum(of.covariance(a, a) * of.projected(a, a)))
        names = []
        for second in needed:
            if second is first or second.joint != first.joint or second.name == first.name:
                continue
            b = of.places(second.effects)
            other = float(np.sum(of.covariance(b, b) * of.projected(b, b)))
            shared = float(np.sum(of.covariance(a, b) * of.projected(a, b)))
            if shared < ALIKE_CORRELATION * np.sqrt(max(variance * other, 1e-300)):
                names.append(second.name)
        out[first.key] = tuple(names)
    return out
