"""Headers of CSV files that other programs write, renamed to `t`, `q.<joint>`, ….

| program | columns |
|---|---|
| PlotJuggler | `__time`, `/joint_states/<joint>/position`, … |
| `ros2 topic echo --csv` | none: seconds, nanoseconds, frame, names, positions, … |
| `rostopic echo -p` and others | `%time`, `field.name0`, `field.position0` or `name[0]`, … |

Names of joints that stand in cells are those of the first row.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..errors import UnusableInput
from ..robot.robot import Robot

QUANTITY = {"position": "q", "velocity": "dq", "effort": "tau"}
"""Our prefixes of the fields of a JointState message."""
PLOTJUGGLER_TIME = "__time"
"""Column of time of PlotJuggler [s since 1970]."""
TIME_COLUMNS = (
    (("header.stamp.sec", 1.0), ("header.stamp.nanosec", 1e-9)),
    (("header.stamp.secs", 1.0), ("header.stamp.nsecs", 1e-9)),
    (("field.header.stamp", 1e-9),),
    (("%time", 1e-9),),
    (("timestamp", 1.0),),
    (("time", 1.0),),
)
"""Columns of time of flattened messages and their factors [s], the preferred first."""
INDEXED = re.compile(r"(?:field)?\.?(name|position|velocity|effort)[_.\[]?(\d+)\]?")
"""Column of an element of an array in a flattened message."""
NAMED = re.compile(r"(.*)/([^/]+)/(position|velocity|effort)")
"""Column of a joint in PlotJuggler: topic, joint, field."""


@dataclass(frozen=True)
class Header:
    """Names of the columns of a file, as `column_names` expects them.

    Attributes:
        names: Names of all columns.
        time: Columns that add up to the time, with their factors [s].
        from_first: True if time counts from the first row.
        has_line: True if the file has a header line.
    """

    names: tuple[str, ...]
    time: tuple[tuple[str, float], ...] = (("t", 1.0),)
    from_first: bool = False
    has_line: bool = True


def recognise(
    source: str,
    cells: Sequence[str],
    first_row: Sequence[str],
    robot: Robot,
    columns: Mapping[str, str],
) -> Header:
    """Rename the columns of a file.

    Args:
        source: Name of the file, for messages.
        cells: Cells of its first line.
        first_row: Cells of its second line.
        robot: Robot whose joints are recorded.
        columns: Standard names of columns -> names in the file; they precede all other rules.

    Raises:
        UnusableInput: A column of `columns` is not in the file, or two columns hold the same
            quantity of a joint.
    """
    echoed = _echoed(cells, robot)
    if echoed is not None and not columns:
        return echoed
    names = list(cells)
    for ours, theirs in columns.items():
        if theirs not in cells:
            from .column_names import similar

            raise UnusableInput(
                f"{source}: has no column '{theirs}' {similar(theirs, cells)}, which --columns "
                f"gives for {ours}"
            )
        if ours in names:
            names[names.index(ours)] = f"({ours})"  # replaced by the one that is given
        names[cells.index(theirs)] = ours
    if PLOTJUGGLER_TIME in names:
        return Header(_plotjuggler(source, names, robot), ((PLOTJUGGLER_TIME, 1.0),), True)
    if "t" not in names and any(INDEXED.fullmatch(name) for name in names):
        time = next(
            (entry for entry in TIME_COLUMNS if all(name in names for name, _ in entry)), None
        )
        if time is not None:
            return Header(_indexed(names, first_row, robot), time, True)
    return Header(tuple(names))


def _plotjuggler(source: str, names: Sequence[str], robot: Robot) -> tuple[str, ...]:
    """Names with `/topic/<joint>/position` renamed to `q.<joint>`."""
    out = list(names)
    for k, name in enumerate(names):
        match = NAMED.fullmatch(name)
        if match is None or match[2] not in robot.joints:
            continue
        ours = f"{QUANTITY[match[3]]}.{match[2]}"
        if ours in out:
            other = names[out.index(ours)]
            raise UnusableInput(
                f"{source}: columns '{other}' and '{name}' are both the {match[3]} of joint "
                f"'{match[2]}'; choose one with --columns {ours}=COLUMN"
            )
        out[k] = ours
    return tuple(out)


def _indexed(names: Sequence[str], first_row: Sequence[str], robot: Robot) -> tuple[str, ...]:
    """Names with `field.position0` renamed to `q.<joint>` by the joint that `field.name0` holds."""
    fields = [INDEXED.fullmatch(name) for name in names]
    joints = {
        match[2]: cell.strip().strip("\"'")
        for match, cell in zip(fields, first_row, strict=False)
        if match is not None and match[1] == "name"
    }
    if not joints:  # positions without names are in the order of the robot
        joints = {str(i): joint for i, joint in enumerate(robot.joints)}
    return tuple(
        f"{QUANTITY[match[1]]}.{joints[match[2]]}"
        if match is not None and match[1] in QUANTITY and match[2] in joints
        else name
        for name, match in zip(names, fields, strict=True)
    )


def _echoed(cells: Sequence[str], robot: Robot) -> Header | None:
    """Header of a file of `ros2 topic echo --csv /joint_states`, None for any other."""
    if len(cells) < 5 or not (cells[0].isdigit() and cells[1].isdigit()):
        return None
    start = 3  # after seconds, nanoseconds and frame
    joints = []
    for cell in cells[start:]:
        try:
            float(cell)
            break
        except ValueError:
            joints.append(cell)
    count, numbers = len(joints), len(cells) - start - len(joints)
    if not set(robot.joints) <= set(joints) or numbers not in (count, 2 * count, 3 * count):
        return None
    names = ["sec", "nanosec", "frame_id", *(f"name {joint}" for joint in joints)]
    # without velocities, efforts stand in their place: a driver sends both or positions alone
    for prefix in ("q", "dq", "tau")[: numbers // count]:
        names += [f"{prefix}.{joint}" for joint in joints]
    return Header(tuple(names), (("sec", 1.0), ("nanosec", 1e-9)), True, False)
