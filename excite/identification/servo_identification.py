"""Identification of a robot with position servos from commanded and measured positions alone.

No torque is recorded. Links, joint parameters and position loops are estimated by output error: the
closed loop is simulated in windows that start from the recorded state, and the parameters minimise

    ½ Σ ‖q(ψ, loop) − q_recorded‖²_Λ + γ d(ψ, ψ₀)² + prior of the loops

(review, eq. 6 and 21). Each Gauss-Newton step linearises the simulation with exact sensitivities,
eliminates the loops by a QR factorisation and solves for physically consistent ψ
(`consistency.maximum_a_posteriori`).

Identifiability: the closed loop stays the same if K_p, K_d and all parameters of links and joints
are multiplied by one factor. Without stated gains the data therefore determine ratios to K_p alone;
the factor is that of the prior, the masses of the robot's description.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from .._types import FloatArray, IntArray
from ..errors import UnusableInput
from ..recordings import Recording
from ..robot.base_parameters import Base
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from ..robot.samples import Samples
from . import consistency, prior_weight
from .consistency import Bounds, ConsistentEstimate, Prior
from .forward_dynamics import build_dynamics
from .inertia_distance import Distance
from .regression import IdentificationModel
from .servo_simulation import (
    LOOP_PARAMETERS,
    ServoCommand,
    ServoLoop,
    ServoWindows,
    simulate_servo,
)

WINDOW_LENGTH = 1.0
"""Length of a window [s]: long enough for a joint held by friction to be moved by its servo."""
MAX_SIMULATED_TIME = 120.0
"""Length of all windows together, at most [s]; they are spread evenly over the recordings."""
POSITION_RATE = 100.0
"""Largest rate at which positions are compared [Hz]."""
SERVO_COULOMB_WIDTH = 5e-3
"""Width w of Coulomb friction [rad/s or m/s]. A joint that friction holds creeps at less than w."""
MAX_ROUNDS = 3
"""Number of times that weights of the position errors and of the prior are estimated."""
MAX_STEPS = 8
"""Number of Gauss-Newton steps in a round, at most."""
COST_TOLERANCE = 2e-3
"""Relative decrease of the cost below which a round has converged."""
MAX_HALVINGS = 6
"""Number of step lengths tried per step, each half of the one before."""
LOG_GAIN_SPREAD = 0.5
"""Standard deviation of log K_p among the joints [1]: servos of one robot are similar."""
DERIVATIVE_TIME = 0.03
"""Standard deviation of K_d/K_p [s]: a few cycles of a hobby servo's controller."""
USUAL_DELAY = 0.03
"""Standard deviation of the delay [s]: the latency of a serial bus and of the servo's own cycle."""
MAX_DELAY = 0.2
"""Largest delay [s]."""
SCALE_SPREAD = 0.01
"""Standard deviation of the factor between identified and nominal torque of the links where no gain
is stated [1]: it fixes what the data do not show."""
MIN_INERTIAL_WEIGHT = 5.0
"""Smallest γ of the inertial parameters [1], that of descriptions that are 30 % off, 1/(2 · 0.3²):
stiction and backlash of hobby servos are no noise, and the evidence overrates the data."""
STUDENT_FREEDOM = 3.0
"""Degrees of freedom of Student's distribution of the errors of a window [1]: few, as contacts of a
hobby arm last for seconds."""
SCALE_ITERATIONS = 50
"""Fixed-point iterations of the scale of that distribution."""
SCALE_ROWS = 500
"""Rows along which these torques are compared, at most."""
GRAVITY_SHARE = 0.05
"""Share of the position error that the nominal torque has to explain for it to give the gain's
first value [1]."""
NATURAL_FREQUENCY = 20.0
"""Natural frequency of a position loop whose gain nothing else suggests [rad/s]."""
ROTOR_SCALE_SHARE = 0.1
"""First value of an unknown rotor inertia over its scale [1]."""
START_CUTOFF = 5.0
"""Cutoff of the motion for the equation error [Hz]."""
START_WIDTH_FACTOR = 10.0
"""Width of Coulomb friction in the equation error over that of the simulation [1]: the speed of an
encoder of 12 bits has a noise of some hundredths of a rad/s."""
START_WINDOW_ROWS = 20
"""Rows of a window of the equation error, a second at 4 START_CUTOFF."""
START_ROUNDS = 2
"""Rounds of the equation error."""
MOTION_KEYS = ("q", "dq", "ddq")
"""Fields of `Samples`."""


@dataclass(frozen=True)
class ServoOptions:
    """Options of `identify_servo`.

    Attributes:
        gains: K_p and K_d of each joint, stated, for recordings without `position_gain`. Shape
            (2, n) [N m/rad, N m s/rad]; None: they are estimated.
        gamma: γ of inertial and joint parameters; None: by the evidence.
        distance: Distance of link inertias from nominal.
        bounds: Bounds of masses and centres of mass.
        window: Length of a window [s].
    """

    gains: FloatArray | None = None
    gamma: tuple[float, float] | None = None
    distance: Distance = Distance.BREGMAN
    bounds: Bounds = field(default_factory=Bounds)
    window: float = WINDOW_LENGTH


