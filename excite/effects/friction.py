"""Friction beyond viscous and Coulomb."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .effect import (
    CandidateModel,
    Effect,
    NonlinearParameterSet,
    alone,
    amplitude,
    beside,
    family,
    named,
    positive,
    within,
)
from .recorded_motion import RecordedMotion, position_range

Array = np.ndarray
STICKIEST, LEAST_STUCK = 5.0, 0.05
"""Times Coulomb friction that friction at rest or before it slides can be. The base fit takes some of it for its own, and beside other
effects perhaps all: Coulomb friction is taken to be this share of the joint's largest torque, at the least."""
POWERS = 0.5, 1.0, 2.0
"""Of a speed, by which friction fades, tried."""
TURNED = {False: (1.0, 1.4, 2.0), True: (1.0, 2.0, 3.0)}
"""The same where it is turned, at the least, usually and at the most: exponential (Tustin 1947; Armstrong-Hélouvry 1991), or rational
(Popp & Stelter 1990; Hess & Soom 1990), which is tried beside the other. Less than 1 is not sought: what peaks at rest has nearly any
height there."""
TOLD = 3.0
"""Times the speed at which a joint crosses one step of its encoder while it stays within one, where it turns back: how fast it goes below
that is not told, and friction that changes there is any. In 91 simulated robots with nothing missing it seemed to, seven times."""
WIDTHS = 1e-3, 4e-3, 2e-2
"""Speed over which the sign of friction turns, at the least, as tried first and at the most [rad/s, or of the fastest if that is less]."""
POINTS = 200
"""A wave, that its largest and least are told from."""
FADING = 6.0
"""Times the usual gain that it takes to believe friction under load that fades with speed: what a coarse encoder makes of a reversal does
so too, wherever some load is."""


def _speed(track: RecordedMotion, joint: int) -> Array:
    return np.asarray(track.samples.dq[:, joint])


def _fastest(tracks: Sequence[RecordedMotion], joint: int) -> float:
    return max(float(np.abs(track.samples.dq[:, joint]).max()) for track in tracks)


def _slowest(tracks: Sequence[RecordedMotion], joint: int) -> float:
    """Speed from which an encoder tells it, 0 where it is fine."""
    return TOLD * min(
        (float(t.steps[joint] / t.reversal_dwell[joint]) for t in tracks if 0.0 < t.reversal_dwell[joint] < np.inf),
        default=0.0,
    )


def _seen(speed: float, least: float, gate: Callable[[Array], bool]) -> Callable[[Array], bool]:
    """The gate of a law that changes at a speed: nothing passes where an encoder does not tell that."""
    return gate if speed > least else lambda c: False


def stickiest(tracks: Sequence[RecordedMotion], joint: int) -> float:
    """What friction before it slides can be, at the most [N m]."""
    largest = max(float(np.abs(track.torque[:, joint]).max()) for track in tracks)
    return STICKIEST * max(
        float(tracks[0].fitted_robot.drive("coulomb")[joint]), LEAST_STUCK * largest, 1e-9
    )


def _slanted(t: RecordedMotion, s: CandidateModel) -> Array:
    return alone(t, s.joint_index, np.abs(_speed(t, s.joint_index)))


