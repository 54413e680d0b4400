"""A robot on a base that gives way a little: to first order, all that the base's own motion does to it and to the base.

M(q) ẍ + ∂τ/∂ẋ ẋ + ∂τ/∂x x = −τ for the six coordinates x of the base, slides along x, y, z and turns about them, with the derivatives of
inverse dynamics (Carpentier & Mansard, RSS 2018): an arm that reaches out aslant couples one turn with the other, gravity topples what
leans, and what moves on a turning base feels Coriolis forces.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ..robot.robot import Robot
from ..robot.samples import Samples

Array = np.ndarray
AXES = (
    pin.JointModelPX,
    pin.JointModelPY,
    pin.JointModelPZ,
    pin.JointModelRX,
    pin.JointModelRY,
    pin.JointModelRZ,
)


@dataclass(frozen=True)
class BaseAxesDynamics:
    """Of some coordinates of the base alone. mass, by_speed, by_place: of the base. Shapes (C, k, k). felt: what joints feel by its place,
    speed and acceleration. Three of (C, n, k). force: what the robot pushes it with beyond its mean. Shape (C, k)."""

    mass: Array
    by_speed: Array
    by_place: Array
    felt: tuple[Array, Array, Array]
    force: Array


@dataclass(frozen=True)
class FloatingBaseDynamics:
    """mass, by_speed, by_place: forces on the base, then torques on the joints, by the base's acceleration, speed and place. Shapes
    (C, 6 + n, 6). reaction: force and moment that hold the base. Shape (C, 6)."""

    mass: Array
    by_speed: Array
    by_place: Array
    reaction: Array
    _cuts: dict[tuple[int, ...], BaseAxesDynamics] = field(
        default_factory=dict, init=False, compare=False, repr=False
    )

    def cut(self, axes: tuple[int, ...]) -> BaseAxesDynamics:
        """Of a base that moves along some axes; made once, for it is asked for with many springs."""
        if axes not in self._cuts:
            which = list(axes)
            mass, by_speed, by_place = (
                x[:, :, which] for x in (self.mass, self.by_speed, self.by_place)
            )
            push = self.reaction[:, which].mean(axis=0) - self.reaction[:, which]
            felt = by_place[:, 6:].copy(), by_speed[:, 6:].copy(), mass[:, 6:].copy()
            self._cuts[axes] = BaseAxesDynamics(
                mass[:, which], by_speed[:, which], by_place[:, which], felt, push
            )
        return self._cuts[axes]


def floating_base_dynamics(robot: Robot, model: pin.Model, motion: Samples) -> FloatingBaseDynamics:
    """Along a motion of the joints, the base at rest. model: the robot's, with its inertias."""
    free = _freed(model)
    data, still, count = free.createData(), np.zeros(6), len(motion)
    shape = count, 6 + robot.n, 6
    by_place, by_speed, mass = np.empty(shape), np.empty(shape), np.empty(shape)
    reaction = np.empty((count, 6))
    told = np.vstack(
        [
            np.hstack([np.eye(6), np.zeros((6, model.nv))]),
            np.hstack([np.zeros((robot.n, 6)), robot.spread.T]),
        ]
    )
    states = zip(
        robot.expand(motion.q), motion.dq @ robot.spread.T, motion.ddq @ robot.spread.T, strict=True
    )
    for t, state in enumerate(states):
        found = pin.computeRNEADerivatives(free, data, *(np.concatenate([still, x]) for x in state))
        by_place[t], by_speed[t] = (told @ slope[:, :6] for slope in found[:2])
        mass[t] = told @ (np.triu(found[2]) + np.triu(found[2], 1).T)[:, :6]
        reaction[t] = data.tau[:6]
    return FloatingBaseDynamics(mass, by_speed, by_place, reaction)


def _freed(model: pin.Model) -> pin.Model:
    """The robot on three slides and three hinges."""
    base, last = pin.Model(), 0
    for number, axis in enumerate(AXES):
        last = base.addJoint(last, axis(), pin.SE3.Identity(), f"excite_base_{number}")
    stand = base.addFrame(
        pin.Frame("excite_base", last, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME)
    )
    out = pin.appendModel(base, model, stand, pin.SE3.Identity())
    out.gravity = model.gravity
    return out
