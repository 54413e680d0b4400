"""Names of columns: the quantity and the joint that each column of a file holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import QUANTITIES, Block

PREFIXES = {
    "q": "q",
    "dq": "dq",
    "tau": "tau",
    "i": "current",
    "qref": "qref",
    "qlink": "qlink",
    "temp": "temperature",
}
"""Prefixes of columns `<prefix>.<joint>`, with their quantities."""
RTDE = {
    "actual_q": "q",
    "actual_qd": "dq",
    "actual_current_as_torque": "tau",
    "actual_current": "current",
    "target_q": "qref",
    "joint_temperatures": "temperature",
}
"""Fields of Universal Robots' RTDE, with their quantities. Columns are `<field>_0` … `<field>_5`,
from the base to the tool. `target_moment` comes from the controller's model and is not read."""
RTDE_POSITION = "actual_q_"
"""Prefix of RTDE columns with positions."""


@dataclass(frozen=True)
class ColumnLayout:
    """Columns of a table that are read.

    Attributes:
        names: Names of the columns, time first.
        places: Quantity and joint index of each column but time.
        n: Number of joints.
    """

    names: tuple[str, ...]
    places: tuple[tuple[str, int], ...]
    n: int

    def block(self, table: FloatArray) -> Block:
        """Sort the columns of a table into quantities.

        Args:
            table: Rows of the columns `names`. Shape (N, len(names)).
        """
        recorded = {quantity for quantity, _ in self.places}
        values = {
            name: np.full((len(table), self.n), np.nan) for name in QUANTITIES if name in recorded
        }
        for column, (quantity, joint) in enumerate(self.places, start=1):
            values[quantity][:, joint] = table[:, column]
        return Block(np.ascontiguousarray(table[:, 0]), values)


def find_columns(source: str, header: Sequence[str], robot: Robot) -> ColumnLayout:
    """Find the columns of a robot in a header, named `<prefix>.<joint>` or as by RTDE.

    Args:
        source: Name of the file, for messages.
        header: Names of all columns.
        robot: Robot whose joints are recorded.

    Raises:
        UnusableInput: A name occurs twice, or time or the position of a joint is missing; the
            message lists similar names.
    """
    repeated = sorted({name for name in header if header.count(name) > 1 and name})
    if repeated:
        raise UnusableInput(
            f"{source}: column '{repeated[0]}' occurs twice in the header; drop or rename one"
        )
    if "timestamp" in header and f"{RTDE_POSITION}0" in header:
        return _find_rtde_columns(source, header, robot)
    if "t" not in header:
        raise UnusableInput(
            f"{source}: has no column 't' but {listed(header)}; the first row should name the "
            "columns t,q.<joint>,…"
        )
    for joint in robot.joints:
        if f"q.{joint}" not in header:
            raise UnusableInput(
                f"{source}: has no column 'q.{joint}' {similar(f'q.{joint}', header)}; record "
                f"joint '{joint}', rename its column, "
                "or leave it out with --joints"
            )
    places = {
        f"{prefix}.{joint}": (quantity, i)
        for prefix, quantity in PREFIXES.items()
        for i, joint in enumerate(robot.joints)
    }
    names = [name for name in header if name in places]
    return ColumnLayout(("t", *names), tuple(places[name] for name in names), robot.n)


def _find_rtde_columns(source: str, header: Sequence[str], robot: Robot) -> ColumnLayout:
    count = sum(
        name.removeprefix(RTDE_POSITION).isdigit()
        for name in header
        if name.startswith(RTDE_POSITION)
    )
    if count != robot.n:
        raise UnusableInput(
            f"{source}: records {count} joints without their names (actual_q_0, …), but {robot.n} "
            "of the robot move; "
            "use it with a robot whose joints all move, or rename the columns t,q.<joint>,…"
        )
    places = {
        f"{field}_{i}": (quantity, i) for field, quantity in RTDE.items() for i in range(robot.n)
    }
    for i, joint in enumerate(robot.joints):
        if f"{RTDE_POSITION}{i}" not in header:
            raise UnusableInput(
                f"{source}: has no column '{RTDE_POSITION}{i}' for joint '{joint}'; record all of "
                "actual_q"
            )
    names = [name for name in header if name in places]
    return ColumnLayout(("timestamp", *names), tuple(places[name] for name in names), robot.n)


def listed(names: Sequence[str], at_most: int = 8) -> str:
    """Quote the first names of a list, for a message."""
    shown = ", ".join(f"'{name}'" for name in names[:at_most])
    return (
        shown + (f" and {len(names) - at_most} more" if len(names) > at_most else "")
        if names
        else "nothing"
    )


def similar(name: str, names: Sequence[str]) -> str:
    """Quote, in brackets, the names that are spelled like a missing name."""
    matches = get_close_matches(name, names, 3, 0.5)
    return f"(similar: {listed(matches)})" if matches else f"(there are: {listed(names)})"
