"""Errors of the reported signals: torque gain and saturation, delay, encoder error."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..._types import FloatArray
from ..physical_effect import PhysicalEffect
from .effect_type import EffectParameter, EffectSite, EffectType, phase_parameter

Values = Mapping[str, float]
READING_RADIUS_RATIO = 1.5
"""Reading radius of an eccentric encoder disc, over its eccentricity."""


@dataclass(frozen=True)
class MisreportedTorque(PhysicalEffect):
    """A joint torque that is reported with an error.

    Attributes:
        j: Index of the joint.
        model: Function of times and true torques, both of shape (N,), to the reported torques.
    """

    j: int
    model: Callable[[FloatArray, FloatArray], FloatArray]

    def measured_torque(
        self, torque: Callable[[FloatArray], FloatArray], t: FloatArray
    ) -> FloatArray:
        """Return the torque that the robot reports at times t, shape (N, n) [N m]."""
        out = torque(t).copy()
        out[:, self.j] = self.model(t, out[:, self.j])
        return out


def gain_constant(site: EffectSite, p: Values) -> PhysicalEffect:
    """A wrong torque constant: reported τ/g."""
    return MisreportedTorque(site.j, lambda t, tau: tau / p["gain"])


def gain_periodic(site: EffectSite, p: Values) -> PhysicalEffect:
    """A torque constant that varies with time: τ/(1 + (g − 1)(1 + 0.1 sin(2πt/23 s)))."""
    return MisreportedTorque(
        site.j,
        lambda t, tau: (
            tau / (1.0 + (p["gain"] - 1.0) * (1.0 + 0.1 * np.sin(2.0 * np.pi * t / 23.0)))
        ),
    )


def saturation_cubic(site: EffectSite, p: Values) -> PhysicalEffect:
    """Saturation: reported τ (1 + λ|τ/τ₁|³) with τ₁ = `at` and λ = loss/(1 − loss)."""
    slope, at = p["loss"] / max(1.0 - p["loss"], 0.05), p["at"]
    return MisreportedTorque(site.j, lambda t, tau: tau * (1.0 + slope * np.abs(tau / at) ** 3))


def saturation_knee(site: EffectSite, p: Values) -> PhysicalEffect:
    """Saturation above a knee: τ (1 + λ k²), k = max(|τ|/τ₁ − 0.4, 0)/0.6."""
    slope, at = p["loss"] / max(1.0 - p["loss"], 0.05), p["at"]
    return MisreportedTorque(
        site.j,
        lambda t, tau: (
            tau * (1.0 + slope * np.square(np.maximum(np.abs(tau) / at - 0.4, 0.0) / 0.6))
        ),
    )


@dataclass(frozen=True)
class DelayedTorque(PhysicalEffect):
    """A torque that is reported late.

    Attributes:
        joints: Indices of the joints concerned.
        seconds: Delay d [s].
        spread: False: τ(t − d). True: half dead time, half lag, the mean of τ(t − d(1 + x)/2) over
            exponentially distributed x.
    """

    joints: tuple[int, ...]
    seconds: float
    spread: bool

    def measured_torque(
        self, torque: Callable[[FloatArray], FloatArray], t: FloatArray
    ) -> FloatArray:
        """Return the torque that the robot reports at times t, shape (N, n) [N m]."""
        out = torque(t).copy()
        if self.seconds == 0.0:
            return out
        nodes, weights = (
            np.polynomial.laguerre.laggauss(4) if self.spread else (np.ones(1), np.ones(1))
        )
        delayed = sum(
            w * torque(t - 0.5 * self.seconds * (1.0 + x))
            for x, w in zip(nodes, weights, strict=True)
        )
        out[:, list(self.joints)] = np.asarray(delayed)[:, list(self.joints)]
        return out


def _delayed_torque(site: EffectSite, p: Values, spread: bool) -> PhysicalEffect:
    """Build the delay of one joint, or of all where the site names none."""
    return DelayedTorque((site.j,) if site.joint else tuple(range(site.n)), p["seconds"], spread)


@dataclass(frozen=True)
class MisreadPosition(PhysicalEffect):
    """A position error ε(q) of one joint's encoder.

    Attributes:
        j: Index of the joint.
        model: Function from position to error [rad], shapes (…).
    """

    j: int
    model: Callable[[FloatArray], FloatArray]

    def measured_position(self, q: FloatArray) -> FloatArray:
        """Return the position that the encoder reports, shape (…, n) [rad]."""
        out = np.array(q)
        out[..., self.j] += self.model(q[..., self.j])
        return out


def encoder_harmonics(site: EffectSite, p: Values) -> PhysicalEffect:
    """Two harmonics: A (sin(Nq + φ) + 0.4 sin(2Nq + 2.3φ))."""
    n, phase = p["order"], p["phase"]
    return MisreadPosition(
        site.j,
        lambda q: (
            p["amplitude"] * (np.sin(n * q + phase) + 0.4 * np.sin(2.0 * n * q + 2.3 * phase))
        ),
    )


def encoder_eccentric(site: EffectSite, p: Values) -> PhysicalEffect:
    """An eccentric disc read near its edge: 2A sin θ/(1.5 + cos θ), θ = Nq + φ."""
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
    """Return the amplitude of the order named.

    sin θ/(a + cos θ) = 2 Σ (−1)ᵏ⁺¹ rᵏ sin kθ with r = a − √(a² − 1).
    """
    return {
        "amplitude": 4.0
        * (READING_RADIUS_RATIO - np.sqrt(READING_RADIUS_RATIO**2 - 1.0))
        * p["amplitude"]
    }


EFFECT_TYPES = (
    EffectType(
        "torque_gain",
        (EffectParameter("gain", "1", 1.05, 1.2, neutral_value=1.0),),
        {"tuning": gain_constant, "scored": gain_periodic},
    ),
    EffectType(
        "torque_saturation",
        (
            EffectParameter("loss", "1", 0.03, 0.15, largest=0.7),
            EffectParameter("at", "N m", 0.4, 0.4, "torque", size_exponent=0.0, in_contract=False),
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
            EffectParameter("order", "1/turn", 1.0, 4.0, size_exponent=0.0),
            phase_parameter(),
        ),
        {"tuning": encoder_harmonics, "scored": encoder_eccentric},
        conversions={"scored": _fundamental},
    ),
)
