"""Mutations of documents: a valid one with one to three changes, as JSON or TOML text."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Iterator
from typing import Any

from hypothesis import strategies as st

Key = str | int
NUMBERS = (
    0,
    -1,
    1,
    3,
    0.5,
    -2.5,
    1e-300,
    1e-9,
    1e6,
    1e308,
    -1e308,
    math.nan,
    math.inf,
    -math.inf,
    10**18,
    10**400,
    -(10**5000 - 1),
)
OTHERS = (
    True,
    False,
    "",
    "x",
    "joint_1",
    "a\nb",
    "\x1b[31m",
    "\u202e\u00e9",
    "$x$ <b> & \" ' {} %",
    "y" * 5000,
    [],
    [1],
    [0.0, 0.0, 0.0],
)
TABLES = ({}, {"a": 1}, [{}], [[]], [[0.0] * 3] * 3)
ONLY_JSON = (None, "\ud800")
"""Values that TOML cannot state."""


RENAMED = ("x", "", "joint_9", "\u00e9", "a\nb")


def paths(value: Any, path: tuple[Key, ...] = ()) -> Iterator[tuple[Key, ...]]:
    """Return the paths of all values in a document, except the document itself."""
    items: Any = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, item in items:
        yield (*path, key)
        yield from paths(item, (*path, key))


def at(document: Any, path: tuple[Key, ...]) -> Any:
    for key in path:
        document = document[key]
    return document


def replacements(value: Any, others: tuple[Any, ...]) -> st.SearchStrategy[Any]:
    """Return replacements of a value: of any type, and similar numbers and lists."""
    near: list[Any] = []
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300:
        near = [
            -value,
            2 * value,
            0.5 * value,
            1e6 * value,
            1e-6 * value,
            value * (1 + 1e-3),
            int(value),
        ]
    elif isinstance(value, list):
        near = [value[:-1], value + value[-1:], value[::-1], value * 2]
    elif isinstance(value, str):
        near = [value.upper(), value + " ", value + "\n", value[1:]]
    usual = st.sampled_from((*NUMBERS, *OTHERS, *TABLES, *others))
    return st.one_of(st.sampled_from(near), usual) if near else usual


@st.composite
def mutated(draw: st.DrawFn, document: dict[str, Any], *, toml: bool = False) -> str:
    """Return a document with one to three values deleted, replaced, renamed or added, as text."""
    out = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 3))):
        every = list(paths(out))
        if not every:
            break
        # draw the depth first, so that shallow values are as probable as deep ones
        depth = draw(st.sampled_from(sorted({len(path) for path in every})))
        path = draw(st.sampled_from([path for path in every if len(path) == depth]))
        place, key = at(out, path[:-1]), path[-1]
        match draw(st.sampled_from(["replace", "replace", "replace", "delete", "rename", "add"])):
            case "delete":
                del place[key]
            case "rename" if isinstance(place, dict):
                place[draw(st.sampled_from((*RENAMED, str(key).upper())))] = place.pop(key)
            case "add" if isinstance(place, dict):
                name = draw(st.sampled_from(["x", "joint_9", "schema", "velocity"]))
                place[name] = copy.deepcopy(draw(replacements(None, () if toml else ONLY_JSON)))
            case _:
                place[key] = copy.deepcopy(
                    draw(replacements(place[key], () if toml else ONLY_JSON))
                )
    return in_toml(out) if toml else in_json(out)


def in_json(value: Any) -> str:
    """Return JSON with NaN, Infinity and integers of any length."""
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(f"{json.dumps(str(key))}: {in_json(item)}" for key, item in value.items())
            + "}"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(in_json, value)) + "]"
    return long_digits(value) or json.dumps(value)


def in_toml(document: dict[str, Any]) -> str:
    """Return TOML with inline tables below the first level."""
    return (
        "\n".join(f"{json.dumps(key)} = {_inline(value)}" for key, value in document.items()) + "\n"
    )


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(f"{json.dumps(str(key))} = {_inline(item)}" for key, item in value.items())
            + "}"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return long_digits(value) or json.dumps(value)


def long_digits(value: Any) -> str:
    """Return the digits of an integer that Python refuses to print: 1 and zeros of its length."""
    if isinstance(value, bool) or not isinstance(value, int) or value.bit_length() < 10_000:
        return ""
    return ("-" if value < 0 else "") + "1" + "0" * int(value.bit_length() * math.log10(2.0))
