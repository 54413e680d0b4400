"""Drag: resistance that grows with the square of the speed."""

from __future__ import annotations

import numpy as np

from .joint_torque import JointTorque

DRAG = JointTorque(
    "drag",
    "c q̇ |q̇|",
    {"coefficient": "N m s²/rad²"},
    "resistance grows with the square of speed",
    "very fast motion",
    regime="speed",
    bounds=(0.0, np.inf),
)
"""Air or fluid drag, churning losses of a gear's oil."""
