"""Torque saturation: the torque per current falls at high current, or clips."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .._types import FloatArray
from ..identification.standstill import STANDSTILL_SPEED_RATIO
from .effect import CandidateModel, Effect, Values, grid_candidates, single_joint_columns
from .recorded_motion import FittedRobot, Motions, RecordedMotion

POWERS = (2.0, 3.0, 5.0)
"""Powers of the torque that are lost."""
SHARPNESSES = (1.0, 2.0, 4.0)
"""Exponents p of a torque that levels off as τ/(1 + |τ/L|^p)^(1/p)."""
MAX_LEVEL_COEFFICIENT = 1.1
"""Largest coefficient of a torque that levels off; with 1 it never exceeds the level."""
MAX_USUAL_LOSS = 0.3
"""Largest loss at a usual torque."""
MAX_LOSS = 0.5
"""Largest loss at the largest torque: magnetic saturation costs 10-30 % at peak current."""


class _TorqueSaturation(Effect):
    """Losses as functions of the measured torque, which the joint model's replaces.

    The recorded τ is that of a current that produced less: true = τ (1 − loss (τ/τ_max)²). A
    magnetically saturated motor levels off with the measured torque as τ/(1 + |τ/L|^p)^(1/p).
    """

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        j = model.joint_index
        return single_joint_columns(
            motion, j, lost_torque(model.values, motion.measured_torque[:, j])
        )

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        torque = np.abs(np.concatenate([m.measured_torque[:, joint] for m in motions]))
        speed = np.abs(np.concatenate([m.samples.dq[:, joint] for m in motions]))
        largest = max(float(torque.max()), 1e-9)
        # median torque in motion: a joint at standstill may carry none
        moving = speed >= STANDSTILL_SPEED_RATIO * speed.max()
        usual = max(float(np.median(torque[moving])), 1e-9)
        fixed, facts = {"measured": 1.0, "largest": largest}, {"usual": usual}
        for power in POWERS:
            yield CandidateModel(self, joint, {**fixed, "power": power}, facts=facts)
        levels = np.geomspace(usual, largest, 6).tolist()
        for sharpness in SHARPNESSES:
            values = {**fixed, "level": levels[0], "bend": sharpness}
            model = CandidateModel(self, joint, values, facts=facts)
            yield from grid_candidates(model, "level", levels)

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        return {"loss": _relative_loss(model, model.values["largest"]) * float(c[0])}

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        """Check that the loss is bounded at the largest torque, and small at a usual one."""
        bounds = (
            MAX_LEVEL_COEFFICIENT if "level" in model.values else 1.0,
            MAX_USUAL_LOSS / max(_relative_loss(model, model.facts["usual"]), 1e-9),
            MAX_LOSS / _relative_loss(model, model.values["largest"]),
        )
        return bool(0.0 < c[0] < min(bounds))

    def recorded_change(
        self, motion: RecordedMotion, model: CandidateModel, c: FloatArray, produced: FloatArray
    ) -> FloatArray:
        """Return recorded minus produced torque of an actuator that loses torque, (M, 1) [N m]."""
        return recorded_torque(float(c[0]), model.values, produced) - produced


def _relative_loss(model: CandidateModel, torque: float) -> float:
    return float(lost_torque(model.values, np.array([torque]))[0]) / torque


def lost_torque(values: Values, x: FloatArray) -> FloatArray:
    """Return the lost torque per coefficient, shape (M,): a power of x, or all above a level."""
    if "level" in values:
        bend = values["bend"]
        return np.asarray(x * (1.0 - (1.0 + np.abs(x / values["level"]) ** bend) ** (-1.0 / bend)))
    return np.asarray(x * (np.abs(x) / values["largest"]) ** (values["power"] - 1.0))


def recorded_torque(loss: float, values: Values, torque: FloatArray) -> FloatArray:
    """Return the torque x that is recorded where an actuator produces τ [N m], any shape.

    Solves x − c · lost(x) = τ with the coefficient c of the `loss`.
    """
    x = np.linspace(0.0, 2.0 * values["largest"], 4001)
    produced = x - loss * lost_torque(values, x)
    rising = slice(0, int(np.argmax(produced)) + 1)  # the actuator produces no more than that
    size = np.abs(torque)
    return np.asarray(
        np.sign(torque) * np.maximum(size, np.interp(size, produced[rising], x[rising]))
    )


TORQUE_SATURATION = _TorqueSaturation(
    "torque_saturation",
    "k_t (1 − β i²); or τ/(1 + |τ/L|^p)^(1/p), which levels off (Fröhlich 1881 for p = 1)",
    {"loss": "1"},
    "torque is missing at high current only",
    "short bursts near the torque limit",
    regime="load",
)
"""Motor saturation, current limit, torque constant that falls with current."""
