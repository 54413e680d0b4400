"""Joint model of a robot: base model, frictions of every joint, delay and ripple, fitted together.

Real joints have Stribeck, nonlinear viscous and load-dependent friction and presliding hysteresis
at once. All of it is fitted jointly with the base model, before anything is judged:

1. columns of the frictions at every joint (`dense_models`), with nonnegative coefficients;
2. weights of the rows from the residual and its autocorrelation;
3. the delay, whose coefficient on the slope of the torque moves into the torque's time stamps;
4. the spatial frequencies of torque ripple, from the residual of all that;
5. physically consistent base parameters, and with them the load of every joint; again from 1.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..effects import (
    EFFECTS_BY_NAME,
    hysteresis,
    load_friction,
    nonlinear_viscous,
    recorded_motion,
    stribeck,
    torque_ripple,
)
from ..effects.effect import CandidateModel
from ..effects.form_error import RELATIVE_STD, with_form_error
from ..effects.recorded_motion import RecordedMotion
from ..identification import consistency
from ..identification.consistency import ConsistentEstimate
from ..identification.identification import Identification
from ..identification.lowpass import Grid
from . import session_changes
from .candidate_fits import CandidateBatch
from .columns import Columns
from .flexible_models import UNMODELLED
from .normal_equations import RIDGE, Solution
from .regression import JointRegression, independent_share, rms

ROUNDS = 4
"""Rounds of the fit: delay and weights change by less than 1 % after three."""
RIPPLE_ROUNDS = (1, 2)
"""Rounds that are followed by a search for ripple: not before the first fit of the frictions."""
MAX_DELAY_STEP = 0.01
"""Prior standard deviation of the delay [s]."""
MIN_DELAY = 1e-5
"""Delay of the clock below which there is none [s]."""
MIN_FREEDOM = 0.1
"""Smallest share of rows that counts as degrees of freedom of the residual."""
MIN_DELAY_EVIDENCE = 5.0
"""Log Bayes factor from which a delay of the clock enters the model."""
MIN_LEVEL_SHARE = 0.3
"""Least friction level of a joint, over the median of all joints."""
MIN_TORQUE_SHARE = 0.1
"""Least friction level of a joint, over the standard deviation of its torque."""
MAX_WIDTH_STEP = 0.7
"""Largest change of the logarithm of a Coulomb width in a round."""
MIN_RIPPLE_EVIDENCE = 5.0
"""Log Bayes factor from which a wave enters the model, after the search over its order."""
MIN_RIPPLE_ORDER, MAX_RIPPLE_ORDER = 3.0, 300.0
"""Spatial frequencies that are searched [1/rad]; the travel of a sliding joint counts as a turn."""
ORDER_STEPS = 4.0
"""Length of the Fourier transform over the range of the angle."""
NEAR_ORDERS = 9
"""Orders around a peak of the spectrum from the best of which the refinement starts."""
GAUSS_NEWTON_STEPS = 6
"""Steps of the refinement of an order."""
MAX_WAVES = 12
"""Waves of a joint at most."""
MAX_ORDER_STEP = 0.3
"""Largest step of an order, over the width of a peak in the order spectrum."""
MIN_ORDER_DISTANCE = 0.5
"""Smallest distance of two orders that count as two waves, over the width of a peak."""
ORDER_TOLERANCE = 1e-4
"""Step at which the refinement of an order ends, in the same unit."""
ANGLE_BIN = np.pi / 2400.0
"""Width of the bins of angle in the order spectrum [rad], an eighth of the shortest wave."""
SPEED_CLASSES = 8
"""Classes of speed in the order spectrum."""
MIN_WAVE_ROWS = 0.05
"""Smallest share of rows in which a wave lies below the cutoff frequency."""
MIN_WAVES = 3.0
"""Periods over the range of a joint from which a torque counts as periodic."""
FRICTIONS = {
    "stribeck": stribeck,
    "nonlinear_viscous": nonlinear_viscous,
    "hysteresis": hysteresis,
    "load_friction": load_friction,
}
"""Frictions that are fitted at every joint: name and module with its `dense_model`."""


@dataclass(frozen=True)
class JointModel:
    """A fitted joint model.

    Attributes:
        motions: Recorded motions, with the base model and with the torque moved by the delay.
        models: Effects in the order of the regression.
        regression: The regression.
        delay: Time by which all torque is recorded late [s].
        level: Friction level of each joint, the unit of prior deviations, shape (n,) [N m].
        psi: Standard parameters, shape (P,).
        free: Base parameters that are refit, shape (p,); all but those of a trusted prior.
        known: Torque of the others, which is not part of the regression, shape (N, n) [N m].
    """

    motions: tuple[RecordedMotion, ...]
    models: tuple[CandidateModel, ...]
    regression: JointRegression
    delay: float
    level: FloatArray
    psi: FloatArray
    free: IntArray
    known: FloatArray

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.motions[0].n

    @property
    def delay_place(self) -> int:
        """Place of the delay among the coefficients: after base parameters and widths."""
        return len(self.free) + self.n

    @property
    def session_places(self) -> slice:
        """Places of the changes between recordings, the last coefficients of the base model."""
        return slice(self.delay_place + 1, self.regression.base_count)

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

    def coefficients(self, effect: int) -> FloatArray:
        """Return the coefficients of an effect, shape (k,)."""
        return np.asarray(self.solution.coefficients[self.regression.slices[effect]])

    def keeping(self, effects: Sequence[int]) -> JointModel:
        """Return the model with some of its effects, and the same rows and weights.

        Args:
            effects: Numbers of the effects, in rising order.
        """
        models = tuple(self.models[i] for i in effects)
        return replace(self, models=models, regression=self.regression.keeping(effects))

    def columns(self, model: CandidateModel) -> Columns | None:
        """Return the columns of a model over all motions; None if they are zero or not finite."""
        return model_columns(model, self.motions, self.level)

    def with_effects(self, models: Sequence[CandidateModel]) -> JointModel:
        """Return the model with further effects, except those whose columns are zero."""
        columns = [self.columns(model) for model in models]
        kept = [model for model, c in zip(models, columns, strict=True) if c is not None]
        regression = self.regression.copy()
        regression.add_all([c for c in columns if c is not None])
        return replace(self, models=(*self.models, *kept), regression=regression)


def model_columns(
    model: CandidateModel, motions: Sequence[RecordedMotion], level: FloatArray
) -> Columns | None:
    """Return the columns of a model over motions; None if they are zero or not finite.

    Args:
        model: The model.
        motions: The motions.
        level: Friction level of each joint, shape (n,) [N m].
    """
    parts = [model.columns(motion) for motion in motions]
    acting = np.any([part.any(axis=(0, 2)) for part in parts], axis=0)
    values = {
        j: np.concatenate([part[:, j] for part in parts]) for j in np.flatnonzero(acting).tolist()
    }
    largest = max((float(np.abs(x).max()) for x in values.values()), default=0.0)
    if not 1e-9 < largest < np.inf:
        return None
    k = parts[0].shape[2]
    if model.prior_std is not None:
        prior = np.full(k, model.prior_std)
    else:
        prior = np.full(k, float(np.max(level) if model.joint is None else level[model.joint]))
        if not any(model.nonnegative):
            # coefficients in units of their own: a column of unit RMS has the friction level
            rows = sum(len(part) for part in parts)
            size = np.sqrt(sum(np.sum(x**2, axis=0) for x in values.values()) / rows)
            prior /= np.maximum(size, 1e-3 * size.max())
    prior[: len(model.prior_shares)] *= model.prior_shares
    if model.form_columns:
        prior[-model.form_columns :] = RELATIVE_STD
    nonnegative = np.array(model.nonnegative or (False,) * k)
    return Columns(tuple(values), tuple(values.values()), nonnegative, prior)


def dense_models(motions: Sequence[RecordedMotion]) -> list[CandidateModel]:
    """Return the friction models of every joint."""
    return [
        effect.dense_model(motions, j) for j in range(motions[0].n) for effect in FRICTIONS.values()
    ]


def first_round(identified: Identification, motions: Sequence[RecordedMotion]) -> JointModel:
    """Return the frictions of all joints at the identified parameters, which start every fit.

    Args:
        identified: The base model.
        motions: The motions to fit.
    """
    psi = initial_parameters(identified)
    present = renewed(identified, motions, psi, identified.model.widths)
    return base_model(identified, present, psi).with_effects(dense_models(present))


def fit(
    identified: Identification,
    motions: Sequence[RecordedMotion],
    rare: Sequence[CandidateModel] = (),
    start: JointModel | None = None,
) -> JointModel:
    """Fit the joint model to recorded motions.

    Args:
        identified: The base model.
        motions: The motions to fit.
        rare: Further effects.
        start: What `first_round` returns, if it is at hand.
    """
    widths, delay = identified.model.widths, 0.0
    waves: list[CandidateModel] = []
    fitted = (start or first_round(identified, motions)).with_effects(rare)
    for step in range(ROUNDS - 1):
        reweight(fitted.regression)
        x = fitted.solution.coefficients
        delay += float(x[fitted.delay_place])
        if delay_evidence(fitted, delay)[0] <= MIN_DELAY_EVIDENCE:
            delay = 0.0
        width_steps = x[len(fitted.free) : fitted.delay_place]
        widths = widths * np.exp(np.clip(width_steps, -MAX_WIDTH_STEP, MAX_WIDTH_STEP))
        psi = consistent_parameters(identified, fitted)
        if step == 0:
            rare = [_with_discrepancy(fitted, model) for model in rare]
        if step in RIPPLE_ROUNDS:
            waves = [*refined_waves(fitted), *find_waves(fitted)]
        moved = [m.with_torque(_moved(m, delay)) for m in motions]
        present = renewed(identified, moved, psi, widths)
        weights = fitted.regression.sigma, fitted.regression.independent_share
        fitted = base_model(identified, present, psi, delay, weights)
        fitted = fitted.with_effects([*dense_models(present), *rare, *waves])
    reweight(fitted.regression)
    for motion, torque in zip(fitted.motions, modelled_torque(fitted), strict=True):
        motion.cache["motor_torque"] = motion.cache["measured_torque"] = torque
    return fitted


def delay_evidence(fitted: JointModel, seconds: float) -> tuple[float, float]:
    """Return the log Bayes factor for a delay of the clock, and its standard deviation [s].

    ln B = ½ I d² − ½ ln(1 + I σ²), with the information I of the data and the prior N(0, σ²).

    Args:
        fitted: A joint model.
        seconds: The delay d [s].
    """
    place = np.zeros((int(np.count_nonzero(fitted.solution.active)), 1))
    place[fitted.delay_place] = 1.0  # all base coefficients are active
    square = float(fitted.solution.solve(place)[fitted.delay_place, 0])
    information = max(1.0 / square - 1.0 / MAX_DELAY_STEP**2, 0.0)
    factor = 0.5 * information * seconds**2 - 0.5 * np.log1p(information * MAX_DELAY_STEP**2)
    return float(factor), float(np.sqrt(square))


def modelled_torque(model: JointModel) -> list[FloatArray]:
    """Return the torque of the model at every sample of its motions, shapes (M, n) [N m].

    Effects of measured torque are computed from it: measured noise would be correlated with itself.
    """
    total = model.known + model.regression.torque - model.regression.residual()
    parts = recorded_motion.split_by_motion(total, model.motions)
    return [
        np.column_stack([np.interp(m.times, m.time, x) for x in part.T])
        for m, part in zip(model.motions, parts, strict=True)
    ]


def _with_discrepancy(fitted: JointModel, model: CandidateModel) -> CandidateModel:
    """Return a rare effect with the discrepancy of its form, in units of its fitted torque."""
    if model not in fitted.models or model.effect == UNMODELLED:
        return model
    if EFFECTS_BY_NAME[model.effect].prior_only:
        return model  # rigid bodies have exactly the form of their model
    coefficients = fitted.coefficients(fitted.models.index(model))
    return with_form_error(model, fitted.motions, coefficients)


def base_model(
    identified: Identification,
    motions: Sequence[RecordedMotion],
    psi: FloatArray,
    delay: float = 0.0,
    weights: tuple[FloatArray, float] | None = None,
) -> JointModel:
    """Return the joint model of the base model without effects.

    Args:
        identified: The base model.
        motions: The motions to fit.
        psi: Its standard parameters, shape (P,).
        delay: Time by which all torque is recorded late, which was moved already [s].
        weights: RMS residual of each joint [N m] and share of independent rows; of the motions'
            base model if None.
    """
    free, level = free_parameters(identified), friction_level(motions)
    fixed = np.delete(np.arange(identified.model.base.count), free)
    known = np.concatenate([m.gamma[:, :, fixed] @ m.theta[fixed] for m in motions])
    moving = np.concatenate([motion.moving for motion in motions])
    if weights is None:
        residual = np.concatenate([motion.residual for motion in motions])
        weights = rms(residual, moving), independent_share(residual, moving)
    regression = JointRegression.of_base(
        np.concatenate([motion.torque for motion in motions]) - known,
        moving,
        _base_columns(motions, level, free),
        _base_prior(identified, motions, free),
        *weights,
    )
    return JointModel(tuple(motions), (), regression, delay, level, psi, free, known)


def reweight(regression: JointRegression, transient: BoolArray | None = None) -> None:
    """Set the weights of the rows by the residual, twice, since they change it.

    Args:
        regression: The regression.
        transient: Rows that do not count, since their residual is that of a transient effect,
            shape (N,).
    """
    moving = regression.moving
    if transient is not None:
        lasting = moving & ~transient[:, None]
        moving = np.where(lasting.any(axis=0), lasting, moving)
    rows = np.maximum(moving.sum(axis=0), 1)
    for _ in range(2):
        residual = regression.residual()
        freedom = np.maximum(rows - regression.fitted_per_joint(), MIN_FREEDOM * rows)
        regression.reweighted(
            rms(residual, moving) * np.sqrt(rows / freedom), independent_share(residual, moving)
        )


def transient_rows(
    models: Sequence[CandidateModel], motions: Sequence[RecordedMotion]
) -> BoolArray:
    """Return the rows in which an effect acts that other rows do not show, shape (N,).

    Args:
        models: The effects.
        motions: The motions.
    """
    out = []
    for motion in motions:
        acting = np.zeros(len(motion), bool)
        for model in models:
            if model.interval is not None and model.source == motion.segment.source:
                low, high = model.interval
                acting |= (motion.time >= low) & (motion.time <= high)
        out.append(acting)
    return np.concatenate(out)


def friction_level(motions: Sequence[RecordedMotion]) -> FloatArray:
    """Return the Coulomb friction of each joint, or more where it is small, shape (n,) [N m].

    It is at least a share of the other joints' and of the variation of the joint's torque.
    """
    coulomb = np.abs(motions[0].fitted_robot.actuator_parameter("coulomb"))
    variation = np.concatenate([motion.torque for motion in motions]).std(axis=0)
    least = max(MIN_LEVEL_SHARE * float(np.median(coulomb)), 1e-12)
    return np.maximum(coulomb, np.maximum(least, MIN_TORQUE_SHARE * variation))


def free_parameters(identified: Identification) -> IntArray:
    """Return the base parameters that are refit, shape (p,): all that no trusted prior states."""
    base, trusted = identified.model.base, identified.options.trusted
    if not trusted:
        return np.arange(base.count)
    joint_parameters = 10 * identified.model.parameters.bodies
    return np.array(
        [
            k
            for k, place in enumerate(base.independent)
            if place >= joint_parameters and int(place) not in trusted
        ],
        int,
    )


def initial_parameters(identified: Identification) -> FloatArray:
    """Return the identified standard parameters, those of a trusted prior as stated, shape (P,)."""
    psi = identified.psi.copy()
    for place, value in identified.options.trusted.items():
        psi[place] = value
    return psi


def _base_columns(
    motions: Sequence[RecordedMotion], level: FloatArray, free: IntArray
) -> FloatArray:
    """Columns of the base model, shape (N, n, p + n + 1 + s).

    Γ, the change of Coulomb friction by its width, −dτ/dt, and the changes between recordings.
    """
    parts = []
    for motion in motions:
        slopes = np.zeros((len(motion), motion.n, motion.n))
        slopes[:, range(motion.n), range(motion.n)] = motion.slopes * level
        slope = -motion.band.filter(motion.segment.torque, Grid.KEPT, 1)[motion.kept]
        changes = session_changes.columns(motion, motions)
        parts.append(
            np.concatenate([motion.gamma[:, :, free], slopes, slope[:, :, None], changes], axis=2)
        )
    return np.concatenate(parts)


def _base_prior(
    identified: Identification, motions: Sequence[RecordedMotion], free: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Mean and information of the base parameters, widths, delay and session changes."""
    base, prior = identified.model.base, identified.prior
    p, n = len(free), motions[0].n
    changes = session_changes.prior_std(motions)
    mean, out = np.zeros(p + n + 1 + len(changes)), np.zeros((p + n + 1 + len(changes),) * 2)
    if not identified.options.trusted:
        out[:p, :p] = consistency.base_prior_information(identified.model.parameters, base, prior)
        mean[:p] = base.matrix @ prior.nominal
    out[range(p, p + n), range(p, p + n)] = 1.0
    out[p + n, p + n] = 1.0 / MAX_DELAY_STEP**2
    places = np.arange(p + n + 1, len(mean))
    out[places, places] = 1.0 / changes**2
    return mean, out


