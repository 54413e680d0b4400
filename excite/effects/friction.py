"""Friction: Coulomb and viscous friction of a joint whose prior states none."""

from __future__ import annotations

from .._types import FloatArray
from .effect import CandidateModel
from .joint_torque import JointTorque


class _Friction(JointTorque):
    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        return bool((c >= 0.0).all())


FRICTION = _Friction(
    "friction",
    "F_c sgn q̇ + F_v q̇, where the model has none",
    {"coulomb": "N m", "viscous": "N m s/rad"},
    "torque against the motion",
    "any motion in both directions",
    nonnegative=(True, True),
    prior_only=True,
    form_std={"coulomb": 0.04, "viscous": 0.04},
)
"""Coulomb (dry) and viscous friction of a joint whose trusted prior states none."""
