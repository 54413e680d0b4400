"""JSON, TOML and YAML files, read within bounds and checked against a schema.

Python's parsers accept content that no valid document holds: files without end, thousands of nested
lists, integers of thousands of digits, NaN and Infinity, repeated keys, YAML aliases that expand to
gigabytes. This module refuses it in one line that names the file and the key. The schema then
checks the values.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
import types
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from ..errors import UnusableInput
from . import quantities
from .quantities import shown

T = TypeVar("T")
Key = str | int
LARGEST_JSON = 1 << 25
"""Largest JSON file [bytes]: 32 MiB. The model of a robot with 60 joints has 15 MB."""
LARGEST_TOML = 1 << 20
"""Largest TOML file [bytes]: 1 MiB. The limits of 60 joints take 20 kB."""
LARGEST_YAML = 1 << 18
"""Largest YAML file [bytes]: 256 KiB, which PyYAML parses in 5 s.

The limits of 60 joints take 30 kB.
"""
DEEPEST = 40
"""Deepest nesting of tables and lists. A trajectory nests 7 deep."""
LONGEST_INTEGER = 19
"""Longest integer [digits]; a longer one becomes a float, which the range of its key refuses."""
MAX_LISTED_KEYS = 12
"""Largest number of keys that a message lists."""


class _Flaw(Exception):
    """A fault of a plain value, with the path of keys to it."""

    def __init__(self, problem: str) -> None:
        super().__init__(problem)
        self.problem = problem
        self.keys: list[Key] = []


@dataclass(frozen=True)
class DocumentFile:
    """A file that should hold a document of one kind.

    Attributes:
        path: The file.
        kind: The kind with its article, for messages: "a trajectory".
        remedy: Advice for a value that does not fit: "design it again".
        origin: File to give instead of one of another kind: "the trajectory.json of
            'excite design'".
    """

    path: Path
    kind: str
    remedy: str
    origin: str

    def error(self, problem: str, where: str = "") -> UnusableInput:
        """Build the error for a value in this file: file, key, problem, remedy."""
        return UnusableInput(f"{self.path}: {where}{': ' if where else ''}{problem}; {self.remedy}")

    def unreadable(self, reason: str) -> UnusableInput:
        """Build the error for a file that is no document of this kind."""
        return UnusableInput(
            f"{self.path}: cannot be read as {self.kind} ({reason}); give {self.origin}"
        )

    def json(self) -> Any:
        """Parse a JSON file to plain values.

        Raises:
            UnusableInput: The file cannot be read, is no strict JSON in UTF-8, or breaks a bound
                of this module.
        """
        return self._parsed(LARGEST_JSON, _json)

    def toml(self) -> Any:
        """Parse a TOML file to plain values; raises as `json` does."""
        return self._parsed(LARGEST_TOML, _toml)

    def yaml(self) -> Any:
        """Parse a YAML file to plain values with keys as texts; raises as `json` does."""
        return self._parsed(LARGEST_YAML, _yaml)

    def schema(self, document: Any, schemas: Sequence[str]) -> str:
        """Return the schema that a document states.

        Raises:
            UnusableInput: It is none of `schemas`.
        """
        stated = document.get("schema") if isinstance(document, dict) else None
        if not isinstance(stated, str) or stated not in schemas:
            problem = f"its schema is {shown(stated)}, not {schemas[0]!r}"
            raise UnusableInput(f"{self.path}: {problem}; give {self.origin}")
        return stated

    def converted(self, document: Any, schema: type[T]) -> T:
        """Convert a plain value to a struct of a schema.

        Raises:
            UnusableInput: The value does not fit the schema.
        """
        try:
            return _converted(document, schema)
        except msgspec.ValidationError as error:
            where, problem = _explained(document, schema, str(error))
            raise self.error(problem, where) from error

    def _parsed(self, largest: int, parse: Callable[[str], Any]) -> Any:
        text = self._text(largest)
        try:
            value = parse(text)
        except _Flaw as flaw:
            raise self.unreadable(flaw.problem) from flaw
        except RecursionError as error:
            raise self.unreadable(f"nested more than {DEEPEST} deep") from error
        try:
            _check(value, 0)
        except _Flaw as flaw:
            raise self.error(flaw.problem, written(flaw.keys)) from flaw
        return value

    def _text(self, largest: int) -> str:
        try:
            with self.path.open("rb") as stream:
                data = stream.read(largest + 1)
        except (OSError, ValueError) as error:  # ValueError: a null byte in the path
            raise self.unreadable(
                str(error.strerror if isinstance(error, OSError) else error)
            ) from error
        if len(data) > largest:
            raise self.unreadable(f"larger than {largest >> 10} KiB")
        try:
            return data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = 1 + data.count(b"\n", 0, error.start)
            raise self.unreadable(f"line {line} is not UTF-8") from error


def written(keys: Sequence[Key]) -> str:
    """Format a path of keys: `limits.velocity.joint_1.value`, `segments[3].start`."""
    out = ""
    for key in keys:
        if isinstance(key, int):
            out += f"[{key}]"
            continue
        plain = re.fullmatch(r"[\w.+/-]{1,80}", key) is not None
        out += ("." if out else "") + (key if plain else shown(key))
    return out


# -- parsing ---------------------------------------------------------------------------------------


def _json(text: str) -> Any:
    try:
        return json.loads(text, object_pairs_hook=_unique, parse_int=_integer, parse_constant=float)
    except json.JSONDecodeError as error:
        raise _Flaw(f"line {error.lineno}, column {error.colno}: {error.msg}") from error


def _integer(text: str) -> int | float:
    return int(text) if len(text) <= LONGEST_INTEGER else float(text)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) < len(pairs):
        seen: set[str] = set()
        for key, _ in pairs:
            if key in seen:
                raise _Flaw(f"the key {shown(key)} occurs twice in one table")
            seen.add(key)
    return out


def _toml(text: str) -> Any:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _Flaw(str(error)) from error
    except ValueError as error:  # of int(), for more than 4300 digits
        raise _Flaw("it has an integer of thousands of digits") from error


def _yaml(text: str) -> Any:
    import yaml

    try:
        return yaml.load(text, _yaml_loader())
    except yaml.YAMLError as error:
        mark, problem = (
            getattr(error, "problem_mark", None),
            getattr(error, "problem", None) or "malformed",
        )
        where = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
        raise _Flaw(f"{where}{problem}") from error
    except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError) as error:
        # PyYAML raises these for a scalar that does not fit its tag, such as !!timestamp x
        raise _Flaw(f"{type(error).__name__}: {shown(str(error))}") from error


def _yaml_loader() -> Any:
    """Build the safe loader without aliases and with keys as texts.

    It knows the tags !degrees and !radians of Universal Robots' own files.
    """
    import yaml

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                event = self.peek_event()
                problem = f"the alias *{event.anchor} is not read, write the value out"
                raise yaml.composer.ComposerError(None, None, problem, event.start_mark)
            return super().compose_node(parent, index)

        def construct_mapping(self, node: Any, deep: bool = False) -> dict[str, Any]:
            if not isinstance(node, yaml.MappingNode):
                raise yaml.constructor.ConstructorError(
                    None, None, "a table is needed here", node.start_mark
                )
            out: dict[str, Any] = {}
            for key, value in node.value:
                if not isinstance(key, yaml.ScalarNode):
                    raise yaml.constructor.ConstructorError(
                        None, None, "a key should be a text", key.start_mark
                    )
                if key.value in out:
                    raise _Flaw(f"the key {shown(key.value)} occurs twice in one table")
                out[key.value] = self.construct_object(value, deep=True)
            return out

    def angle(unit: float) -> Callable[[Any, Any], float]:
        return lambda loader, node: unit * float(loader.construct_scalar(node))

    Loader.add_constructor(
        "tag:yaml.org,2002:map", lambda loader, node: loader.construct_mapping(node)
    )
    Loader.add_constructor("!degrees", angle(math.pi / 180.0))
    Loader.add_constructor("!radians", angle(1.0))
    return Loader


def _check(value: Any, depth: int) -> None:
    """Raise _Flaw for a plain value that no document holds."""
    if isinstance(value, float):
        if not math.isfinite(value):
            raise _Flaw("the number is not finite, or too large")
    elif isinstance(value, str):
        _check_text(value, "the text")
    elif isinstance(value, dict | list):
        if depth >= DEEPEST:
            raise _Flaw(f"is nested more than {DEEPEST} deep")
        items: Any = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            if isinstance(key, str):
                _check_key(key)
            try:
                _check(item, depth + 1)
            except _Flaw as flaw:
                flaw.keys.insert(0, key)
                raise
    elif isinstance(value, int) and value.bit_length() > 63:
        raise _Flaw(f"{shown(value)} is too large")


def _check_key(key: str) -> None:
    if len(key) > quantities.LONGEST_NAME:
        raise _Flaw(f"a key has {len(key)} characters, more than {quantities.LONGEST_NAME}")
    if (control := quantities.unprintable(key)) is not None:
        raise _Flaw(f"the key {shown(key)} has the control character U+{ord(control):04X}")
    _check_text(key, "a key")


def _check_text(text: str, what: str) -> None:
    if (half := re.search("[\ud800-\udfff]", text)) is not None:
        raise _Flaw(f"{what} has the half character U+{ord(half[0]):04X}, which cannot be written")


# -- errors of the schema --------------------------------------------------------------------------


def _converted(document: Any, schema: type[T]) -> T:
    return msgspec.convert(document, schema, dec_hook=quantities.converted)


_WORDS = {
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "str": "a text",
    "object": "a table",
    "array": "a list",
    "null": "null",
}
"""Descriptions of the types in msgspec's messages."""


