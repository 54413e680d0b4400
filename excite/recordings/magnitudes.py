"""Bounds of magnitudes beyond which a number is no measurement.

They are far wider than any unit that a recording may be in by mistake (encoder counts,
milliamperes, nanoseconds since 1970), which `units` and `time_axis` report in more detail. They
keep squares and sums over all rows finite.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import Block
from .column_names import column_of

MAX_MAGNITUDE = 1e12
"""Largest magnitude of a measured quantity, whatever its unit."""
MAX_TIME = 1e20
"""Largest magnitude of a time, in any unit: the year 2026 is 1.8e18 ns after 1970."""


def check_magnitudes(source: str, block: Block, robot: Robot, first_row: int) -> None:
    """Check the numbers of a block; `missing_values` handles NaN and ±inf.

    Args:
        source: Name of the recording, for messages.
        block: Rows of it.
        robot: The robot.
        first_row: Number of the block's first row in its file, as users count.

    Raises:
        UnusableInput: A number exceeds MAX_MAGNITUDE or MAX_TIME.
    """
    check_cells(source, block.t, {}, first_row)
    for quantity, values in block.values.items():
        columns = {
            column_of(quantity, i, robot.joints): column for i, column in enumerate(values.T)
        }
        check_cells(source, block.t[:0], columns, first_row)


def check_cells(
    source: str, t: FloatArray, columns: Mapping[str, FloatArray], first_row: int
) -> None:
    """Check times and columns; see `check_magnitudes`.

    Args:
        source: Name of the recording, for messages.
        t: Times. Shape (N,).
        columns: Columns by name. Shape (N,) each.
        first_row: Number of the first row in its file, as users count.
    """
    for name, column, largest in (
        ("t", t, MAX_TIME),
        *((name, column, MAX_MAGNITUDE) for name, column in columns.items()),
    ):
        row = _first_beyond(column, largest)
        if row is not None:
            raise UnusableInput(
                _message(source, name, first_row + row, float(column[row]), largest)
            )


def _first_beyond(column: FloatArray, largest: float) -> int | None:
    """Row of the first finite number beyond a magnitude."""
    with np.errstate(invalid="ignore"):
        beyond = np.isfinite(column) & (np.abs(column) > largest)
    return int(np.argmax(beyond)) if beyond.any() else None


def _message(source: str, column: str, row: int, value: float, largest: float) -> str:
    fault = f"{value:g} is beyond ±{largest:g}, no measurement"
    return f"{source}: row {row}, column {column}: {fault}; correct the cell or leave it empty"