def _coulomb_columns(identified: Identification) -> IntArray:
    """Column of Γ that is the Coulomb friction of each joint, −1 where there is none."""
    out = np.full(identified.model.robot.n, -1)
    for column, joint in identified.model.friction_columns().items():
        out[joint] = column
    return out


def renewed(
    identified: Identification,
    motions: Sequence[RecordedMotion],
    psi: FloatArray,
    widths: FloatArray,
) -> list[RecordedMotion]:
    """Return motions with the base model of other parameters."""
    model = identified.model
    robot = recorded_motion.fitted_robot(model.robot, model.parameters, psi)
    columns = _coulomb_columns(identified)
    return [m.with_base_model(robot, widths, model.base.matrix @ psi, columns) for m in motions]


def _moved(motion: RecordedMotion, delay: float) -> FloatArray:
    """Return the recorded torque of a motion at earlier times, shape (M, n) [N m]."""
    if not delay:
        return motion.segment.torque
    t = motion.times
    return np.asarray(motion.torque_spline(np.clip(t + delay, t[0], t[-1])))


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
    """Return the physically consistent estimate of a fit without a trusted prior.

    The information of the base parameters is what the data hold after elimination of all effects.
    """
    model = identified.model
    p = len(fitted.free)
    solution = fitted.solution
    others = solution.active.copy()
    others[:p] = False
    eliminated = np.flatnonzero(others)
    a = solution.information
    scale = 1.0 / np.sqrt(np.diag(a)[eliminated])
    block = a[eliminated][:, eliminated] * scale[:, None] * scale
    cross = scale[:, None] * a[eliminated][:, :p]
    schur = a[:p, :p] - cross.T @ np.linalg.solve(block + RIDGE * np.eye(len(scale)), cross)
    mean, prior = _base_prior(identified, fitted.motions, fitted.free)
    information = 0.5 * (schur + schur.T) - prior[:p, :p]
    score = schur @ solution.coefficients[:p] - prior[:p, :p] @ mean[:p]
    values, vectors = np.linalg.eigh(information)
    known = values > 1e-12 * values.max()
    root = np.sqrt(values[known])[:, None] * vectors[:, known].T
    target = (vectors[:, known].T @ score) / np.sqrt(values[known])
    return consistency.maximum_a_posteriori(
        model.parameters,
        root @ model.base.matrix,
        target,
        identified.prior,
        identified.options.bounds,
    )


