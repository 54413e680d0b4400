"""The interface of all hidden effects: what an effect may change in a simulated robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .._types import FloatArray
from .actuator import JointActuators
from .mujoco_dynamics import RigidBodyDynamics
from .urdf_tree import UrdfTree


@dataclass(frozen=True)
class JointStates:
    """States of the joints at one time or at several times.

    Attributes:
        t: Time, shape (…) [s].
        q: Position of the motor shaft divided by the gear ratio, shape (…, n) [rad].
        v: Speed of the same, shape (…, n) [rad/s].
        a: Acceleration of the same, shape (…, n) [rad/s²].
        load: Torque transmitted to the link, shape (…, n) [N m].
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray
    load: FloatArray


@dataclass(frozen=True)
class TransmissionSpring:
    """An elastic transmission between a motor and its link.

    Attributes:
        joint: Index of the joint.
        torque_and_slopes: Function of the deflection δ = θ − q [rad] and its rate [rad/s] that
            returns the transmitted torque [N m] and its derivatives with respect to both.
    """

    joint: int
    torque_and_slopes: Callable[[float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class BaseSuspension:
    """Springs and dampers of the coordinates of a base that moves.

    Attributes:
        stiffness: Shape (k,) [N m/rad].
        damping: Shape (k,) [N m s/rad].
    """

    stiffness: FloatArray
    damping: FloatArray


class PhysicalEffect:
    """Hidden physics of a robot; each method changes nothing unless an effect overrides it.

    Attributes:
        state_size: Number of internal states of the effect.
    """

    state_size: int = 0

    def modify_tree(self, tree: UrdfTree) -> UrdfTree:
        """Return the robot's tree with other bodies or frames."""
        return tree

    def modify_gravity(self, gravity: FloatArray) -> FloatArray:
        """Return gravity in the base frame, shape (3,) [m/s²]."""
        return gravity

    def modify_actuators(self, actuators: JointActuators) -> JointActuators:
        """Return other actuators."""
        return actuators

    def bind(self, dynamics: RigidBodyDynamics) -> PhysicalEffect:
        """Return the effect with the rigid-body dynamics that it acts on."""
        return self

    def base_suspension(self) -> BaseSuspension | None:
        """Return the suspension of the coordinates that `modify_tree` put below the base."""
        return None

    def transmission_spring(self) -> TransmissionSpring | None:
        """Return the spring that replaces the rigid transmission of a joint."""
        return None

    def advance_state(self, x: JointStates, z: FloatArray, dt: float) -> FloatArray:
        """Return the internal states after a time step.

        Args:
            x: States of the joints during the step.
            z: Internal states at its start, shape (…, state_size).
            dt: Time step [s].
        """
        return z

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray | None:
        """Return the torque that actuators give in addition, shape (…, n) [N m], or None."""
        return None

    def measured_position(self, q: FloatArray) -> FloatArray:
        """Return the position that the motor encoder reports, shape (…, n) [rad]."""
        return q

    def measured_torque(
        self, torque: Callable[[FloatArray], FloatArray], t: FloatArray
    ) -> FloatArray:
        """Return the torque that the robot reports.

        Args:
            torque: The true torque, as a function of times: (N,) [s] to (N, n) [N m].
            t: Times, shape (N,) [s].
        """
        return torque(t)
