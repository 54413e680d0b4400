"""ROS bags: sensor_msgs/JointState messages of a rosbag2 folder, an .mcap, a .db3 or a ROS 1 .bag.

The package rosbags reads them without ROS.
"""

from __future__ import annotations

import itertools
import sqlite3
import struct
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import Block
from .column_names import listed
from .joint_state_messages import (
    SEARCHED_MESSAGES,
    JointStateMessage,
    MessageSource,
    message_contents,
    read_messages,
)
from .sidecar import Sidecar, sidecar_path

MESSAGE_TYPE = "sensor_msgs/msg/JointState"
SUFFIXES = (".mcap", ".db3", ".bag")
"""Suffixes of single files of bags."""
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
    """Read the JointState messages of a bag; see `read_messages`.

    Args:
        path: A rosbag2 folder or a file of a bag.
        robot: Robot whose joints are recorded.
        sidecar: Sidecar of the bag.

    Yields:
        Consecutive blocks of rows.

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
        bag = _Bag(path, rosbags, reader)
        topic = _select_topic(path, bag, robot, sidecar)
        yield from read_messages(bag.source(topic), robot, sidecar)


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

    def source(self, topic: str) -> MessageSource:
        """Return the messages of a topic."""
        return MessageSource(self.path, f"on {topic}", partial(self._messages, topic))

    def _messages(self, topic: str) -> Iterator[JointStateMessage]:
        """Yield the messages of a topic."""
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
            stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            values = (message.position, message.velocity, message.effort)
            yield JointStateMessage(stamp, received, tuple(message.name), *values)


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
        for message in itertools.islice(bag.source(topic).read(), SEARCHED_MESSAGES)
    )


def _names_together(bag: _Bag, topic: str, robot: Robot) -> bool:
    """Return True if the messages of a topic together name all joints."""
    contents = message_contents(bag.source(topic))
    return set(robot.joints) <= set().union(*(names for names, _ in contents))
