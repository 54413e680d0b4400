"""Joint model of a robot: base model, frictions of every joint, delay and ripple, fitted together.

1. columns of the frictions at every joint (`dense_models`), with nonnegative coefficients;
2. weights of the rows from the residual and its autocorrelation;
3. the delay, whose coefficient on the slope of the torque moves into the torque's time stamps, and
   the filter that the torque has passed, which all columns pass as well;
4. the spatial frequencies of torque ripple, from the residual of all that;
5. widths of Coulomb friction, physically consistent base parameters, and with them the load of
   every joint; the shares of the presliding elements, which are damped by them; whether Stribeck
   and load friction build up in these elements, as Coulomb friction does; again from 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..effects import hysteresis, recorded_motion
from ..effects.effect import CandidateModel, Key
from ..effects.form_error import with_form_error
from ..effects.hysteresis import HYSTERESIS
from ..effects.load_friction import LOAD_FRICTION
from ..effects.nonlinear_viscous import NONLINEAR_VISCOUS
from ..effects.recorded_motion import RecordedMotion
from ..effects.stribeck import STRIBECK
from ..identification import consistency
from ..identification.consistency import ConsistentEstimate
from ..identification.dissipation import friction_powers
from ..identification.estimators import torque_resolution
from ..identification.identification import Identification
from ..identification.segments import RecordingSegment
from ..schemas.effects import FORM_ERROR_STD
from . import recording_chain, ripple_search, session_changes
from .flexible_models import UNMODELLED
from .motion_rows import MotionRows, motion_rows
from .normal_equations import Solution
from .recording_chain import RecordingChain
from .regression import Columns, JointRegression, independent_share, rms

ROUNDS = 4
"""Fits, with the first one: delay and weights change by less than 1 % after three."""
RIPPLE_ROUNDS = (1, 2)
"""Rounds that are followed by a search for ripple: not before the first fit of the frictions."""
MIN_FREEDOM = 0.1
"""Smallest share of rows that counts as degrees of freedom of the residual."""
MIN_ENTRY_EVIDENCE = 5.0
"""Log Bayes factor from which the delay or the filter of the recording chain enters the model, or
the build-up of a joint's dry frictions."""
MIN_LEVEL_SHARE = 0.3
"""Least friction level of a joint, over the median of all joints."""
MIN_TORQUE_SHARE = 0.1
"""Least friction level of a joint, over the standard deviation of its torque."""
MAX_LOG_STEP = 0.7
"""Largest change of the logarithm of a Coulomb width, or of a corner frequency, in a round."""
FRICTIONS = {
    effect.name: effect for effect in (STRIBECK, NONLINEAR_VISCOUS, HYSTERESIS, LOAD_FRICTION)
}
"""Frictions that are fitted at every joint, by their names."""
BUILDING_UP = (STRIBECK, LOAD_FRICTION)
"""Those that may build up in the presliding elements."""
MIN_BUILT_UP_SHARE = 0.5
"""Share of Coulomb friction in the presliding elements of a joint from which its other dry
frictions may build up in them, too: most of it."""


