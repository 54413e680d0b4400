"""Predictions along a recording as a table."""

from __future__ import annotations

import csv
import io
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .._system.output_files import output_files
from .._types import FloatArray


class PredictedTable(ABC):
    """A prediction that is saved as one CSV file."""

    @abstractmethod
    def csv(self) -> str:
        """Return the table as CSV."""

    def save(self, path: str | Path) -> Path:
        """Write the table as CSV; return its path.

        Raises:
            UnusableInput: The file cannot be written.
        """
        path = Path(path)
        return output_files(path).replace({path.name: self.csv()})[0]


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
