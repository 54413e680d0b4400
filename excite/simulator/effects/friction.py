"""Friction beyond viscous and Coulomb: by speed, direction, load, position, past, heat.

Each kind has two forms, and neither is the one a catalogue would fit.
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
    """(½(p+n) + ½(p−n) tanh(v/50 mrad/s)) v."""
    mean, half = 0.5 * (p["positive"] + p["negative"]), 0.5 * (p["positive"] - p["negative"])
    return memoryless_effect(site, lambda x: (mean + half * np.tanh(x.v / 0.05)) * x.v)


def asymmetric_saturating(site: EffectSite, p: Values) -> PhysicalEffect:
    """p v, n v by direction, each bent: v/(1 + 0.1|v|/v_max)."""
    top = site.speed[site.j]
    return memoryless_effect(
        site,
        lambda x: (
            np.where(x.v > 0.0, p["positive"], p["negative"])
            * x.v
            / (1.0 + 0.1 * np.abs(x.v) / top)
        ),
    )


def stribeck_rational(site: EffectSite, p: Values) -> PhysicalEffect:
    """A sgn(v)/(1 + (v/vₛ)²) (Hess and Soom, where catalogues have a Gaussian or an exponential)."""
    return memoryless_effect(
        site, lambda x: p["amplitude"] * smooth_sign(x.v) / (1.0 + np.square(x.v / p["velocity"]))
    )


def stribeck_sech(site: EffectSite, p: Values) -> PhysicalEffect:
    """A sgn(v)/cosh(v/vₛ) (Makkar et al. 2005 use such smooth forms)."""
    return memoryless_effect(
        site,
        lambda x: (
            p["amplitude"]
            * smooth_sign(x.v)
            / np.cosh(np.minimum(np.abs(x.v) / p["velocity"], 50.0))
        ),
    )


def viscous_power(site: EffectSite, p: Values) -> PhysicalEffect:
    """c |v|ᵏ sgn(v), k no half or whole number."""
    return memoryless_effect(
        site, lambda x: p["coefficient"] * smooth_sign(x.v) * np.abs(x.v) ** p["exponent"]
    )


def viscous_rounded_power(site: EffectSite, p: Values) -> PhysicalEffect:
    """c ((v² + v₀²)^(k/2) − v₀ᵏ) sgn(v), v₀ a tenth of the top speed."""
    v0 = 0.1 * site.speed[site.j]
    k = p["exponent"]
    return memoryless_effect(
        site,
        lambda x: (
            p["coefficient"] * smooth_sign(x.v) * ((x.v * x.v + v0 * v0) ** (0.5 * k) - v0**k)
        ),
    )


def load_power(site: EffectSite, p: Values) -> PhysicalEffect:
    """μ |τ|^1.15 sgn(v), scaled to μ|τ| at a quarter of the torque limit."""
    at = 0.25 * site.torque[site.j]
    return memoryless_effect(
        site, lambda x: p["mu"] * smooth_sign(x.v) * np.abs(x.load) * (np.abs(x.load) / at) ** 0.15
    )


def load_quadrants(site: EffectSite, p: Values) -> PhysicalEffect:
    """μ|τ| sgn(v), a fifth more when the load drives the joint and a fifth less when the motor does (worm and planetary gears)."""
    half = 0.02 * site.torque[site.j]
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
    """A tri(kq + φ) sgn(v): a triangular wave in position."""
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
    """A (e^{4(cos(kq+φ)−1)} + ½ e^{8(cos(kq+2φ)−1)}) sgn(v): two tight spots."""
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
    """Two tight spots at 0 of two angles, the second half as high and narrower."""
    return np.asarray(np.exp(4 * (np.cos(first) - 1)) + 0.5 * np.exp(8 * (np.cos(second) - 1)))


def _half_peak_to_peak(p: Values) -> Values:
    """An amplitude is half of what lies between highest and lowest: the mean is the base model's Coulomb friction."""
    turn = np.linspace(0.0, 2.0 * np.pi, 3600)
    return {
        "amplitude": 0.5 * p["amplitude"] * float(np.ptp(_two_tight_spots(turn, turn + p["phase"])))
    }


