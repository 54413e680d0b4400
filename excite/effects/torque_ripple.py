"""Torque ripple: torque that is periodic in the joint or motor angle, as cogging or gear mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._types import FloatArray
from .effect import (
    CandidateModel,
    Effect,
    harmonic_columns,
    no_candidates,
    single_joint_columns,
)
from .recorded_motion import RecordedMotion


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """A wave of one order; with a "load", also a wave that grows with the load."""
    j = model.joint_index
    waves = harmonic_columns(model.values, motion.samples.q[:, j])
    if "load" in model.values:
        load = motion.transmitted_torque[:, j] / model.values["load"]
        waves = np.hstack([waves, load[:, None] * waves])
    return single_joint_columns(motion, j, waves)


def wave_model(motions: Sequence[RecordedMotion], joint: int, order: float) -> CandidateModel:
    """Return the wave of one order [1/rad] at a joint, whose amplitude may grow with the load."""
    load = max(float(np.abs(motion.transmitted_torque[:, joint]).max()) for motion in motions)
    values = {"order": order, "load": max(load, 1e-9)}
    return CandidateModel(
        "torque_ripple",
        joint,
        _columns,
        values,
        parameters=lambda c: {"amplitude": float(np.hypot(c[0], c[1])), "order": order},
    )


TORQUE_RIPPLE = Effect(
    "torque_ripple",
    "A cos kq + B sin kq",
    _columns,
    no_candidates,
    {"order": "1/turn", "amplitude": "N m"},
    "periodic in the angle, whatever the speed",
    ("encoder_error",),
    "slow constant speed over a turn",
    form_std={"order": 0.02, "amplitude": 0.1},
)
"""Torque ripple; users call it cogging, gear meshing or motor pole ripple."""
