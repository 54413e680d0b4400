"""Rows of a recording from sensor_msgs/JointState messages, of a bag or of printed text."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .._types import FloatArray, IntArray
from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import Block
from .column_names import similar
from .remark import Remark, RemarkKind
from .sidecar import Sidecar, sidecar_path
from .time_axis import MAX_FILLED_STEPS

BLOCK_ROWS = 20_000
"""Number of rows in a block."""
FIELDS = ("position", "velocity", "effort")
"""Fields of a JointState message."""
MIN_MERGED_ROWS = 2
"""Number of rows from which messages of single joints can be merged."""
SEARCHED_MESSAGES = 20_000
"""Number of messages of a topic in which the robot's joints and the kinds of its messages are
searched: 20 s at 1 kHz, by which every publisher has begun."""


@dataclass(frozen=True, slots=True)
class JointStateMessage:
    """A message.

    Attributes:
        stamp: Time of the header [ns].
        received: Time of reception [ns]; 0 where it is not known.
        name: Names of the joints.
        position: Positions, none or one of each joint [rad or m].
        velocity: Velocities, none or one of each joint [rad/s or m/s].
        effort: Efforts, none or one of each joint [N m or N].
    """

    stamp: int
    received: int
    name: tuple[str, ...]
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray


@dataclass(frozen=True)
class MessageSource:
    """Messages that can be read several times.

    Attributes:
        path: File, for messages to the user.
        place: Words that follow "message", as "on /joint_states".
        read: Returns the messages from the first one.
    """

    path: Path
    place: str
    read: Callable[[], Iterator[JointStateMessage]]


def read_messages(source: MessageSource, robot: Robot, sidecar: Sidecar) -> Iterator[Block]:
    """Read messages that name all joints of the robot, in any order.

    Time is the stamp of the header, or the time of reception if the first stamp is zero; it counts
    from the first message used. `effort` is torque unless the sidecar states "effort": "current".
    Messages without one of the joints, such as those of a gripper on the same topic, are skipped.
    Where some messages hold positions, velocities and efforts and others fewer of them, as of a
    second publisher that fills in positions, only the complete ones are used; without any, those
    with positions and efforts. Where no message names all joints, as with one publisher a joint,
    the messages are merged; also where those that name all joints lack the efforts of the others,
    or are fewer.

    Args:
        source: The messages.
        robot: Robot whose joints are recorded.
        sidecar: Sidecar of the file.

    Yields:
        Consecutive blocks of BLOCK_ROWS rows.

    Raises:
        UnusableInput: No message names the joints, or one has another number of values than names.
    """
    contents = message_contents(source)
    effort = "current" if sidecar.effort == "current" else "tau"
    complete = [fields for names, fields in contents if set(robot.joints) <= names]
    if _are_parts_better(contents, robot):
        yield _merge_joints(source, robot, sidecar)
        return
    recorded = max(complete, key=_usefulness, default=frozenset({"position"}))
    table = _Table(source.path, robot, effort, recorded)
    locked = _LockedPositions(robot)
    for message in source.read():
        table.add(message)
        locked.add(message)
        if len(table.times) == BLOCK_ROWS:
            yield replace(table.flush(), locked=locked.flush())
    yield replace(table.flush(_remarks(source, table, sidecar)), locked=locked.flush())


Contents = Counter[tuple[frozenset[str], frozenset[str]]]
"""Joints and fields that occur together in messages, and in how many."""


def message_contents(source: MessageSource) -> Contents:
    """Return the contents of the first messages."""
    return Counter(
        (frozenset(message.name), _filled_fields(message))
        for message in itertools.islice(source.read(), SEARCHED_MESSAGES)
    )


def _are_parts_better(contents: Contents, robot: Robot) -> bool:
    """Return True if messages of some joints hold efforts that those of all joints lack, or as many
    quantities more often.

    The others are those of an aggregator, or of a publisher that only announces the joints.
    """
    joints = frozenset(robot.joints)
    parts = Counter({kind: n for kind, n in contents.items() if not joints <= kind[0]})
    if not joints <= frozenset().union(*(names for names, _ in parts)):
        return False
    ranks = [_rank(parts, joint) for joint in robot.joints]
    complete = Counter({kind: n for kind, n in contents.items() if joints <= kind[0]})
    return min(ranks) > _rank(complete, robot.joints[0])


def _rank(contents: Contents, joint: str) -> tuple[bool, bool, int]:
    """Rank of the messages of a joint: positions, then efforts, then their number."""
    kinds = {kind: n for kind, n in contents.items() if joint in kind[0] and "position" in kind[1]}
    with_efforts = sum(n for (_, fields), n in kinds.items() if "effort" in fields)
    return bool(kinds), with_efforts > 0, with_efforts or sum(kinds.values())


def _filled_fields(message: JointStateMessage) -> frozenset[str]:
    """Fields of a message that hold values."""
    return frozenset(field for field in FIELDS if len(getattr(message, field)))


def _usefulness(fields: frozenset[str]) -> tuple[bool, bool, int]:
    """Rank of a message's fields, different for different fields: positions, then efforts."""
    return "position" in fields, "effort" in fields, len(fields)