def _asymmetric(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    def parameters(viscous: float) -> Callable[[Array], dict[str, float]]:
        return lambda c: {"positive": viscous + float(c[0]), "negative": viscous - float(c[0])}

    for j in range(tracks[0].n):
        viscous, coulomb = (
            max(float(tracks[0].fitted_robot.drive(kind)[j]), 1e-9) for kind in ("viscous", "coulomb")
        )
        most = 1.5 * (
            viscous + coulomb / max(_fastest(tracks, j), 1e-9)
        )  # what is dissipated in both directions, with all that resists
        yield CandidateModel(
            "asymmetric_viscous",
            j,
            _slanted,
            parameters=parameters(viscous),
            plausible=within(-most, most),
        )


def _stuck(t: RecordedMotion, s: CandidateModel) -> Array:
    """Friction that fades with speed. Where the sign of friction has a `width` of its own, so has Coulomb friction, instead of the `usual`:
    a base fit that knows nothing of what fades makes it too narrow, and a joint that creeps as it turns back is within it for long."""
    if "width" not in s.values:
        return alone(t, s.joint_index, t.sign(s.joint_index) * _faded(t, s))
    sign, usual = (np.tanh(_speed(t, s.joint_index) / s.values[name]) for name in ("width", "usual"))
    return alone(t, s.joint_index, np.column_stack([sign * _faded(t, s), sign - usual]))


def _faded(t: RecordedMotion, s: CandidateModel) -> Array:
    """exp(−(|q̇|/v)^δ), or 1/(1 + (e − 1)(|q̇|/v)^δ) where that is rational: either has fallen to 1/e at v. Shape (M,)."""
    x = (np.abs(_speed(t, s.joint_index)) / s.values["velocity"]) ** s.values["exponent"]
    return np.asarray(1.0 / (1.0 + (np.e - 1.0) * x) if "rational" in s.values else np.exp(-x))


@dataclass(frozen=True)
class _Fading:
    """Stribeck's curve at a joint, any value of which can be turned. least: speed from which an encoder tells it [rad/s]. most: how high it
    can be [N m]. widths: see WIDTHS; usual: the base model's [rad/s]. rational: see `_faded`. width: None where it is the usual one."""

    joint: int
    least: float
    most: float
    widths: tuple[float, float, float]
    usual: float
    power: float
    rational: bool = False
    velocity: float = 0.0
    width: float | None = None

    def at(self, velocity: float) -> CandidateModel:
        """Turned by the velocity; then, by either law, by all values together: each makes up for much of another."""
        fixed = {"velocity": velocity, "exponent": self.power}
        fixed |= {"rational": 1.0} if self.rational else {}
        fixed |= {} if self.width is None else {"width": self.width, "usual": self.usual}
        told, gate = (
            named("amplitude", velocity=velocity),
            _seen(velocity, self.least, self._resists),
        )
        own = replace(self, velocity=velocity)
        kin = lambda: [own._knobs(rational) for rational in (False, True)]  # noqa: E731
        return CandidateModel(
            "stribeck", self.joint, _stuck, fixed, parameters=told, plausible=gate, variants=kin
        )

    def _knobs(self, rational: bool) -> NonlinearParameterSet:
        least, usual, most = TURNED[rational]
        power = max(self.power, least) if rational == self.rational else usual
        values = {
            "velocity": (self.velocity, self.velocity / 2.0, self.velocity * 2.0),
            "power": (power, least, most),
        }
        narrowest, middling, widest = np.maximum(self.widths, self.least).tolist()
        if narrowest < widest:
            values["width"] = self.width or middling, narrowest, widest
        return NonlinearParameterSet(values, replace(self, rational=rational)._with)

    def _with(self, values: Mapping[str, float]) -> CandidateModel:
        own = replace(self, power=values["power"], width=values.get("width"))
        (by_velocity,) = beside(values["velocity"], 2.0, [own.at])
        return by_velocity.here

    def _resists(self, c: Array) -> bool:
        return bool(0.0 < c[0] < self.most and np.abs(c[1:]).max(initial=0.0) < self.most)


def _stribeck(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    for j in range(tracks[0].n):
        scale, usual = min(1.0, _fastest(tracks, j)), float(tracks[0].widths[j])
        low, middle, high = (scale * width for width in WIDTHS)
        velocities = (scale * np.geomspace(0.01, 0.4, 7)).tolist()
        least, most = _slowest(tracks, j), stickiest(tracks, j)
        for power in POWERS:
            yield from family(
                velocities, _Fading(j, least, most, (low, middle, high), usual, power).at
            )


def _powered(t: RecordedMotion, s: CandidateModel) -> Array:
    return alone(t, s.joint_index, t.sign(s.joint_index) * np.abs(_speed(t, s.joint_index)) ** s.values["exponent"])


def _nonlinear(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    def bent(j: int) -> Callable[[float], CandidateModel]:
        least = _slowest(tracks, j) / max(_fastest(tracks, j), 1e-9)

        def shape(power: float) -> CandidateModel:
            told, rises = (
                named("coefficient", exponent=power),
                0.5 ** (1.0 / power),
            )  # to half, at this part of the fastest
            return CandidateModel(
                "nonlinear_viscous",
                j,
                _powered,
                {"exponent": power},
                parameters=told,
                plausible=_seen(rises, least, positive),
            )

        return shape

    for j in range(tracks[0].n):
        shape = bent(j)
        yield from family((0.2, 0.35, 0.5, 0.7), shape)
        yield from family((1.4, 1.7, 2.0, 2.5, 3.2), shape)


def _windy(t: RecordedMotion, s: CandidateModel) -> Array:
    return alone(t, s.joint_index, _speed(t, s.joint_index) * np.abs(_speed(t, s.joint_index)))


def _drag(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    for j in range(tracks[0].n):
        yield CandidateModel("drag", j, _windy, parameters=named("coefficient"), plausible=positive)


def _rubbed(t: RecordedMotion, s: CandidateModel) -> Array:
    """sgn q̇ times a power of the load: what the link weighs, or where it is `driven` what the motor makes. Where a `velocity` is stated,
    the same once more as far as it fades with speed."""
    scale, place = s.values["scale"], s.joint_index
    load = (t.motor_torque if "driven" in s.values else t.transmitted_torque)[:, place]
    rubs = t.sign(place) * scale * (np.abs(load) / scale) ** s.values["power"]
    return alone(
        t, place, np.column_stack([rubs, rubs * _faded(t, s)]) if "velocity" in s.values else rubs
    )


def _load(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    def fading(j: int, fixed: Mapping[str, float]) -> Callable[[float], CandidateModel]:
        def shape(velocity: float) -> CandidateModel:
            bare = CandidateModel(
                "load_friction",
                j,
                _rubbed,
                {**fixed, "velocity": velocity},
                plausible=_rubs,
                threshold_factor=FADING,
            )
            mean = float(np.mean(np.concatenate([_faded(t, bare) for t in tracks])))
            return replace(
                bare, parameters=lambda c: {"mu": float(c[0] + mean * c[1])}
            )  # on the average of the motion

        return shape

    for j in range(tracks[0].n):
        scale = {"scale": max(*(float(np.abs(t.transmitted_torque[:, j]).max()) for t in tracks), 1e-9)}
        speeds = (np.array([0.02, 0.06, 0.2]) * _fastest(tracks, j)).tolist()
        for powers, drive in ((1.0, 1.5, 2.0), {}), ((1.0,), {"driven": 1.0}):
            for power in powers:
                fixed = {"power": power, **scale, **drive}
                yield CandidateModel(
                    "load_friction",
                    j,
                    _rubbed,
                    fixed,
                    parameters=named("mu"),
                    plausible=within(0.0, 1.0),
                )
            for exponent in (1.0, 2.0):
                yield from family(
                    speeds, fading(j, {"power": 1.0, "exponent": exponent, **scale, **drive})
                )


def _rubs(c: Array) -> bool:
    """Friction that grows with the load at every speed, the more the slower."""
    return bool(c[0] >= 0.0 and c[1] > 0.0 and c[0] + c[1] < 1.0)


def _placed(t: RecordedMotion, s: CandidateModel) -> Array:
    """sgn q̇ times the first waves of a periodic function of position, as many as `waves` says, of `order`, 2 `order`, …; each less its mean
    over where the joint was: what does not vary there is Coulomb friction."""
    place, sign = t.samples.q[:, s.joint_index], t.sign(s.joint_index)
    everywhere = np.linspace(s.values["low"], s.values["high"], POINTS)
    waves = [
        (f, k * s.values["order"])
        for k in range(1, int(s.values["waves"]) + 1)
        for f in (np.cos, np.sin)
    ]
    return alone(
        t,
        s.joint_index,
        np.column_stack(
            [sign * (f(order * place) - f(order * everywhere).mean()) for f, order in waves]
        ),
    )


def _position(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    def waved(j: int, waves: float) -> Callable[[float], CandidateModel]:
        low, high = position_range(tracks, j)

        def shape(order: float) -> CandidateModel:
            fixed = {"order": order, "waves": waves, "low": low, "high": high}
            return CandidateModel(
                "position_friction", j, _placed, fixed, parameters=amplitude(), allows_several=True
            )

        return shape

    for j in range(tracks[0].n):
        yield from family((0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6), waved(j, 1.0))
        yield from family((0.5, 1.0, 2.0), waved(j, 3.0))


def _range(parts: Sequence[tuple[CandidateModel, Array]]) -> dict[str, float]:
    """Half of how much friction varies where the joint was, all waves together."""
    first, turns = (
        parts[0][0].values,
        max(shape.values["order"] * shape.values["waves"] for shape, _ in parts) / (2.0 * np.pi),
    )
    angle = np.linspace(
        first["low"],
        first["high"],
        int(POINTS * max(1.0, turns * (first["high"] - first["low"]))) + 1,
    )
    wave = np.zeros(len(angle))
    for shape, c in parts:
        for k, (cosine, sine) in enumerate(c.reshape(-1, 2), start=1):
            wave += cosine * np.cos(k * shape.values["order"] * angle) + sine * np.sin(
                k * shape.values["order"] * angle
            )
    return {"amplitude": 0.5 * float(np.ptp(wave))}


def _resisted(t: RecordedMotion, s: CandidateModel) -> Array:
    return alone(t, s.joint_index, np.column_stack([t.sign(s.joint_index), _speed(t, s.joint_index)]))


def _friction(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    for j in range(tracks[0].n):
        told = named("coulomb", "viscous")
        yield CandidateModel(
            "friction",
            j,
            _resisted,
            parameters=told,
            plausible=lambda c: bool(c[0] > 0.0 and c[1] > -0.2 * c[0]),
        )


EFFECTS = (
    Effect(
        "asymmetric_viscous",
        "F_v+ for q̇ > 0, F_v− for q̇ < 0",
        _slanted,
        _asymmetric,
        {"positive": "N m s/rad", "negative": "N m s/rad"},
        "torque against speed has another slope in each direction",
        ("thermal_drift", "drag"),
        "constant speeds in both directions, several of them",
        form={"positive": 0.09, "negative": 0.09},
        residual_log_offset=0.4,
    ),
    Effect(
        "stribeck",
        "(F_s − F_c) exp(−(|q̇|/v_s)^δ) sgn q̇, or / (1 + (e − 1) (|q̇|/v_s)^δ) (Stribeck 1902; Hess & Soom 1990; Armstrong-Hélouvry 1994)",
        _stuck,
        _stribeck,
        {"amplitude": "N m", "velocity": "rad/s"},
        "friction is larger near zero speed",
        ("hysteresis", "nonlinear_viscous", "delay"),
        "a ladder of slow constant speeds, 1 mrad/s to 0.5 rad/s",
        form={"amplitude": 0.25, "velocity": 0.25},
    ),
    Effect(
        "nonlinear_viscous",
        "F |q̇|^k sgn q̇",
        _powered,
        _nonlinear,
        {"coefficient": "N m (s/rad)^k", "exponent": "1"},
        "friction against speed is bent",
        ("drag", "stribeck", "thermal_drift"),
        "a wide range of constant speeds",
        form={"coefficient": 0.25, "exponent": 0.25},
        residual_log_offset=-0.6,
    ),
    Effect(
        "drag",
        "c q̇ |q̇|",
        _windy,
        _drag,
        {"coefficient": "N m s²/rad²"},
        "resistance grows with the square of speed",
        ("nonlinear_viscous",),
        "very fast motion",
    ),
    Effect(
        "load_friction",
        "μ |τ_L|^k sgn q̇ (Hamon, Gautier & Garrec 2010); |τ_L| (μ + μ_s exp(−(|q̇|/v)^δ)) sgn q̇ (Bittencourt & Gunnarsson 2012)",
        _rubbed,
        _load,
        {"mu": "1"},
        "friction grows with the torque carried",
        ("position_friction", "coupling"),
        "repeat the same trajectory with another load at the flange",
        form={"mu": 0.35},
    ),
    Effect(
        "position_friction",
        "sgn q̇ (a cos kq + b sin kq)",
        _placed,
        _position,
        {"amplitude": "N m"},
        "friction depends on where the joint is",
        ("load_friction",),
        "the same stroke at shifted positions",
        told=_range,
        form={"amplitude": 0.5},
        residual_log_offset=-0.8,
    ),
    Effect(
        "friction",
        "F_c sgn q̇ + F_v q̇, where the model has none",
        _resisted,
        _friction,
        {"coulomb": "N m", "viscous": "N m s/rad"},
        "torque against the motion",
        ("stribeck",),
        "any motion in both directions",
        prior_only=True,
        form={"coulomb": 0.04, "viscous": 0.04},
    ),
)
