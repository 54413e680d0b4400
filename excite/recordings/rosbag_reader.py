"""ROS bags: sensor_msgs/JointState messages of a rosbag2 folder, an .mcap, a .db3 or a ROS 1 .bag.

The package rosbags reads them without ROS.
"""

from __future__ import annotations

import itertools
import sqlite3
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from .._types import FloatArray, IntArray
from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import Block
from .column_names import listed, similar
from .remark import Remark, RemarkKind
from .sidecar import Sidecar, sidecar_path
from .time_axis import MAX_FILLED_STEPS

BLOCK_ROWS = 20_000
"""Number of rows in a block."""
MESSAGE_TYPE = "sensor_msgs/msg/JointState"
FIELDS = ("position", "velocity", "effort")
"""Fields of a JointState message."""
MIN_MERGED_ROWS = 2
"""Number of rows from which messages of single joints can be merged."""
SUFFIXES = (".mcap", ".db3", ".bag")
"""Suffixes of single files of bags."""
SEARCHED_MESSAGES = 20_000
"""Number of messages of a topic in which the robot's joints and the kinds of its messages are
searched: 20 s at 1 kHz, by which every publisher has begun."""
UNREADABLE = (
    *(
        OSError,
        EOFError,
        AssertionError,
        ArithmeticError,
        AttributeError,
        LookupError,
        MemoryError,
        RuntimeError,
        TypeError,
        ValueError,
    ),
    *(struct.error, sqlite3.Error, zlib.error),
)
"""Built-in exceptions that rosbags, lz4 and sqlite3 raise for damaged files."""


def is_bag(path: Path) -> bool:
    """Return True for a folder or a file with the suffix of a bag."""
    return path.is_dir() or path.suffix in SUFFIXES


def read_blocks(path: Path, robot: Robot, sidecar: Sidecar) -> Iterator[Block]:
    """Read the JointState messages that name all joints of the robot, in any order.

    Time is the stamp of the header, or the time of reception if the first stamp is zero; it counts
    from the first message used. `effort` is torque unless the sidecar states "effort": "current".
    Messages without one of the joints, such as those of a gripper on the same topic, are skipped.
    Where some messages hold positions, velocities and efforts and others fewer of them, as of a
    second publisher that fills in positions, only the complete ones are used; without any, those
    with positions and efforts. Where no message names all joints, as with one publisher a joint,
    the messages are merged; also where those that name all joints lack the efforts of the others,
    or are fewer.

    Args:
        path: A rosbag2 folder or a file of a bag.
        robot: Robot whose joints are recorded.
        sidecar: Sidecar of the bag.

    Yields:
        Consecutive blocks of BLOCK_ROWS rows.

    Raises:
        UnusableInput: The bag cannot be read, or not exactly one topic names all joints.
    """
    rosbags = _import_rosbags(path)
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise UnusableInput(
            f"{path}: is a folder without metadata.yaml; give a rosbag2 folder, or the .mcap in it"
        )
    # bags from before ROS 2 Iron hold no definitions; JointState is the same in all versions
    store = rosbags.typesys.get_typestore(rosbags.typesys.Stores.ROS2_HUMBLE)
    with ExitStack() as opened:
        with _unusable_if_damaged(path, rosbags):
            reader = opened.enter_context(
                rosbags.highlevel.AnyReader([path], default_typestore=store)
            )
        yield from _read_messages(path, _Bag(path, rosbags, reader), robot, sidecar)


@contextmanager
def _unusable_if_damaged(path: Path, rosbags: ModuleType) -> Iterator[None]:
    """Convert exceptions of rosbags and its decompressors for damaged files to UnusableInput."""
    import apsw  # these three come with rosbags
    import ruamel.yaml
    import zstandard

    reader_errors = (
        rosbags.highlevel.AnyReaderError,
        rosbags.rosbag2.ReaderError,
        rosbags.serde.SerdeError,
    )
    try:
        yield
    except (
        *reader_errors,
        apsw.Error,
        ruamel.yaml.YAMLError,
        zstandard.ZstdError,
        *UNREADABLE,
    ) as error:
        reason = " ".join(str(error).split()) or "cut short"
        raise UnusableInput(
            f"{path}: cannot be read as a bag ({reason}); record it again or 'ros2 bag reindex'"
        ) from error


