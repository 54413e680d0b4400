"""CSV: the contract's and Universal Robots' (ur_rtde's commas, UR's own client's blanks), block by
block."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path

from ..errors import UnusableInput
from ..robot.robot import Robot
from . import csv_parse
from .block import Block
from .column_names import layout

CHUNK = 1 << 23
"""Bytes parsed at once."""
SEPARATORS = (",", ";", "\t", " ")
LONGEST_LINE = 1 << 20
"""Longest line of a file, its header included [bytes]: 10,000 columns of 100 bytes."""


def blocks(path: Path, robot: Robot) -> Iterator[Block]:
    """Blocks of a CSV whose first row names the columns, separated by commas, semicolons, tabs or
    blanks.

    Raises UnusableInput for a header without the robot's columns and for a cell that is no number,
    by row and column.
    """
    with path.open("rb") as stream:
        separator, header = _header(path, stream.readline(LONGEST_LINE))
        places = layout(str(path), header, robot)
        columns = [header.index(name) for name in places.names]
        row, rest = 2, b""
        while chunk := stream.read(CHUNK):
            text, newline, rest = (rest + chunk).rpartition(b"\n")
            if len(rest) > LONGEST_LINE:
                raise UnusableInput(
                    f"{path}: after row {row + text.count(newline or b' ')}: a line is longer than "
                    f"{LONGEST_LINE} bytes; give a CSV"
                )
            if newline:
                yield places.block(_parsed(path, text + newline, separator, header, columns, row))
                row += text.count(b"\n") + 1
        if rest.strip():
            yield places.block(_parsed(path, rest, separator, header, columns, row))


def _header(path: Path, line: bytes) -> tuple[str, list[str]]:
    """The separator of a file and the names in its first line."""
    if b"\r" in line.removesuffix(b"\n").removesuffix(b"\r"):
        raise UnusableInput(
            f"{path}: row 1: its line ends in a carriage return alone; save it with line ends LF "
            "or CR LF"
        )
    if len(line) == LONGEST_LINE:
        raise UnusableInput(
            f"{path}: row 1 is longer than {LONGEST_LINE} bytes; give a CSV with a header "
            "t,q.<joint>,…"
        )
    try:
        text = line.decode("utf-8-sig").strip().lstrip("#").strip()
    except UnicodeDecodeError as error:
        raise UnusableInput(
            f"{path}: is no UTF-8 text; give a CSV in UTF-8 with a header t,q.<joint>,…, an .npz, "
            "a rosbag2 folder or an .mcap"
        ) from error
    separator = next((s for s in SEPARATORS if s in text), ",")
    if separator == " ":
        return separator, [cell.strip('"') for cell in text.split()]
    try:
        cells = next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    except csv.Error as error:
        raise UnusableInput(
            f"{path}: its header cannot be read ({error}); the first row should name the columns"
        ) from error
    return separator, [cell.strip() for cell in cells]


def _parsed(
    path: Path, text: bytes, separator: str, header: list[str], columns: list[int], row: int
) -> csv_parse.Array:
    try:
        return csv_parse.rows(text, separator, len(header), columns)
    except ValueError as error:
        found = re.search(r"^(.*?)[ ;]*at row (\d+), column (\d+)", str(error))
        where = f"row {row + int(found[2])}" if found else f"after row {row - 1}"
        reason = found[1] if found else str(error)
        raise UnusableInput(
            f"{path}: {where}: {reason}; each row should hold {len(header)} numbers, empty where "
            "none was measured"
        ) from error
