"""Coulomb and viscous friction, and quantities that all friction effects share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, named_coefficients, single_joint_columns
from .recorded_motion import RecordedMotion


def joint_speed(motion: RecordedMotion, joint: int) -> FloatArray:
    """Return the speed of a joint at every sample [rad/s], shape (M,)."""
    return np.asarray(motion.samples.dq[:, joint])


def max_speed(motions: Sequence[RecordedMotion], joint: int) -> float:
    """Return the largest speed of a joint [rad/s]."""
    return max(float(np.abs(motion.samples.dq[:, joint]).max()) for motion in motions)


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Coulomb and viscous friction."""
    j = model.joint_index
    return single_joint_columns(
        motion, j, np.column_stack([motion.sign(j), joint_speed(motion, j)])
    )


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """One candidate a joint."""
    for j in range(motions[0].n):
        yield CandidateModel(
            "friction",
            j,
            _columns,
            parameters=named_coefficients("coulomb", "viscous"),
            nonnegative=(True, True),
            is_plausible=lambda c: bool((c >= 0.0).all()),
        )


FRICTION = Effect(
    "friction",
    "F_c sgn q̇ + F_v q̇, where the model has none",
    _columns,
    _candidates,
    {"coulomb": "N m", "viscous": "N m s/rad"},
    "torque against the motion",
    "any motion in both directions",
    prior_only=True,
    form_std={"coulomb": 0.04, "viscous": 0.04},
)
"""Coulomb (dry) and viscous friction of a joint whose trusted prior states none."""
