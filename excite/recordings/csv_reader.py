"""CSV files, block by block: columns `q.<joint>`, …, or those of other programs' recorders
(`export_formats`, Universal Robots' RTDE).

ur_rtde separates cells by commas, Universal Robots' own client by blanks.

Numbers are parsed by SciPy's Matrix Market reader (fast_float inside), which is twice as fast as
`np.loadtxt`: 10⁶ rows of 20 columns take 3 to 4 s (`python scripts/bench_csv.py`). That reader
ignores the part of a cell that it does not understand, "2024-01-02" is 2024. The grammar of the
text is therefore checked first on whole arrays; other text goes to `np.loadtxt`, which accepts more
(nan, quotes, blanks, text in columns that are not read) and reports the place of a faulty cell.
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import dataclasses
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import Block
from .column_names import ColumnLayout, find_columns, numbered_remarks
from .export_formats import Header, recognise
from .long_tables import LongColumns, find_long_columns, pivot
from .magnitudes import check_cells
from .remark import Remark, RemarkKind
from .spelled_columns import OTHER_UNITS, SPELLINGS
from .text_file import open_text
from .time_cells import DATE, DateColumn, epoch_unit

CHUNK_SIZE = 1 << 23
"""Part of a file that is parsed at once [bytes]."""
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "blanks"}
"""Separators of cells, in the order in which a header is searched for them, and their names."""
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


HEAD_SIZE = 1 << 16
"""Part of a file behind its header by which its form is recognised [bytes]."""
COMMENTS = (b"#", b"//", b"%")
"""First characters of comments."""
COMMENTED_HEADER = re.compile(r"\A(?:#+|%\s)\s*")
"""Sign of a comment in front of the names of columns; `%time` is a name of rostopic."""
MIN_EMPTY_SHARE = 0.1
"""Share of rows without any quantity of the robot from which they are those of another topic, in a
table that merges several [1]; fewer are missing values."""
MAX_EPOCH_STEP = 0.1
"""Usual time step from which a time of the size of one since 1970 is none [s]: microseconds of a
controller that has run for 12 days have that of milliseconds since 1970, with steps 1000 times as
long. No motion is recorded with ten rows a second."""
SI_UNITS = frozenset(("s", "sec", "n.m", "n-m", *SPELLINGS))
"""Units in a row below the header that need no conversion, in small letters."""
NO_UNITS = frozenset(("-", "none", "n/a"))
"""Cells of such a row that name no unit."""
CONVERTED_UNITS = frozenset(("ms", "us", "µs", "ns", "%", *OTHER_UNITS))
"""Units in a row below the header that have to be converted, in small letters."""
UNIT_CELL = re.compile(r"[^0-9+.\-].{0,15}|-")
"""Cell that may name a unit: no number."""
NAME_CELL = re.compile(r"[^\W\d][\w ./-]*")
"""Cell that may be the name of a column."""
SEPARATOR_LINE = re.compile(rb"sep=.\r?\n", re.IGNORECASE)
"""First line by which spreadsheets state the separator of cells."""
MISSING_CELL = re.compile(
    r'(?im)(?<![^,\n])[ \t]*(?:"[ \t]*"|"?(?:n/?a|#n/a|null|none|missing|-{1,3}|\?'
    r'|[+-]?1\.#(?:qnan|snan|ind)0*|[+-]?nan\(s?(?:nan|ind)\))"?)[ \t]*(?![^,\n])'
)
"""Cell that says that nothing was measured; the last two are those of Microsoft's C library."""
DECIMAL_COMMA = re.compile(r"'[+-]?\d+,\d+'")
"""Number with one comma in the message of a parser."""
BLANK_CELL = re.compile(r"(?:^|,)\s*(?:,|$)")
"""Cell without a value in a line."""
WHOLE_CELL = re.compile(r"\s*[+-]?\d+\s*")
"""Cell that holds a whole number, as either part of a number with a decimal comma."""
GROUPED = re.compile(r"(['\"])[+-]?\d{1,3}(?:[.,' ]\d{3})+(?:[.,]\d*)?\1")
"""Number in the message of a parser that may have separators of thousands."""
THOUSANDS = re.compile(
    rb"(?m)(?:^|[;\t])[ \"]*[+-]?[1-9]\d{0,2}((?:,\d{3})+)(?:\.\d*)?[ \"]*(?=$|[;\t\r])"
)
"""Cell with commas between thousands."""
POINT_CELL = re.compile(rb"(?m)(?:^|[;\t])[ \"]*[+-]?\d+\.\d+(?:[eE][+-]?\d+)?[ \"]*(?=$|[;\t\r])")
"""Cell that is a number with a decimal point."""
DATE_CELL = re.compile(
    r"'\s*(?:\d{4}[-/]\d{1,2}[-/]\d{1,2}|\d{1,2}[./]\d{1,2}[./]\d{4}|\d{1,2}:\d{2}:)"
)
"""Date or time of day in the message of a parser."""


