"""Torque gain: the torque constant or the gain of the joint actuator is wrong."""

from __future__ import annotations

from collections.abc import Iterator

from .._types import FloatArray
from .effect import CandidateModel, Effect, Values, single_joint_columns
from .recorded_motion import FittedRobot, Motions, RecordedMotion

CHANGES = (-0.7, 2.0)
"""Plausible relative changes of a gain: a wrong torque constant, gear ratio or unit is a factor."""
MEASURED_CHANGES = (CHANGES[0] / (1.0 + CHANGES[0]), CHANGES[1] / (1.0 + CHANGES[1]))
"""The same over the recorded torque."""


class _TorqueGain(Effect):
    """The measured torque."""

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        j = model.joint_index
        return single_joint_columns(motion, j, motion.measured_torque[:, j])

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        yield CandidateModel(self, joint, {"measured": 1.0})

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        # the recorded torque is the true one over the gain
        return {"gain": 1.0 - float(c[0])}

    def recorded_change(
        self, motion: RecordedMotion, model: CandidateModel, c: FloatArray, produced: FloatArray
    ) -> FloatArray:
        """Return recorded minus produced torque; the coefficient is its share in the former."""
        return produced * float(c[0] / (1.0 - c[0]))


TORQUE_GAIN = _TorqueGain(
    "torque_gain",
    "τ = (1 + ε) k_t i",
    {"gain": "1"},
    "every term of one joint scaled",
    "two known loads",
    prior_only=True,
    form_std={"gain": 0.035},
    bounds=MEASURED_CHANGES,
)
"""Wrong torque constant, true over stated."""
