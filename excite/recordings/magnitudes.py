"""Bounds of magnitudes beyond which a number is no measurement.

They are far wider than any unit that a recording may be in by mistake (encoder counts,
milliamperes, nanoseconds since 1970), which `units` and `time_axis` report in more detail. They
keep squares and sums over all rows finite.
"""

from __future__ import annotations

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
    place = _first_beyond(block.t[:, None], MAX_TIME)
    if place is not None:
        value = float(block.t[place[0]])
        raise UnusableInput(_message(source, "t", first_row + place[0], value, MAX_TIME))
    for quantity, values in block.values.items():
        place = _first_beyond(values, MAX_MAGNITUDE)
        if place is not None:
            column = column_of(quantity, place[1], robot.joints)
            value = float(values[place])
            raise UnusableInput(
                _message(source, column, first_row + place[0], value, MAX_MAGNITUDE)
            )


def _first_beyond(values: FloatArray, largest: float) -> tuple[int, int] | None:
    """Row and column of the first finite number beyond a magnitude."""
    with np.errstate(invalid="ignore"):
        beyond = np.isfinite(values) & (np.abs(values) > largest)
    if not beyond.any():
        return None
    row, column = np.argwhere(beyond)[0]
    return int(row), int(column)


def _message(source: str, column: str, row: int, value: float, largest: float) -> str:
    fault = f"{value:g} is beyond ±{largest:g}, no measurement"
    return f"{source}: row {row}, column {column}: {fault}; correct the cell or leave it empty"
