"""Long (tidy) tables: one row for each joint and time, as data frames are stored.

| columns | cells |
|---|---|
| `time`, `joint`, `position`, `velocity`, `effort` | name or number of the joint, its quantities |
| `time`, `joint`, `signal`, `value` | name or number of the joint, a quantity, its value |
| `time`, `variable`, `value` | a column of a wide table, as `q.elbow` (`pandas.melt`), its value |

Rows are read as numbers, with a code for the joint or the variable, and put together by their times
(`Pivot`): rows may be ordered by time or by joint.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .._types import FloatArray, IntArray
from ..errors import UnusableInput
from ..robot.robot import Robot
from .column_names import PREFIXES, listed, numbered_remarks, similar
from .interleaved_rows import interpolate_signal
from .remark import Remark, RemarkKind
from .spelled_columns import (
    OTHER_UNITS,
    are_joint_numbers,
    columns_of_one_joint,
    distinct_columns,
    find_spelled_columns,
    has_standard_names,
    number_fault,
    seconds,
    time_columns,
)
from .time_axis import STEP_TOLERANCE

JOINT = re.compile(
    r"(?:joint|axis|motor|servo|drive|dof)(?:[ _]?(?:name|id|index|idx|number|no|nr))?", re.I
)
"""Column of the joint; one by another name is known by a joint of the robot in its first row."""
VARIABLE = re.compile(r"variable|signal|quantity|field|channel|measurement|metric|key", re.I)
"""Column of the quantity, or of quantity and joint."""
UNITS = re.compile(r"units?", re.I)
"""Column of the unit of the value."""
VALUE = re.compile(r"value|val|data", re.I)
"""Column of the value of any quantity."""
NUMBERED = re.compile(r"(?:joint|axis|motor|servo|drive|dof|j|a)?[._ -]*(\d+)(?:\.0*)?", re.I)
"""Joint that is known by its number."""


@dataclass
class LongColumns:
    """Columns of a long table, and the joints or variables in its rows.

    Attributes:
        source: Name of the file, for messages.
        separator: Separator of its cells.
        width: Number of cells in a row.
        time: Index of the column of time.
        factor: Its factor [s].
        keys: Indices of the columns of the joint or the variable, or both.
        values: Index of each column of values and the prefix of its quantity; without one where the
            keys hold it.
        row: Number of the next row in the file.
        codes: Number of each joint or variable in the rows so far.
    """

    source: str
    separator: str
    width: int
    time: int
    factor: float
    keys: tuple[int, ...]
    values: dict[int, str]
    row: int = 1
    codes: dict[tuple[str, ...], int] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns that `rewrite` returns."""
        return ("t", *(f"value {k}" for k in self.values), "code")

    def rewrite(self, text: bytes) -> tuple[bytes, int]:
        """Return complete lines with time, values and the code of joint or variable alone.

        Raises:
            UnusableInput: A row has another number of cells than the header.
        """
        lines = text.decode("utf-8", "replace").split("\n")
        wanted = (self.time, *self.values)
        for k, line in enumerate(lines):
            if not line.strip():
                continue
            cells = self._cells(line)
            if len(cells) < self.width:
                raise UnusableInput(
                    f"{self.source}: row {self.row + k}: {len(cells)} cells instead of "
                    f"{self.width}; complete the row or remove it"
                )
            key = tuple(cells[i].strip() for i in self.keys)
            code = self.codes.setdefault(key, len(self.codes))
            lines[k] = self.separator.join([*(cells[i].strip() for i in wanted), str(code)])
        self.row += len(lines) - 1
        return "\n".join(lines).encode(), 0

    def _cells(self, line: str) -> list[str]:
        """Cells of a line."""
        if self.separator == " ":
            return line.split()
        if '"' in line:
            return next(csv.reader([line.rstrip("\r")], delimiter=self.separator), [])
        return line.rstrip("\r").split(self.separator)


