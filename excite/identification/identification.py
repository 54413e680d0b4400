"""Identification: recordings in, physically consistent parameters and how sure they are out."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..designer import identifiability
from ..designer.identifiability import Identifiability
from ..errors import UnusableInput
from ..recordings import Recording
from ..robot.base_parameters import Base
from ..robot.inertial_parameters import COULOMB_WIDTH, Parameters
from ..robot.robot import Robot
from . import (
    consistency,
    estimators,
    friction_width,
    instruments,
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
from .segments import Segment, TorqueSpectra
from .simulation_error import SimulationError
from .torque_delay import TorqueDelay

Array = np.ndarray
Progress = Callable[[str], None]
FOLDS = 5
WIDTH_STEPS = 2
"""Gauss-Newton steps of the friction's widths, from the best of a grid."""
SURE = 1e8
"""γ of what a trusted prior states."""
FREE = 1e-14
"""γ of what the data alone should decide."""


@dataclass(frozen=True)
class IdentificationOptions:
    """method: how rows are weighted. distance: of the prior. gamma: (bodies, drives), or how to choose: "evidence" or
    "heldout". band: [Hz], from the data if None. threshold: largest scale-free variance that counts as identified.
    bounds: further constraints. align: torque is moved by the delay found. trusted: parameter -> value that is right as it stands.
    hausman: test whether instruments are needed. simulate, refine: positions simulated ahead, and the model refined against them.
    """

    method: Method = Method.WLS
    distance: Distance = Distance.BREGMAN
    gamma: str | tuple[float, float] = "evidence"
    band: float | None = None
    threshold: float = identifiability.IDENTIFIABLE_VARIANCE
    bounds: Bounds = field(default_factory=Bounds)
    align: bool = False
    trusted: Mapping[int, float] = field(default_factory=dict)
    hausman: bool = False
    simulate: bool = False
    refine: bool = False


@dataclass(frozen=True)
class Prediction:
    """Torque of a recording against the models' below the band. measured, nominal, fitted: Shape (N, n) [N m]. time: [s].

    floor: standard deviation of its noise below the band per joint, None where not known. Shape (n,).
    """

    source: str
    time: Array
    measured: Array
    nominal: Array
    fitted: Array
    floor: Array | None
    starts: tuple[int, ...]

    def error(self, which: str = "fitted") -> Array:
        """RMS torque error per joint. Shape (n,) [N m]."""
        return np.sqrt(np.mean((self.measured - getattr(self, which)) ** 2, axis=0))

    def in_floors(self) -> Array | None:
        """The error of the fitted model over the noise floor; ∞ where the floor is 0, None where it is not known. Shape (n,)."""
        if self.floor is None:
            return None
        return np.divide(
            self.error(), self.floor, out=np.full_like(self.floor, np.inf), where=self.floor > 0.0
        )

    def relative(self, which: str = "fitted") -> Array:
        """The same over the RMS of the torque; ∞ for a joint whose measured torque is 0 throughout."""
        size = np.sqrt(np.mean(self.measured**2, axis=0))
        return np.divide(self.error(which), size, out=np.full_like(size, np.inf), where=size > 0.0)


@dataclass(frozen=True)
class Identification:
    """What was learnt. psi: ψ̂, physically consistent. reduced: the same with what the data can't say left as it was.

    data: θ̂ by the data alone. posterior: with the prior. analysis: which directions the recordings show, in
    the metric of `metric` and `metric_base`.
    floor: standard deviation of torque noise below the band by repeated periods, None without. tried: (γ, held-out error) pairs.
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
    floor: Array | None
    fits: tuple[Prediction, ...]
    validations: tuple[Prediction, ...]
    tried: tuple[tuple[float, float], ...] = ()
    endogeneity: HausmanTest | None = None
    simulation: SimulationError | None = None

    @property
    def psi(self) -> Array:
        return self.posterior.psi

    @property
    def gamma(self) -> tuple[float, float]:
        """γ of bodies and, on average, of drives."""
        return self.prior.bodies, float(np.mean(self.prior.drives)) if len(
            self.prior.drives
        ) else 0.0

    def decided(self) -> Array:
        """Share of each direction's value that the data decided: λ/(λ + 2γ), or with several γ what the prior says of θ. Shape (p,)."""
        base = self.model.base
        values, vectors = identifiability.eigenvalues_and_directions(self.data.root @ base.matrix, self.metric_base)
        ways = base.matrix @ self.metric_base.geometric @ vectors
        known = consistency.prior_information(self.model.parameters, self.prior)
        spread = base.matrix @ consistency.symmetric_pseudo_inverse(known) @ base.matrix.T
        prior = np.einsum("ik,ij,jk->k", ways, consistency.symmetric_pseudo_inverse(spread), ways)
        return np.asarray(values / np.maximum(values + prior, 1e-300))


