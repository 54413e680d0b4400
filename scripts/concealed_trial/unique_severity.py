"""Unique severity: the part of an effect's torque that no combination of others could stand for.

The torque e is fitted by the base model and a dictionary D of frictions without the effect's own
class: min |e − Y β − D x|² with x ≥ −x₀, where x₀ ≥ 0 fits the other frictions of the joint. Other
frictions may thus be larger, or smaller by as much as they are there, but not negative. The
dictionary is written for the trial alone and shares no code with the diagnosis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, optimize

from excite._types import FloatArray
from excite.simulator.effect_instance import EffectInstance
from excite.simulator.mujoco_dynamics import build_dynamics
from excite.simulator.physical_effect import PhysicalEffect
from excite.simulator.severity import (
    ELASTIC_RATE,
    RIGID_RATE,
    HiddenTorque,
    base_columns,
    column_space,
    hidden_torque,
    low_passed,
)
from excite.simulator.simulated_robot import SimulatedMotion, SimulatedRobot

STRIBECK_SPEEDS = (0.015, 0.04, 0.1, 0.25)
"""Stribeck velocities of the dictionary over the velocity limit [1]."""
VISCOUS_SPEEDS = (0.05, 0.2)
"""Speeds over the velocity limit at which asinh-shaped viscous friction bends [1]."""
SLIP_DISTANCES = 1e-3 * 2.0 ** np.arange(7)
"""Breakaway displacements of the Maxwell-slip elements [rad]: 1 to 64 mrad."""
RIPPLE_ORDERS = (1.0, 1.37, 2.0)
"""Orders of the ripple columns over the stated order [1]: fundamental, second mesh, harmonic."""
RIDGE = 1e-7
"""Ridge parameter over the squared norm of a column, for columns that are nearly dependent [1]."""
SIGNED_CLASSES = ("ripple",)
"""Classes of the dictionary whose coefficients have either sign."""
EFFECT_CLASSES = {
    "stribeck": "stribeck",
    "nonlinear_viscous": "viscous",
    "drag": "viscous",
    "hysteresis": "presliding",
    "load_friction": "load",
    "torque_ripple": "ripple",
}
"""Class of the dictionary that describes an effect; effects that are not listed have none."""


@dataclass(frozen=True)
class EffectSeverity:
    """Severity of a hidden effect in every joint.

    Attributes:
        alone: RMS torque beyond the base model over the noise floor, shape (n,) [1].
        unique: The same beyond the base model and the other frictions, shape (n,) [1].
    """

    alone: FloatArray
    unique: FloatArray

    def scaled(self, factor: float) -> EffectSeverity:
        """Return the severity of an effect made `factor` times as large, to first order."""
        return EffectSeverity(factor * self.alone, factor * self.unique)


def friction_columns(
    robot: SimulatedRobot, j: int, motion: HiddenTorque, orders: Sequence[float]
) -> dict[str, FloatArray]:
    """Return the dictionary of a joint's frictions by class, shapes (N, m).

    With s = tanh(v/w), x = v over the velocity limit and the load τ: s e^{−|x|/x₀} and
    s e^{−(x/x₀)²} (stribeck); s √|x|, asinh(x/x₀), x|x|, x³ (viscous); Maxwell-slip elements
    z ← clip(z + Δq, ±δ) (presliding); |τ| s, τ² s (load); cos and sin of Nq, also times τ (ripple).

    Args:
        robot: The robot without effects.
        j: Index of the joint.
        motion: Motion of the robot.
        orders: Spatial frequencies of the joint's torque ripple [1/turn].
    """
    q, v = motion.q[:, j], motion.v[:, j]
    x = v / robot.tree.velocity_and_torque_limit(robot.joints[j])[0]
    sign = np.tanh(v / robot.actuators.width[j])
    dynamics = build_dynamics(robot.tree, robot.joints, robot.lock, robot.gravity)
    load = dynamics.inverse_dynamics(motion.q, motion.v, motion.a)[:, j] / robot.torque_limit[j]
    out = {
        "stribeck": np.column_stack(
            [
                sign * np.exp(-(np.abs(x / speed) ** power))
                for speed in STRIBECK_SPEEDS
                for power in (1.0, 2.0)
            ]
        ),
        "viscous": np.column_stack(
            [
                sign * np.sqrt(np.abs(x)),
                *(np.arcsinh(x / speed) for speed in VISCOUS_SPEEDS),
                x * np.abs(x),
                x**3,
            ]
        ),
        "presliding": _slip_elements(q) / SLIP_DISTANCES,
        "load": np.column_stack([np.abs(load) * sign, load**2 * sign]),
    }
    if orders:
        waves = [
            wave(ratio * order * q)
            for order in orders
            for ratio in RIPPLE_ORDERS
            for wave in (np.cos, np.sin)
        ]
        out["ripple"] = np.column_stack([*waves, *(load * wave for wave in waves)])
    return out


def _slip_elements(q: FloatArray) -> FloatArray:
    """Return the displacements of Maxwell-slip elements along a motion, shape (N, 7) [rad]."""
    out = np.zeros((len(q), len(SLIP_DISTANCES)))
    for k, step in enumerate(np.diff(q).tolist()):
        out[k + 1] = np.minimum(np.maximum(out[k] + step, -SLIP_DISTANCES), SLIP_DISTANCES)
    return out


@dataclass(frozen=True)
class _Dictionary:
    """Dictionary of some joints, fitted together with the base model.

    Attributes:
        basis: Orthonormal basis of the base model, shape (M·n, r).
        blocks: Columns of each joint, shapes (M, m).
        shape: M and n.
    """

    basis: FloatArray
    blocks: Mapping[int, FloatArray]
    shape: tuple[int, ...]

    def fit(self, target: FloatArray) -> FloatArray:
        """Return the coefficients, none of which is negative, of a torque of shape (M, n)."""
        beyond_base = self.beyond_base(target)
        # eliminate the base model, then solve for the coefficients of the dictionary
        crossed = np.hstack(
            [self.basis[j :: self.shape[1]].T @ block for j, block in self.blocks.items()]
        )
        gram = linalg.block_diag(*(block.T @ block for block in self.blocks.values()))
        right = np.concatenate([block.T @ beyond_base[:, j] for j, block in self.blocks.items()])
        root = np.linalg.cholesky(gram - crossed.T @ crossed + RIDGE * np.eye(len(gram)))
        solution, _ = optimize.nnls(root.T, linalg.solve_triangular(root, right, lower=True))
        return np.asarray(solution)

    def torque(self, coefficients: FloatArray) -> FloatArray:
        """Return the torque of coefficients, shape (M, n)."""
        out, start = np.zeros(self.shape), 0
        for j, block in self.blocks.items():
            out[:, j] = block @ coefficients[start : start + block.shape[1]]
            start += block.shape[1]
        return out

    def beyond_base(self, torque: FloatArray) -> FloatArray:
        """Return what the base model leaves of a torque, shape (M, n)."""
        projection = self.basis @ (self.basis.T @ torque.ravel())
        return np.asarray(torque - projection.reshape(torque.shape))


class TorqueProjection:
    """Projection of torques along recorded motions on the base model and on friction dictionaries.

    Attributes:
        robot: The robot without effects.
        motions: The motions.
        rate: Rate of their samples [Hz].
    """

    def __init__(
        self,
        robot: SimulatedRobot,
        motions: Sequence[HiddenTorque],
        rate: float,
        instances: Sequence[EffectInstance],
    ) -> None:
        """Build the basis of the base model.

        Args:
            robot: The robot without effects.
            motions: The motions.
            rate: Rate of their samples [Hz].
            instances: Hidden effects, of which torque ripple states its order.
        """
        self.robot, self.motions, self.rate = robot, motions, rate
        self._orders: dict[str | None, list[float]] = {}
        for instance in instances:
            if instance.name == "torque_ripple":
                self._orders.setdefault(instance.joint, []).append(instance.values["order"])
        self._basis = column_space(
            np.concatenate([base_columns(robot, m.q, m.v, m.a, rate) for m in motions])
        )
        self._dictionaries: dict[int, Mapping[str, FloatArray]] = {}

    def severity(
        self,
        name: str,
        joint: str | None,
        torques: Sequence[FloatArray],
        noise: FloatArray,
        frictions: Sequence[FloatArray] | None = None,
    ) -> EffectSeverity:
        """Return the severity of an effect.

        Args:
            name: Name of the effect.
            joint: Joint that carries it; None: all.
            torques: Its torque along each motion, shapes (N, n) [N m].
            noise: Noise floor, shape (n,) [N m].
            frictions: Torque of all effects with a class in the dictionary, along each motion,
                shapes (N, n) [N m]; None: of this effect alone.
        """
        limit, kind = self.robot.torque_limit, EFFECT_CLASSES.get(name, "")
        joints = list(range(len(limit))) if joint is None else [self.robot.joints.index(joint)]
        target = self._samples(torques)
        others = np.zeros_like(target)
        if frictions is not None:
            others[:, joints] = self._samples(frictions)[:, joints]
            others -= target if kind else 0.0
        dictionary = _Dictionary(
            self._basis, {j: self._dictionary_without(j, kind) for j in joints}, target.shape
        )
        substitutes = dictionary.torque(dictionary.fit(others))
        fitted = dictionary.torque(dictionary.fit(target + substitutes))
        parts = (target, target + substitutes - fitted)
        return EffectSeverity(
            *(
                np.sqrt(np.square(dictionary.beyond_base(x)).mean(axis=0)) * limit / noise
                for x in parts
            )
        )

    def _samples(self, torques: Sequence[FloatArray]) -> FloatArray:
        """Return torques along all motions below 20 Hz, over the torque limits, shape (M, n)."""
        parts = [low_passed(torque, self.rate) for torque in torques]
        return np.asarray(np.concatenate(parts) / self.robot.torque_limit)

    def _dictionary_without(self, j: int, excluded: str) -> FloatArray:
        """Return the dictionary of a joint without a class, columns of norm 1, shape (M, m)."""
        if j not in self._dictionaries:
            orders = self._orders.get(self.robot.joints[j], [])
            parts = [friction_columns(self.robot, j, motion, orders) for motion in self.motions]
            self._dictionaries[j] = {
                name: np.concatenate([low_passed(part[name], self.rate) for part in parts])
                for name in parts[0]
            }
        columns = np.hstack(
            [
                np.hstack([block, -block]) if name in SIGNED_CLASSES else block
                for name, block in self._dictionaries[j].items()
                if name != excluded
            ]
        )
        return np.asarray(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))


def sampled_motion(
    motion: SimulatedMotion, robot: SimulatedRobot, periodic: tuple[float, float]
) -> tuple[HiddenTorque, float]:
    """Return the hidden torque and the motion in a time window, and the rate of the samples [Hz].

    Args:
        motion: Motion of the robot with its effects.
        robot: The robot without effects.
        periodic: Begin and end of the window [s].
    """
    rate = ELASTIC_RATE if motion.robot.springs else RIGID_RATE
    return hidden_torque(motion, robot, np.arange(*periodic, 1.0 / rate)), rate


def effect_torques(motion: SimulatedMotion, t: FloatArray) -> list[FloatArray | None]:
    """Return the torque that each effect adds to the reported torque, shapes (N, n) [N m].

    None for an effect that acts otherwise than by a torque, which alters the motion: a spring, a
    moving base, a wrong position.

    Args:
        motion: Motion of the robot with its effects.
        t: Times, shape (N,) [s].
    """
    x, start, out = motion.joint_states(t), 0, list[FloatArray | None]()
    reported = motion.measured(t)[1]
    for effect in motion.robot.effects:
        torque: FloatArray | None = None
        if type(effect).torque is not PhysicalEffect.torque:
            states = motion.history.z[:, start : start + effect.state_size].T
            start += effect.state_size
            z = np.array([np.interp(t, motion.history.t, state) for state in states])
            torque = effect.torque(x, z.reshape(effect.state_size, len(t)).T)
        elif type(effect).measured_torque is not PhysicalEffect.measured_torque:
            others = tuple(other for other in motion.robot.effects if other is not effect)
            without = SimulatedMotion(
                replace(motion.robot, effects=others), motion.dynamics, motion.history
            )
            torque = reported - without.measured(t)[1]
        out.append(torque)
    return out


def friction_severities(
    robot: SimulatedRobot,
    instances: Sequence[EffectInstance],
    motions: Sequence[tuple[SimulatedMotion, tuple[float, float]]],
    noise: FloatArray,
) -> list[EffectSeverity]:
    """Return the severity of all frictions of a robot, and of its delay, along its motions.

    Args:
        robot: The robot without effects.
        instances: Frictions and delay, the first of the robot's effects.
        motions: Motions of the robot with its effects, each with a time window [s].
        noise: Noise floor, shape (n,) [N m].
    """
    if not instances:
        return []
    windows = [np.arange(*periodic, 1.0 / RIGID_RATE) for _, periodic in motions]
    sampled = [
        hidden_torque(motion, robot, t) for (motion, _), t in zip(motions, windows, strict=True)
    ]
    projection = TorqueProjection(robot, sampled, RIGID_RATE, instances)
    torques = [effect_torques(motion, t) for (motion, _), t in zip(motions, windows, strict=True)]
    frictions = [
        sum(
            (
                torque
                for torque, instance in zip(recording, instances, strict=False)
                if torque is not None and instance.name in EFFECT_CLASSES
            ),
            np.zeros((len(t), len(noise))),
        )
        for recording, t in zip(torques, windows, strict=True)
    ]
    return [
        projection.severity(
            instance.name,
            instance.joint,
            [torque for recording in torques if (torque := recording[k]) is not None],
            noise,
            frictions,
        )
        for k, instance in enumerate(instances)
    ]


def severity_of_motion(
    instance: EffectInstance,
    robot: SimulatedRobot,
    motion: SimulatedMotion,
    periodic: tuple[float, float],
    noise: FloatArray,
    others: Sequence[EffectInstance] = (),
) -> EffectSeverity:
    """Return the severity of the only effect of a robot.

    Args:
        instance: The effect.
        robot: The robot without it.
        motion: Motion of the robot with it.
        periodic: Time window [s].
        noise: Noise floor, shape (n,) [N m].
        others: Other effects of the case, of which torque ripple states its order.
    """
    sampled, rate = sampled_motion(motion, robot, periodic)
    projection = TorqueProjection(robot, [sampled], rate, others)
    return projection.severity(instance.name, instance.joint, [sampled.torque], noise)
