"""Load-dependent friction: friction that grows with the torque that the gear transmits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from .._types import FloatArray
from .effect import (
    CandidateModel,
    Effect,
    grid_candidates,
    is_between,
    named_coefficients,
    single_joint_columns,
)
from .friction import joint_speed, max_speed, velocity_weakening
from .recorded_motion import RecordedMotion

WEAKENING_THRESHOLD_FACTOR = 6.0
"""Factor on the evidence for load friction that falls with speed: a coarse encoder's reversal
error, wherever there is load, looks like it."""

EFFICIENCY_DIFFERENCE = 0.1
"""Usual difference of load friction between driving and being driven, over the prior of μ."""
PRIOR_COEFFICIENT = 0.2
"""Prior standard deviation of the friction coefficient; usual ones are 0.03-0.3."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """sgn q̇ times a power of the load; with a "velocity", also the part that falls with speed.

    The load is the torque of the links, or where the model is "driven" that of the motor.
    """
    values, j = model.values, model.joint_index
    scale = values["scale"]
    if "dense" in values:
        load, sign = motion.transmitted_torque[:, j], motion.sign(j)
        share = np.abs(load) / scale
        return single_joint_columns(
            motion, j, scale * np.column_stack([sign * share, sign * share**2, load / scale])
        )
    load = (motion.motor_torque if "driven" in values else motion.transmitted_torque)[:, j]
    friction = motion.sign(j) * scale * (np.abs(load) / scale) ** values["power"]
    if "velocity" not in values:
        return single_joint_columns(motion, j, friction)
    weakening = friction * velocity_weakening(joint_speed(motion, j), values)
    return single_joint_columns(motion, j, np.column_stack([friction, weakening]))


def dense_model(motions: Sequence[RecordedMotion], joint: int) -> CandidateModel:
    """Return friction of a joint that grows with the load and its square.

    The last column, of either sign, is the load itself: the efficiency of gears differs by the
    direction of power.
    """
    torque = np.concatenate([motion.transmitted_torque[:, joint] for motion in motions])
    scale, mean = max(float(np.abs(torque).max()), 1e-9), float(np.abs(torque).mean())
    return CandidateModel(
        "load_friction",
        joint,
        _columns,
        {"dense": 1.0, "scale": scale},
        parameters=lambda c: {"mu": float(c[0] + c[1] * mean / scale)},
        nonnegative=(True, True, False),
        prior_std=PRIOR_COEFFICIENT,
        prior_shares=(1.0, 1.0, EFFICIENCY_DIFFERENCE),
    )


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Powers of the link or motor torque, and linear friction that falls with speed."""

    def family(j: int, fixed: Mapping[str, float]) -> Callable[[float], CandidateModel]:
        def model(velocity: float) -> CandidateModel:
            candidate = CandidateModel(
                "load_friction",
                j,
                _columns,
                {**fixed, "velocity": velocity},
                is_plausible=_decreases_with_speed,
                threshold_factor=WEAKENING_THRESHOLD_FACTOR,
            )
            weakening = [
                velocity_weakening(joint_speed(motion, j), candidate.values) for motion in motions
            ]
            # friction coefficient averaged over the motion
            mean = float(np.mean(np.concatenate(weakening)))
            return replace(candidate, parameters=lambda c: {"mu": float(c[0] + mean * c[1])})

        return model

    for j in range(motions[0].n):
        largest = (float(np.abs(motion.transmitted_torque[:, j]).max()) for motion in motions)
        scale = {"scale": max(*largest, 1e-9)}
        speeds = (np.array([0.02, 0.06, 0.2]) * max_speed(motions, j)).tolist()
        for powers, source in ((1.0, 1.5, 2.0), {}), ((1.0,), {"driven": 1.0}):
            for power in powers:
                yield CandidateModel(
                    "load_friction",
                    j,
                    _columns,
                    {"power": power, **scale, **source},
                    parameters=named_coefficients("mu"),
                    is_plausible=is_between(0.0, 1.0),
                )
            for exponent in (1.0, 2.0):
                yield from grid_candidates(
                    speeds, family(j, {"power": 1.0, "exponent": exponent, **scale, **source})
                )


def _decreases_with_speed(c: FloatArray) -> bool:
    """Check that friction grows with the load at every speed, and most at low speed."""
    return bool(c[0] >= 0.0 and c[1] > 0.0 and c[0] + c[1] < 1.0)


LOAD_FRICTION = Effect(
    "load_friction",
    "μ |τ_L|^k sgn q̇ (Hamon, Gautier & Garrec 2010); |τ_L| (μ + μ_s exp(−(|q̇|/v)^δ)) sgn q̇ "
    "(Bittencourt & Gunnarsson 2012)",
    _columns,
    _candidates,
    {"mu": "1"},
    "friction grows with the torque carried",
    ("position_friction", "coupling"),
    "repeat the same trajectory with another load at the flange",
    form_std={"mu": 0.35},
)
"""Load-dependent gear friction, torque-dependent losses."""
