"""Columns of CSV files as scripts name them, renamed to `t`, `q.<joint>`, ….

| column | examples |
|---|---|
| time | `time`, `timestamp`, `time_s`, `t [ms]` |
| quantity and joint | `q_elbow`, `elbow_pos`, `elbow/velocity`, `tau[elbow]`, `elbow.effort` |
| quantity and number, by the order of the robot | `q1`, `dq_1`, `tau[0]`, `joint1_torque` |
| quantity alone, of a robot with a single joint | `position`, `torque` |

They are renamed only if all positions and the time are found so. A unit may follow (`q1 [rad]`,
`torque_Nm`); any but SI units is refused, as the names of columns convert no values.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ..errors import UnusableInput
from ..robot.robot import Robot

WORDS = {
    "q": "q",
    "pos": "q",
    "position": "q",
    "dq": "dq",
    "qd": "dq",
    "qdot": "dq",
    "vel": "dq",
    "velocity": "dq",
    "tau": "tau",
    "torque": "tau",
    "effort": "effort",
    "i": "i",
    "current": "i",
    "temp": "temp",
    "temperature": "temp",
}
"""Words for a quantity, with the prefixes of its columns; that of an effort differs by file."""
TIMES = re.compile(r"(?:t|time|timestamp|seconds)(?:[ _]*[\[(]?(s|sec|ms|us|ns)[\])]?)?", re.I)
"""A column of time, with its unit."""
SECONDS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
UNIT = re.compile(
    r"\s*[\[(](?P<bracketed>[^\[\]()]*[^\[\]()\d][^\[\]()]*)[\])]$"
    r"|_(?P<appended>rad|rad_s|rad/s|m_s|m/s|nm|n_m|amps?|deg|deg_s|deg/s|degrees|rpm|mm|ma|mnm)$",
    re.I,
)
"""A unit at the end of a name; a number in brackets is that of a joint."""
SI_UNITS = {
    *("rad", "m", "rad/s", "rad_s", "m/s", "m_s", "nm", "n m", "n·m", "n*m", "n_m", "n"),
    *("a", "amp", "amps", "°c", "degc", "c"),
}
"""Units of columns, in lower case, without a conversion."""
_WORD = "|".join(sorted(WORDS, key=len, reverse=True))
_NUMBERED = re.compile(
    rf"(?P<word>{_WORD})[._ /-]*(?:joint|axis|j)?[._ -]*[\[(]?(?P<number>\d+)[\])]?"
    rf"|(?:joint|axis|j)[._ -]*(?P<first>\d+)[._ /-]+(?P<behind>{_WORD})",
    re.I,
)


@dataclass(frozen=True)
class SpelledColumns:
    """Columns of a file as scripts name them.

    Attributes:
        names: Names of all columns, those of the robot renamed.
        time: Column of time and its factor [s].
        numbered: Names of the positions in the file, of numbered joints; else empty.
    """

    names: tuple[str, ...]
    time: tuple[str, float]
    numbered: tuple[str, ...] = ()


def find_spelled_columns(
    source: str, names: Sequence[str], robot: Robot, effort: str
) -> SpelledColumns | None:
    """Return the columns of a robot by the names that scripts give; None if some are not found.

    Args:
        source: Name of the file, for messages.
        names: Names of all columns.
        robot: Robot whose joints are recorded.
        effort: Prefix of an effort, "tau" for torque or "i" for current.

    Raises:
        UnusableInput: Two columns hold the same quantity of a joint, or one has another unit.
    """
    times = [(name, match) for name in names if (match := TIMES.fullmatch(name.strip()))]
    positions = [f"q.{joint}" for joint in robot.joints]
    if not times or {"t", *positions} <= set(names):
        return None
    time, match = next((entry for entry in times if entry[0] == "t"), times[0])
    joints = [*robot.joints, *(joint.name for joint in robot.locked)]
    places = {name: place for name in names if (place := _of_joint(name, joints, effort))}
    numbered: tuple[str, ...] = ()
    if not set(positions) <= set(places.values()):
        if set(positions) & set(places.values()):
            return None  # the name of another joint is misspelled
        places = _of_number(names, robot.joints, effort)
        if not set(positions) <= set(places.values()):
            return None
        if len(robot.joints) > 1:
            names_of = {place: name for name, place in places.items()}
            numbered = tuple(names_of[place] for place in positions)
    first: dict[str, str] = {}
    for name, place in places.items():
        if first.setdefault(place, name) != name:
            raise UnusableInput(
                f"{source}: columns '{first[place]}' and '{name}' are both {place}; choose one "
                f"with --columns {place}=COLUMN"
            )
        unit = _unit(name)
        if unit and unit not in joints and unit.lower() not in SI_UNITS:
            raise UnusableInput(
                f"{source}: column '{name}' is in {unit}; convert it to SI units and "
                f"name it {place}"
            )
    renamed = tuple(places.get(name, name) for name in names)
    return SpelledColumns(renamed, (time, SECONDS[(match[1] or "s").lower()]), numbered)


def _of_joint(name: str, joints: Sequence[str], effort: str) -> str | None:
    """Return the standard name of a column with the name of a joint; None of any other."""
    for text in (name.strip(), UNIT.sub("", name.strip())):
        for joint in sorted(joints, key=len, reverse=True):
            before, middle, behind = text.partition(joint)
            if middle and not (before and behind.strip("[]()")):
                word = (before or behind).strip("._/ -[]()").lower()
                if word in WORDS:
                    return f"{_prefix(word, effort)}.{joint}"
    return None


def _unit(name: str) -> str:
    """Return the unit at the end of a name, empty without one."""
    match = UNIT.search(name.strip())
    return (match["bracketed"] or match["appended"]).strip() if match else ""


def _of_number(names: Sequence[str], joints: Sequence[str], effort: str) -> dict[str, str]:
    """Return the standard names of columns with numbers, from 0 or 1 to that of the last joint.

    That of a single joint may be missing.
    """
    places: dict[str, tuple[str, int]] = {}
    for name in names:
        text = UNIT.sub("", name.strip())
        match = _NUMBERED.fullmatch(text)
        if len(joints) == 1 and text.lower() in WORDS:
            places[name] = _prefix(text.lower(), effort), 0
        elif match is not None:
            word = (match["word"] or match["behind"]).lower()
            number = int(match["number"] or match["first"])
            places[name] = _prefix(word, effort), number
    numbers = sorted({number for prefix, number in places.values() if prefix == "q"})
    first = numbers[0] if numbers else 0
    if first not in (0, 1) or numbers != list(range(first, first + len(joints))):
        return {}
    return {
        name: f"{prefix}.{joints[number - first]}"
        for name, (prefix, number) in places.items()
        if 0 <= number - first < len(joints)
    }


def _prefix(word: str, effort: str) -> str:
    """Return the prefix of the columns of a quantity."""
    return effort if WORDS[word] == "effort" else WORDS[word]
