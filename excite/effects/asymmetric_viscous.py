"""Asymmetric viscous friction: viscous friction that differs by direction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, is_between, single_joint_columns
from .friction import max_speed
from .recorded_motion import FittedRobot, RecordedMotion

MAX_EXCESS = 1.5
"""Largest half difference of both directions, over the friction of the base fit at full speed: the
friction that refits with it may be larger by half."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """|q̇|: half of the difference between both directions."""
    return single_joint_columns(
        motion, model.joint_index, np.abs(motion.samples.dq[:, model.joint_index])
    )


def _parameters(joint: int, c: FloatArray, base: FittedRobot) -> dict[str, float]:
    """Viscous friction in both directions, whose mean is that of the base model."""
    viscous = float(base.actuator_parameter("viscous")[joint])
    return {"positive": viscous + float(c[0]), "negative": viscous - float(c[0])}


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """One candidate a joint; it must dissipate energy in both directions, with all friction."""
    for j in range(motions[0].n):
        viscous, coulomb = (
            max(float(motions[0].fitted_robot.actuator_parameter(kind)[j]), 1e-9)
            for kind in ("viscous", "coulomb")
        )
        limit = MAX_EXCESS * (viscous + coulomb / max(max_speed(motions, j), 1e-9))
        yield CandidateModel(
            "asymmetric_viscous",
            j,
            _columns,
            parameters_on_base=partial(_parameters, j),
            is_plausible=is_between(-limit, limit),
        )


ASYMMETRIC_VISCOUS = Effect(
    "asymmetric_viscous",
    "F_v+ for q̇ > 0, F_v− for q̇ < 0",
    _columns,
    _candidates,
    {"positive": "N m s/rad", "negative": "N m s/rad"},
    "torque against speed has another slope in each direction",
    "constant speeds in both directions, several of them",
    form_std={"positive": 0.09, "negative": 0.09},
)
"""Direction-dependent viscous friction."""
