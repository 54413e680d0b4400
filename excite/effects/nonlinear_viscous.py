"""Nonlinear viscous friction: a power of the speed other than 1."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, no_candidates, single_joint_rows
from .friction import max_speed
from .recorded_motion import RecordedMotion

ASINH_SPEEDS = (0.02, 0.1, 0.4)
"""Speeds of the asinh curves, over the largest speed."""
TANH_SPEEDS = (0.1, 0.4)
"""Speeds of the tanh curves, over the largest speed."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Concave and convex friction curves."""
    # beyond the speeds of the fit the friction goes on linearly
    j, top_speed = model.joint_index, model.values["top_speed"]
    columns = motion.for_all_fits(
        f"viscous curves of joint {j} up to {top_speed}",
        lambda: motion.lowpass(_curves(np.clip(motion.samples.dq[:, j] / top_speed, -1.0, 1.0))),
    )
    return single_joint_rows(motion, j, columns)


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
        """Power whose deviation from a line fits the curve best; friction opposes motion."""
        share = np.linspace(0.02, 1.0, 60)
        curve = _curves(share) @ c
        exponents = np.concatenate([np.linspace(0.2, 0.9, 29), np.linspace(1.2, 3.5, 47)])
        shapes = share[:, None] ** exponents - share[:, None]
        sizes = np.maximum(shapes.T @ curve / np.sum(shapes**2, axis=0), 0.0)
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


NONLINEAR_VISCOUS = Effect(
    "nonlinear_viscous",
    "F |q̇|^k sgn q̇",
    _columns,
    no_candidates,
    {"coefficient": "N m (s/rad)^k", "exponent": "1"},
    "friction is not linear in speed",
    "a wide range of constant speeds",
    form_std={"coefficient": 0.25, "exponent": 0.25},
)
"""Shear-thinning or shear-thickening lubricant friction."""
