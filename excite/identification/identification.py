"""Identification of a robot: physically consistent parameters from recordings.

Steps: segments of recordings → filtered regression equations → widths of Coulomb friction →
estimate of base parameters from the data alone → weight of the prior → physically consistent
estimate → identifiability and torque predictions.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .._types import BoolArray, FloatArray
from ..designer import identifiability
from ..designer.identifiability import Identifiability
from ..designer.identifiability_threshold import IDENTIFIABLE_VARIANCE, is_identifiable
from ..recordings import Recording
from ..robot.base_parameters import Base
from ..robot.inertial_parameters import COULOMB_WIDTH, Parameters
from ..robot.robot import Robot
from . import (
    consistency,
    dissipation,
    estimators,
    friction_width,
    instruments,
    position_bandwidth,
    prior_weight,
    regression,
    segments,
    simulation_error,
    simulation_refinement,
    torque_delay,
)
from .consistency import Bounds, ConsistentEstimate, Prior
from .estimators import Estimate, Method
from .hausman_test import HausmanTest, durbin_wu_hausman
from .inertia_distance import Distance
from .regression import IdentificationModel, TorqueEquations
from .segments import RecordingSegment, TorqueSpectra
from .simulation_error import SimulationError
from .torque_delay import TorqueDelay

Progress = Callable[[str], None]
"""Receives one line of text per step."""
CROSS_VALIDATION_FOLDS = 5
"""Number of contiguous parts of the recordings that γ is validated on."""
WIDTH_STEPS = 2
"""Gauss-Newton steps of the friction widths, starting from the best of a grid."""
TRUSTED_GAMMA = 1e8
"""γ of parameters that a trusted prior states: keeps them at their stated values."""
REDUCED_GAMMA = 1e-3
"""γ of the prior in `Identification.reduced`, small against the information of a direction that
counts as identified."""
MIN_ERROR_OVER_NOISE_FLOOR = 0.6
"""Smallest RMS error of a prediction over the noise floor at which the floor is noise [1]. The
error contains the noise; a smaller one shows that the periods differ in a torque that the model
predicts, as by the force pulses of EMPS, which leave the motion periodic."""
MAX_BAND_SHARE = 0.45
"""Cutoff frequency over the rate of a recording, at most, for predictions."""


@dataclass(frozen=True)
class IdentificationOptions:
    """Options of `identify`.

    Attributes:
        method: Estimator of the base parameters.
        distance: Distance of link inertias from nominal.
        gamma: γ of inertial and joint parameters, or how to choose it: "evidence", "heldout".
        band: Cutoff frequency [Hz]; chosen from the data if None.
        threshold: Largest scale-free variance of a direction that counts as identified.
        bounds: Bounds of masses and centres of mass.
        align: Shift torque by the estimated delay of each joint, where it is significant.
        trusted: Index in ψ and value of the parameters that are known.
        widths: Widths of Coulomb friction that are known, shape (n,) [rad/s or m/s]; estimated if
            None.
        hausman: Test whether instruments are needed.
        simulate: Compute the simulation error.
        refine: Refine the parameters against the simulation error.
        dissipation: Refuse recordings in which friction feeds in power; not for torque from which
            effects are subtracted.
    """

    method: Method = Method.WLS
    distance: Distance = Distance.BREGMAN
    gamma: str | tuple[float, float] = "evidence"
    band: float | None = None
    threshold: float = IDENTIFIABLE_VARIANCE
    bounds: Bounds = field(default_factory=Bounds)
    align: bool = False
    trusted: Mapping[int, float] = field(default_factory=dict)
    widths: FloatArray | None = None
    hausman: bool = False
    simulate: bool = False
    refine: bool = False
    dissipation: bool = True


ABOVE_FLOOR = 1.2
"""Torque error over the noise floor up to which an error counts as noise [1]."""


@dataclass(frozen=True)
class Prediction:
    """Measured torque of a recording and the predictions of two models, below the band.

    Attributes:
        source: Name of the recording.
        time: Times of the rows. Shape (N,) [s].
        measured: Measured torque. Shape (N, n) [N m].
        nominal: Torque predicted with the nominal parameters. Shape (N, n) [N m].
        fitted: Torque predicted with the identified parameters. Shape (N, n) [N m].
        noise_floor: Standard deviation of the torque noise below the band per joint; None if the
            recording does not repeat. Shape (n,) [N m].
        starts: Row at which each segment begins.
        moving: Rows of each joint that count in its errors: False at a standstill under friction,
            where no parameters predict the torque. Shape (N, n).
    """

    source: str
    time: FloatArray
    measured: FloatArray
    nominal: FloatArray
    fitted: FloatArray
    noise_floor: FloatArray | None
    starts: tuple[int, ...]
    moving: BoolArray

    def size(self) -> FloatArray:
        """Return the RMS of the measured torque per joint. Shape (n,) [N m]."""
        return self._rms(self.measured)

    def error(self, which: str = "fitted") -> FloatArray:
        """Return the RMS torque error of the model `which` per joint. Shape (n,) [N m]."""
        return self._rms(self.measured - getattr(self, which))

    def _rms(self, values: FloatArray) -> FloatArray:
        """RMS of each joint over the rows that count. Shapes (N, n) -> (n,)."""
        return np.sqrt(np.mean(values**2, axis=0, where=self.moving))

    def error_over_noise_floor(self) -> FloatArray | None:
        """Return the error of the identified model over the noise floor.

        ∞ where the noise floor is 0; None if it is not known. Shape (n,).
        """
        if self.noise_floor is None:
            return None
        return np.divide(
            self.error(),
            self.noise_floor,
            out=np.full_like(self.noise_floor, np.inf),
            where=self.noise_floor > 0.0,
        )

    def limiting_joint(self) -> tuple[int, bool]:
        """Return the joint whose error matters most, and whether it exceeds its noise floor.

        That is the joint with the largest error beyond its noise floor over the RMS torque; where
        every error is at its floor, the joint whose error the identification reduced most.
        """
        error, floor = self.error(), self.noise_floor
        beyond = error if floor is None else np.sqrt(np.maximum(error**2 - floor**2, 0.0))
        size = np.maximum(self.size(), 1e-300)
        above = np.ones(len(error), bool) if floor is None else error > ABOVE_FLOOR * floor
        if above.any():
            return int(np.argmax(np.where(above, beyond / size, -1.0))), floor is not None
        return int(np.argmax(self.error("nominal") - error)), False

    def worsened(self) -> BoolArray:
        """Return True for joints that the nominal model predicts better. Shape (n,)."""
        error, floor = self.error(), self.noise_floor
        is_noise = False if floor is None else error <= ABOVE_FLOOR * floor
        return (error > self.error("nominal")) & ~np.asarray(is_noise)

    def relative(self, which: str = "fitted") -> FloatArray:
        """Return the error over the RMS of the measured torque; ∞ where that is 0. Shape (n,)."""
        size = self.size()
        return np.divide(self.error(which), size, out=np.full_like(size, np.inf), where=size > 0.0)


@dataclass(frozen=True)
class Identification:
    """Result of an identification.

    Attributes:
        model: The model, with estimated friction widths.
        options: The options.
        spectra: Spectra of torque, and the cutoff frequency.
        equations: The regression equations.
        data: Base parameters estimated from the data alone.
        posterior: Physically consistent estimate with the prior.
        reduced: Physically consistent estimate that takes the identified directions from the data
            and all others from the nominal robot.
        prior: ψ₀, the distance and γ.
        analysis: Identifiability of the directions in the metric of `metric` and `metric_base`.
        metric: Standard parameters with the scales of that metric.
        metric_base: Base parameters in that metric.
        delay: Delay of the torque signals.
        noise_floor: Standard deviation of torque noise below the band by repeated periods; None
            without. Shape (n,) [N m].
        fits: Predictions of the recordings that the model was fitted to.
        validations: Predictions of the validation recordings.
        gamma_trials: Pairs of γ and validation error, if γ was chosen by validation.
        endogeneity: Result of the Hausman test.
        simulation: The simulation error.
    """

    model: IdentificationModel
    options: IdentificationOptions
    spectra: TorqueSpectra
    equations: TorqueEquations
    data: Estimate
    posterior: ConsistentEstimate
    reduced: ConsistentEstimate
    prior: Prior
    analysis: Identifiability
    metric: Parameters
    metric_base: Base
    delay: TorqueDelay
    noise_floor: FloatArray | None
    fits: tuple[Prediction, ...]
    validations: tuple[Prediction, ...]
    gamma_trials: tuple[tuple[float, float], ...] = ()
    endogeneity: HausmanTest | None = None
    simulation: SimulationError | None = None

    @property
    def psi(self) -> FloatArray:
        """Identified standard parameters ψ̂. Shape (P,)."""
        return self.posterior.psi

    @property
    def gamma(self) -> tuple[float, float]:
        """γ of the inertial parameters and the mean γ of the joint parameters."""
        weights = self.prior.joint_weights
        return self.prior.inertial_weight, float(np.mean(weights)) if len(weights) else 0.0

    def worsened_joints(self) -> list[str]:
        """Return the joints whose held-out torque the nominal robot predicts better."""
        worse = [prediction.worsened() for prediction in self.validations]
        return [
            joint
            for joint, *is_worse in zip(self.model.robot.joints, *worse, strict=True)
            if any(is_worse)
        ]

    def data_shares(self) -> FloatArray:
        """Compute the share of each direction's value that the data determine.

        It is λ/(λ + information of the prior), the latter being 2γ if all γ are equal. Shape (p,).
        """
        base = self.model.base
        values, vectors = identifiability.eigenvalues_and_directions(
            self.data.information_root @ base.matrix, self.metric_base
        )
        directions = base.matrix @ self.metric_base.geometric @ vectors
        information = consistency.base_prior_information(self.model.parameters, base, self.prior)
        prior = np.einsum("ik,ij,jk->k", directions, information, directions)
        return np.asarray(values / np.maximum(values + prior, 1e-300))


@dataclass(frozen=True)
class _DataFit:
    """Equations of the recordings, and the base parameters by the data alone."""

    model: IdentificationModel
    segments: list[RecordingSegment]
    equations: TorqueEquations
    estimate: Estimate
    delay: TorqueDelay


def identify(
    robot: Robot,
    parameters: Parameters,
    base: Base,
    recordings: Sequence[Recording],
    validate: Sequence[Recording] = (),
    options: IdentificationOptions | None = None,
    progress: Progress = lambda _: None,
) -> Identification:
    """Identify parameters from recordings.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        base: Its base parameters.
        recordings: Recordings that the model is fitted to.
        validate: Recordings that the model is validated on.
        options: Options.
        progress: Called with a line of text at each step.

    Raises:
        UnusableInput: A recording has no torque, is too short for the band, or its torque has the
            wrong sign.
    """
    options = options or IdentificationOptions()
    model = IdentificationModel(robot, parameters, base, np.full(robot.n, COULOMB_WIDTH))
    parts = segments.usable_segments(recordings)
    spectra = segments.torque_spectra(
        parts, options.band, functools.partial(position_bandwidth.position_bandwidth, robot=robot)
    )
    progress(
        f"{sum(len(r) for r in recordings)} rows, band {spectra.hertz:.3g} Hz: "
        "building the regression equations"
    )
    fit = _fit_data(model, parts, spectra.hertz, options)
    progress(
        f"{len(fit.equations)} × {robot.n} equations, {base.count} base parameters: "
        "computing the physically consistent estimate"
    )
    data, equations = fit.estimate, fit.equations
    if options.dissipation:
        dissipation.require_dissipation(recordings, fit.model, equations, data)
    prior, gamma_trials = _choose_prior(parameters, base, equations, data, options)
    posterior = _consistent_estimate(parameters, base, data, prior, options)
    endogeneity = None
    if options.method is Method.IV or options.hausman:
        progress("computing instruments by simulating the robot along the reference")
        instrumental, endogeneity = _instrumental_estimate(fit, recordings, posterior.psi)
        if options.method is Method.IV:
            data = instrumental
            prior, gamma_trials = _choose_prior(parameters, base, equations, data, options)
            posterior = _consistent_estimate(parameters, base, data, prior, options)
    simulation = None
    if options.simulate or options.refine:
        progress("simulating the identified robot")
        posterior, simulation = _simulate(fit, data, posterior, prior, options, spectra.hertz)
    metric, metric_base, analysis = _analysed(
        fit.model, data, posterior, options.threshold, sum(len(r) for r in recordings)
    )
    predict = functools.partial(
        _predict,
        fit.model,
        hertz=equations.hertz,
        psi=posterior.psi,
        nominal=prior.nominal,
        shift=fit.delay.significant if options.align else None,
    )
    # equations of a mean period, or of several recordings, are not those of a prediction
    same = equations if not any(equations.periods) and len(recordings) == 1 else None
    return Identification(
        model=fit.model,
        options=options,
        spectra=spectra,
        equations=equations,
        data=data,
        posterior=posterior,
        reduced=_reduced_estimate(metric, metric_base, data, prior, options),
        prior=prior,
        analysis=analysis,
        metric=metric,
        metric_base=metric_base,
        delay=fit.delay,
        noise_floor=segments.noise_floor(parts, spectra.hertz),
        fits=tuple(predict(r, equations=same) for r in recordings),
        validations=tuple(predict(r) for r in validate),
        gamma_trials=gamma_trials,
        endogeneity=endogeneity,
        simulation=simulation,
    )


def with_estimate(
    identified: Identification, data: Estimate, posterior: ConsistentEstimate
) -> Identification:
    """Return an identification with another estimate from the same recordings.

    Args:
        identified: The identification.
        data: Base parameters by the data.
        posterior: The physically consistent estimate.
    """
    model, options = identified.model, identified.options
    metric, metric_base, analysis = _analysed(
        model, data, posterior, options.threshold, identified.analysis.samples
    )
    return dataclasses.replace(
        identified,
        data=data,
        posterior=posterior,
        reduced=_reduced_estimate(metric, metric_base, data, identified.prior, options),
        metric=metric,
        metric_base=metric_base,
        analysis=analysis,
    )


def _analysed(
    model: IdentificationModel,
    data: Estimate,
    posterior: ConsistentEstimate,
    threshold: float,
    samples: int | None,
) -> tuple[Parameters, Base, Identifiability]:
    """Parameters and base in the metric of identifiability, and identifiability in that metric."""
    metric, metric_base = _identifiability_metric(model.parameters, model.base, posterior.psi)
    analysis = identifiability.analyse_root(
        metric,
        metric_base,
        data.information_root @ model.base.matrix,
        data.noise,
        model.robot,
        threshold=threshold,
        samples=samples,
    )
    return metric, metric_base, analysis


def _fit_data(
    model: IdentificationModel,
    parts: list[RecordingSegment],
    hertz: float,
    options: IdentificationOptions,
) -> _DataFit:
    """Build the equations with estimated friction widths, and estimate θ from the data alone."""
    leading = segments.leading_segments(parts, friction_width.MAX_WIDTH_SAMPLES)
    if options.widths is not None:
        model = dataclasses.replace(model, widths=options.widths)
    equations = regression.build_equations(model, leading, hertz)
    if options.widths is None:
        model = friction_width.fit_widths(model, equations, leading)
    complete = sum(map(len, leading)) == sum(map(len, parts))
    equations = (
        friction_width.apply_widths(model, equations, leading)
        if complete
        else regression.build_equations(model, parts, hertz)
    )
    # instruments are computed with a first estimate by weighted least squares
    method = Method.WLS if options.method is Method.IV else options.method
    data = estimators.estimate(equations, method, nuisance=width_slopes(model, equations))
    for _ in range(WIDTH_STEPS if complete and options.widths is None else 0):
        model = friction_width.refine_widths(model, data)
        equations = friction_width.apply_widths(model, equations, parts)
        data = estimators.estimate(equations, method, nuisance=width_slopes(model, equations))
    delay = torque_delay.estimate_delay(equations, data)
    if options.align:
        parts = [_aligned(segment, delay.significant) for segment in parts]
        equations = regression.build_equations(model, parts, hertz)
        data = estimators.estimate(equations, method, nuisance=width_slopes(model, equations))
    return _DataFit(model, parts, equations, data, delay)


def _consistent_estimate(
    parameters: Parameters,
    base: Base,
    data: Estimate,
    prior: Prior,
    options: IdentificationOptions,
) -> ConsistentEstimate:
    """Physically consistent parameters given the data and the prior."""
    return consistency.maximum_a_posteriori(
        parameters,
        data.information_root @ base.matrix,
        data.information_root @ data.theta,
        prior,
        options.bounds,
    )


def _instrumental_estimate(
    fit: _DataFit, recordings: Sequence[Recording], psi: FloatArray
) -> tuple[Estimate, HausmanTest]:
    """Estimate θ by instruments, and test whether they are needed."""
    built = instruments.build_instruments(fit.model, recordings, fit.equations.hertz, psi)
    nuisance = width_slopes(fit.model, fit.equations)
    nuisance_instruments = width_slopes(fit.model, built.equations)
    Z = (
        built.rows
        if nuisance_instruments is None
        else np.concatenate([built.rows, nuisance_instruments], axis=2)
    )
    estimate = estimators.estimate(fit.equations, Method.IV, instruments=Z, nuisance=nuisance)
    return estimate, durbin_wu_hausman(fit.estimate, estimate, fit.equations, Z, nuisance)


def _simulate(
    fit: _DataFit,
    data: Estimate,
    posterior: ConsistentEstimate,
    prior: Prior,
    options: IdentificationOptions,
    hertz: float,
) -> tuple[ConsistentEstimate, SimulationError | None]:
    """Compute the simulation error, after a refinement if requested; None without a window."""
    groups, share = simulation_error.cut_windows(fit.segments, hertz)
    if options.refine:
        refined = simulation_refinement.refine(
            fit.model, groups, posterior.psi, data, prior, options.bounds
        )
        posterior = dataclasses.replace(posterior, psi=refined.psi)
    if not groups:
        return posterior, None
    return posterior, simulation_error.compute_simulation_error(
        fit.model, posterior.psi, prior.nominal, groups, share
    )


def width_slopes(model: IdentificationModel, equations: TorqueEquations) -> FloatArray | None:
    """Nuisance columns: derivatives of torque by the friction widths. Shape (N, n, n)."""
    joints = list(model.friction_columns().values())
    if not joints:
        return None
    out = np.zeros((len(equations), equations.n, len(joints)))
    out[:, joints, range(len(joints))] = equations.slopes[:, joints]
    return out


def _aligned(segment: RecordingSegment, delay: FloatArray) -> RecordingSegment:
    """The segment with each joint's torque shifted to compensate a delay [s]."""
    t = np.arange(len(segment)) / segment.rate
    length = len(segment) / segment.rate
    columns = [
        np.interp(t + d, t, tau, period=length if segment.periodic else None)
        for d, tau in zip(delay, segment.torque.T, strict=True)
    ]
    return dataclasses.replace(segment, torque=np.column_stack(columns))


