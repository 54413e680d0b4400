"""Elasticity and backlash between motor and link, and torque ripple of the gear mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import exp, log1p

import numpy as np
from scipy.special import jv

from ..._types import FloatArray
from ..physical_effect import JointStates, PhysicalEffect, TransmissionSpring
from .effect_type import EffectParameter, EffectSite, EffectType, memoryless_effect, phase_parameter

Values = Mapping[str, float]
MESH_WAVE_SKEW = 0.4
"""Skew m of a loaded mesh's wave sin(θ + m sin θ) [rad]."""
DEFLECTION_DAMPING_RATIO = 0.04
"""Damping ratio of the motor's oscillation against its link."""


@dataclass(frozen=True)
class ElasticTransmission(PhysicalEffect):
    """Base of the effects between motor and link: elasticity and backlash.

    Motor and link are two masses, connected by a spring whose torque over the deflection each
    derived class defines.

    Attributes:
        site: Place of the effect.
        stiffness: Stiffness [N m/rad].
        width: Total backlash [rad]; 0 for an elastic transmission without backlash.
    """

    site: EffectSite
    stiffness: float
    width: float = 0.0

    @cached_property
    def damping(self) -> float:
        """Damping of the deflection [N m s/rad]."""
        return (
            2.0
            * DEFLECTION_DAMPING_RATIO
            * float(np.sqrt(self.stiffness * self.site.actuators.inertia[self.site.j]))
        )

    def transmission_spring(self) -> TransmissionSpring:
        """Return the spring between motor and link."""
        return TransmissionSpring(self.site.j, self.torque_and_slopes)

    def torque_and_slopes(self, d: float, rate: float) -> tuple[float, float, float]:
        """Return the transmitted torque and its derivatives with respect to deflection and rate.

        Args:
            d: Deflection θ − q [rad].
            rate: Its rate [rad/s].

        Returns:
            Torque [N m], stiffness [N m/rad] and damping [N m s/rad].
        """
        raise NotImplementedError


@dataclass(frozen=True)
class HardeningSpring(ElasticTransmission):
    """A hardening spring K δ (1 + (δ/δ₀)²) where K δ₀ is twice the torque limit."""

    def torque_and_slopes(self, d: float, rate: float) -> tuple[float, float, float]:
        """Return transmitted torque, stiffness and damping at a deflection d and its rate."""
        hardening = (d * self.stiffness / (2.0 * float(self.site.torque_limit[self.site.j]))) ** 2
        return (
            self.stiffness * d * (1.0 + hardening) + self.damping * rate,
            self.stiffness * (1.0 + 3.0 * hardening),
            self.damping,
        )


@dataclass(frozen=True)
class StrainWaveGear(ElasticTransmission):
    """A strain-wave gear: stiffness 0.7 K for small and 1.3 K for large torques.

    Makers of such gears state their stiffness in sections; the change is smooth, at a tenth of the
    torque limit.
    """

    @cached_property
    def scale(self) -> float:
        """Deflection at which the stiffness changes [rad]."""
        return 0.1 * float(self.site.torque_limit[self.site.j]) / self.stiffness

    def torque_and_slopes(self, d: float, rate: float) -> tuple[float, float, float]:
        """Return transmitted torque, stiffness and damping at a deflection d and its rate."""
        scale = self.scale
        bend = abs(d) / scale
        torque = self.stiffness * (
            0.7 * d + 0.6 * (abs(d) - scale * log1p(bend)) * (1.0 if d > 0.0 else -1.0)
        )
        slope = self.stiffness * (0.7 + 0.6 * bend / (1.0 + bend))
        return torque + self.damping * rate, slope, self.damping


@dataclass(frozen=True)
class DeadZoneBacklash(ElasticTransmission):
    """Backlash as a dead zone: no torque within ±w/2, a stiff spring beyond.

    It is damped in contact only.
    """

    def torque_and_slopes(self, d: float, rate: float) -> tuple[float, float, float]:
        """Return transmitted torque, stiffness and damping at a deflection d and its rate."""
        half = 0.5 * self.width
        beyond = d - half if d > half else d + half if d < -half else 0.0
        # lubricant transmits some torque within the gap, so the stiffness never vanishes
        slope = self.stiffness if beyond != 0.0 else 1e-3 * self.stiffness
        damp = self.damping if beyond != 0.0 else 0.05 * self.damping
        free = 1e-3 * self.stiffness * (d - beyond)
        return self.stiffness * beyond + free + damp * rate, slope, damp