def find_waves(fitted: JointModel) -> list[CandidateModel]:
    """Find torque ripple in the residual, at each joint until no wave has evidence.

    The order of each wave is that of the highest peak of the order spectrum. It is refined jointly
    with those of the waves found before it, which were biased without it.
    """
    share, hertz = fitted.regression.independent_share, fitted.motions[0].band.hertz
    out = []
    for j in range(fitted.n):
        moving = fitted.regression.moving[:, j]
        angle, speed = _angle_and_speed(fitted.motions, j)
        known = [
            m.values["order"] for m in fitted.models if m.effect == "torque_ripple" and m.joint == j
        ]
        span = float(np.ptp(angle))
        if span <= 0.0:
            continue
        width = 2.0 * np.pi / span
        is_prismatic = fitted.motions[0].fitted_robot.robot.entries[j].kind == "prismatic"
        radian = span / (2.0 * np.pi) if is_prismatic else 1.0
        low = max(MIN_RIPPLE_ORDER / radian, MIN_WAVES * width)
        waves: list[CandidateModel] = []
        regression = fitted.regression
        while len(known) + len(waves) < MAX_WAVES:
            residual = regression.residual_of(j)
            order, gain, count = _spectrum_peak(
                residual, angle / radian, speed / radian, moving, low * radian, hertz
            )
            order /= radian
            gain *= share / float(np.mean(residual[moving] ** 2))
            evidence = gain - np.log(max(count * max(gain, 1.0), 1.0))
            before = [wave.values["order"] for wave in waves]
            if evidence < MIN_RIPPLE_EVIDENCE or _are_near([*known, *before, order], width):
                break
            orders = _refined_orders(fitted, j, [*before, order], width)
            # of so few periods, a spring; near another one, a part of it
            if min(orders) < low or _are_near([*known, *orders], width):
                break
            waves = [torque_ripple.wave_model(fitted.motions, j, order) for order in orders]
            regression = fitted.with_effects(waves).regression
        out += waves
    return out


