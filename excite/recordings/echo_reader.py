"""Text of sensor_msgs/JointState messages that `ros2 topic echo` or `rostopic echo` prints.

A message is a YAML document, with its lists in blocks (`- 0.1`) or in brackets (`[0.1, 0.2]`), or
all of it in braces. Documents end in a line `---`. PyYAML's `CSafeLoader` takes 0.2 ms for a
message of seven joints; the few fields that are needed are found by regular expressions in an
eighth of that time, and text between them, such as warnings, is skipped.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.parameter_names import plural
from ..robot.robot import Robot
from .block import Block
from .joint_state_messages import FIELDS, JointStateMessage, MessageSource, read_messages
from .remark import Remark, RemarkKind
from .sidecar import Sidecar
from .text_file import open_text

HEAD_SIZE = 1 << 16
"""Part of a file in which the beginning of a message is searched [bytes]."""
CHUNK_SIZE = 1 << 22
"""Part of a file that is parsed at once [bytes]."""
MAX_MESSAGE = 1 << 26
"""Longest text between two lines `---` [bytes]."""
SUFFIXES = (".yaml", ".yml")
"""Suffixes of files that hold nothing else."""
BEGINNING = re.compile(
    rb"^\{?header:[ \t]*(?:\r?$|\{)|^(?:name|position):[ \t]*(?:\r?\n[ \t]*-[ \t]|\[)"
    rb"|^-[ \t][^\n]*\n---[ \t]*\r?$",
    re.M,
)
"""Line at which a message begins, or at which the list of a single field ends."""
SEPARATOR = re.compile(rb"^---[ \t]*\r?$", re.M)
"""Line between two messages."""
STAMP = re.compile(r"\bsecs?:[ \t]*(\d+)[,\s]+n(?:ano)?secs?:[ \t]*(\d+)")
"""Time of a header."""
FIELD = re.compile(
    r"(?:^|\{|,\s+)(name|position|velocity|effort):[ \t]*"
    r"(?:\[([^\]]*)\]|((?:\r?\n[ \t]*-[ \t][^\n]*)+))",
    re.M,
)
"""Field of a message with its list."""
ELEMENT = re.compile(r"-[ \t]+([^\n]*)")
"""Element of a list in a block."""
OMITTED = re.compile(r"^[ \t]*position:[ \t]*['\"]?<(?:array|sequence) type", re.M)
"""Field of a message that was printed without its arrays."""


def is_echo(path: Path) -> bool:
    """Return True for a file with the suffix or the beginning of printed messages."""
    if path.suffix in SUFFIXES:
        return True
    with open_text(path) as stream:
        return BEGINNING.search(stream.read(HEAD_SIZE)) is not None


def read_blocks(path: Path, robot: Robot, sidecar: Sidecar) -> Iterator[Block]:
    """Read printed messages; see `read_messages`.

    Args:
        path: The text.
        robot: Robot whose joints are recorded.
        sidecar: Sidecar of the text.

    Yields:
        Consecutive blocks of rows.

    Raises:
        UnusableInput: It holds no JointState message, or none with a time.
    """
    text = _EchoedText(path)
    if next(text.messages(), None) is None:
        raise UnusableInput(f"{path}: {text.fault()}")
    waiting: Block | None = None
    for block in read_messages(MessageSource(path, "in it", text.messages), robot, sidecar):
        if waiting is not None:
            yield waiting
        waiting = block
    if waiting is not None:
        yield replace(waiting, remarks=(*waiting.remarks, *text.remarks()))


class _EchoedText:
    """Printed messages that can be read several times.

    Attributes:
        path: The text.
        unreadable: Number of messages of the last reading that could not be read.
        untimed: Number of those whose stamp is zero.
        is_cut: True if the last message is not complete.
        lacks_arrays: True if messages were printed without their arrays.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.unreadable, self.untimed, self.is_cut, self.lacks_arrays = 0, 0, False, False

    def messages(self) -> Iterator[JointStateMessage]:
        """Yield the messages that are complete and have a stamp."""
        self.unreadable, self.untimed, self.is_cut, self.lacks_arrays = 0, 0, False, False
        for document, has_end in self._documents():
            message = _message(document)
            if not has_end and document.strip() and (message is None or not _is_whole(document)):
                self.is_cut = True
            elif message is None:
                self.unreadable += bool(re.search(r"\b(?:header|position):", document))
                self.lacks_arrays |= OMITTED.search(document) is not None
            elif message.stamp == 0:
                self.untimed += 1
            else:
                yield message

    def _documents(self) -> Iterator[tuple[str, bool]]:
        """Yield the texts between the lines `---`, and True if such a line follows."""
        remainder = b""
        with open_text(self.path) as stream:
            while chunk := stream.read(CHUNK_SIZE):
                *complete, remainder = SEPARATOR.split(remainder + chunk)
                for document in complete:
                    yield document.decode("utf-8", "replace"), True
                if len(remainder) > MAX_MESSAGE:
                    raise UnusableInput(
                        f"{self.path}: a message is longer than {MAX_MESSAGE} bytes; separate the "
                        "messages by lines ---, as `ros2 topic echo` does"
                    )
        yield remainder.decode("utf-8", "replace"), False

    def fault(self) -> str:
        """State why there is no message, and the remedy."""
        if self.lacks_arrays:
            return "its messages were printed without their arrays; echo them without --no-arr"
        if self.untimed:
            return (
                "the stamps of all messages are zero; record a bag, which holds the time of "
                "reception, or set the stamps in the driver"
            )
        return (
            "has no complete sensor_msgs/JointState message with header, name and position, as "
            "`ros2 topic echo /joint_states` prints it; echo that topic, or record a bag"
        )

    def remarks(self) -> list[Remark]:
        """Return remarks about messages of the last reading that are left out."""
        texts = []
        if self.unreadable:
            count = plural(self.unreadable, "message")
            texts.append(f"{count} that cannot be read {_verb(self.unreadable)} left out")
        if self.untimed:
            count = plural(self.untimed, "message")
            texts.append(f"{count} without a stamp {_verb(self.untimed)} left out")
        if self.is_cut:
            texts.append("the last message is cut short and left out")
        return [Remark(RemarkKind.SKIPPED, text, repaired=True) for text in texts]


