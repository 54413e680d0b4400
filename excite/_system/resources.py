"""Estimated time and memory of a computation, compared with the machine's."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import UnusableInput

MEMORY_SHARE = 0.7
"""Share of the machine's memory that a command may use [1]; other processes need the remainder."""
MAX_TIME = 24 * 3600.0
"""Longest estimated time of a command [s]; a longer one is usually a mistake in the options."""
ANNOUNCED_TIME = 30.0
"""Estimated time from which it is announced before the computation [s]."""
ANNOUNCED_MEMORY = 1e9
"""Estimated memory from which it is announced before the computation [bytes]."""
CGROUP_LIMITS = (
    Path("/sys/fs/cgroup/memory.max"),
    Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
)
"""Files with the memory limit of a container: control groups of version 2 and 1."""


@dataclass(frozen=True)
class Cost:
    """Estimated cost of a computation.

    Attributes:
        seconds: Time on an idle machine [s].
        memory: Memory of all processes [bytes].
    """

    seconds: float
    memory: float

    def __str__(self) -> str:
        """Return both in words: "about 4 min and 1.2 GB"."""
        return f"about {duration(self.seconds)} and {self.memory / 1e9:.2g} GB"

    def require(
        self, work: str, remedy: str, announce: Callable[[str], None] | None = None
    ) -> None:
        """Refuse a computation that is too large for this machine, and announce a long one.

        Args:
            work: The computation, for messages: "60 joints, 100 samples".
            remedy: How to make it smaller, for messages.
            announce: Called with a line of progress; None: nothing is announced.

        Raises:
            UnusableInput: It takes longer than MAX_TIME, or more than MEMORY_SHARE of the
                memory.
        """
        memory = machine_memory()
        if memory is not None and self.memory > MEMORY_SHARE * memory:
            raise UnusableInput(
                f"{work}: needs {self}, more than {100 * MEMORY_SHARE:.0f} % of this machine's "
                f"{memory / 1e9:.2g} GB; {remedy}"
            )
        if self.seconds > MAX_TIME:
            raise UnusableInput(f"{work}: needs {self}, longer than {duration(MAX_TIME)}; {remedy}")
        is_large = self.seconds > ANNOUNCED_TIME or self.memory > ANNOUNCED_MEMORY
        if announce is not None and is_large:
            announce(f"{work}: this takes {self}")


def duration(seconds: float) -> str:
    """Return a time [s] in words with two digits: "40 s", "3.5 min", "12 h", "2.1 days"."""
    for unit, length in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"


def machine_memory() -> float | None:
    """Return the memory of the machine or of the container [bytes]; None if unknown."""
    known = []
    with contextlib.suppress(AttributeError, OSError, ValueError):  # Windows
        known.append(float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES"))
    for file in CGROUP_LIMITS:
        try:
            known.append(float(file.read_text(encoding="ascii")))
        except (OSError, ValueError):  # absent, or "max": no limit
            continue
    return min(known, default=None)