@dataclass(frozen=True)
class _Data:
    """The recordings as equations, and the parameters by the data alone."""

    model: IdentificationModel
    parts: list[Segment]
    rows: TorqueEquations
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
    """Parameters from recordings. Raises UnusableInput where a recording has no torque or is too short for the band."""
    options = options or IdentificationOptions()
    model = IdentificationModel(robot, parameters, base, np.full(robot.n, COULOMB_WIDTH))
    parts = list(segments.extract_segments(recordings))
    if not parts:
        raise UnusableInput(
            f"{recordings[0].source}: has no stretch without a gap that is long enough; record again"
        )
    spectra = segments.torque_spectra(parts, options.band)
    progress(
        f"{sum(len(r) for r in recordings)} rows; band {spectra.hertz:.3g} Hz; building the equations"
    )
    own = _data(model, parts, spectra.hertz, options)
    progress(
        f"{len(own.rows)} × {robot.n} equations in {base.count} base parameters; physically consistent ones"
    )
    data, rows = own.estimate, own.rows
    prior, tried = _prior(parameters, base, rows, data, options)
    posterior = _posterior(parameters, base, data, prior, options)
    endogeneity = None
    if options.method is Method.IV or options.hausman:
        progress("instruments from a simulated robot that follows the reference")
        instrumented, endogeneity = _instrumented(own, recordings, posterior.psi)
        if options.method is Method.IV:
            data = instrumented
            prior, tried = _prior(parameters, base, rows, data, options)
            posterior = _posterior(parameters, base, data, prior, options)
    simulation = None
    if options.simulate or options.refine:
        progress("simulating ahead")
        posterior, simulation = _simulated(own, data, posterior, prior, options, spectra.hertz)
    scaled, sized = _sized(parameters, base, posterior.psi)
    analysis = identifiability.analyse_root(
        scaled,
        sized,
        data.root @ base.matrix,
        data.noise,
        robot,
        threshold=options.threshold,
        samples=sum(len(r) for r in recordings),
    )
    predict = _predictor(own, posterior.psi, prior.nominal, options)
    same = (
        rows if not any(rows.periods) and len(recordings) == 1 else None
    )  # rows of single periods are not at hand
    return Identification(
        model=own.model,
        options=options,
        spectra=spectra,
        equations=rows,
        data=data,
        posterior=posterior,
        reduced=_reduced(scaled, sized, data, prior, options),
        prior=prior,
        analysis=analysis,
        metric=scaled,
        metric_base=sized,
        delay=own.delay,
        floor=segments.noise_floor(parts, spectra.hertz),
        fits=tuple(predict(r, rows=same) for r in recordings),
        validations=tuple(predict(r) for r in validate),
        tried=tried,
        endogeneity=endogeneity,
        simulation=simulation,
    )


def _data(model: IdentificationModel, parts: list[Segment], hertz: float, options: IdentificationOptions) -> _Data:
    """Equations with friction as wide as the data has it, and θ̂ by the data alone."""
    few = segments.leading_segments(parts, friction_width.MAX_WIDTH_SAMPLES)
    rows = regression.build_equations(model, few, hertz)
    model = friction_width.fit_widths(model, rows, few)
    enough = sum(map(len, few)) == sum(map(len, parts))
    rows = (
        friction_width.apply_widths(model, rows, few)
        if enough
        else regression.build_equations(model, parts, hertz)
    )
    method = (
        Method.WLS if options.method is Method.IV else options.method
    )  # instruments need a model first
    data = estimators.estimate(rows, method, nuisance=_nuisance(model, rows))
    for _ in range(WIDTH_STEPS if enough else 0):
        model = friction_width.refine_widths(model, data)
        rows = friction_width.apply_widths(model, rows, parts)
        data = estimators.estimate(rows, method, nuisance=_nuisance(model, rows))
    late = torque_delay.estimate_delay(rows, data)
    if options.align:
        parts = [_moved(piece, late.seconds) for piece in parts]
        rows = regression.build_equations(model, parts, hertz)
        data = estimators.estimate(rows, method, nuisance=_nuisance(model, rows))
    return _Data(model, parts, rows, data, late)


