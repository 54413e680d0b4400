"""Names of columns: the quantity and the joint that each column of a file holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.robot import Robot
from . import floating_signals, spelled_columns
from .block import QUANTITIES, Block
from .remark import Remark, RemarkKind

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
PREFIX_OF = {quantity: prefix for prefix, quantity in PREFIXES.items()}
"""Prefix of the columns of each quantity."""
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
        names: Names of the columns: those of time, of `places`, of `locked`.
        places: Quantity and joint index of each column of the robot.
        n: Number of joints.
        signals: Columns of each signal of a floating base; see `floating_signals`.
        time_factors: Factors by which the columns of time add up to seconds.
        from_first: True if time counts from the first row.
        locked: Names of the locked joints of which positions are recorded.
    """

    names: tuple[str, ...]
    places: tuple[tuple[str, int], ...]
    n: int
    time_factors: tuple[float, ...] = (1.0,)
    from_first: bool = False
    signals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    locked: tuple[str, ...] = ()

    @property
    def recorded(self) -> slice:
        """Columns of the table that hold quantities of the robot."""
        return slice(len(self.time_factors), len(self.time_factors) + len(self.places))

    def block(self, table: FloatArray, origin: FloatArray | None = None) -> Block:
        """Sort the columns of a table into quantities.

        Args:
            table: Rows of the columns `names`. Shape (N, len(names)).
            origin: Columns of time of the row from which time counts; None: from 0. Shape (k,).
        """
        clock = table[:, : len(self.time_factors)]
        if origin is not None:
            clock = clock - origin
        t = clock[:, 0] if self.time_factors == (1.0,) else clock @ np.array(self.time_factors)
        recorded = {quantity for quantity, _ in self.places}
        values = {
            name: np.full((len(table), self.n), np.nan) for name in QUANTITIES if name in recorded
        }
        values |= {
            name: np.full((len(table), len(columns)), np.nan)
            for name, columns in self.signals.items()
        }
        for column, (quantity, joint) in enumerate(self.places, start=len(self.time_factors)):
            values[quantity][:, joint] = table[:, column]
        first = self.recorded.stop
        locked = {name: table[:, first + k] for k, name in enumerate(self.locked)}
        return Block(np.ascontiguousarray(t), values, locked=locked)


def find_columns(
    source: str,
    header: Sequence[str],
    robot: Robot,
    time: Sequence[tuple[str, float]] = (("t", 1.0),),
    *,
    from_first: bool = False,
    floating: bool = False,
) -> ColumnLayout:
    """Find the columns of a robot in a header, named `<prefix>.<joint>` or as by RTDE.

    A column `<prefix>.<joint>` precedes RTDE's column of the same quantity.

    Args:
        source: Name of the file, for messages.
        header: Names of all columns.
        robot: Robot whose joints are recorded.
        time: Columns of time and their factors [s].
        from_first: True if time counts from the first row.
        floating: True if the columns of a floating base are wanted.

    Raises:
        UnusableInput: A name occurs twice, or time or the position of a joint is missing; the
            message lists similar names.
    """
    repeated = sorted({name for name in header if header.count(name) > 1 and name})
    if repeated:
        raise UnusableInput(
            f"{source}: column '{repeated[0]}' occurs twice in the header; drop or rename one"
        )
    if _lacks_names_of_rtde(header, robot):
        return _find_rtde_columns(source, header, robot)
    if any(name not in header for name, _ in time):
        raise UnusableInput(f"{source}: {_missing_columns(header, robot)}")
    for joint in robot.joints:
        if f"q.{joint}" not in header:
            raise UnusableInput(
                f"{source}: has no column 'q.{joint}' {similar(f'q.{joint}', header)}; record "
                f"joint '{joint}', name its column with --columns q.{joint}=COLUMN, "
                "or leave it out with --joints"
            )
    places = _named_columns(robot)
    signals = floating_signals.signal_columns(source, header) if floating else {}
    for signal, columns in signals.items():
        places |= {name: (signal, i) for i, name in enumerate(columns)}
    names = [name for name in header if name in places]
    locked = tuple(joint.name for joint in robot.locked if f"q.{joint.name}" in header)
    return ColumnLayout(
        (*(name for name, _ in time), *names, *(f"q.{joint}" for joint in locked)),
        tuple(places[name] for name in names),
        robot.n,
        tuple(factor for _, factor in time),
        from_first,
        signals,
        locked,
    )


