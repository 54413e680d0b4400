"""State of the robot at every row of some motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..effects.recorded_motion import RecordedMotion
from ..identification.lowpass import Grid

BLOCK = 1.0
"""Length of a block [s], longer than the correlation time of a servo's noise, so that blocks are
independent."""
MIN_BLOCKS = 40
"""Blocks into which a short recording is divided."""
MIN_BLOCK_PERIODS = 5.0
"""Shortest block, in periods of the cutoff frequency."""
MIN_BIN_ROWS = 8
"""Rows that a bin needs to be drawn."""
SLOW_SPEED_RATIO = 0.02
"""Speed over the joint's largest speed below which it has no direction."""


@dataclass(frozen=True)
class MotionRows:
    """State of the robot at every row of some motions.

    Attributes:
        time: Time, one recording after the other [s], shape (N,).
        clock: Time since the start of the recording [s], shape (N,).
        q: Joint positions, shape (N, n).
        dq: Joint velocities, shape (N, n).
        ddq: Joint accelerations, shape (N, n).
        load: Torque of the rigid links [N m], shape (N, n).
        motor_torque: Torque of the base model [N m], shape (N, n).
        distance: Travel since the last reversal, shape (N, n).
        temperature: Joint temperatures, NaN where none was recorded [°C], shape (N, n).
        moving: Rows at which a joint is judged, shape (N, n).
        starts: First row of each block.
        begins: First row of each motion.
        rate: Rows a second [Hz].
        hertz: Cutoff frequency [Hz].
        linear: Whether each joint is prismatic.
    """

    time: FloatArray
    clock: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    load: FloatArray
    motor_torque: FloatArray
    distance: FloatArray
    temperature: FloatArray
    moving: BoolArray
    starts: IntArray
    begins: IntArray
    rate: float
    hertz: float
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

    @property
    def blocks(self) -> IntArray:
        """Block of each row, shape (N,)."""
        return np.repeat(np.arange(len(self.starts)), np.diff([*self.starts, len(self)]))


def motion_rows(motions: Sequence[RecordedMotion]) -> MotionRows:
    """Concatenate the rows of some motions."""
    parts: dict[str, list[Any]] = {}
    starts, begins, at, elapsed = list[IntArray](), list[int](), 0, 0.0
    length = block_length(motions)
    for motion in motions:
        for name, value in _state(motion).items():
            parts.setdefault(name, []).append(value)
        clock = motion.time - motion.time[0]
        parts.setdefault("time", []).append(clock + elapsed)
        starts.append(at + block_starts(clock, length))
        begins.append(at)
        at, elapsed = at + len(motion), elapsed + float(clock[-1]) + length
    joined = {name: np.concatenate(values) for name, values in parts.items()}
    first = motions[0]
    return MotionRows(
        **joined,
        starts=np.concatenate(starts),
        begins=np.array(begins),
        rate=first.band.rate_of(Grid.KEPT),
        hertz=first.band.hertz,
        linear=tuple(entry.kind == "prismatic" for entry in first.fitted_robot.robot.entries),
    )


def block_length(motions: Sequence[RecordedMotion]) -> float:
    """Return the length of a block [s]: about 1 s, and less in short recordings."""
    total = sum(float(motion.time[-1] - motion.time[0]) for motion in motions)
    return float(min(BLOCK, max(total / MIN_BLOCKS, MIN_BLOCK_PERIODS / motions[0].band.hertz)))


def block_starts(clock: FloatArray, length: float) -> IntArray:
    """Return the first row of each block of a motion; a remainder joins the last block."""
    count = max(1, int(clock[-1] / length + 0.5))
    return np.unique(np.searchsorted(clock, np.arange(count) * length))


def _state(motion: RecordedMotion) -> dict[str, FloatArray | BoolArray]:
    """Fields of `MotionRows` of one motion."""
    s = motion.coarse_samples
    t = motion.segment.start + np.arange(len(s)) / motion.band.rate_of(Grid.COARSE)

    def at_rows(x: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(motion.time, t, column) for column in x.T])

    distance = np.column_stack(
        [travel_since_reversal(q, dq) for q, dq in zip(s.q.T, s.dq.T, strict=True)]
    )
    return {
        "clock": motion.time - motion.segment.start,
        "q": at_rows(s.q),
        "dq": at_rows(s.dq),
        "ddq": at_rows(s.ddq),
        "load": at_rows(motion.rigid_torque),
        "motor_torque": motion.lowpass(motion.motor_torque),
        "distance": at_rows(distance),
        "temperature": np.column_stack(
            [np.interp(motion.time, motion.times, column) for column in motion.temperature.T]
        ),
        "moving": motion.moving,
    }


def travel_since_reversal(q: FloatArray, dq: FloatArray) -> FloatArray:
    """Return the travel since the last reversal, shape (C,).

    Reversals within very slow motion do not count.
    """
    sign = np.sign(dq) * (np.abs(dq) > SLOW_SPEED_RATIO * np.abs(dq).max(initial=0.0))
    index = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(q)), 0))
    last_sign = sign[index]
    reversals = np.flatnonzero(np.diff(last_sign, prepend=last_sign[:1]) != 0.0)
    origin = np.zeros(len(q), int)
    origin[reversals] = reversals
    return np.abs(q - q[np.maximum.accumulate(origin)])