def _predictor(
    own: _Data, psi: Array, nominal: Array, options: IdentificationOptions
) -> Callable[..., Prediction]:
    shift = own.delay.seconds if options.align else None
    return functools.partial(
        _predicted, own.model, hertz=own.rows.hertz, psi=psi, nominal=nominal, shift=shift
    )


def _posterior(
    parameters: Parameters, base: Base, data: Estimate, prior: Prior, options: IdentificationOptions
) -> ConsistentEstimate:
    return consistency.maximum_a_posteriori(
        parameters, data.root @ base.matrix, data.root @ data.theta, prior, options.bounds
    )


def _instrumented(
    own: _Data, recordings: Sequence[Recording], psi: Array
) -> tuple[Estimate, HausmanTest]:
    """θ̂ by instruments, and the test whether they are needed. Raises UnusableInput where a recording has no reference motion."""
    found = instruments.build_instruments(own.model, recordings, own.rows.hertz, psi)
    nuisance, its = _nuisance(own.model, own.rows), _nuisance(own.model, found.equations)
    rows = found.rows if its is None else np.concatenate([found.rows, its], axis=2)
    estimate = estimators.estimate(own.rows, Method.IV, instruments=rows, nuisance=nuisance)
    return estimate, durbin_wu_hausman(own.estimate, estimate, own.rows, rows, nuisance)


def _simulated(
    own: _Data, data: Estimate, posterior: ConsistentEstimate, prior: Prior, options: IdentificationOptions, hertz: float
) -> tuple[ConsistentEstimate, SimulationError | None]:
    """Positions simulated ahead by the model, refined against them if asked; nothing where no window is long enough."""
    groups, share = simulation_error.cut_windows(own.parts, hertz)
    if options.refine:
        refined = simulation_refinement.refine(
            own.model, groups, posterior.psi, data, prior, options.bounds
        )
        posterior = dataclasses.replace(posterior, psi=refined.psi)
    return posterior, simulation_error.compute_simulation_error(
        own.model, posterior.psi, prior.nominal, groups, share
    ) if groups else None


def _nuisance(model: IdentificationModel, rows: TorqueEquations) -> Array | None:
    """What errors of the friction's widths do to torque. Shape (N, n, n)."""
    joints = list(model.friction_columns().values())
    if not joints:
        return None
    out = np.zeros((len(rows), rows.n, len(joints)))
    out[:, joints, range(len(joints))] = rows.slopes[:, joints]
    return out


def _moved(piece: Segment, seconds: Array) -> Segment:
    """The piece with each joint's torque taken that much later."""
    t = np.arange(len(piece)) / piece.rate
    length = len(piece) / piece.rate
    columns = [
        np.interp(t + d, t, tau, period=length if piece.periodic else None)
        for d, tau in zip(seconds, piece.torque.T, strict=True)
    ]
    return dataclasses.replace(piece, torque=np.column_stack(columns))


