"""Columns of CSV files as scripts name them, renamed to `t`, `q.<joint>`, ….

| column | examples |
|---|---|
| time | `time`, `timestamp`, `stamp`, `elapsed_time`, `time_s`, `t [ms]`, `time (millisec)` |
| quantity and joint | `q_elbow`, `elbow_pos`, `elbow/velocity`, `tau[elbow]`, `eff_elbow` |
| quantity and number, by the order of the robot | `q1`, `dq_1`, `tau[0]`, `joint1_torque` |
| commanded position | `goal_position_elbow`, `q_ref_1`, `elbow_target_pos`, `cmd_pos[0]` |
| quantity alone, of a robot with a single joint | `position`, `torque`, `q_current` |
| the same behind a topic | `/joint_states/elbow/position`, `joint_states.effort.elbow` |

They are renamed only if all positions and the time are found so, all behind the same topic. A unit
may follow (`q1 [rad]`, `torque_Nm`) or stand behind the quantity (`current_A_elbow`); any but SI
units is refused, as the names of columns convert no values.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from ..errors import UnusableInput
from ..robot.parameter_names import plural
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
    "eff": "effort",
    "i": "i",
    "cur": "i",
    "current": "i",
    "temp": "temp",
    "temperature": "temp",
    "angle": "q",
    "iq": "i",
    "i_q": "i",
    "q_current": "i",
}
"""Words for a quantity, with the prefixes of its columns; that of an effort differs by file."""
STATE_WORDS = {
    f"{state}_{word}": prefix
    for state in ("present", "measured", "feedback")
    for word, prefix in {
        **{"pos": "q", "position": "q", "angle": "q", "vel": "dq", "velocity": "dq"},
        **{"torque": "tau", "current": "i", "temperature": "temp"},
    }.items()
}
"""Words of servos for a measured quantity."""
WORDS |= STATE_WORDS
COMMAND_WORDS = frozenset(
    f"{first}{mark}{second}"
    for command in (
        *("goal", "target", "desired", "des", "commanded", "command", "cmd"),
        *("reference", "ref", "setpoint"),
    )
    for position in ("q", "pos", "position", "angle")
    for first, second in ((command, position), (position, command))
    for mark in ("_", "")
)
"""Words for a commanded position: a file may have several, of which none is read."""
WORDS |= dict.fromkeys(COMMAND_WORDS, "qref")
SECOND_WORDS = {"angle", "iq", "i_q", "q_current", *STATE_WORDS}
"""Words that are read only where no other column holds their quantity, or a torque instead of the
current: angles of other sensors, or several currents of a motor, may stand next to it."""
SECONDS = {
    **{"s": 1.0, "sec": 1.0, "seconds": 1.0},
    **{"ms": 1e-3, "msec": 1e-3, "millis": 1e-3, "millisec": 1e-3, "milliseconds": 1e-3},
    **{"us": 1e-6, "micros": 1e-6, "microseconds": 1e-6, "ns": 1e-9, "nanoseconds": 1e-9},
}
"""Spellings of units of time, with their seconds."""
NO_JOINT = "\0"
"""Name of the joint of a file whose columns hold none; no name contains it."""
_TIME_UNIT = rf"(?:[ _]*[\[(]?({'|'.join(SECONDS)})[\])]?)?"
TIMES = tuple(
    re.compile(names + _TIME_UNIT, re.I)
    for names in (
        "(?:t|time|timestamp|seconds)",
        "(?:(?:header[./])?stamp|time[ _]stamp|elapsed(?:[ _]?time)?)",
    )
)
"""A column of time, with its unit, and names that are taken where there is none of the first: the
stamp of a message, or the duration of a loop, may stand next to the time."""
SI_UNITS = {
    "q": {"rad", "m"},
    "qref": {"rad", "m"},
    "dq": {"rad/s", "m/s"},
    "tau": {"N m", "N"},
    "i": {"A"},
    "temp": {"°C"},
}
"""SI units of each quantity."""
SPELLINGS = {
    **{"rad": "rad", "rad/s": "rad/s", "rad_s": "rad/s", "m": "m", "m/s": "m/s", "m_s": "m/s"},
    **{"nm": "N m", "n m": "N m", "n_m": "N m", "n·m": "N m", "n*m": "N m", "n": "N"},
    **{"a": "A", "amp": "A", "amps": "A", "c": "°C", "°c": "°C", "degc": "°C"},
}
"""Spellings of SI units, in lower case."""
OTHER_UNITS = (
    *("deg", "deg_s", "deg/s", "degrees", "°", "°/s", "mrad", "rpm", "mm", "mm_s", "mm/s"),
    *("ma", "nmm", "n mm", "n*mm", "mnm", "knm", "kn"),
)
"""Spellings of other units in lower case, as behind an underscore; in brackets there may be any."""
_APPENDED = "|".join(map(re.escape, sorted((*SPELLINGS, *OTHER_UNITS), key=len, reverse=True)))
UNIT = re.compile(
    r"\s*[\[(](?P<bracketed>[^\[\]()]*[^\[\]()\d][^\[\]()]*)[\])]$"
    rf"|_(?P<appended>{_APPENDED})$",
    re.I,
)
"""A unit at the end of a name; a number in brackets is that of a joint."""
_WORD = "|".join(sorted(WORDS, key=len, reverse=True))
_INNER_UNIT = "a|amps?|nm|rad|rad_s|rad/s|deg|deg_s|deg/s|degrees|rpm|ma|mnm"
"""Units between a quantity and a joint. Those of a single letter may be a part of another name, as
the motor position `q_m`; `A` is one behind a current alone."""
WORD_AND_UNIT = re.compile(rf"(?P<word>{_WORD})[ _]?[\[(]?(?P<unit>{_INNER_UNIT})[\])]?", re.I)
"""A quantity with its unit, in front of or behind a joint."""
_NUMBERED = re.compile(
    rf"(?P<word>{_WORD})(?:[ _]?[\[(]?(?P<unit>{_INNER_UNIT})[\])]?(?=[._ /|-]))?"
    r"[._ /|-]*(?:joint|axis|j)?[._ -]*[\[(]?(?P<number>\d+)[\])]?"
    rf"|(?:joint|axis|j)[._ -]*(?P<first>\d+)[._ /|-]+(?P<behind>{_WORD})",
    re.I,
)
KNOWN_ELSEWHERE = re.compile(
    r"__time|%time|field\..*|(?:.*[./])?(?:name|position|velocity)s?|actual_\w+|header[./].*"
)
"""Columns of other programs, see `export_formats`, and of Universal Robots' RTDE."""
NUMBERED_FIELD = re.compile(rf".*[./](?:{_WORD})[._]?[\[(]?\d+[\])]?", re.I)
"""Column of a quantity with a number, behind a topic."""