@dataclass(frozen=True)
class _Bag:
    """An open bag; all methods raise UnusableInput for a damaged file."""

    path: Path
    rosbags: ModuleType
    reader: Any

    def topics(self) -> list[str]:
        """Names of the topics of JointState."""
        return sorted({str(c.topic) for c in self.reader.connections if c.msgtype == MESSAGE_TYPE})

    def messages(self, topic: str) -> Iterator[tuple[Any, int]]:
        """Yield the messages of a topic with their times of reception [ns]."""
        with _unusable_if_damaged(self.path, self.rosbags):
            raw = self.reader.messages(
                connections=[c for c in self.reader.connections if c.topic == topic]
            )
        while True:
            with _unusable_if_damaged(self.path, self.rosbags):
                entry = next(raw, None)
                if entry is None:
                    return
                connection, received, data = entry
                message = self.reader.deserialize(data, connection.msgtype)
            yield message, received


def _import_rosbags(path: Path) -> ModuleType:
    try:
        import rosbags.highlevel
        import rosbags.rosbag2
        import rosbags.serde
        import rosbags.typesys
    except ImportError as error:
        raise UnusableInput(
            f"{path}: reading bags needs the package rosbags; pip install 'excite[bags]'"
        ) from error
    return rosbags


def _read_messages(path: Path, bag: _Bag, robot: Robot, sidecar: Sidecar) -> Iterator[Block]:
    topic = _select_topic(path, bag, robot, sidecar)
    contents = _message_contents(bag, topic)
    effort = "current" if sidecar.effort == "current" else "tau"
    complete = [fields for names, fields in contents if set(robot.joints) <= names]
    if _are_parts_better(contents, robot):
        yield _merge_joints(path, bag, topic, robot, sidecar)
        return
    recorded = max(complete, key=_usefulness, default=frozenset({"position"}))
    table = _Table(path, robot, effort, recorded)
    locked = _LockedPositions(robot)
    for message, received in bag.messages(topic):
        table.add(message, received)
        locked.add(message)
        if len(table.times) == BLOCK_ROWS:
            yield replace(table.flush(), locked=locked.flush())
    yield replace(table.flush(_remarks(path, topic, table, sidecar)), locked=locked.flush())


Contents = Counter[tuple[frozenset[str], frozenset[str]]]
"""Joints and fields that occur together in messages, and in how many."""


