"""Load-dependent friction: friction that grows with the torque that the gear transmits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Effect, no_candidates, single_joint_columns
from .hysteresis import direction
from .recorded_motion import RecordedMotion

EFFICIENCY_DIFFERENCE = 0.1
"""Usual difference of load friction between driving and being driven, over the prior of μ."""
PRIOR_COEFFICIENT = 0.2
"""Prior standard deviation of the friction coefficient; usual ones are 0.03-0.3."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """|τ_L| sgn q̇, its square over the scale, and the load."""
    scale, j = model.values["scale"], model.joint_index
    load, sign = motion.transmitted_torque[:, j], direction(motion, model)
    share = np.abs(load) / scale
    return single_joint_columns(
        motion, j, scale * np.array([sign * share, sign * share**2, load / scale]).T
    )


def dense_model(
    motions: Sequence[RecordedMotion], joint: int, build_up: Mapping[str, float] | None = None
) -> CandidateModel:
    """Return friction of a joint that grows with the load and its square.

    The last column, of either sign, is the load itself: the efficiency of gears differs by the
    direction of power.

    Args:
        motions: The recorded motions.
        joint: Index of the joint.
        build_up: How it builds up, as of `hysteresis.build_up`; at once if None.
    """
    torque = np.concatenate([motion.transmitted_torque[:, joint] for motion in motions])
    scale, mean = max(float(np.abs(torque).max()), 1e-9), float(np.abs(torque).mean())
    return CandidateModel(
        "load_friction",
        joint,
        _columns,
        {"dense": 1.0, "scale": scale, **(build_up or {})},
        parameters=lambda c: {"mu": float(c[0] + c[1] * mean / scale)},
        nonnegative=(True, True, False),
        prior_std=PRIOR_COEFFICIENT,
        prior_shares=(1.0, 1.0, EFFICIENCY_DIFFERENCE),
    )


LOAD_FRICTION = Effect(
    "load_friction",
    "μ |τ_L|^k sgn q̇ (Hamon, Gautier & Garrec 2010)",
    _columns,
    no_candidates,
    {"mu": "1"},
    "friction grows with the torque carried",
    "repeat the same trajectory with another load",
    form_std={"mu": 0.35},
)
"""Load-dependent gear friction, torque-dependent losses."""
