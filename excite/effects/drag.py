"""Drag: resistance that grows with the square of the speed."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from .effect import (
    CandidateModel,
    Effect,
    is_positive,
    named_coefficients,
    one_per_joint,
    single_joint_columns,
)
from .recorded_motion import RecordedMotion


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """q̇ |q̇|."""
    speed = motion.samples.dq[:, model.joint_index]
    return single_joint_columns(motion, model.joint_index, speed * np.abs(speed))


DRAG = Effect(
    "drag",
    "c q̇ |q̇|",
    _columns,
    one_per_joint(
        "drag", _columns, parameters=named_coefficients("coefficient"), is_plausible=is_positive
    ),
    {"coefficient": "N m s²/rad²"},
    "resistance grows with the square of speed",
    "very fast motion",
)
"""Air or fluid drag, churning losses of a gear's oil."""