@dataclass(frozen=True)
class JointModel:
    """A fitted joint model.

    Attributes:
        motions: Recorded motions, with the base model and with the torque moved by the delay.
        models: Effects in the order of the regression.
        chain: How torque is recorded. Its delay was removed from the torque of the motions, its
            filter is part of all columns.
        level: Friction level of each joint, the unit of prior deviations, shape (n,) [N m].
        variation: Standard deviation of the torque of each joint, at least its friction level: the
            unit of those of effects that change the base model, shape (n,) [N m].
        psi: Standard parameters, shape (P,).
        free: Base parameters that are refit, shape (p,); all but those of a trusted prior.
        known: Torque of the others, which is not part of the regression, shape (N, n) [N m].
        change_scale: Factor of the prior standard deviation of the changes between recordings of
            each joint, shape (n,).
        weights_in_mean: Weights of the recordings in the mean of their friction, shape
            (recordings, n, 3).
        error_evidence: By effect and joint: log Bayes factor by errors of the positions alone.
    """

    motions: tuple[RecordedMotion, ...]
    models: tuple[CandidateModel, ...]
    regression: JointRegression
    chain: RecordingChain
    level: FloatArray
    variation: FloatArray
    psi: FloatArray
    free: IntArray
    known: FloatArray
    change_scale: FloatArray
    weights_in_mean: FloatArray
    error_evidence: Mapping[Key, float] = field(default_factory=dict)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.motions[0].n

    @property
    def delay_place(self) -> int:
        """Place of the delay among the coefficients: after base parameters and widths."""
        return len(self.free) + self.n

    @property
    def filter_place(self) -> int:
        """Place of the corner frequency of the recording chain's filter."""
        return self.delay_place + 1

    @property
    def session_places(self) -> slice:
        """Places of the changes between recordings, the last coefficients of the base model."""
        return slice(self.filter_place + 1, self.regression.base_count)

    @property
    def form_places(self) -> list[int]:
        """Places of the form errors of all effects among the coefficients."""
        return [
            place
            for model, part in zip(self.models, self.regression.slices, strict=True)
            for place in range(part.stop - model.form_columns, part.stop)
        ]

    @property
    def solution(self) -> Solution:
        """The solution of the regression."""
        return self.regression.solution

    @property
    def log_evidence(self) -> float:
        """Log evidence of the model with all its effects, up to a constant of its rows."""
        return self.regression.log_evidence(self.solution)

    @property
    def far_from_rest(self) -> BoolArray:
        """Rows that count and that no friction at rest reaches, shape (N, n)."""
        far = np.concatenate([motion.far_from_rest for motion in self.motions])
        return np.asarray(self.regression.moving & far)

    @cached_property
    def rows(self) -> MotionRows:
        """State of the robot at every row, with the torques of this model."""
        return motion_rows(self.motions)

    def coefficients(self, effect: int) -> FloatArray:
        """Return the coefficients of an effect, shape (k,)."""
        return np.asarray(self.solution.coefficients[self.regression.slices[effect]])

    def keeping(self, effects: Sequence[int]) -> JointModel:
        """Return the model with some of its effects, and the same rows and weights."""
        models = tuple(self.models[i] for i in effects)
        regression = self.regression.keeping(effects)
        regression.built_up = _built_up(models)
        return replace(self, models=models, regression=regression)

    def built_up(self, joint: int) -> list[int]:
        """Return the numbers of the frictions of a joint that build up in presliding elements."""
        return [i for i, m in enumerate(self.models) if m.joint == joint and _is_built_up(m)]

    def columns(self, model: CandidateModel) -> Columns | None:
        """Return the columns of a model over all motions; None if they are zero or not finite."""
        return self.columns_of([model])[0]

    def columns_of(self, models: Sequence[CandidateModel]) -> list[Columns | None]:
        """Return the columns of several models, which pass the recording chain together."""
        parts = [[model.columns(motion) for model in models] for motion in self.motions]
        acting = [
            np.flatnonzero(np.any([_acting_joints(part) for part in of_model], axis=0))
            for of_model in zip(*parts, strict=True)
        ]
        passed = [
            self._passed(motion, [part[:, joints] for part, joints in zip(of, acting, strict=True)])
            for motion, of in zip(self.motions, parts, strict=True)
        ]
        return [
            self._with_prior(model, joints.tolist(), np.concatenate(rows).swapaxes(0, 1))
            for model, joints, *rows in zip(models, acting, *passed, strict=True)
        ]

    def _passed(self, motion: RecordedMotion, parts: Sequence[FloatArray]) -> list[FloatArray]:
        """Columns, shapes (N, J, k), that have passed the recording chain."""
        if self.chain.filter is None or not parts:
            return list(parts)
        ends = np.cumsum([part[0].size for part in parts])[:-1]
        rows = np.hstack([part.reshape(len(motion), -1) for part in parts])
        passed = np.hsplit(self.chain.passed(motion, rows), ends)
        return [x.reshape(part.shape) for x, part in zip(passed, parts, strict=True)]

    def _with_prior(
        self, model: CandidateModel, joints: Sequence[int], values: FloatArray
    ) -> Columns | None:
        """Columns on some joints, shape (J, N, k), with the prior; None if zero or not finite."""
        largest = float(np.abs(values).max(initial=0.0))
        if not 1e-9 < largest < np.inf:
            return None
        k = values.shape[2]
        if model.prior_std is not None:
            prior = np.full(k, model.prior_std)
        else:
            # a load or another change of the base model can be as large as that
            of_base = model.definition.prior_only
            unit = (self.variation if of_base else self.level)[list(joints)]
            prior = np.full(k, float(unit.max()))
            if not any(model.nonnegative):
                # coefficients in units of their own: the RMS torque of a column is the unit of the
                # joints on which it acts; one that is not visible stays near zero
                exact = values[:, :, : k - model.form_columns]
                size = np.sqrt(np.mean((exact / unit[:, None, None]) ** 2, axis=(0, 1)))
                size = np.where(size > 1e-3 * size.max(), size, size.max())
                prior[: len(size)] = 1.0 / size
        prior[: len(model.prior_shares)] *= model.prior_shares
        if model.form_columns:
            prior[-model.form_columns :] = FORM_ERROR_STD
        nonnegative = np.array(model.nonnegative or (False,) * k)
        return Columns(tuple(joints), tuple(values), nonnegative, prior)

    def with_effects(self, models: Sequence[CandidateModel]) -> JointModel:
        """Return the model with further effects, except those whose columns are zero."""
        columns = self.columns_of(models)
        kept = [model for model, c in zip(models, columns, strict=True) if c is not None]
        regression = self.regression.copy()
        regression.add(*(c for c in columns if c is not None))
        models = (*self.models, *kept)
        regression.built_up = _built_up(models)
        return replace(self, models=models, regression=regression)