@dataclass(frozen=True)
class BoucWenHysteresis(PhysicalEffect):
    """A z, ż = (k/A)(v − ½|v||z|^(m−1) z − ½ v|z|ᵐ), m = 1.6; steps are exact for the slope at their start."""

    site: EffectSite
    amplitude: float
    stiffness: float
    state_size = 1

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        if self.amplitude == 0.0:
            return z
        v = x.v[..., self.site.j]
        side = np.copysign(1.0, v)
        s = z[..., 0] * side
        # with s = z sgn(v): ds/dt = (k/A)|v|(1 − |s|^m [s > 0]), towards 1 exponentially with the slope that the law has here
        gap = 1.0 - np.maximum(s, 0.0) ** 1.6
        left = 1.0 - s
        moved = 1.0 - left * np.exp(
            -self.stiffness / self.amplitude * np.abs(v) * dt * gap / (left + 1e-12)
        )
        return np.asarray(np.minimum(moved, 1.0) * side)[..., None]

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        return torque_at_joint(self.site.n, self.site.j, self.amplitude * z[..., 0])


@dataclass(frozen=True)
class IwanHysteresis(PhysicalEffect):
    """Twelve slip elements in parallel whose breakaways follow a power law (Iwan 1966; Segalman 2005): Σ clip(kᵢ(q − sᵢ), ±fᵢ)."""

    site: EffectSite
    amplitude: float
    stiffness: float
    state_size = 12

    def _shares(self) -> tuple[FloatArray, FloatArray]:
        """Share of the force and breakaway way of each element [1, rad]."""
        reach = 2.2 * self.amplitude / self.stiffness * (np.arange(1, 13) / 12.0) ** 1.7
        share = np.ones(12) / 12.0
        stiff = float((share / reach).sum()) * self.amplitude
        return share, reach * stiff / self.stiffness

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        if self.amplitude == 0.0:
            return z
        _, reach = self._shares()
        return np.clip(z + (x.v[..., self.site.j] * dt)[..., None], -reach, reach)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        if self.amplitude == 0.0:
            return torque_at_joint(self.site.n, self.site.j, 0.0 * z[..., 0])
        share, reach = self._shares()
        return torque_at_joint(
            self.site.n, self.site.j, self.amplitude * (z / reach * share).sum(axis=-1)
        )


@dataclass(frozen=True)
class TimedThermalDrift(PhysicalEffect):
    """Base friction times s(t): two time constants, the second three times the first, weighed 2 : 1."""

    site: EffectSite
    change: float
    constant: float

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        drive, j, c = self.site.drive, self.site.j, self.constant
        rise = (2.0 * (1.0 - np.exp(-x.t / c)) + (1.0 - np.exp(-x.t / (3.0 * c)))) / 3.0
        friction = (drive.friction_torque(x.v) - drive.offset)[..., j]
        return torque_at_joint(self.site.n, j, self.change * rise * friction)


@dataclass(frozen=True)
class SelfHeatingFriction(PhysicalEffect):
    """Viscous friction × e^{−κΔ}, Coulomb half as much; Δ is heated by the friction's own power and cools with the time constant.

    Δ is scaled so that the power of full speed makes it 1; κ so that it changes friction by `change` there.
    """

    site: EffectSite
    change: float
    constant: float
    state_size = 1

    def _power(self, v: FloatArray) -> FloatArray:
        drive, j = self.site.drive, self.site.j
        top = 0.4 * self.site.speed[j]
        own = drive.viscous[j] * v * v + drive.coulomb[j] * np.abs(v)
        return own / (drive.viscous[j] * top * top + drive.coulomb[j] * top)

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        keep = np.exp(-dt / self.constant)
        return np.asarray(z[..., 0] * keep + (1.0 - keep) * self._power(x.v[..., self.site.j]))[
            ..., None
        ]

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        drive, j = self.site.drive, self.site.j
        v, kappa = x.v[..., j], -np.log1p(max(self.change, -0.95))
        less = np.expm1(-kappa * z[..., 0])
        return torque_at_joint(
            self.site.n,
            j,
            less * drive.viscous[j] * v
            + 0.5 * less * drive.coulomb[j] * np.tanh(v / drive.width[j]),
        )


def drag_power(site: EffectSite, p: Values) -> PhysicalEffect:
    """c |v|^1.85 sgn(v) v₀^0.15: turbulent, not quite square; v₀ half of the top speed."""
    v0 = 0.5 * site.speed[site.j]
    return memoryless_effect(
        site, lambda x: p["coefficient"] * smooth_sign(x.v) * np.abs(x.v) ** 1.85 * v0**0.15
    )


def drag_rounded(site: EffectSite, p: Values) -> PhysicalEffect:
    """c v √(v² + v₀²) − c v₀ v, v₀ a tenth of the top speed."""
    v0 = 0.1 * site.speed[site.j]
    return memoryless_effect(
        site, lambda x: p["coefficient"] * x.v * (np.sqrt(x.v * x.v + v0 * v0) - v0)
    )


