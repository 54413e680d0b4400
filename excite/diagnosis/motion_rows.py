"""State of the robot at every row of some motions, and means over a quantity of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import BoolArray, FloatArray
from ..effects.recorded_motion import Motions, RecordedMotion
from ..identification.lowpass import Grid

MIN_BIN_ROWS = 8
"""Rows that a bin needs to be drawn."""
SLOW_SPEED_RATIO = 0.02
"""Speed over the joint's largest speed below which it has no direction."""


@dataclass(frozen=True)
class MotionRows:
    """State of the robot at every row of some motions.

    Attributes:
        time: Time stamps of the recordings [s], shape (N,).
        run_time: Time since the start of the recording [s], shape (N,).
        q: Joint positions, shape (N, n).
        dq: Joint velocities, shape (N, n).
        ddq: Joint accelerations, shape (N, n).
        load: Torque of the rigid links [N m], shape (N, n).
        motor_torque: Torque of the base model, or of a joint model [N m], shape (N, n).
        distance: Travel since the last reversal, shape (N, n).
        moving: Rows at which a joint is judged, shape (N, n).
    """

    time: FloatArray
    run_time: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    load: FloatArray
    motor_torque: FloatArray
    distance: FloatArray
    moving: BoolArray
    linear: tuple[bool, ...]

    def __len__(self) -> int:
        return len(self.time)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    def direction(self, joint: int) -> FloatArray:
        """Return the direction of motion of a joint, −1, 0 or 1, shape (N,)."""
        speed = self.dq[:, joint]
        return np.sign(speed) * (np.abs(speed) > SLOW_SPEED_RATIO * np.abs(speed).max())


def motion_rows(motions: Motions) -> MotionRows:
    """Concatenate the rows of some motions."""
    parts = [_state(motion) for motion in motions]
    entries = motions[0].fitted_robot.robot.entries
    return MotionRows(
        **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]},
        linear=tuple(entry.kind == "prismatic" for entry in entries),
    )


def _state(motion: RecordedMotion) -> dict[str, Any]:
    """Fields of `MotionRows` of one motion."""
    s, of = motion.coarse_samples, Grid.COARSE
    distance = np.column_stack(
        [travel_since_reversal(q, dq) for q, dq in zip(s.q.T, s.dq.T, strict=True)]
    )
    return {
        "time": motion.time,
        "run_time": motion.at_rows(motion.run_time[:, None])[:, 0],
        "q": motion.at_rows(s.q, of),
        "dq": motion.at_rows(s.dq, of),
        "ddq": motion.at_rows(s.ddq, of),
        "load": motion.at_rows(motion.rigid_torque, of),
        "motor_torque": motion.lowpass(motion.motor_torque),
        "distance": motion.at_rows(distance, of),
        "moving": motion.moving,
    }


def travel_since_reversal(q: FloatArray, dq: FloatArray) -> FloatArray:
    """Return the travel since the last reversal, except those in very slow motion, shape (C,)."""
    sign = np.sign(dq) * (np.abs(dq) > SLOW_SPEED_RATIO * np.abs(dq).max(initial=0.0))
    index = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(q)), 0))
    last_sign = sign[index]
    reversals = np.flatnonzero(np.diff(last_sign, prepend=last_sign[:1]) != 0.0)
    origin = np.zeros(len(q), int)
    origin[reversals] = reversals
    return np.abs(q - q[np.maximum.accumulate(origin)])


def binned_means(
    x: FloatArray, y: FloatArray, edges: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres and means (b,) of y in bins of x with enough rows, and means by row (N,)."""
    bins = len(edges) - 1
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    means = np.asarray(np.bincount(place, y, minlength=bins) / np.maximum(count, 1))
    enough = count >= MIN_BIN_ROWS
    return 0.5 * (edges[1:] + edges[:-1])[enough], means[enough], means[place]
