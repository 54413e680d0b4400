"""Torque columns of the catalogue's effects along a periodic motion, with exact gradients.

A column is the torque per unit of a coefficient, as in `excite.effects`, whose nonlinear parameters
are fixed at their fitted values. Most are functions of one sample of (q, q̇, q̈), of the torque of
the links and of the motor's, and are written in CasADi. Effects with memory get further signals
along the period: the rate of the motor's torque (delay), the deflection of a spring behind the
motor by a linear filter (elasticity), and the state of presliding friction (hysteresis). Thermal
drift multiplies friction by a function of the run time. A payload's columns are those of the
regressor. Columns of an uncertain form (`form_uncertainty`) follow those of each effect.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..robot.inertial_parameters import Parameters, mean_inertia
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..schemas.effects import FORM_ERROR_STD
from .casadi_batch import MappedFunction
from .casadi_model import link_torque
from .design_objective import SampledMotion
from .form_uncertainty import EXACT_FORMS, discrepancy_factors, shape_points
from .presliding import PreslidingState, presliding_state

SPEED_ROUNDING = 1e-4
"""Speed ε below which √(q̇² + ε²) replaces |q̇| [rad/s]: a fiftieth of the Coulomb width."""
LOAD_ROUNDING = 1e-4
"""The same for the load, over its scale [1]."""
CURVE_POINTS = 200
"""Positions at which the mean of a friction wave is taken, as in `effects.friction_runtime`."""
RATE_BAND = 0.5
"""Band of the derivative of the motor's torque over half the sampling rate [1]: a Gaussian that
leaves 1/7 there, so that the derivative of a jump does not ring."""
LINEARISED = {
    "delay": "first order in the delay, of the torque below half the optimiser's sampling rate",
    "elasticity": "linear oscillator with the mean inertia about the joint; stiffness and damping "
    "linearised",
    "encoder_error": "first order in the position error",
    "gravity_tilt": "first order in the tilt",
    "stribeck": "speed and exponent linearised",
    "hysteresis": "travel linearised",
    "nonlinear_viscous": "exponent linearised",
    "torque_saturation": "power linearised",
    "torque_ripple": "fixed spatial frequency",
    "position_friction": "spatial frequency linearised",
    "thermal_drift": "time constant linearised; fixed mean friction",
    "load_friction": "power of the load linearised",
    "coupling": "fixed ratio",
    "unknown": "fixed curve, smooth between its points and constant beyond them",
}
"""How the nonlinear form of each effect becomes columns."""


UNKNOWN = "unknown"
"""Name of a torque that no effect explains, given by its curve over position or speed."""
CURVE_ROUNDING = 0.25
"""Width of the rounded corners of such a curve over the mean distance of its points [1]."""


@dataclass(frozen=True)
class SymbolicEffect:
    """A form of an effect with fixed nonlinear parameters.

    Attributes:
        effect: Name of the effect in the catalogue.
        joint: Index of the joint that carries it; None for an effect of no single joint.
        values: Nonlinear parameters by name, as in `effects.effect.CandidateModel`.
        other: Index of a second joint that it depends on.
    """

    effect: str
    joint: int | None
    values: Mapping[str, float] = field(default_factory=dict)
    other: int | None = None


@dataclass(frozen=True)
class RobotConstants:
    """Robot with the parameters by which columns are computed.

    Attributes:
        robot: The robot.
        parameters: Layout of its standard parameters.
        psi: Standard parameters: identified ones where there are any. Shape (P,).
        widths: Widths of the smooth Coulomb friction. Shape (n,) [rad/s or m/s].
        limits: Limits of the robot.
    """

    robot: Robot
    parameters: Parameters
    psi: FloatArray
    widths: FloatArray
    limits: Limits

    @cached_property
    def mean_inertia(self) -> FloatArray:
        """Mean inertia of the links about each joint. Shape (n,) [kg m²]."""
        bodies = self.parameters.of_bodies(self.psi)
        return np.maximum(mean_inertia(self.robot, self.limits, bodies), 1e-9)


def position_range(limits: Limits, joint: int) -> tuple[float, float]:
    """Return the range of a joint's position; a turn where it has no limits."""
    low, high = limits.position[joint]
    bounded = bool(np.isfinite(low) and np.isfinite(high))
    return (float(low), float(high)) if bounded else (-np.pi, np.pi)


