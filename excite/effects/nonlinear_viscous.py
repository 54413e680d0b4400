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

ASINH_SPEEDS = (0.02, 0.1, 0.4)
"""Speeds of the asinh curves, over the largest speed."""
TANH_SPEEDS = (0.1, 0.4)
"""Speeds of the tanh curves, over the largest speed."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """|q̇|^k sgn q̇, or the curves of `dense_model`."""
    j = model.joint_index
    if "top_speed" in model.values:
        # beyond the speeds of the fit the friction goes on linearly
        share = np.clip(joint_speed(motion, j) / model.values["top_speed"], -1.0, 1.0)
        return single_joint_columns(motion, j, _curves(share))
    return single_joint_columns(
        motion, j, motion.sign(j) * np.abs(joint_speed(motion, j)) ** model.values["exponent"]
    )


def _curves(share: FloatArray) -> FloatArray:
    """Friction curves that are not linear in speed, less the linear one of equal friction at top.

    Concave ones (asinh: Eyring viscosity; tanh, root) and convex ones (square, cube).

    Args:
        share: Speed over the largest speed, shape (M,).

    Returns:
        Shape (M, k).
    """
    size = np.abs(share)
    concave = [np.arcsinh(share / v) / np.arcsinh(1.0 / v) for v in ASINH_SPEEDS]
    concave += [np.tanh(share / v) / np.tanh(1.0 / v) for v in TANH_SPEEDS]
    concave += [np.sign(share) * np.sqrt(size)]
    convex = [share * size, share**3]
    return np.column_stack([curve - share for curve in (*concave, *convex)])


def dense_model(motions: Sequence[RecordedMotion], joint: int) -> CandidateModel:
    """Return a nonnegative combination of concave and convex friction curves of a joint."""
    top_speed = max_speed(motions, joint)
    count = len(ASINH_SPEEDS) + len(TANH_SPEEDS) + 3

    def parameters(c: FloatArray) -> dict[str, float]:
        """Power whose deviation from a line fits the curve best."""
        share = np.linspace(0.02, 1.0, 60)
        curve = _curves(share) @ c
        exponents = np.concatenate([np.linspace(0.2, 0.9, 29), np.linspace(1.2, 3.5, 47)])
        shapes = share[:, None] ** exponents - share[:, None]
        sizes = shapes.T @ curve / np.sum(shapes**2, axis=0)
        best = int(np.argmin(np.sum((curve[:, None] - shapes * sizes) ** 2, axis=0)))
        exponent = float(exponents[best])
        return {"coefficient": float(sizes[best]) / top_speed**exponent, "exponent": exponent}

    return CandidateModel(
        "nonlinear_viscous",
        joint,
        _columns,
        {"top_speed": top_speed},
        parameters=parameters,
        nonnegative=(True,) * count,
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
