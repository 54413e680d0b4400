"""Nonlinear viscous friction: a power of the speed other than 1."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Values, single_joint_rows
from .friction_runtime import CONCAVE_CURVES, JointMotion, columns
from .joint_torque import JointTorque
from .recorded_motion import FittedRobot, Motions, RecordedMotion, for_all_fits, max_speed

LINE_SHARE = "line_share"
"""Value of a model that is continued beyond the speeds of its fit: share of the line."""


@for_all_fits
def _curves(motion: RecordedMotion, joint: int, *values: tuple[str, float]) -> FloatArray:
    """Low-passed curves of a joint with the values of a model, shape (N, k)."""
    x = JointMotion(dq=motion.samples.dq[:, joint])
    parts = columns("nonlinear_viscous", dict(values), x)
    return motion.lowpass(np.array([part.smooth for part in parts]).T)


class _NonlinearViscous(JointTorque):
    """Concave friction curves (asinh, tanh, root) and convex ones (square, cube)."""

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        j = model.joint_index
        return single_joint_rows(motion, j, _curves(motion, j, *model.values.items()))

    def dense_model(self, motions: Motions, joint: int) -> CandidateModel:
        """Return a nonnegative combination of concave and convex friction curves."""
        return CandidateModel(self, joint, {"top_speed": max_speed(motions, joint)})

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        """Return the power whose deviation from a line fits best; friction opposes motion."""
        share = np.linspace(0.02, 1.0, 60)
        parts = columns(self.name, {"top_speed": 1.0}, JointMotion(dq=share))
        curve = np.column_stack([part.smooth for part in parts]) @ c
        exponents = np.concatenate([np.linspace(0.2, 0.9, 29), np.linspace(1.2, 3.5, 47)])
        shapes = share[:, None] ** exponents - share[:, None]
        sizes = np.maximum(shapes.T @ curve / np.sum(shapes**2, axis=0), 0.0)
        best = int(np.argmin(np.sum((curve[:, None] - shapes * sizes) ** 2, axis=0)))
        exponent = float(exponents[best])
        coefficient = float(sizes[best]) / model.values["top_speed"] ** exponent
        return {"coefficient": coefficient, "exponent": exponent}


NONLINEAR_VISCOUS = _NonlinearViscous(
    "nonlinear_viscous",
    "F |q̇|^k sgn q̇",
    {"coefficient": "N m (s/rad)^k", "exponent": "1"},
    "friction is not linear in speed",
    "a wide range of constant speeds",
    regime="speed",
    nonnegative=(True,) * (CONCAVE_CURVES + 2),
    has_candidates=False,
    form_std={"coefficient": 0.25, "exponent": 0.25},
)
"""Shear-thinning or shear-thickening lubricant friction."""


def without_falling(model: CandidateModel, c: FloatArray, viscous: float) -> CandidateModel:
    """Return a `dense_model` whose friction does not fall beyond the speeds of its fit.

    Each curve is less a line, which viscous friction [N m s/rad or N s/m] makes up for. Where this
    is smaller than all lines of concave curves, friction falls towards the largest speed; further
    on, it would feed in power at some speed.
    """
    lines = float(c[:CONCAVE_CURVES].sum())
    made_up = viscous * model.values["top_speed"]
    return (
        model if made_up >= lines else model.with_values(**{LINE_SHARE: max(made_up, 0.0) / lines})
    )
