"""Headers of CSV files that other programs write, renamed to `t`, `q.<joint>`, ….

| program | columns |
|---|---|
| PlotJuggler | `__time`, `/joint_states/<joint>/position`, … |
| `ros2 topic echo --csv` | none: seconds, nanoseconds, frame, names, positions, … |
| `rostopic echo -p` and others | `%time`, `field.name0`, `field.position0` or `name[0]`, … |
| scripts that write a message per row | `time`, `name`, `position`, … with lists in the cells |
| other scripts | `time`, `q_<joint>` or `q1`, …, see `spelled_columns` |

Where names of joints stand in cells, each row is put into the order of the first
(`joint_state_cells`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..errors import UnusableInput
from ..robot.robot import Robot
from .joint_state_cells import ElementColumns, ListCells, Rewrite, is_list
from .spelled_columns import (
    are_joint_numbers,
    check_unit,
    find_spelled_columns,
    first_numbers,
    holds_name,
    number_fault,
    seconds,
    surplus_fault,
    surplus_remedy,
)

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
LISTED = re.compile(r"(?:.*[./])?(name|position|velocity|effort)s?")
"""Column of a field whose cells hold lists."""
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
        rewrite: Rewrites lines so that they have the columns `names`; None: they have them.
        numbered: Names in the file of the positions of joints that are known by their numbers
            alone; else empty.
    """

    names: tuple[str, ...]
    time: tuple[tuple[str, float], ...] = (("t", 1.0),)
    from_first: bool = False
    has_line: bool = True
    rewrite: Rewrite | None = None
    numbered: tuple[str, ...] = ()


def recognise(
    source: str,
    cells: Sequence[str],
    first_row: Sequence[str],
    robot: Robot,
    columns: Mapping[str, str],
    separator: str = ",",
    topic: str | None = None,
    effort: str = "tau",
) -> Header:
    """Rename the columns of a file.

    Args:
        source: Name of the file, for messages.
        cells: Cells of its first line.
        first_row: Cells of its second line.
        robot: Robot whose joints are recorded.
        columns: Standard names of columns -> names in the file; they precede all other rules.
        separator: Separator of the cells.
        topic: Topic of PlotJuggler's columns to use; None: there is one of the robot's joints.
        effort: Prefix of the efforts of JointState messages, "tau" for torque or "i" for current.

    Raises:
        UnusableInput: A column of `columns` is not in the file, or two columns hold the same
            quantity of a joint.
    """
    prefixes = {"position": "q", "velocity": "dq", "effort": effort}
    echoed = _echoed(source, cells, robot, separator, prefixes)
    if echoed is None and cells and cells[0].isdigit():  # a message of other joints comes first
        echoed = _echoed(source, first_row, robot, separator, prefixes)
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
        check_unit(source, ours, theirs)
    if PLOTJUGGLER_TIME in names:
        time = ((PLOTJUGGLER_TIME, 1.0),)
        return Header(_plotjuggler(source, names, robot, topic, prefixes), time, True)
    listed = _listed(source, names, first_row, robot, separator, prefixes)
    if listed is not None:
        return listed
    if "t" not in names and _is_indexed(names, robot):
        time_columns = next(
            (entry for entry in TIME_COLUMNS if all(name in names for name, _ in entry)), None
        )
        if time_columns is not None:
            return _indexed(source, names, first_row, robot, separator, time_columns, prefixes)
    spelled = find_spelled_columns(source, names, robot, effort, topic)
    given = ("t", seconds(columns.get("t", "t")))
    if spelled is not None:
        stated = given if spelled.time[0] == "t" else spelled.time
        return Header(spelled.names, (stated,), numbered=spelled.numbered)
    return Header(tuple(names), (given,))


def _is_indexed(names: Sequence[str], robot: Robot) -> bool:
    """Return True if positions are elements of an array, or named while other fields are."""
    fields = {match[1] for name in names if (match := INDEXED.fullmatch(name))}
    is_named = all(f"q.{joint}" in names for joint in robot.joints)
    return bool(fields & {"name", "position"}) or (bool(fields) and is_named)


def _plotjuggler(
    source: str,
    names: Sequence[str],
    robot: Robot,
    topic: str | None,
    prefixes: Mapping[str, str],
) -> tuple[str, ...]:
    """Names with `/topic/<joint>/position` renamed to `q.<joint>`."""
    out = list(names)
    joints = {*robot.joints, *(joint.name for joint in robot.locked)}
    for k, name in enumerate(names):
        match = NAMED.fullmatch(name)
        if match is None or match[2] not in joints or topic not in (None, match[1]):
            continue
        ours = f"{prefixes[match[3]]}.{match[2]}"
        if ours in out:
            other = names[out.index(ours)]
            first = NAMED.fullmatch(other)
            if first is not None and first[1] != match[1]:
                remedy = (
                    f'choose the topic with "topic": "{first[1]}" or "{match[1]}" in the '
                    f"recording's .json file, or the column with --columns {ours}=COLUMN"
                )
            else:
                remedy = f"choose one with --columns {ours}=COLUMN"
            raise UnusableInput(
                f"{source}: columns '{other}' and '{name}' are both the {match[3]} of joint "
                f"'{match[2]}'; {remedy}"
            )
        out[k] = ours
    return tuple(out)


