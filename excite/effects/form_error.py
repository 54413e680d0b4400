"""Model discrepancy: an effect of a real robot has not exactly the form of its model.

The torque of the effect may differ from that of its model by a smooth factor of position and speed
(Kennedy & O'Hagan 2001, with a multiplicative Gaussian process in a finite basis):

    τ_e = Σ_k c_k C_k (1 + Σ_m a_km φ_m),   a_km ~ N(0, η²)

Without it the difference, which grows with the effect, would be taken for further effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel
from .recorded_motion import RecordedMotion, position_range

POSITION_WAVES = 4
"""Half waves over the range of the joint."""
SPEED_WAVES = 2
"""Half waves over the range of speeds."""
RELATIVE_STD = 0.15
"""Standard deviation η of each factor."""


def with_form_error(
    model: CandidateModel, motions: Sequence[RecordedMotion], coefficients: FloatArray
) -> CandidateModel:
    """Return a model that has its discrepancy as further columns.

    Args:
        model: A model of one joint.
        motions: Motions that it is fitted to.
        coefficients: Coefficients of the model, shape (k,), in whose units the further columns are.
    """
    low, high = position_range(motions, model.joint_index)
    top = max(float(np.abs(m.samples.dq[:, model.joint_index]).max()) for m in motions)
    k = len(coefficients)
    count = POSITION_WAVES + SPEED_WAVES

    def columns(motion: RecordedMotion, _: CandidateModel) -> FloatArray:
        torque = model.torque_columns(motion, model)
        q = np.interp(motion.time, motion.times, motion.samples.q[:, model.joint_index])
        speed = np.interp(motion.time, motion.times, motion.samples.dq[:, model.joint_index])
        place, rate = (q - low) / max(high - low, 1e-9), np.abs(speed) / max(top, 1e-9)
        factors = [np.cos(np.pi * m * place) for m in range(1, POSITION_WAVES + 1)]
        factors += [np.cos(np.pi * m * rate) for m in range(1, SPEED_WAVES + 1)]
        total = torque @ coefficients
        return np.concatenate(
            [torque, total[:, :, None] * np.column_stack(factors)[:, None, :]], axis=2
        )

    return replace(
        model,
        torque_columns=columns,
        parameters=lambda c: model.parameters(c[:k]),
        nonnegative=(*(model.nonnegative or (False,) * k), *(False,) * count),
        form_columns=count,
    )