def read_column_names(path: Path) -> list[str]:
    """Read the names in the header of a CSV file.

    Raises:
        UnusableInput: It is no text, or its header cannot be read.
    """
    with open_text(path) as stream:
        line, _ = _skip_comments(stream)
        return _read_header(path, line, stream.readline(MAX_LINE))[1]


def read_blocks(
    path: Path,
    robot: Robot,
    columns: Mapping[str, str] = MappingProxyType({}),
    topic: str | None = None,
    *,
    effort: str = "tau",
    floating: bool = False,
) -> Iterator[Block]:
    """Read a CSV file whose first row names the columns.

    Args:
        path: File with cells separated by commas, semicolons, tabs or blanks.
        robot: Robot whose joints are recorded.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in the file.
        topic: Topic of PlotJuggler's columns to use; None: there is one of the robot's joints.
        effort: Prefix of the efforts of JointState messages, "tau" for torque or "i" for current.
        floating: True if the columns of a floating base are wanted; see `floating_signals`.

    Yields:
        Consecutive rows, CHUNK_SIZE bytes of text at a time.

    Raises:
        UnusableInput: The header lacks a column of the robot, or a cell is no number.
    """
    with open_text(path) as stream:
        line, row = _skip_comments(stream)
        behind = stream.tell()
        first_line = stream.readline(MAX_LINE)
        separator, with_unnamed = _read_header(path, line, first_line)
        cells = _without_empty_end(with_unnamed)
        first_row = _without_empty_end(_cells(separator, first_line))
        if _is_row_of_units(path, row + 1, cells, first_row):
            behind, row = stream.tell(), row + 1
            first_line = stream.readline(MAX_LINE)
            first_row = _without_empty_end(_cells(separator, first_line))
        _require_one_row_of_names(path, row + 1, cells, first_row)
        long = None
        if set(columns) <= {"t"}:
            names = ["t" if name == columns.get("t") else name for name in cells]
            rows_of_head = _first_rows(stream, separator, first_line)
            long = find_long_columns(str(path), names, rows_of_head, robot, separator, effort)
        if long is not None:
            stream.seek(behind)
            rows = _LongTable(path, separator, long, row + 1)
            rows.header_line = line.rstrip(b"\r\n")
            yield rows.block_of(stream, robot, effort)
            return
        header = recognise(str(path), cells, first_row, robot, columns, separator, topic, effort)
        unnamed = len(with_unnamed) - len(cells)
        _require_names(path, header.names, robot, separator, unnamed)
        if header.has_line:
            _require_separator(path, row + 1, separator, cells, first_line)
        stream.seek(behind if header.has_line else 0)
        layout = find_columns(
            str(path),
            header.names,
            robot,
            header.time,
            from_first=header.from_first,
            floating=floating,
        )
        table = _Table(path, separator, header, layout, unnamed)
        table.header_line = line.rstrip(b"\r\n") if header.has_line else None
        table.remarks += (*_planned(cells, robot), *numbered_remarks(header.numbered, robot))
        table.row = row + 1 if header.has_line else 1
        if b'"' not in first_line and not first_line.startswith(COMMENTS):
            table.separators = first_line.count(separator.encode())
        yield from map(table.block, table.parts(stream))


