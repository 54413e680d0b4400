"""Joint actuators (rotor inertia, friction, offset) and the gains of their controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from .mujoco_dynamics import RigidBodyDynamics

INERTIA_SAMPLE_POSES = 20
"""Random poses over which the mass matrix is averaged; enough to size a rotor, not to identify."""
REFERENCE_ACCELERATION = 150.0
"""Acceleration at the torque limit that defines the least inertia of a joint [rad/s²].

A rotor has 20-50 % of at least `torque limit / REFERENCE_ACCELERATION`, so that it alone limits
the acceleration to 300-750 rad/s². The light links of a wrist would not.
"""


@dataclass(frozen=True)
class JointActuators:
    """Actuator parameters at the joint shafts: J α + F_v ω + F_c tanh(ω/w) + τ₀.

    The fields are the keys of `drive` in `excite.truth/1`. All have shape (n,).

    Attributes:
        inertia: Rotor inertia J reflected to the joint [kg m²].
        viscous: Viscous friction F_v [N m s/rad].
        coulomb: Coulomb friction F_c [N m].
        width: Speed w over which Coulomb friction changes sign [rad/s].
        offset: Constant torque τ₀ [N m].
    """

    inertia: FloatArray
    viscous: FloatArray
    coulomb: FloatArray
    width: FloatArray
    offset: FloatArray

    def friction_torque(self, v: FloatArray) -> FloatArray:
        """Return friction plus offset at joint speeds.

        Args:
            v: Joint speeds, shape (…, n) [rad/s].

        Returns:
            Torque, shape (…, n) [N m].
        """
        return self.viscous * v + self.coulomb * np.tanh(v / self.width) + self.offset


@dataclass(frozen=True)
class ControllerGains:
    """Gains of a cascade: position P, speed PI, feed-forward, and the lag of the current loop.

    The fields are the keys of `control` in `excite.truth/1`.

    Attributes:
        position: Gain of the position loop [1/s].
        speed: Bandwidth of the speed loop [rad/s] at the first pose of a motion, whose inertia
            scales its gain; one number, or one for each joint.
        integral: Integral gain of the speed loop [1/s].
        forward: Fraction of the rigid-body torque that is fed forward [1].
        lag: Time constant of the current loop [s].
        step: Resolution of the position that is fed back [rad]; 0: exact.
    """

    position: float = 30.0
    speed: float | FloatArray = 150.0
    integral: float = 12.0
    forward: float = 0.8
    lag: float = 1e-3
    step: float = 0.0


def mean_joint_inertia(dynamics: RigidBodyDynamics, rng: np.random.Generator) -> FloatArray:
    """Return the mean diagonal of the mass matrix over random poses, shape (n,) [kg m²]."""
    poses = rng.uniform(-2.0, 2.0, (INERTIA_SAMPLE_POSES, dynamics.n))
    return np.mean([np.diag(dynamics.mass_and_bias(q, 0.0 * q)[0]) for q in poses], axis=0)


def sample_actuators(
    dynamics: RigidBodyDynamics,
    velocity_limit: FloatArray,
    torque_limit: FloatArray,
    rng: np.random.Generator,
) -> JointActuators:
    """Draw random actuators of the size that industrial arms have.

    Coulomb friction is 2-4 % of the torque limit, viscous friction 1-3 % of it at full speed, and
    the rotor has 20-50 % of the mean inertia that the joint moves.

    Args:
        dynamics: Rigid-body dynamics of the robot.
        velocity_limit: Shape (n,) [rad/s].
        torque_limit: Shape (n,) [N m].
        rng: Generator of the draw.
    """
    n = dynamics.n
    return JointActuators(
        inertia=rng.uniform(0.2, 0.5, n)
        * np.maximum(mean_joint_inertia(dynamics, rng), torque_limit / REFERENCE_ACCELERATION),
        viscous=rng.uniform(0.01, 0.03, n) * torque_limit / velocity_limit,
        coulomb=rng.uniform(0.02, 0.04, n) * torque_limit,
        width=rng.uniform(0.003, 0.006, n),
        offset=rng.uniform(-0.005, 0.005, n) * torque_limit,
    )
