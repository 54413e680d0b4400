"""Torque columns that were exchanged between two joints, shown by a fit of all links.

The torques of all joints come from the same links. With the torques as read and with those of two
joints exchanged, the inertial parameters φ of all links and the friction and rotor inertia of each
joint are fitted to a part of the rows and predict the others:

    τ_π(j) = Y_j φ + F_j f_j + e_j,   φ ~ N(φ₀, S²),   e_j ~ N(0, σ_j²),

with the vague prior of `link_columns` around the nominal parameters φ₀. Unlike a comparison with
the nominal torque itself, this judges joints whose torque is mostly friction, and links that are
poorly known.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..robot.robot import Robot
from ..robot.samples import Samples
from .nominal_comparison import ROUNDING
from .torque_columns import MIN_NOISE_SHARE, OWN_COLUMNS, friction_columns, link_columns

FOLDS = 5
"""Number of consecutive parts of the rows, each of which is predicted from the others."""
RIDGE = 1e-3
"""Regularization of the fit of a single joint, over the mean of its information's diagonal [1]."""
MAX_UNEXPLAINED = 0.3
"""Largest unexplained share of the torque of both joints, predicted with the torques exchanged [1].
Where more remains, as at a wrist of which no model holds, neither order is shown."""
MIN_LOG_GAIN = 0.5
"""Smallest gain by which an exchange is shown: the logarithm of the ratio of prediction errors,
summed over the joints [1]. Of the 266 pairs in 24 recordings of six real robots, whose columns are
right, it is 0.0 at most among those that MAX_UNEXPLAINED admits."""


@dataclass(frozen=True)
class TorqueExchange:
    """Two joints whose torques are predicted better if they are exchanged.

    Attributes:
        first: Index of a joint.
        second: Index of the other.
        before: Unexplained shares of their predicted torques as read. Shape (2,).
        after: The same with the torques exchanged. Shape (2,).
    """

    first: int
    second: int
    before: FloatArray
    after: FloatArray


@dataclass(frozen=True)
class _JointEquations:
    """Normal equations of a joint's row with the torque columns of all joints, fold by fold.

    Attributes:
        information: XᵀX of the columns X = [F_j, Y_j S]. Shape (FOLDS, k, k).
        right: Xᵀ(τ_i − Y_j φ₀) for the torque of each joint i. Shape (FOLDS, k, n).
        power: Sum of squares of τ_i − Y_j φ₀. Shape (FOLDS, n).
    """

    information: FloatArray
    right: FloatArray
    power: FloatArray


def find_exchange(
    robot: Robot, motion: Samples, torque: FloatArray, independent: float
) -> TorqueExchange | None:
    """Find the two joints whose torques are exchanged, if an exchange predicts them far better.

    Args:
        robot: The robot.
        motion: Motion at N rows.
        torque: Torque as read. Shape (N, n) [N m or N].
        independent: Number of rows with independent errors, over N [1].
    """
    n = robot.n
    equations = _joint_equations(robot, motion, torque)
    size = np.maximum(np.sum((torque - torque.mean(axis=0)) ** 2, axis=0), 1e-300)
    noise = _noise(equations, size / len(torque), len(torque))
    before = _errors(equations, list(range(n)), noise, independent) / size + ROUNDING
    best, best_gain = None, MIN_LOG_GAIN
    for first, second in itertools.combinations(range(n), 2):
        order = list(range(n))
        order[first], order[second] = second, first
        after = _errors(equations, order, noise, independent) / size[order] + ROUNDING
        pair = [first, second]
        gain = 0.5 * float(np.log(before / after).sum())
        # each of the two torques must belong to the other joint, not one of them alone
        are_exchanged = bool((after[pair[::-1]] < before[pair]).all())
        if gain > best_gain and are_exchanged and after[pair].max() < MAX_UNEXPLAINED:
            best, best_gain = TorqueExchange(first, second, before[pair], after[pair]), gain
    return best


def _joint_equations(robot: Robot, motion: Samples, torque: FloatArray) -> list[_JointEquations]:
    """Build the equations of each joint's row."""
    n, rows = robot.n, len(torque)
    (nominal, columns), out = link_columns(robot, motion), []
    fold = np.arange(rows) * FOLDS // rows
    for j in range(n):
        alone = np.column_stack([friction_columns(motion.dq[:, j]), motion.ddq[:, j]])
        X = np.column_stack([alone, columns[:, j]])
        y = torque - nominal[:, [j]]
        parts = [(X[fold == k], y[fold == k]) for k in range(FOLDS)]
        out.append(
            _JointEquations(
                np.array([a.T @ a for a, _ in parts]),
                np.array([a.T @ b for a, b in parts]),
                np.array([np.sum(b**2, axis=0) for _, b in parts]),
            )
        )
    return out


def _errors(
    equations: list[_JointEquations], order: list[int], noise: FloatArray, independent: float
) -> FloatArray:
    """Sum of squared errors of the predicted folds at the row of each joint, shape (n,).

    Args:
        equations: Equations of each joint.
        order: Index of the torque column that each joint takes.
        noise: σ² of each joint's row with each torque. Shape (n, n).
        independent: Number of rows with independent errors, over that of all [1].
    """
    m, out = OWN_COLUMNS, np.zeros(len(equations))
    total = [joint.information.sum(axis=0) for joint in equations]
    total_right = [joint.right.sum(axis=0) for joint in equations]
    for k in range(FOLDS):
        normal = np.eye(total[0].shape[0] - m)
        right, eliminated = np.zeros(len(normal)), []
        for j, (joint, i) in enumerate(zip(equations, order, strict=True)):
            G = total[j] - joint.information[k]
            h = total_right[j][:, i] - joint.right[k, :, i]
            inverse = np.linalg.pinv(G[:m, :m])
            weight = independent / noise[j, i]
            normal += weight * (G[m:, m:] - G[m:, :m] @ inverse @ G[:m, m:])
            right += weight * (h[m:] - G[m:, :m] @ inverse @ h[:m])
            eliminated.append((inverse, G[:m, m:], h[:m]))
        links = np.linalg.solve(normal, right)
        for j, (joint, i) in enumerate(zip(equations, order, strict=True)):
            inverse, mixed, h = eliminated[j]
            fitted = np.concatenate([inverse @ (h - mixed @ links), links])
            squares = fitted @ joint.information[k] @ fitted
            out[j] += joint.power[k, i] - 2.0 * fitted @ joint.right[k, :, i] + squares
    return np.maximum(out, 0.0)


def _noise(equations: list[_JointEquations], variance: FloatArray, rows: int) -> FloatArray:
    """Return σ² of each joint's row with the torque of each joint, shape (n, n)."""
    out = np.empty((len(equations), len(equations)))
    for j, joint in enumerate(equations):
        information, right = joint.information.sum(axis=0), joint.right.sum(axis=0)
        scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
        ridge = RIDGE * np.eye(len(scale))
        fitted = np.linalg.solve(
            information / np.outer(scale, scale) + ridge, right / scale[:, None]
        )
        fitted /= scale[:, None]
        remaining = joint.power.sum(axis=0) - np.sum(fitted * right, axis=0)
        out[j] = np.maximum(remaining / rows, 0.0) + MIN_NOISE_SHARE * variance
    return out
