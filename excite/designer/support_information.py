"""Information of motions in support, as exported: its root after each of them."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from ..robot.floating_base import FloatingMotion, FloatingRobot, Rows
from ..robot.inertial_parameters import Parameters
from ..trajectory.rest_to_rest import PhaseProfile
from . import floating_identifiability
from .floating_identifiability import RowNoise
from .support_kinematics import support_samples
from .support_problem import profile_duration
from .support_stance import Stance


def exported_motion(
    robot: FloatingRobot,
    stance: Stance,
    parameters: Parameters,
    profile: PhaseProfile,
    rate: float,
) -> FloatingMotion:
    """Return the rows of a motion as exported, without the last one.

    Args:
        robot: The robot.
        stance: The feet and the standing pose.
        parameters: Its standard parameters.
        profile: Motion of the independent coordinates.
        rate: Rows per second [Hz].
    """
    t = np.arange(round(profile_duration(profile) * rate)) / rate
    return support_samples(robot, stance, parameters, profile, t).motion


def added_root(
    root: FloatArray,
    robot: FloatingRobot,
    parameters: Parameters,
    motion: FloatingMotion,
    noise: RowNoise,
    rows: Rows,
) -> FloatArray:
    """Return a root of information to which that of a motion is added.

    Args:
        root: R with RᵀR the information so far. Shape (r, P).
        robot: The robot.
        parameters: Its standard parameters.
        motion: The motion as exported.
        noise: Noise of the rows.
        rows: The rows.
    """
    added = floating_identifiability.information_root(robot, parameters, motion, noise, rows)
    return np.asarray(np.linalg.qr(np.vstack([root, added]), mode="r"))
