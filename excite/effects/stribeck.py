"""Stribeck friction: friction that falls with speed near zero speed (velocity-weakening)."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Values
from .friction_runtime import STRIBECK_SPEEDS, JointMotion, columns
from .joint_torque import JointTorque
from .recorded_motion import FittedRobot, Motions, max_speed


class _Stribeck(JointTorque):
    """Exponential and Gaussian curves."""

    def dense_model(self, motions: Motions, joint: int) -> CandidateModel:
        """Return a nonnegative combination of exponential and Gaussian Stribeck curves."""
        return CandidateModel(self, joint, {"top_speed": max_speed(motions, joint)})

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        """Return the excess at rest, and the speed at which it has fallen to 1/e."""
        top_speed = model.values["top_speed"]
        speeds = np.geomspace(1e-3, 1.0, 400) * top_speed
        curves = [part.dry for part in columns(self.name, model.values, JointMotion(dq=speeds))]
        below = np.column_stack(curves) @ c < float(c.sum()) / np.e
        velocity = speeds[int(np.argmax(below))] if below.any() else top_speed
        return {"amplitude": float(c.sum()), "velocity": float(velocity)}


STRIBECK = _Stribeck(
    "stribeck",
    "(F_s − F_c) exp(−(|q̇|/v_s)^δ) sgn q̇ (Stribeck 1902; Armstrong-Hélouvry 1994)",
    {"amplitude": "N m", "velocity": "rad/s"},
    "friction is larger near zero speed",
    "a ladder of slow constant speeds, 1 mrad/s to 0.5 rad/s",
    regime="speed",
    nonnegative=(True,) * 2 * len(STRIBECK_SPEEDS),
    has_candidates=False,
    form_std={"amplitude": 0.25, "velocity": 0.25},
)
"""Stribeck friction; users call it stiction, breakaway friction or stick-slip."""
