"""The drives' base physics and their controller, sized by the robot's torque and speed limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from .mujoco_dynamics import RigidBodyDynamics


@dataclass(frozen=True)
class JointActuators:
    """J α + F_v ω + F_c tanh(ω/w) + τ₀ per joint, on the motor's side. All of shape (n,), at the joint's shaft.

    inertia [kg m²], viscous [N m s/rad], coulomb [N m], width w [rad/s], offset [N m].
    """

    inertia: FloatArray
    viscous: FloatArray
    coulomb: FloatArray
    width: FloatArray
    offset: FloatArray

    def friction_torque(self, v: FloatArray) -> FloatArray:
        """Friction and offset at speeds v. Shapes (…, n) [N m]."""
        return self.viscous * v + self.coulomb * np.tanh(v / self.width) + self.offset


@dataclass(frozen=True)
class ControllerGains:
    """A cascade: position P, speed PI, feed-forward of speed and of a share of the model's torque, lag of the current loop.

    position [1/s]; speed: bandwidth [rad/s]; integral [1/s]; forward: share [1]; lag [s]; step: the encoder's, as fed back [rad].
    """

    position: float = 30.0
    speed: float = 150.0
    integral: float = 12.0
    forward: float = 0.8
    lag: float = 1e-3
    step: float = 0.0


def mean_joint_inertia(arm: RigidBodyDynamics, rng: np.random.Generator) -> FloatArray:
    """Mean diagonal of the mass matrix over random poses. Shape (n,) [kg m²]."""
    poses = rng.uniform(-2.0, 2.0, (20, arm.n))
    return np.mean([np.diag(arm.mass_and_bias(q, 0.0 * q)[0]) for q in poses], axis=0)


def draw_actuators(
    arm: RigidBodyDynamics, speed: FloatArray, torque: FloatArray, rng: np.random.Generator
) -> JointActuators:
    """Drives as robots have them: Coulomb 2-4 %, viscous 1-3 % of the torque limit (at full speed), rotors of 20-50 % of the
    link's inertia, and no drive faster than 400 rad/s² by itself, as the small links of a wrist would have it.

    speed, torque: the joints' limits. Shape (n,) [rad/s, N m].
    """
    n = arm.n
    return JointActuators(
        inertia=rng.uniform(0.2, 0.5, n) * np.maximum(mean_joint_inertia(arm, rng), torque / 150.0),
        viscous=rng.uniform(0.01, 0.03, n) * torque / speed,
        coulomb=rng.uniform(0.02, 0.04, n) * torque,
        width=rng.uniform(0.003, 0.006, n),
        offset=rng.uniform(-0.005, 0.005, n) * torque,
    )
