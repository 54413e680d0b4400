"""The base model with what was found: its torque along a recording, recordings without it, and its place in `model.json`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..effects import EFFECTS_BY_NAME, recorded_motion
from ..effects.effect import CandidateModel
from ..effects.recorded_motion import RecordedMotion
from ..identification.identified_model import IdentifiedModel
from ..identification.lowpass import Grid
from ..identification.segments import RecordingSegment
from ..recordings import Recording
from ..robot.robot import Robot
from ..schemas.effects import EffectDocument
from .search import EffectRegression, Trial

Array = np.ndarray


@dataclass(frozen=True)
class FittedEffect:
    """A fitted shape. coefficients: Shape (k,)."""

    shape: CandidateModel
    coefficients: Array


def parts(one: EffectRegression, together: Trial | None) -> tuple[FittedEffect, ...]:
    """The shapes of a fit, each with its own coefficients."""
    if together is None:
        return ()
    split_by_motion = one.split(together.shapes, together.coefficients)
    return tuple(FittedEffect(one.shapes[i], c) for i, c in zip(together.shapes, split_by_motion, strict=True))


def torque(found: Sequence[FittedEffect], along: RecordedMotion) -> Array:
    """What was found adds, below the band, at every sample of a track's piece. Shape (M, n) [N m]."""
    piece = along.segment
    every = dataclasses.replace(
        along,
        grid=Grid.RECORDED,
        kept=slice(0, len(piece)),
        time=piece.start + np.arange(len(piece)) / piece.rate,
    )
    out = np.zeros(piece.q.shape)
    for part in found:
        out += part.shape.columns(every) @ part.coefficients
    return out


def removed(found: Sequence[FittedEffect], recording: Recording, tracks: Sequence[RecordedMotion]) -> Recording:
    """A recording whose torque is without what was found, where there are tracks of it."""
    tau = recording.torque.copy()
    for one in tracks:
        if one.segment.source == recording.source:
            first = int(np.argmin(np.abs(recording.t - one.segment.start)))
            tau[first : first + len(one.segment)] -= torque(found, one)
    return dataclasses.replace(recording, tau=tau)


# -- in model.json ---------------------------------------------------------------------------------------------------


def entry(part: FittedEffect, robot: Robot) -> dict[str, Any]:
    """An element of the model's "effects"."""
    shape = part.shape
    return {
        "effect": shape.effect,
        "joint": None if shape.joint is None else robot.joints[shape.joint],
        "from": None if shape.other is None else robot.joints[shape.other],
        "values": dict(shape.values),
        "coefficients": part.coefficients.tolist(),
        "time": None if shape.interval is None else list(shape.interval),
        "recording": shape.source or None,
    }


def restored(stated: EffectDocument, robot: Robot) -> FittedEffect:
    """The fitted shape of a validated effect of `model.json`."""
    joint, other = (
        None if name is None else robot.joints.index(name) for name in (stated.joint, stated.other)
    )
    interval = None if stated.time is None else (float(stated.time[0]), float(stated.time[1]))
    values = {key: float(value) for key, value in stated.values.items()}
    shape = CandidateModel(
        stated.effect,
        joint,
        EFFECTS_BY_NAME[stated.effect].torque_columns,
        values,
        other,
        interval,
        stated.recording or "",
    )
    return FittedEffect(shape, np.array(stated.coefficients, float))


def predict(fitted: IdentifiedModel, recording: Recording) -> tuple[Array, Array]:
    """Torque along a recording at its own times, effects included: (times, torque). Shapes (N,) [s], (N, n) [N m]."""
    found = [restored(stated, fitted.robot) for stated in fitted.effects]
    if not found:
        return fitted.predict(recording)
    body = recorded_motion.fitted_robot(fitted.robot, fitted.layout, fitted.psi)
    own, late = (
        [part for part in found if (part.shape.values.get("measured", 0.0) > 0.0) is last]
        for last in (False, True)
    )
    late.sort(
        key=lambda part: list(EFFECTS_BY_NAME).index(part.shape.effect)
    )  # a drive's loss before a clock's delay, as the catalogue has them
    nothing = np.zeros((0, fitted.robot.n))

    def beyond(stretch: Recording) -> Array:
        still, warmth = np.zeros(stretch.q.shape), stretch.temperature
        whole = (recording.source, float(stretch.t[0]), stretch.rate, stretch.q, still)
        piece = RecordingSegment(
            *whole, encoder=recording.encoder, temperature=warmth, recording_start=float(recording.t[0])
        )
        band = piece.band(min(fitted.hertz, 0.45 * piece.rate))
        empty = nothing[:, :, None]
        along = RecordedMotion(
            piece,
            band,
            body,
            fitted.widths,
            np.zeros(0),
            nothing,
            empty,
            nothing,
            slice(0),
            np.zeros(0),
        )
        added = torque(own, along)
        for part in late:
            recorded = EFFECTS_BY_NAME[part.shape.effect].predicted_torque
            assert recorded is not None  # a shape of measured torque has one
            added += band.filter(
                recorded(along, part.shape, part.coefficients, along.motor_torque + added), Grid.RECORDED
            )
        return added

    return fitted.predict(recording, beyond)
