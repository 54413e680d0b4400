"""CSV files, block by block: columns `q.<joint>`, … or those of Universal Robots' recorders.

ur_rtde separates cells by commas, Universal Robots' own client by blanks.

Numbers are parsed by SciPy's Matrix Market reader (fast_float inside), which is twice as fast as
`np.loadtxt`: 10⁶ rows of 20 columns take 3 to 4 s (`python scripts/bench_csv.py`). That reader
ignores the part of a cell that it does not understand, "2024-01-02" is 2024. The grammar of the
text is therefore checked first on whole arrays; other text goes to `np.loadtxt`, which accepts more
(nan, quotes, blanks, text in columns that are not read) and reports the place of a faulty cell.
"""

from __future__ import annotations

import contextlib
import csv
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import Block
from .column_names import find_columns

CHUNK_SIZE = 1 << 23
"""Part of a file that is parsed at once [bytes]."""
SEPARATORS = (",", ";", "\t", " ")
"""Separators of cells, in the order in which a header is searched for them."""
MAX_LINE = 1 << 20
"""Longest line of a file, its header included [bytes]: 10,000 columns of 100 bytes."""

_DIGIT, _SEPARATOR, _POINT, _EXPONENT, _SIGN, _OTHER = 0, 1, 2, 3, 4, 255
_CLASSES = np.full(256, _OTHER, np.uint8)
"""Class of each byte in the grammar of plain numbers. Shape (256,)."""
_CLASSES[list(b"0123456789")] = _DIGIT
_CLASSES[list(b",\n")] = _SEPARATOR
_CLASSES[ord(".")] = _POINT
_CLASSES[list(b"eE")] = _EXPONENT
_CLASSES[list(b"+-")] = _SIGN


def read_blocks(path: Path, robot: Robot) -> Iterator[Block]:
    """Read a CSV file whose first row names the columns.

    Args:
        path: File with cells separated by commas, semicolons, tabs or blanks.
        robot: Robot whose joints are recorded.

    Yields:
        Consecutive rows, CHUNK_SIZE bytes of text at a time.

    Raises:
        UnusableInput: The header lacks a column of the robot, or a cell is no number.
    """
    with path.open("rb") as stream:
        separator, header = _read_header(path, stream.readline(MAX_LINE))
        layout = find_columns(str(path), header, robot)
        columns = [header.index(name) for name in layout.names]
        row, remainder = 2, b""
        while chunk := stream.read(CHUNK_SIZE):
            text, newline, remainder = (remainder + chunk).rpartition(b"\n")
            if len(remainder) > MAX_LINE:
                raise UnusableInput(
                    f"{path}: after row {row + text.count(newline or b' ')}: a line is longer than "
                    f"{MAX_LINE} bytes; give a CSV"
                )
            if newline:
                lines = text + newline
                yield layout.block(_parse_rows(path, lines, separator, header, columns, row))
                row += text.count(b"\n") + 1
        if remainder.strip():
            yield layout.block(_parse_rows(path, remainder, separator, header, columns, row))


