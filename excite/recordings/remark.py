"""Remarks about a recording: properties and faults of its data, and how they were repaired."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any


class RemarkKind(Enum):
    """Subject of a remark. The function that makes a remark documents its rule."""

    ORDER = "order"
    REPEATED = "repeated"
    HELD = "held"
    CLOCK = "clock"
    JITTER = "jitter"
    TIMESTAMP_JITTER = "timestamp jitter"
    GAP = "gap"
    MISSING = "missing"
    UNIT = "unit"
    SKIPPED = "skipped"
    LOCKED = "locked joint"
    STILL = "still"
    COARSE = "coarse"
    ROUNDED = "rounded"
    FROZEN = "frozen"
    REPEATED_TORQUE = "repeated torque"
    CLIPPED = "clipped"
    OUTSIDE = "outside"
    INCONSISTENT = "inconsistent"
    CLOCK_STEP = "clock step"
    WRAPPED = "wrapped"
    GLITCH = "glitch"
    PUBLISHER = "publisher"
    SPEED = "speed"
    PERIOD = "period"
    EXECUTED = "executed motion"
    PLANNED = "planned"
    NUMBERED = "numbered joints"
    TORQUE_SIGN = "torque sign"
    MAGNITUDE = "torque magnitude"
    TORQUE_SCALE = "torque scale"
    TORQUE_LIMIT = "torque limit"
    WEIGHT = "weight"
    GRAVITY = "gravity"
    EXCHANGED = "exchanged joints"
    POSITION = "position"


def shown_time(time: float) -> str:
    """Format a time of a recording for a message [s]: to 1 ms, also where it is a Unix time."""
    return f"{round(time, 3):.13g}"


@dataclass(frozen=True)
class Remark:
    """A property or a fault of a recording.

    Attributes:
        kind: Subject.
        text: Description for the user.
        joint: Name of the joint, None if it concerns all.
        start: First time at which it occurs [s], None if it concerns all of the recording.
        end: Last time at which it occurs [s], None likewise.
        repaired: True if the data were changed by the rule of this kind.
        doubt: True if a column may not hold what it is taken for, and the data were not repaired. A
            model fitted to such a recording describes the fault, not the robot.
    """

    kind: RemarkKind
    text: str
    joint: str | None = None
    start: float | None = None
    end: float | None = None
    repaired: bool = False
    doubt: bool = False

    def document(self) -> dict[str, Any]:
        """Entry of a `--json` document."""
        time = None if self.start is None else [self.start, self.end]
        return {
            "kind": self.kind.value,
            "joint": self.joint,
            "text": self.text,
            "time": time,
            "repaired": self.repaired,
            "doubt": self.doubt,
        }
