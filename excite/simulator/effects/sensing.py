"""What the robot tells of itself: torque through currents and gains, position through encoders, both on a clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..._types import FloatArray
from ..physical_effect import PhysicalEffect
from .effect_type import EffectParameter, EffectSite, EffectType, phase_parameter

Values = Mapping[str, float]
READING_RADIUS_RATIO = 1.5
"""Of an eccentric disc, where it is read, over how far it is off its centre."""


@dataclass(frozen=True)
class MisreportedTorque(PhysicalEffect):
    """A torque told otherwise than it is. law: (times, true torque) of one joint to what is told. Shapes (N,)."""

    j: int
    law: Callable[[FloatArray, FloatArray], FloatArray]

    def measured_torque(
        self, torque: Callable[[FloatArray], FloatArray], t: FloatArray
    ) -> FloatArray:
        out = torque(t).copy()
        out[:, self.j] = self.law(t, out[:, self.j])
        return out


def gain_constant(site: EffectSite, p: Values) -> PhysicalEffect:
    """τ/g."""
    return MisreportedTorque(site.j, lambda t, tau: tau / p["gain"])


def gain_periodic(site: EffectSite, p: Values) -> PhysicalEffect:
    """τ/(1 + (g − 1)(1 + 0.1 sin(2πt/23 s))): magnets that warm and cool."""
    return MisreportedTorque(
        site.j,
        lambda t, tau: (
            tau / (1.0 + (p["gain"] - 1.0) * (1.0 + 0.1 * np.sin(2.0 * np.pi * t / 23.0)))
        ),
    )


def saturation_cubic(site: EffectSite, p: Values) -> PhysicalEffect:
    """τ (1 + λ|τ/τ₁|³): current that grows faster than torque; τ₁ = `at`, λ = loss/(1 − loss)."""
    more, at = p["loss"] / max(1.0 - p["loss"], 0.05), p["at"]
    return MisreportedTorque(site.j, lambda t, tau: tau * (1.0 + more * np.abs(tau / at) ** 3))


def saturation_knee(site: EffectSite, p: Values) -> PhysicalEffect:
    """τ (1 + λ k²), k the part of |τ|/τ₁ beyond 0.4 over 0.6: linear iron up to a knee."""
    more, at = p["loss"] / max(1.0 - p["loss"], 0.05), p["at"]
    return MisreportedTorque(
        site.j,
        lambda t, tau: (
            tau * (1.0 + more * np.square(np.maximum(np.abs(tau) / at - 0.4, 0.0) / 0.6))
        ),
    )


@dataclass(frozen=True)
class DelayedTorque(PhysicalEffect):
    """τ(t − d), or spread: the mean of τ(t − d(1 + x)/2) over x from the exponential distribution (half dead time, half lag).

    joints: those that are late.
    """

    joints: tuple[int, ...]
    seconds: float
    spread: bool

    def measured_torque(
        self, torque: Callable[[FloatArray], FloatArray], t: FloatArray
    ) -> FloatArray:
        out = torque(t).copy()
        if self.seconds == 0.0:
            return out
        nodes, weights = (
            np.polynomial.laguerre.laggauss(4) if self.spread else (np.ones(1), np.ones(1))
        )
        late = sum(
            w * torque(t - 0.5 * self.seconds * (1.0 + x))
            for x, w in zip(nodes, weights, strict=True)
        )
        out[:, list(self.joints)] = np.asarray(late)[:, list(self.joints)]
        return out


def _delayed_torque(site: EffectSite, p: Values, spread: bool) -> PhysicalEffect:
    return DelayedTorque((site.j,) if site.joint else tuple(range(site.n)), p["seconds"], spread)


@dataclass(frozen=True)
class MisreadPosition(PhysicalEffect):
    """q + ε(q) at one joint. law: position to error. Shapes (…)."""

    j: int
    law: Callable[[FloatArray], FloatArray]

    def measured_position(self, q: FloatArray) -> FloatArray:
        out = np.array(q)
        out[..., self.j] += self.law(q[..., self.j])
        return out


def encoder_harmonics(site: EffectSite, p: Values) -> PhysicalEffect:
    """A (sin(Nq + φ) + 0.4 sin(2Nq + 2.3φ))."""
    n, phase = p["order"], p["phase"]
    return MisreadPosition(
        site.j,
        lambda q: (
            p["amplitude"] * (np.sin(n * q + phase) + 0.4 * np.sin(2.0 * n * q + 2.3 * phase))
        ),
    )


def encoder_eccentric(site: EffectSite, p: Values) -> PhysicalEffect:
    """2A sin θ/(1.5 + cos θ), θ = Nq + φ: a disc off its centre, read close to its edge."""
    n, phase = p["order"], p["phase"]
    return MisreadPosition(
        site.j,
        lambda q: (
            2.0
            * p["amplitude"]
            * np.sin(n * q + phase)
            / (READING_RADIUS_RATIO + np.cos(n * q + phase))
        ),
    )


def _fundamental(p: Values) -> Values:
    """The wave of the order named, from sin θ/(a + cos θ) = 2 Σ (−1)ᵏ⁺¹ rᵏ sin kθ with r = a − √(a² − 1)."""
    return {
        "amplitude": 4.0
        * (READING_RADIUS_RATIO - np.sqrt(READING_RADIUS_RATIO**2 - 1.0))
        * p["amplitude"]
    }


EFFECT_TYPES = (
    EffectType(
        "torque_gain",
        (EffectParameter("gain", "1", 1.05, 1.2, about=1.0),),
        {"tuning": gain_constant, "scored": gain_periodic},
    ),
    EffectType(
        "torque_saturation",
        (
            EffectParameter("loss", "1", 0.03, 0.15, most=0.7),
            EffectParameter("at", "N m", 0.4, 0.4, "torque", power=0.0, stated=False),
        ),
        {"tuning": saturation_cubic, "scored": saturation_knee},
    ),
    EffectType(
        "delay",
        (EffectParameter("seconds", "s", 5e-4, 5e-3),),
        {
            "tuning": lambda site, p: _delayed_torque(site, p, False),
            "scored": lambda site, p: _delayed_torque(site, p, True),
        },
        place="either",
    ),
    EffectType(
        "encoder_error",
        (
            EffectParameter("amplitude", "rad", 2e-4, 2e-3),
            EffectParameter("order", "1/turn", 1.0, 4.0, power=0.0),
            phase_parameter(),
        ),
        {"tuning": encoder_harmonics, "scored": encoder_eccentric},
        conversions={"scored": _fundamental},
    ),
)
