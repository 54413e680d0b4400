"""Physics that no name of the contract takes: the right answer is `unknown`."""

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
    memoryless_effect,
    phase_parameter,
    torque_at_joint,
)

Values = Mapping[str, float]


def tooth_defect(site: EffectSite, p: Values) -> PhysicalEffect:
    """A bump wherever a broken tooth meshes under load of one sign: A e^{−(Δ/w)²} at five angles in no order."""
    places = (
        np.modf(np.arange(1, 6) * (np.sqrt(5.0) - 1.0) / 2.0 + p["phase"] / (2 * np.pi))[0] * 4.0
        - 2.0
    )
    top = 0.02 * site.torque[site.j]

    def law(x: JointStates) -> FloatArray:
        away = (x.q[..., None] - places) / p["breadth"]
        return (
            p["amplitude"]
            * np.exp(-np.square(away)).sum(axis=-1)
            * 0.5
            * (1.0 + np.tanh(x.load / top))
        )

    return memoryless_effect(site, law)


@dataclass(frozen=True)
class SloshingLiquid(PhysicalEffect):
    """A liquid in the link: an oscillator z̈ + 2ζω ż + ω² z = −v̇ whose reaction I ω² z + 2ζωI ż loads the joint."""

    site: EffectSite
    inertia: float
    frequency: float
    damping: float
    state_size = 2

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        w = 2.0 * np.pi * self.frequency
        rate = (z[..., 1] - dt * (x.a[..., self.site.j] + w * w * z[..., 0])) / (
            1.0 + dt * (2.0 * self.damping * w + dt * w * w)
        )
        return np.stack(np.broadcast_arrays(z[..., 0] + dt * rate, rate), axis=-1)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        w = 2.0 * np.pi * self.frequency
        return torque_at_joint(
            self.site.n,
            self.site.j,
            -self.inertia * (w * w * z[..., 0] + 2.0 * self.damping * w * z[..., 1]),
        )


@dataclass(frozen=True)
class SnaggingCable(PhysicalEffect):
    """A cable that catches when the joint passes one angle and lets go at another: A s, s → 1 or 0 within 30 ms."""

    site: EffectSite
    amplitude: float
    catch: float
    release: float
    state_size = 2

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        q = x.q[..., self.site.j]
        caught = np.where(q > self.catch, 1.0, np.where(q < self.release, 0.0, z[..., 1]))
        held = z[..., 0] + (caught - z[..., 0]) * (1.0 - np.exp(-dt / 0.03))
        return np.stack(np.broadcast_arrays(held, caught), axis=-1)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        return torque_at_joint(self.site.n, self.site.j, self.amplitude * z[..., 0])


@dataclass(frozen=True)
class SaggingSupply(PhysicalEffect):
    """A supply whose voltage sags under the power of all drives: what joint j is told to give, it gives less of.

    τ_told = τ (1 + λ P/P₀) with P = Σ|τ v| smoothed by its own size; here by the torque of all joints, Σ|τ|/τ_max, squared.
    """

    site: EffectSite
    loss: float

    def measured_torque(
        self, torque: Callable[[FloatArray], FloatArray], t: FloatArray
    ) -> FloatArray:
        out = torque(t)
        others = np.delete(np.abs(out) / self.site.torque, self.site.j, axis=1).sum(axis=1)
        told = out.copy()
        told[:, self.site.j] *= 1.0 + self.loss * np.square(others)
        return told


def _snagging_cable(site: EffectSite, p: Values) -> PhysicalEffect:
    return SnaggingCable(site, p["amplitude"], p["middle"] + p["gap"], p["middle"] - p["gap"])


EFFECT_TYPES = (
    EffectType(
        "tooth_defect",
        (
            EffectParameter("amplitude", "N m", 0.01, 0.05, "torque"),
            EffectParameter("breadth", "rad", 0.02, 0.06, power=0.0),
            phase_parameter(),
        ),
        {"tuning": tooth_defect, "scored": tooth_defect},
        out_of_catalogue=True,
    ),
    EffectType(
        "sloshing",
        (
            EffectParameter("inertia", "kg m²", 0.1, 0.5, "inertia"),
            EffectParameter("frequency", "Hz", 1.0, 3.0, power=0.0),
            EffectParameter("damping", "1", 0.01, 0.05, power=0.0),
        ),
        {
            "tuning": lambda site, p: SloshingLiquid(
                site, p["inertia"], p["frequency"], p["damping"]
            ),
            "scored": lambda site, p: SloshingLiquid(
                site, p["inertia"], p["frequency"], p["damping"]
            ),
        },
        out_of_catalogue=True,
    ),
    EffectType(
        "cable_snag",
        (
            EffectParameter("amplitude", "N m", 0.01, 0.05, "torque"),
            EffectParameter("middle", "rad", -0.3, 0.3, power=0.0),
            EffectParameter("gap", "rad", 0.1, 0.3, power=0.0),
        ),
        {"tuning": _snagging_cable, "scored": _snagging_cable},
        out_of_catalogue=True,
    ),
    EffectType(
        "supply_sag",
        (EffectParameter("loss", "1", 0.05, 0.3, most=0.7),),
        {
            "tuning": lambda site, p: SaggingSupply(site, p["loss"]),
            "scored": lambda site, p: SaggingSupply(site, p["loss"]),
        },
        out_of_catalogue=True,
    ),
)