class _Table:
    """The rows of a file, chunk by chunk.

    Attributes:
        unnamed: Number of columns without a name behind the others.
        header_line: The line with the names; None: there is none.
        separators: Number of separators in the first row, if it has no quotes.
        width: Number of cells in a row of the file.
        may_be_shorter: True if a row may have fewer.
        row: Number of the next row in the file, as users count.
        remarks: Remarks that the next block carries.
    """

    def __init__(
        self, path: Path, separator: str, header: Header, layout: ColumnLayout, unnamed: int
    ) -> None:
        self.path, self.separator, self.header, self.layout = path, separator, header, layout
        self.unnamed = unnamed
        self.places = [header.names.index(name) for name in layout.names]
        self.header_line: bytes | None = None
        self.origin: FloatArray | None = None
        self.dates: DateColumn | None = None
        self.has_times = False
        self.separators = 0
        self.width, self.may_be_shorter = len(header.names), header.rewrite is not None
        self.row = 1
        self.remarks: tuple[Remark, ...] = ()
        self.remarked: set[str] = set()

    def parts(self, stream: BinaryIO) -> Iterator[bytes]:
        """Yield the complete lines of a stream, CHUNK_SIZE bytes at a time."""
        remainder = b""
        while chunk := stream.read(CHUNK_SIZE):
            text, newline, remainder = (remainder + chunk).rpartition(b"\n")
            if len(remainder) > MAX_LINE:
                raise UnusableInput(
                    f"{self.path}: after row {self.row + text.count(newline or b' ')}: a line is "
                    f"longer than {MAX_LINE} bytes; give a CSV"
                )
            if newline:
                yield text + newline
        if remainder.strip():
            yield self._last_line(remainder)

    def block(self, text: bytes) -> Block:
        """Parse complete lines."""
        first, table = self.row, self.numbers(text)
        block = self.layout.block(table, self.origin)
        out = dataclasses.replace(block, remarks=self.remarks, row=first)
        self.remarks = ()
        return out

    def numbers(self, text: bytes) -> FloatArray:
        """Parse complete lines. Shape (rows, columns of the layout)."""
        count = text.count(b"\n")
        text = self._without_comments(self._without_repeated_headers(text))
        if self.header.rewrite is not None:
            text, left_out = self.header.rewrite(text)
            if left_out:
                self._remark(f"{left_out} rows that lack some of the robot's joints are left out")
        text = self._without_dates(text)
        table = _parse_rows(
            self.path,
            text,
            self.separator,
            len(self.header.names),
            self.places,
            self.row,
            self.unnamed,
        )
        self.row += count
        table = self._without_empty_rows(table)
        times = len(self.layout.time_factors)
        clock = table[np.isfinite(table[:, :times]).all(axis=1), :times]
        if len(clock) and not self.has_times:
            self.has_times = True
            self._find_epoch(clock)
            self.origin = clock[0].copy() if self.layout.from_first else None
        return table

    def _last_line(self, line: bytes) -> bytes:
        """Return a last line that does not end in a newline; it may be cut short."""
        missing = len(_cells(self.separator, line)) < self.width
        if self.separator != " " and b'"' not in line:  # the separator at the end of lines as well
            missing |= line.count(self.separator.encode()) < self.separators
        if missing and not self._is_comment(line) and not self.may_be_shorter:
            self._remark(f"row {self.row}, the last one, is cut short and left out")
            return b""
        return line + b"\n"

    def _without_repeated_headers(self, text: bytes) -> bytes:
        """Lines without those that repeat the header, as where a log was continued."""
        if self.header_line is None or self.header_line not in text:
            return text
        lines = text.split(b"\n")
        kept = [line for line in lines if line.rstrip(b"\r") != self.header_line]
        if len(kept) < len(lines):
            self._remark(f"{len(lines) - len(kept)} rows that repeat the header are left out")
        return b"\n".join(kept)

    def _without_dates(self, text: bytes) -> bytes:
        """Text with seconds in place of dates, if the time in the first row is one."""
        dates, place = self.dates, self.places[0]
        if dates is None and not self.has_times and len(self.layout.time_factors) == 1:
            first = next((line for line in text.split(b"\n") if line.strip()), b"")
            cells = _cells(self.separator, first)
            if place < len(cells) and DATE.fullmatch(cells[place].strip()):
                self.dates = dates = DateColumn(self.path, self.separator, place)
                # whatever unit the name of the column states, dates are rewritten in seconds
                self.layout = dataclasses.replace(self.layout, time_factors=(1.0,))
        if dates is None:
            return text
        is_first = dates.first is None
        text = dates.rewrite(text, self.row)
        if is_first and dates.first is not None:
            self.remarks += (Remark(RemarkKind.CLOCK, dates.remark(), repaired=True),)
        return text

    def _find_epoch(self, clock: FloatArray) -> None:
        """Find out from the first times whether they count another unit than seconds since 1970."""
        epoch = epoch_unit(float(np.median(clock[:, 0])))
        if epoch is None or self.layout.time_factors != (1.0,):
            return
        unit, length = epoch
        steps = np.diff(clock[:, 0])
        if len(steps) and float(np.median(steps)) * length >= MAX_EPOCH_STEP:
            return  # a shorter unit since the start of a controller
        self.layout = dataclasses.replace(self.layout, time_factors=(length,), from_first=True)
        text = f"its times count {unit} since 1970, by their size; they are converted to s from "
        text += "the first row"
        self.remarks += (Remark(RemarkKind.CLOCK, text, repaired=True),)

    def _without_comments(self, text: bytes) -> bytes:
        """Text in which lines of comments are empty, so that rows keep their numbers."""
        if not any(text.startswith(sign) or b"\n" + sign in text for sign in COMMENTS):
            return text
        lines = text.split(b"\n")
        kept = [b"" if self._is_comment(line) else line for line in lines]
        if kept == lines:
            return text
        self._remark("comments below the names of the columns are left out")
        return b"\n".join(kept)

    def _is_comment(self, line: bytes) -> bool:
        """Return True for a comment, and no row whose first cell is a text that is not read."""
        if not line.startswith(COMMENTS):
            return False
        widths = self.width, self.width + self.unnamed
        return 0 in self.places or len(_cells(self.separator, line)) not in widths

    def _without_empty_rows(self, table: FloatArray) -> FloatArray:
        """Rows without those of other topics, which hold a time and no quantity of the robot."""
        is_empty = np.isnan(table[:, self.layout.recorded]).all(axis=1)
        if not len(table) or is_empty.mean() < MIN_EMPTY_SHARE:
            return table
        self._remark("rows without any quantity of the robot, as of other topics, are left out")
        return np.asarray(table[~is_empty])

    def _remark(self, text: str) -> None:
        """Add a remark about rows that were left out, once for each kind."""
        kind = text.lstrip("0123456789 ")
        if kind not in self.remarked:
            self.remarked.add(kind)
            self.remarks += (Remark(RemarkKind.SKIPPED, text, repaired=True),)


