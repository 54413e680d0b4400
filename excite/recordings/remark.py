"""What the health check found in a recording and what was done about it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any


class Kind(Enum):
    """What a remark is about. The rule of each is in the docstring of the function that finds
    it."""

    ORDER = "order"
    REPEATED = "repeated"
    CLOCK = "clock"
    JITTER = "jitter"
    WAVER = "waver"
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
    """One finding. repaired: the data were changed by the stated rule. start, end: where it happens
    [s], if anywhere."""

    kind: Kind
    text: str
    joint: str | None = None
    start: float | None = None
    end: float | None = None
    repaired: bool = False

    def document(self) -> dict[str, Any]:
        """For a `--json` document."""
        time = None if self.start is None else [self.start, self.end]
        return {
            "kind": self.kind.value,
            "joint": self.joint,
            "text": self.text,
            "time": time,
            "repaired": self.repaired,
        }
