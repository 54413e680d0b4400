"""Load-dependent friction: friction that grows with the torque that the gear transmits."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Values
from .joint_torque import JointTorque
from .recorded_motion import FittedRobot, Motions

EFFICIENCY_DIFFERENCE = 0.1
"""Usual difference of load friction between driving and being driven, over the prior of μ."""
PRIOR_COEFFICIENT = 0.2
"""Prior standard deviation of the friction coefficient; usual ones are 0.03-0.3."""


class _LoadFriction(JointTorque):
    """|τ_L| sgn q̇, its square over the scale, and what is lost in one direction of power alone.

    The efficiency of gears differs between driving a load and being driven by it, but neither gives
    torque: |τ_L| sgn q̇ ± τ_L, both ≥ 0, hold no gain of the torque.
    """

    def dense_model(self, motions: Motions, joint: int) -> CandidateModel:
        """Return friction that grows with the load and its square."""
        load = np.abs(np.concatenate([motion.transmitted_torque[:, joint] for motion in motions]))
        return CandidateModel(
            self,
            joint,
            {"dense": 1.0, "scale": max(float(load.max()), 1e-9)},
            facts={"mean_load": float(load.mean())},
            prior_std=PRIOR_COEFFICIENT,
            prior_shares=(1.0, 1.0, EFFICIENCY_DIFFERENCE, EFFICIENCY_DIFFERENCE),
        )

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        square = c[1] * model.facts["mean_load"] / model.values["scale"]
        return {"mu": float(c[0] + square + c[2] + c[3])}


LOAD_FRICTION = _LoadFriction(
    "load_friction",
    "μ |τ_L|^k sgn q̇ (Hamon, Gautier & Garrec 2010)",
    {"mu": "1"},
    "friction grows with the torque carried",
    "repeat the same trajectory with another load",
    regime="load",
    nonnegative=(True,) * 4,
    has_candidates=False,
    form_std={"mu": 0.35},
)
"""Load-dependent gear friction, torque-dependent losses."""
