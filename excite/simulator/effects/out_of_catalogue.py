"""Physics that no effect of the catalogue describes; a diagnosis should report it as `unknown`.

Each has one model form, of the tuning or of the scored family, so that no physics on which a
diagnosis is tuned is scored. Those of the scored family depend on several states at once or on
their history.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import signal

from ..._types import FloatArray
from ..physical_effect import JointStates, PhysicalEffect
from .effect_type import (
    EffectParameter,
    EffectSite,
    EffectType,
    memoryless_effect,
    phase_parameter,
    smooth_sign,
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


RELAY_LAG = 0.03
"""Time constant with which the torque of a relay or a snapped cable follows [s]."""
RELAY_COUNT = 12
"""Relays of the memory of another joint's position."""
DWELL_SPEED = 0.02
"""Speed over the velocity limit below which a joint counts as dwelling [1]."""
HEAT_STEP = 0.02
"""Time step of a motor's temperature [s]."""


@dataclass(frozen=True)
class PoseFriction(PhysicalEffect):
    """Friction that depends on the product of two joint positions, as of a pinched hose.

    Its torque is A s(v_j) ½ (1 + sin(κ q_j q_i + φ)), with i the neighbour.

    Attributes:
        site: Place of the effect.
        amplitude: Largest friction A [N m].
        curvature: Coefficient κ [1/rad²].
        phase: Phase φ [rad].
    """

    site: EffectSite
    amplitude: float
    curvature: float
    phase: float

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        j, i = self.site.j, self.site.source
        wave = np.sin(self.curvature * x.q[..., j] * x.q[..., i] + self.phase)
        return torque_at_joint(
            self.site.n, j, 0.5 * self.amplitude * smooth_sign(x.v[..., j]) * (1.0 + wave)
        )


@dataclass(frozen=True)
class CrossJointMemory(PhysicalEffect):
    """A torque with memory of another joint's position: a Preisach sum of relays.

    τ_j = (A/K) Σ h_k with relays h_k that switch to 1 where q_i > c_k + g and to −1 where
    q_i < c_k − g (Mayergoyz, Mathematical Models of Hysteresis, 1991). The thresholds c_k lie at
    equal distances within ±1.2 rad; the torque follows with a lag of 30 ms.

    Attributes:
        site: Place of the effect.
        amplitude: Largest torque A [N m].
        gap: Half width g of the relays [rad].
    """

    site: EffectSite
    amplitude: float
    gap: float
    state_size = RELAY_COUNT + 1

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        """Return the internal states after a time step `dt` [s]; see `PhysicalEffect`."""
        q = x.q[..., self.site.source, None]
        centres = np.linspace(-1.2, 1.2, RELAY_COUNT)
        relays = np.where(
            q > centres + self.gap, 1.0, np.where(q < centres - self.gap, -1.0, z[..., 1:])
        )
        mean = relays.mean(axis=-1)
        level = z[..., 0] + (mean - z[..., 0]) * (1.0 - np.exp(-dt / RELAY_LAG))
        return np.concatenate([np.asarray(level)[..., None], relays], axis=-1)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        return torque_at_joint(self.site.n, self.site.j, self.amplitude * z[..., 0])


@dataclass(frozen=True)
class SnappingCable(PhysicalEffect):
    """A cable over two joints that sticks, stretches and snaps loose.

    Its tension follows ż = (v_j + 0.7 v_i)/d and falls to 0.2 z where |z| passes
    1 + ½ sin(q_j − q_i); the torque A z follows with a lag of 30 ms.

    Attributes:
        site: Place of the effect.
        amplitude: Torque A at the tension of 1 [N m].
        distance: Motion d that stretches the cable to a tension of 1 [rad].
    """

    site: EffectSite
    amplitude: float
    distance: float
    state_size = 2

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        """Return the internal states after a time step `dt` [s]; see `PhysicalEffect`."""
        j, i = self.site.j, self.site.source
        tension = z[..., 1] + dt * (x.v[..., j] + 0.7 * x.v[..., i]) / self.distance
        limit = 1.0 + 0.5 * np.sin(x.q[..., j] - x.q[..., i])
        tension = np.where(np.abs(tension) > limit, 0.2 * tension, tension)
        felt = z[..., 0] + (tension - z[..., 0]) * (1.0 - np.exp(-dt / RELAY_LAG))
        return np.stack(np.broadcast_arrays(felt, tension), axis=-1)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        return torque_at_joint(self.site.n, self.site.j, self.amplitude * z[..., 0])


def drifting_ripple(site: EffectSite, p: Values) -> PhysicalEffect:
    """Mesh torque A (τ/τ_max) sin(Nq + φ + 8 v/v_max): load sets its size, speed its phase."""
    torque_limit, top = site.torque_limit[site.j], site.velocity_limit[site.j]
    return memoryless_effect(
        site,
        lambda x: (
            p["amplitude"]
            * (x.load / (0.2 * torque_limit))
            * np.sin(p["waves"] * x.q + p["phase"] + 8.0 * x.v / top)
        ),
    )