def _read_header(path: Path, line: bytes) -> tuple[str, list[str]]:
    """Find the separator of a file and the names in its first line."""
    if b"\r" in line.removesuffix(b"\n").removesuffix(b"\r"):
        raise UnusableInput(
            f"{path}: row 1: its line ends in a carriage return alone; save it with line ends LF "
            "or CR LF"
        )
    if len(line) == MAX_LINE:
        raise UnusableInput(
            f"{path}: row 1 is longer than {MAX_LINE} bytes; give a CSV with a header t,q.<joint>,…"
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


def _parse_rows(
    path: Path,
    text: bytes,
    separator: str,
    header: Sequence[str],
    columns: Sequence[int],
    first_row: int,
) -> FloatArray:
    """Parse lines; raise UnusableInput that names the row of a faulty cell."""
    try:
        return parse_numbers(text, separator, len(header), columns)
    except ValueError as error:
        match = re.search(r"^(.*?)[ ;]*at row (\d+), column (\d+)", str(error))
        place = f"row {first_row + int(match[2])}" if match else f"after row {first_row - 1}"
        reason = match[1] if match else str(error)
        raise UnusableInput(
            f"{path}: {place}: {reason}; each row should hold {len(header)} numbers, empty where "
            "none was measured"
        ) from error


def parse_numbers(text: bytes, separator: str, width: int, columns: Sequence[int]) -> FloatArray:
    """Parse columns of complete lines.

    Args:
        text: The lines.
        separator: ",", ";" (commas are then decimal points), a tab, or " " for any blanks.
        width: Number of cells in a line.
        columns: Indices of the columns to return.

    Returns:
        Numbers, NaN for empty cells. Shape (lines, len(columns)).

    Raises:
        ValueError: A cell is no number or a line has another number of cells; the message ends in
            "at row R, column C", counted from 0.
    """
    if separator == ";":
        text = text.replace(b",", b".").replace(b";", b",")
    elif separator == "\t":
        text = text.replace(b"\t", b",")
    elif separator == " ":
        text = re.sub(rb"[ \t]+", b",", re.sub(rb"(?m)^[ \t]+|[ \t]+\r?$", b"", text))
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n")
    text = text if text.endswith(b"\n") else text + b"\n"
    if is_plain(text, width):
        # a cell such as "-" or "." fails here; the tolerant parser reports its place
        with contextlib.suppress(ValueError):
            return _parse_plain(text, width)[:, list(columns)]
    return _parse_tolerant(text, width, columns)


def is_plain(text: bytes, width: int) -> bool:
    """Return True if each line is `width` cells of [sign] digits [. digits] [e [sign] digits].

    Args:
        text: Lines with commas as separators that end in a newline.
        width: Number of cells in a line.
    """
    body = np.frombuffer(text, np.uint8)
    classes = _CLASSES[body]
    if not _has_plain_signs(body, classes):
        return False
    exponents = np.flatnonzero(classes == _EXPONENT)
    first, second = (classes.take(exponents + k, mode="clip") for k in (1, 2))
    if not ((first == _DIGIT) | ((first == _SIGN) & (second == _DIGIT))).all():
        return False  # SciPy's reader takes "1e" for 1
    marks = np.flatnonzero((classes != _DIGIT) & (classes != _SIGN))
    order = classes[marks]
    if order.max() > _EXPONENT:
        return False
    following, preceding = order[1:], order[:-1]
    if ((following == _POINT) & (preceding != _SEPARATOR)).any() or (
        (following == _EXPONENT) & (preceding == _EXPONENT)
    ).any():
        return False
    ends = body[marks[order == _SEPARATOR]]
    if len(ends) % width:
        return False
    ends = ends.reshape(-1, width)
    is_empty = np.diff(marks[order == _SEPARATOR], prepend=-1) < 2
    return not is_empty.any() and bool(
        (ends[:, -1] == ord("\n")).all() and (ends[:, :-1] == ord(",")).all()
    )


def _has_plain_signs(body: NDArray[np.uint8], classes: NDArray[np.uint8]) -> bool:
    """Return True if signs begin a number or an exponent, and a digit follows each leading "+"."""
    signs = np.flatnonzero(classes == _SIGN)
    before = classes[signs - 1]  # of a sign at the beginning: the last byte, a newline
    if not ((before == _SEPARATOR) | (before == _EXPONENT)).all():
        return False
    plus = signs[(before == _SEPARATOR) & (body[signs] == ord("+"))]
    return bool((classes.take(plus + 1, mode="clip") == _DIGIT).all())


def _parse_plain(text: bytes, width: int) -> FloatArray:
    """Parse text of which `is_plain` is true. Shape (lines, width)."""
    from scipy.io import mmread  # slow to import

    # an array in that format is written column by column: our rows are its columns
    header = b"%%%%MatrixMarket matrix array real general\n%d %d\n" % (width, text.count(b"\n"))
    lines = text.replace(b",", b"\n")
    if b"\n+" in lines or lines.startswith(b"+"):  # fast_float reads no leading "+"
        lines = lines.removeprefix(b"+").replace(b"\n+", b"\n")
    table: FloatArray = mmread(io.BytesIO(header + lines))
    return table.T


def _parse_tolerant(text: bytes, width: int, columns: Sequence[int]) -> FloatArray:
    """Parse any text that `np.loadtxt` can read. Shape (lines, len(columns))."""
    lines = [line for line in text.decode("utf-8").split("\n") if line.strip()]
    for number, line in enumerate(lines):
        if '"' not in line and line.count(",") != width - 1:
            raise ValueError(
                f"{line.count(',') + 1} cells instead of {width} at row {number}, column 0"
            )
    if any(",," in line or line.startswith(",") or line.endswith(",") for line in lines):
        lines = [",".join(cell.strip() or "nan" for cell in line.split(",")) for line in lines]
    if not lines:
        return np.empty((0, len(columns)))
    return np.loadtxt(
        lines, delimiter=",", comments=None, quotechar='"', usecols=list(columns), ndmin=2
    )