COMMANDED = re.compile(
    r"(?:^|[._/ -])(?:command(?:ed|s)?|cmd|target|desired|des|qd|reference|ref|setpoint|goal)[._/]",
    re.I,
)
"""Topic whose name says that its positions are commanded and not measured."""

Numbers: TypeAlias = Mapping[str, Mapping[int, str]]
"""Names of columns by the prefix of their quantity and their number."""


@dataclass(frozen=True)
class SpelledColumns:
    """Columns of a file as scripts name them.

    Attributes:
        names: Names of all columns, those of the robot renamed.
        time: Column of time and its factor [s].
        numbered: Names of the positions in the file, of joints that are known by their numbers
            alone; else empty.
    """

    names: tuple[str, ...]
    time: tuple[str, float]
    numbered: tuple[str, ...] = ()


def has_standard_names(names: Iterable[str], robot: Robot) -> bool:
    """Return True if columns with standard names hold the time and all positions."""
    return {"t", *(f"q.{joint}" for joint in robot.joints)} <= set(names)


def find_spelled_columns(
    source: str, names: Sequence[str], robot: Robot, effort: str, topic: str | None = None
) -> SpelledColumns | None:
    """Return the columns of a robot by the names that scripts give; None if some are not found.

    Args:
        source: Name of the file, for messages.
        names: Names of all columns.
        robot: Robot whose joints are recorded.
        effort: Prefix of an effort, "tau" for torque or "i" for current.
        topic: Topic in front of the names, as `/joint_states`; None: that which has all positions.

    Raises:
        UnusableInput: Two columns hold the same quantity of a joint, two topics all positions, or
            a column has another unit.
    """
    if has_standard_names(names, robot):
        return None
    columns = _find_columns(source, names, robot, effort)
    if columns is not None:
        return columns
    by_topic: dict[str, SpelledColumns] = {}
    for prefix in _topics(names, robot):
        if topic is None or prefix[:-1] == topic:
            columns = _find_columns(source, _bare(names, prefix), robot, effort)
            by_topic |= {} if columns is None else {prefix: columns}
    if len(by_topic) > 1:
        first, second = (prefix[:-1] for prefix in list(by_topic)[:2])
        raise UnusableInput(
            f"{source}: '{first}' and '{second}' both hold the positions; choose one with "
            f'"topic": "{first}" in the recording\'s .json file'
        )
    for prefix, columns in by_topic.items():
        if topic is None and COMMANDED.search(prefix):
            raise UnusableInput(
                f"{source}: '{prefix[:-1]}' alone holds all positions, and by its name they are "
                f"commanded; name measured ones with --columns q.{robot.joints[0]}=COLUMN,…, or "
                f'choose it with "topic": "{prefix[:-1]}" in the recording\'s .json file'
            )
        original = dict(zip(_bare(names, prefix), names, strict=True))
        return replace(columns, numbered=tuple(original[name] for name in columns.numbered))
    return None


