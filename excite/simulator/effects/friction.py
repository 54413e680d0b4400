"""Friction beyond viscous and Coulomb: dependence on speed, load, position, history, temperature.

Each effect has two model forms, and neither is the one that a catalogue would fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..._types import FloatArray
from ..physical_effect import JointStates, PhysicalEffect
from .effect_type import (
    EffectParameter,
    EffectSite,
    EffectType,
    ValueConversion,
    memoryless_effect,
    phase_parameter,
    smooth_sign,
    torque_at_joint,
)

Values = Mapping[str, float]


def asymmetric_blend(site: EffectSite, p: Values) -> PhysicalEffect:
    """Viscous friction by direction: (½(p+n) + ½(p−n) tanh(v/50 mrad/s)) v."""
    mean, half = 0.5 * (p["positive"] + p["negative"]), 0.5 * (p["positive"] - p["negative"])
    return memoryless_effect(site, lambda x: (mean + half * np.tanh(x.v / 0.05)) * x.v)


def asymmetric_saturating(site: EffectSite, p: Values) -> PhysicalEffect:
    """Viscous friction by direction: p v or n v, divided by 1 + 0.1|v|/v_max."""
    top = site.velocity_limit[site.j]
    return memoryless_effect(
        site,
        lambda x: (
            np.where(x.v > 0.0, p["positive"], p["negative"])
            * x.v
            / (1.0 + 0.1 * np.abs(x.v) / top)
        ),
    )


def stribeck_rational(site: EffectSite, p: Values) -> PhysicalEffect:
    """Stribeck friction A sgn(v)/(1 + (v/vₛ)²).

    The rational form of Hess & Soom (1990); catalogues fit a Gaussian or an exponential.
    """
    return memoryless_effect(
        site, lambda x: p["amplitude"] * smooth_sign(x.v) / (1.0 + np.square(x.v / p["velocity"]))
    )


def stribeck_sech(site: EffectSite, p: Values) -> PhysicalEffect:
    """Stribeck friction A sgn(v)/cosh(v/vₛ), a smooth form as in Makkar et al. (2005)."""
    return memoryless_effect(
        site,
        lambda x: (
            p["amplitude"]
            * smooth_sign(x.v)
            / np.cosh(np.minimum(np.abs(x.v) / p["velocity"], 50.0))
        ),
    )


def viscous_power(site: EffectSite, p: Values) -> PhysicalEffect:
    """Nonlinear viscous friction c |v|ᵏ sgn(v), with k neither whole nor half."""
    return memoryless_effect(
        site, lambda x: p["coefficient"] * smooth_sign(x.v) * np.abs(x.v) ** p["exponent"]
    )


def viscous_rounded_power(site: EffectSite, p: Values) -> PhysicalEffect:
    """Nonlinear viscous friction c ((v² + v₀²)^(k/2) − v₀ᵏ) sgn(v), v₀ = 0.1 v_max."""
    v0 = 0.1 * site.velocity_limit[site.j]
    k = p["exponent"]
    return memoryless_effect(
        site,
        lambda x: (
            p["coefficient"] * smooth_sign(x.v) * ((x.v * x.v + v0 * v0) ** (0.5 * k) - v0**k)
        ),
    )


def load_power(site: EffectSite, p: Values) -> PhysicalEffect:
    """Load-dependent friction μ |τ|^1.15 sgn(v), scaled to μ|τ| at 0.25 τ_max."""
    at = 0.25 * site.torque_limit[site.j]
    return memoryless_effect(
        site, lambda x: p["mu"] * smooth_sign(x.v) * np.abs(x.load) * (np.abs(x.load) / at) ** 0.15
    )


def load_quadrants(site: EffectSite, p: Values) -> PhysicalEffect:
    """Load-dependent friction μ|τ| sgn(v) with an efficiency that depends on the power flow.

    It is 20 % more when the load drives the joint and 20 % less when the motor does, as in worm and
    planetary gears.
    """
    half = 0.02 * site.torque_limit[site.j]
    return memoryless_effect(
        site,
        lambda x: (
            p["mu"]
            * smooth_sign(x.v)
            * np.sqrt(x.load**2 + half**2)
            * (1.0 - 0.2 * np.tanh(x.load * x.v / (half * 0.1)))
        ),
    )


def position_triangle(site: EffectSite, p: Values) -> PhysicalEffect:
    """Position-dependent friction A tri(kq + φ) sgn(v), tri a triangular wave."""
    return memoryless_effect(
        site,
        lambda x: (
            p["amplitude"]
            * smooth_sign(x.v)
            * (2.0 / np.pi)
            * np.arcsin(np.sin(p["waves"] * x.q + p["phase"]))
        ),
    )


def position_bumps(site: EffectSite, p: Values) -> PhysicalEffect:
    """Position-dependent friction A (e^{4(cos(kq+φ)−1)} + ½ e^{8(cos(kq+2φ)−1)}) sgn(v)."""
    w = p["waves"]
    return memoryless_effect(
        site,
        lambda x: (
            p["amplitude"]
            * smooth_sign(x.v)
            * _two_tight_spots(w * x.q + p["phase"], w * x.q + 2 * p["phase"])
        ),
    )


def _two_tight_spots(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return two bumps at the zeros of two angles; the second is half as high and narrower."""
    return np.asarray(np.exp(4 * (np.cos(first) - 1)) + 0.5 * np.exp(8 * (np.cos(second) - 1)))