class _LongTable(_Table):
    """The rows of a long table, which are put together when all are read."""

    def __init__(self, path: Path, separator: str, long: LongColumns, row: int) -> None:
        header = Header(long.names, (("t", long.factor),), rewrite=long.rewrite)
        # values of one joint, whatever they are, and the code behind them
        places = tuple(("q", k) for k in range(len(long.values)))
        layout = ColumnLayout(long.names, places, len(places), (long.factor,))
        super().__init__(path, separator, header, layout, 0)
        self.long, self.row, long.row = long, row, row
        self.width, self.may_be_shorter = long.width, False

    def block_of(self, stream: BinaryIO, robot: Robot, effort: str) -> Block:
        """Read the rows of a stream and return them as a wide table."""
        tables, quantities = (
            list[FloatArray](),
            [f"value of {p or 'all'}" for p in self.long.values.values()],
        )
        for text in self.parts(stream):
            first, table = self.row, self.numbers(text)
            check_cells(
                str(self.path), table[:, 0], dict(zip(quantities, table.T[1:], strict=False)), first
            )
            tables.append(table)
        table = np.concatenate(tables) if tables else np.empty((0, len(self.long.names)))
        factor = self.layout.time_factors[0]
        t = factor * (table[:, 0] - (0.0 if self.origin is None else self.origin[0]))
        codes = table[:, -1].astype(int)
        wide = pivot(self.long, t, table[:, 1:-1], codes, robot, effort)
        layout = find_columns(str(self.path), wide.names, robot)
        block = layout.block(wide.table[:, [wide.names.index(name) for name in layout.names]])
        return dataclasses.replace(block, remarks=(*self.remarks, *wide.remarks))


def _skip_comments(stream: BinaryIO) -> tuple[bytes, int]:
    """Return the header's line and its number, below comments and empty lines.

    A header may be a comment itself: then the line below has as many cells and is none.
    """
    line, row = stream.readline(MAX_LINE).removeprefix(codecs.BOM_UTF8), 1
    if SEPARATOR_LINE.fullmatch(line):
        line, row = stream.readline(MAX_LINE), row + 1
    while line.isspace():
        line, row = stream.readline(MAX_LINE), row + 1
    while line.lstrip().startswith(COMMENTS) and not line.startswith(b"%time"):  # of rostopic
        place = stream.tell()
        following = stream.readline(MAX_LINE)
        is_data = bool(following.strip()) and not following.lstrip().startswith(COMMENTS)
        if not following or (is_data and _width(line) == _width(following)):
            stream.seek(place)
            break
        line, row = following, row + 1
        while line.isspace():
            line, row = stream.readline(MAX_LINE), row + 1
    return line, row


