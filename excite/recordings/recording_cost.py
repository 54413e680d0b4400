"""Time and memory that recordings of N rows, T seconds and n joints need, estimated in advance.

    reading and identification:  130 MB + 76 bytes · N (1 + n · quantities),  3 s + 1.2 µs · N n
    diagnosis:                   200 MB + T (0.6 n + 0.18 n²) MB + 0.4 kB · N n,
                                 3 s + T (0.015 n + 0.0027 n²)

The coefficients of identification were measured by `scripts/bench_scale.py` with 10⁵ and 10⁶ rows
of robots with two and six joints, sampled at 1 kHz; those of a diagnosis, which computes most below
the cutoff frequency, with 15,000 to 200,000 rows and 50 to 390 s of robots with one to seven
joints: memory within 20 % of 0.26 to 4.7 GB, time within 60 % of 3 to 90 s.
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
"""Memory of a diagnosis that does not depend on its recordings [bytes]."""
DIAGNOSIS_BYTES_PER_SECOND = (6e5, 1.8e5)
"""Memory of a diagnosis per second that is recorded: coefficients of n and n² [bytes/s]."""
DIAGNOSIS_BYTES_PER_NUMBER = 400.0
"""Memory of a diagnosis per row and joint [bytes]."""
DIAGNOSIS_TIME = 3.0
"""Time of a diagnosis that does not depend on its recordings [s]."""
DIAGNOSIS_TIME_PER_SECOND = (0.015, 0.0027)
"""Time of a diagnosis per second that is recorded: coefficients of n and n² [1]."""
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
    rows, n = sum(map(len, recordings)), len(recordings[0].joints)
    recorded = sum(float(recording.t[-1] - recording.t[0]) for recording in recordings)

    def in_total(per_second: tuple[float, float]) -> float:
        return recorded * (per_second[0] * n + per_second[1] * n**2)

    memory = in_total(DIAGNOSIS_BYTES_PER_SECOND) + DIAGNOSIS_BYTES_PER_NUMBER * rows * n
    seconds = DIAGNOSIS_TIME + in_total(DIAGNOSIS_TIME_PER_SECOND)
    cost = Cost(seconds, DIAGNOSIS_MEMORY + memory)
    cost.require(f"{recorded:.0f} s of {n} joints", "give fewer or shorter recordings", say)
