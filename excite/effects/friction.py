"""Coulomb and viscous friction, and quantities that all friction effects share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, named_coefficients, one_per_joint, single_joint_columns
from .recorded_motion import RecordedMotion


def max_speed(motions: Sequence[RecordedMotion], joint: int) -> float:
    """Return the largest speed of a joint [rad/s]."""
    return max(float(np.abs(motion.samples.dq[:, joint]).max()) for motion in motions)


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Coulomb and viscous friction."""
    j = model.joint_index
    return single_joint_columns(
        motion, j, np.column_stack([motion.sign(j), motion.samples.dq[:, j]])
    )


FRICTION = Effect(
    "friction",
    "F_c sgn q̇ + F_v q̇, where the model has none",
    _columns,
    one_per_joint(
        "friction",
        _columns,
        parameters=named_coefficients("coulomb", "viscous"),
        nonnegative=(True, True),
        is_plausible=lambda c: bool((c >= 0.0).all()),
    ),
    {"coulomb": "N m", "viscous": "N m s/rad"},
    "torque against the motion",
    "any motion in both directions",
    prior_only=True,
    form_std={"coulomb": 0.04, "viscous": 0.04},
)
"""Coulomb (dry) and viscous friction of a joint whose trusted prior states none."""