@dataclass(frozen=True)
class PositionReplay:
    """Simulation of a complete recording from its first state under its commands.

    Attributes:
        source: Name of the recording.
        time: Times of the compared positions. Shape (S,) [s].
        measured: Recorded positions. Shape (S, n) [rad or m].
        command: Commanded positions. Shape (S, n) [rad or m].
        fitted: Positions of the identified robot. Shape (S, n) [rad or m].
    """

    source: str
    time: FloatArray
    measured: FloatArray
    command: FloatArray
    fitted: FloatArray

    def error(self, which: str = "fitted") -> FloatArray:
        """Return the RMS of `fitted` or `command` minus the recorded positions. Shape (n,)."""
        return np.sqrt(np.mean((getattr(self, which) - self.measured) ** 2, axis=0))


@dataclass(frozen=True)
class ServoIdentification:
    """Result of an identification without torque.

    Attributes:
        model: The model.
        options: The options.
        loop: Position loops.
        loop_deviation: Standard deviations of K_p, K_d and delay, 0 where stated. Shape (3, n).
        ratio_deviation: Standard deviations of the joint parameters over K_p, by their covariance
            with K_p. Shape (kinds, n).
        reference_gain: `position_gain` to which K_p belongs. Shape (n,).
        error_limit: Position error at which the motors saturate at that gain, ∞ if never. Shape
            (n,) [rad or m].
        posterior: Physically consistent estimate.
        prior: ψ₀, the distance and γ.
        fits: Replays of the recordings that the model was fitted to.
        validations: Replays of the validation recordings.
        costs: Cost at the start and after every step of the last round.
    """

    model: IdentificationModel
    options: ServoOptions
    loop: ServoLoop
    loop_deviation: FloatArray
    ratio_deviation: FloatArray
    reference_gain: FloatArray
    error_limit: FloatArray
    posterior: ConsistentEstimate
    prior: Prior
    fits: tuple[PositionReplay, ...]
    validations: tuple[PositionReplay, ...]
    costs: tuple[float, ...]

    @property
    def psi(self) -> FloatArray:
        """Identified standard parameters ψ̂. Shape (P,)."""
        return self.posterior.psi

    @property
    def is_ratio(self) -> bool:
        """True if the data determine ratios to the gains alone."""
        return self.options.gains is None

    @property
    def scale_statement(self) -> str:
        """Statement of what fixes the scale of all torques."""
        if not self.is_ratio:
            return "the stated gains of the position loops fix the scale of all torques"
        return (
            "without torque only ratios to the servo gain are identifiable: inertia/K_p, "
            "friction/K_p, K_d/K_p; the common factor is that of the masses in the robot's "
            "description (state the gain with --gains KP,KD to replace it)"
        )


