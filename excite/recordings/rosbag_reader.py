"""ROS bags: sensor_msgs/JointState from a rosbag2 folder, an .mcap, a .db3 or a ROS 1 .bag, without
ROS (package rosbags)."""

from __future__ import annotations

import itertools
import sqlite3
import struct
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import Block
from .column_names import listed, similar
from .remark import Kind, Remark
from .sidecar import Sidecar, beside

Array = np.ndarray
ROWS = 20_000
MESSAGE = "sensor_msgs/msg/JointState"
ENDINGS = (".mcap", ".db3", ".bag")
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
"""What rosbags, lz4 and sqlite3 raise for damaged files, besides errors of their own."""


def is_bag(path: Path) -> bool:
    """A rosbag2 folder or a single file of a bag."""
    return path.is_dir() or path.suffix in ENDINGS


def blocks(path: Path, robot: Robot, sidecar: Sidecar) -> Iterator[Block]:
    """Blocks of the bag's JointState messages that name all of the robot's joints, in whatever
    order each message has them.

    Time is the header's stamp, or the time of reception where the first stamp is zero; it counts
    from the first message used. `effort` is taken as torque unless the sidecar says "effort":
    "current". Messages that lack a joint (a gripper's, on the same topic) are left out. Raises
    UnusableInput for a bag that cannot be read or in which no or several topics fit.
    """
    rosbags = _package(path)
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise UnusableInput(
            f"{path}: is a folder without metadata.yaml; give a rosbag2 folder, or the .mcap in it"
        )
    # Bags written before ROS 2 Iron hold no definitions; JointState is the same in all.
    store = rosbags.typesys.get_typestore(rosbags.typesys.Stores.ROS2_HUMBLE)
    with ExitStack() as opened:
        with _refusing(path, rosbags):
            reader = opened.enter_context(
                rosbags.highlevel.AnyReader([path], default_typestore=store)
            )
        yield from _blocks(path, _Bag(path, rosbags, reader), robot, sidecar)


@contextmanager
def _refusing(path: Path, rosbags: ModuleType) -> Iterator[None]:
    """Turn what rosbags and its decompressors raise for a damaged file into UnusableInput."""
    import apsw  # these three come with rosbags
    import ruamel.yaml
    import zstandard

    own = (rosbags.highlevel.AnyReaderError, rosbags.rosbag2.ReaderError, rosbags.serde.SerdeError)
    try:
        yield
    except (*own, apsw.Error, ruamel.yaml.YAMLError, zstandard.ZstdError, *UNREADABLE) as error:
        reason = " ".join(str(error).split()) or "cut short"
        raise UnusableInput(
            f"{path}: cannot be read as a bag ({reason}); record it again or 'ros2 bag reindex'"
        ) from error


@dataclass(frozen=True)
class _Bag:
    """An open bag; every use of its reader refuses a damaged file."""

    path: Path
    rosbags: ModuleType
    reader: Any

    def topics(self) -> list[str]:
        """Names of the topics of JointState."""
        return sorted({str(c.topic) for c in self.reader.connections if c.msgtype == MESSAGE})

    def messages(self, topic: str) -> Iterator[tuple[Any, int]]:
        """Messages of a topic and their times of reception [ns]."""
        with _refusing(self.path, self.rosbags):
            raw = self.reader.messages(
                connections=[c for c in self.reader.connections if c.topic == topic]
            )
        while True:
            with _refusing(self.path, self.rosbags):
                entry = next(raw, None)
                if entry is None:
                    return
                connection, received, data = entry
                message = self.reader.deserialize(data, connection.msgtype)
            yield message, received


def _package(path: Path) -> ModuleType:
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


def _blocks(path: Path, source: _Bag, robot: Robot, sidecar: Sidecar) -> Iterator[Block]:
    topic = _topic(path, source, robot, sidecar)
    table = _Table(path, robot, "current" if sidecar.effort == "current" else "tau")
    for message, received in source.messages(topic):
        table.add(message, received)
        if len(table.times) == ROWS:
            yield table.flush()
    yield table.flush(_remarks(path, topic, table, sidecar))


