"""Columns of the torque of each joint: its friction, and the links with a prior about each.

The inertial parameters of the links in a robot description are wrong by a part of their size. With
φ ~ N(φ₀, S²), S diagonal and half the size of each parameter, the torque of joint j is
Y_j φ₀ + Y_j S x, x ~ N(0, 1).
"""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from ..robot.dynamics import body_regressor
from ..robot.robot import Robot
from ..robot.samples import Samples

FRICTION_SPEED_SHARE = 0.05
"""Width of the smooth Coulomb step over the RMS speed [1]."""
OWN_COLUMNS = 4
"""Columns of a joint alone: offset, viscous and Coulomb friction, and rotor inertia."""
MIN_NOISE_SHARE = 1e-4
"""Smallest variance of the noise in a fit of these columns, over that of the joint's torque [1]."""
PRIOR_SHARE = 0.5
"""Prior standard deviation of a parameter, over its size in a body of LINK_RADIUS [1]."""
LINK_RADIUS = 0.2
"""Distance of a link's mass from its joint, by which its parameters are scaled [m]."""
MIN_MASS_SHARE = 0.05
"""Smallest mass by which a link's prior is scaled, over the largest of the robot [1]."""


def friction_columns(speed: FloatArray) -> FloatArray:
    """Return the columns of offset, viscous and Coulomb friction of a joint. Shape (N, 3)."""
    width = max(FRICTION_SPEED_SHARE * float(np.sqrt(np.mean(speed**2))), 1e-12)
    return np.column_stack([np.ones_like(speed), speed, np.tanh(speed / width)])


def link_columns(robot: Robot, motion: Samples) -> tuple[FloatArray, FloatArray]:
    """Return the nominal torque Y φ₀ and the columns Y S of all links.

    Args:
        robot: The robot.
        motion: Motion at N rows.

    Returns:
        The torque, shape (N, n) [N m or N], and the columns, shape (N, n, 10 links).
    """
    bodies = np.array([body.toDynamicParameters() for body in list(robot.model.inertias)[1:]])
    regressor = body_regressor(robot, motion)
    return np.asarray(regressor @ bodies.ravel()), regressor * _prior_std(bodies[:, 0])


def _prior_std(mass: FloatArray) -> FloatArray:
    """Prior standard deviations of mass, first and second moments of links, shape (10 links,)."""
    mass = np.maximum(mass, MIN_MASS_SHARE * mass.max())
    powers = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    return (PRIOR_SHARE * mass[:, None] * LINK_RADIUS**powers).ravel()