def _width(line: bytes) -> int:
    """Number of cells of a line, comment signs left out."""
    text = line.lstrip(b" #/%\t").strip()
    separator = next((s for s in SEPARATORS if s.encode() in text), ",")
    return len(_without_empty_end(_cells(separator, text)))


def _first_rows(stream: BinaryIO, separator: str, first_line: bytes) -> list[list[str]]:
    """Return the cells of the complete rows in the first part of a file, behind its header."""
    place, head = stream.tell(), stream.read(HEAD_SIZE)
    stream.seek(place)
    lines = [first_line, *head.splitlines()[: -1 if len(head) == HEAD_SIZE else None]]
    return [
        _cells(separator, line)
        for line in lines
        if line.strip() and not line.lstrip().startswith(COMMENTS)
    ]


def _without_empty_end(cells: Sequence[str]) -> list[str]:
    """Cells without the empty ones at the end, as behind a separator at the end of a line."""
    count = max((k + 1 for k, cell in enumerate(cells) if cell.strip()), default=0)
    return list(cells[:count])


def _is_row_of_units(path: Path, row: int, header: Sequence[str], cells: Sequence[str]) -> bool:
    """Return True if the line below the header, with that number, names SI units.

    Raises:
        UnusableInput: It names another unit, or an unknown one next to known ones.
    """
    units = [cell.strip().strip("[]()").strip().lower() for cell in cells]
    stated = [unit for unit in units if unit]
    known = [unit in SI_UNITS | CONVERTED_UNITS for unit in stated]
    if not any(known) or not all(UNIT_CELL.fullmatch(unit) for unit in stated):
        return False
    for name, unit in zip(header, units, strict=False):
        if unit in CONVERTED_UNITS:
            raise UnusableInput(
                f"{path}: row {row}: column '{name}' is in {unit}; convert it to SI units (s, rad, "
                f"rad/s, N m, A) and leave row {row} out"
            )
        if unit and unit not in SI_UNITS | NO_UNITS:
            raise UnusableInput(
                f"{path}: row {row}: the unit '{unit}' of column '{name}' is unknown; write one of "
                f"{', '.join(sorted(SI_UNITS))}, or leave row {row} out"
            )
    return True


def _require_one_row_of_names(
    path: Path, row: int, header: Sequence[str], cells: Sequence[str]
) -> None:
    """Check that the line below the header, with that number, is no second line of names.

    Tables with two levels of names have one, as of `pandas`: the quantities above the joints.
    """
    texts = [cell.strip() for cell in cells if cell.strip()]
    if len(texts) < 2 or len(cells) != len(header) or not all(map(NAME_CELL.fullmatch, texts)):
        return
    if all(map(MISSING_CELL.fullmatch, texts)) or any(map(_is_number, texts)):
        return
    first = next(k for k, name in enumerate(cells) if k and name.strip())
    raise UnusableInput(
        f"{path}: row {row}: it holds names and no numbers; join both rows of names to one "
        f"('{header[first]}' and '{cells[first].strip()}'), with the columns t,q.<joint>,…"
    )


def _cells(separator: str, line: bytes) -> list[str]:
    """Cells of a line of data; empty where it is no text."""
    try:
        text = line.decode("utf-8-sig").strip()
        return (
            text.split() if separator == " " else next(csv.reader([text], delimiter=separator), [])
        )
    except (UnicodeDecodeError, csv.Error):
        return []


def _planned(header: Sequence[str], robot: Robot) -> tuple[Remark, ...]:
    """Remark the `trajectory.csv` of a design: it alone holds planned accelerations."""
    quantities = ("q", "dq", "ddq", "tau")
    planned = ["t", *(f"{name}.{joint}" for name in quantities for joint in robot.joints)]
    if list(header) != planned:
        return ()
    text = (
        "this is the planned motion of a design and no recording; its torque is that of the "
        "nominal model, which a fit to it returns"
    )
    return (Remark(RemarkKind.PLANNED, text, doubt=True),)