def find_long_columns(
    source: str,
    names: Sequence[str],
    rows: Sequence[Sequence[str]],
    robot: Robot,
    separator: str,
    effort: str,
) -> LongColumns | None:
    """Return the columns of a long table; None for any other table.

    A table whose header names all positions is none, whatever else it holds.

    Args:
        source: Name of the file, for messages.
        names: Names of all columns.
        rows: Cells of the first rows.
        robot: Robot whose joints are recorded.
        separator: Separator of the cells.
        effort: Prefix of an effort, "tau" for torque or "i" for current.

    Raises:
        UnusableInput: A column has a unit other than of SI, or there is no time.
    """
    if not rows or has_standard_names(names, robot):
        return None
    key, is_long = _column_of_joint(names, rows, robot)
    quantities = columns_of_one_joint(names, effort)
    has_positions = "q" in (prefix for prefix, _ in quantities.values())
    value = next((k for k, name in enumerate(names) if VALUE.fullmatch(name.strip())), None)
    variable = next((k for k, name in enumerate(names) if VARIABLE.fullmatch(name.strip())), None)
    is_table = key is not None and has_positions
    is_list = value is not None and variable is not None
    if not (is_table or is_list):
        return None
    if not is_long and find_spelled_columns(source, names, robot, effort) is not None:
        return None
    if key is not None and has_positions:
        keys: tuple[int, ...] = (key,)
        quantities = distinct_columns(source, names, quantities)
        values = {list(names).index(name): prefix for name, (prefix, _) in quantities.items()}
    else:
        assert value is not None and variable is not None
        keys = (variable,) if key is None or key == variable else (variable, key)
        values = {value: ""}
        _require_si_units(source, names, rows)
    times = time_columns(names)
    if not times:
        raise UnusableInput(
            f"{source}: has no column of time but {listed(names)}; name it with --columns t=COLUMN"
        )
    time = times[0][0]
    place, factor = list(names).index(time), seconds(time)
    return LongColumns(source, separator, len(names), place, factor, keys, values)


def _column_of_joint(
    names: Sequence[str], rows: Sequence[Sequence[str]], robot: Robot
) -> tuple[int | None, bool]:
    """Return the column of the joint, and True if the table is none of a single joint.

    A column that is called so comes first. Where its cells are not the names of the robot's joints,
    a robot of one joint has none unless a time has several: another property may be called so.
    """
    joints = {*robot.joints, *(joint.name for joint in robot.locked)}
    times = [k for k, name in enumerate(names) if time_columns([name])]
    called = [k for k, name in enumerate(names) if JOINT.fullmatch(name.strip())]
    others = [k for k in range(len(names)) if k not in times and k not in called]
    complete = [
        [cell.strip().strip("\"'") for cell in row] for row in rows if len(row) >= len(names)
    ]
    cells = [{row[k] for row in complete} for k in range(len(names))]
    for k in (*called, *others):
        if cells[k] & joints:
            return k, True
    for k in called:
        if cells[k] and all(map(_may_be_joint, cells[k])):
            if robot.n > 1:
                return k, False
            if times and len({(row[times[0]], row[k]) for row in complete}) > len(cells[times[0]]):
                return k, True
    return None, False