@dataclass(frozen=True)
class SmoothBacklash(ElasticTransmission):
    """Backlash with soft gap boundaries: a softplus over a tenth of the width on either side."""

    def torque_and_slopes(self, d: float, rate: float) -> tuple[float, float, float]:
        """Return transmitted torque, stiffness and damping at a deflection d and its rate."""
        half, soft = 0.5 * self.width, 0.1 * self.width
        torque, slope = 1e-3 * self.stiffness * d, 1e-3 * self.stiffness
        for side in (1.0, -1.0):
            x = (side * d - half) / soft
            torque += side * self.stiffness * soft * (x if x > 30.0 else log1p(exp(max(x, -60.0))))
            slope += self.stiffness / (1.0 + exp(-min(max(x, -60.0), 60.0)))
        damp = self.damping * slope / self.stiffness
        return torque + damp * rate, slope, damp


def _gear_stiffness(site: EffectSite) -> float:
    """Return the stiffness of a gear with backlash: 0.5 mrad at the torque limit [N m/rad]."""
    return float(site.torque_limit[site.j]) / 5e-4


def ripple_pair(site: EffectSite, p: Values) -> PhysicalEffect:
    """Torque ripple A (cos(Nq + φ) + 0.6 cos(1.37 Nq + 2φ)): two meshes of irrational ratio."""
    order, phase = p["order"], p["phase"]
    return memoryless_effect(
        site,
        lambda x: (
            p["amplitude"]
            * (np.cos(order * x.q + phase) + 0.6 * np.cos(1.37 * order * x.q + 2 * phase))
        ),
    )


def ripple_loaded(site: EffectSite, p: Values) -> PhysicalEffect:
    """Torque ripple A (1 + ½ τ/τ_max) sin(θ + 0.4 sin θ), θ = Nq + φ: it grows with load."""
    order, phase, torque_limit = p["order"], p["phase"], site.torque_limit[site.j]

    def model(x: JointStates) -> FloatArray:
        turn = order * x.q + phase
        return (
            p["amplitude"]
            * (1.0 + 0.5 * x.load / torque_limit)
            * np.sin(turn + MESH_WAVE_SKEW * np.sin(turn))
        )

    return memoryless_effect(site, model)


def _fundamental(p: Values) -> Values:
    """Return the amplitude of the order named, without load.

    sin(θ + m sin θ) = Σ Jₖ(m) sin (k + 1)θ over all integers k (Jacobi-Anger expansion).
    """
    return {"amplitude": float(jv(0, MESH_WAVE_SKEW) - jv(2, MESH_WAVE_SKEW)) * p["amplitude"]}


EFFECT_TYPES = (
    EffectType(
        "elasticity",
        (EffectParameter("stiffness", "N m/rad", 50.0, 400.0, "torque", size_exponent=-1.0),),
        {
            "tuning": lambda site, p: HardeningSpring(site, p["stiffness"]),
            "scored": lambda site, p: StrainWaveGear(site, p["stiffness"]),
        },
        omitted_at_zero=True,
    ),
    EffectType(
        "backlash",
        (EffectParameter("width", "rad", 1e-4, 3e-3),),
        {
            "tuning": lambda site, p: DeadZoneBacklash(site, _gear_stiffness(site), p["width"]),
            "scored": lambda site, p: SmoothBacklash(site, _gear_stiffness(site), p["width"]),
        },
        omitted_at_zero=True,
    ),
    EffectType(
        "torque_ripple",
        (
            EffectParameter("order", "1/turn", 6.0, 60.0, size_exponent=0.0),
            EffectParameter("amplitude", "N m", 0.005, 0.05, "torque"),
            phase_parameter(),
        ),
        {"tuning": ripple_pair, "scored": ripple_loaded},
        conversions={"scored": _fundamental},
    ),
)
