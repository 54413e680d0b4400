"""Time and memory that recordings of N rows and n joints need, estimated in advance.

    reading and identification:  130 MB + 76 bytes · N (1 + n · quantities),  3 s + 1.2 µs · N n
    diagnosis:                   200 MB + N (0.7 n + 0.08 n²) kB,  4 s + N (20 n + 1.6 n²) µs

The coefficients were measured by `scripts/bench_scale.py` with 10⁵ and 10⁶ rows of robots with two
and six joints, sampled at 1 kHz.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from .._system.resources import Cost
from .recording import Recording

BYTES_PER_NUMBER = 76.0
"""Memory per number read: the columns, and copies of them resampled and filtered [bytes]."""
PROCESS_MEMORY = 1.3e8
"""Memory of a process with its libraries [bytes]."""
IDENTIFICATION_TIME = 3.0
"""Time of an identification that does not depend on its rows [s]."""
IDENTIFICATION_TIME_PER_NUMBER = 1.2e-6
"""Time of an identification per row and joint [s]."""
DIAGNOSIS_MEMORY = 2e8
"""Memory of a diagnosis that does not depend on its rows [bytes]."""
DIAGNOSIS_BYTES = (700.0, 80.0)
"""Memory of a diagnosis per row: coefficients of n and n² [bytes]."""
DIAGNOSIS_TIME = 4.0
"""Time of a diagnosis that does not depend on its rows [s]."""
DIAGNOSIS_TIME_PER_ROW = (20e-6, 1.6e-6)
"""Time of a diagnosis per row: coefficients of n and n² [s]."""
REMEDY = "cut it into parts with one motion each, or record at a lower rate"


def require_readable(source: str, rows: int, numbers: int) -> None:
    """Refuse a recording that does not fit into memory.

    Args:
        source: Name of the recording, for messages.
        rows: Number of rows read so far.
        numbers: Number of values in these rows.

    Raises:
        UnusableInput: This machine has less memory.
    """
    cost = Cost(0.0, PROCESS_MEMORY + BYTES_PER_NUMBER * numbers)
    cost.require(f"{source}: {rows} rows and more", REMEDY)


def require_identifiable(recordings: Sequence[Recording], say: Callable[[str], None]) -> None:
    """Announce a long identification, or refuse one.

    Args:
        recordings: All recordings.
        say: Function that shows a line to the user.

    Raises:
        UnusableInput: It needs more memory or time than this machine offers.
    """
    rows = sum(map(len, recordings))
    n = len(recordings[0].joints)
    numbers = sum(len(recording) * (1 + n * recording.quantities) for recording in recordings)
    memory = PROCESS_MEMORY + BYTES_PER_NUMBER * numbers
    cost = Cost(IDENTIFICATION_TIME + IDENTIFICATION_TIME_PER_NUMBER * rows * n, memory)
    cost.require(f"{rows} rows of {n} joints", REMEDY, say)


def require_diagnosable(recordings: Sequence[Recording], say: Callable[[str], None]) -> None:
    """Announce a long diagnosis, or refuse one.

    Args:
        recordings: All recordings.
        say: Function that shows a line to the user.

    Raises:
        UnusableInput: It needs more memory or time than this machine offers.
    """
    rows, n = float(sum(map(len, recordings))), len(recordings[0].joints)
    memory = DIAGNOSIS_MEMORY + rows * (DIAGNOSIS_BYTES[0] * n + DIAGNOSIS_BYTES[1] * n**2)
    time_per_row = DIAGNOSIS_TIME_PER_ROW[0] * n + DIAGNOSIS_TIME_PER_ROW[1] * n**2
    cost = Cost(DIAGNOSIS_TIME + rows * time_per_row, memory)
    cost.require(f"{rows:.0f} rows of {n} joints", REMEDY, say)
