"""Remarks about a recording: properties and faults of its data, and how they were repaired."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any


class RemarkKind(Enum):
    """Subject of a remark. The function that makes a remark documents its rule."""

    ORDER = "order"
    REPEATED = "repeated"
    CLOCK = "clock"
    JITTER = "jitter"
    TIMESTAMP_JITTER = "waver"
    GAP = "gap"
    MISSING = "missing"
    UNIT = "unit"
    SKIPPED = "skipped"
    STILL = "still"
    COARSE = "coarse"
    ROUNDED = "rounded"
    FROZEN = "frozen"
    CLIPPED = "clipped"
    OUTSIDE = "outside"
    INCONSISTENT = "inconsistent"


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
    """

    kind: RemarkKind
    text: str
    joint: str | None = None
    start: float | None = None
    end: float | None = None
    repaired: bool = False

    def document(self) -> dict[str, Any]:
        """Entry of a `--json` document."""
        time = None if self.start is None else [self.start, self.end]
        return {
            "kind": self.kind.value,
            "joint": self.joint,
            "text": self.text,
            "time": time,
            "repaired": self.repaired,
        }