def _half_peak_to_peak(p: Values) -> Values:
    """Return the amplitude as half of the peak-to-peak variation.

    The mean belongs to the Coulomb friction of the base model.
    """
    turn = np.linspace(0.0, 2.0 * np.pi, 3600)
    return {
        "amplitude": 0.5 * p["amplitude"] * float(np.ptp(_two_tight_spots(turn, turn + p["phase"])))
    }


@dataclass(frozen=True)
class BoucWenHysteresis(PhysicalEffect):
    """Bouc-Wen hysteresis A z with ż = (k/A)(v − ½|v||z|^(m−1) z − ½ v|z|ᵐ), m = 1.6.

    Each step is exact for the slope at its start.

    Attributes:
        site: Place of the effect.
        amplitude: Largest torque A [N m].
        stiffness: Presliding stiffness k [N m/rad].
    """

    site: EffectSite
    amplitude: float
    stiffness: float
    state_size = 1

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        """Return the internal states after a time step `dt` [s]; see `PhysicalEffect`."""
        if self.amplitude == 0.0:
            return z
        v = x.v[..., self.site.j]
        direction = np.copysign(1.0, v)
        s = z[..., 0] * direction
        # s = z sgn(v): ds/dt = (k/A)|v|(1 − |s|^m [s > 0]), integrated as an exponential
        # approach to 1 with the slope at the start of the step
        gap = 1.0 - np.maximum(s, 0.0) ** 1.6
        remainder = 1.0 - s
        advanced = 1.0 - remainder * np.exp(
            -self.stiffness / self.amplitude * np.abs(v) * dt * gap / (remainder + 1e-12)
        )
        return np.asarray(np.minimum(advanced, 1.0) * direction)[..., None]

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        return torque_at_joint(self.site.n, self.site.j, self.amplitude * z[..., 0])


