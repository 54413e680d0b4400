"""Kinematic error: link lengths or joint axes differ from the model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..identification.lowpass import Grid
from ..robot.dynamics import inverse_dynamics
from .effect import CandidateModel, Effect
from .recorded_motion import RecordedMotion

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


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Torque per rotation or displacement of all that follows a joint's link, in its frame.

    Where the model is "whole", the link itself is moved too.
    """
    robot, columns, samples = motion.fitted_robot.robot, [], motion.coarse_samples
    is_angle, body = model.values["angle"] > 0.0, robot.body_of(model.joint_index)
    pinocchio_model = motion.fitted_robot.model
    children = [i for i in range(1, pinocchio_model.njoints) if pinocchio_model.parents[i] == body]
    for axis in range(3):
        moved = pinocchio_model.copy()
        twist = np.zeros(6)
        twist[(3 if is_angle else 0) + axis] = ANGLE_STEP if is_angle else LENGTH_STEP
        change = pin.exp6(twist)
        for i in children:
            moved.jointPlacements[i] = change * moved.jointPlacements[i]
        if model.values["whole"]:
            moved.inertias[body] = change.act(moved.inertias[body])
        torque = inverse_dynamics(robot, moved, samples)
        columns.append((torque - motion.rigid_torque) / (ANGLE_STEP if is_angle else LENGTH_STEP))
    out = np.stack(columns, axis=2)
    largest = np.abs(out).max(axis=(0, 1))
    return motion.lowpass(out * (largest > MIN_COLUMN_RATIO * largest.max()), Grid.COARSE)


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Angle and length errors of every joint, with and without the link's own inertia."""

    def is_small(c: FloatArray) -> bool:
        return bool(np.linalg.norm(c) < MAX_ERROR)

    def norm(name: str) -> Callable[[FloatArray], dict[str, float]]:
        return lambda c: {name: float(np.linalg.norm(c))}

    for j in range(motions[0].n):
        for is_angle, name in ((1.0, "angle"), (0.0, "length")):
            for moves_link in (0.0, 1.0):
                yield CandidateModel(
                    "kinematic_error",
                    j,
                    _columns,
                    {"angle": is_angle, "whole": moves_link},
                    parameters=norm(name),
                    is_plausible=is_small,
                )


KINEMATIC_ERROR = Effect(
    "kinematic_error",
    "Σ δ_k ∂τ/∂(placement)_k",
    _columns,
    _candidates,
    {"angle": "rad", "length": "m"},
    "small cross terms of gravity and inertia",
    "poses, and an external measurement of them",
    prior_only=True,
    of_link=True,
)
"""Geometric calibration error."""