def _read_header(path: Path, line: bytes, following: bytes) -> tuple[str, list[str]]:
    """Find the separator of a file and the names in its first line.

    Args:
        path: The file, for messages.
        line: The line.
        following: The line below.

    Raises:
        UnusableInput: The line cannot be read.
    """
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
        text = COMMENTED_HEADER.sub("", line.decode("utf-8-sig").strip(), count=1)
    except UnicodeDecodeError as error:
        raise UnusableInput(
            f"{path}: is no UTF-8 text; give a CSV in UTF-8 with a header t,q.<joint>,…, an .npz, "
            "a rosbag2 folder or an .mcap"
        ) from error
    separator = _separator(text, following)
    if separator == " ":
        return separator, [cell.strip('"') for cell in text.split()]
    try:
        cells = next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    except csv.Error as error:
        raise UnusableInput(
            f"{path}: its header cannot be read ({error}); the first row should name the columns"
        ) from error
    return separator, [cell.strip() for cell in cells]


def _separator(text: str, following: bytes) -> str:
    """Return the separator in a line of names: the first one in it, unless another fits the row.

    A name may contain `|`, or a comma in its unit, where blanks separate cells.

    Args:
        text: The line of names.
        following: The row below.
    """
    occurring = [separator for separator in SEPARATORS if separator in text]
    for separator in occurring:
        names = _without_empty_end(_cells(separator, text.encode()))
        cells = _without_empty_end(_cells(separator, following))
        if len(names) == len(cells) > 1 and (separator == occurring[0] or _is_number(cells[0])):
            return separator
    return occurring[0] if occurring else ","


def _require_names(
    path: Path, names: Sequence[str], robot: Robot, separator: str, unnamed: int
) -> None:
    """Check that the first row holds names: not only numbers, next to empty and missing cells."""
    cells = [name for name in names if name and not MISSING_CELL.fullmatch(name)]
    if not cells or not all(map(_is_number, cells)):
        return
    joint = robot.joints[0]
    example = separator.join(["t", f"q.{joint}", "…", f"tau.{joint}", "…"])
    raise UnusableInput(
        f"{path}: its first row holds numbers, no names; put the names of its "
        f"{len(names) + unnamed} columns above it, or in its place if it numbers the columns: "
        f"{example} (separated by {SEPARATORS[separator]})"
    )


def _require_separator(
    path: Path, row: int, separator: str, names: Sequence[str], line: bytes
) -> None:
    """Check that the first row of data, with that number, has the separator of the names.

    Commas in it may be decimal points: `0,1;0,2` below `t,q.elbow`.
    """
    by_names = _without_empty_end(_cells(separator, line))
    if len(by_names) == len(names) or len(names) < 2:
        return
    for other, word in SEPARATORS.items():
        if other == separator:
            continue
        cells = _without_empty_end(_cells(other, line))
        are_numbers = all(
            not cell or (cell[-1] != "," and _is_number(cell.replace(",", "."))) for cell in cells
        )
        if len(cells) == len(names) and (are_numbers or len(by_names) <= 1):
            remedy = f"separate the names by {word}"
            if other == " " and b"," in line:  # between blanks, commas are no decimal points
                remedy = "separate names and cells by semicolons"
            raise UnusableInput(
                f"{path}: row {row}: its {len(names)} cells are separated by {word}, and the names "
                f"above by {SEPARATORS[separator]}; {remedy}"
            )


