"""Friction: Coulomb and viscous friction of a joint whose trusted prior states none."""

from __future__ import annotations

import numpy as np

from .joint_torque import JointTorque

FRICTION = JointTorque(
    "friction",
    "F_c sgn q̇ + F_v q̇, where the model has none",
    {"coulomb": "N m", "viscous": "N m s/rad"},
    "torque against the motion",
    "any motion in both directions",
    nonnegative=(True, True),
    prior_only=True,
    form_std={"coulomb": 0.04, "viscous": 0.04},
    bounds=(0.0, np.inf),
)
"""Coulomb (dry) and viscous friction."""