def _acting_joints(columns: FloatArray) -> BoolArray:
    """Tell on which joints columns of shape (N, n, k) act, shape (n,)."""
    return np.asarray(columns.swapaxes(0, 1).reshape(columns.shape[1], -1).any(axis=1))


def _is_built_up(model: CandidateModel) -> bool:
    """Tell whether a friction builds up in presliding elements."""
    return model.definition in BUILDING_UP and "reach" in model.values


def _built_up(models: Sequence[CandidateModel]) -> dict[int, tuple[int | None, int | None]]:
    """Return each built-up friction with the hysteresis of its joint, else with its other form."""
    at_once = {m.key: i for i, m in enumerate(models) if not _is_built_up(m)}
    return {
        i: (at_once.get(("hysteresis", m.joint)), at_once.get(m.key))
        for i, m in enumerate(models)
        if _is_built_up(m)
    }


def dense_models(
    motions: Sequence[RecordedMotion],
    build_ups: Mapping[int, Mapping[str, float]] | None = None,
    shares: Mapping[int, Mapping[str, float]] | None = None,
) -> list[CandidateModel]:
    """Return the friction models of every joint.

    Far from any rest, presliding hysteresis is Coulomb friction: a joint all of whose rows lie
    there shows none.

    Args:
        build_ups: How dry frictions build up, by joint; these joints have both forms of them.
        shares: Shares of the presliding elements in an earlier fit, by joint; they are damped by
            these, if any is positive.
    """
    near_rest = np.any([(m.moving & ~m.far_from_rest).any(axis=0) for m in motions], axis=0)
    out = []
    for j in range(motions[0].n):
        of_joint = (shares or {}).get(j, {})
        for effect in FRICTIONS.values():
            if effect is not HYSTERESIS:
                out.append(effect.dense_model(motions, j))
            elif near_rest[j]:
                model = effect.dense_model(motions, j)
                damped = hysteresis.built_up_share(of_joint) > 0.0
                out.append(model.with_values(**of_joint) if damped else model)
    return [*out, *_built_up_models(motions, build_ups or {})]


def _built_up_models(
    motions: Sequence[RecordedMotion], build_ups: Mapping[int, Mapping[str, float]]
) -> list[CandidateModel]:
    """Return the frictions that build up, by joint."""
    return [
        effect.dense_model(motions, j).with_values(**build_up)
        for j, build_up in build_ups.items()
        for effect in BUILDING_UP
    ]


