"""Text to numbers: the part of reading a CSV that takes the time.

SciPy's Matrix Market reader (fast_float inside) is twice as fast as `np.loadtxt` but takes what it
understands of a cell and drops the rest, "2024-01-02" is 2024 to it. So the text's grammar is
checked first, on whole arrays; what doesn't pass goes to `np.loadtxt`, which is slower, accepts
more (nan, quotes, blanks, text in columns nobody reads) and says where a cell is wrong.
"""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Sequence

import numpy as np

Array = np.ndarray
CELL, POINT, EXPONENT, SIGN = 1, 2, 3, 4
_KIND = np.full(256, 255, np.uint8)
_KIND[list(b"0123456789")] = 0
_KIND[list(b",\n")] = CELL
_KIND[ord(".")] = POINT
_KIND[list(b"eE")] = EXPONENT
_KIND[list(b"+-")] = SIGN


def rows(text: bytes, separator: str, width: int, columns: Sequence[int]) -> Array:
    """Numbers of some columns of whole lines. Shape (lines, len(columns)).

    separator: "," or ";" (then a comma may be the decimal point) or a tab, or " " for any blanks.
        width: columns in a line. Raises ValueError, "… row R, column C …" counted from 0, when a
        cell is no number or a line too short.
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
    if plain(text, width):
        # a cell such as "-" or ".", of which the tolerant reader says where it is
        with contextlib.suppress(ValueError):
            return _fast(text, width)[:, list(columns)]
    return _tolerant(text, width, columns)


def plain(text: bytes, width: int) -> bool:
    """Whether each line is `width` cells of [sign] digits [. digits] [e [sign] digits], nothing
    else."""
    body = np.frombuffer(text, np.uint8)
    kind = _KIND[body]
    signs = np.flatnonzero(kind == SIGN)
    before = kind[signs - 1]  # of a first byte: the last, a newline
    if (
        not ((before == CELL) | (before == EXPONENT)).all()
        or (body[signs[before == CELL]] == ord("+")).any()
    ):
        return False
    exponents = np.flatnonzero(kind == EXPONENT)
    first, second = (kind.take(exponents + k, mode="clip") for k in (1, 2))
    if not ((first == 0) | ((first == SIGN) & (second == 0))).all():
        return False  # "1e", of which SciPy's reader takes the 1
    marks = np.flatnonzero((kind != 0) & (kind != SIGN))
    order = kind[marks]
    if order.max() > EXPONENT:
        return False
    later, former = order[1:], order[:-1]
    if ((later == POINT) & (former != CELL)).any() or (
        (later == EXPONENT) & (former == EXPONENT)
    ).any():
        return False
    ends = body[marks[order == CELL]]
    if len(ends) % width:
        return False
    ends = ends.reshape(-1, width)
    empty = np.diff(marks[order == CELL], prepend=-1) < 2
    return not empty.any() and bool(
        (ends[:, -1] == ord("\n")).all() and (ends[:, :-1] == ord(",")).all()
    )


def _fast(text: bytes, width: int) -> Array:
    from scipy.io import mmread  # slow to import

    # An array in that format is written column by column: our rows are its columns.
    header = b"%%%%MatrixMarket matrix array real general\n%d %d\n" % (width, text.count(b"\n"))
    table: Array = mmread(io.BytesIO(header + text.replace(b",", b"\n")))
    return table.T


def _tolerant(text: bytes, width: int, columns: Sequence[int]) -> Array:
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
