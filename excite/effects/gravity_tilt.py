"""Gravity tilt: the base is not level."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import Grid
from .effect import CandidateModel, Effect, Values
from .recorded_motion import FittedRobot, Motions, RecordedMotion

MAX_TILT_SINE = 0.7
"""Largest sine of the tilt angle."""
MAX_LENGTH_ERROR = 0.1
"""Largest error of gravity's magnitude, over the sine of the tilt."""
MAX_UNOBSERVED_LENGTH = 0.08
"""Loss of magnitude that a tilt of 0.4 rad about an axis that no joint observes causes."""


class _GravityTilt(Effect):
    """Torque per rotation about x and y; for a large tilt also by the change along gravity."""

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        base = motion.base_dynamics
        columns = [base.by_place[:, 6:, 3:5]]
        if model.values.get("large"):  # gravity acts like an acceleration of the base
            gravity = motion.fitted_robot.model.gravity.linear
            columns.append(-(base.mass[:, 6:, :3] @ gravity)[:, :, None])
        return motion.lowpass(np.concatenate(columns, axis=2), Grid.COARSE)

    def candidates(self, motions: Motions) -> Iterator[CandidateModel]:
        """Yield a small tilt, and where the model's gravity is vertical a large one."""
        is_upright = not np.any(motions[0].fitted_robot.model.gravity.linear[:2])
        for large in (0.0, 1.0) if is_upright else (0.0,):
            yield CandidateModel(self, None, {"large": large})

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        """Return roll and pitch, as in URDF, from the change of gravity across and along it."""
        if len(c) == 2:
            return {"roll": float(c[0]), "pitch": float(c[1])}
        return {
            "roll": float(np.arctan2(c[0], 1.0 + c[2])),
            "pitch": float(np.arctan2(c[1], np.hypot(c[0], 1.0 + c[2]))),
        }

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        """Check that gravity is rotated but not lengthened.

        It may appear shorter to an arm that does not observe the whole rotation.
        """
        across = float(np.hypot(c[0], c[1]))
        if len(c) == 2 or across > MAX_TILT_SINE:
            return across < MAX_TILT_SINE
        excess = float(c[2] - np.sqrt(1.0 - across**2) + 1.0)
        tolerance = MAX_LENGTH_ERROR * across
        return -MAX_UNOBSERVED_LENGTH - tolerance < excess < tolerance


GRAVITY_TILT = _GravityTilt(
    "gravity_tilt",
    "∂τ/∂g (Rᵀ − 1) g, R = roll and pitch of the base",
    {"roll": "rad", "pitch": "rad"},
    "joint 1 of an upright arm feels gravity",
    "joint 1 a full turn, arm stretched",
    prior_only=True,
    form_std={"roll": 0.05, "pitch": 0.05},
)
"""Tilted base, wrong mounting orientation."""