def fit(
    identified: Identification,
    motions: Sequence[RecordedMotion],
    rare: Sequence[CandidateModel],
    start: JointModel,
) -> JointModel:
    """Fit the joint model to recorded motions, from a start by `FilterFits.chosen`."""
    widths, chain = start.motions[0].widths, start.chain
    waves: list[CandidateModel] = []
    build_ups: Mapping[int, Mapping[str, float]] = {}
    fitted = start.with_effects(rare)
    for step in range(ROUNDS - 1):
        reweight(fitted.regression)
        chain = renewed_chain(fitted)
        width_steps = fitted.solution.coefficients[len(fitted.free) : fitted.delay_place]
        widths = widths * np.exp(np.clip(width_steps, -MAX_LOG_STEP, MAX_LOG_STEP))
        psi = consistent_parameters(identified, fitted)
        build_ups = _build_ups(identified, fitted, build_ups)
        shares = _shares_of_elements(identified, fitted)
        if step == 0:
            rare = [_with_discrepancy(fitted, model) for model in rare]
        if step in RIPPLE_ROUNDS:
            waves = [*ripple_search.refined_waves(fitted), *ripple_search.find_waves(fitted)]
        moved = [chain.without_delay(motion) for motion in motions]
        present = [
            motion.with_modelled_torque(torque)
            for motion, torque in zip(
                with_parameters(identified, moved, psi, widths),
                modelled_torque(fitted),
                strict=True,
            )
        ]
        fitted = base_model(identified, present, psi, chain, fitted)
        fitted = fitted.with_effects([*dense_models(present, build_ups, shares), *rare, *waves])
    kept = _build_ups(identified, fitted, build_ups)
    dropped = [i for j in build_ups if j not in kept for i in fitted.built_up(j)]
    if dropped:
        fitted = fitted.keeping([i for i in range(len(fitted.models)) if i not in dropped])
    reweight(fitted.regression)
    torques = zip(fitted.motions, modelled_torque(fitted), strict=True)
    return replace(
        fitted, motions=tuple(motion.with_modelled_torque(x, x) for motion, x in torques)
    )


def _build_ups(
    identified: Identification,
    fitted: JointModel,
    candidates: Mapping[int, Mapping[str, float]],
) -> dict[int, Mapping[str, float]]:
    """Return how the dry frictions of joints build up, by joint.

    Presliding elements must have most of Coulomb friction, with the other frictions built up in
    them as well, and there must be evidence for that, by the same weights with and without them.
    `fitted` has those of the `candidates`.
    """
    built_up = _mostly_built_up(_shares_of_elements(identified, fitted))
    further = {j: b for j, b in built_up.items() if j not in candidates}
    if further:
        candidates = {**candidates, **further}
        fitted = fitted.with_effects(_built_up_models(fitted.motions, further))
        built_up = _mostly_built_up(_shares_of_elements(identified, fitted))
    at_once = fitted.regression.log_evidence
    return {
        j: build_up
        for j, build_up in built_up.items()
        if j in candidates
        and fitted.log_evidence - at_once(fitted.regression.without(fitted.built_up(j)))
        > MIN_ENTRY_EVIDENCE
    }


def _mostly_built_up(
    shares: Mapping[int, Mapping[str, float]],
) -> dict[int, Mapping[str, float]]:
    """Return the joints whose presliding elements have most of Coulomb friction."""
    return {
        j: build_up
        for j, build_up in shares.items()
        if hysteresis.built_up_share(build_up) > MIN_BUILT_UP_SHARE
    }


def _shares_of_elements(
    identified: Identification, fitted: JointModel
) -> dict[int, dict[str, float]]:
    """Return how friction would build up in the presliding elements of a fit, by joint."""
    theta = identified.model.base.matrix @ fitted.psi
    theta[fitted.free] = fitted.solution.coefficients[: len(fitted.free)]
    coulomb = {j: float(theta[k]) for k, j in identified.model.friction_columns().items()}
    out = {}
    for number, model in enumerate(fitted.models):
        if model.effect == "hysteresis":
            j = model.joint_index
            out[j] = hysteresis.build_up(model, fitted.coefficients(number), coulomb.get(j, 0.0))
    return out


def renewed_chain(fitted: JointModel) -> RecordingChain:
    """Return the recording chain with the step of a fit; no delay without evidence."""
    x, chain = fitted.solution.coefficients, fitted.chain
    seconds = chain.delay + float(x[fitted.delay_place])
    if delay_evidence(fitted, seconds)[0] <= MIN_ENTRY_EVIDENCE:
        seconds = 0.0
    step = np.clip(x[fitted.filter_place], -MAX_LOG_STEP, MAX_LOG_STEP)
    return chain.stepped(seconds, float(step))


def delay_evidence(fitted: JointModel, seconds: float) -> tuple[float, float]:
    """Return the log Bayes factor for a delay [s] of the recording, and the delay's std [s]."""
    information, prior = _information(fitted, np.array([fitted.delay_place]))
    std = float(1.0 / np.sqrt(information[0, 0] + prior[0]))
    occam = float(np.log1p(information[0, 0] / prior[0]))
    return 0.5 * float(information[0, 0]) * seconds**2 - 0.5 * occam, std


