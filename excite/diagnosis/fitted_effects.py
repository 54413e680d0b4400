"""Fitted effects: torque along a motion, entries of `model.json`, and prediction by such a file.

What a diagnosis reports as error is that of the file: of a model read back from its text.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import _json
from .._types import FloatArray
from ..effects import EFFECTS_BY_NAME
from ..effects.effect import CandidateModel
from ..effects.recorded_motion import FittedRobot, Motions, RecordedMotion
from ..identification import identified_model
from ..identification.identification import MAX_BAND_SHARE
from ..identification.identified_model import IdentifiedModel, at_row_times
from ..identification.lowpass import FLAT_BANDWIDTH_RATIO, Grid
from ..identification.segments import RecordingSegment
from ..recordings import Recording
from ..robot.robot import Robot
from ..schemas.effects import EffectDocument


@dataclass(frozen=True)
class FittedEffect:
    """A candidate model with its fitted coefficients, shape (k,)."""

    shape: CandidateModel
    coefficients: FloatArray

    def torque(self, motions: Motions) -> FloatArray:
        """Return the torque at the rows of some motions [N m], shape (N, n)."""
        return np.concatenate([self.shape.columns(m) @ self.coefficients for m in motions])


def torque(effects: Sequence[FittedEffect], motion: RecordedMotion) -> FloatArray:
    """Return the torque of effects at every sample of a motion [N m], (M, n).

    It is complete below the cutoff frequency, to pass a filter with the torque of all else.
    """
    at_samples = dataclasses.replace(
        motion, grid=Grid.RECORDED, bandwidth_ratio=FLAT_BANDWIDTH_RATIO
    )
    return sum(
        (effect.torque([at_samples]) for effect in effects), np.zeros(motion.segment.q.shape)
    )


def entry(effect: FittedEffect, robot: Robot) -> dict[str, Any]:
    """Return the element of an effect in the "effects" of `model.json`."""
    model = effect.shape
    return {
        "effect": model.effect,
        "joint": None if model.joint is None else robot.joints[model.joint],
        "from": None if model.other is None else robot.joints[model.other],
        "values": dict(model.values),
        "coefficients": effect.coefficients.tolist(),
        "time": None if model.interval is None else list(model.interval),
        "recording": model.source or None,
    }


def restored(stated: EffectDocument, robot: Robot) -> FittedEffect:
    """Return the fitted effect of a validated element of `model.json`."""
    joint, other = (
        None if name is None else robot.joints.index(name) for name in (stated.joint, stated.other)
    )
    interval = None if stated.time is None else (float(stated.time[0]), float(stated.time[1]))
    values = {key: float(value) for key, value in stated.values.items()}
    definition = EFFECTS_BY_NAME[stated.effect]
    model = CandidateModel(definition, joint, values, other, interval, stated.recording or "")
    return FittedEffect(model, np.array(stated.coefficients, float))


def predict(fitted: IdentifiedModel, recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Return times (N,) [s] of a recording and the torque (N, n) [N m] there, effects included."""
    of_effects = _effect_torque(fitted, recording, is_filtered=True) if fitted.effects else None
    return fitted.predict(recording, of_effects)


def read_back(document: Mapping[str, Any]) -> IdentifiedModel:
    """Return the model that `excite predict` reads from the text of a `model.json`."""
    file = identified_model.model_file(Path("model.json"))
    return identified_model.model_from_document(file, json.loads(_json.dumps(document)))


def residuals(
    model: IdentifiedModel,
    recordings: Sequence[Recording],
    motions: Motions,
) -> FloatArray:
    """Return measured minus predicted torque at the rows of motions, shape (N, n) [N m].

    The measured torque is that of the motions, below the cutoff frequency.
    """
    predictions = {r.source: predict(model, r) for r in recordings}
    out = []
    for motion in motions:
        times, torque = predictions[motion.segment.source]
        at_rows = [np.interp(motion.time, times, column) for column in torque.T]
        out.append(motion.torque - np.column_stack(at_rows))
    return np.concatenate(out)


def without_effects(fitted: IdentifiedModel, recording: Recording) -> Recording:
    """Return a recording whose torque is without what the effects of a model predict."""
    effect_torque = _effect_torque(fitted, recording, is_filtered=False)
    torques = [(stretch, effect_torque(stretch)) for stretch in recording.segments()]
    times, torque = at_row_times(recording, torques)
    at_samples = [np.interp(recording.t, times, column) for column in torque.T]
    return dataclasses.replace(recording, tau=recording.torque - np.column_stack(at_samples))


def _effect_torque(
    fitted: IdentifiedModel, recording: Recording, *, is_filtered: bool
) -> Callable[[Recording], FloatArray]:
    """Function that predicts the torque of all effects along a gap-free stretch of a recording.

    `is_filtered`: whether it is low-passed, to be compared with low-passed torque.
    """
    effects = [restored(stated, fitted.robot) for stated in fitted.effects]
    robot = FittedRobot(fitted.robot, fitted.layout, fitted.psi)
    of_motion, of_measured_torque = (
        [part for part in effects if ("measured" in part.shape.values) is measured]
        for measured in (False, True)
    )
    # an actuator's loss before a clock's delay, as in the catalogue
    of_measured_torque.sort(key=lambda part: list(EFFECTS_BY_NAME).index(part.shape.effect))

    def effect_torque(stretch: Recording) -> FloatArray:
        segment = RecordingSegment(
            recording.source,
            float(stretch.t[0]),
            stretch.rate,
            stretch.q,
            np.zeros(stretch.q.shape),
            encoder=recording.quantization_noise,
            temperature=stretch.temperature,
            recording_start=float(recording.t[0]),
        )
        band = segment.band(min(fitted.hertz, MAX_BAND_SHARE * segment.rate))
        motion = RecordedMotion(segment, band, robot, fitted.widths)
        out = torque(of_motion, motion)
        for part in of_measured_torque:
            shape, joints = part.shape, part.shape.joints
            produced = (motion.motor_torque + out)[:, joints]
            change = shape.definition.recorded_change(motion, shape, part.coefficients, produced)
            out[:, joints] += band.filter(
                change, Grid.RECORDED, bandwidth_ratio=FLAT_BANDWIDTH_RATIO
            )
        if is_filtered:
            out = band.filter(out, Grid.RECORDED)
        return out

    return effect_torque
