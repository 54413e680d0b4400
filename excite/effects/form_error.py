"""Model discrepancy: an effect of a real robot has not exactly the form of its model.

The torque of the effect may differ from that of its model by a smooth factor of position and speed
(Kennedy & O'Hagan 2001, with a multiplicative Gaussian process in a finite basis), and in time, as
by dynamics that the model lacks:

    τ_e = T (1 + Σ_m a_m φ_m) + b₁ Ṫ/ω + b₂ T̈/ω²,   T = Σ_k c_k C_k,   a, b ~ N(0, η²)

ω and ω² are the RMS values of Ṫ and T̈ over that of T, in each motion. Without the discrepancy the
difference, which grows with the effect, would be taken for further effects.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .._types import FloatArray
from ..schemas.effects import FORM_POSITION_WAVES, FORM_SPEED_WAVES
from .effect import CandidateModel
from .recorded_motion import Motions, RecordedMotion, max_speed, position_range

DERIVATIVES = 2
"""Time derivatives of the torque, as of a second-order lag [1]."""


def with_form_error(
    model: CandidateModel, motions: Motions, coefficients: FloatArray
) -> CandidateModel:
    """Return a model with its discrepancy as further columns, in units of its coefficients (k,).

    Rigid bodies have none: they have exactly the form of their model.
    """
    if model.definition.prior_only:
        return model
    n, joint = motions[0].n, model.joint
    count = n + DERIVATIVES
    if joint is not None:
        low, high = position_range(motions, joint)
        top = max_speed(motions, joint)
        count = FORM_POSITION_WAVES + FORM_SPEED_WAVES + DERIVATIVES

    def columns(motion: RecordedMotion) -> FloatArray:
        torque = model.columns(motion)
        total = torque @ coefficients
        if joint is None:  # the joints' shares of it may differ
            varied = total[:, :, None] * np.eye(n)
        else:
            s = motion.samples
            q, speed = motion.at_rows(np.column_stack([s.q[:, joint], s.dq[:, joint]])).T
            place, rate = (q - low) / max(high - low, 1e-9), np.abs(speed) / max(top, 1e-9)
            factors = [np.cos(np.pi * m * place) for m in range(1, FORM_POSITION_WAVES + 1)]
            factors += [np.cos(np.pi * m * rate) for m in range(1, FORM_SPEED_WAVES + 1)]
            varied = total[:, :, None] * np.column_stack(factors)[:, None, :]
        derivatives, size = [total], np.sqrt(np.mean(total**2))
        while len(derivatives) <= DERIVATIVES:
            slope = np.gradient(derivatives[-1], motion.time, axis=0)
            rms = np.sqrt(np.mean(slope**2))
            derivatives.append(slope * size / max(rms, 1e-300))
        return np.concatenate([torque, varied, np.stack(derivatives[1:], axis=2)], axis=2)

    return replace(model, own_columns=columns, form_columns=count, exact=model)