def _missing_columns(header: Sequence[str], robot: Robot) -> str:
    """Say which columns a header without the column `t` lacks, and the remedy.

    It may have a column of time by another name, or all positions.
    """
    spelled = spelled_columns.standard_names(header, robot)
    positions = [f"q.{joint}" for joint in robot.joints if f"q.{joint}" not in spelled]
    if not positions:
        return (
            f"has no column 't' of time but {listed(header)}; add a column t [s], the number of "
            "the row divided by the rows a second, or name it with --columns t=COLUMN"
        )
    if not spelled_columns.time_columns(header):
        return (
            f"has no column 't' but {listed(header)}; the first row should name the columns "
            "t,q.<joint>,…, or name them with --columns t=COLUMN,q.<joint>=COLUMN,…"
        )
    torques = [
        f"tau.{joint}" for joint in robot.joints if not {f"tau.{joint}", f"i.{joint}"} & spelled
    ]
    named = ",".join(f"{name}=COLUMN" for name in (*positions[:1], *torques[:1]))
    remedy = f"name the columns with --columns {named}{',…' if len(positions) > 1 else ''}"
    numbers = spelled_columns.numbers_of_positions(header, robot)
    if numbers and (fault := spelled_columns.number_fault(numbers, robot)):
        return f"{fault}; {remedy}"
    missing = "position" if len(torques) < robot.n else "position and no torque"
    joint = positions[0].removeprefix("q.")
    return f"has no {missing} of joint '{joint}' but {listed(header)}; {remedy}"


def column_of(quantity: str, index: int, joints: Sequence[str]) -> str:
    """Return the name of the column that holds a quantity of a joint or an axis of a signal."""
    if quantity in PREFIX_OF:
        return f"{PREFIX_OF[quantity]}.{joints[index]}"
    if quantity == "base":
        return floating_signals.POSE[index]
    if quantity == "gyroscope":
        return floating_signals.GYROSCOPE[index]
    if quantity == "accelerometer":
        return floating_signals.ACCELEROMETER[index]
    return f"{quantity}.{floating_signals.COMPONENTS[index]}"


def _named_columns(robot: Robot) -> dict[str, tuple[str, int]]:
    """Quantity and joint index of each column `<prefix>.<joint>`."""
    return {
        f"{prefix}.{joint}": (quantity, i)
        for prefix, quantity in PREFIXES.items()
        for i, joint in enumerate(robot.joints)
    }


def _rtde_joints(header: Sequence[str]) -> set[int]:
    """Indices of the joints of which RTDE's columns hold positions."""
    places = (name.removeprefix(RTDE_POSITION) for name in header if RTDE_POSITION in name)
    return {int(place) for place in places if place.isdecimal()}


def _lacks_names_of_rtde(header: Sequence[str], robot: Robot) -> bool:
    """True for a header of RTDE in which not all positions are named `q.<joint>`."""
    return (
        ("timestamp" in header or "t" in header)
        and bool(_rtde_joints(header))
        and not all(f"q.{joint}" in header for joint in robot.joints)
    )


def _find_rtde_columns(source: str, header: Sequence[str], robot: Robot) -> ColumnLayout:
    named = {i for i, joint in enumerate(robot.joints) if f"q.{joint}" in header}
    count = len(_rtde_joints(header) | named)
    if count != robot.n:
        raise UnusableInput(
            f"{source}: records {count} joints without their names (actual_q_0, …), but {robot.n} "
            "of the robot move; "
            "use it with a robot whose joints all move, or rename the columns t,q.<joint>,…"
        )
    places = _named_columns(robot) | {
        f"{field}_{i}": (quantity, i)
        for field, quantity in RTDE.items()
        for i, joint in enumerate(robot.joints)
        if f"{PREFIX_OF[quantity]}.{joint}" not in header
    }
    for i, joint in enumerate(robot.joints):
        if i not in named and f"{RTDE_POSITION}{i}" not in header:
            raise UnusableInput(
                f"{source}: has no column '{RTDE_POSITION}{i}' for joint '{joint}'; record all of "
                "actual_q"
            )
    names = [name for name in header if name in places]
    time = "t" if "t" in header else "timestamp"
    return ColumnLayout((time, *names), tuple(places[name] for name in names), robot.n)


def numbered_remarks(columns: Sequence[str], robot: Robot) -> list[Remark]:
    """Remark columns that name joints by their numbers: the order is that of the robot.

    Args:
        columns: Names of their positions in the file, of each joint of the robot; none otherwise.
        robot: Robot whose joints are recorded.
    """
    if not columns:
        return []
    pairs = zip(columns, robot.joints, strict=True)
    text = f"its joints have numbers and no names; they are {', '.join(map(' = '.join, pairs))}"
    return [Remark(RemarkKind.NUMBERED, text, repaired=True)]


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
