"""Asymmetric viscous friction: viscous friction that differs by direction."""

from __future__ import annotations

from collections.abc import Iterator

from .._types import FloatArray
from .effect import CandidateModel, Values
from .joint_torque import JointTorque
from .recorded_motion import FittedRobot, Motions, max_speed

MAX_EXCESS = 1.5
"""Largest half difference of both directions, over the friction of the base fit at full speed: the
friction that refits with it may be larger by half."""


class _AsymmetricViscous(JointTorque):
    """Half of the difference between both directions; their mean is that of the base model."""

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        viscous, coulomb = (
            max(float(motions[0].fitted_robot.actuator_parameter(kind)[joint]), 1e-9)
            for kind in ("viscous", "coulomb")
        )
        limit = MAX_EXCESS * (viscous + coulomb / max_speed(motions, joint))
        yield CandidateModel(self, joint, facts={"limit": limit})

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        """Check that it dissipates energy in both directions, with all friction."""
        return bool(abs(c[0]) < model.facts["limit"])

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        viscous = float(base.actuator_parameter("viscous")[model.joint_index])
        return {"positive": viscous + float(c[0]), "negative": viscous - float(c[0])}


ASYMMETRIC_VISCOUS = _AsymmetricViscous(
    "asymmetric_viscous",
    "F_v+ for q̇ > 0, F_v− for q̇ < 0",
    {"positive": "N m s/rad", "negative": "N m s/rad"},
    "torque against speed has another slope in each direction",
    "constant speeds in both directions, several of them",
    regime="direction",
    form_std={"positive": 0.09, "negative": 0.09},
)
"""Direction-dependent viscous friction."""
