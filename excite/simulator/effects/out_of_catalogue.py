"""Physics that no effect of the catalogue describes; a diagnosis should report it as `unknown`."""

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
    """A gear defect: bumps A e^{−(Δ/w)²} at five irregular angles, under load of one sign only."""
    places = (
        np.modf(np.arange(1, 6) * (np.sqrt(5.0) - 1.0) / 2.0 + p["phase"] / (2 * np.pi))[0] * 4.0
        - 2.0
    )
    load_scale = 0.02 * site.torque_limit[site.j]

    def model(x: JointStates) -> FloatArray:
        distance = (x.q[..., None] - places) / p["breadth"]
        return (
            p["amplitude"]
            * np.exp(-np.square(distance)).sum(axis=-1)
            * 0.5
            * (1.0 + np.tanh(x.load / load_scale))
        )

    return memoryless_effect(site, model)


@dataclass(frozen=True)
class SloshingLiquid(PhysicalEffect):
    """A liquid in the link: an oscillator z̈ + 2ζω ż + ω² z = −q̈ that reacts on the joint.

    Its torque is −I (ω² z + 2ζω ż).

    Attributes:
        site: Place of the effect.
        inertia: Moving inertia I [kg m²].
        frequency: Natural frequency ω/2π [Hz].
        damping: Damping ratio ζ [1].
    """

    site: EffectSite
    inertia: float
    frequency: float
    damping: float
    state_size = 2

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        """Return the internal states after a time step `dt` [s]; see `PhysicalEffect`."""
        w = 2.0 * np.pi * self.frequency
        rate = (z[..., 1] - dt * (x.a[..., self.site.j] + w * w * z[..., 0])) / (
            1.0 + dt * (2.0 * self.damping * w + dt * w * w)
        )
        return np.stack(np.broadcast_arrays(z[..., 0] + dt * rate, rate), axis=-1)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        w = 2.0 * np.pi * self.frequency
        return torque_at_joint(
            self.site.n,
            self.site.j,
            -self.inertia * (w * w * z[..., 0] + 2.0 * self.damping * w * z[..., 1]),
        )


@dataclass(frozen=True)
class SnaggingCable(PhysicalEffect):
    """A cable that snags when the joint passes one angle and releases at another.

    The torque A s follows s → 1 or s → 0 with a time constant of 30 ms.

    Attributes:
        site: Place of the effect.
        amplitude: Torque A of the snagged cable [N m].
        catch: Angle above which it snags [rad].
        release: Angle below which it releases [rad].
    """

    site: EffectSite
    amplitude: float
    catch: float
    release: float
    state_size = 2

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        """Return the internal states after a time step `dt` [s]; see `PhysicalEffect`."""
        q = x.q[..., self.site.j]
        caught = np.where(q > self.catch, 1.0, np.where(q < self.release, 0.0, z[..., 1]))
        tension = z[..., 0] + (caught - z[..., 0]) * (1.0 - np.exp(-dt / 0.03))
        return np.stack(np.broadcast_arrays(tension, caught), axis=-1)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        return torque_at_joint(self.site.n, self.site.j, self.amplitude * z[..., 0])


@dataclass(frozen=True)
class SaggingSupply(PhysicalEffect):
    """A supply voltage that sags under the load of the other actuators.

    The reported torque of joint j is τ_j (1 + λ s²) with s = Σ|τ_i|/τ_max,i over the other joints,
    because the motor gives less than it is commanded.

    Attributes:
        site: Place of the effect.
        loss: Coefficient λ [1].
    """

    site: EffectSite
    loss: float

    def measured_torque(
        self, torque: Callable[[FloatArray], FloatArray], t: FloatArray
    ) -> FloatArray:
        """Return the torque that the robot reports at times t, shape (N, n) [N m]."""
        true_torque = torque(t)
        load = np.delete(np.abs(true_torque) / self.site.torque_limit, self.site.j, axis=1).sum(
            axis=1
        )
        reported = true_torque.copy()
        reported[:, self.site.j] *= 1.0 + self.loss * np.square(load)
        return reported


def _snagging_cable(site: EffectSite, p: Values) -> PhysicalEffect:
    """Build the cable from its parameter values."""
    return SnaggingCable(site, p["amplitude"], p["middle"] + p["gap"], p["middle"] - p["gap"])


EFFECT_TYPES = (
    EffectType(
        "tooth_defect",
        (
            EffectParameter("amplitude", "N m", 0.01, 0.05, "torque"),
            EffectParameter("breadth", "rad", 0.02, 0.06, size_exponent=0.0),
            phase_parameter(),
        ),
        {"tuning": tooth_defect, "scored": tooth_defect},
        out_of_catalogue=True,
    ),
    EffectType(
        "sloshing",
        (
            EffectParameter("inertia", "kg m²", 0.1, 0.5, "inertia"),
            EffectParameter("frequency", "Hz", 1.0, 3.0, size_exponent=0.0),
            EffectParameter("damping", "1", 0.01, 0.05, size_exponent=0.0),
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
            EffectParameter("middle", "rad", -0.3, 0.3, size_exponent=0.0),
            EffectParameter("gap", "rad", 0.1, 0.3, size_exponent=0.0),
        ),
        {"tuning": _snagging_cable, "scored": _snagging_cable},
        out_of_catalogue=True,
    ),
    EffectType(
        "supply_sag",
        (EffectParameter("loss", "1", 0.05, 0.3, largest=0.7),),
        {
            "tuning": lambda site, p: SaggingSupply(site, p["loss"]),
            "scored": lambda site, p: SaggingSupply(site, p["loss"]),
        },
        out_of_catalogue=True,
    ),
)
