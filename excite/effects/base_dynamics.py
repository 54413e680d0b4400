"""Dynamics of a robot on a compliant base, linearised about a base at rest.

M(q) ẍ + ∂τ/∂ẋ ẋ + ∂τ/∂x x = −τ for the six coordinates x of the base, translations along x, y, z
and rotations about them, with the derivatives of inverse dynamics (Carpentier & Mansard, Analytical
derivatives of rigid body dynamics algorithms, RSS 2018). They contain the coupling of rotations by
an extended arm, the destabilising moment of gravity, and Coriolis forces on a rotating base.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..robot.robot import Robot
from ..robot.samples import Samples

BASE_JOINTS = (
    pin.JointModelPX,
    pin.JointModelPY,
    pin.JointModelPZ,
    pin.JointModelRX,
    pin.JointModelRY,
    pin.JointModelRZ,
)
"""Joints between the ground and the robot, one for each coordinate of the base."""


@dataclass(frozen=True)
class FloatingBaseDynamics:
    """Linearised dynamics of the robot with respect to its base.

    Attributes:
        mass: Forces on the base, then torques on the joints, per base acceleration, shape
            (C, 6 + n, 6).
        by_speed: The same per base velocity.
        by_place: The same per base displacement.
        reaction: Force and moment that hold the base, shape (C, 6).
    """

    mass: FloatArray
    by_speed: FloatArray
    by_place: FloatArray
    reaction: FloatArray


def floating_base_dynamics(robot: Robot, model: pin.Model, motion: Samples) -> FloatingBaseDynamics:
    """Linearise the dynamics about a base at rest along C samples of the joints."""
    free = _on_floating_base(model)
    data, zero, count = free.createData(), np.zeros(6), len(motion)
    slopes, mass = np.empty((2, count, free.nv, 6)), np.empty((count, 6, free.nv))
    reaction = np.empty((count, 6))
    selection = np.vstack(
        [
            np.hstack([np.eye(6), np.zeros((6, model.nv))]),
            np.hstack([np.zeros((robot.n, 6)), robot.spread.T]),
        ]
    )
    states = zip(
        robot.expand(motion.q), motion.dq @ robot.spread.T, motion.ddq @ robot.spread.T, strict=True
    )
    for t, state in enumerate(states):
        by_place, by_speed, upper = pin.computeRNEADerivatives(
            free, data, *(np.concatenate([zero, x]) for x in state)
        )
        slopes[0, t], slopes[1, t], mass[t] = by_place[:, :6], by_speed[:, :6], upper[:6]
        reaction[t] = data.tau[:6]
    mass[:, :, :6] = symmetric(mass[:, :, :6])
    by_place, by_speed = selection @ slopes
    return FloatingBaseDynamics(selection @ mass.swapaxes(1, 2), by_speed, by_place, reaction)


def symmetric(upper: FloatArray) -> FloatArray:
    """Return symmetric matrices with given upper triangles, shape (…, k, k)."""
    return np.asarray(np.triu(upper) + np.triu(upper, 1).swapaxes(-1, -2))


def _on_floating_base(model: pin.Model) -> pin.Model:
    """The robot mounted on three prismatic and three revolute joints."""
    base, last = pin.Model(), 0
    for number, joint in enumerate(BASE_JOINTS):
        last = base.addJoint(last, joint(), pin.SE3.Identity(), f"excite_base_{number}")
    mount = base.addFrame(
        pin.Frame("excite_base", last, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME)
    )
    out = pin.appendModel(base, model, mount, pin.SE3.Identity())
    out.gravity = model.gravity
    return out