_PROBLEMS: tuple[tuple[str, Callable[[re.Match[str], Any, Any], str]], ...] = (
    (r"Object missing required field `(.*)`", lambda match, value, kind: f"has no '{match[1]}'"),
    (
        r"Object contains unknown field `(.*)`",
        lambda match, value, kind: f"has the unknown key {shown(match[1])}{_alternatives(kind)}",
    ),
    (
        r"Invalid enum value .*",
        lambda match, value, kind: (
            f"{shown(value)} is none of {', '.join(map(str, typing.get_args(kind)))}"
        ),
    ),
    (
        r"Expected `array` of length (\d+).*",
        lambda match, value, kind: f"should hold {match[1]} values, not {len(value)}",
    ),
    (
        r"Expected `([^`]*)`.*",
        lambda match, value, kind: f"{shown(value)} should be {_in_words(match[1])}",
    ),
)
"""Patterns of msgspec's messages, each with a function that formats ours from value and type."""


def _explained(document: Any, schema: type, message: str) -> tuple[str, str]:
    """Return key and problem of an error of msgspec, "<problem> - at `$.a[...].b[0]`"."""
    problem, _, path = message.rpartition(" - at `") if " - at `" in message else (message, "", "")
    keys = _keys(document, schema, message, re.findall(r"\.([^.\[`]+)|\[(\d+|\.\.\.)\]", path))
    where, value = written(keys), document
    for key in keys:
        value = value[key]
    for pattern, words in _PROBLEMS:
        if match := re.fullmatch(pattern, problem, re.DOTALL):
            return where, words(match, value, _type_at(schema, keys))
    if match := re.fullmatch(
        r"(\w+(?:\.\w+|\[\d+\])*): (.*)", problem, re.DOTALL
    ):  # a struct's own check names a key in it
        return (f"{where}." if where else "") + match[1], match[2]
    return where, problem


