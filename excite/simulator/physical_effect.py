"""What a hidden effect may do to a robot: the one interface of all effects, each method of which does nothing by default."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .actuator import JointActuators
from .mujoco_dynamics import RigidBodyDynamics
from .urdf_tree import UrdfTree

Array = np.ndarray


@dataclass(frozen=True)
class JointStates:
    """The joints at one time or at many. Arrays of shape (…, n); t: Shape (…).

    q, v, a: of the motor's shaft, divided by the gear ratio [rad, rad/s, rad/s²]. load: torque passed on to the link [N m].
    """

    t: Array
    q: Array
    v: Array
    a: Array
    load: Array


@dataclass(frozen=True)
class TransmissionSpring:
    """What an elastic joint passes on: f(δ, δ̇) of its wind-up δ = θ − q. pull: floats to (torque, ∂/∂δ, ∂/∂δ̇)."""

    joint: int
    pull: Callable[[float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class BaseSuspension:
    """Springs and dampers under the base's own coordinates. Shapes (k,) [N m/rad, N m s/rad]."""

    stiffness: Array
    damping: Array


class PhysicalEffect:
    """Hidden physics of a robot. Torques are what the drive must give in addition, Shape (…, n) [N m]."""

    memory: int = 0

    def alter(self, tree: UrdfTree) -> UrdfTree:
        """Other bodies or frames."""
        return tree

    def gravity(self, vector: Array) -> Array:
        """Gravity in the base's frame. Shape (3,) [m/s²]."""
        return vector

    def drives(self, drive: JointActuators) -> JointActuators:
        """Other drives."""
        return drive

    def bound(self, arm: RigidBodyDynamics) -> PhysicalEffect:
        """The same law, knowing the arm it acts on."""
        return self

    def suspension(self) -> BaseSuspension | None:
        """What carries the coordinates that `alter` put under the base."""
        return None

    def spring(self) -> TransmissionSpring | None:
        """What lies between a motor and its link instead of a rigid gear."""
        return None

    def advance(self, x: JointStates, z: Array, dt: float) -> Array:
        """Memory after dt [s] at the motion x. Shape (…, memory)."""
        return z

    def torque(self, x: JointStates, z: Array) -> Array | None:
        """Additional torque, or None."""
        return None

    def seen(self, q: Array) -> Array:
        """Position that the motor's encoder tells. Shapes (…, n)."""
        return q

    def told(self, torque: Callable[[Array], Array], t: Array) -> Array:
        """Torque that the robot tells at times t, where torque(t) is the true one. Shape (N, n)."""
        return torque(t)
