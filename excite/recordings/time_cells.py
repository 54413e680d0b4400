"""Times of a CSV file that are dates, or counts of another unit since 1970."""

from __future__ import annotations

import csv
import re
from datetime import UTC, datetime
from pathlib import Path

from ..errors import UnusableInput

DATE = re.compile(
    r"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}(:\d{2}([.,]\d+)?)?(Z|[+-]\d{2}(:?\d{2}(:?\d{2})?)?)?", re.I
)
"""Date with the time of day as in ISO 8601, as `2025-03-30T00:59:55.008+02:00`."""
EPOCH_UNITS = (("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9))
"""Units of a time since 1970, and their lengths [s]."""
EPOCH_RANGE = (1e9, 1e10)
"""Seconds since 1970 that are taken for a date, of the years 2001 to 2286 [s]. A count of another
unit that is in this range after its conversion is in that unit: as seconds, it would be a date
after the year 30,000."""


def epoch_unit(time: float) -> tuple[str, float] | None:
    """Return unit and length [s] of a time that counts ms, µs or ns since 1970; None of others."""
    for unit, length in EPOCH_UNITS:
        if EPOCH_RANGE[0] <= time * length < EPOCH_RANGE[1]:
            return unit, length
    return None


class DateColumn:
    """A column of dates, which are rewritten as seconds since the first.

    Dates without a time zone are taken as they are.

    Args:
        path: File, for messages.
        separator: Separator of its cells.
        place: Index of the column.
    """

    def __init__(self, path: Path, separator: str, place: int) -> None:
        self.path, self.separator, self.place = path, separator, place
        self.first: datetime | None = None

    def rewrite(self, text: bytes, first_row: int) -> bytes:
        """Return lines with seconds in place of dates; those without a date are not changed.

        Args:
            text: Lines.
            first_row: Number of the first of them, for messages.

        Raises:
            UnusableInput: A date cannot be read, or only some of them have a time zone.
        """
        lines = text.decode("utf-8", "surrogateescape").split("\n")
        for k, line in enumerate(lines):
            cells = self._split(line)
            if self.place < len(cells) and DATE.fullmatch(stamp := cells[self.place].strip('" \r')):
                cells[self.place] = f"{self._seconds(stamp, first_row + k):.6f}"
                lines[k] = self.separator.join(cells)
        return "\n".join(lines).encode("utf-8", "surrogateescape")

    def _split(self, line: str) -> list[str]:
        """Return the cells up to that of the date, and the remainder of the line."""
        if self.separator == " ":
            return line.split(None, self.place + 1)
        if '"' not in line:
            return line.split(self.separator, self.place + 1)
        cells = next(csv.reader([line.rstrip("\r")], delimiter=self.separator), [])
        return [f'"{cell}"' if self.separator in cell else cell for cell in cells]

    def _seconds(self, stamp: str, row: int) -> float:
        """Return the time since the first date [s]."""
        try:
            date = datetime.fromisoformat(stamp.upper())
            if self.first is None:
                self.first = date
            return (date - self.first).total_seconds()
        except ValueError as error:
            raise UnusableInput(
                f"{self.path}: row {row}: '{stamp}' is no date ({error}); write the time in seconds"
            ) from error
        except TypeError as error:
            raise UnusableInput(
                f"{self.path}: row {row}: '{stamp}' has a time zone and the dates above have none, "
                "or the other way round; write all of them in the same way"
            ) from error

    def remark(self) -> str:
        """Return the text of a remark on the origin of the times."""
        first = self.first
        assert first is not None
        zone = "" if first.tzinfo is None else " UTC"
        moment = first if first.tzinfo is None else first.astimezone(UTC).replace(tzinfo=None)
        return f"its times are dates; they count in seconds from the first, {moment}{zone}"