def identify_servo(
    robot: Robot,
    parameters: Parameters,
    base: Base,
    recordings: Sequence[Recording],
    validate: Sequence[Recording] = (),
    options: ServoOptions | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> ServoIdentification:
    """Identify parameters and position loops from commanded and measured positions.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        base: Its base parameters.
        recordings: Recordings that the model is fitted to.
        validate: Recordings that the model is validated on.
        options: Options.
        progress: Called with a line of text at each step.

    Raises:
        UnusableInput: A recording has no commanded positions or is too short.
    """
    options = options or ServoOptions()
    model = IdentificationModel(robot, parameters, base, np.full(robot.n, SERVO_COULOMB_WIDTH))
    reference = stated_gains(recordings[0])
    groups = cut_servo_windows(recordings, reference, options.window)
    iterate = _first_iterate(model, recordings, options)
    prior = _first_prior(model, recordings, iterate.loop, options)
    start = _EquationErrors.of_recordings(model, recordings, reference)
    scale = np.zeros((0, parameters.count))
    if options.gains is None:
        scale = _scale_row(model, start.motion, prior.nominal)
    first = _ServoProblem(model, start, prior, options, scale)
    iterate, problem, _ = _estimate(first, iterate, START_ROUNDS)
    progress(
        f"{sum(map(len, groups))} windows, {sum(group.seconds for group in groups):.0f} s: "
        f"simulating the closed loop for {base.count} base parameters and the position loops"
    )
    simulated = dataclasses.replace(problem, predicted=_SimulatedErrors(model, groups))
    iterate, problem, costs = _estimate(simulated, iterate, MAX_ROUNDS, progress)
    posterior, deviation, ratio_deviation = problem.posterior(iterate)
    replays = _replay(model, [*recordings, *validate], reference, iterate)
    return ServoIdentification(
        model=model,
        options=options,
        loop=iterate.loop,
        loop_deviation=deviation,
        ratio_deviation=ratio_deviation,
        reference_gain=reference,
        error_limit=np.min([(g.error_limit * g.gain).min(axis=0) for g in groups], axis=0),
        posterior=posterior,
        prior=problem.prior,
        fits=tuple(replays[: len(recordings)]),
        validations=tuple(replays[len(recordings) :]),
        costs=tuple(costs),
    )


def stated_gains(recording: Recording) -> FloatArray:
    """Return the `position_gain` of each joint of a recording, 1 where none is stated."""
    gains = recording.sidecar.position_gain
    return np.array([gains.get(joint, 1.0) for joint in recording.joints])


def cut_servo_windows(
    recordings: Sequence[Recording],
    reference: FloatArray,
    length: float,
    most: float = MAX_SIMULATED_TIME,
) -> list[ServoWindows]:
    """Cut windows that start from the recorded state.

    Args:
        recordings: Recordings with commanded positions.
        reference: `position_gain` to which K_p belongs. Shape (n,).
        length: Length of a window [s].
        most: Length of all windows together, at most [s].

    Returns:
        The windows, one set per rate.

    Raises:
        UnusableInput: A recording has no commanded positions, or none is long enough.
    """
    stretches = [part for recording in recordings for part in _commanded_segments(recording)]
    places = [
        (k, row)
        for k, part in enumerate(stretches)
        for size, every in [_window_size(part, length)]
        for row in range(0, len(part) - size * every, size * every)
    ]
    if not places:
        raise UnusableInput(
            f"{recordings[0].source}: has no gap-free stretch that is long enough; record again"
        )
    count = int(min(len(places), most / length + 1))
    chosen = [places[i] for i in np.unique(np.linspace(0, len(places) - 1, count).astype(int))]
    groups: dict[tuple[int, float], list[ServoWindows]] = {}
    for k, part in enumerate(stretches):
        if begins := [row for at, row in chosen if at == k]:
            size, every = _window_size(part, length)
            windows = _windows(part, begins, size, every, reference)
            groups.setdefault((size, round(windows.step, 9)), []).append(windows)
    return [_joined(group) for group in groups.values()]


def _joined(parts: Sequence[ServoWindows]) -> ServoWindows:
    """Windows of several stretches that have the same length and rate."""
    states, q, begins, gain, limit = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("states", "q", "begins", "gain", "error_limit")
    )
    commands = tuple(command for part in parts for command in part.commands)
    return ServoWindows(states, q, begins, commands, parts[0].step, gain, limit)


def _commanded_segments(recording: Recording) -> list[Recording]:
    """Gap-free stretches of a recording.

    Raises:
        UnusableInput: A joint has no commanded positions.
    """
    missing = [j for j in recording.joints if not recording.has("qref", j)]
    if missing:
        raise UnusableInput(
            f"{recording.source}: joint '{missing[0]}' has neither torque nor qref; record "
            f"tau.{missing[0]}, or the commanded position as qref.{missing[0]}"
        )
    return [
        part
        for part in recording.segments()
        if part.qref is not None and np.isfinite(part.qref).all()
    ]


def _window_size(part: Recording, length: float) -> tuple[int, int]:
    """Number of positions in a window besides the first, and rows from one to the next."""
    every = max(1, int(part.rate / POSITION_RATE + 1e-9))
    return max(1, round(length / (part.step * every))), every


def _windows(
    part: Recording, begins: Sequence[int], size: int, every: int, reference: FloatArray
) -> ServoWindows:
    """Windows of a gap-free stretch; the last may reach beyond its end, where nothing moves."""
    assert part.qref is not None  # checked by _commanded_segments
    motion, start = part.samples(), np.asarray(begins, int)
    index = np.minimum(start[:, None] + every * np.arange(size + 1), len(part) - 1)
    limits = part.sidecar.error_limit
    limit = np.array([limits.get(joint, np.inf) for joint in part.joints])
    return ServoWindows(
        np.concatenate([motion.q[start], motion.dq[start]], axis=1),
        part.q[index],
        part.t[start],
        (ServoCommand(part.t, part.qref),) * len(start),
        part.step * every,
        np.tile(stated_gains(part) / reference, (len(start), 1)),
        np.tile(limit, (len(start), 1)),
    )


@dataclass(frozen=True)
class _Iterate:
    """Parameters and position loops."""

    psi: FloatArray
    loop: ServoLoop