def _topics(names: Sequence[str], robot: Robot) -> list[str]:
    """Return the beginnings of as many columns as there are joints, up to a slash or a point."""
    ours = [
        name
        for name in names
        if any(joint in name for joint in robot.joints) or NUMBERED_FIELD.fullmatch(name)
    ]
    counts = Counter(name[: mark.end()] for name in ours for mark in re.finditer(r"[/.]", name))
    return sorted(prefix for prefix, count in counts.items() if count >= robot.n)


def _bare(names: Sequence[str], topic: str) -> list[str]:
    """Return names without a topic; those that are another column's name then keep it."""
    bare = [name.removeprefix(topic) for name in names]
    counts = Counter(bare)
    return [name if counts[short] > 1 else short for name, short in zip(names, bare, strict=True)]


def _find_columns(
    source: str, names: Sequence[str], robot: Robot, effort: str
) -> SpelledColumns | None:
    """Return the columns of a robot whose names have no topic; see `find_spelled_columns`."""
    times = time_columns(names)
    positions = [f"q.{joint}" for joint in robot.joints]
    if not times:
        return None
    time = next((name for name, _ in times if name == "t"), times[0][0])
    joints = [*robot.joints, *(joint.name for joint in robot.locked)]
    candidates = _without_second_words(names, joints, effort)
    places = {name: place for name in candidates if (place := _of_joint(name, joints, effort))}
    numbered: tuple[str, ...] = ()
    columns = {column for column, _ in places.values()}
    if not set(positions) <= columns:
        if set(positions) & columns:
            return None  # the name of another joint is misspelled
        # a log of all joints has numbers of those that are locked as well
        joints = [*robot.joints]
        if not (places := _of_number(candidates, joints, effort)):
            joints = [*robot.all_joints] or joints
            places = _of_number(candidates, joints, effort)
        numbers = _numbers(_read_numbers(candidates, joints, effort))
        if places and (fault := surplus_fault(numbers, len(joints))):
            raise UnusableInput(f"{source}: {fault}; {surplus_remedy(robot)}")
        names_of = {column: name for name, (column, _) in places.items()}
        if not set(positions) <= set(names_of):
            return None
        ordered = tuple(names_of[column] for column in positions)
        if len(joints) > 1 and not all(map(holds_name, ordered, robot.joints)):
            numbered = ordered
    places = distinct_columns(source, names, places)
    renamed = tuple(places[name][0] if name in places else name for name in names)
    return SpelledColumns(renamed, (time, seconds(time)), numbered)


