"""Rotor inertia: the reflected inertia (armature) of a joint actuator."""

from __future__ import annotations

from .._types import FloatArray
from .effect import CandidateModel, Effect, named_coefficients, one_per_joint, single_joint_columns
from .recorded_motion import RecordedMotion


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Acceleration of the joint."""
    return single_joint_columns(motion, model.joint_index, motion.samples.ddq[:, model.joint_index])


ROTOR_INERTIA = Effect(
    "rotor_inertia",
    "I_a q̈",
    _columns,
    one_per_joint("rotor_inertia", _columns, parameters=named_coefficients("inertia")),
    {"inertia": "kg m²"},
    "like the joint's own acceleration, at any pose",
    "small fast motion at several poses",
    prior_only=True,
    form_std={"inertia": 0.04},
)
"""Armature; rotor inertia times the square of the gear ratio."""