def _renewed_change_scale(fitted: JointModel) -> FloatArray:
    """Return the scale of the changes between recordings, one joint at a time, shape (n,)."""
    places = np.arange(len(fitted.solution.coefficients))[fitted.session_places]
    if not len(places):
        return fitted.change_scale
    information, prior = _information(fitted, places)
    score = (information + np.diag(prior)) @ fitted.solution.coefficients[places]
    joint = np.arange(len(places)) // len(session_changes.KINDS) % fitted.n

    def evidence(j: int, scale: float) -> float:
        precision = np.where(joint == j, (fitted.change_scale[j] / scale) ** 2, 1.0) * prior
        total = information + np.diag(precision)
        determinant = float(np.linalg.slogdet(total)[1]) - float(np.sum(np.log(precision)))
        return 0.5 * float(score @ np.linalg.solve(total, score)) - 0.5 * determinant

    scales = session_changes.SCALES.tolist()
    by_joint = [[evidence(j, scale) for scale in scales] for j in range(fitted.n)]
    return session_changes.scale_of_joints(np.array(by_joint))


def _information(fitted: JointModel, places: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the information of the data on signed coefficients (k, k), and of their prior (k,)."""
    prior = np.diag(fitted.regression.prior_matrix)[places]
    total = np.linalg.inv(fitted.solution.covariance(places, places))
    values, vectors = np.linalg.eigh(total - np.diag(prior))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T), prior


def modelled_torque(model: JointModel) -> list[FloatArray]:
    """Return the torque of the model at every sample of its motions, shapes (M, n) [N m].

    Effects of measured torque are computed from it: measured noise would be correlated with itself.
    It has not passed the filter of the recording chain.
    """
    regression, place = model.regression, model.filter_place
    of_filter = regression.torque_along(model.solution.at(slice(place, place + 1)))
    total = model.known + regression.torque - regression.residual() - of_filter
    parts = recorded_motion.split_by_motion(total, model.motions)
    return [
        model.chain.without_filter(m, m.at_samples(part))
        for m, part in zip(model.motions, parts, strict=True)
    ]


def _with_discrepancy(fitted: JointModel, model: CandidateModel) -> CandidateModel:
    """Return a rare effect with the discrepancy of its form, in units of its fitted torque."""
    if model not in fitted.models or model.effect == UNMODELLED:
        return model
    coefficients = fitted.coefficients(fitted.models.index(model))
    return with_form_error(model, fitted.motions, coefficients)


def base_model(
    identified: Identification,
    motions: Sequence[RecordedMotion],
    psi: FloatArray,
    chain: RecordingChain,
    previous: JointModel | None = None,
) -> JointModel:
    """Return the joint model of the base model without effects.

    Args:
        psi: Standard parameters, shape (P,).
        chain: Recording chain; its delay was removed from the torque of the motions.
        previous: A fit that gives the weights of the rows, the size of changes between recordings,
            and the measured torque of the motions; the base model does if None.
    """
    free = free_parameters(identified)
    torque = np.concatenate([motion.torque for motion in motions])
    deviation = torque.std(axis=0)
    level = friction_level(motions, deviation)
    fixed = np.delete(np.arange(identified.model.base.count), free)
    known = np.concatenate(
        [chain.passed(m, m.gamma[:, :, fixed] @ m.theta[fixed]) for m in motions]
    )
    moving = np.concatenate([motion.moving for motion in motions])
    if previous is None:
        residual = np.concatenate([motion.residual for motion in motions])
        error = np.hypot(rms(residual, moving), torque_resolution(torque))
        share = independent_share(residual, moving)
        change_scale, modelled = np.ones(len(level)), [motion.motor_torque for motion in motions]
    else:
        error, share = previous.regression.sigma, previous.regression.independent_share
        change_scale = _renewed_change_scale(previous)
        modelled = [motion.measured_torque for motion in motions]
    prior = _base_prior(identified, motions, free, change_scale)
    in_mean = session_changes.weights_in_mean(motions, change_scale, error)
    changes = session_changes.columns(motions, in_mean)
    of_width = level if identified.options.widths is None else np.zeros_like(level)
    regression = JointRegression.of_base(
        torque - known,
        moving,
        _base_columns(motions, of_width, free, modelled, chain, changes),
        prior,
        error,
        share,
        _dissipated(identified, free, len(prior[0])),
    )
    return JointModel(
        motions=tuple(motions),
        models=(),
        regression=regression,
        chain=chain,
        level=level,
        variation=np.maximum(deviation, level),
        psi=psi,
        free=free,
        known=known,
        change_scale=change_scale,
        weights_in_mean=in_mean,
    )


def reweight(regression: JointRegression, transient: BoolArray | None = None) -> None:
    """Set the weights of the rows by the residual, twice, since they change it.

    Rows in which a transient effect acts, shape (N,), do not count.
    """
    moving = regression.moving
    if transient is not None:
        lasting = moving & ~transient[:, None]
        moving = np.where(lasting.any(axis=0), lasting, moving)
    rows = np.maximum(moving.sum(axis=0), 1)
    resolution = torque_resolution(regression.torque)
    for _ in range(2):
        residual = regression.residual()
        freedom = np.maximum(rows - regression.fitted_per_joint(), MIN_FREEDOM * rows)
        sigma = np.hypot(rms(residual, moving) * np.sqrt(rows / freedom), resolution)
        regression.reweighted(sigma, independent_share(residual, moving))


def transient_rows(
    models: Sequence[CandidateModel], motions: Sequence[RecordedMotion]
) -> BoolArray:
    """Return the rows in which an effect acts that other rows do not show, shape (N,)."""
    out = []
    for motion in motions:
        acting = np.zeros(len(motion), bool)
        for model in models:
            if model.interval is not None:
                acting |= model.acts_during(motion)
        out.append(acting)
    return np.concatenate(out)


def friction_level(motions: Sequence[RecordedMotion], deviation: FloatArray) -> FloatArray:
    """Return the Coulomb friction of each joint, shape (n,) [N m].

    It is at least a share of the other joints' and of the standard deviation of the joint's torque,
    shape (n,) [N m].
    """
    coulomb = np.abs(motions[0].fitted_robot.actuator_parameter("coulomb"))
    least = max(MIN_LEVEL_SHARE * float(np.median(coulomb)), 1e-12)
    return np.maximum(coulomb, np.maximum(least, MIN_TORQUE_SHARE * deviation))


def free_parameters(identified: Identification) -> IntArray:
    """Return the base parameters that are refit, shape (p,): all that no trusted prior states."""
    base, trusted = identified.model.base, identified.options.trusted
    if not trusted:
        return np.arange(base.count)
    joint_parameters = 10 * identified.model.parameters.bodies
    places = np.asarray(base.independent)
    return np.flatnonzero((places >= joint_parameters) & ~np.isin(places, list(trusted)))


def initial_parameters(identified: Identification) -> FloatArray:
    """Return the identified standard parameters, those of a trusted prior as stated, shape (P,)."""
    psi = identified.psi.copy()
    for place, value in identified.options.trusted.items():
        psi[place] = value
    return psi


def identified_motions(
    identified: Identification, segments: Sequence[RecordingSegment], hertz: float
) -> list[RecordedMotion]:
    """Return the motions of segments that are long enough, with the identified base model."""
    psi, model = initial_parameters(identified), identified.model
    return recorded_motion.recorded_motions(model, psi, segments, hertz)


def _base_columns(
    motions: Sequence[RecordedMotion],
    of_width: FloatArray,
    free: IntArray,
    modelled: Sequence[FloatArray],
    chain: RecordingChain,
    changes: Sequence[FloatArray],
) -> FloatArray:
    """Columns of the base model, shape (N, n, p + n + 2 + s).

    Γ, the change of Coulomb friction by its width (in units of `of_width`, 0 of a known one), the
    recording chain, and the changes between recordings. In memory the rows of each joint are
    adjacent.
    """
    n, p = len(of_width), len(free)
    first, end = p + n, p + n + len(recording_chain.PRIOR_STD)
    out = np.zeros((n, sum(map(len, motions)), end + changes[0].shape[2])).swapaxes(0, 1)
    parts = recorded_motion.split_by_motion(out, motions)
    for part, motion, torque, changed in zip(parts, motions, modelled, changes, strict=True):
        part[:, :, :p] = chain.passed(motion, motion.gamma[:, :, free])
        part[:, range(n), range(p, first)] = chain.passed(motion, motion.slopes * of_width)
        part[:, :, first:end] = recording_chain.columns(motion, torque, chain)
        part[:, :, end:] = chain.passed(motion, changed)
    return out


def _base_prior(
    identified: Identification,
    motions: Sequence[RecordedMotion],
    free: IntArray,
    change_scale: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Mean and information of the base parameters, widths, recording chain and session changes.

    Each base parameter that a trusted prior leaves free is a joint parameter plus known ones.
    """
    base, prior = identified.model.base, identified.prior
    p, n = len(free), motions[0].n
    others = np.concatenate(
        [
            np.ones(n),
            recording_chain.PRIOR_STD,
            session_changes.prior_std(motions, change_scale),
        ]
    )
    mean, out = np.zeros(p + len(others)), np.zeros((p + len(others),) * 2)
    if not identified.options.trusted:
        out[:p, :p] = consistency.base_prior_information(identified.model.parameters, base, prior)
        mean[:p] = base.matrix @ prior.nominal
    else:
        edge, psi = 10 * identified.model.parameters.bodies, initial_parameters(identified)
        places_in_psi = np.asarray(base.independent, int)[free]
        out[range(p), range(p)] = prior.joint_information[places_in_psi - edge]
        mean[:p] = (base.matrix @ psi)[free] + (prior.nominal - psi)[places_in_psi]
    places = np.arange(p, len(mean))
    out[places, places] = 1.0 / others**2
    return mean, out


def _dissipated(identified: Identification, free: IntArray, count: int) -> BoolArray:
    """Tell which coefficients of the base model are frictions, which cannot be negative.

    They can be where friction of the base model alone feeds in power, as of a motor that another
    one drives: it represents another effect there.
    """
    model, out = identified.model, np.zeros(count, bool)
    if identified.options.trusted:
        return out  # `consistent_parameters` makes them dissipative
    kinds = [kind for kind in ("viscous", "coulomb") if kind in model.parameters.drive]
    powers = friction_powers(model, identified.equations, identified.data, kinds)
    dissipating = [j for j, (power, _) in powers.items() if power > 0.0]
    frictions = [model.parameters.block(kind).start + j for kind in kinds for j in dissipating]
    alone = np.count_nonzero(model.base.matrix, axis=1) == 1
    out[: len(free)] = (alone & np.isin(model.base.independent, frictions))[free]
    return out


def with_parameters(
    identified: Identification,
    motions: Sequence[RecordedMotion],
    psi: FloatArray,
    widths: FloatArray,
) -> list[RecordedMotion]:
    """Return motions with the base model of other parameters."""
    model = identified.model
    robot = recorded_motion.FittedRobot(model.robot, model.parameters, psi)
    columns, theta = model.friction_columns(), model.base.matrix @ psi
    return [m.with_base_model(robot, widths, theta, columns) for m in motions]


def consistent_parameters(identified: Identification, fitted: JointModel) -> FloatArray:
    """Return the physically consistent standard parameters of a fit, shape (P,).

    Those of a trusted prior are as stated, with dissipative joint parameters.
    """
    if not identified.options.trusted:
        return consistent_estimate(identified, fitted).psi
    psi, base, model = fitted.psi.copy(), identified.model.base, identified.model
    change = fitted.solution.coefficients[: len(fitted.free)] - (base.matrix @ psi)[fitted.free]
    psi[np.asarray(base.independent)[fitted.free]] += change
    for kind in ("rotor_inertia", "viscous", "coulomb"):
        if kind in model.parameters.drive:
            indices = model.parameters.block(kind)
            psi[indices] = np.maximum(psi[indices], 0.0)
    return psi


def consistent_estimate(identified: Identification, fitted: JointModel) -> ConsistentEstimate:
    """Return the physically consistent estimate of a fit without a trusted prior."""
    information, score, _ = fitted.regression.data_information(len(fitted.free))
    values, vectors = np.linalg.eigh(information)
    known = values > 1e-12 * values.max()
    root = np.sqrt(values[known])[:, None] * vectors[:, known].T
    target = (vectors[:, known].T @ score) / np.sqrt(values[known])
    return consistency.maximum_a_posteriori(
        identified.model.parameters,
        root @ identified.model.base.matrix,
        target,
        identified.prior,
        identified.options.bounds,
        start=fitted.psi,
    )