def _topic(path: Path, source: _Bag, robot: Robot, sidecar: Sidecar) -> str:
    """The topic to read: the sidecar's, the only one of JointState, or the only one whose messages
    name all joints."""
    topics = source.topics()
    if not topics:
        raise UnusableInput(f"{path}: has no topic of {MESSAGE}; record /joint_states")
    if sidecar.topic is not None:
        if sidecar.topic not in topics:
            raise UnusableInput(
                f"{path}: has no topic '{sidecar.topic}' of JointState, which its sidecar names; "
                f"there are {listed(topics)}"
            )
        return sidecar.topic
    if len(topics) == 1:
        return topics[0]
    named = {topic: _names(source, topic, robot) for topic in topics}
    fitting = [topic for topic, names in named.items() if set(robot.joints) <= names]
    if len(fitting) == 1:
        return fitting[0]
    many = "several topics with" if fitting else "no topic with"
    remedy = (
        f'say which with "topic" in {beside(path).name}'
        if fitting
        else "record one that publishes them"
    )
    raise UnusableInput(
        f"{path}: has {many} all of {', '.join(robot.joints)} among {listed(topics)}; {remedy}"
    )


def _names(source: _Bag, topic: str, robot: Robot, look: int = 100) -> set[str]:
    """Joints in the first messages of a topic, up to one that names all."""
    for message, _ in itertools.islice(source.messages(topic), look):
        if set(robot.joints) <= set(message.name):
            return set(message.name)
    return set()


class _Table:
    """Rows gathered from messages until they are handed on as a block."""

    def __init__(self, path: Path, robot: Robot, effort: str) -> None:
        self.path, self.robot = path, robot
        self.fields = {"position": "q", "velocity": "dq", "effort": effort}
        self.times: list[float] = []
        self.rows: dict[str, list[Array]] = {name: [] for name in self.fields}
        self.there: set[str] = {"position"}
        self.skipped = 0
        self.used = 0
        self.start: int | None = None
        self.by_reception = False
        self._order: tuple[tuple[str, ...], Array | None] = ((), None)
        self._nothing = np.full(robot.n, np.nan)
        self.seen: set[str] = set()

    def add(self, message: Any, received: int) -> None:
        """Take the robot's joints from a message, if it names them all."""
        columns = self._columns(tuple(message.name))
        if columns is None:
            self.skipped += 1
            return
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if self.start is None:
            self.by_reception = stamp == 0
            self.start = received if self.by_reception else stamp
            self.there |= {field for field in self.fields if len(getattr(message, field))}
        now = received if self.by_reception else stamp
        # A stamp that is missing among others has no time; the health check drops such rows.
        self.times.append((now - self.start) * 1e-9 if now else np.nan)
        for field in self.there:
            values = getattr(message, field)
            if len(values) not in (0, len(message.name)):
                raise UnusableInput(
                    f"{self.path}: a message after {self.times[-1]:.3f} s has {len(values)} values "
                    f"of {field} for "
                    f"{len(message.name)} joints; repair the driver that publishes it"
                )
            self.rows[field].append(values[columns] if len(values) else self._nothing)
        self.used += 1

    def _columns(self, names: tuple[str, ...]) -> Array | None:
        if names != self._order[0]:
            self.seen |= set(names)
            complete = set(self.robot.joints) <= set(names)
            self._order = (
                names,
                np.array([names.index(joint) for joint in self.robot.joints]) if complete else None,
            )
        return self._order[1]

    def flush(self, remarks: tuple[Remark, ...] = ()) -> Block:
        """The gathered rows as a block."""
        shape = (len(self.times), self.robot.n)
        there = [field for field in self.fields if field in self.there]
        values = {
            self.fields[field]: np.array(self.rows[field], float).reshape(shape) for field in there
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
                Kind.SKIPPED,
                f"{table.skipped} messages on {topic} that lack some of the robot's joints are "
                "left out",
                repaired=True,
            )
        )
    if table.by_reception:
        out.append(
            Remark(
                Kind.CLOCK,
                f"stamps on {topic} are zero; the time of reception is used",
                repaired=True,
            )
        )
    if "effort" in table.there and sidecar.effort is None:
        text = (
            "effort is taken to be in N m; if the driver publishes current, "
            f'put "effort": "current" and drive_gain into {beside(path).name}'
        )
        out.append(Remark(Kind.UNIT, text))
    return tuple(out)