@dataclass(frozen=True)
class DwellingSeal(PhysicalEffect):
    """A seal that sticks the longer the joint has dwelt, and frees itself over a distance.

    While |v| < 0.02 v_max the dwell time T grows; when the joint leaves, the level m becomes
    1 − e^{−T/T₀}, and decays by ṁ = −m |v|/D. The torque is A m s(v).

    Attributes:
        site: Place of the effect.
        amplitude: Friction A after a long dwell [N m].
        dwell: Time constant T₀ [s].
        distance: Distance D over which the seal frees itself [rad].
    """

    site: EffectSite
    amplitude: float
    dwell: float
    distance: float
    state_size = 2

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        """Return the internal states after a time step `dt` [s]; see `PhysicalEffect`."""
        speed = np.abs(x.v[..., self.site.j])
        dwells = speed < DWELL_SPEED * self.site.velocity_limit[self.site.j]
        level, time = z[..., 0], z[..., 1]
        stuck = np.maximum(level, 1.0 - np.exp(-time / self.dwell))
        freed = stuck * np.exp(-speed * dt / self.distance)
        return np.stack(
            np.broadcast_arrays(
                np.where(dwells, level, freed), np.where(dwells, time + dt, 0.0 * time)
            ),
            axis=-1,
        )

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        sign = smooth_sign(x.v[..., self.site.j])
        return torque_at_joint(self.site.n, self.site.j, self.amplitude * z[..., 0] * sign)


@dataclass(frozen=True)
class HeatedNeighbour(PhysicalEffect):
    """A motor that weakens as its neighbour's motor heats it.

    The temperature follows T θ̇ = (τ_i/τ_max,i)²/0.04 − θ; the reported torque of joint j is
    τ_j (1 + λ θ), because the motor gives less than it is commanded.

    Attributes:
        site: Place of the effect.
        loss: Coefficient λ [1].
        time_constant: Thermal time constant T [s].
    """

    site: EffectSite
    loss: float
    time_constant: float

    def measured_torque(
        self, torque: Callable[[FloatArray], FloatArray], t: FloatArray
    ) -> FloatArray:
        """Return the torque that the robot reports at times t, shape (N, n) [N m]."""
        i, j = self.site.source, self.site.j
        grid = np.arange(0.0, float(np.max(t)) + 2.0 * HEAT_STEP, HEAT_STEP)
        heat = np.square(torque(grid)[:, i] / self.site.torque_limit[i]) / 0.04
        decay = np.exp(-HEAT_STEP / self.time_constant)
        temperature = signal.lfilter([1.0 - decay], [1.0, -decay], heat)
        out = torque(t).copy()
        out[:, j] *= 1.0 + self.loss * np.interp(t, grid, temperature)
        return out


EFFECT_TYPES = (
    EffectType(
        "tooth_defect",
        (
            EffectParameter("amplitude", "N m", 0.01, 0.05, "torque"),
            EffectParameter("breadth", "rad", 0.02, 0.06, size_exponent=0.0),
            phase_parameter(),
        ),
        {"tuning": tooth_defect},
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
            )
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
        {"tuning": _snagging_cable},
        out_of_catalogue=True,
    ),
    EffectType(
        "supply_sag",
        (EffectParameter("loss", "1", 0.05, 0.3, largest=0.7),),
        {"tuning": lambda site, p: SaggingSupply(site, p["loss"])},
        out_of_catalogue=True,
    ),
    EffectType(
        "pose_friction",
        (
            EffectParameter("amplitude", "N m", 0.01, 0.05, "torque"),
            EffectParameter("curvature", "1/rad²", 1.5, 3.0, size_exponent=0.0),
            phase_parameter(),
        ),
        {"scored": lambda site, p: PoseFriction(site, p["amplitude"], p["curvature"], p["phase"])},
        out_of_catalogue=True,
    ),
    EffectType(
        "cross_joint_memory",
        (
            EffectParameter("amplitude", "N m", 0.01, 0.05, "torque"),
            EffectParameter("gap", "rad", 0.1, 0.4, size_exponent=0.0),
        ),
        {"scored": lambda site, p: CrossJointMemory(site, p["amplitude"], p["gap"])},
        out_of_catalogue=True,
    ),
    EffectType(
        "snapping_cable",
        (
            EffectParameter("amplitude", "N m", 0.01, 0.05, "torque"),
            EffectParameter("distance", "rad", 0.3, 0.8, size_exponent=0.0),
        ),
        {"scored": lambda site, p: SnappingCable(site, p["amplitude"], p["distance"])},
        out_of_catalogue=True,
    ),
    EffectType(
        "drifting_ripple",
        (
            EffectParameter("amplitude", "N m", 0.01, 0.05, "torque"),
            EffectParameter("waves", "1/turn", 8.0, 25.0, size_exponent=0.0),
            phase_parameter(),
        ),
        {"scored": drifting_ripple},
        out_of_catalogue=True,
    ),
    EffectType(
        "dwelling_seal",
        (
            EffectParameter("amplitude", "N m", 0.02, 0.1, "torque"),
            EffectParameter("dwell", "s", 0.02, 0.1, size_exponent=0.0),
            EffectParameter("distance", "rad", 0.2, 0.6, size_exponent=0.0),
        ),
        {"scored": lambda site, p: DwellingSeal(site, p["amplitude"], p["dwell"], p["distance"])},
        out_of_catalogue=True,
    ),
    EffectType(
        "heated_neighbour",
        (
            EffectParameter("loss", "1", 0.05, 0.3, largest=0.7),
            EffectParameter("time_constant", "s", 3.0, 10.0, size_exponent=0.0),
        ),
        {"scored": lambda site, p: HeatedNeighbour(site, p["loss"], p["time_constant"])},
        out_of_catalogue=True,
    ),
)
