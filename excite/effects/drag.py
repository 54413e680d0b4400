"""Drag: resistance that grows with the square of the speed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, is_positive, named_coefficients, single_joint_columns
from .friction import joint_speed
from .recorded_motion import RecordedMotion


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """q̇ |q̇|."""
    speed = joint_speed(motion, model.joint_index)
    return single_joint_columns(motion, model.joint_index, speed * np.abs(speed))


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """One candidate a joint."""
    for j in range(motions[0].n):
        yield CandidateModel(
            "drag",
            j,
            _columns,
            parameters=named_coefficients("coefficient"),
            is_plausible=is_positive,
        )


DRAG = Effect(
    "drag",
    "c q̇ |q̇|",
    _columns,
    _candidates,
    {"coefficient": "N m s²/rad²"},
    "resistance grows with the square of speed",
    "very fast motion",
)
"""Air or fluid drag, churning losses of a gear's oil."""
