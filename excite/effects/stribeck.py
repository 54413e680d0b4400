"""Stribeck friction: friction that falls with speed near zero speed (velocity-weakening)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, no_candidates, single_joint_columns
from .friction import max_speed
from .hysteresis import direction
from .recorded_motion import RecordedMotion

DENSE_VELOCITIES = np.geomspace(0.03, 0.3, 4)
"""Velocities of the curves of `dense_model`, over the joint's largest speed."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Exponential and Gaussian curves."""
    j = model.joint_index
    velocities = DENSE_VELOCITIES * model.values["top_speed"]
    share = np.abs(motion.samples.dq[:, j]) / velocities[:, None]
    curves = np.vstack([np.exp(-share), np.exp(-(share**2))])
    return single_joint_columns(motion, j, (direction(motion, model) * curves).T)


def dense_model(
    motions: Sequence[RecordedMotion], joint: int, build_up: Mapping[str, float] | None = None
) -> CandidateModel:
    """Return a nonnegative combination of exponential and Gaussian Stribeck curves of a joint.

    Args:
        motions: The recorded motions.
        joint: Index of the joint.
        build_up: How it builds up, as of `hysteresis.build_up`; at once if None.
    """
    top_speed = max_speed(motions, joint)
    velocities = np.tile(DENSE_VELOCITIES * top_speed, 2)
    exponents = np.repeat((1.0, 2.0), len(DENSE_VELOCITIES))

    def parameters(c: FloatArray) -> dict[str, float]:
        """Excess at rest, and the speed at which it has fallen to 1/e."""
        speeds = np.geomspace(1e-3, 1.0, 400) * top_speed
        curve = np.exp(-((speeds[:, None] / velocities) ** exponents)) @ c
        below = curve < float(c.sum()) / np.e
        velocity = speeds[int(np.argmax(below))] if below.any() else top_speed
        return {"amplitude": float(c.sum()), "velocity": float(velocity)}

    return CandidateModel(
        "stribeck",
        joint,
        _columns,
        {"top_speed": top_speed, **(build_up or {})},
        parameters=parameters,
        nonnegative=(True,) * len(velocities),
    )


STRIBECK = Effect(
    "stribeck",
    "(F_s − F_c) exp(−(|q̇|/v_s)^δ) sgn q̇ (Stribeck 1902; Armstrong-Hélouvry 1994)",
    _columns,
    no_candidates,
    {"amplitude": "N m", "velocity": "rad/s"},
    "friction is larger near zero speed",
    "a ladder of slow constant speeds, 1 mrad/s to 0.5 rad/s",
    form_std={"amplitude": 0.25, "velocity": 0.25},
)
"""Stribeck friction; users call it stiction, breakaway friction or stick-slip."""