@dataclass(frozen=True)
class IwanHysteresis(PhysicalEffect):
    """Iwan hysteresis: twelve Maxwell-slip elements in parallel, Σ clip(kᵢ(q − sᵢ), ±fᵢ).

    The breakaway displacements follow a power function (Iwan 1966; Segalman 2005).

    Attributes:
        site: Place of the effect.
        amplitude: Largest torque [N m].
        stiffness: Presliding stiffness [N m/rad].
    """

    site: EffectSite
    amplitude: float
    stiffness: float
    state_size = 12

    def _shares(self) -> tuple[FloatArray, FloatArray]:
        """Return each element's share of the torque [1] and its breakaway displacement [rad]."""
        breakaway = 2.2 * self.amplitude / self.stiffness * (np.arange(1, 13) / 12.0) ** 1.7
        share = np.ones(12) / 12.0
        stiff = float((share / breakaway).sum()) * self.amplitude
        return share, breakaway * stiff / self.stiffness

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        """Return the internal states after a time step `dt` [s]; see `PhysicalEffect`."""
        if self.amplitude == 0.0:
            return z
        _, breakaway = self._shares()
        return np.clip(z + (x.v[..., self.site.j] * dt)[..., None], -breakaway, breakaway)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        if self.amplitude == 0.0:
            return torque_at_joint(self.site.n, self.site.j, 0.0 * z[..., 0])
        share, breakaway = self._shares()
        return torque_at_joint(
            self.site.n, self.site.j, self.amplitude * (z / breakaway * share).sum(axis=-1)
        )


@dataclass(frozen=True)
class TimedThermalDrift(PhysicalEffect):
    """Friction that changes with run time: base friction times a sum of two exponentials.

    The second time constant is three times the first; their weights are 2 : 1.

    Attributes:
        site: Place of the effect.
        change: Relative change of the friction in the end [1].
        time_constant: First time constant [s].
    """

    site: EffectSite
    change: float
    time_constant: float

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        actuators, j, c = self.site.actuators, self.site.j, self.time_constant
        rise = (2.0 * (1.0 - np.exp(-x.t / c)) + (1.0 - np.exp(-x.t / (3.0 * c)))) / 3.0
        friction = (actuators.friction_torque(x.v) - actuators.offset)[..., j]
        return torque_at_joint(self.site.n, j, self.change * rise * friction)


@dataclass(frozen=True)
class SelfHeatingFriction(PhysicalEffect):
    """Friction that decreases as its own power heats the joint.

    Viscous friction is multiplied by e^{−κΔ}, Coulomb friction changes half as much. The
    temperature rise Δ cools with the time constant and is scaled so that the power at 40 % of the
    velocity limit makes it 1; κ is such that viscous friction then changes by `change`.

    Attributes:
        site: Place of the effect.
        change: Relative change of viscous friction at Δ = 1 [1].
        time_constant: Thermal time constant [s].
    """

    site: EffectSite
    change: float
    time_constant: float
    state_size = 1

    def _power(self, v: FloatArray) -> FloatArray:
        """Return the friction power over that at 40 % of the velocity limit [1]."""
        actuators, j = self.site.actuators, self.site.j
        top = 0.4 * self.site.velocity_limit[j]
        power = actuators.viscous[j] * v * v + actuators.coulomb[j] * np.abs(v)
        return power / (actuators.viscous[j] * top * top + actuators.coulomb[j] * top)

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        """Return the internal states after a time step `dt` [s]; see `PhysicalEffect`."""
        decay = np.exp(-dt / self.time_constant)
        return np.asarray(z[..., 0] * decay + (1.0 - decay) * self._power(x.v[..., self.site.j]))[
            ..., None
        ]

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        actuators, j = self.site.actuators, self.site.j
        v, kappa = x.v[..., j], -np.log1p(max(self.change, -0.95))
        relative_change = np.expm1(-kappa * z[..., 0])
        return torque_at_joint(
            self.site.n,
            j,
            relative_change * actuators.viscous[j] * v
            + 0.5 * relative_change * actuators.coulomb[j] * np.tanh(v / actuators.width[j]),
        )


def drag_power(site: EffectSite, p: Values) -> PhysicalEffect:
    """Drag c |v|^1.85 v₀^0.15 sgn(v) with v₀ = 0.5 v_max: turbulent, not quite quadratic."""
    v0 = 0.5 * site.velocity_limit[site.j]
    return memoryless_effect(
        site, lambda x: p["coefficient"] * smooth_sign(x.v) * np.abs(x.v) ** 1.85 * v0**0.15
    )