def _prior(
    parameters: Parameters, base: Base, rows: TorqueEquations, data: Estimate, options: IdentificationOptions
) -> tuple[Prior, tuple[tuple[float, float], ...]]:
    """ψ₀ and γ: as given, by evidence, or by what predicts left-out blocks; what is trusted is held fast."""
    nominal = consistency.consistent_nominal(parameters)
    edge, scales = 10 * parameters.bodies, prior_weight.joint_parameter_scales(parameters)
    for place, value in options.trusted.items():
        nominal[place] = value
    if options.trusted:
        drives = np.full(parameters.count - edge, FREE)
        drives[[place - edge for place in options.trusted if place >= edge]] = SURE
        return Prior(nominal, options.distance, SURE, drives, scales), ()
    start = Prior(nominal, options.distance, 1.0, np.ones(parameters.count - edge), scales)
    if not isinstance(options.gamma, str):
        return dataclasses.replace(
            start, bodies=options.gamma[0], drives=options.gamma[1] * start.drives
        ), ()
    bodies, drives = prior_weight.gamma_by_evidence(
        parameters, data.root @ base.matrix, data.root @ data.theta, start
    )
    prior = dataclasses.replace(start, bodies=bodies, drives=drives)
    if options.gamma == "evidence":
        return prior, ()
    folds = _folds(rows, data)

    def fit(gamma: float, fold: int) -> float:
        own = np.vstack([part for k, part in enumerate(folds) if k != fold])
        trial = dataclasses.replace(prior, bodies=gamma)
        found = consistency.maximum_a_posteriori(
            parameters, own[:, :-1] @ base.matrix, own[:, -1], trial, options.bounds
        )
        left = folds[fold][:, :-1] @ (base.matrix @ found.psi) - folds[fold][:, -1]
        return float(left @ left)

    chosen, tried = prior_weight.gamma_by_validation(fit, bodies, FOLDS)
    return dataclasses.replace(prior, bodies=chosen), tuple(tried)


def _folds(rows: TorqueEquations, data: Estimate) -> list[Array]:
    """R and R θ̂ of each of FOLDS contiguous parts of the recordings: [R | z]. Shape (≤ p + 1, p + 1)."""
    edges = np.linspace(0, len(rows), FOLDS + 1).astype(int)
    parts = [rows.rows(slice(low, high)) for low, high in itertools.pairwise(edges)]
    return [estimators.triangular_factor(part, data.scale) for part in parts]


def _sized(parameters: Parameters, base: Base, psi: Array) -> tuple[Parameters, Base]:
    """The metric in which practical identifiability is judged: a drive's scale is its identified value where that is larger than the
    stated one, which is a guess where the URDF says nothing."""
    edge = 10 * parameters.bodies
    scale = parameters.scale.copy()
    index = np.arange(edge, parameters.count)
    scale[index, index] = np.maximum(scale[index, index], np.abs(psi[edge:]))
    sized = dataclasses.replace(parameters, scale=scale)
    return sized, dataclasses.replace(
        base, geometric=scale @ np.linalg.qr((base.matrix @ scale).T)[0]
    )


def _reduced(
    parameters: Parameters, base: Base, data: Estimate, prior: Prior, options: IdentificationOptions
) -> ConsistentEstimate:
    """The estimate that takes identified directions from the data and all others from the nominal robot (Lee, Lee & Park 2021, 4.4)."""
    values, vectors = identifiability.eigenvalues_and_directions(data.root @ base.matrix, base)
    seen = values * options.threshold >= 1.0
    # coordinates of θ in which the metric is 1 and the information diagonal
    frame = vectors[:, seen].T @ np.linalg.inv(base.matrix @ base.geometric)
    root = np.sqrt(values[seen])[:, None] * frame
    edge = 10 * parameters.bodies
    same = np.full(len(prior.drives), 1e-3)
    weak = Prior(prior.nominal, Distance.PULLBACK, 1e-3, same, np.diag(parameters.scale)[edge:])
    return consistency.maximum_a_posteriori(
        parameters, root @ base.matrix, root @ data.theta, weak, options.bounds
    )


def _predicted(
    model: IdentificationModel,
    recording: Recording,
    *,
    hertz: float,
    psi: Array,
    nominal: Array,
    shift: Array | None,
    rows: TorqueEquations | None = None,
) -> Prediction:
    """Measured and predicted torque of every row, not of mean periods; the noise floor where periods repeat."""
    if rows is None:
        parts = list(segments.extract_segments([recording], average=False))
        if shift is not None:
            parts = [_moved(piece, shift) for piece in parts]
        rows = regression.build_equations(model, parts, min(hertz, 0.45 * min(piece.rate for piece in parts)))
    floor = segments.noise_floor(list(segments.extract_segments([recording])), hertz, tapered=True)
    fitted, before = (rows.predicted(model.base.matrix @ one) for one in (psi, nominal))
    return Prediction(recording.source, rows.time, rows.torque, before, fitted, floor, rows.starts)