def _choose_prior(
    parameters: Parameters,
    base: Base,
    equations: TorqueEquations,
    data: Estimate,
    options: IdentificationOptions,
) -> tuple[Prior, tuple[tuple[float, float], ...]]:
    """Choose ψ₀ and γ: given, by evidence, or by validation; trusted parameters are kept.

    Joint parameters that a trusted prior does not state have the γ that they have without one: the
    data may not determine them.
    """
    nominal = consistency.consistent_nominal(parameters)
    edge, scales = 10 * parameters.bodies, prior_weight.joint_parameter_scales(parameters)
    for place, value in options.trusted.items():
        nominal[place] = value
    start = Prior(nominal, options.distance, 1.0, np.ones(parameters.count - edge), scales)
    inertial, joint = (
        prior_weight.gamma_by_evidence(
            parameters,
            data.information_root @ base.matrix,
            data.information_root @ data.theta,
            start,
        )
        if isinstance(options.gamma, str)
        else (options.gamma[0], options.gamma[1] * start.joint_weights)
    )
    if options.trusted:
        inertial, joint = TRUSTED_GAMMA, joint.copy()
        joint[[place - edge for place in options.trusted if place >= edge]] = TRUSTED_GAMMA
    prior = dataclasses.replace(start, inertial_weight=inertial, joint_weights=joint)
    if options.trusted or options.gamma != "heldout":
        return prior, ()
    folds = _fold_factors(equations, data)

    def squared_error(gamma: float, fold: int) -> float:
        training = np.vstack([factor for k, factor in enumerate(folds) if k != fold])
        trial = dataclasses.replace(prior, inertial_weight=gamma)
        solution = consistency.maximum_a_posteriori(
            parameters, training[:, :-1] @ base.matrix, training[:, -1], trial, options.bounds
        )
        residual = folds[fold][:, :-1] @ (base.matrix @ solution.psi) - folds[fold][:, -1]
        return float(residual @ residual)

    chosen, trials = prior_weight.gamma_by_validation(
        squared_error, inertial, CROSS_VALIDATION_FOLDS
    )
    return dataclasses.replace(prior, inertial_weight=chosen), tuple(trials)