def drag_rounded(site: EffectSite, p: Values) -> PhysicalEffect:
    """Drag c v (√(v² + v₀²) − v₀) with v₀ = 0.1 v_max."""
    v0 = 0.1 * site.velocity_limit[site.j]
    return memoryless_effect(
        site, lambda x: p["coefficient"] * x.v * (np.sqrt(x.v * x.v + v0 * v0) - v0)
    )


def friction_algebraic(site: EffectSite, p: Values) -> PhysicalEffect:
    """Coulomb and viscous friction F_c v/√(v² + w²) + F_v v."""
    return memoryless_effect(site, lambda x: p["coulomb"] * smooth_sign(x.v) + p["viscous"] * x.v)


def friction_arctangent(site: EffectSite, p: Values) -> PhysicalEffect:
    """Coulomb and viscous friction F_c (2/π) atan(v/w) + F_v v, w = 2 mrad/s."""
    return memoryless_effect(
        site, lambda x: p["coulomb"] * (2.0 / np.pi) * np.arctan(x.v / 2e-3) + p["viscous"] * x.v
    )


def _coupled_friction(
    site: EffectSite, p: Values, ratio: float, sign_width: float
) -> PhysicalEffect:
    """Return the torque of a shaft that turns with v_j + ratio·v_i, beyond that of v_j alone.

    Args:
        site: Place of the effect; joint i is its `source`.
        p: Parameter values.
        ratio: Transmission ratio [1].
        sign_width: Speed over which Coulomb friction changes sign [rad/s].
    """
    i, j = site.source, site.j

    def model(x: JointStates) -> FloatArray:
        combined = x.v[..., j] + ratio * x.v[..., i]
        single = x.v[..., j]
        coulomb = p["coulomb"] * (np.tanh(combined / sign_width) - np.tanh(single / sign_width))
        return p["viscous"] * ratio * x.v[..., i] + coulomb + p["inertia"] * ratio * x.a[..., i]

    return CoupledJoints(site.n, j, model)


@dataclass(frozen=True)
class CoupledJoints(PhysicalEffect):
    """A torque at one joint that depends on the states of all joints.

    Attributes:
        n: Number of joints.
        j: Index of the joint that feels it.
        model: Function from the states of all joints to the torque [N m], shape (…).
    """

    n: int
    j: int
    model: Callable[[JointStates], FloatArray]

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        return torque_at_joint(self.n, self.j, self.model(x))


def coupling_sum(site: EffectSite, p: Values) -> PhysicalEffect:
    """Friction and inertia of a shaft that turns with v_j + v_i."""
    return _coupled_friction(site, p, 1.0, 8e-3)


def coupling_difference(site: EffectSite, p: Values) -> PhysicalEffect:
    """Friction and inertia of a shaft that turns with v_j − 0.9 v_i."""
    return _coupled_friction(site, p, -0.9, 12e-3)


def _velocity_at_1_over_e(ratio: float) -> ValueConversion:
    """Return a conversion to the Stribeck velocity of textbooks, (Fₛ − F_c) e^{−(v/vₛ)^δ}.

    There the excess friction is down to 1/e, for any δ.

    Args:
        ratio: That velocity over the model form's own parameter.
    """
    return lambda p: {"velocity": ratio * p["velocity"]}


def _time_to_1_minus_1_over_e(p: Values) -> Values:
    """Return the time constant at which 1 − 1/e of the change is done.

    It generalises the time constant to a response that is not of first order.
    """
    return {"time_constant": RISE_TIME_RATIO * p["time_constant"]}


RISE_TIME_RATIO = 1.42393068
"""Root x of (2 e^{−x} + e^{−x/3})/3 = 1/e; see `TimedThermalDrift`."""