def _require_si_units(source: str, names: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Refuse other units in a column of units, which convert no values."""
    for k, name in enumerate(names):
        if not UNITS.fullmatch(name.strip()):
            continue
        stated = {row[k].strip().strip("[]\"'") for row in rows if k < len(row)}
        if other := sorted(unit for unit in stated if unit.lower() in OTHER_UNITS):
            raise UnusableInput(
                f"{source}: column '{name}' states {other[0]}; convert the values to SI units"
            )


def _may_be_joint(cell: str) -> bool:
    """Return True for a word or a whole number."""
    return bool(NUMBERED.fullmatch(cell) or re.match(r"[^\W\d]", cell))


@dataclass(frozen=True)
class Pivot:
    """A wide table, put together from a long one.

    Attributes:
        names: Standard names of its columns, the first is the time.
        table: Its rows. Shape (N, len(names)).
        remarks: Remarks on how it was put together.
    """

    names: tuple[str, ...]
    table: FloatArray
    remarks: tuple[Remark, ...]


def pivot(
    columns: LongColumns,
    t: FloatArray,
    values: FloatArray,
    codes: IntArray,
    robot: Robot,
    effort: str,
) -> Pivot:
    """Put the rows of a long table together by their times.

    Times of one sample that differ by less than 2 % of the time step on average are taken as one.
    Otherwise the quantities of all joints are interpolated at the times of the joint with the most
    rows.

    Args:
        columns: Columns of the table.
        t: Times. Shape (N,) [s].
        values: Cells of `columns.values`. Shape (N, len(columns.values)).
        codes: Number of the joint or variable in each row. Shape (N,).
        robot: Robot whose joints are recorded.
        effort: Prefix of an effort, "tau" for torque or "i" for current.

    Raises:
        UnusableInput: A joint of the robot has no rows.
    """
    if all(columns.values.values()):
        wanted, remarks = _columns_of_joints(columns, robot)
    else:
        wanted, remarks = _columns_of_variables(columns, robot, effort)
    used = np.isin(codes, [code for code, _ in wanted.values()]) & np.isfinite(t)
    t, values, codes = t[used], values[used], codes[used]
    sample, times, are_samples = _samples(t, codes)
    table = np.full((len(times), 1 + len(wanted)), np.nan)
    table[:, 0] = times
    for column, (code, k) in enumerate(wanted.values(), start=1):
        rows = np.flatnonzero(codes == code)
        table[sample[rows], column] = values[rows, k]
    if not are_samples:
        table = _interpolated(columns.source, table, tuple(wanted), robot)
        text = (
            "the joints are recorded at different times; their signals are interpolated at the "
            "times of one joint"
        )
        remarks.append(Remark(RemarkKind.MISSING, text, repaired=True))
    return Pivot(("t", *wanted), table, tuple(remarks))


Places = dict[str, tuple[int, int]]
"""Code and column of values of each standard name."""


def _columns_of_joints(columns: LongColumns, robot: Robot) -> tuple[Places, list[Remark]]:
    """Return the columns of the robot where rows name the joint."""
    joints = {*robot.joints, *(joint.name for joint in robot.locked)}
    keys = {key[0].strip("\"'"): code for key, code in columns.codes.items()}
    named, remarks = {code: key for key, code in keys.items() if key in joints}, list[Remark]()
    if not named:
        numbers = {key: int(match[1]) for key in keys if (match := NUMBERED.fullmatch(key))}
        named, pairs = _joints_by_number(columns.source, keys, numbers, robot)
        remarks += numbered_remarks(pairs, robot)
    missing = [joint for joint in robot.joints if joint not in named.values()]
    if missing:
        raise UnusableInput(
            f"{columns.source}: has no rows of joint '{missing[0]}' {similar(missing[0], [*keys])};"
            " record it, or leave it out with --joints"
        )
    places = {
        f"{prefix}.{joint}": (code, k)
        for code, joint in named.items()
        for k, prefix in enumerate(columns.values.values())
    }
    return places, remarks


def _joints_by_number(
    source: str, keys: Mapping[str, int], numbers: Mapping[str, int], robot: Robot
) -> tuple[dict[int, str], list[str]]:
    """Return the joint of each code by its number in the order of the robot, from 0 or 1.

    Args:
        source: Name of the file, for messages.
        keys: Codes of the texts in the file.
        numbers: Numbers of those texts that have one.
        robot: Robot whose joints are recorded.

    Returns:
        Joints by code, and the texts in the order of the robot's joints.

    Raises:
        UnusableInput: The numbers are not those of the joints.
    """
    if not numbers:
        return {}, []
    if robot.n == 1 and len(keys) == 1:
        return {code: robot.joints[0] for code in keys.values()}, []
    texts, joints = sorted(numbers, key=lambda text: numbers[text]), robot.joints
    if robot.locked and are_joint_numbers(numbers.values(), len(robot.all_joints)):
        joints = robot.all_joints  # a log of all joints, some of which are locked
    elif fault := number_fault(sorted(numbers.values()), robot):
        raise UnusableInput(
            f"{source}: {fault}; write the names of the joints in place of their numbers"
        )
    text_of = dict(zip(joints, texts, strict=True))
    named = {keys[text]: joint for joint, text in text_of.items()}
    return named, [text_of[joint] for joint in robot.joints] if robot.n > 1 else []


def _columns_of_variables(
    columns: LongColumns, robot: Robot, effort: str
) -> tuple[Places, list[Remark]]:
    """Return the columns of the robot where rows name a quantity, or quantity and joint."""
    names = [".".join(part.strip("\"'") for part in key) for key in columns.codes]
    header, numbered = ["t", *names], tuple[str, ...]()
    spelled = find_spelled_columns(columns.source, header, robot, effort)
    if spelled is not None:
        header, numbered = [*spelled.names], spelled.numbered
    known = [name for name in header if name.partition(".")[0] in PREFIXES]
    missing = next((joint for joint in robot.joints if f"q.{joint}" not in known), None)
    if missing is not None:
        raise UnusableInput(
            f"{columns.source}: has no rows of the position of joint '{missing}' but those of "
            f"{listed(names)}; name it q.{missing}, or leave the joint out with --joints"
        )
    codes = dict(zip(header[1:], columns.codes.values(), strict=True))
    return {name: (codes[name], 0) for name in known}, numbered_remarks(numbered, robot)


def _samples(t: FloatArray, codes: IntArray) -> tuple[IntArray, FloatArray, bool]:
    """Number the samples that rows belong to.

    Args:
        t: Times. Shape (N,) [s].
        codes: Numbers of the joints or variables. Shape (N,).

    Returns:
        Sample of each row, shape (N,); time of each sample, shape (M,) [s]; and False if the times
        within a sample differ, so that each is its own. A sample has one row of a joint: further
        ones at the same time are a sample of their own.
    """
    series = [t[codes == code] for code in np.unique(codes)]
    usual = min((_usual_step(times) for times in series), default=np.inf)
    stamps, group = np.unique(t, return_inverse=True)
    cluster = np.concatenate([[0], np.cumsum(np.diff(stamps) > 0.5 * usual)])[: len(stamps)]
    first = np.unique(cluster, return_index=True)[1]
    last = np.append(first[1:], len(stamps)) - 1
    spread = float(np.mean(stamps[last] - stamps[first])) if len(stamps) else 0.0
    pairs = np.unique(np.column_stack([group, codes]), axis=0)  # rows without repeated ones
    is_single = len(np.unique(np.column_stack([cluster[pairs[:, 0]], pairs[:, 1]]), axis=0))
    are_samples = bool(spread <= STEP_TOLERANCE * usual and is_single == len(pairs))
    if are_samples:
        group, stamps = cluster[group], stamps[first]
    repeat = _occurrences(group, codes)
    _, start, sample = np.unique(
        group * (int(repeat.max(initial=0)) + 1) + repeat, return_index=True, return_inverse=True
    )
    times = stamps[group[start]]
    if all((np.diff(times_of_joint) >= 0.0).all() for times_of_joint in series):
        return sample, times, are_samples
    order = np.argsort(start)  # in the order of the file, by which clock restarts show
    return np.argsort(order)[sample], times[order], are_samples


def _usual_step(t: FloatArray) -> float:
    """Return the median step of times in any order; infinite where there is none [s]."""
    stamps = np.unique(t)
    return float(np.median(np.diff(stamps))) if len(stamps) > 1 else np.inf


def _occurrences(group: IntArray, codes: IntArray) -> IntArray:
    """Count the earlier rows of the same group and code. Shape (N,)."""
    key = group * (int(codes.max(initial=0)) + 1) + codes
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    starts = np.searchsorted(ordered, ordered)  # of the first row with the same key
    out = np.empty(len(key), int)
    out[order] = np.arange(len(key)) - starts
    return out


def _interpolated(source: str, table: FloatArray, names: Sequence[str], robot: Robot) -> FloatArray:
    """Interpolate all columns at the times of the position with the most values.

    Rows before the first or behind the last position of a joint are left out.

    Args:
        source: Name of the file, for messages.
        table: Times and columns. Shape (N, 1 + len(names)).
        names: Standard names of the columns.
        robot: Robot whose joints are recorded.

    Raises:
        UnusableInput: A joint has no position.
    """
    slides = {
        joint
        for joint, entry in zip(robot.joints, robot.entries, strict=True)
        if entry.kind == "prismatic"
    }
    table = table[np.argsort(table[:, 0], kind="stable")]
    known = np.isfinite(table[:, 1:])
    positions = [k for k, name in enumerate(names) if name.startswith("q.")]
    if absent := [names[k] for k in positions if not known[:, k].any()]:
        raise UnusableInput(
            f"{source}: {absent[0]} has no number in any row; record the joint, or leave it out "
            "with --joints"
        )
    series = [table[known[:, k], 0] for k in positions]
    times = max(series, key=len)
    start, end = max(t.min() for t in series), min(t.max() for t in series)
    times = times[(times >= start) & (times <= end)]
    columns = [times]
    for k, name in enumerate(names):
        prefix, _, joint = name.partition(".")
        stamps, cells = table[known[:, k], 0], table[known[:, k], 1 + k]
        if np.isin(times, stamps).all():
            columns.append(cells[np.searchsorted(stamps, times)])
            continue
        is_angle = prefix in ("q", "qref", "qlink") and joint not in slides
        columns.append(interpolate_signal(stamps, cells, times, is_angle=is_angle))
    return np.column_stack(columns)