def _joint_scales(
    model: IdentificationModel, recordings: Sequence[Recording], loop: ServoLoop
) -> FloatArray:
    """Scales of the joint parameters in the prior: each alone could explain the servo's torque.

    The torque limits that a description of a hobby robot states are often placeholders, and its
    friction is a larger share of them than that of an industrial robot; the torque K_p e, the speed
    and the acceleration of the recordings are known. Shape (P − 10 bodies,).
    """
    reference = stated_gains(recordings[0])
    sums, count = np.zeros((3, model.robot.n)), 0
    for recording in recordings:
        for part in _commanded_segments(recording):
            motion = part.samples(START_CUTOFF)
            assert part.qref is not None  # checked by _commanded_segments
            error = (part.qref - part.q) * stated_gains(part) / reference
            for row, column in enumerate((loop.proportional * error, motion.dq, motion.ddq)):
                sums[row] += np.sum(column**2, axis=0)
            count += len(part)
    torque, speed, acceleration = np.maximum(np.sqrt(sums / count), 1e-9)
    scales = {
        "rotor_inertia": torque / acceleration,
        "viscous": torque / speed,
        "coulomb": torque,
        "offset": torque,
    }
    return np.concatenate([scales[kind] for kind in model.parameters.drive] or [np.zeros(0)])


def _first_prior(
    model: IdentificationModel,
    recordings: Sequence[Recording],
    loop: ServoLoop,
    options: ServoOptions,
) -> Prior:
    """The prior with the stated γ, else with γ = 1 until the evidence changes it."""
    inertial, joint = options.gamma or (1.0, 1.0)
    scales = _joint_scales(model, recordings, loop)
    return Prior(
        consistency.consistent_nominal(model.parameters),
        options.distance,
        inertial,
        np.full(len(scales), joint),
        scales,
    )


