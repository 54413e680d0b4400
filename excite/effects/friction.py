"""Coulomb and viscous friction, and the largest speed, which several frictions need."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel
from .joint_torque import JointTorque
from .recorded_motion import RecordedMotion


def max_speed(motions: Sequence[RecordedMotion], joint: int) -> float:
    """Return the largest speed of a joint [rad/s]."""
    return max(float(np.abs(motion.samples.dq[:, joint]).max()) for motion in motions)


class _Friction(JointTorque):
    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        return bool((c >= 0.0).all())


FRICTION = _Friction(
    "friction",
    "F_c sgn q̇ + F_v q̇, where the model has none",
    {"coulomb": "N m", "viscous": "N m s/rad"},
    "torque against the motion",
    "any motion in both directions",
    nonnegative=(True, True),
    prior_only=True,
    form_std={"coulomb": 0.04, "viscous": 0.04},
)
"""Coulomb (dry) and viscous friction of a joint whose trusted prior states none."""