def time_columns(names: Sequence[str]) -> list[tuple[str, re.Match[str]]]:
    """Return the columns of time and the matches of their units, the preferred first."""
    return [
        (name, match) for kind in TIMES for name in names if (match := kind.fullmatch(name.strip()))
    ]


def _without_second_words(names: Sequence[str], joints: Sequence[str], effort: str) -> list[str]:
    """Return the names without those of SECOND_WORDS next to another column of their quantity.

    A current is not needed next to a torque. Of several kinds of commanded positions none is known
    to be that which the controller tracks.
    """
    readings = {name: _readings(name, joints) for name in names}
    words = {name: either[0].word for name, either in readings.items() if either}
    commands = {name: word for name, word in words.items() if word in COMMAND_WORDS}
    if len({*commands.values()}) > 1:
        names = [name for name in names if name not in commands]
    others = [name for name in names if words.get(name) not in SECOND_WORDS]
    known = {reading.prefix(effort) for name in others for reading in readings[name]}
    if "tau" in known:
        known.add("i")
    return [
        name
        for name in names
        if words.get(name) not in SECOND_WORDS or WORDS[words[name]] not in known
    ]


def columns_of_one_joint(names: Sequence[str], effort: str) -> dict[str, tuple[str, str]]:
    """Return the prefixes of columns whose names hold no joint and no number, and their units.

    Args:
        names: Names of all columns, as `position` or `torque [Nm]`.
        effort: Prefix of an effort, "tau" for torque or "i" for current.
    """
    candidates = _without_second_words(names, (NO_JOINT,), effort)
    readings = {name: _read_number(name, is_single=True) for name in candidates}
    return {
        name: (reading.prefix(effort), reading.unit)
        for name, reading in readings.items()
        if reading is not None and reading.number is None
    }


def distinct_columns(
    source: str, names: Sequence[str], places: Mapping[str, tuple[str, str]]
) -> dict[str, tuple[str, str]]:
    """Return columns without further ones of the same quantity, all in SI units.

    A column with the standard name, as of --columns, precedes, then one in SI units.

    Args:
        source: Name of the file, for messages.
        names: Names of all columns.
        places: Standard names and units of columns.

    Raises:
        UnusableInput: Two columns hold the same quantity, or one is in another unit.
    """
    places = _in_si_units(
        {name: place for name, place in places.items() if name == place[0] or place[0] not in names}
    )
    first: dict[str, str] = {}
    for name, (column, unit) in places.items():
        if first.setdefault(column, name) != name:
            remedy = f"choose one with --columns {column}=COLUMN"
            raise UnusableInput(
                f"{source}: columns '{first[column]}' and '{name}' are both {column}; "
                f"{remedy if '.' in column else 'rename the other'}"
            )
        if not _is_si(column, unit):
            raise _other_unit(source, name, column, unit)
    return places


def check_unit(source: str, column: str, name: str) -> None:
    """Check that the name of a column that a user gives for a standard one states no other unit.

    Args:
        source: Name of the file, for messages.
        column: Standard name, as `i.elbow`.
        name: Name in the file.

    Raises:
        UnusableInput: It ends in a unit other than of SI.
    """
    match = UNIT.search(name)
    quantity = column.partition(".")[0]
    if match is None or quantity not in SI_UNITS:
        return
    unit = match["bracketed"] or match["appended"]
    if not _is_si(column, unit) and unit.lower() in OTHER_UNITS:
        raise _other_unit(source, name, column, unit)


