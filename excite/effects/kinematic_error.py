"""Kinematic error: link lengths or joint axes differ from the model."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..identification.lowpass import Grid
from ..robot.dynamics import inverse_dynamics
from .effect import CandidateModel, Effect, Values
from .recorded_motion import FittedRobot, Motions, RecordedMotion

ANGLE_STEP = 1e-4
"""Rotation of the finite differences [rad]."""
LENGTH_STEP = 1e-5
"""Displacement of the finite differences [m]."""
MAX_ERROR = 0.2
"""Largest plausible error [rad or m], about a hundred times a usual one (0.1 to 2 mm, 0.01° to
0.2°): a bound of the prior."""
MIN_COLUMN_RATIO = 1e-6
"""Column over the largest one, below which it is rounding, as of a rotation about the joint's own
vertical axis."""


class _KinematicError(Effect):
    """Torque per rotation or displacement of all that follows a joint's link, in its frame.

    Where the model is "whole", the link itself is moved too.
    """

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        robot, links = motion.fitted_robot.robot, motion.fitted_robot.model
        columns, is_angle = [], model.values["angle"] > 0.0
        step, body = ANGLE_STEP if is_angle else LENGTH_STEP, robot.body_of(model.joint_index)
        children = [i for i in range(1, links.njoints) if links.parents[i] == body]
        for axis in range(3):
            moved = links.copy()
            twist = np.zeros(6)
            twist[(3 if is_angle else 0) + axis] = step
            change = pin.exp6(twist)
            for i in children:
                moved.jointPlacements[i] = change * moved.jointPlacements[i]
            if model.values["whole"]:
                moved.inertias[body] = change.act(moved.inertias[body])
            torque = inverse_dynamics(robot, moved, motion.coarse_samples)
            columns.append((torque - motion.rigid_torque) / step)
        out = np.stack(columns, axis=2)
        largest = np.abs(out).max(axis=(0, 1))
        return motion.lowpass(out * (largest > MIN_COLUMN_RATIO * largest.max()), Grid.COARSE)

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        """Yield angle and length errors, with and without the link's own inertia."""
        for is_angle, moves_link in product((1.0, 0.0), (0.0, 1.0)):
            yield CandidateModel(self, joint, {"angle": is_angle, "whole": moves_link})

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        return {"angle" if model.values["angle"] else "length": float(np.linalg.norm(c))}

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        return bool(np.linalg.norm(c) < MAX_ERROR)


KINEMATIC_ERROR = _KinematicError(
    "kinematic_error",
    "Σ δ_k ∂τ/∂(placement)_k",
    {"angle": "rad", "length": "m"},
    "small cross terms of gravity and inertia",
    "poses, and an external measurement of them",
    prior_only=True,
    of_link=True,
)
"""Geometric calibration error."""
