"""Practical identifiability of the bodies of a floating-base robot by a motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .._linear_algebra import triangle
from .._types import FloatArray
from ..robot import floating_base
from ..robot.base_parameters import Base
from ..robot.floating_base import FloatingMotion, FloatingRobot, Rows
from ..robot.inertial_parameters import Parameters
from ..robot.limits import Limits
from . import identifiability
from .identifiability import Identifiability
from .identifiability_threshold import IDENTIFIABLE_VARIANCE

WRENCH_NOISE_SHARE = 0.01
"""Assumed noise of a contact force over the robot's weight [1], as of torque over its limit."""
WRENCH_NOISE_LEVER = 0.1
"""Lever at which this force makes the assumed noise of a moment [m]: half the length of a foot."""


@dataclass(frozen=True)
class RowNoise:
    """Noise of the rows of a floating-base robot.

    Attributes:
        force: Standard deviation of the force on the base [N].
        moment: That of the moment about the origin of the base link [N m].
        torque: That of each joint torque. Shape (n,) [N m].
    """

    force: float
    moment: float
    torque: FloatArray

    def of(self, rows: Rows) -> FloatArray:
        """Return the standard deviation of each row. Shape (r,)."""
        both = np.concatenate([[self.force] * 3, [self.moment] * 3, self.torque])
        return np.asarray(both[rows.selection(len(self.torque))])


def assumed_noise(
    robot: FloatingRobot,
    limits: Limits,
    wrench: tuple[float, float] | None = None,
    torque: tuple[float, ...] | None = None,
) -> RowNoise:
    """Return the noise of the rows: as stated, else 1 % of the weight and of the torque limits.

    Args:
        robot: The robot.
        limits: Limits of its joints.
        wrench: Standard deviations of force and moment [N, N m]; None: assumed.
        torque: Standard deviation of each joint torque [N m]; None: assumed.
    """
    weight = robot.mass * float(np.linalg.norm(robot.model.gravity.linear))
    force = WRENCH_NOISE_SHARE * weight
    return RowNoise(
        *(wrench or (force, WRENCH_NOISE_LEVER * force)),
        WRENCH_NOISE_SHARE * limits.torque if torque is None else np.array(torque, float),
    )


def information_root(
    robot: FloatingRobot,
    parameters: Parameters,
    motion: FloatingMotion,
    noise: RowNoise,
    rows: Rows = Rows.BOTH,
) -> FloatArray:
    """Return R with RᵀR = Σₜ Yᵀ Σ⁻¹ Y of the rows along a motion, in bounded memory.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        motion: The motion.
        noise: Noise of the rows.
        rows: The rows.

    Returns:
        Shape (≤ P, P).
    """
    blocks = floating_base.regressor_blocks(robot, parameters, motion, rows)
    return identifiability.root_of_blocks(blocks, noise.of(rows), parameters.count)


def added_root(
    root: FloatArray,
    robot: FloatingRobot,
    parameters: Parameters,
    motion: FloatingMotion,
    noise: RowNoise,
    rows: Rows,
) -> FloatArray:
    """Return a root of information to which that of a motion is added; see `information_root`."""
    added = information_root(robot, parameters, motion, noise, rows)
    return triangle(np.vstack([root, added]))


def analyse(
    robot: FloatingRobot,
    parameters: Parameters,
    base: Base,
    root: FloatArray,
    noise: RowNoise,
    rows: Rows = Rows.BOTH,
    *,
    threshold: float = IDENTIFIABLE_VARIANCE,
    samples: int | None = None,
) -> Identifiability:
    """Analyse identifiability from a root of the information.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        base: Its base parameters in the rows.
        root: Result of `information_root`, or several of them stacked. Shape (m, P).
        noise: Noise of the rows.
        rows: The rows.
        threshold: Largest scale-free variance of an identifiable direction [1].
        samples: Number of samples of the motion, for the record.
    """
    analysis = identifiability.analyse_root(
        parameters, base, root, noise.of(rows), robot, threshold=threshold, samples=samples
    )
    return replace(analysis, joint_names=robot.row_names[rows.selection(robot.n)])
