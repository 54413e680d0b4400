"""Torque offset: a constant torque, as of a biased sensor or of Coulomb friction by direction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, named_coefficients, single_joint_columns
from .recorded_motion import RecordedMotion


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """A constant."""
    return single_joint_columns(motion, model.joint_index, np.ones(len(motion.segment)))


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """One candidate a joint."""
    for j in range(motions[0].n):
        yield CandidateModel("torque_offset", j, _columns, parameters=named_coefficients("offset"))


TORQUE_OFFSET = Effect(
    "torque_offset",
    "τ₀",
    _columns,
    _candidates,
    {"offset": "N m"},
    "constant, whatever the motion",
    "hold a pose, reached from both sides",
    prior_only=True,
    form_std={"offset": 0.04},
)
"""Torque sensor bias."""