def _is_number(cell: str) -> bool:
    """Tell whether a cell is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _parse_rows(
    path: Path,
    text: bytes,
    separator: str,
    width: int,
    columns: Sequence[int],
    first_row: int,
    unnamed: int,
) -> FloatArray:
    """Parse lines; raise UnusableInput that names the row of a faulty cell."""
    try:
        return parse_numbers(text, separator, width, columns, unnamed)
    except ValueError as error:
        match = re.search(r"^(.*?)[ ;]*at row (\d+), column (\d+)", str(error))
        place = f"row {first_row + int(match[2])}" if match else f"after row {first_row - 1}"
        reason = match[1] if match else str(error)
        if GROUPED.search(reason):
            reason += " (if it has separators of thousands, remove them)"
        elif DECIMAL_COMMA.search(reason):
            reason += " (if its comma is a decimal point, write a point)"
        if DATE_CELL.search(reason):
            raise UnusableInput(
                f"{path}: {place}: {reason.split(' to float')[0]}, a date or a time of day; write "
                f"it in seconds or as 2025-03-30T01:59:55.008, each row should hold {width} numbers"
            ) from error
        raise UnusableInput(
            f"{path}: {place}: {reason}; each row should hold {width} numbers, empty where "
            "none was measured"
        ) from error


def parse_numbers(
    text: bytes, separator: str, width: int, columns: Sequence[int], unnamed: int = 0
) -> FloatArray:
    """Parse columns of complete lines.

    Args:
        text: The lines.
        separator: ",", ";", "|" or a tab (commas are then decimal points), or " " for any blanks.
        width: Number of cells in a line; further ones are allowed where they are empty.
        columns: Indices of the columns to return.
        unnamed: Number of further cells that a line may have, with anything in them.

    Returns:
        Numbers, NaN for empty cells. Shape (lines, len(columns)).

    Raises:
        ValueError: A cell is no number or a line has another number of cells; the message ends in
            "at row R, column C", counted from 0.
    """
    if separator in (";", "\t", "|"):
        _require_no_thousands(text)
        text = text.replace(b",", b".").replace(separator.encode(), b",")
    elif separator == " ":
        text = re.sub(rb"[ \t]+", b",", re.sub(rb"(?m)^[ \t]+|[ \t]+\r?$", b"", text))
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n")
    text = text if text.endswith(b"\n") else text + b"\n"
    text = _without_empty_cells_behind(text, width)
    for cells in sorted({width, width + unnamed}):
        if is_plain(text, cells):
            # a cell such as "-" or "." fails here; the tolerant parser reports its place
            with contextlib.suppress(ValueError):
                return _parse_plain(text, cells)[:, list(columns)]
    return _parse_tolerant(text, width, columns, unnamed)


def _require_no_thousands(text: bytes) -> None:
    """Raise ValueError for commas that separate thousands, next to decimal points.

    They are taken for that where each stands in front of three digits and behind one to three that
    do not begin with 0.
    """
    if b"," not in text or b"." not in text or not POINT_CELL.search(text):
        return
    grouped = 0
    for match in THOUSANDS.finditer(text):
        grouped += match[1].count(b",")
    if grouped == text.count(b","):
        line = text[: text.index(b",")].count(b"\n")
        raise ValueError(
            "commas stand between thousands, next to decimal points; remove them at row "
            f"{line}, column 0"
        )


def _without_empty_cells_behind(text: bytes, width: int) -> bytes:
    """Return lines without the cells behind a width, if these are empty in every line."""
    if b'"' in text:
        return text  # a comma may be a part of a cell
    count = text.count(b"\n")
    while text.count(b",", 0, text.find(b"\n")) >= width and text.count(b",\n") == count:
        text = text.replace(b",\n", b"\n")
    return text


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


def _parse_tolerant(
    text: bytes, width: int, columns: Sequence[int], unnamed: int = 0
) -> FloatArray:
    """Parse any text that `np.loadtxt` can read. Shape (lines, len(columns))."""
    texts = MISSING_CELL.sub("nan", text.decode("utf-8")).split("\n")
    numbers = [number for number, line in enumerate(texts) if line.strip()]
    lines = [texts[number] for number in numbers]
    for k, line in enumerate(lines):
        if '"' not in line and line.count(",") != width - 1:
            cells = line.split(",")
            if len(cells) > width and not any(map(str.strip, cells[width + unnamed :])):
                lines[k] = ",".join(cells[:width])
                continue
            fault = f"{len(cells)} cells instead of {width}"
            if len(cells) > width and all(WHOLE_CELL.fullmatch(cell) for cell in cells):
                fault += (
                    ", all whole numbers: if commas are decimal points, write points, or separate "
                    "names and cells by semicolons"
                )
            raise ValueError(f"{fault} at row {numbers[k]}, column 0")
    if any(map(BLANK_CELL.search, lines)):
        lines = [",".join(cell.strip() or "nan" for cell in line.split(",")) for line in lines]
    if not lines:
        return np.empty((0, len(columns)))
    try:
        return np.loadtxt(
            lines, delimiter=",", comments=None, quotechar='"', usecols=list(columns), ndmin=2
        )
    except ValueError as error:  # whose row does not count empty lines
        fault = re.sub(r"at row (\d+)", lambda m: f"at row {numbers[int(m[1])]}", str(error))
        raise ValueError(fault) from error