def seconds(name: str) -> float:
    """Return the unit of a column of time, which its name may state, 1 without one [s]."""
    match = next((match for _, match in time_columns([name])), None)
    return SECONDS[(match[1] or "s").lower()] if match else 1.0


def _other_unit(source: str, name: str, column: str, unit: str) -> UnusableInput:
    """Return the error of a column that is not in SI units."""
    expected = " or ".join(sorted(SI_UNITS[column.partition(".")[0]], reverse=True))
    return UnusableInput(
        f"{source}: column '{name}' is in {unit}; convert it to SI units, {expected}, and name it "
        f"{column}"
    )


def _is_si(column: str, unit: str) -> bool:
    """Return True if the unit of a standard column is that of SI, or not stated."""
    return not unit or SPELLINGS.get(unit.lower()) in SI_UNITS[column.partition(".")[0]]


def _in_si_units(places: Mapping[str, tuple[str, str]]) -> dict[str, tuple[str, str]]:
    """Return columns without those in another unit next to the same in SI units."""
    stated = {column for column, unit in places.values() if _is_si(column, unit)}
    return {
        name: (column, unit)
        for name, (column, unit) in places.items()
        if _is_si(column, unit) or column not in stated
    }


def unread_columns(names: Sequence[str], joints: Sequence[str]) -> list[str]:
    """Return the columns that hold no known quantity of a joint and no time.

    Args:
        names: Names of all columns.
        joints: Names of the joints.
    """
    known = (*(f"{prefix}." for prefix in SI_UNITS), "qlink.", "base.", "wrench.")
    return [
        name for name in names if name and not name.startswith(known) and not _is_read(name, joints)
    ]


def _is_read(name: str, joints: Sequence[str]) -> bool:
    """Return True for a time, a column of a joint, and a position or velocity behind a topic."""
    if time_columns([name]) or KNOWN_ELSEWHERE.fullmatch(name) or _of_joint(name, joints, "tau"):
        return True
    if name in _read_numbers([name], joints, "tau"):
        return True
    for mark in re.finditer(r"[/.]", name):
        bare = name[mark.end() :]
        place = _of_joint(bare, joints, "tau")
        prefix = place[0].partition(".")[0] if place else None
        prefix = prefix or _read_numbers([bare], joints, "tau").get(bare, (None,))[0]
        if time_columns([bare]) or prefix in ("q", "dq"):
            return True
    return False


def standard_names(names: Sequence[str], robot: Robot) -> set[str]:
    """Return the standard names of all columns that are known by any spelling.

    Args:
        names: Names of all columns.
        robot: Robot whose joints are recorded.
    """
    by_name = {place[0] for name in names if (place := _of_joint(name, robot.joints, "tau"))}
    by_number = {column for column, _ in _of_number(names, robot.joints, "tau").values()}
    return {*names, *(by_name or by_number)}


@dataclass(frozen=True)
class _Reading:
    """A name of a column, taken apart.

    Attributes:
        word: Word for its quantity, a key of WORDS.
        unit: Its unit, empty without one.
        joint: Name of the joint in it; None: it has a number instead, or neither.
        number: Number in it; None without one.
    """

    word: str
    unit: str
    joint: str | None = None
    number: int | None = None

    def prefix(self, effort: str) -> str:
        """Return the prefix of the columns of the quantity; `effort` is that of an effort."""
        return effort if WORDS[self.word] == "effort" else WORDS[self.word]


def _readings(name: str, joints: Sequence[str]) -> list[_Reading]:
    """Return the ways in which a name can be read: by the name of a joint, by a number."""
    return [
        reading
        for reading in (_read_joint(name, joints), _read_number(name, is_single=len(joints) == 1))
        if reading is not None
    ]


