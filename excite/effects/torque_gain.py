"""Torque gain: the torque constant or the gain of the joint actuator is wrong."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, is_between, one_per_joint, single_joint_columns
from .recorded_motion import RecordedMotion

CHANGES = (-0.7, 2.0)
"""Plausible relative changes of a gain: a wrong torque constant, gear ratio or unit is a factor."""
MEASURED_CHANGES = (CHANGES[0] / (1.0 + CHANGES[0]), CHANGES[1] / (1.0 + CHANGES[1]))
"""The same over the recorded torque."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Measured torque, or that of the base model."""
    torque = motion.measured_torque if model.values.get("measured") else motion.motor_torque
    return single_joint_columns(motion, model.joint_index, torque[:, model.joint_index])


def _predicted_torque(
    motion: RecordedMotion, model: CandidateModel, c: FloatArray, produced: FloatArray
) -> FloatArray:
    """Recorded minus produced torque, of which the coefficient is the share in the recorded one."""
    out = np.zeros_like(produced)
    out[:, model.joint_index] = produced[:, model.joint_index] * float(c[0] / (1.0 - c[0]))
    return out


TORQUE_GAIN = Effect(
    "torque_gain",
    "τ = (1 + ε) k_t i",
    _columns,
    one_per_joint(
        "torque_gain",
        _columns,
        values={"measured": 1.0},
        # the recorded torque is the true one over the gain
        parameters=lambda c: {"gain": 1.0 - float(c[0])},
        is_plausible=is_between(*MEASURED_CHANGES),
    ),
    {"gain": "1"},
    "every term of one joint scaled",
    "two known loads",
    prior_only=True,
    form_std={"gain": 0.035},
    predicted_torque=_predicted_torque,
)
"""Wrong torque constant, true over stated."""
