"""Time and memory that a command will take, against what the machine has."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import UnusableInput

MEMORY_SHARE = 0.7
"""Share of the machine's memory that a command may use; the rest is for everything else on it."""
LONGEST = 24 * 3600.0
"""Longest time that a command may take [s]. A design that needs more has a mistake in its options
more often than a purpose."""
WORTH_MENTION = 30.0, 1e9
"""Time [s] and memory [bytes] from which an estimate is printed before the work begins."""
CGROUP_LIMITS = (
    Path("/sys/fs/cgroup/memory.max"),
    Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
)
"""Files in which Linux states the memory limit of a container, of its two versions."""


@dataclass(frozen=True)
class Cost:
    """An estimate of what a piece of work takes.

    Attributes:
        seconds: Time on an idle machine [s].
        memory: Memory of all processes [bytes].
    """

    seconds: float
    memory: float

    def __str__(self) -> str:
        """Both in words: "about 4 min and 1.2 GB"."""
        return f"about {duration(self.seconds)} and {self.memory / 1e9:.2g} GB"

    def require(self, work: str, remedy: str, say: Callable[[str], None] | None = None) -> None:
        """Refuse work that this machine cannot do, and announce work that takes long.

        Args:
            work: The work, for messages: "60 joints, 100 samples".
            remedy: What makes it smaller, for messages.
            say: Prints a line of progress; None: nothing is announced.

        Raises:
            UnusableInput: The work takes longer than LONGEST, or more than MEMORY_SHARE of the
                memory.
        """
        memory = machine_memory()
        if memory is not None and self.memory > MEMORY_SHARE * memory:
            raise UnusableInput(
                f"{work}: needs {self}, more than {100 * MEMORY_SHARE:.0f} % of this machine's "
                f"{memory / 1e9:.2g} GB; {remedy}"
            )
        if self.seconds > LONGEST:
            raise UnusableInput(f"{work}: needs {self}, longer than {duration(LONGEST)}; {remedy}")
        if say and (self.seconds > WORTH_MENTION[0] or self.memory > WORTH_MENTION[1]):
            say(f"{work}: this takes {self}")


def duration(seconds: float) -> str:
    """A time in words with two digits: "40 s", "3.5 min", "12 h", "2.1 days"."""
    for unit, length in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"


def machine_memory() -> float | None:
    """Memory of the machine or of the container that this process runs in [bytes]; None where
    unknown."""
    known = []
    with contextlib.suppress(AttributeError, OSError, ValueError):  # Windows
        known.append(float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES"))
    for file in CGROUP_LIMITS:
        try:
            known.append(float(file.read_text(encoding="ascii")))
        except (OSError, ValueError):  # not there, or "max": no limit
            continue
    return min(known, default=None)
