"""Torque saturation: the torque per current falls at high current, or clips."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from .._types import FloatArray
from ..identification.standstill import STANDSTILL_SPEED_RATIO
from .effect import CandidateModel, Effect, grid_candidates, is_between, single_joint_columns
from .recorded_motion import RecordedMotion

POWERS = (2.0, 3.0, 5.0)
"""Powers of the torque that are lost."""
SHARPNESSES = (1.0, 2.0, 4.0)
"""Exponents p of a torque that levels off as τ/(1 + |τ/L|^p)^(1/p)."""
MAX_LEVEL_COEFFICIENT = 1.1
"""Largest coefficient of a torque that levels off; with 1 it never exceeds the level."""
MAX_USUAL_LOSS = 0.3
"""Largest loss at a usual torque."""
MAX_LOSS = 0.5
"""Largest loss at the largest torque: magnetic saturation costs 10-30 % at peak current, and of a
drive that records what it is told and clips it, no one would let half get lost."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Lost torque, of the measured torque, or of the base model's in older files."""
    torque = motion.measured_torque if model.values.get("measured") else motion.motor_torque
    return single_joint_columns(
        motion, model.joint_index, lost_torque(model.values, torque[:, model.joint_index])
    )


def lost_torque(values: Mapping[str, float], x: FloatArray) -> FloatArray:
    """Return the lost torque per coefficient, shape (M,): a power of x, or all above a level."""
    if "level" in values:
        bend = values["bend"]
        return np.asarray(x * (1.0 - (1.0 + np.abs(x / values["level"]) ** bend) ** (-1.0 / bend)))
    return np.asarray(x * (np.abs(x) / values["largest"]) ** (values["power"] - 1.0))


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Losses as functions of the measured torque, for which that of the joint model stands.

    The recorded τ stands for a current that produced less: true = τ (1 − loss (τ/τ_max)²). A
    magnetically saturated motor levels off with the measured torque as τ/(1 + |τ/L|^p)^(1/p).
    """
    for joint in range(motions[0].n):
        signals = zip(
            *((motion.measured_torque, motion.samples.dq) for motion in motions), strict=True
        )
        torque, speed = (np.abs(np.concatenate([x[:, joint] for x in parts])) for parts in signals)
        largest = max(float(torque.max()), 1e-9)
        # median torque in motion: a joint at standstill may carry none
        moving = speed >= STANDSTILL_SPEED_RATIO * speed.max()
        usual = max(float(np.median(torque[moving])), 1e-9)
        for power in POWERS:
            yield _loss(joint, usual, largest, 1.0, power=power)
        for sharpness in SHARPNESSES:
            levels = np.geomspace(usual, largest, 6).tolist()
            yield from grid_candidates(levels, _levelling_off(joint, usual, largest, sharpness))


def _levelling_off(
    joint: int, usual: float, largest: float, sharpness: float
) -> Callable[[float], CandidateModel]:
    """Return the model of a torque that levels off, for each level [N m]."""
    return lambda level: _loss(
        joint, usual, largest, MAX_LEVEL_COEFFICIENT, level=level, bend=sharpness
    )


def _loss(
    joint: int, usual: float, largest: float, max_coefficient: float, **values: float
) -> CandidateModel:
    """Return a loss that is reported at the largest torque, and is small at a usual one.

    Args:
        joint: Index of the joint.
        usual: A usual torque [N m].
        largest: The largest torque [N m].
        max_coefficient: Largest coefficient.
        **values: Power, or level and bend.
    """
    fixed = {"measured": 1.0, "largest": largest, **values}
    usual_loss, largest_loss = (
        lost_torque(fixed, np.array([usual, largest])) / [usual, largest]
    ).tolist()
    bounds = max_coefficient, MAX_USUAL_LOSS / max(usual_loss, 1e-9), MAX_LOSS / largest_loss
    return CandidateModel(
        "torque_saturation",
        joint,
        _columns,
        fixed,
        parameters=lambda c: {"loss": largest_loss * float(c[0])},
        is_plausible=is_between(0.0, min(bounds)),
    )


def _predicted_torque(
    motion: RecordedMotion, model: CandidateModel, c: FloatArray, produced: FloatArray
) -> FloatArray:
    """Recorded minus produced torque of an actuator that loses torque, shape (M, n)."""
    out = np.zeros_like(produced)
    torque = produced[:, model.joint_index]
    out[:, model.joint_index] = recorded_torque(float(c[0]), model.values, torque) - torque
    return out


def recorded_torque(loss: float, values: Mapping[str, float], torque: FloatArray) -> FloatArray:
    """Return the torque that is recorded while a saturating actuator produces a torque.

    Solves x − c · lost(x) = τ for x.

    Args:
        loss: Coefficient c.
        values: Values of the candidate model.
        torque: Produced torque τ [N m], shape (M,).
    """
    x = np.linspace(0.0, 2.0 * values["largest"], 4001)
    produced = x - loss * lost_torque(values, x)
    rising = slice(0, int(np.argmax(produced)) + 1)  # the actuator produces no more than that
    size = np.abs(torque)
    return np.asarray(
        np.sign(torque) * np.maximum(size, np.interp(size, produced[rising], x[rising]))
    )


TORQUE_SATURATION = Effect(
    "torque_saturation",
    "k_t (1 − β i²); or τ/(1 + |τ/L|^p)^(1/p), which levels off (Fröhlich 1881 for p = 1)",
    _columns,
    _candidates,
    {"loss": "1"},
    "torque is missing at high current only",
    "short bursts near the torque limit",
    predicted_torque=_predicted_torque,
)
"""Motor saturation, current limit, torque constant that falls with current."""