def _student_scale(power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Scale of mean square errors and the weight of each window. Shapes (W, n) -> (n,), (W, n)."""
    scale, share = power.mean(axis=0), np.ones_like(power)
    for _ in range(SCALE_ITERATIONS):
        share = (STUDENT_FREEDOM + 1.0) / (STUDENT_FREEDOM + power / np.maximum(scale, 1e-16))
        scale = np.mean(share * power, axis=0)
    return scale, share


def _scale_row(model: IdentificationModel, motion: Samples, nominal: FloatArray) -> FloatArray:
    """Row s ψ = ⟨Y ψ, Y ψ₀⟩/⟨Y ψ₀, Y ψ₀⟩ over SCALE_SPREAD, Y of the links along a motion.

    s ψ = s ψ₀ means that the identified torque of the links has a slope of 1 against that of the
    description. Shape (1, P).
    """
    rows = np.unique(np.linspace(0, len(motion) - 1, min(len(motion), SCALE_ROWS)).astype(int))
    Y = regressor(model.robot, model.parameters, motion.rows(rows))
    edge = 10 * model.parameters.bodies
    torque = Y[:, :, :edge] @ nominal[:edge]
    out = np.zeros((1, model.parameters.count))
    out[0, :edge] = np.einsum("tjp,tj->p", Y[:, :, :edge], torque)
    return out / (SCALE_SPREAD * float(np.sum(torque**2)))


def _estimate(
    problem: _ServoProblem,
    iterate: _Iterate,
    rounds: int,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[_Iterate, _ServoProblem, list[float]]:
    """Minimise the cost; weights of the errors and γ are estimated anew in every round."""
    costs: list[float] = []
    for number in range(rounds):
        problem = problem.weighted(iterate)
        if problem.options.gamma is None:
            problem = dataclasses.replace(problem, prior=problem.prior_by_evidence(iterate))
        iterate, costs = _minimise(problem, iterate)
        errors = ", ".join(f"{1e3 * e:.3g}" for e in problem.rms_error(iterate))
        progress(
            f"round {number + 1} of {rounds}: {len(costs) - 1} steps, position error in the "
            f"windows {errors} mrad or mm"
        )
    return iterate, problem, costs


def _first_iterate(
    model: IdentificationModel, recordings: Sequence[Recording], options: ServoOptions
) -> _Iterate:
    """First values: nominal links, and the gains with which nominal torque explains the errors.

    e = (τ + F_c sign q̇ + F_v q̇ + c)/K_p by bounded least squares, joint by joint. A joint whose
    torque explains little takes the mean gain of the others.
    """
    from scipy import optimize  # slow to import

    parameters, n = model.parameters, model.robot.n
    psi = consistency.consistent_nominal(parameters)
    dynamics = build_dynamics(model, psi)
    columns = []
    reference = stated_gains(recordings[0])
    for recording in recordings:
        for part in _commanded_segments(recording):
            motion = part.samples(START_CUTOFF)
            assert part.qref is not None
            sign = np.tanh(motion.dq / (START_WIDTH_FACTOR * SERVO_COULOMB_WIDTH))
            error = (part.qref - motion.q) * stated_gains(part) / reference
            columns.append(
                np.stack(
                    [dynamics.rigid_torque(motion), sign, motion.dq, np.ones_like(sign), error]
                )
            )
    rows = np.concatenate(columns, axis=1)
    values, usable = np.full((4, n), 1e-9), np.zeros(n, bool)
    for j in range(n):
        A, b = rows[:4, :, j].T, rows[4, :, j]
        size = np.maximum(np.linalg.norm(A, axis=0), 1e-12)
        low = np.array([0.0, 0.0, 0.0, -np.inf])
        x = optimize.lsq_linear(A / size, b, (low, np.full(4, np.inf))).x / size
        explained = float(np.std(A[:, 0] * x[0])) ** 2
        usable[j] = explained > GRAVITY_SHARE * float(np.var(b))
        values[:, j] = x
    if options.gains is not None:
        proportional, derivative = options.gains
    else:
        inverse = np.exp(np.mean(np.log(values[0, usable]))) if usable.any() else None
        mass = np.mean(dynamics.mass_matrix(recordings[0].q[:1]), axis=0).diagonal()
        proportional = np.where(
            usable,
            1.0 / np.maximum(values[0], 1e-9),
            mass * NATURAL_FREQUENCY**2 if inverse is None else 1.0 / inverse,
        )
        derivative = np.zeros(n)
    for kind, row in (("coulomb", values[1]), ("viscous", values[2])):
        if kind in parameters.drive:
            block = parameters.block(kind)
            psi[block] = np.maximum(psi[block], row * proportional)
    if "offset" in parameters.drive:
        psi[parameters.block("offset")] = values[3] * proportional
    loop = ServoLoop(proportional, derivative, np.zeros(n))
    if "rotor_inertia" in parameters.drive:
        block, edge = parameters.block("rotor_inertia"), 10 * parameters.bodies
        scale = _joint_scales(model, recordings, loop)[block.start - edge : block.stop - edge]
        psi[block] = np.maximum(psi[block], ROTOR_SCALE_SHARE * scale)
    return _Iterate(psi, loop)


class _PositionErrors(Protocol):
    """Errors of predicted positions, in windows."""

    def errors(self, iterate: _Iterate) -> list[FloatArray]:
        """Predicted minus recorded positions of each set of windows. Shape (W, S, n)."""

    def slopes(self, iterate: _Iterate) -> list[tuple[FloatArray, FloatArray]]:
        """The errors with derivatives by log K_p, K_d, d and θ, shape (W, S, n, 3n + p)."""


@dataclass(frozen=True)
class _SimulatedErrors:
    """Errors of the simulated closed loop."""

    model: IdentificationModel
    groups: Sequence[ServoWindows]

    def errors(self, iterate: _Iterate) -> list[FloatArray]:
        dynamics = build_dynamics(self.model, iterate.psi)
        return [
            (simulate_servo(dynamics, iterate.loop, group).q - group.q)[:, 1:]
            for group in self.groups
        ]

    def slopes(self, iterate: _Iterate) -> list[tuple[FloatArray, FloatArray]]:
        dynamics, out = build_dynamics(self.model, iterate.psi), []
        for group in self.groups:
            run = simulate_servo(dynamics, iterate.loop, group, sensitivities=True)
            assert run.slopes is not None
            out.append(((run.q - group.q)[:, 1:], run.slopes[:, 1:]))
        return out


@dataclass(frozen=True)
class _EquationErrors:
    """Errors of the positions at which the loop would give the torque of the recorded motion.

    q = q_ref(t − d) + (K_d (q̇_ref − q̇) − Γ θ)/K_p: the equation error over K_p. It needs no
    simulation, and its minimum is the start of the output error.

    Attributes:
        model: The model.
        motion: Recorded motion, filtered. Shape (W S, n).
        reference: Commanded motion, filtered. Shape (W S, n).
        gamma: Regressor over the relative gain of the recording. Shape (W S, n, p).
        windows: Number of windows W.
    """

    model: IdentificationModel
    motion: Samples
    reference: Samples
    gamma: FloatArray
    windows: int

    @classmethod
    def of_recordings(
        cls, model: IdentificationModel, recordings: Sequence[Recording], reference: FloatArray
    ) -> _EquationErrors:
        """Filter recordings; rows are grouped into windows of START_WINDOW_ROWS."""
        smooth = dataclasses.replace(model, widths=START_WIDTH_FACTOR * model.widths)
        motions, commands, gammas, size = [], [], [], START_WINDOW_ROWS
        for recording in recordings:
            for part in _commanded_segments(recording):
                assert part.qref is not None
                every = max(1, int(part.rate / (4.0 * START_CUTOFF)))
                rows = np.arange(0, len(part), every)
                rows = rows[: len(rows) // size * size]
                motion = part.samples(START_CUTOFF).rows(rows)
                command = dataclasses.replace(part, q=part.qref).samples(START_CUTOFF).rows(rows)
                relative = stated_gains(part) / reference
                dynamics = build_dynamics(smooth, consistency.consistent_nominal(model.parameters))
                motions.append(motion)
                commands.append(command)
                gammas.append(dynamics.regressor(motion) / relative[:, None])
        gamma = np.concatenate(gammas)
        return cls(model, _stacked(motions), _stacked(commands), gamma, len(gamma) // size)

    def errors(self, iterate: _Iterate) -> list[FloatArray]:
        return [self.slopes(iterate)[0][0]]

    def slopes(self, iterate: _Iterate) -> list[tuple[FloatArray, FloatArray]]:
        loop, n = iterate.loop, self.model.robot.n
        torque = self.gamma @ (self.model.base.matrix @ iterate.psi)
        rate, K = self.reference.dq - self.motion.dq, loop.proportional
        push = (loop.derivative * rate - torque) / K
        error = self.reference.q - loop.delay * self.reference.dq + push - self.motion.q
        out = np.zeros((*error.shape, LOOP_PARAMETERS * n + self.gamma.shape[2]))
        joints = np.arange(n)
        out[:, joints, joints], out[:, joints, n + joints] = -push, rate / K
        out[:, joints, 2 * n + joints] = -self.reference.dq
        out[:, :, LOOP_PARAMETERS * n :] = -self.gamma / K[:, None]
        shape = (self.windows, -1, n)
        return [(error.reshape(shape), out.reshape(*shape, out.shape[2]))]


def _stacked(parts: Sequence[Samples]) -> Samples:
    """Motions one after the other."""
    q, dq, ddq = (np.concatenate([getattr(m, key) for m in parts]) for key in MOTION_KEYS)
    return Samples(q, dq, ddq)


@dataclass(frozen=True)
class _ServoProblem:
    """Terms of the cost.

    Attributes:
        model: The model.
        predicted: Errors of predicted positions.
        prior: ψ₀, the distance and γ.
        options: The options.
        scale: Row s with s ψ = s ψ₀ ± 1, which fixes the common factor; none where the gains are
            stated. Shape (≤ 1, P).
        weights: Weights of position errors, by set. Shape (W, 1, n) [1/rad or 1/m].
    """

    model: IdentificationModel
    predicted: _PositionErrors
    prior: Prior
    options: ServoOptions
    scale: FloatArray
    weights: tuple[FloatArray, ...] = ()

    def weighted(self, iterate: _Iterate) -> _ServoProblem:
        """The problem with errors weighted by those of an iterate.

        A window of S positions counts as (tr C)²/tr C² of them, C the covariance of its errors,
        because errors close in time are correlated (Satterthwaite 1946). Windows with larger
        errors than others, as where the robot touches something, weigh less: the mean square error
        of a window has Student's distribution (Lange, Little & Taylor, JASA 84, 1989).
        """
        errors, n, weights = self.predicted.errors(iterate), self.model.robot.n, []
        power = np.concatenate([np.mean(e**2, axis=1) for e in errors])
        scale, share = _student_scale(power)
        starts = np.cumsum([0, *map(len, errors)])
        for start, error in zip(starts[:-1], errors, strict=True):
            rows = share[start : start + len(error)]
            weight = np.empty((len(error), 1, n))
            for j in range(n):
                weighed = np.sqrt(rows[:, j, None]) * error[:, :, j]
                C = weighed.T @ weighed / len(error)
                independent = np.trace(C) ** 2 / max(float(np.sum(C * C)), 1e-300)
                weight[:, 0, j] = np.sqrt(
                    rows[:, j] * max(independent, 1.0) / len(C) / max(scale[j], 1e-16)
                )
            weights.append(weight)
        return dataclasses.replace(self, weights=tuple(weights))

    def rms_error(self, iterate: _Iterate) -> FloatArray:
        """RMS position error over all windows. Shape (n,)."""
        errors = [e.reshape(-1, e.shape[2]) for e in self.predicted.errors(iterate)]
        return np.asarray(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))

    def cost(self, iterate: _Iterate) -> float:
        """Cost of an iterate."""
        errors = self.predicted.errors(iterate)
        total = sum(
            0.5 * float(np.sum((w * e) ** 2)) for w, e in zip(self.weights, errors, strict=True)
        )
        _, target = self._loop_prior(iterate.loop)
        return (
            total
            + 0.5 * float(np.sum(target**2))
            + consistency.map_objective(
                self.model.parameters,
                self.scale,
                self.scale @ self.prior.nominal,
                self.prior,
                iterate.psi,
            )
        )

    def _loop_prior(self, loop: ServoLoop) -> tuple[FloatArray, FloatArray]:
        """Rows and target of the prior in a step of log K_p, K_d and delay."""
        n = len(loop.delay)
        centre = np.eye(n) - np.full((n, n), 1.0 / n)
        rows = np.zeros((LOOP_PARAMETERS * n, LOOP_PARAMETERS * n))
        rows[:n, :n] = centre / LOG_GAIN_SPREAD
        scale = DERIVATIVE_TIME * loop.proportional
        rows[n : 2 * n, n : 2 * n] = np.diag(1.0 / scale)
        rows[2 * n :, 2 * n :] = np.eye(n) / USUAL_DELAY
        target = -np.concatenate(
            [
                centre @ np.log(loop.proportional) / LOG_GAIN_SPREAD,
                loop.derivative / scale,
                loop.delay / USUAL_DELAY,
            ]
        )
        return rows, target

    def _free(self, loop: ServoLoop, at_bound: set[int]) -> IntArray:
        """Indices of the loop parameters that are estimated."""
        n = len(loop.delay)
        first = 2 * n if self.options.gains is not None else 0
        return np.array([k for k in range(first, LOOP_PARAMETERS * n) if k not in at_bound], int)

    def linearised(self, iterate: _Iterate) -> FloatArray:
        """Triangular factor of [∂q/∂loop, ∂q/∂θ, ∂q/∂θ θ − error], weighted."""
        theta, loops = self.model.base.matrix @ iterate.psi, LOOP_PARAMETERS * self.model.robot.n
        factors = []
        for weight, (error, slopes) in zip(
            self.weights, self.predicted.slopes(iterate), strict=True
        ):
            rows = (weight[..., None] * slopes).reshape(-1, slopes.shape[-1])
            target = rows[:, loops:] @ theta - (weight * error).reshape(-1)
            factors.append(np.linalg.qr(np.column_stack([rows, target]), mode="r"))
        return np.asarray(np.linalg.qr(np.vstack(factors), mode="r"))

    def eliminated(
        self, factor: FloatArray, loop: ServoLoop, free: IntArray, fixed: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Split a triangular factor into the rows of the loops and those of θ alone.

        Args:
            factor: As `linearised` returns it.
            loop: The loops at which it holds.
            free: Indices of the loop parameters that are estimated.
            fixed: Steps of the others; 0 elsewhere. Shape (3n,).
        """
        loops = LOOP_PARAMETERS * self.model.robot.n
        rows, target = self._loop_prior(loop)
        prior = np.zeros((len(rows), factor.shape[1]))
        prior[:, :loops], prior[:, -1] = rows, target
        stacked = np.vstack([factor, prior])
        stacked[:, -1] -= stacked[:, :loops] @ fixed
        kept = np.concatenate([free, np.arange(loops, factor.shape[1])])
        R: FloatArray = np.linalg.qr(stacked[:, kept], mode="r")  # type: ignore[assignment]
        count = len(free)
        return (
            R[:count],
            np.vstack([R[count:, count:-1] @ self.model.base.matrix, self.scale]),
            np.append(R[count:, -1], self.scale @ self.prior.nominal),
        )

    def gauss_newton(self, iterate: _Iterate, factor: FloatArray) -> _Iterate:
        """Minimum of the problem linearised at an iterate, with K_d and delay in their bounds."""
        n, at_bound = self.model.robot.n, set[int]()
        present = np.concatenate([np.zeros(n), iterate.loop.derivative, iterate.loop.delay])
        while True:
            free, step = self._free(iterate.loop, at_bound), np.zeros(LOOP_PARAMETERS * n)
            step[list(at_bound)] = -present[list(at_bound)]
            loops, root, target = self.eliminated(factor, iterate.loop, free, step)
            solution = consistency.maximum_a_posteriori(
                self.model.parameters, root, target, self.prior, self.options.bounds
            )
            count = len(free)
            theta = self.model.base.matrix @ solution.psi
            step[free] = np.linalg.lstsq(
                loops[:, :count], loops[:, -1] - loops[:, count:-1] @ theta, rcond=None
            )[0]
            step[:n] = np.clip(step[:n], -1.0, 1.0)
            trial = iterate.loop.changed(step)
            values = np.concatenate([trial.derivative, trial.delay])
            beyond = np.flatnonzero(values < 0.0)
            added = {int(n + k) for k in beyond if n + k in free}
            if not added:
                return _Iterate(solution.psi, _bounded(trial))
            at_bound |= added

    def prior_by_evidence(self, iterate: _Iterate) -> Prior:
        """The prior with the γ that maximise the evidence of the linearised problem."""
        parameters = self.model.parameters
        factor = self.linearised(iterate)
        free = self._free(iterate.loop, set())
        _, root, target = self.eliminated(
            factor, iterate.loop, free, np.zeros(LOOP_PARAMETERS * self.model.robot.n)
        )
        start = dataclasses.replace(
            self.prior,
            inertial_weight=1.0,
            joint_weights=np.ones(parameters.count - 10 * parameters.bodies),
        )
        inertial, joint = prior_weight.gamma_by_evidence(parameters, root, target, start)
        return dataclasses.replace(
            start, inertial_weight=max(inertial, MIN_INERTIAL_WEIGHT), joint_weights=joint
        )

    def posterior(self, iterate: _Iterate) -> tuple[ConsistentEstimate, FloatArray, FloatArray]:
        """Estimate with covariance at an iterate, and standard deviations of the loops (3, n) and
        of the joint parameters over K_p (kinds, n)."""
        n = self.model.robot.n
        free = self._free(iterate.loop, set())
        loops, root, target = self.eliminated(
            self.linearised(iterate), iterate.loop, free, np.zeros(LOOP_PARAMETERS * n)
        )
        solution = consistency.maximum_a_posteriori(
            self.model.parameters, root, target, self.prior, self.options.bounds
        )
        misfit = root @ iterate.psi - target
        B, count = self.model.base.matrix, len(free)
        inverse = np.linalg.pinv(loops[:, :count])
        by_theta = inverse @ loops[:, count:-1] @ B
        covariance = inverse @ inverse.T + by_theta @ solution.covariance @ by_theta.T
        deviation = np.zeros(LOOP_PARAMETERS * n)
        deviation[free] = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        deviation[:n] *= iterate.loop.proportional
        estimate = dataclasses.replace(
            solution, psi=iterate.psi, misfit=0.5 * float(misfit @ misfit)
        )
        with_psi = np.zeros((LOOP_PARAMETERS * n, len(iterate.psi)))  # of ln K_p, K_d, delay and ψ
        with_psi[free] = -by_theta @ solution.covariance
        ratio = self._ratio_deviation(iterate, solution.covariance, deviation[:n], with_psi[:n])
        return estimate, deviation.reshape(LOOP_PARAMETERS, n), ratio

    def _ratio_deviation(
        self, iterate: _Iterate, covariance: FloatArray, deviation: FloatArray, mixed: FloatArray
    ) -> FloatArray:
        """Standard deviations of r = ψ/K_p by error propagation, dr = (dψ − ψ d ln K_p)/K_p.

        Args:
            iterate: Estimate.
            covariance: Of ψ. Shape (P, P).
            deviation: Of K_p. Shape (n,).
            mixed: Covariance of ln K_p and ψ. Shape (n, P).
        """
        parameters, gain = self.model.parameters, iterate.loop.proportional
        joints, rows = np.arange(len(gain)), []
        for kind in parameters.drive:
            places = np.arange(len(iterate.psi))[parameters.block(kind)]
            psi = iterate.psi[places]
            variance = covariance[places, places] - 2.0 * psi * mixed[joints, places]
            variance += (psi * deviation / gain) ** 2
            rows.append(np.sqrt(np.maximum(variance, 0.0)) / gain)
        return np.array(rows).reshape(len(parameters.drive), len(gain))


def _bounded(loop: ServoLoop) -> ServoLoop:
    """The loops with K_d and delay in their bounds."""
    return ServoLoop(
        loop.proportional, np.maximum(loop.derivative, 0.0), np.clip(loop.delay, 0.0, MAX_DELAY)
    )


def _minimise(problem: _ServoProblem, iterate: _Iterate) -> tuple[_Iterate, list[float]]:
    """Gauss-Newton steps with step halving until the cost no longer decreases."""
    costs = [problem.cost(iterate)]
    for _ in range(MAX_STEPS):
        end = problem.gauss_newton(iterate, problem.linearised(iterate))
        iterate, cost = _line_search(problem, iterate, end, costs[-1])
        costs.append(cost)
        if costs[-2] - cost <= COST_TOLERANCE * abs(costs[-2]):
            break
    return iterate, costs


def _line_search(
    problem: _ServoProblem, start: _Iterate, end: _Iterate, cost: float
) -> tuple[_Iterate, float]:
    """First of start + (end − start)/2ᵏ that costs less, else start, with its cost."""
    for k in range(MAX_HALVINGS):
        part = 0.5**k
        loop = ServoLoop(
            start.loop.proportional * (end.loop.proportional / start.loop.proportional) ** part,
            start.loop.derivative + part * (end.loop.derivative - start.loop.derivative),
            start.loop.delay + part * (end.loop.delay - start.loop.delay),
        )
        trial = _Iterate(start.psi + part * (end.psi - start.psi), loop)
        trial_cost = problem.cost(trial)
        if trial_cost < cost:
            return trial, trial_cost
    return start, cost


def _replay(
    model: IdentificationModel,
    recordings: Sequence[Recording],
    reference: FloatArray,
    iterate: _Iterate,
) -> list[PositionReplay]:
    """Simulate the longest gap-free stretch of each recording from its first state."""
    parts = [max(_commanded_segments(recording), key=len) for recording in recordings]
    windows: dict[float, list[int]] = {}
    for k, part in enumerate(parts):
        windows.setdefault(round(part.step, 9), []).append(k)
    out: dict[int, PositionReplay] = {}
    dynamics = build_dynamics(model, iterate.psi)
    for places in windows.values():
        _, every = _window_size(parts[places[0]], 1.0)
        size = max((len(parts[k]) - 1) // every for k in places)
        group = _joined([_windows(parts[k], [0], size, every, reference) for k in places])
        run = simulate_servo(dynamics, iterate.loop, group, keep_lost=True)
        for row, k in enumerate(places):
            part, count = parts[k], (len(parts[k]) - 1) // every + 1
            assert part.qref is not None
            rows = every * np.arange(count)
            out[k] = PositionReplay(
                part.source, part.t[rows], part.q[rows], part.qref[rows], run.q[row, :count]
            )
    return [out[k] for k in range(len(parts))]