def _are_near(orders: Sequence[float], width: float) -> bool:
    """Tell whether two orders are too close to count as two waves.

    Args:
        orders: The orders [1/rad].
        width: Width of a peak in the order spectrum [1/rad].
    """
    distances = np.diff(np.sort(orders))
    return bool(np.any(distances < MIN_ORDER_DISTANCE * width))


def refined_waves(fitted: JointModel) -> list[CandidateModel]:
    """Return the waves of a joint model with orders refined by a Gauss-Newton step.

    All orders of a joint are refined jointly. A wave whose order comes near that of an earlier one
    was a part of it.
    """
    out = list[CandidateModel]()
    for j in range(fitted.n):
        waves = [
            (wave.values["order"], fitted.coefficients(i))
            for i, wave in enumerate(fitted.models)
            if wave.effect == "torque_ripple" and wave.joint == j
        ]
        if not waves:
            continue
        slopes = np.hstack([_order_slope(_wave(fitted.motions, j, k), c) for k, c in waves])
        steps = fitted.regression.candidate(_free_columns(j, slopes)).coefficients
        angle, _ = _angle_and_speed(fitted.motions, j)
        width = 2.0 * np.pi / float(np.ptp(angle))
        limit = MAX_ORDER_STEP * width
        known: list[float] = []
        for (order, _), step in zip(waves, np.clip(steps, -limit, limit).tolist(), strict=True):
            if not _are_near([*known, order + step], width):
                known.append(order + step)
        out += [torque_ripple.wave_model(fitted.motions, j, order) for order in known]
    return out