def _in_words(types_of_msgspec: str) -> str:
    return " or ".join(_WORDS.get(name, name) for name in types_of_msgspec.split(" | "))


def _keys(document: Any, schema: type, message: str, parts: Sequence[tuple[str, str]]) -> list[Key]:
    """Return the path of keys to the value of an error.

    msgspec writes `[...]` for any key of a table with free keys.
    """
    keys: list[Key] = []
    for name, index in parts:
        if index == "...":
            keys.append(_faulty_key(document, schema, message, keys))
        else:
            keys.append(name or int(index))
    return keys


def _faulty_key(document: Any, schema: type, message: str, keys: Sequence[Key]) -> str:
    """Find the key of the table at `keys` whose value is refused.

    It is the first key without which the same error does not arise, found by bisection.
    """
    table = document
    for key in keys:
        table = table[key]
    names = list(table)
    low, high = 0, len(names) - 1
    while low < high:
        middle = (low + high) // 2
        part = {name: table[name] for name in names[: middle + 1]}
        try:
            _converted(_replaced(document, keys, part), schema)
            recurs = False
        except msgspec.ValidationError as error:
            recurs = str(error) == message
        low, high = (low, middle) if recurs else (middle + 1, high)
    return str(names[low])


def _replaced(document: Any, keys: Sequence[Key], value: Any) -> Any:
    """Copy a plain value with another value at a path of keys."""
    if not keys:
        return value
    out: Any = dict(document) if isinstance(document, dict) else list(document)
    out[keys[0]] = _replaced(document[keys[0]], keys[1:], value)
    return out


def _type_at(schema: Any, keys: Sequence[Key]) -> Any:
    """Return the type that a schema has at a path of keys; None if it is unknown."""
    for key in keys:
        schema = _without_null(schema)
        if isinstance(schema, type) and issubclass(schema, msgspec.Struct):
            schema = next(
                (
                    field.type
                    for field in msgspec.structs.fields(schema)
                    if field.encode_name == key
                ),
                None,
            )
            continue
        arguments = typing.get_args(schema)
        if not arguments:
            return None
        if isinstance(key, str):
            schema = arguments[1]
            continue
        schema = arguments[key] if typing.get_origin(schema) is tuple else arguments[0]
    return _without_null(schema)


def _without_null(schema: Any) -> Any:
    """Return the first alternative of a union that is not null; other types unchanged."""
    if typing.get_origin(schema) in (typing.Union, types.UnionType):
        return next(
            part
            for part in typing.get_args(schema)
            if part not in (types.NoneType, msgspec.UnsetType)
        )
    return schema


def _alternatives(schema: Any) -> str:
    """List the keys of a struct for a message."""
    if not (isinstance(schema, type) and issubclass(schema, msgspec.Struct)):
        return ""
    names = [field.encode_name for field in msgspec.structs.fields(schema)]
    return f"; it may have {', '.join(names)}" if len(names) <= MAX_LISTED_KEYS else ""
