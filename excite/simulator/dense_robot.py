"""Hidden effects of a robot as dense as real ones: several frictions at every joint at once.

Real joints have Stribeck, nonlinear viscous, load-dependent friction and presliding hysteresis
together; their torque is recorded late, and some gears ripple (Bittencourt & Gunnarsson 2012;
Waiboer, Aarts & Jonker 2005).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._types import FloatArray
from .effect_instance import EffectInstance
from .effects.effect_type import FORM_FAMILIES
from .mujoco_dynamics import build_dynamics
from .reference_trajectory import ReferenceTrajectory
from .simulated_robot import SimulatedRobot

LOAD_POSES = 400
"""Poses of a motion in which the load of the joints is computed."""
DENSE_STREAM = 7
"""Number of the random stream of the effects, different from those of bodies and noise."""


@dataclass(frozen=True)
class DenseSettings:
    """Probabilities and sizes of the effects of a dense robot.

    Sizes are uniform between the two values. Torques are stated over the torque limit, speeds over
    the velocity limit.

    Attributes:
        friction_probability: That a joint has each kind of friction: 1 for a dense robot, 0.5 for a
            half-dense one.
        ripple_probability: That a joint has torque ripple.
        concave_probability: That nonlinear viscous friction grows less than in proportion to speed.
        stribeck: Excess of static friction.
        stribeck_velocity: Speed at which the excess has decayed.
        viscous: Nonlinear part of the viscous friction at the velocity limit.
        hysteresis: Amplitude of the presliding hysteresis.
        presliding: Distance over which it builds up after a reversal [rad].
        load: Friction per transmitted torque [1].
        min_load: Largest static torque from which a joint counts as loaded.
        ripple: Amplitude of the torque ripple.
        ripple_order: Its spatial frequency [1/turn].
        delay: Time by which torque is recorded later [s].
    """

    friction_probability: float = 1.0
    ripple_probability: float = 0.4
    concave_probability: float = 0.7
    stribeck: tuple[float, float] = (0.005, 0.02)
    stribeck_velocity: tuple[float, float] = (0.02, 0.1)
    viscous: tuple[float, float] = (0.005, 0.03)
    hysteresis: tuple[float, float] = (0.005, 0.02)
    presliding: tuple[float, float] = (1e-3, 2e-2)
    load: tuple[float, float] = (0.03, 0.15)
    min_load: float = 0.1
    ripple: tuple[float, float] = (0.004, 0.015)
    ripple_order: tuple[float, float] = (6.0, 60.0)
    delay: tuple[float, float] = (5e-4, 3e-3)


def draw_dense_effects(
    robot: SimulatedRobot,
    load: FloatArray,
    rng: np.random.Generator,
    settings: DenseSettings = DenseSettings(),
    families: Sequence[str] = FORM_FAMILIES,
) -> tuple[EffectInstance, ...]:
    """Draw the effects of a dense robot.

    Args:
        robot: The robot without effects.
        load: Largest static torque of each joint along the motion, shape (n,) [N m].
        rng: Generator of the draw.
        settings: Probabilities and sizes.
        families: Families of model forms, one drawn for each effect.
    """
    effects: list[EffectInstance] = []

    def add(name: str, joint: str | None, **values: float) -> None:
        effects.append(EffectInstance(name, joint, str(rng.choice(list(families))), values))

    for j, joint in enumerate(robot.joints):
        torque = float(robot.torque_limit[j])
        speed = float(robot.tree.velocity_and_torque_limit(joint)[0])
        present = rng.random(5) < (
            *(settings.friction_probability,) * 4,
            settings.ripple_probability,
        )
        if present[0]:
            add(
                "stribeck",
                joint,
                amplitude=torque * rng.uniform(*settings.stribeck),
                velocity=speed * rng.uniform(*settings.stribeck_velocity),
            )
        if present[1]:
            is_concave = rng.random() < settings.concave_probability
            exponent = rng.uniform(0.35, 0.75) if is_concave else rng.uniform(2.0, 3.0)
            add(
                "nonlinear_viscous",
                joint,
                coefficient=torque * rng.uniform(*settings.viscous) / speed**exponent,
                exponent=exponent,
            )
        if present[2]:
            amplitude = torque * rng.uniform(*settings.hysteresis)
            distance = np.exp(rng.uniform(*np.log(settings.presliding)))
            add("hysteresis", joint, amplitude=amplitude, stiffness=amplitude / distance)
        if present[3] and load[j] > settings.min_load * torque:
            add("load_friction", joint, mu=rng.uniform(*settings.load))
        if present[4]:
            add(
                "torque_ripple",
                joint,
                order=rng.uniform(*settings.ripple_order),
                amplitude=torque * rng.uniform(*settings.ripple),
                phase=rng.uniform(-np.pi, np.pi),
            )
    if rng.random() < settings.friction_probability:
        add("delay", None, seconds=rng.uniform(*settings.delay))
    return tuple(effects)


def static_load(robot: SimulatedRobot, motion: ReferenceTrajectory) -> FloatArray:
    """Return the largest static torque of each joint along a motion, shape (n,) [N m]."""
    dynamics = build_dynamics(robot.tree, robot.joints, robot.lock, robot.gravity)
    q = motion.at(np.linspace(0.0, motion.duration, LOAD_POSES))[0]
    still = np.zeros_like(q)
    return np.asarray(np.abs(dynamics.inverse_dynamics(q, still, still)).max(axis=0))


def dense_effects(
    robot: SimulatedRobot, motion: ReferenceTrajectory, probability: float, seed: int
) -> tuple[EffectInstance, ...]:
    """Draw the effects of a dense robot for a motion and a seed.

    Args:
        robot: The robot without effects.
        motion: The commanded motion.
        probability: Probability of each friction at each joint.
        seed: Seed of the draw.
    """
    settings = replace(DenseSettings(), friction_probability=probability)
    rng = np.random.default_rng([seed, DENSE_STREAM])
    return draw_dense_effects(robot, static_load(robot, motion), rng, settings)
