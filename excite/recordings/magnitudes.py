"""Numbers that no measurement has: a recording that holds one is refused by column and row.

The ranges are far wider than any unit that a recording may be in by mistake (encoder counts,
milliamperes, nanoseconds since 1970), of which `units` and `clock` tell more; they keep squares and
sums over all rows finite.
"""

from __future__ import annotations

import numpy as np

from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import Block
from .column_names import PREFIXES

Array = np.ndarray
LARGEST = 1e12
"""Largest magnitude of a measured quantity, whatever its unit."""
LARGEST_TIME = 1e20
"""Largest magnitude of a time, in any unit: the year 2026 is 1.8e18 ns after 1970."""
PREFIX = {quantity: prefix for prefix, quantity in PREFIXES.items()}


def check(source: str, block: Block, robot: Robot, first_row: int) -> None:
    """Check the numbers of a block as a reader found it; NaN and ±inf are missing numbers, see
    `missing`.

    Args:
        source: The recording, for messages.
        block: Rows of it.
        robot: The robot.
        first_row: Number of the block's first row in its file, counted as the file's users count.

    Raises:
        UnusableInput: A number is larger than LARGEST or LARGEST_TIME.
    """
    row = _first_beyond(block.t[:, None], LARGEST_TIME)
    if row is not None:
        raise UnusableInput(
            _words(source, "t", first_row + row[0], float(block.t[row[0]]), LARGEST_TIME)
        )
    for quantity, values in block.values.items():
        place = _first_beyond(values, LARGEST)
        if place is not None:
            column = f"{PREFIX[quantity]}.{robot.joints[place[1]]}"
            raise UnusableInput(
                _words(source, column, first_row + place[0], float(values[place]), LARGEST)
            )


def _first_beyond(values: Array, largest: float) -> tuple[int, int] | None:
    """Row and column of the first finite number beyond a magnitude."""
    with np.errstate(invalid="ignore"):
        beyond = np.isfinite(values) & (np.abs(values) > largest)
    if not beyond.any():
        return None
    row, column = np.argwhere(beyond)[0]
    return int(row), int(column)


def _words(source: str, column: str, row: int, value: float, largest: float) -> str:
    return f"{source}: row {row}, column {column}: {value:g} is beyond ±{largest:g}, no measurement; correct the cell or leave it empty"  # noqa: E501