def _verb(count: int) -> str:
    """Return the verb for a number of messages."""
    return "is" if count == 1 else "are"


def _message(document: str) -> JointStateMessage | None:
    """Read a message; None if it has no stamp, names or positions, or a value is no number."""
    stamp = STAMP.search(document)
    fields: dict[str, list[str]] = {}
    for match in FIELD.finditer(document):
        fields.setdefault(match[1], _elements(match))
    if stamp is None or not {"name", "position"} <= set(fields):
        return None
    try:
        position, velocity, effort = (_numbers(fields.get(field, [])) for field in FIELDS)
    except ValueError:
        return None
    time = int(stamp[1]) * 1_000_000_000 + int(stamp[2])
    return JointStateMessage(time, 0, tuple(fields["name"]), position, velocity, effort)


def _elements(match: re.Match[str]) -> list[str]:
    """Elements of the list of a field, without quotes."""
    if match[3] is not None:
        return [element.strip("'\" \t\r") for element in ELEMENT.findall(match[3])]
    return [element.strip("'\" \t\r\n") for element in match[2].split(",") if element.strip()]


def _numbers(elements: list[str]) -> FloatArray:
    """Numbers as YAML writes them, `.nan` among them.

    Raises:
        ValueError: An element is no number.
    """
    try:
        return np.array(elements, float)
    except ValueError:
        return np.array([re.sub(r"\.(?=nan|inf)", "", text.lower()) for text in elements], float)


def _is_whole(document: str) -> bool:
    """Return True if a message without a line `---` behind it has all of its values."""
    lengths = {match[1]: len(_elements(match)) for match in FIELD.finditer(document)}
    is_ended = document.endswith(("\n", "}", "]"))
    counts = [lengths.get(field, -1) for field in FIELDS]
    return is_ended and all(count in (0, lengths["name"]) for count in counts)
