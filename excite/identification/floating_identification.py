"""Identification of floating-base robots from contact wrenches, joint torques or both.

Steps: cutoff frequency of each row by the prediction error of the nominal model → filtered
equations y = Γ θ + N b with sensor offsets b → weights of the rows → weight γ of the prior by
blocked cross-validation on the training recordings → physically consistent estimate (Lee, Kwon,
Wensing & Park, eq. 12 and 21); once more with the cutoff frequencies of the identified model.

Every row is weighted by the variance of its residual times the number of samples per independent
sample, 1 + 2 Σ ρ_k with the autocorrelations ρ_k of its residual (summed up to the first that is
not positive): what a coloured residual of that length is worth.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .._types import FloatArray
from ..designer import identifiability
from ..designer.identifiability import Identifiability
from ..designer.identifiability_threshold import IDENTIFIABLE_VARIANCE
from ..errors import UnusableInput
from ..recordings import Recording
from ..robot import floating_base
from ..robot.floating_base import FloatingRobot, Rows
from ..robot.inertial_parameters import COULOMB_WIDTH, DRIVE, metric
from ..robot.limits import Limits
from . import consistency, estimators, floating_regression, prior_weight, symmetry
from .consistency import Bounds, ConsistentEstimate, Prior
from .estimators import Estimate, Method
from .floating_regression import FloatingEquations, FloatingModel
from .identification import Prediction
from .inertia_distance import Distance
from .link_estimates import LinkEstimate, link_estimates
from .lowpass import SETTLING_FACTOR, TAPER_FRACTION, tapered_gain

Progress = Callable[[str], None]
"""Receives one line of text per step."""
FOLDS = 5
"""Number of contiguous parts of the training recordings on which γ is validated."""
COARSE_GAMMAS = 10.0 ** np.arange(-1.0, 5.5)
"""Values of γ that are compared first: relative deviations of a body from 220 % to 0.22 %."""
FINE_FACTORS = 10.0 ** np.array([-0.5, 0.0, 0.5])
"""Values that are compared next, in units of the best of them."""
UNIT_GAMMA_OF_SI = 1e3
"""Factor of these values for the Euclidean distance, whose unit is that of SI squared [1]: of the
parameters of a link of 1 kg the largest squared entries of the metric are of this order."""
BAND_ITERATIONS = 2
"""Number of alternations between the cutoff frequencies and the estimate: first those of the
nominal bodies, then those of the identified ones."""
WEIGHT_ITERATIONS = 3
"""Number of alternations between the estimate and the weights of the rows."""
MAX_BAND_HZ = 20.0
"""Highest cutoff frequency chosen automatically [Hz], that of fixed-base identification."""
MIN_BAND_HZ = 0.5
"""Lowest cutoff frequency chosen automatically [Hz]."""
MAX_BAND_SHARE = 0.4
"""Cutoff frequency over the rate of a recording, at most."""
WELCH_SECONDS = 20.0
"""Length of a window in the densities of the rows [s]: their resolution is then 0.05 Hz."""
MAX_MARGIN_SHARE = 0.5
"""Share of a recording that the filter may discard at its ends, where the cutoff is chosen."""
OFFSET_SHARE = 0.05
"""Standard deviation of a force offset over the robot's weight [1], of a sensor that was zeroed
but drifts; that of a moment offset is the same at a lever of OFFSET_LEVER."""
OFFSET_LEVER = 1.0
"""Lever of the moment offsets [m]: plates are zeroed about points up to a metre from the foot."""


@dataclass(frozen=True)
class FloatingOptions:
    """Options of `identify`.

    Attributes:
        rows: Rows to fit; None: all that the recordings hold.
        drive: Kinds of joint parameters, if joint rows are fitted.
        distance: Distance of link inertias from nominal.
        gamma: γ of the inertial parameters, or how to choose it: "heldout", by blocked
            cross-validation on the training recordings, or "evidence".
        band: Cutoff frequency of all rows [Hz]; None: that of each row by its prediction
            error, see `choose_bands`.
        threshold: Largest scale-free variance of a direction that counts as identified.
        bounds: Bounds of masses and centres of mass.
        symmetric: Prefixes of the names of links on the left and on the right whose bodies mirror
            each other; None: no such prior.
        offsets: Estimate constant offsets of the wrench sensors.
    """

    rows: Rows | None = None
    drive: tuple[str, ...] = DRIVE
    distance: Distance = Distance.BREGMAN
    gamma: str | float = "heldout"
    band: float | None = None
    threshold: float = IDENTIFIABLE_VARIANCE
    bounds: Bounds = field(default_factory=Bounds)
    symmetric: tuple[str, str] | None = None
    offsets: bool = True


@dataclass(frozen=True)
class RowWeights:
    """Residual of each row.

    Attributes:
        deviation: Its standard deviation. Shape (r,) [N, N m].
        samples_per_independent: Number of its samples that are worth an independent one. Shape
            (r,).
    """

    deviation: FloatArray
    samples_per_independent: FloatArray

    @property
    def scale(self) -> FloatArray:
        """Standard deviation of an independent sample of the same information. Shape (r,)."""
        return np.asarray(self.deviation * np.sqrt(self.samples_per_independent))


@dataclass(frozen=True)
class FloatingIdentification:
    """Result of an identification.

    Attributes:
        model: The model.
        options: The options.
        hertz: Cutoff frequency of each row. Shape (r,) [Hz].
        rows_fitted: Number of times at which the rows were fitted.
        weights: Residual and weight of each row.
        data: Base parameters estimated from the data alone, with the coloured spectrum of the
            residuals.
        information_root: R with RᵀR the weighted information on θ, offsets unknown. Shape (m, p).
        posterior: Physically consistent estimate with the prior.
        prior: ψ₀, the distance and γ.
        symmetry: Root of the information of symmetric bodies, see `symmetry`; without rows if there
            is none. Shape (10 pairs, P).
        offset: Offsets of the wrench sensors, six of each contact. Shape (6 contacts,).
        offset_deviation: Their standard deviations.
        analysis: Identifiability of the directions by the weighted information.
        gamma_trials: Pairs of γ and validation error.
        fits: Predictions of the training recordings; those with the nominal bodies contain the
            offsets that fit best with them.
        validations: Predictions of the validation recordings.
    """

    model: FloatingModel
    options: FloatingOptions
    hertz: FloatArray
    rows_fitted: int
    weights: RowWeights
    data: Estimate
    information_root: FloatArray
    posterior: ConsistentEstimate
    prior: Prior
    symmetry: FloatArray
    offset: FloatArray
    offset_deviation: FloatArray
    analysis: Identifiability
    gamma_trials: tuple[tuple[float, float], ...]
    fits: tuple[Prediction, ...]
    validations: tuple[Prediction, ...]

    @property
    def psi(self) -> FloatArray:
        """Identified standard parameters ψ̂. Shape (P,)."""
        return self.posterior.psi

    def body_shares(self) -> Mapping[str, float]:
        """Return for each link the share of its inertial parameters that the data decide.

        It is 1 − tr(C G)/tr(C₀ G) with the posterior covariance C of its ten parameters, the
        covariance C₀ that the prior alone gives them, and the metric G of `local_prior`: 0 where
        the prior decides all of them. Symmetry is part of the prior.
        """
        parameters = self.model.parameters
        prior = consistency.local_prior(parameters, self.prior, self.psi)
        before = consistency.symmetric_pseudo_inverse(
            consistency.prior_information(parameters, prior) + self.symmetry.T @ self.symmetry
        )
        bodies = consistency.inertial_rows(parameters, prior.nominal)
        shares = {}
        for i, link in enumerate(parameters.links):
            block, G = slice(10 * i, 10 * i + 10), metric(bodies[i])
            after = float(np.trace(self.posterior.covariance[block, block] @ G))
            ahead = float(np.trace(before[block, block] @ G))
            shares[link] = float(np.clip(1.0 - after / ahead, 0.0, 1.0))
        return shares

    def links(self) -> list[LinkEstimate]:
        """Return mass and centre of mass of each link."""
        further = self.symmetry.T @ self.symmetry
        return link_estimates(self.model.parameters, self.posterior, self.prior, further)


def identify(
    robot: FloatingRobot,
    recordings: Sequence[Recording],
    validate: Sequence[Recording] = (),
    options: FloatingOptions | None = None,
    limits: Limits | None = None,
    progress: Progress = lambda _: None,
) -> FloatingIdentification:
    """Identify the bodies of a floating-base robot.

    Args:
        robot: The robot.
        recordings: Recordings that the model is fitted to; all have the same contacts.
        validate: Recordings that the model is validated on; they choose nothing.
        options: Options.
        limits: Limits of the joints, for the scales of joint parameters.
        progress: Called with a line of text at each step.

    Raises:
        UnusableInput: A recording lacks a quantity, its contacts differ, or it is too short.
    """
    options = options or FloatingOptions()
    rows = options.rows or floating_regression.available_rows(recordings)
    contacts = recordings[0].contacts
    for recording in (*recordings, *validate):
        floating_regression.require_rows(recording, rows)
        if recording.contacts != contacts:
            raise UnusableInput(
                f"{recording.source}: has the contacts {', '.join(recording.contacts) or 'none'}, "
                f"{recordings[0].source} has {', '.join(contacts) or 'none'}; identify recordings "
                "with the same wrench columns together"
            )
        for frame in contacts:
            floating_base.require_frame(robot, frame, recording.source)
    drive = options.drive if rows.has_joints else ()
    parameters = floating_base.standard_parameters(robot, limits, drive)
    base = floating_base.find_base_parameters(robot, parameters, rows)
    widths = np.full(robot.n, COULOMB_WIDTH)
    model = FloatingModel(robot, parameters, base, rows, contacts, widths)
    psi = consistency.consistent_nominal(parameters)
    iterations = BAND_ITERATIONS if options.band is None else 1
    for iteration in range(iterations):
        hertz = choose_bands(model, recordings, psi, options.band)
        progress(
            f"{sum(map(len, recordings))} rows, bands {hertz.min():.3g} to {hertz.max():.3g} Hz: "
            "building the equations"
        )
        system = floating_regression.build_equations(model, recordings, hertz)
        progress(
            f"{len(system)} × {len(model.joints)} equations, {base.count} base parameters, "
            f"{parameters.bodies} bodies: choosing the weights"
        )
        problem = _EstimationProblem(model, system, options)
        fit = problem.solve(progress, is_final=iteration == iterations - 1)
        psi = fit.posterior.psi
    factor = problem.factor(slice(0, len(system)), fit.weights)
    k = problem.offset_count
    root = factor[k:, k:-1]
    analysis = identifiability.analyse_root(
        parameters,
        base,
        root @ base.matrix,
        fit.weights.deviation,
        model,
        threshold=options.threshold,
        samples=sum(map(len, recordings)),
    )
    nominal_offset = problem.offset(factor, fit.prior.nominal)

    def predict(recording: Recording) -> Prediction:
        part = floating_regression.build_equations(model, [recording], hertz)
        after, before = (
            part.equations.predicted(base.matrix @ psi) + part.offsets[:, :, :k] @ offset
            for psi, offset in (
                (fit.posterior.psi, fit.offset),
                (fit.prior.nominal, nominal_offset),
            )
        )
        equations = part.equations
        return Prediction(
            recording.source,
            equations.time,
            equations.torque,
            before,
            after,
            None,
            equations.starts,
            equations.moving,
        )

    inverse = np.linalg.inv(factor[:k, :k]) if k else np.zeros((0, 0))
    coupling = inverse @ factor[:k, k:-1] @ base.matrix
    spread = inverse @ inverse.T + coupling @ fit.posterior.covariance @ coupling.T
    return FloatingIdentification(
        model=model,
        options=options,
        hertz=hertz,
        rows_fitted=len(system),
        weights=fit.weights,
        data=estimators.estimate(
            system.equations, Method.WLS, nuisance=system.offsets if k else None
        ),
        information_root=root,
        posterior=fit.posterior,
        prior=fit.prior,
        symmetry=problem.symmetry,
        offset=fit.offset,
        offset_deviation=np.sqrt(np.diag(spread)),
        analysis=analysis,
        gamma_trials=fit.trials,
        fits=tuple(predict(recording) for recording in recordings),
        validations=tuple(predict(recording) for recording in validate),
    )


def choose_bands(
    model: FloatingModel,
    recordings: Sequence[Recording],
    psi: FloatArray,
    hertz: float | None = None,
) -> FloatArray:
    """Choose for each row the cutoff frequency at which its prediction error is smallest.

    Wrenches are often stored with a narrower band than the motion, or the motion is noisier: above
    some frequency the predicted row then only adds error. With the densities S_y of the measured
    row, S_ŷ of the predicted one and S_e of their difference, a filter of gain g leaves the error
    ∫ S_y − g (S_y + S_ŷ − S_e) + g² S_ŷ over the training recordings.

    Args:
        model: The model.
        recordings: The training recordings.
        psi: Its parameters. Shape (P,).
        hertz: Cutoff frequency to use for all rows instead [Hz].

    Returns:
        Cutoff frequencies. Shape (r,) [Hz].
    """
    from scipy import signal  # slow to import

    count = len(model.joints)
    if hertz is not None:
        return np.full(count, float(hertz))
    rate = min(recording.rate for recording in recordings)
    length = max(len(segment) for r in recordings for segment in r.segments()) / rate
    lowest = max(MIN_BAND_HZ, _shortest_band(length))
    highest = max(min(MAX_BAND_HZ, MAX_BAND_SHARE * rate), lowest)
    system = floating_regression.build_equations(model, recordings, np.full(count, highest))
    equations = system.equations
    predicted = equations.predicted(model.base.matrix @ psi)
    window = max(equations.stretches(), key=lambda stretch: stretch.stop - stretch.start)
    size = min(window.stop - window.start, int(np.ceil(WELCH_SECONDS * equations.rate)))
    densities = [
        signal.welch(x[window], equations.rate, nperseg=size, axis=0, detrend="constant")
        for x in (equations.torque, predicted, equations.torque - predicted)
    ]
    frequency = densities[0][0]
    S_y, S_p, S_e = (density for _, density in densities)
    candidates = np.unique(np.clip(frequency, lowest, highest))
    errors = []
    for candidate in candidates:
        gain = tapered_gain(frequency, float(candidate))[:, None]
        errors.append(np.sum(S_y - gain * (S_y + S_p - S_e) + gain**2 * S_p, axis=0))
    return np.asarray(candidates[np.argmin(errors, axis=0)])


def _shortest_band(length: float) -> float:
    """Cutoff frequency whose margins are MAX_MARGIN_SHARE of a recording's length [s]."""
    return 2.0 * SETTLING_FACTOR / (TAPER_FRACTION * MAX_MARGIN_SHARE * length)


