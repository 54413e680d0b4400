"""A robot with all its hidden physics, and the motion that it makes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from .._types import FloatArray
from ..errors import UnusableInput
from .actuator import ControllerGains, JointActuators, sample_actuators
from .closed_loop import ClosedLoop, StateHistory
from .mujoco_dynamics import GRAVITY, RigidBodyDynamics, build_dynamics
from .physical_effect import JointStates, PhysicalEffect, TransmissionSpring
from .reference_trajectory import ReferenceTrajectory
from .urdf_tree import UrdfTree

RIGID_STEP = 1e-3
"""Time step of a loop without elasticity or backlash [s]: the cycle of a 1 kHz controller."""
ELASTIC_MAX_STEP = 5e-4
"""Largest time step of a loop with elasticity or backlash [s].

Within its backlash gap a motor has a fraction of the inertia that its controller is tuned for and
limit-cycles in a loop of 2 ms; a link caught by gear teeth oscillates at hundreds of Hz.
"""


@dataclass(frozen=True)
class SimulatedRobot:
    """A robot with actuators, controller and hidden effects.

    Attributes:
        tree: Links with their true inertias, without hidden effects.
        joints: Names of the n joints.
        lock: Positions of the locked joints [rad or m].
        gravity: Gravity in the base frame, shape (3,) [m/s²].
        torque_limit: Largest torque of each joint, shape (n,) [N m or N].
        actuators: Rotor inertia, friction and offset of the joints.
        gains: Gains of the controller.
        effects: Hidden effects.
        step: Time step of the closed loop [s].
    """

    tree: UrdfTree
    joints: tuple[str, ...]
    lock: dict[str, float]
    gravity: tuple[float, ...]
    torque_limit: FloatArray
    actuators: JointActuators
    gains: ControllerGains
    effects: tuple[PhysicalEffect, ...] = ()
    step: float = RIGID_STEP

    @property
    def springs(self) -> list[TransmissionSpring]:
        """Elastic transmissions between motors and links."""
        return [
            spring
            for effect in self.effects
            if (spring := effect.transmission_spring()) is not None
        ]

    def dynamics(self) -> RigidBodyDynamics:
        """Build the rigid-body dynamics with the bodies and frames that the effects change.

        The coordinates of a base that moves come before the joints.
        """
        tree, gravity = self.tree, np.array(self.gravity)
        for effect in self.effects:
            tree, gravity = effect.modify_tree(tree), effect.modify_gravity(gravity)
        base_joints = tuple(name for name in tree.joints if name not in self.tree.joints)
        return build_dynamics(tree, base_joints + self.joints, self.lock, tuple(gravity))

    def follow(self, reference: ReferenceTrajectory) -> SimulatedMotion:
        """Simulate the closed loop along a reference.

        Raises:
            UnusableInput: Two effects need the same coordinates, or the loop is unstable.
        """
        self._check_effects_are_compatible()
        dynamics, actuators = self.dynamics(), self.actuators
        for effect in self.effects:
            actuators = effect.modify_actuators(actuators)
        bound = replace(
            self,
            actuators=actuators,
            effects=tuple(effect.bind(dynamics) for effect in self.effects),
        )
        suspensions = [s for effect in bound.effects if (s := effect.base_suspension()) is not None]
        step = min(self.step, ELASTIC_MAX_STEP) if bound.springs else self.step
        history = ClosedLoop(
            dynamics,
            actuators,
            self.gains,
            bound.effects,
            suspensions[0] if suspensions else None,
            self.torque_limit,
            step,
        ).run(reference)
        if not np.isfinite(history.q).all():
            raise UnusableInput(
                f"{self.tree.source}: the simulated control loop is unstable; "
                "make the hidden effects smaller"
            )
        return SimulatedMotion(bound, dynamics, history)

    def _check_effects_are_compatible(self) -> None:
        """Refuse two suspensions of the base and two springs in a joint."""
        base_effects = sum(
            type(effect).base_suspension is not PhysicalEffect.base_suspension
            for effect in self.effects
        )
        if base_effects > 1:
            raise UnusableInput(
                f"{self.tree.source}: more than one effect moves the base; "
                "keep one --effect base_compliance"
            )
        elastic = [spring.joint for spring in self.springs]
        for j in set(elastic):
            if elastic.count(j) > 1:
                raise UnusableInput(
                    f"{self.tree.source}: joint '{self.joints[j]}' has more than one spring; "
                    "give it elasticity or backlash, not both"
                )


class SimulatedMotion:
    """A simulated motion, interpolated by quintic splines between the steps of the loop.

    Positions are interpolated, so that accelerations are continuous and a link that oscillates
    between two steps stays in place, where integrated speeds would drift. Torques are computed
    anew along the splines by inverse dynamics, so that recorded torque and motion are consistent to
    machine precision.

    Attributes:
        robot: The robot, with effects bound to its dynamics.
        dynamics: Its rigid bodies.
        history: States at the steps of the loop.
        end: Time of the last state [s].
    """

    def __init__(
        self, robot: SimulatedRobot, dynamics: RigidBodyDynamics, history: StateHistory
    ) -> None:
        """Fit the splines."""
        self.robot, self.dynamics, self.history = robot, dynamics, history
        self.end = float(history.t[-1])
        self._links, self._motors = (
            _spline_and_derivatives(history.t, x) for x in (history.q, history.theta)
        )

    def link_motion(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration of base and links, shapes (N, k + n)."""
        return self._evaluate(self._links, t)

    def motor_motion(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration of the motors at the joints, shapes (N, n)."""
        return self._evaluate(self._motors, t)

    def _evaluate(
        self, splines: tuple[BSpline, BSpline, BSpline], t: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Evaluate splines at times within the motion."""
        t = np.clip(t, 0.0, self.end)
        q, v, a = (spline(t) for spline in splines)
        return q, v, a

    def joint_states(self, t: FloatArray) -> JointStates:
        """Return the states of the joints, with the torque that is transmitted to the links."""
        load = self.dynamics.inverse_dynamics(*self.link_motion(t))[
            :, self.dynamics.n - len(self.robot.joints) :
        ]
        q, v, a = self.motor_motion(t)
        return JointStates(t, q, v, a, load)

    def torque(self, t: FloatArray) -> FloatArray:
        """Return the torque of the actuators, shape (N, n) [N m]."""
        t = np.clip(t, 0.0, self.end)
        x, actuators, start = self.joint_states(t), self.robot.actuators, 0
        out = x.load + actuators.inertia * x.a + actuators.friction_torque(x.v)
        for effect in self.robot.effects:
            if type(effect).torque is PhysicalEffect.torque:
                continue
            z = np.column_stack(
                [
                    np.interp(t, self.history.t, self.history.z[:, i])
                    for i in range(start, start + effect.state_size)
                ]
                or [np.empty((len(t), 0))]
            )
            start += effect.state_size
            torque = effect.torque(x, z)
            out = out if torque is None else out + torque
        return out

    def measured(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return position and torque as the robot reports them, before noise. Shapes (N, n)."""
        q = self.motor_motion(t)[0]
        torque: Callable[[FloatArray], FloatArray] = self.torque
        for effect in self.robot.effects:
            q, torque = effect.measured_position(q), _as_measured(effect, torque)
        return q, torque(t)


def _spline_and_derivatives(t: FloatArray, x: FloatArray) -> tuple[BSpline, BSpline, BSpline]:
    """Return a quintic spline through positions at equidistant times, and two derivatives."""
    spline = make_interp_spline(t, x, k=5)
    return spline, spline.derivative(1), spline.derivative(2)


def _as_measured(
    effect: PhysicalEffect, torque: Callable[[FloatArray], FloatArray]
) -> Callable[[FloatArray], FloatArray]:
    """Return the torque with the measurement error of an effect, as a function of time."""
    return lambda t: effect.measured_torque(torque, t)


def sample_robot(
    tree: UrdfTree,
    reference: ReferenceTrajectory,
    rng: np.random.Generator,
    *,
    gains: ControllerGains | None = None,
    effects: Sequence[PhysicalEffect] = (),
) -> SimulatedRobot:
    """Sample a robot with random actuators, sized by the limits of its joints.

    Args:
        tree: Links with their true inertias.
        reference: Trajectory that states joints, locked joints and gravity.
        rng: Generator of the actuators.
        gains: Gains of the controller; None: the default ones.
        effects: Hidden effects.
    """
    lock = {str(k): float(v) for k, v in reference.robot.get("locked", {}).items()}
    gravity = tuple(float(g) for g in reference.robot.get("gravity", GRAVITY))
    dynamics = build_dynamics(tree, reference.joints, lock, gravity)
    velocity_limit, torque_limit = np.array(
        [tree.velocity_and_torque_limit(name) for name in reference.joints]
    ).T
    return SimulatedRobot(
        tree,
        reference.joints,
        lock,
        gravity,
        torque_limit,
        sample_actuators(dynamics, velocity_limit, torque_limit, rng),
        gains or ControllerGains(),
        tuple(effects),
    )
