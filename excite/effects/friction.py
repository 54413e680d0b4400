"""Coulomb and viscous friction, and quantities that all friction effects share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, named_coefficients, single_joint_columns
from .recorded_motion import RecordedMotion

MAX_STATIC_RATIO = 5.0
"""Largest static or presliding friction over Coulomb friction."""
MIN_COULOMB_SHARE = 0.05
"""Smallest Coulomb friction that is assumed, over the joint's largest torque: the base fit absorbs
part of a friction effect, and next to other effects perhaps all of it."""
RESOLVED_SPEED_RATIO = 3.0
"""Smallest speed at which friction is judged, over the speed at which a reversing joint crosses one
encoder step. Friction changing below it was found falsely seven times in 91 simulated robots
without any effect."""


def joint_speed(motion: RecordedMotion, joint: int) -> FloatArray:
    """Return the speed of a joint at every sample [rad/s], shape (M,)."""
    return np.asarray(motion.samples.dq[:, joint])


def max_speed(motions: Sequence[RecordedMotion], joint: int) -> float:
    """Return the largest speed of a joint [rad/s]."""
    return max(float(np.abs(motion.samples.dq[:, joint]).max()) for motion in motions)


def min_resolved_speed(motions: Sequence[RecordedMotion], joint: int) -> float:
    """Return the smallest speed that the encoder resolves [rad/s]; 0 for a fine encoder."""
    return RESOLVED_SPEED_RATIO * min(
        (
            float(motion.steps[joint] / motion.reversal_dwell[joint])
            for motion in motions
            if 0.0 < motion.reversal_dwell[joint] < np.inf
        ),
        default=0.0,
    )


def if_resolved(
    speed: float, min_speed: float, check: Callable[[FloatArray], bool]
) -> Callable[[FloatArray], bool]:
    """Return `check` if a model changes at a speed that is resolved; otherwise reject it."""
    return check if speed > min_speed else lambda c: False


def max_static_friction(motions: Sequence[RecordedMotion], joint: int) -> float:
    """Return the largest plausible static friction of a joint [N m]."""
    largest = max(float(np.abs(motion.torque[:, joint]).max()) for motion in motions)
    return MAX_STATIC_RATIO * max(
        float(motions[0].fitted_robot.actuator_parameter("coulomb")[joint]),
        MIN_COULOMB_SHARE * largest,
        1e-9,
    )


def velocity_weakening(speed: FloatArray, values: Mapping[str, float]) -> FloatArray:
    """Return the Stribeck curve: 1 at rest, 1/e at |q̇| = v.

    exp(−(|q̇|/v)^δ), or the rational form 1/(1 + (e − 1)(|q̇|/v)^δ) where "rational" is stated.

    Args:
        speed: q̇ [rad/s], shape (M,).
        values: "velocity" v [rad/s] and "exponent" δ.
    """
    x = (np.abs(speed) / values["velocity"]) ** values["exponent"]
    return np.asarray(1.0 / (1.0 + (np.e - 1.0) * x) if "rational" in values else np.exp(-x))


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Coulomb and viscous friction."""
    j = model.joint_index
    return single_joint_columns(
        motion, j, np.column_stack([motion.sign(j), joint_speed(motion, j)])
    )


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """One candidate a joint."""
    for j in range(motions[0].n):
        yield CandidateModel(
            "friction",
            j,
            _columns,
            parameters=named_coefficients("coulomb", "viscous"),
            is_plausible=lambda c: bool(c[0] > 0.0 and c[1] > -0.2 * c[0]),
        )


FRICTION = Effect(
    "friction",
    "F_c sgn q̇ + F_v q̇, where the model has none",
    _columns,
    _candidates,
    {"coulomb": "N m", "viscous": "N m s/rad"},
    "torque against the motion",
    ("stribeck",),
    "any motion in both directions",
    prior_only=True,
    form_std={"coulomb": 0.04, "viscous": 0.04},
)
"""Coulomb (dry) and viscous friction of a joint whose trusted prior states none."""