def _free_columns(joint: int, torque: FloatArray) -> Columns:
    """Columns of one joint, shape (N, k), with coefficients of either sign and no prior."""
    k = torque.shape[1]
    return Columns((joint,), (torque,), np.zeros(k, bool), np.full(k, np.inf))


def _angle_and_speed(
    motions: Sequence[RecordedMotion], joint: int
) -> tuple[FloatArray, FloatArray]:
    """Angle and speed of a joint at the rows of all motions."""
    angle = [np.interp(m.time, m.times, m.samples.q[:, joint]) for m in motions]
    speed = [np.interp(m.time, m.times, m.samples.dq[:, joint]) for m in motions]
    return np.concatenate(angle), np.concatenate(speed)


def _spectrum_peak(
    residual: FloatArray,
    angle: FloatArray,
    speed: FloatArray,
    moving: BoolArray,
    low: float,
    hertz: float,
) -> tuple[float, float, int]:
    """Return the order of the wave that fits a residual best, half its power, and their number.

    A least-squares periodogram over the angle (Lomb 1976), by Fourier transforms of sums in narrow
    bins of the angle. Rows where the wave lies above the cutoff frequency do not count; the speeds
    are divided into classes for that.

    Args:
        residual: Torque residual, shape (N,) [N m].
        angle: Joint angle, shape (N,) [rad].
        speed: Joint speed, shape (N,) [rad/s].
        moving: Rows that count, shape (N,).
        low: Smallest order [1/rad].
        hertz: Cutoff frequency [Hz].

    Returns:
        Order [1/rad], half the power of its wave [(N m)²], and number of independent orders.
    """
    rows = np.flatnonzero(moving)
    place = np.rint((angle[rows] - angle[rows].min()) / ANGLE_BIN).astype(int)
    length = int(2 ** np.ceil(np.log2(ORDER_STEPS * (int(place.max()) + 1))))
    orders = 2.0 * np.pi * np.arange(length // 2 + 1) / (length * ANGLE_BIN)
    wanted = np.flatnonzero((orders >= low) & (orders <= MAX_RIPPLE_ORDER))
    twice = np.minimum(2 * wanted, length // 2)
    highest = 2.0 * np.pi * hertz / np.maximum(np.abs(speed[rows]), 1e-9)
    edges = np.append(np.quantile(highest, np.linspace(0.0, 1.0, SPEED_CLASSES + 1)[:-1]), np.inf)
    wave, square, count = (np.zeros(len(wanted), t) for t in (complex, complex, float))
    for first, last in itertools.pairwise(edges.tolist()):
        members = (highest >= first) & (highest < last)
        if not members.any():
            continue
        below = orders[wanted] <= float(np.median(highest[members]))
        sums = np.bincount(place[members], residual[rows][members], length)
        numbers = np.bincount(place[members], minlength=length)
        wave += np.where(below, np.fft.rfft(sums)[wanted], 0.0)
        square += np.where(below, np.fft.rfft(numbers)[twice], 0.0)
        count += below * float(members.sum())
    cc, ss, cs = 0.5 * (count + square.real), 0.5 * (count - square.real), -0.5 * square.imag
    yc, ys = wave.real, -wave.imag
    determinant = cc * ss - cs**2
    usable = (determinant > 1e-3 * (cc + ss) ** 2) & (count > MIN_WAVE_ROWS * len(rows))
    power = np.where(
        usable,
        (ss * yc**2 - 2.0 * cs * yc * ys + cc * ys**2) / np.where(usable, determinant, 1.0),
        0.0,
    )
    if not len(power):
        return 0.0, 0.0, 0
    k = int(np.argmax(power))
    return float(orders[wanted][k]), 0.5 * float(power[k]), len(wanted)


def _refined_orders(
    fitted: JointModel, joint: int, orders: Sequence[float], width: float
) -> list[float]:
    """Refine orders by Gauss-Newton steps, jointly with all coefficients of a joint model.

    Args:
        fitted: The joint model, without the waves.
        joint: Index of the joint.
        orders: Their orders; the last one is that of a peak in the order spectrum [1/rad].
        width: Width of a peak [1/rad].
    """

    distances = width * np.linspace(-1.0, 1.0, NEAR_ORDERS)

    def near(q: FloatArray) -> FloatArray:
        """Waves of all near orders, by powers of the phasor between two of them."""
        first, between = orders[-1] - width, distances[1] - distances[0]
        lowest, step = (np.exp(1j * k * q) for k in (first, between))
        waves = np.cumprod([lowest, *[step] * (NEAR_ORDERS - 1)], axis=0)
        return np.stack([waves.real, waves.imag], axis=1).reshape(-1, len(q)).T

    pairs = np.split(_filtered(fitted.motions, joint, near), NEAR_ORDERS, axis=1)
    others = np.zeros((len(pairs[0]), 0))
    if len(orders) > 1:
        known = [_wave(fitted.motions, joint, order)[:, :2] for order in orders[:-1]]
        others = np.hstack(known)
    batch = CandidateBatch.of(
        [_free_columns(joint, np.hstack([others, pair])) for pair in pairs],
        fitted.regression.moving,
    )
    gains = [fit.gain for fit in fitted.regression.candidates(batch)]
    refined = np.array(orders, float)
    refined[-1] += distances[int(np.argmax(gains))]
    count, limit = 2 * len(refined), MAX_ORDER_STEP * width
    for _ in range(GAUSS_NEWTON_STEPS):
        waves = [_wave(fitted.motions, joint, order) for order in refined.tolist()]
        columns = np.hstack([wave[:, :2] for wave in waves])
        c = fitted.regression.candidate(_free_columns(joint, columns)).coefficients
        slopes = [_order_slope(*part) for part in zip(waves, c.reshape(-1, 2), strict=True)]
        fit = fitted.regression.candidate(_free_columns(joint, np.hstack([columns, *slopes])))
        steps = np.clip(fit.coefficients[count:], -limit, limit)
        refined += steps
        if np.abs(steps).max() < ORDER_TOLERANCE * width:
            break
    return refined.tolist()


def _wave(motions: Sequence[RecordedMotion], joint: int, order: float) -> FloatArray:
    """Low-pass cos kq, sin kq, q cos kq and q sin kq of one order k, shape (N, 4)."""

    def wave(q: FloatArray) -> FloatArray:
        cosine, sine = np.cos(order * q), np.sin(order * q)
        return np.array([cosine, sine, q * cosine, q * sine]).T

    return _filtered(motions, joint, wave)


def _order_slope(wave: FloatArray, c: FloatArray) -> FloatArray:
    """Return the derivative of a wave with coefficients c by its order, shape (N, 1).

    Args:
        wave: What `_wave` returns.
        c: Coefficients of its cosine and sine.
    """
    return c[1] * wave[:, 2:3] - c[0] * wave[:, 3:]


def _filtered(
    motions: Sequence[RecordedMotion], joint: int, functions: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Low-pass functions of a joint's angle, shape (N, k)."""
    return np.concatenate([m.lowpass(functions(m.samples.q[:, joint])) for m in motions])