AMPLITUDE = EffectParameter("amplitude", "N m", 0.005, 0.03, "torque")
"""Amplitude of a friction torque, as two effects have it."""
EFFECT_TYPES = (
    EffectType(
        "asymmetric_viscous",
        (
            EffectParameter("positive", "N m s/rad", 0.002, 0.006, "viscous"),
            EffectParameter(
                "negative", "N m s/rad", -0.006, -0.002, "viscous", bounded_by="viscous"
            ),
        ),
        {"tuning": asymmetric_blend, "scored": asymmetric_saturating},
    ),
    EffectType(
        "stribeck",
        (AMPLITUDE, EffectParameter("velocity", "rad/s", 0.02, 0.3, size_exponent=0.0)),
        {"tuning": stribeck_rational, "scored": stribeck_sech},
        conversions={
            "tuning": _velocity_at_1_over_e(np.sqrt(np.e - 1.0)),
            "scored": _velocity_at_1_over_e(np.arccosh(np.e)),
        },
    ),
    EffectType(
        "nonlinear_viscous",
        (
            EffectParameter("coefficient", "N m (s/rad)^exponent", 0.01, 0.05, "viscous"),
            EffectParameter("exponent", "1", 2.2, 3.2, size_exponent=0.0),
        ),
        {"tuning": viscous_power, "scored": viscous_rounded_power},
    ),
    EffectType(
        "load_friction",
        (EffectParameter("mu", "1", 0.03, 0.3, largest=0.6),),
        {"tuning": load_power, "scored": load_quadrants},
    ),
    EffectType(
        "position_friction",
        (
            EffectParameter("amplitude", "N m", 0.002, 0.01, "torque", bounded_by="coulomb"),
            EffectParameter("waves", "1", 1.0, 2.0, size_exponent=0.0, in_contract=False),
            phase_parameter(),
        ),
        {"tuning": position_triangle, "scored": position_bumps},
        conversions={"scored": _half_peak_to_peak},
    ),
    EffectType(
        "hysteresis",
        (
            AMPLITUDE,
            EffectParameter("stiffness", "N m/rad", 2.0, 30.0, "torque", size_exponent=0.0),
        ),
        {
            "tuning": lambda site, p: BoucWenHysteresis(site, p["amplitude"], p["stiffness"]),
            "scored": lambda site, p: IwanHysteresis(site, p["amplitude"], p["stiffness"]),
        },
    ),
    EffectType(
        "thermal_drift",
        (
            EffectParameter("change", "1", -0.7, -0.2, largest=0.9),
            EffectParameter("time_constant", "s", 5.0, 30.0, size_exponent=0.0),
        ),
        {
            "tuning": lambda site, p: TimedThermalDrift(site, p["change"], p["time_constant"]),
            "scored": lambda site, p: SelfHeatingFriction(site, p["change"], p["time_constant"]),
        },
        conversions={"tuning": _time_to_1_minus_1_over_e},
    ),
    EffectType(
        "drag",
        (EffectParameter("coefficient", "N m s²/rad²", 0.01, 0.06, "square"),),
        {"tuning": drag_power, "scored": drag_rounded},
    ),
    EffectType(
        "friction",
        (
            EffectParameter("coulomb", "N m", 0.01, 0.03, "torque"),
            EffectParameter("viscous", "N m s/rad", 0.01, 0.03, "viscous"),
        ),
        {"tuning": friction_algebraic, "scored": friction_arctangent},
    ),
    EffectType(
        "coupling",
        (
            EffectParameter("viscous", "N m s/rad", 0.01, 0.03, "viscous"),
            EffectParameter("coulomb", "N m", 0.01, 0.03, "torque"),
            EffectParameter("inertia", "kg m²", 0.002, 0.02, "inertia"),
        ),
        {"tuning": coupling_sum, "scored": coupling_difference},
    ),
)