@dataclass(frozen=True)
class Signals:
    """Symbols of one sample.

    Attributes:
        q: Positions. Shape (n,).
        dq: Velocities. Shape (n,).
        ddq: Accelerations. Shape (n,).
        load: Torque of the links. Shape (n,).
        motor: Torque of the base model with actuators. Shape (n,).
    """

    q: ca.SX
    dq: ca.SX
    ddq: ca.SX
    load: ca.SX
    motor: ca.SX


@dataclass(frozen=True)
class PeriodicFilter:
    """Signal that is a linear function of a torque over the period.

    Attributes:
        source: "load" or "motor".
        joint: Index of the joint.
        response: Returns the complex frequency response at angular frequencies [rad/s].
    """

    source: str
    joint: int
    response: Callable[[FloatArray], FloatArray]

    def matrix(self, count: int, period: float) -> FloatArray:
        """Return the linear map of N samples over one period. Shape (N, N)."""
        omega = np.asarray(2.0 * np.pi / period * np.fft.fftfreq(count, 1.0 / count), float)
        spectrum = self.response(omega)
        if count % 2 == 0:  # the alternating wave has no phase
            spectrum[count // 2] = spectrum[count // 2].real
        impulse = np.fft.ifft(spectrum).real
        place = (np.arange(count)[:, None] - np.arange(count)) % count
        return np.asarray(impulse[place])


@dataclass(frozen=True)
class FrictionState:
    """Signal that is the state of presliding friction.

    Attributes:
        joint: Index of the joint.
        reach: Travel of Dahl's model [rad or m].
    """

    joint: int
    reach: float


PeriodSignal = PeriodicFilter | FrictionState
"""A signal that depends on the whole period."""
Column = tuple[int | None, ca.SX]
"""Joint and its torque; None and the torque of all joints, shape (n,)."""


class _Builder:
    """Collect the columns of effects and the signals that they need."""

    def __init__(self, constants: RobotConstants) -> None:
        """Create the symbols."""
        self.constants = constants
        n = constants.robot.n
        self.signals = Signals(*(ca.SX.sym(name, n) for name in Signals.__annotations__))
        self._link_slopes: dict[int, tuple[ca.SX, ...]] = {}
        self.period_signals: list[PeriodSignal] = []
        self.symbols: list[ca.SX] = []

    def link_slopes(self, joint: int) -> tuple[ca.SX, ...]:
        """Return the slopes of the links' torque by q, q̇ and q̈ of a joint, shapes (n,)."""
        if joint not in self._link_slopes:
            state = self.signals.q, self.signals.dq, self.signals.ddq
            unit = np.eye(self.constants.robot.n)[joint]
            self._link_slopes[joint] = tuple(
                ca.jtimes(self._link_torque, x, ca.SX(unit)) for x in state
            )
        return self._link_slopes[joint]

    @cached_property
    def _link_torque(self) -> ca.SX:
        """Torque of the links, shape (n,)."""
        s, constants = self.signals, self.constants
        phi = ca.SX(constants.psi[: 10 * constants.parameters.bodies])
        return link_torque(constants.robot, s.q, s.dq, s.ddq, phi)

    def signal(self, signal: PeriodSignal) -> ca.SX:
        """Return the symbol of a signal over the period."""
        self.period_signals.append(signal)
        self.symbols.append(ca.SX.sym(f"signal{len(self.symbols)}"))
        return self.symbols[-1]

    def sign(self, joint: int) -> ca.SX:
        """Return the smooth sign of a joint's velocity."""
        return ca.tanh(self.signals.dq[joint] / self.constants.widths[joint])

    def speed(self, joint: int) -> ca.SX:
        """Return the smooth magnitude of a joint's velocity."""
        return ca.sqrt(self.signals.dq[joint] ** 2 + SPEED_ROUNDING**2)

    def actuator(self, kind: str, joint: int) -> float:
        """Return an actuator parameter of a joint; 0 where the model has none."""
        layout = self.constants.parameters
        if kind not in layout.drive:
            return 0.0
        return float(self.constants.psi[layout.block(kind)][joint])


def _local(
    function: Callable[[_Builder, int, Mapping[str, float]], list[ca.SX]],
) -> Callable[[_Builder, SymbolicEffect], list[Column]]:
    """Return the columns of an effect whose torque acts on its own joint only."""

    def columns(builder: _Builder, effect: SymbolicEffect) -> list[Column]:
        assert effect.joint is not None
        joint = effect.joint
        return [(joint, torque) for torque in function(builder, joint, effect.values)]

    return columns


def _stribeck(b: _Builder, j: int, values: Mapping[str, float]) -> list[ca.SX]:
    return [b.sign(j) * ca.exp(-((b.speed(j) / values["velocity"]) ** values["exponent"]))]


def _nonlinear_viscous(b: _Builder, j: int, values: Mapping[str, float]) -> list[ca.SX]:
    exponents = [values[key] for key in ("exponent", "concave") if key in values]
    return [b.sign(j) * b.speed(j) ** exponent for exponent in exponents]


def _load_friction(b: _Builder, j: int, values: Mapping[str, float]) -> list[ca.SX]:
    scale = values["scale"]
    size = ca.sqrt((b.signals.load[j] / scale) ** 2 + LOAD_ROUNDING**2)
    return [b.sign(j) * scale * size ** values["power"]]


def _position_friction(b: _Builder, j: int, values: Mapping[str, float]) -> list[ca.SX]:
    positions = np.linspace(values["low"], values["high"], CURVE_POINTS)
    out = []
    for k in range(1, int(values["waves"]) + 1):
        order = k * values["order"]
        for f, g in ((ca.cos, np.cos), (ca.sin, np.sin)):
            mean = float(g(order * positions).mean())
            out.append(b.sign(j) * (f(order * b.signals.q[j]) - mean))
    return out


def _spring(b: _Builder, j: int, values: Mapping[str, float]) -> list[ca.SX]:
    q = b.signals.q[j]
    if "waves" in values:
        place = (q - values["low"]) / (values["high"] - values["low"])
        return [ca.cos(np.pi * m * place) for m in range(1, int(values["waves"]) + 1)]
    return [ca.cos(q), ca.sin(q)] if values["form"] else [q]


def _torque_ripple(b: _Builder, j: int, values: Mapping[str, float]) -> list[ca.SX]:
    angle = values["order"] * b.signals.q[j]
    return [ca.cos(angle), ca.sin(angle)]


def _saturation(b: _Builder, j: int, values: Mapping[str, float]) -> list[ca.SX]:
    x = b.signals.motor[j]
    size = ca.sqrt((x / values["largest"]) ** 2 + LOAD_ROUNDING**2)
    return [x * size ** (values["power"] - 1.0)]


def _coupling(b: _Builder, effect: SymbolicEffect) -> list[Column]:
    assert effect.joint is not None and effect.other is not None
    j, ratio, s = effect.joint, effect.values["ratio"], b.signals
    speed = s.dq[j] + ratio * s.dq[effect.other]
    torques = [speed, ca.tanh(speed / b.constants.widths[j]), ratio * s.ddq[effect.other]]
    return [(j, torque) for torque in torques]


def _hysteresis(b: _Builder, j: int, values: Mapping[str, float]) -> list[ca.SX]:
    return [b.signal(FrictionState(j, values["reach"])) - b.sign(j)]


def _thermal(b: _Builder, j: int, values: Mapping[str, float]) -> list[ca.SX]:
    """Friction of the joint, which a function of the run time multiplies."""
    return [values["coulomb"] * b.sign(j) + values["viscous"] * b.signals.dq[j]]


def _band_limited_rate(omega: FloatArray) -> FloatArray:
    """Return the response of the time derivative, below half the highest frequency.

    Coulomb friction jumps between two samples; its derivative would have no limit.
    """
    cutoff = RATE_BAND * float(np.abs(omega).max())
    return np.asarray(1j * omega * np.exp(-0.5 * (omega / cutoff) ** 2))


def _delay(b: _Builder, effect: SymbolicEffect) -> list[Column]:
    joints = range(b.constants.robot.n) if effect.joint is None else [effect.joint]
    out = ca.SX.zeros(b.constants.robot.n)
    for j in joints:
        out[j] = -b.signal(PeriodicFilter("motor", j, _band_limited_rate))
    return [(None, out)]


def _lagging_link(
    b: _Builder, joint: int, lag: Sequence[ca.SX], *, carries_rotor: bool
) -> list[Column]:
    """Return −(∂τ/∂q δ + ∂τ/∂q̇ δ̇ + M δ̈) for a position error δ of a joint, with its rates."""
    out = ca.SX.zeros(b.constants.robot.n)
    for slope, rate in zip(b.link_slopes(joint), lag, strict=True):
        out -= slope * rate
    if carries_rotor:
        out[joint] -= b.actuator("rotor_inertia", joint) * lag[2]
        out[joint] -= b.actuator("viscous", joint) * lag[1]
    return [(None, out)]


def _elasticity(b: _Builder, effect: SymbolicEffect) -> list[Column]:
    """Deflection δ of a linear oscillator: (M s² + D s + K) δ = τ_load, D = 2 ζ √(K M)."""
    assert effect.joint is not None
    stiffness, ratio = effect.values["stiffness"], effect.values["damping"]
    inertia = float(b.constants.mean_inertia[effect.joint])
    damping = 2.0 * ratio * np.sqrt(stiffness * inertia)

    def rate(order: int) -> Callable[[FloatArray], FloatArray]:
        return lambda omega: np.asarray(
            (1j * omega) ** order / (stiffness - inertia * omega**2 + 1j * omega * damping)
        )

    lag = [b.signal(PeriodicFilter("load", effect.joint, rate(order))) for order in range(3)]
    return _lagging_link(b, effect.joint, lag, carries_rotor=False)


def _encoder_error(b: _Builder, effect: SymbolicEffect) -> list[Column]:
    assert effect.joint is not None
    q, dq, ddq = (x[effect.joint] for x in (b.signals.q, b.signals.dq, b.signals.ddq))
    out: list[Column] = []
    order = effect.values["order"]
    cosine, sine = ca.cos(order * q), ca.sin(order * q)
    for wave, slope in ((cosine, -sine), (sine, cosine)):
        rate = order * slope * dq
        acceleration = order * slope * ddq - order**2 * wave * dq**2
        out += _lagging_link(b, effect.joint, [wave, rate, acceleration], carries_rotor=True)
    return out


def curve_values(
    x: Sequence[float], y: Sequence[float], *, over_speed: bool, directed: bool
) -> dict[str, float]:
    """Return the values of an unknown torque that is known by its curve.

    Args:
        x: Position [rad or m] or speed, ascending.
        y: Torque [N m or N].
        over_speed: True if x is a speed.
        directed: True if the torque changes its sign with the direction of motion.
    """
    flags = {"over_speed": float(over_speed), "directed": float(directed)}
    points = {f"x{k}": float(value) for k, value in enumerate(x)}
    return {**flags, **points, **{f"y{k}": float(value) for k, value in enumerate(y)}}


def _unknown(b: _Builder, effect: SymbolicEffect) -> list[Column]:
    """Return the curve y₀ + Σ Δm_k h(x − x_k) with the slopes m_k between its points.

    h(d) = (d + √(d² + w²))/2 is a rounded ramp. The joint of the abscissa is `other`, or else that
    of the effect.
    """
    assert effect.joint is not None
    values, place = effect.values, effect.joint if effect.other is None else effect.other
    count = sum(key.startswith("x") for key in values)
    x, y = (np.array([values[f"{axis}{k}"] for k in range(count)]) for axis in "xy")
    slopes = np.concatenate([[0.0], np.diff(y) / np.diff(x), [0.0]])
    width = CURVE_ROUNDING * float(np.mean(np.diff(x)))
    signal = (b.signals.dq if values["over_speed"] else b.signals.q)[place]
    torque = ca.SX(float(y[0]))
    for knot, change in zip(x.tolist(), np.diff(slopes).tolist(), strict=True):
        distance = signal - knot
        torque += change * 0.5 * (distance + ca.sqrt(distance**2 + width**2))
    return [(effect.joint, torque * b.sign(effect.joint) if values["directed"] else torque)]


def _gravity_tilt(b: _Builder, effect: SymbolicEffect) -> list[Column]:
    """Torque per rotation of the base about x and y: δg = g × φ."""
    s, constants = b.signals, b.constants
    gravity = np.array(constants.robot.model.gravity.linear)
    lift = ca.SX.sym("lift", 3)
    phi = ca.SX(constants.psi[: 10 * constants.parameters.bodies])
    by_lift = ca.jacobian(link_torque(constants.robot, s.q, s.dq, s.ddq, phi, lift), lift)
    leaning = -ca.mtimes(by_lift, ca.SX(pin.skew(gravity)))
    return [(None, leaning[:, axis]) for axis in range(2)]


_COLUMNS: dict[str, Callable[[_Builder, SymbolicEffect], list[Column]]] = {
    "rotor_inertia": _local(lambda b, j, v: [b.signals.ddq[j]]),
    "torque_offset": _local(lambda b, j, v: [ca.SX.ones(1)]),
    "friction": _local(lambda b, j, v: [b.sign(j), b.signals.dq[j]]),
    "asymmetric_viscous": _local(lambda b, j, v: [b.speed(j)]),
    "stribeck": _local(_stribeck),
    "nonlinear_viscous": _local(_nonlinear_viscous),
    "drag": _local(lambda b, j, v: [b.signals.dq[j] * b.speed(j)]),
    "load_friction": _local(_load_friction),
    "position_friction": _local(_position_friction),
    "spring": _local(_spring),
    "torque_ripple": _local(_torque_ripple),
    "torque_gain": _local(lambda b, j, v: [b.signals.motor[j]]),
    "torque_saturation": _local(_saturation),
    "hysteresis": _local(_hysteresis),
    "thermal_drift": _local(_thermal),
    "coupling": _coupling,
    "delay": _delay,
    "elasticity": _elasticity,
    "encoder_error": _encoder_error,
    "gravity_tilt": _gravity_tilt,
}
SYMBOLIC_EFFECTS = (*_COLUMNS, "payload")
"""Effects of the catalogue that have columns here. Backlash, base compliance, contact and kinematic
errors have none: their torque is no smooth function of the motion, or needs other measurements."""


@dataclass(frozen=True)
class ColumnValues:
    """Columns along a motion and what their gradient needs.

    Attributes:
        columns: Torque per coefficient at N samples. Shape (N, n, K) [N m].
        motion: The motion.
        inputs: Arguments of the functions of one sample.
        matrices: Linear map of each `PeriodicFilter`, by its place among the signals.
        states: State of each `FrictionState`, by its place.
    """

    columns: FloatArray
    motion: SampledMotion
    inputs: Sequence[FloatArray]
    matrices: Mapping[int, FloatArray]
    states: Mapping[int, PreslidingState]


def _columns_of(builder: _Builder, effect: SymbolicEffect) -> list[Column]:
    """Return the columns of an effect that is no payload."""
    return (_unknown if effect.effect == UNKNOWN else _COLUMNS[effect.effect])(builder, effect)


def _full(builder: _Builder, column: Column) -> ca.SX:
    """Return the torque of all joints. Shape (n,)."""
    joint, torque = column
    if joint is None:
        return torque
    out = ca.SX.zeros(builder.constants.robot.n)
    out[joint] = torque
    return out


def _form_columns(
    builder: _Builder, effect: SymbolicEffect, columns: Sequence[ca.SX]
) -> list[ca.SX]:
    """Return the columns of the uncertain form of an effect, as many of each kind as it has."""
    if effect.effect in EXACT_FORMS or (effect.effect == "spring" and "waves" in effect.values):
        return []  # a curve of any form over the position has no other one
    out: list[ca.SX] = []
    for points in shape_points(effect.effect, effect.values):
        if effect.effect == "thermal_drift":  # whose factor of the run time has the parameter
            out += columns
            continue
        ends = [_columns_of(builder, dataclasses.replace(effect, values=v)) for v in points]
        out += [
            0.5 * (_full(builder, above) - _full(builder, below))
            for above, below in zip(*ends, strict=True)
        ]
    if effect.joint is None:  # the shares of the joints may differ
        units = FORM_ERROR_STD * np.eye(builder.constants.robot.n)
        return out + [ca.SX(unit) * column for unit in units for column in columns]
    limits, j = builder.constants.limits, effect.joint
    factors = discrepancy_factors(
        builder.signals.q[j],
        builder.speed(j),
        position_range(limits, j),
        float(limits.velocity[j]),
    )
    return out + [factor * column for factor in factors for column in columns]


class EffectColumns:
    """Columns of several effects; picklable.

    Attributes:
        effects: The effects.
        slices: Columns of each effect, those of its uncertain form included.
        coefficients: Columns of each effect alone.
        count: Number K of columns.
        parents: Of each column of an uncertain form the column whose coefficient is its unit; −1 of
            all others. Shape (K,).
        uncertain_forms: True if the forms of the effects are uncertain.
    """

    def __init__(
        self,
        constants: RobotConstants,
        effects: Sequence[SymbolicEffect],
        *,
        uncertain_forms: bool = False,
    ) -> None:
        """Build the CasADi functions.

        Args:
            constants: Robot with its parameters.
            effects: Effects, all of `SYMBOLIC_EFFECTS` or `UNKNOWN`.
            uncertain_forms: Add the columns of uncertain forms.
        """
        self.constants, self.effects = constants, tuple(effects)
        self.uncertain_forms = uncertain_forms
        n = constants.robot.n
        builder = _Builder(constants)
        torques: list[ca.SX] = []
        slices, coefficients, self._payload = [], [], dict[int, int]()
        parents: list[int] = []
        for effect in effects:
            begin = len(torques)
            if effect.effect == "payload":
                link = int(effect.values["link"])
                for k in range(int(effect.values["count"])):
                    self._payload[begin + k] = 10 * link + k
                    torques.append(ca.SX.zeros(n))
            else:
                torques += [_full(builder, c) for c in _columns_of(builder, effect)]
            end = len(torques)
            coefficients.append(slice(begin, end))
            parents += [-1] * (end - begin)
            if uncertain_forms:
                torques += _form_columns(builder, effect, torques[begin:end])
                parents += [begin + k % (end - begin) for k in range(len(torques) - end)]
            slices.append(slice(begin, len(torques)))
        self.slices, self.count = tuple(slices), len(torques)
        self.coefficients, self.parents = tuple(coefficients), np.array(parents, int)
        self._signals = tuple(builder.period_signals)
        s = builder.signals
        extra = ca.vertcat(*builder.symbols) if builder.symbols else ca.SX.sym("none", 1)
        inputs = [s.q, s.dq, s.ddq, s.load, s.motor, extra]
        columns = ca.horzcat(*torques) if torques else ca.SX.zeros(n, 1)
        self._function = ca.Function("columns", inputs, [ca.densify(ca.vec(columns.T))])
        self._mapped: dict[tuple[str, int], MappedFunction] = {}
        self._matrices: dict[tuple[int, float], dict[int, FloatArray]] = {}

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_mapped": {}, "_matrices": {}}

    @cached_property
    def _adjoint(self) -> ca.Function:
        """Map the arguments of the columns and a seed to the gradients by each argument."""
        inputs = self._function.sx_in()
        (columns,) = self._function.call(inputs)
        seed = ca.SX.sym("seed", columns.numel())
        gradient = ca.jtimes(columns, ca.vertcat(*inputs), seed, True)
        parts = ca.vertsplit(gradient, np.cumsum([0, *(x.numel() for x in inputs)]).tolist())
        return ca.Function("columns_adjoint", [*inputs, seed], [ca.densify(g) for g in parts])

    def _over_samples(self, function: ca.Function, count: int) -> MappedFunction:
        """Return a function over N samples."""
        key = function.name(), count
        if key not in self._mapped:
            self._mapped[key] = MappedFunction(function, count)
        return self._mapped[key]

    def _filters(self, count: int, period: float) -> dict[int, FloatArray]:
        """Return the linear map of each filter over N samples of a period."""
        key = count, period
        if key not in self._matrices:
            self._matrices[key] = {
                i: signal.matrix(count, period)
                for i, signal in enumerate(self._signals)
                if isinstance(signal, PeriodicFilter)
            }
        return self._matrices[key]

    @property
    def _link_parameters(self) -> FloatArray:
        """ψ of the links alone. Shape (P,)."""
        out = self.constants.psi.copy()
        out[10 * self.constants.parameters.bodies :] = 0.0
        return out

    @property
    def _coulomb(self) -> FloatArray:
        """Coulomb friction of each joint. Shape (n,) [N m]."""
        layout = self.constants.parameters
        if "coulomb" not in layout.drive:
            return np.zeros(self.constants.robot.n)
        return np.asarray(self.constants.psi[layout.block("coulomb")])

    @property
    def _smooth_parameters(self) -> FloatArray:
        """ψ without Coulomb friction, whose width is not that of the regressor. Shape (P,)."""
        out, layout = self.constants.psi.copy(), self.constants.parameters
        if "coulomb" in layout.drive:
            out[layout.block("coulomb")] = 0.0
        return out

    def _signal_values(self, motion: SampledMotion) -> ColumnValues:
        """Return the arguments of the functions and the signals' records, without columns."""
        load = motion.regressor @ self._link_parameters
        motor = motion.regressor @ self._smooth_parameters
        motor += self._coulomb * np.tanh(motion.dq / self.constants.widths)
        count = len(motion.q)
        extra = np.zeros((count, max(len(self._signals), 1)))
        matrices, states = self._filters(count, motion.period), {}
        for i, signal in enumerate(self._signals):
            j = signal.joint
            if isinstance(signal, PeriodicFilter):
                extra[:, i] = matrices[i] @ (load if signal.source == "load" else motor)[:, j]
            else:
                states[i] = presliding_state(
                    motion.q[:, j], motion.dq[:, j], motion.period / count, signal.reach
                )
                extra[:, i] = states[i].z
        inputs = [motion.q, motion.dq, motion.ddq, load, motor, extra]
        return ColumnValues(np.zeros(0), motion, inputs, matrices, states)

    def evaluate(self, motion: SampledMotion) -> ColumnValues:
        """Evaluate the columns along one period of a motion.

        Thermal drift's columns are its friction, which `time_factors` multiply.

        Args:
            motion: The motion.
        """
        record = self._signal_values(motion)
        count, n = motion.q.shape
        out = (
            self._over_samples(self._function, count)(*record.inputs)[0]
            .reshape(count, n, -1)
            .copy()
        )
        for k, column in self._payload.items():
            out[:, :, k] = motion.regressor[:, :, column]
        return dataclasses.replace(record, columns=out[:, :, : self.count])

    def gradients(
        self, values: ColumnValues, seed: FloatArray
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
        """Return the gradients of Σ seed·C.

        Args:
            values: Result of `evaluate`.
            seed: Gradient with respect to the columns. Shape (N, n, K).

        Returns:
            Gradient with respect to the regressor, shape (N, n, P), and the direct ones with
            respect to q, q̇ and q̈, shapes (N, n).
        """
        motion = values.motion
        parts = self._over_samples(self._adjoint, len(motion.q))(
            *values.inputs, np.ascontiguousarray(seed).reshape(len(motion.q), -1)
        )
        by_q, by_dq, by_ddq, by_load, by_motor, by_extra = (part.copy() for part in parts)
        by_extra = by_extra.reshape(len(motion.q), -1)
        for i, signal in enumerate(self._signals):
            if isinstance(signal, PeriodicFilter):
                target = by_load if signal.source == "load" else by_motor
                target[:, signal.joint] += values.matrices[i].T @ by_extra[:, i]
            else:
                position, velocity = values.states[i].gradients(by_extra[:, i])
                by_q[:, signal.joint] += position
                by_dq[:, signal.joint] += velocity
        by_regressor = (
            by_load[:, :, None] * self._link_parameters
            + by_motor[:, :, None] * self._smooth_parameters
        )
        widths = self.constants.widths
        slope = (1.0 - np.tanh(motion.dq / widths) ** 2) / widths
        by_dq += by_motor * self._coulomb * slope
        for k, column in self._payload.items():
            by_regressor[:, :, column] += seed[:, :, k]
        return by_regressor, (by_q, by_dq, by_ddq)

    def time_factors(self, times: FloatArray) -> FloatArray | None:
        """Return the factors of the run time on the columns; None where none depends on it.

        Args:
            times: Run time of each row. Shape (…) [s].

        Returns:
            Factors, 1 for most columns. Shape (…, K).
        """
        out, depends = np.ones((*times.shape, self.count)), False
        places = zip(self.effects, self.slices, self.coefficients, strict=True)
        for effect, place, coefficients in places:
            if effect.effect != "thermal_drift":
                continue
            depends = True
            out[..., place] = _warming(times, effect.values)[..., None]
            if place != coefficients:
                (points,) = shape_points(effect.effect, effect.values)
                above, below = (_warming(times, values) for values in points)
                out[..., coefficients.stop] = 0.5 * (above - below)
        return out if depends else None


def _warming(times: FloatArray, values: Mapping[str, float]) -> FloatArray:
    """Return the share of thermal drift that has happened at each run time [1]."""
    return np.asarray(1.0 - np.exp(-times / values["time_constant"]))
