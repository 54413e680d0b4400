"""Torque gain: the torque constant or the gain of the joint actuator is wrong."""

from __future__ import annotations

from .._types import FloatArray
from .effect import CandidateModel, Effect, is_between, one_per_joint, single_joint_columns
from .recorded_motion import RecordedMotion

CHANGES = (-0.7, 2.0)
"""Plausible relative changes of a gain: a wrong torque constant, gear ratio or unit is a factor."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Torque of the base model."""
    return single_joint_columns(
        motion, model.joint_index, motion.motor_torque[:, model.joint_index]
    )


TORQUE_GAIN = Effect(
    "torque_gain",
    "τ = (1 + ε) k_t i",
    _columns,
    one_per_joint(
        "torque_gain",
        _columns,
        # the recorded torque is the true one over the gain
        parameters=lambda c: {"gain": 1.0 / (1.0 + float(c[0]))},
        is_plausible=is_between(*CHANGES),
    ),
    {"gain": "1"},
    "every term of one joint scaled",
    "two known loads",
    prior_only=True,
    form_std={"gain": 0.035},
)
"""Wrong torque constant, true over stated."""
