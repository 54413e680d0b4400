"""Predictions along a recording as a table."""

from __future__ import annotations

import csv
import io
import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .._system.output_files import output_files
from .._types import FloatArray
from ..errors import ExciteWarning
from ..identification.lowpass import settling_time
from ..identification.standstill import STANDSTILL_SPEED_RATIO
from ..payload.static import QUANTIZATION_RANGE, REST_RANGE
from ..recordings import Recording
from ..recordings.remark import shown_time


@dataclass(frozen=True)
class PredictedTable(ABC):
    """A prediction that is saved as one CSV file.

    Attributes:
        inputs: Files that it was computed from, which `save` does not replace.
    """

    inputs: tuple[Path, ...] = field(default=(), repr=False, kw_only=True)

    @abstractmethod
    def csv(self) -> str:
        """Return the table as CSV."""

    def save(self, path: str | Path) -> Path:
        """Write the table as CSV; return its path.

        Raises:
            UnusableInput: The file cannot be written, or is among `inputs`.
        """
        path = Path(path)
        return output_files(path, inputs=self.inputs).replace({path.name: self.csv()})[0]


def csv_text(columns: Sequence[str], time: FloatArray, values: FloatArray) -> str:
    """Return a table as CSV.

    Args:
        columns: Names of the columns after the time.
        time: Times. Shape (N,) [s].
        values: Values. Shape (N, k).
    """
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerow(["t", *columns])
    formats = ["%s", *["%.9g"] * len(columns)]  # %s: as many digits as the time has
    np.savetxt(stream, np.column_stack([time, values]), fmt=formats, delimiter=",")
    return stream.getvalue()


def warn_of_unsettled_ends(recording: Recording, hertz: float) -> None:
    """Warn where a recording, or a gap-free stretch of it, begins or ends in motion.

    The filter continues it there by reflection, which takes accelerations to be 0 at the ends.

    Args:
        recording: The recording.
        hertz: Cutoff frequency of the prediction [Hz].
    """
    times = list[float]()
    for stretch in recording.segments():
        rows = int(np.clip(stretch.rate / (2.0 * hertz), 1, len(stretch) - 1))
        travel = np.abs(stretch.q[rows:] - stretch.q[:-rows])
        least = np.maximum(
            STANDSTILL_SPEED_RATIO * travel.max(axis=0),
            QUANTIZATION_RANGE * recording.quantization_noise,
        )
        moves = (travel > least) & (np.ptp(stretch.q, axis=0) > REST_RANGE)
        times += [float(stretch.t[end]) for end in (0, -1) if moves[end].any()]
    if times:
        shown = ", ".join(shown_time(time) for time in times[:2])
        more = f" and {len(times) - 2} more times" if len(times) > 2 else ""
        warnings.warn(
            f"{recording.source}: begins or ends in motion at {shown} s{more}; the prediction "
            f"is inaccurate within {settling_time(hertz):.2g} s of there, where the low-pass "
            "filter has not settled; leave these rows out, or record from rest to rest",
            ExciteWarning,
            stacklevel=3,
        )
