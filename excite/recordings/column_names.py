"""Names of columns: which holds what of which joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import QUANTITIES, Block

Array = np.ndarray
PREFIXES = {
    "q": "q",
    "dq": "dq",
    "tau": "tau",
    "i": "current",
    "qref": "qref",
    "qlink": "qlink",
    "temp": "temperature",
}
"""The contract's prefix of a quantity's columns, `<prefix>.<joint>`."""
RTDE = {
    "actual_q": "q",
    "actual_qd": "dq",
    "actual_current_as_torque": "tau",
    "actual_current": "current",
    "target_q": "qref",
    "joint_temperatures": "temperature",
}
"""Universal Robots' RTDE fields, written `<field>_0` … `<field>_5`, joints from the base to the
tool. `target_moment` is the controller's model, not a measurement, and isn't read."""


@dataclass(frozen=True)
class Layout:
    """Names of the columns to read, the time first, and where each goes: (quantity, index of the
    joint)."""

    names: tuple[str, ...]
    places: tuple[tuple[str, int], ...]
    n: int

    def block(self, table: Array) -> Block:
        """Rows of the named columns, in their order, as a block. table: Shape (N, len(names))."""
        there = {quantity for quantity, _ in self.places}
        values = {
            name: np.full((len(table), self.n), np.nan) for name in QUANTITIES if name in there
        }
        for column, (quantity, joint) in enumerate(self.places, start=1):
            values[quantity][:, joint] = table[:, column]
        return Block(np.ascontiguousarray(table[:, 0]), values)


def layout(source: str, header: Sequence[str], robot: Robot) -> Layout:
    """Find the robot's columns in a header, the contract's names or RTDE's.

    Raises UnusableInput when a name stands twice, or time or a joint's position is missing: the
    line lists similar names.
    """
    twice = sorted({name for name in header if header.count(name) > 1 and name})
    if twice:
        raise UnusableInput(
            f"{source}: column '{twice[0]}' stands twice in the header; drop or rename one"
        )
    if "timestamp" in header and "actual_q_0" in header:
        return _rtde(source, header, robot)
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
    wanted = {
        f"{prefix}.{joint}": (quantity, i)
        for prefix, quantity in PREFIXES.items()
        for i, joint in enumerate(robot.joints)
    }
    found = [name for name in header if name in wanted]
    return Layout(("t", *found), tuple(wanted[name] for name in found), robot.n)


def _rtde(source: str, header: Sequence[str], robot: Robot) -> Layout:
    count = sum(
        name.removeprefix("actual_q_").isdigit() for name in header if name.startswith("actual_q_")
    )
    if count != robot.n:
        raise UnusableInput(
            f"{source}: records {count} joints without their names (actual_q_0, …), but {robot.n} "
            "of the robot move; "
            "use it with a robot whose joints all move, or rename the columns t,q.<joint>,…"
        )
    wanted = {
        f"{field}_{i}": (quantity, i) for field, quantity in RTDE.items() for i in range(robot.n)
    }
    missing = [f"actual_q_{i}" for i in range(robot.n) if f"actual_q_{i}" not in header]
    if missing:
        raise UnusableInput(
            f"{source}: has no column '{missing[0]}' for joint "
            f"'{robot.joints[int(missing[0][9:])]}'; record all of actual_q"
        )
    found = [name for name in header if name in wanted]
    return Layout(("timestamp", *found), tuple(wanted[name] for name in found), robot.n)


def listed(names: Sequence[str], most: int = 8) -> str:
    """The first few names, for people."""
    shown = ", ".join(f"'{name}'" for name in names[:most])
    return (
        shown + (f" and {len(names) - most} more" if len(names) > most else "")
        if names
        else "nothing"
    )


def similar(name: str, names: Sequence[str]) -> str:
    """Names near a missing one in spelling, in brackets."""
    near = get_close_matches(name, names, 3, 0.5)
    return f"(similar: {listed(near)})" if near else f"(there are: {listed(names)})"
