"""Drag: resistance that grows with the square of the speed."""

from __future__ import annotations

from .._types import FloatArray
from .effect import CandidateModel
from .joint_torque import JointTorque


class _Drag(JointTorque):
    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        return bool((c > 0.0).all())


DRAG = _Drag(
    "drag",
    "c q̇ |q̇|",
    {"coefficient": "N m s²/rad²"},
    "resistance grows with the square of speed",
    "very fast motion",
)
"""Air or fluid drag, churning losses of a gear's oil."""
