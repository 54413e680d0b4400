"""A robot with all its physics: it moves, and along that motion its drives give exactly the torque that the motion needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from .._types import FloatArray
from ..errors import UnusableInput
from . import mujoco_dynamics as arms
from .actuator import ControllerGains, JointActuators
from .closed_loop import ClosedLoop, StateHistory
from .mujoco_dynamics import RigidBodyDynamics
from .physical_effect import JointStates, PhysicalEffect, TransmissionSpring
from .reference_trajectory import ReferenceTrajectory
from .urdf_tree import UrdfTree

ELASTIC_MAX_STEP = 5e-4
"""Longest step where a joint winds up or has play [s]: a motor between its teeth carries a fraction of the inertia that its controller is
tuned for, and rattles in a loop of two milliseconds; a link that teeth catch swings at hundreds of Hz."""


@dataclass(frozen=True)
class SimulatedRobot:
    """tree: the true bodies, without effects. limit: torque limits, Shape (n,) [N m]. laws: the hidden effects. step: of the loop [s]."""

    tree: UrdfTree
    joints: tuple[str, ...]
    lock: dict[str, float]
    gravity: tuple[float, ...]
    limit: FloatArray
    drive: JointActuators
    control: ControllerGains
    effects: tuple[PhysicalEffect, ...] = ()
    step: float = 1e-3

    @property
    def springs(self) -> list[TransmissionSpring]:
        """What lies between motors and links."""
        return [spring for law in self.effects if (spring := law.transmission_spring()) is not None]

    def without_effects(self) -> SimulatedRobot:
        """The same robot with nothing hidden."""
        return replace(self, effects=())

    def arm(self) -> RigidBodyDynamics:
        """The rigid bodies as the effects leave them; a base that moves has its coordinates before the joints."""
        tree, gravity = self.tree, np.array(self.gravity)
        for law in self.effects:
            tree, gravity = law.modify_tree(tree), law.gravity(gravity)
        extra = tuple(name for name in tree.joints if name not in self.tree.joints)
        return arms.build_dynamics(tree, extra + self.joints, self.lock, tuple(gravity))

    def run(self, reference: ReferenceTrajectory) -> SimulatedMotion:
        """Close the loop on a reference."""
        self._require_room()
        arm, drive = self.arm(), self.drive
        for law in self.effects:
            drive = law.modify_actuators(drive)
        bound = replace(self, drive=drive, effects=tuple(law.bind(arm) for law in self.effects))
        carried = [s for law in bound.effects if (s := law.base_suspension()) is not None]
        step = min(self.step, ELASTIC_MAX_STEP) if bound.springs else self.step
        trace = ClosedLoop(
            arm,
            drive,
            self.control,
            bound.effects,
            carried[0] if carried else None,
            self.limit,
            step,
        ).run(reference)
        if not np.isfinite(trace.q).all():
            raise UnusableInput(
                f"{self.tree.source}: the controller loses this robot; make the hidden effects smaller"
            )
        return SimulatedMotion(bound, arm, trace)

    def _require_room(self) -> None:
        """A base moves on one set of springs, a joint winds up in one."""
        if (
            sum(
                type(law).base_suspension is not PhysicalEffect.base_suspension
                for law in self.effects
            )
            > 1
        ):
            raise UnusableInput(
                f"{self.tree.source}: more than one effect moves the base; leave one --effect base_compliance"
            )
        wound = [spring.joint for spring in self.springs]
        for j in set(wound):
            if wound.count(j) > 1:
                raise UnusableInput(
                    f"{self.tree.source}: joint '{self.joints[j]}' has more than one spring; give it elasticity or backlash, not both"
                )


class SimulatedMotion:
    """A finished motion, smooth between the steps of the loop: positions are splines of the fifth order, so that accelerations are smooth
    and a link that is knocked back and forth between two steps stays where it was (integrals of speeds drift).

    Torques are recomputed along it, not taken from the controller: what is recorded is consistent to machine precision.
    """

    def __init__(self, plant: SimulatedRobot, arm: RigidBodyDynamics, trace: StateHistory) -> None:
        self.robot, self.arm, self.history = plant, arm, trace
        self.end = float(trace.t[-1])
        self._links, self._motors = (
            _spline_and_derivatives(trace.t, x) for x in (trace.q, trace.theta)
        )

    def links(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration of base and links. Shapes (N, k + n)."""
        return self._at(self._links, t)

    def motor_motion(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The same of the motors, at the joints' shafts. Shapes (N, n)."""
        return self._at(self._motors, t)

    def _at(
        self, motion: tuple[BSpline, BSpline, BSpline], t: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        t = np.clip(t, 0.0, self.end)
        q, v, a = (spline(t) for spline in motion)
        return q, v, a

    def joint_states(self, t: FloatArray) -> JointStates:
        """The joints at times t, with the torque that passes to the links."""
        load = self.arm.inverse_dynamics(*self.links(t))[:, self.arm.n - len(self.robot.joints) :]
        q, v, a = self.motor_motion(t)
        return JointStates(t, q, v, a, load)

    def torque(self, t: FloatArray) -> FloatArray:
        """What the drives gave. Shape (N, n) [N m]."""
        t = np.clip(t, 0.0, self.end)
        x, drive, at = self.joint_states(t), self.robot.drive, 0
        out = x.load + drive.inertia * x.a + drive.friction_torque(x.v)
        for law in self.robot.effects:
            if type(law).torque is PhysicalEffect.torque:
                continue
            z = np.column_stack(
                [
                    np.interp(t, self.history.t, self.history.z[:, i])
                    for i in range(at, at + law.state_size)
                ]
                or [np.empty((len(t), 0))]
            )
            at += law.state_size
            more = law.torque(x, z)
            out = out if more is None else out + more
        return out

    def measured_torque(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position and torque as the robot tells them, before noise. Shapes (N, n)."""
        q = self.motor_motion(t)[0]
        ask: Callable[[FloatArray], FloatArray] = self.torque
        for law in self.robot.effects:
            q, ask = law.measured_position(q), _wrapped(law, ask)
        return q, ask(t)


def _spline_and_derivatives(t: FloatArray, x: FloatArray) -> tuple[BSpline, BSpline, BSpline]:
    """A smooth motion through positions at equal times, its speed and its acceleration."""
    spline = make_interp_spline(t, x, k=5)
    return spline, spline.derivative(1), spline.derivative(2)


def _wrapped(
    law: PhysicalEffect, ask: Callable[[FloatArray], FloatArray]
) -> Callable[[FloatArray], FloatArray]:
    return lambda t: law.measured_torque(ask, t)


def draw_robot(
    tree: UrdfTree,
    reference: ReferenceTrajectory,
    rng: np.random.Generator,
    *,
    control: ControllerGains | None = None,
    laws: Sequence[PhysicalEffect] = (),
) -> SimulatedRobot:
    """A robot with drives drawn at random, sized by the tree's limits."""
    from . import actuator

    lock = {str(k): float(v) for k, v in reference.robot.get("locked", {}).items()}
    gravity = tuple(float(g) for g in reference.robot.get("gravity", arms.GRAVITY))
    arm = arms.build_dynamics(tree, reference.joints, lock, gravity)
    speed, torque = np.array([tree.velocity_and_torque_limit(name) for name in reference.joints]).T
    return SimulatedRobot(
        tree,
        reference.joints,
        lock,
        gravity,
        torque,
        actuator.draw_actuators(arm, speed, torque, rng),
        control or ControllerGains(),
        tuple(laws),
    )
