"""What a hidden effect may do to a robot: the one interface of all effects, each method of which does nothing by default."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .._types import FloatArray
from .actuator import JointActuators
from .mujoco_dynamics import RigidBodyDynamics
from .urdf_tree import UrdfTree


@dataclass(frozen=True)
class JointStates:
    """The joints at one time or at many. Arrays of shape (…, n); t: Shape (…).

    q, v, a: of the motor's shaft, divided by the gear ratio [rad, rad/s, rad/s²]. load: torque passed on to the link [N m].
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray
    load: FloatArray


@dataclass(frozen=True)
class TransmissionSpring:
    """What an elastic joint passes on: f(δ, δ̇) of its wind-up δ = θ − q. pull: floats to (torque, ∂/∂δ, ∂/∂δ̇)."""

    joint: int
    torque_and_slopes: Callable[[float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class BaseSuspension:
    """Springs and dampers under the base's own coordinates. Shapes (k,) [N m/rad, N m s/rad]."""

    stiffness: FloatArray
    damping: FloatArray


class PhysicalEffect:
    """Hidden physics of a robot. Torques are what the drive must give in addition, Shape (…, n) [N m]."""

    state_size: int = 0

    def modify_tree(self, tree: UrdfTree) -> UrdfTree:
        """Other bodies or frames."""
        return tree

    def gravity(self, vector: FloatArray) -> FloatArray:
        """Gravity in the base's frame. Shape (3,) [m/s²]."""
        return vector

    def modify_actuators(self, drive: JointActuators) -> JointActuators:
        """Other drives."""
        return drive

    def bind(self, arm: RigidBodyDynamics) -> PhysicalEffect:
        """The same law, knowing the arm it acts on."""
        return self

    def base_suspension(self) -> BaseSuspension | None:
        """What carries the coordinates that `alter` put under the base."""
        return None

    def transmission_spring(self) -> TransmissionSpring | None:
        """What lies between a motor and its link instead of a rigid gear."""
        return None

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        """Memory after dt [s] at the motion x. Shape (…, memory)."""
        return z

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray | None:
        """Additional torque, or None."""
        return None

    def measured_position(self, q: FloatArray) -> FloatArray:
        """Position that the motor's encoder tells. Shapes (…, n)."""
        return q

    def measured_torque(
        self, torque: Callable[[FloatArray], FloatArray], t: FloatArray
    ) -> FloatArray:
        """Torque that the robot tells at times t, where torque(t) is the true one. Shape (N, n)."""
        return torque(t)