def friction_algebraic(site: EffectSite, p: Values) -> PhysicalEffect:
    """F_c v/√(v² + w²) + F_v v."""
    return memoryless_effect(site, lambda x: p["coulomb"] * smooth_sign(x.v) + p["viscous"] * x.v)


def friction_arctangent(site: EffectSite, p: Values) -> PhysicalEffect:
    """F_c (2/π) atan(v/w) + F_v v."""
    return memoryless_effect(
        site, lambda x: p["coulomb"] * (2.0 / np.pi) * np.arctan(x.v / 2e-3) + p["viscous"] * x.v
    )


def _coupled_friction(site: EffectSite, p: Values, ratio: float, bend: float) -> PhysicalEffect:
    i, j = site.source, site.j

    def law(x: JointStates) -> FloatArray:
        both = x.v[..., j] + ratio * x.v[..., i]
        alone = x.v[..., j]
        coulomb = p["coulomb"] * (np.tanh(both / bend) - np.tanh(alone / bend))
        return p["viscous"] * ratio * x.v[..., i] + coulomb + p["inertia"] * ratio * x.a[..., i]

    return CoupledJoints(site.n, j, law)


@dataclass(frozen=True)
class CoupledJoints(PhysicalEffect):
    """A torque at one joint that depends on the motion of all."""

    n: int
    j: int
    law: Callable[[JointStates], FloatArray]

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        return torque_at_joint(self.n, self.j, self.law(x))


def coupling_sum(site: EffectSite, p: Values) -> PhysicalEffect:
    """Friction and inertia of a shaft that turns with v_j + v_i, beyond those of v_j alone."""
    return _coupled_friction(site, p, 1.0, 8e-3)


def coupling_difference(site: EffectSite, p: Values) -> PhysicalEffect:
    """The same with v_j − 0.9 v_i."""
    return _coupled_friction(site, p, -0.9, 12e-3)


def _velocity_at_1_over_e(times: float) -> ValueConversion:
    """The speed of textbooks, (Fₛ − F_c) e^{−(v/vₛ)^δ}: where the excess is down to 1/e, whatever δ; `times` the law's own."""
    return lambda p: {"velocity": times * p["velocity"]}


def _time_to_1_minus_1_over_e(p: Values) -> Values:
    """When 1 − 1/e of the change is done, as the time constant of a response that is not of first order."""
    return {"time_constant": RISE_TIME_RATIO * p["time_constant"]}


RISE_TIME_RATIO = 1.42393068
"""Root of (2 e^{−x} + e^{−x/3})/3 = 1/e: see `Warming`."""
AMPLITUDE = EffectParameter("amplitude", "N m", 0.005, 0.03, "torque")
EFFECT_TYPES = (
    EffectType(
        "asymmetric_viscous",
        (
            EffectParameter("positive", "N m s/rad", 0.002, 0.006, "viscous"),
            EffectParameter("negative", "N m s/rad", -0.006, -0.002, "viscous", within="viscous"),
        ),
        {"tuning": asymmetric_blend, "scored": asymmetric_saturating},
    ),
    EffectType(
        "stribeck",
        (AMPLITUDE, EffectParameter("velocity", "rad/s", 0.02, 0.3, power=0.0)),
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
            EffectParameter("exponent", "1", 2.2, 3.2, power=0.0),
        ),
        {"tuning": viscous_power, "scored": viscous_rounded_power},
    ),
    EffectType(
        "load_friction",
        (EffectParameter("mu", "1", 0.03, 0.3, most=0.6),),
        {"tuning": load_power, "scored": load_quadrants},
    ),
    EffectType(
        "position_friction",
        (
            EffectParameter("amplitude", "N m", 0.002, 0.01, "torque", within="coulomb"),
            EffectParameter("waves", "1", 1.0, 2.0, power=0.0, stated=False),
            phase_parameter(),
        ),
        {"tuning": position_triangle, "scored": position_bumps},
        conversions={"scored": _half_peak_to_peak},
    ),
    EffectType(
        "hysteresis",
        (AMPLITUDE, EffectParameter("stiffness", "N m/rad", 2.0, 30.0, "torque", power=0.0)),
        {
            "tuning": lambda site, p: BoucWenHysteresis(site, p["amplitude"], p["stiffness"]),
            "scored": lambda site, p: IwanHysteresis(site, p["amplitude"], p["stiffness"]),
        },
    ),
    EffectType(
        "thermal_drift",
        (
            EffectParameter("change", "1", -0.7, -0.2, most=0.9),
            EffectParameter("time_constant", "s", 5.0, 30.0, power=0.0),
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