@dataclass(frozen=True)
class _Fit:
    """Estimate with its weights and prior."""

    posterior: ConsistentEstimate
    offset: FloatArray
    weights: RowWeights
    prior: Prior
    trials: tuple[tuple[float, float], ...]


class _EstimationProblem:
    """Equations, prior information and the estimate for given weights and γ."""

    def __init__(
        self, model: FloatingModel, system: FloatingEquations, options: FloatingOptions
    ) -> None:
        self.model, self.options, self.parameters = model, options, model.parameters
        self.equations = system.equations
        self.offset_count = system.offsets.shape[2] if options.offsets else 0
        self.columns = np.concatenate(
            [
                system.offsets[:, :, : self.offset_count],
                self.equations.regressor,
                self.equations.torque[:, :, None],
            ],
            axis=2,
        )
        gravity = float(np.linalg.norm(model.robot.model.gravity.linear))
        force = OFFSET_SHARE * model.robot.mass * gravity
        sensor = np.repeat([force, OFFSET_LEVER * force], 3)
        self.offset_scale = np.tile(sensor, self.offset_count // 6)
        nominal = consistency.consistent_nominal(self.parameters)
        joints = self.parameters.count - 10 * self.parameters.bodies
        scales = prior_weight.joint_parameter_scales(self.parameters)
        self.start = Prior(nominal, options.distance, 1.0, np.ones(joints), scales)
        self.symmetry = (
            np.zeros((0, self.parameters.count))
            if options.symmetric is None
            else symmetry.symmetry_root(model.robot, self.parameters, *options.symmetric)
        )

    def factor(self, which: slice | FloatArray, weights: RowWeights) -> FloatArray:
        """QR factor of the weighted [N | Γ | y] at some times, with the prior of the offsets."""
        rows = (self.columns[which] / weights.scale[:, None]).reshape(-1, self.columns.shape[2])
        k = self.offset_count
        offsets = np.zeros((k, rows.shape[1]))
        offsets[range(k), range(k)] = 1.0 / self.offset_scale
        return np.asarray(np.linalg.qr(np.vstack([offsets, rows]), mode="r"))

    def offset(self, factor: FloatArray, psi: FloatArray) -> FloatArray:
        """Offsets of the sensors for given parameters."""
        k = self.offset_count
        if not k:
            return np.zeros(0)
        right = factor[:k, -1] - factor[:k, k:-1] @ (self.model.base.matrix @ psi)
        return np.asarray(np.linalg.solve(factor[:k, :k], right))

    def stacked(self, factor: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Root and target of the estimate of ψ: data with unknown offsets, and symmetry."""
        k = self.offset_count
        p = self.model.base.count
        root = factor[k : k + p, k:-1] @ self.model.base.matrix
        return (
            np.vstack([root, self.symmetry]),
            np.concatenate([factor[k : k + p, -1], np.zeros(len(self.symmetry))]),
        )

    def estimate(self, factor: FloatArray, prior: Prior) -> ConsistentEstimate:
        """Physically consistent estimate."""
        root, target = self.stacked(factor)
        return consistency.maximum_a_posteriori(
            self.parameters, root, target, prior, self.options.bounds
        )

    def residual(self, psi: FloatArray, offset: FloatArray) -> FloatArray:
        """Residual of all rows. Shape (N, r)."""
        k = self.offset_count
        fitted = self.columns[:, :, k:-1] @ (self.model.base.matrix @ psi)
        return np.asarray(self.columns[:, :, -1] - fitted - self.columns[:, :, :k] @ offset)

    def solve(self, progress: Progress, *, is_final: bool) -> _Fit:
        """Alternate between the weights of the rows, γ and the estimate.

        γ is that of the evidence, which is quick to compute, until the weights are final.
        """
        complete = slice(0, len(self.columns))
        weights = self.initial_weights()
        trials: tuple[tuple[float, float], ...] = ()
        prior, factor = self.start, self.factor(complete, weights)
        for iteration in range(WEIGHT_ITERATIONS):
            is_last = is_final and iteration == WEIGHT_ITERATIONS - 1
            prior, trials = self.choose_prior(factor, weights, validated=is_last)
            if is_last:
                progress(f"γ {prior.inertial_weight:.3g} ({len(trials)} values compared)")
            posterior = self.estimate(factor, prior)
            offset = self.offset(factor, posterior.psi)
            if iteration < WEIGHT_ITERATIONS - 1:
                weights = self.weights_of(self.residual(posterior.psi, offset))
                factor = self.factor(complete, weights)
        return _Fit(posterior, offset, weights, prior, trials)

    def initial_weights(self) -> RowWeights:
        """Weights by the residual of the nominal bodies without its mean."""
        psi = self.start.nominal
        residual = self.residual(psi, np.zeros(self.offset_count))
        return self.weights_of(residual - residual.mean(axis=0))

    def weights_of(self, residual: FloatArray) -> RowWeights:
        """Standard deviation and colour of each row's residual."""
        deviation = np.maximum(np.sqrt(np.mean(residual**2, axis=0)), 1e-300)
        stretches = list(self.equations.stretches())
        longest = max(stretches, key=lambda stretch: stretch.stop - stretch.start)
        samples = np.array([samples_per_independent(row) for row in residual[longest].T])
        return RowWeights(deviation, samples)

    def choose_prior(
        self, factor: FloatArray, weights: RowWeights, *, validated: bool
    ) -> tuple[Prior, tuple[tuple[float, float], ...]]:
        """Choose γ: given, by evidence, or by blocked cross-validation if `validated`."""
        gamma, prior = self.options.gamma, self.start
        if gamma == "heldout" and not validated:
            gamma = "evidence"
        if len(prior.joint_weights) or gamma == "evidence":
            root, target = self.stacked(factor)
            inertial, joint = prior_weight.gamma_by_evidence(self.parameters, root, target, prior)
            prior = dataclasses.replace(prior, inertial_weight=inertial, joint_weights=joint)
        if not isinstance(gamma, str):
            return dataclasses.replace(prior, inertial_weight=float(gamma)), ()
        if gamma == "evidence":
            return prior, ()
        edges = np.linspace(0, len(self.columns), FOLDS + 1).astype(int)
        gap = int(np.ceil(weights.samples_per_independent.max()))
        folds = []
        for low, high in itertools.pairwise(edges):
            outside = np.concatenate(
                [np.arange(0, low - gap), np.arange(high + gap, len(self.columns))]
            )
            folds.append((slice(int(low), int(high)), self.factor(outside, weights)))

        def squared_error(trial: float, fold: int) -> float:
            held_out, training = folds[fold]
            choice = dataclasses.replace(prior, inertial_weight=trial)
            psi = self.estimate(training, choice).psi
            error = self.residual(psi, self.offset(training, psi))[held_out]
            return float(np.sum((error / weights.scale) ** 2))

        unit = 1.0 / UNIT_GAMMA_OF_SI if self.options.distance is Distance.EUCLIDEAN else 1.0
        best, coarse = prior_weight.gamma_by_validation(squared_error, unit, FOLDS, COARSE_GAMMAS)
        best, fine = prior_weight.gamma_by_validation(squared_error, best, FOLDS, FINE_FACTORS)
        trials = sorted(dict([*coarse, *fine]).items())
        return dataclasses.replace(prior, inertial_weight=best), tuple(trials)


def samples_per_independent(residual: FloatArray) -> float:
    """Return how many samples of a coloured residual are worth an independent one.

    That is 1 + 2 Σ ρ_k, summed over the autocorrelations up to the first that is not positive
    (Geyer, "Practical Markov chain Monte Carlo", Statistical Science 7(4), 1992).

    Args:
        residual: Evenly spaced samples. Shape (N,).
    """
    centred = residual - residual.mean()
    spectrum = np.abs(np.fft.rfft(centred, 2 * len(centred))) ** 2
    correlation = np.fft.irfft(spectrum)[: len(centred)]
    if correlation[0] <= 0.0:
        return 1.0
    correlation = correlation / correlation[0]
    negative = np.flatnonzero(correlation <= 0.0)
    end = int(negative[0]) if len(negative) else len(correlation)
    return float(max(1.0, 1.0 + 2.0 * correlation[1:end].sum()))