def _message_contents(bag: _Bag, topic: str) -> Contents:
    """Contents of the first messages of a topic."""
    return Counter(
        (frozenset(message.name), _filled_fields(message))
        for message, _ in itertools.islice(bag.messages(topic), SEARCHED_MESSAGES)
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


def _filled_fields(message: Any) -> frozenset[str]:
    """Fields of a message that hold values."""
    return frozenset(field for field in FIELDS if len(getattr(message, field)))


def _usefulness(fields: frozenset[str]) -> tuple[bool, bool, int]:
    """Rank of a message's fields, different for different fields: positions, then efforts."""
    return "position" in fields, "effort" in fields, len(fields)


def _merge_joints(path: Path, bag: _Bag, topic: str, robot: Robot, sidecar: Sidecar) -> Block:
    """Merge messages of some joints on the stamps of the joint with the most messages.

    Messages of all joints are those of another publisher and left out.
    """
    effort = "current" if sidecar.effort == "current" else "tau"
    tables = [_Table(path, robot, effort, frozenset(FIELDS), (joint,)) for joint in robot.joints]
    locked = _LockedPositions(robot)
    joints, left_out = set(robot.joints), 0
    for message, received in bag.messages(topic):
        locked.add(message)
        if joints <= set(message.name):
            left_out += 1
            continue
        for table in tables:
            table.add(message, received)
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
            f"{path}: the messages of the joints on {topic} hardly overlap in time; record again"
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
    text = f"each message on {topic} holds some of the joints; they are merged in time"
    if left_out:
        text += f", and {left_out} messages that hold all of them are left out"
    remarks = [Remark(RemarkKind.PUBLISHER, text, repaired=True)]
    remarks += _effort_remarks(path, effort in block, sidecar)
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


def _select_topic(path: Path, bag: _Bag, robot: Robot, sidecar: Sidecar) -> str:
    """Select the topic that the sidecar states, the only one of JointState, or the only one whose
    messages name all joints."""
    topics = bag.topics()
    if not topics:
        raise UnusableInput(f"{path}: has no topic of {MESSAGE_TYPE}; record /joint_states")
    if sidecar.topic is not None:
        if sidecar.topic not in topics:
            raise UnusableInput(
                f"{path}: has no topic '{sidecar.topic}' of JointState, which its sidecar names; "
                f"there are {listed(topics)}"
            )
        return sidecar.topic
    if len(topics) == 1:
        return topics[0]
    fitting = [topic for topic in topics if _names_all_joints(bag, topic, robot)]
    fitting = fitting or [topic for topic in topics if _names_together(bag, topic, robot)]
    if len(fitting) == 1:
        return fitting[0]
    number = "several topics with" if fitting else "no topic with"
    remedy = (
        f'select one with "topic" in {sidecar_path(path).name}'
        if fitting
        else "record one that publishes them"
    )
    raise UnusableInput(
        f"{path}: has {number} all of {', '.join(robot.joints)} among {listed(topics)}; {remedy}"
    )


def _names_all_joints(bag: _Bag, topic: str, robot: Robot) -> bool:
    """Return True if one of the first messages of a topic names all joints."""
    return any(
        set(robot.joints) <= set(message.name)
        for message, _ in itertools.islice(bag.messages(topic), SEARCHED_MESSAGES)
    )


def _names_together(bag: _Bag, topic: str, robot: Robot) -> bool:
    """Return True if the messages of a topic together name all joints."""
    contents = _message_contents(bag, topic)
    return set(robot.joints) <= set().union(*(names for names, _ in contents))


class _LockedPositions:
    """Positions of locked joints, collected from messages until they are returned."""

    def __init__(self, robot: Robot) -> None:
        self.joints = [joint.name for joint in robot.locked]
        self.values: dict[str, list[float]] = {}

    def add(self, message: Any) -> None:
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

    def add(self, message: Any, received: int) -> None:
        """Add the robot's joints from a message if it names them all."""
        columns = self._columns(tuple(message.name))
        if columns is None:
            self.skipped += 1
            return
        if not self.is_merged and not self.recorded <= _filled_fields(message):
            self.incomplete += 1
            return
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if self.start is None:
            self.by_reception = stamp == 0
            self.start = received if self.by_reception else stamp
        now = received if self.by_reception else stamp
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


def _remarks(path: Path, topic: str, table: _Table, sidecar: Sidecar) -> tuple[Remark, ...]:
    if not table.used:
        joint = next(
            (joint for joint in table.robot.joints if joint not in table.seen),
            table.robot.joints[0],
        )
        raise UnusableInput(
            f"{path}: no message on {topic} names all of the robot's joints; joint '{joint}' is "
            "missing "
            f"{similar(joint, sorted(table.seen))}; record it, or leave it out with --joints"
        )
    out = []
    if table.skipped:
        out.append(
            Remark(
                RemarkKind.SKIPPED,
                f"{table.skipped} messages on {topic} that lack some of the robot's joints are "
                "left out",
                repaired=True,
            )
        )
    if table.incomplete:
        out.append(
            Remark(
                RemarkKind.PUBLISHER,
                f"{table.incomplete} messages on {topic} without "
                f"{' or '.join(sorted(table.recorded - {'position'}))} are left out, as of a "
                "second publisher",
                repaired=True,
            )
        )
    if table.by_reception:
        out.append(
            Remark(
                RemarkKind.CLOCK,
                f"stamps on {topic} are zero; the time of reception is used",
                repaired=True,
            )
        )
    return (*out, *_effort_remarks(path, "effort" in table.recorded, sidecar))


def _effort_remarks(path: Path, has_effort: bool, sidecar: Sidecar) -> list[Remark]:
    if not has_effort or sidecar.effort is not None:
        return []
    text = (
        "effort is taken to be in N m; if the driver publishes current, "
        f'put "effort": "current" and drive_gain into {sidecar_path(path).name}'
    )
    return [Remark(RemarkKind.UNIT, text)]