def _merge_joints(source: MessageSource, robot: Robot, sidecar: Sidecar) -> Block:
    """Merge messages of some joints on the stamps of the joint with the most messages.

    Messages of all joints are those of another publisher and left out.
    """
    effort = "current" if sidecar.effort == "current" else "tau"
    tables = [
        _Table(source.path, robot, effort, frozenset(FIELDS), (joint,)) for joint in robot.joints
    ]
    locked = _LockedPositions(robot)
    joints, left_out = set(robot.joints), 0
    for message in source.read():
        locked.add(message)
        if joints <= set(message.name):
            left_out += 1
            continue
        for table in tables:
            table.add(message)
    origin = min(table.start for table in tables if table.start is not None)
    series = []
    for table in tables:
        times = np.array(table.times) + 1e-9 * ((table.start or 0) - origin)
        times, first = np.unique(times, return_index=True)
        first = first[np.isfinite(times)]
        values = {name: np.concatenate(rows)[first] for name, rows in table.rows.items() if rows}
        series.append((times[np.isfinite(times)], values))
    base = max(series, key=lambda entry: len(entry[0]))[0]
    start, end = (f(entry[0][k] for entry in series) for f, k in ((max, 0), (min, -1)))
    t = base[(base >= start) & (base <= end)]
    if len(t) < MIN_MERGED_ROWS:
        raise UnusableInput(
            f"{source.path}: the messages of the joints {source.place} hardly overlap in time; "
            "record again"
        )
    block: dict[str, FloatArray] = {}
    for field, name in tables[0].fields.items():
        columns = np.full((len(t), robot.n), np.nan)
        for i, (times, values) in enumerate(series):
            known = np.isfinite(values[field])
            if known.sum() >= MIN_MERGED_ROWS:
                columns[:, i] = _interpolated(times[known], values[field][known], t)
        if np.isfinite(columns).any():
            block[name] = columns
    text = f"each message {source.place} holds some of the joints; they are merged in time"
    if left_out:
        text += f", and {left_out} messages that hold all of them are left out"
    remarks = [Remark(RemarkKind.PUBLISHER, text, repaired=True)]
    remarks += _effort_remarks(source.path, effort in block, sidecar)
    return Block(t, block, tuple(remarks), locked.flush())


def _interpolated(times: FloatArray, column: FloatArray, t: FloatArray) -> FloatArray:
    """Interpolate a column by a cubic spline; NaN beyond its ends and in its gaps.

    Args:
        times: Its times. Shape (M,) [s].
        column: Its finite values. Shape (M,).
        t: Times at which it is wanted. Shape (N,) [s].
    """
    from scipy.interpolate import CubicSpline  # slow to import

    out = CubicSpline(times, column, extrapolate=False)(t)
    place = np.clip(np.searchsorted(times, t), 1, len(times) - 1)
    usual = float(np.median(np.diff(times)))
    out[times[place] - times[place - 1] > (MAX_FILLED_STEPS + 0.5) * usual] = np.nan
    for index in (place - 1, place):  # where there is a value, it is taken unchanged
        is_known = times[index] == t
        out[is_known] = column[index[is_known]]
    return np.asarray(out, float)


class _LockedPositions:
    """Positions of locked joints, collected from messages until they are returned."""

    def __init__(self, robot: Robot) -> None:
        self.joints = [joint.name for joint in robot.locked]
        self.values: dict[str, list[float]] = {}

    def add(self, message: JointStateMessage) -> None:
        """Add the positions of a message."""
        for joint in self.joints:
            if joint in message.name and len(message.position) == len(message.name):
                position = message.position[message.name.index(joint)]
                self.values.setdefault(joint, []).append(float(position))

    def flush(self) -> dict[str, FloatArray]:
        """Return the collected positions and start anew."""
        values, self.values = self.values, {}
        return {joint: np.array(positions) for joint, positions in values.items()}


