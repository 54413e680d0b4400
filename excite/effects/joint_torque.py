"""Torque of one joint that follows from its present motion and load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, single_joint_columns
from .friction_runtime import JointMotion, columns, unit
from .hysteresis import direction
from .recorded_motion import RecordedMotion


@dataclass(frozen=True, eq=False)
class JointTorque(Effect):
    """An effect whose columns are those of `friction_runtime.columns`.

    Its dry part has the direction of `hysteresis.direction`.
    """

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        """Return the low-passed columns at the motion's rows, shape (N, n, k)."""
        return single_joint_columns(motion, model.joint_index, self._at_samples(motion, model))

    def _at_samples(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        """Columns of the joint at every sample, shape (M, k)."""
        s, j = motion.samples, model.joint_index
        other = j if model.other is None else model.other
        x = JointMotion(
            s.q[:, j],
            s.dq[:, j],
            s.ddq[:, j],
            motion.transmitted_torque[:, j],
            s.dq[:, other],
            s.ddq[:, other],
            float(motion.widths[j]),
        )
        parts = columns(self.name, model.values, x)
        sign = direction(motion, model)
        stated = [np.broadcast_to(part.smooth + part.dry * sign, len(s)) for part in parts]
        return unit(model.values) * np.array(stated).T
