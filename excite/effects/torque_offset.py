"""Torque offset: a constant torque, as of a biased sensor or of Coulomb friction by direction."""

from __future__ import annotations

from .joint_torque import JointTorque

TORQUE_OFFSET = JointTorque(
    "torque_offset",
    "τ₀",
    {"offset": "N m"},
    "constant, whatever the motion",
    "hold a pose, reached from both sides",
    prior_only=True,
    form_std={"offset": 0.04},
)
"""Torque sensor bias."""