def _read_joint(name: str, joints: Sequence[str]) -> _Reading | None:
    """Take the name of a column of a joint apart; None of others.

    A name that is complete without a unit has none, as that of a joint may end like a unit.
    """
    complete = name.strip()
    for text, unit in ((complete, ""), (UNIT.sub("", complete), _unit_behind(complete))):
        for joint in sorted(joints, key=len, reverse=True):
            before, middle, behind = text.partition(joint)
            if not middle or (before and behind.strip("[]()")):
                continue
            word = (before or behind).strip("._/| -[]()").lower()
            if word in WORDS:
                return _Reading(word, unit, joint)
            inner = WORD_AND_UNIT.fullmatch((before or behind).strip("._/| -"))
            if inner is not None and not unit and _is_unit(inner):
                return _Reading(inner["word"].lower(), inner["unit"], joint)
    return None


def _read_number(name: str, *, is_single: bool) -> _Reading | None:
    """Take the name of a column with a quantity and a number apart; None of others.

    A single joint needs no number, except for a current `i`, which may be the number of a row.
    """
    complete = name.strip()
    text, unit = UNIT.sub("", complete), _unit_behind(complete)
    match = _NUMBERED.fullmatch(text)
    if match is not None:
        if not _is_unit(match):
            return None
        word, number = match["word"] or match["behind"], match["number"] or match["first"]
        return _Reading(word.lower(), unit or match["unit"] or "", number=int(number))
    if is_single and text.lower() in WORDS and complete.lower() != "i":
        return _Reading(text.lower(), unit)
    return None


def _is_unit(match: re.Match[str]) -> bool:
    """Return False for a letter `a` between a quantity and a joint that is no unit.

    It is one behind a current alone, and a part of the name in `q_a_elbow` and `torque_A_1`.
    """
    is_current = WORDS.get((match["word"] or "").lower()) in ("i", "effort")
    return (match["unit"] or "").lower() != "a" or is_current


def _unit_behind(name: str) -> str:
    """Return the unit at the end of a name, empty without one."""
    match = UNIT.search(name)
    return (match["bracketed"] or match["appended"]).strip() if match else ""


def _of_joint(name: str, joints: Sequence[str], effort: str) -> tuple[str, str] | None:
    """Return the standard name of a column with the name of a joint, and its unit; None of others.

    The unit is empty without one.
    """
    reading = _read_joint(name, joints)
    if reading is None:
        return None
    return f"{reading.prefix(effort)}.{reading.joint}", reading.unit


def are_joint_numbers(numbers: Iterable[int], n: int) -> bool:
    """Return True if numbers are those of n joints, from 0 or 1."""
    return sorted(numbers) in (list(range(n)), list(range(1, n + 1)))


def number_fault(numbers: Sequence[int], robot: Robot) -> str:
    """State why the numbers of positions are not those of the joints; empty where they are.

    Args:
        numbers: Sorted numbers of the positions of a file.
        robot: Robot whose joints are recorded.
    """
    if len(numbers) != robot.n:
        of_many = f"{len(numbers)} joints without their names"
        named = "1 joint without its name" if len(numbers) == 1 else of_many
        moving = f"{plural(robot.n, 'joint')} of the robot"
        verb = "moves" if robot.n == 1 else "move"
        return f"has the positions of {named}, but {moving} {verb}"
    if are_joint_numbers(numbers, robot.n):
        return ""
    return (
        f"its positions have the numbers {', '.join(map(str, numbers))}, neither 0 to "
        f"{robot.n - 1} nor 1 to {robot.n}"
    )


def numbers_of_positions(names: Sequence[str], robot: Robot) -> list[int]:
    """Return the sorted numbers of columns of positions; empty if a column names a joint.

    Args:
        names: Names of all columns.
        robot: Robot whose joints are recorded.
    """
    if any(name.startswith("q.") or _of_joint(name, robot.joints, "tau") for name in names):
        return []
    read = _read_numbers(names, robot.joints, "tau").values()
    return sorted({number for prefix, number in read if prefix == "q" and number is not None})


