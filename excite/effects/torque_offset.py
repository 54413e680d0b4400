"""Torque offset: a constant torque, as of a biased sensor or of Coulomb friction by direction."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, named_coefficients, one_per_joint, single_joint_columns
from .recorded_motion import RecordedMotion


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """A constant."""
    return single_joint_columns(motion, model.joint_index, np.ones(len(motion.segment)))


TORQUE_OFFSET = Effect(
    "torque_offset",
    "τ₀",
    _columns,
    one_per_joint("torque_offset", _columns, parameters=named_coefficients("offset")),
    {"offset": "N m"},
    "constant, whatever the motion",
    "hold a pose, reached from both sides",
    prior_only=True,
    form_std={"offset": 0.04},
)
"""Torque sensor bias."""
