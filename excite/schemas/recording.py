"""The sidecar of a recording, schema excite.recording/1."""

from __future__ import annotations

from typing import Literal

import msgspec

from .quantities import ClockTime, DriveGain, Name, Period, PositionError, PositionGain, Text

SCHEMA = "excite.recording/1"
SHORTEST_WINDOW = 0.5
"""Shortest window over the period [1]. A recording of a single period may lack its transient;
nothing repeats in half a period."""


class SidecarDocument(msgspec.Struct):
    """The complete file; unknown keys are reported and ignored."""

    schema: Literal["excite.recording/1"]
    drive_gain: dict[str, DriveGain] = {}
    period: Period | None = None
    periodic: tuple[ClockTime, ClockTime] | None = None
    motor_side: bool = False
    effort: Literal["torque", "current", "without gravity"] | None = None
    topic: Name | None = None
    position_gain: dict[str, PositionGain] = {}
    error_limit: dict[str, PositionError] = {}
    notes: Text = Text("")

    def __post_init__(self) -> None:
        if self.periodic is None:
            return
        length = self.periodic[1] - self.periodic[0]
        if not length > 0.0:
            window = f"[{self.periodic[0]:g}, {self.periodic[1]:g}]"
            raise ValueError(f"periodic: {window} should be [start, end] with start < end")
        if self.period is not None and length < SHORTEST_WINDOW * self.period:
            shorter = f"much shorter than the period, {self.period:g} s"
            raise ValueError(f"periodic: a window of {length:g} s is {shorter}")
