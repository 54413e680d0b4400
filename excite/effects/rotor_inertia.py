"""Rotor inertia: the reflected inertia (armature) of a joint actuator."""

from __future__ import annotations

from .._types import FloatArray
from .effect import CandidateModel, Effect, single_joint_columns
from .recorded_motion import RecordedMotion


class _RotorInertia(Effect):
    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        j = model.joint_index
        return single_joint_columns(motion, j, motion.samples.ddq[:, j])


ROTOR_INERTIA = _RotorInertia(
    "rotor_inertia",
    "I_a q̈",
    {"inertia": "kg m²"},
    "like the joint's own acceleration, at any pose",
    "small fast motion at several poses",
    prior_only=True,
    form_std={"inertia": 0.04},
)
"""Armature; rotor inertia times the square of the gear ratio."""
