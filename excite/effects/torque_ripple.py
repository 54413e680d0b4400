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
    pair_amplitude,
    single_joint_columns,
)
from .recorded_motion import RecordedMotion


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """A wave of one order, and one that grows with the load."""
    j = model.joint_index
    waves = harmonic_columns(model.values, motion.samples.q[:, j])
    load = motion.transmitted_torque[:, j] / model.values["load"]
    return single_joint_columns(motion, j, np.hstack([waves, load[:, None] * waves]))


def wave_model(motions: Sequence[RecordedMotion], joint: int, order: float) -> CandidateModel:
    """Return the wave of one order [1/rad] at a joint, whose amplitude may grow with the load.

    At a load as large as the largest torque of the joint, the growth has the prior of the wave
    itself: a joint that carried next to nothing says nothing about loads.
    """
    torque = max(float(np.abs(motion.torque[:, joint]).max()) for motion in motions)
    load = np.concatenate([motion.transmitted_torque[:, joint] for motion in motions])
    scale = max(torque, float(np.abs(load).max()), 1e-9)
    share = float(np.sqrt(np.mean(load**2))) / scale
    values = {"order": order, "load": scale}
    return CandidateModel(
        "torque_ripple",
        joint,
        _columns,
        values,
        parameters=pair_amplitude(order=order),
        prior_shares=(1.0, 1.0, share, share),
    )


TORQUE_RIPPLE = Effect(
    "torque_ripple",
    "A cos kq + B sin kq",
    _columns,
    no_candidates,
    {"order": "1/turn", "amplitude": "N m"},
    "periodic in the angle, whatever the speed",
    "slow constant speed over a turn",
    form_std={"order": 0.02, "amplitude": 0.1},
)
"""Torque ripple; users call it cogging, gear meshing or motor pole ripple."""
