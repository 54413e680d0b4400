"""Nonlinear viscous friction: a power of the speed other than 1."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from .._types import FloatArray
from .effect import (
    CandidateModel,
    Effect,
    grid_candidates,
    is_positive,
    named_coefficients,
    single_joint_columns,
)
from .friction import if_resolved, joint_speed, max_speed, min_resolved_speed
from .recorded_motion import RecordedMotion


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """|q̇|^k sgn q̇."""
    j = model.joint_index
    return single_joint_columns(
        motion, j, motion.sign(j) * np.abs(joint_speed(motion, j)) ** model.values["exponent"]
    )


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Exponents below and above 1."""

    def family(j: int) -> Callable[[float], CandidateModel]:
        min_speed = min_resolved_speed(motions, j) / max(max_speed(motions, j), 1e-9)

        def model(exponent: float) -> CandidateModel:
            # share of the largest speed at which friction has risen to half
            half_speed = 0.5 ** (1.0 / exponent)
            return CandidateModel(
                "nonlinear_viscous",
                j,
                _columns,
                {"exponent": exponent},
                parameters=named_coefficients("coefficient", exponent=exponent),
                is_plausible=if_resolved(half_speed, min_speed, is_positive),
            )

        return model

    for j in range(motions[0].n):
        model = family(j)
        yield from grid_candidates((0.2, 0.35, 0.5, 0.7), model)
        yield from grid_candidates((1.4, 1.7, 2.0, 2.5, 3.2), model)


NONLINEAR_VISCOUS = Effect(
    "nonlinear_viscous",
    "F |q̇|^k sgn q̇",
    _columns,
    _candidates,
    {"coefficient": "N m (s/rad)^k", "exponent": "1"},
    "friction is not linear in speed",
    ("drag", "stribeck", "thermal_drift"),
    "a wide range of constant speeds",
    form_std={"coefficient": 0.25, "exponent": 0.25},
    residual_log_offset=-0.6,
)
"""Shear-thinning or shear-thickening lubricant friction."""