def _listed(
    source: str,
    names: Sequence[str],
    first_row: Sequence[str],
    robot: Robot,
    separator: str,
    prefixes: Mapping[str, str],
) -> Header | None:
    """Header of a file whose cells hold lists, None for any other."""
    fields: dict[str, int] = {}
    for k, name in enumerate(names):
        match = LISTED.fullmatch(name)
        if match is not None and k < len(first_row) and is_list(first_row[k]):
            fields.setdefault(match[1], k)
    if "position" not in fields:
        return None
    known = ((("t", 1.0),), ((PLOTJUGGLER_TIME, 1.0),), *TIME_COLUMNS)
    time = next((entry for entry in known if all(name in names for name, _ in entry)), None)
    if time is None:
        raise UnusableInput(
            f"{source}: has no column of time; name it with --columns t=COLUMN, or write one "
            "named 't' [s]"
        )
    quantities = {prefixes[field]: k for field, k in fields.items() if field in prefixes}
    locked = [joint.name for joint in robot.locked] if "name" in fields else []
    cells = ListCells(
        source,
        separator,
        [list(names).index(name) for name, _ in time],
        fields.get("name"),
        quantities,
        robot.joints,
        locked,
    )
    columns = [f"{quantity}.{joint}" for quantity in quantities for joint in robot.joints]
    columns += [f"q.{joint}" for joint in locked]
    return Header((*(name for name, _ in time), *columns), time, True, True, cells.rewrite)


def _indexed(
    source: str,
    names: Sequence[str],
    first_row: Sequence[str],
    robot: Robot,
    separator: str,
    time: tuple[tuple[str, float], ...],
    prefixes: Mapping[str, str],
) -> Header:
    """Header with `field.position0` renamed to `q.<joint>` by the joint in `field.name0`."""
    fields = [INDEXED.fullmatch(name) for name in names]
    elements = {
        match[2]: cell.strip().strip("\"'")
        for match, cell in zip(fields, first_row, strict=False)
        if match is not None and match[1] == "name"
    }
    rewrite, numbered = None, tuple[str, ...]()
    if elements:
        place = {(m[1], m[2]): k for k, m in enumerate(fields) if m is not None}
        columns = [
            [place[field, element] for element in elements]
            for field in prefixes
            if all((field, element) in place for element in elements)
        ]
        columns_of_names = [place["name", element] for element in elements]
        rewrite = ElementColumns(
            source, separator, columns_of_names, columns, list(elements.values()), robot.joints
        ).rewrite
        joints = {
            (field, element): joint for field in prefixes for element, joint in elements.items()
        }
    else:
        joints, numbered = _joints_by_number(source, names, fields, robot)
    renamed = tuple(
        f"{prefixes[match[1]]}.{joints[match[1], match[2]]}"
        if match is not None and (match[1], match[2]) in joints
        else name
        for name, match in zip(names, fields, strict=True)
    )
    return Header(renamed, time, True, True, rewrite, numbered)


def _joints_by_number(
    source: str, names: Sequence[str], fields: Sequence[re.Match[str] | None], robot: Robot
) -> tuple[dict[tuple[str, str], str], tuple[str, ...]]:
    """Return the joint of each number in the order of the robot, from 0 or 1.

    Args:
        source: Name of the file, for messages.
        names: Names of all columns.
        fields: Matches of INDEXED with the names.
        robot: Robot whose joints are recorded.

    Returns:
        Joints by field and number as they stand in the file, and the names of the columns of
        positions if the numbers alone tell the joints apart, else none.

    Raises:
        UnusableInput: The positions are not numbered 0 … n − 1 or 1 … n, or another field has
            numbers that are those of no joint.
    """
    columns: dict[str, dict[int, str]] = {}
    written: dict[tuple[str, int], str] = {}
    for name, match in zip(names, fields, strict=True):
        if match is not None and match[1] != "name":
            prefix = "q" if match[1] == "position" else match[1]
            columns.setdefault(prefix, {})[int(match[2])] = name
            written[prefix, int(match[2])] = match[2]
    positions, joints_in_file = columns.get("q", {}), robot.joints
    if all(f"q.{joint}" in names for joint in robot.joints):  # by --columns
        numbers = {number for used in columns.values() for number in used}
        if positions or not are_joint_numbers(numbers, robot.n):
            return {}, ()
        columns["q"] = dict.fromkeys(numbers, "")
    else:
        remedy = f"name the columns with --columns q.{robot.joints[0]}=COLUMN,…"
        if robot.locked and are_joint_numbers(positions, len(robot.all_joints)):
            joints_in_file = robot.all_joints  # a log of all joints, some of which are locked
        elif fault := number_fault(sorted(positions), robot):
            raise UnusableInput(f"{source}: {fault}; {remedy}")
    n = len(joints_in_file)
    fault = surplus_fault(columns, n)
    if fault:
        raise UnusableInput(f"{source}: {fault}; {surplus_remedy(robot)}")
    firsts = first_numbers(columns, n)
    joints = {
        ("position" if prefix == "q" else prefix, text): joints_in_file[number - firsts[prefix]]
        for (prefix, number), text in written.items()
    }
    ordered = tuple(
        positions[number]
        for number in sorted(positions)
        if joints_in_file[number - firsts["q"]] in robot.joints
    )
    is_numbered = robot.n > 1 and not all(map(holds_name, ordered, robot.joints))
    return joints, ordered if is_numbered else ()


def _echoed(
    source: str,
    cells: Sequence[str],
    robot: Robot,
    separator: str,
    prefixes: Mapping[str, str],
) -> Header | None:
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
    for prefix in list(prefixes.values())[: numbers // count]:
        names += [f"{prefix}.{joint}" for joint in joints]
    columns = [
        list(range(start + k * count, start + (k + 1) * count)) for k in range(1 + numbers // count)
    ]
    rewrite = ElementColumns(source, separator, columns[0], columns[1:], joints, robot.joints)
    time = (("sec", 1.0), ("nanosec", 1e-9))
    return Header(tuple(names), time, True, False, rewrite.rewrite)