def _fold_factors(equations: TorqueEquations, data: Estimate) -> list[FloatArray]:
    """QR factor [R | R θ̂] of each contiguous fold of the recordings. Shape (≤ p + 1, p + 1)."""
    edges = np.linspace(0, len(equations), CROSS_VALIDATION_FOLDS + 1).astype(int)
    folds = [equations.rows(slice(low, high)) for low, high in itertools.pairwise(edges)]
    return [estimators.triangular_factor(fold, data.noise_root) for fold in folds]


def _identifiability_metric(
    parameters: Parameters, base: Base, psi: FloatArray
) -> tuple[Parameters, Base]:
    """Metric in which identifiability is judged.

    The scale of a joint parameter is its identified value if that is larger than the stated scale,
    which is a guess where the URDF states nothing.
    """
    edge = 10 * parameters.bodies
    scale = parameters.scale.copy()
    index = np.arange(edge, parameters.count)
    scale[index, index] = np.maximum(scale[index, index], np.abs(psi[edge:]))
    metric = dataclasses.replace(parameters, scale=scale)
    return metric, dataclasses.replace(
        base, geometric=scale @ np.linalg.qr((base.matrix @ scale).T)[0]
    )


def _reduced_estimate(
    parameters: Parameters,
    base: Base,
    data: Estimate,
    prior: Prior,
    options: IdentificationOptions,
) -> ConsistentEstimate:
    """Identified directions from the data, others nominal (Lee, Lee & Park 2021, 4.4)."""
    values, vectors = identifiability.eigenvalues_and_directions(
        data.information_root @ base.matrix, base
    )
    identified = is_identifiable(values, options.threshold)
    # coordinates of θ in which the metric is 1 and the information diagonal
    frame = vectors[:, identified].T @ np.linalg.inv(base.matrix @ base.geometric)
    root = np.sqrt(values[identified])[:, None] * frame
    edge = 10 * parameters.bodies
    weak = Prior(
        prior.nominal,
        Distance.PULLBACK,
        REDUCED_GAMMA,
        np.full(len(prior.joint_weights), REDUCED_GAMMA),
        np.diag(parameters.scale)[edge:],
    )
    return consistency.maximum_a_posteriori(
        parameters, root @ base.matrix, root @ data.theta, weak, options.bounds
    )


def _predict(
    model: IdentificationModel,
    recording: Recording,
    *,
    hertz: float,
    psi: FloatArray,
    nominal: FloatArray,
    shift: FloatArray | None,
    equations: TorqueEquations | None = None,
) -> Prediction:
    """Predict the torque at every row of a recording, without averaging periods."""
    if equations is None:
        parts = segments.usable_segments([recording], average=False)
        if shift is not None:
            parts = [_aligned(segment, shift) for segment in parts]
        cutoff = min(hertz, MAX_BAND_SHARE * min(segment.rate for segment in parts))
        equations = regression.build_equations(model, parts, cutoff)
    noise_floor = segments.noise_floor(
        list(segments.extract_segments([recording])), equations.hertz, tapered=True
    )
    fitted, before = (
        equations.predicted(model.base.matrix @ parameters) for parameters in (psi, nominal)
    )
    prediction = Prediction(
        recording.source,
        equations.time,
        equations.torque,
        before,
        fitted,
        noise_floor,
        equations.starts,
        equations.moving,
    )
    if (
        noise_floor is not None
        and (prediction.error() < MIN_ERROR_OVER_NOISE_FLOOR * noise_floor).any()
    ):
        return dataclasses.replace(prediction, noise_floor=None)
    return prediction