def _of_number(
    names: Sequence[str], joints: Sequence[str], effort: str
) -> dict[str, tuple[str, str]]:
    """Return the standard names and units of columns with numbers.

    Numbers start from 0 or 1, those of each quantity for themselves.
    """
    readings = {
        name: reading
        for name in names
        if (reading := _read_number(name, is_single=len(joints) == 1))
    }
    columns = _numbers(_read_numbers(names, joints, effort))
    if "q" in columns and not are_joint_numbers(columns["q"], len(joints)):
        return {}
    firsts = first_numbers(columns, len(joints))
    places = dict[str, tuple[str, str]]()
    for name, reading in readings.items():
        prefix = reading.prefix(effort)
        place = 0 if reading.number is None else reading.number - firsts[prefix]
        if 0 <= place < len(joints):
            places[name] = f"{prefix}.{joints[place]}", reading.unit
    return places


def first_numbers(columns: Numbers, n: int) -> dict[str, int]:
    """Return the number of the first joint in the columns of each quantity.

    Numbers start from 0 or 1, those of each quantity for itself; those of fewer columns than there
    are joints start like those of the positions.

    Args:
        columns: Columns by quantity and number, those of positions complete.
        n: Number of joints.
    """
    first = min(columns.get("q", {0: ""}))
    return {
        prefix: min(used) if are_joint_numbers(used, n) else first
        for prefix, used in columns.items()
    }


def surplus_fault(columns: Numbers, n: int) -> str:
    """State which columns have numbers that are those of no joint; empty if there are none.

    Columns of temperatures and commanded positions are no fault: more than those of the joints may
    be recorded.

    Args:
        columns: Columns by quantity and number, those of positions complete.
        n: Number of joints.
    """
    positions = columns.get("q", {})
    for prefix, first in first_numbers(columns, n).items():
        used = columns[prefix]
        surplus = [used[k] for k in sorted(used) if not first <= k < first + n]
        if not surplus or not positions or prefix in ("temp", "qref"):
            continue
        return (
            f"has {_span(used)} but {_span(positions)}; no position has the number of "
            f"{', '.join(map(repr, surplus))}"
        )
    return ""


def surplus_remedy(robot: Robot) -> str:
    """Return the remedy of `surplus_fault`."""
    joint = robot.joints[0]
    return (
        "remove columns that are of no joint of the robot, or name all with --columns "
        f"t=COLUMN,q.{joint}=COLUMN,…,tau.{joint}=COLUMN,…"
    )


def _span(columns: Mapping[int, str]) -> str:
    """Return the number of columns with their first and last name."""
    if len(columns) == 1:
        return f"the column '{columns[min(columns)]}'"
    return f"{len(columns)} columns '{columns[min(columns)]}' to '{columns[max(columns)]}'"


def _numbers(read: Mapping[str, tuple[str, int | None]]) -> Numbers:
    """Return the columns of `_read_numbers` that have numbers, by quantity and number."""
    columns: dict[str, dict[int, str]] = {}
    for name, (prefix, number) in read.items():
        if number is not None:
            columns.setdefault(prefix, {})[number] = name
    return columns


def _read_numbers(
    names: Sequence[str], joints: Sequence[str], effort: str
) -> dict[str, tuple[str, int | None]]:
    """Return the prefix and the number of each column with a quantity and a number.

    The number is None for a quantity alone, of a single joint.
    """
    readings = {name: _read_number(name, is_single=len(joints) == 1) for name in names}
    return {
        name: (reading.prefix(effort), reading.number)
        for name, reading in readings.items()
        if reading is not None
    }


def holds_name(column: str, joint: str) -> bool:
    """Return True if a column with a number holds the name of a joint, as `q1` that of `q1`.

    Separators and capital letters do not count: `q_joint1` holds `joint_1`, and `q_joint2` none.
    """
    text, name = (re.sub(r"[\W_]", "", t).lower() for t in (UNIT.sub("", column.strip()), joint))
    return text.startswith(name) or text.endswith(name)