class _Table:
    """Rows collected from messages until they are returned as a block."""

    def __init__(
        self,
        path: Path,
        robot: Robot,
        effort: str,
        recorded: frozenset[str],
        joints: tuple[str, ...] | None = None,
    ) -> None:
        """Collect messages of `joints` (None: all of the robot) with the fields `recorded`."""
        self.path, self.robot = path, robot
        self.joints = robot.joints if joints is None else joints
        self.fields = dict(zip(FIELDS, ("q", "dq", effort), strict=True))
        self.times: list[float] = []
        self.rows: dict[str, list[FloatArray]] = {name: [] for name in self.fields}
        self.recorded, self.is_merged = recorded, joints is not None
        self.skipped = 0
        self.incomplete = 0
        self.used = 0
        self.start: int | None = None
        self.by_reception = False
        self._order: tuple[tuple[str, ...], IntArray | None] = ((), None)
        self._missing = np.full(len(self.joints), np.nan)
        self.seen: set[str] = set()

    def add(self, message: JointStateMessage) -> None:
        """Add the robot's joints from a message if it names them all."""
        columns = self._columns(message.name)
        if columns is None:
            self.skipped += 1
            return
        if not self.is_merged and not self.recorded <= _filled_fields(message):
            self.incomplete += 1
            return
        if self.start is None:
            self.by_reception = message.stamp == 0
            self.start = message.received if self.by_reception else message.stamp
        now = message.received if self.by_reception else message.stamp
        # a single missing stamp: rows without a time are dropped later
        self.times.append((now - self.start) * 1e-9 if now else np.nan)
        for field in self.recorded:
            values = getattr(message, field)
            if len(values) not in (0, len(message.name)):
                raise UnusableInput(
                    f"{self.path}: a message after {self.times[-1]:.3f} s has {len(values)} values "
                    f"of {field} for "
                    f"{len(message.name)} joints; repair the driver that publishes it"
                )
            self.rows[field].append(values[columns] if len(values) else self._missing)
        self.used += 1

    def _columns(self, names: tuple[str, ...]) -> IntArray | None:
        """Indices of the robot's joints in a message, None if one is missing."""
        if names != self._order[0]:
            self.seen |= set(names)
            is_complete = set(self.joints) <= set(names)
            self._order = (
                names,
                np.array([names.index(joint) for joint in self.joints]) if is_complete else None,
            )
        return self._order[1]

    def flush(self, remarks: tuple[Remark, ...] = ()) -> Block:
        """Return the collected rows as a block and start a new one."""
        shape = (len(self.times), self.robot.n)
        recorded = [field for field in self.fields if field in self.recorded]
        values = {
            self.fields[field]: np.array(self.rows[field], float).reshape(shape)
            for field in recorded
        }
        block = Block(np.array(self.times, float), values, remarks)
        self.times, self.rows = [], {name: [] for name in self.fields}
        return block


def _remarks(source: MessageSource, table: _Table, sidecar: Sidecar) -> tuple[Remark, ...]:
    if not table.used:
        joint = next(
            (joint for joint in table.robot.joints if joint not in table.seen),
            table.robot.joints[0],
        )
        raise UnusableInput(
            f"{source.path}: no message {source.place} names all of the robot's joints; joint "
            f"'{joint}' is missing {similar(joint, sorted(table.seen))}; record it, or leave it "
            "out with --joints"
        )
    out = []
    if table.skipped:
        out.append(
            Remark(
                RemarkKind.SKIPPED,
                f"{table.skipped} messages {source.place} that lack some of the robot's joints are "
                "left out",
                repaired=True,
            )
        )
    if table.incomplete:
        out.append(
            Remark(
                RemarkKind.PUBLISHER,
                f"{table.incomplete} messages {source.place} without "
                f"{' or '.join(sorted(table.recorded - {'position'}))} are left out, as of a "
                "second publisher",
                repaired=True,
            )
        )
    if table.by_reception:
        out.append(
            Remark(
                RemarkKind.CLOCK,
                f"stamps {source.place} are zero; the time of reception is used",
                repaired=True,
            )
        )
    return (*out, *_effort_remarks(source.path, "effort" in table.recorded, sidecar))


def _effort_remarks(path: Path, has_effort: bool, sidecar: Sidecar) -> list[Remark]:
    if not has_effort or sidecar.effort is not None:
        return []
    text = (
        "effort is taken to be in N m; if the driver publishes current, "
        f'put "effort": "current" and drive_gain into {sidecar_path(path).name}'
    )
    return [Remark(RemarkKind.UNIT, text)]
