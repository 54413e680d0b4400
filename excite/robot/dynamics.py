"""Rigid-body dynamics by Pinocchio: the oracle that certifies, independent of what the optimiser
differentiates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from .inertial_parameters import COULOMB_WIDTH, Parameters
from .robot import Robot
from .samples import Samples

BLOCK_NUMBERS = 1 << 22
"""Numbers of a regressor that are held at once (32 MiB), whatever the length of a motion."""


def body_regressor(robot: Robot, motion: Samples) -> FloatArray:
    """Columns of Y of the bodies' inertial parameters at every sample. Shape (N, n, 10 bodies)."""
    model, data = robot.model, robot.model.createData()
    q, dq, ddq = robot.expand(motion.q), motion.dq @ robot.spread.T, motion.ddq @ robot.spread.T
    inertial = np.empty((len(motion), model.nv, 10 * (model.njoints - 1)))
    for t in range(len(motion)):
        inertial[t] = pin.computeJointTorqueRegressor(model, data, q[t], dq[t], ddq[t])
    simple = model.nv == robot.n
    return inertial if simple else np.einsum("vi,tvp->tip", robot.spread, inertial)


def regressor(robot: Robot, parameters: Parameters, motion: Samples) -> FloatArray:
    """Y with τ = Y ψ at every sample (eq. 9). Shape (N, n, P) [N m per unit of ψ]."""
    inertial = body_regressor(robot, motion)
    out = np.zeros((len(motion), robot.n, parameters.count))
    out[:, :, : inertial.shape[2]] = inertial
    columns = {
        "rotor_inertia": motion.ddq,
        "viscous": motion.dq,
        "coulomb": np.tanh(motion.dq / COULOMB_WIDTH),
        "offset": np.ones_like(motion.q),
    }
    rows, start = np.arange(robot.n), inertial.shape[2]
    for kind in parameters.drive:
        out[:, rows, start + rows] = columns[kind]
        start += robot.n
    return out


def inverse_dynamics(robot: Robot, model: pin.Model, motion: Samples) -> FloatArray:
    """Torque of rigid bodies, those of a variant of the robot's model. Shape (N, n) [N m]."""
    data, spread = model.createData(), robot.spread
    states = zip(robot.expand(motion.q), motion.dq @ spread.T, motion.ddq @ spread.T, strict=True)
    return np.asarray(np.array([pin.rnea(model, data, *state) for state in states]) @ spread)


def regressor_blocks(robot: Robot, parameters: Parameters, motion: Samples) -> Iterator[FloatArray]:
    """Y at consecutive samples, in blocks of at most BLOCK_NUMBERS numbers. Shape (≤ N, n, P)
    each."""
    size = max(BLOCK_NUMBERS // (robot.n * parameters.count), 16)
    for start in range(0, len(motion), size):
        yield regressor(robot, parameters, motion.rows(slice(start, start + size)))


def torque(robot: Robot, parameters: Parameters, motion: Samples) -> FloatArray:
    """Nominal torque Yψ₀. Shape (N, n) [N m]."""
    return torque_band(robot, parameters, motion, 0.0)[0]


def torque_band(
    robot: Robot, parameters: Parameters, motion: Samples, radius: float
) -> tuple[FloatArray, FloatArray]:
    """Nominal torque and the half-width of `band` along a motion of any length. Shapes (N, n)."""
    nominal, width = [np.empty((0, robot.n))], [np.empty((0, robot.n))]
    for Y in regressor_blocks(robot, parameters, motion):
        middle, half = band(Y, parameters, radius)
        nominal.append(middle)
        width.append(half)
    return np.concatenate(nominal), np.concatenate(width)


def positions(robot: Robot, frame: str, q: FloatArray) -> FloatArray:
    """Origin of a frame in the base frame. Shapes (N, n) -> (N, 3) [m]."""
    model, data, index = robot.model, robot.model.createData(), robot.frame(frame)
    out = np.empty((len(q), 3))
    for t, configuration in enumerate(robot.expand(q)):
        pin.forwardKinematics(model, data, configuration)
        out[t] = pin.updateFramePlacement(model, data, index).translation
    return out


def band(Y: FloatArray, parameters: Parameters, radius: float) -> tuple[FloatArray, FloatArray]:
    """Nominal torque Yψ₀ and its half-width r √(Y G₀⁻¹ Yᵀ) over the ball of radius r in the metric.
    Shapes (N, n)."""
    nominal = Y @ parameters.nominal
    width = (
        radius * np.sqrt(np.einsum("tip,tip->ti", Z := Y @ parameters.scale, Z))
        if radius
        else np.zeros_like(nominal)
    )
    return nominal, width
