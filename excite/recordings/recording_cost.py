"""Time and memory that recordings take, by their rows N and joints n.

    reading and identification:  m = 130 MB + 76 bytes · N (1 + n · quantities)    t = 3 s + 1.2 µs
    · N n diagnosis:                   m = 200 MB + N (0.7 n + 0.08 n²) kB               t = 4 s + N
    (20 n + 1.6 n²) µs

`scripts/bench_scale.py` measured the coefficients with 10⁵ and 10⁶ rows of a robot of two joints
and of one of six, sampled at 1 kHz.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from .._system.resources import Cost
from .recording import Recording

BYTES_PER_NUMBER = 76.0
"""Memory per number read: the columns, their copies on an even grid and filtered [bytes]."""
PROCESS_MEMORY = 1.3e8
"""Memory of a process with its libraries [bytes]."""
REMEDY = "cut it into parts that one motion each is in, or record at a lower rate"


def require_readable(source: str, rows: int, numbers: int) -> None:
    """Raise UnusableInput where so many rows, of so many numbers together, are more than this
    machine can hold."""
    cost = Cost(0.0, PROCESS_MEMORY + BYTES_PER_NUMBER * numbers)
    cost.require(f"{source}: {rows} rows and more", REMEDY)


def require_identifiable(recordings: Sequence[Recording], say: Callable[[str], None]) -> None:
    """Announce a long identification; UnusableInput for one that this machine cannot do."""
    rows = sum(map(len, recordings))
    n = len(recordings[0].joints)
    numbers = sum(len(recording) * (1 + n * recording.quantities) for recording in recordings)
    cost = Cost(3.0 + 1.2e-6 * rows * n, PROCESS_MEMORY + BYTES_PER_NUMBER * numbers)
    cost.require(f"{rows} rows of {n} joints", REMEDY, say)


def require_diagnosable(recordings: Sequence[Recording], say: Callable[[str], None]) -> None:
    """Announce a long diagnosis; UnusableInput for one that this machine cannot do."""
    rows, n = float(sum(map(len, recordings))), len(recordings[0].joints)
    memory = 2e8 + rows * (700.0 * n + 80.0 * n**2)
    cost = Cost(4.0 + rows * (20e-6 * n + 1.6e-6 * n**2), memory)
    cost.require(f"{rows:.0f} rows of {n} joints", REMEDY, say)
