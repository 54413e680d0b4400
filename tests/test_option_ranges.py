"""Numeric options of all commands refuse values outside their ranges before the command runs."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import pytest

from excite.cli import main as main_module
from excite.cli.option_types import NUMERIC, NamedNumbers, Number, Numbers, WordOrNumbers

TEXT = {
    "robot",
    "joints",
    "limits",
    "without",
    "support",
    "symmetric",
    "contact",
    "given",
    "for_task",
    "discriminate",
    "discriminating",
    "before",
    "out",
    "srdf",
    "scene",
    "packages",
    "cluster",
    "trajectory",
    "motion",
    "recordings",
    "columns",
    "validate",
    "prior",
    "bounds",
    "model",
    "recording",
    "effect",
    "like",
    "host",
    "limits_template",
    "format",
    "source",
    "into",
    "carrying",
    "empty",
    "link",
    "for_payload",
    "shape",
}
"""Options and arguments that are names, paths or lists of names."""
POSITIONALS = {
    "effects": [],
    "formats": [],
    "robots": [],
    "check": ["two_link"],
    "design": ["two_link", "-o", "unused"],
    "verify": ["unused.json"],
    "export": ["unused.json", "--format", "csv", "-o", "unused"],
    "identifiability": ["two_link", "unused.json", "-o", "unused"],
    "identify": ["two_link", "unused.csv", "-o", "unused"],
    "predict": ["unused.json", "unused.csv", "-o", "unused.csv"],
    "diagnose": ["two_link", "unused.csv", "--validate", "unused.csv", "-o", "unused"],
    "payload": ["two_link", "--with", "unused.csv", "-o", "unused"],
    "replay": ["unused.json", "unused.csv", "-o", "unused"],
    "simulate": ["two_link", "unused.json", "-o", "unused.csv"],
    "view": ["unused.json"],
}
NEVER = (
    "nan",
    "-nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e400",
    "9" * 400,
    "",
    " ",
    "many",
    "0x10",
    "1,,2",
    "1;2",
    "--",
    "10**9",
    "1e",
)
"""Texts that no numeric option accepts."""


def commands() -> dict[str, argparse.ArgumentParser]:
    action = next(
        action
        for action in main_module.parser()._actions
        if isinstance(action, argparse._SubParsersAction)
    )
    return dict(action.choices)


def options() -> Iterator[tuple[str, argparse.Action]]:
    """Return the options and arguments with a value, except switches and choices."""
    for command, sub in commands().items():
        for action in sub._actions:
            if action.nargs != 0 and action.choices is None:
                yield command, action


def numeric() -> list[tuple[str, argparse.Action]]:
    return [(command, action) for command, action in options() if isinstance(action.type, NUMERIC)]


def named(pair: tuple[str, argparse.Action]) -> str:
    return f"{pair[0]} {pair[1].option_strings[0]}"


def fitting(kind: object, number: str) -> str:
    """Return a valid text of an option in which one number is replaced."""
    if isinstance(kind, NamedNumbers):
        return f"joint_1{kind.separator}{fitting(kind.numbers, number)}"
    if isinstance(kind, WordOrNumbers):
        return fitting(kind.numbers, number)
    if isinstance(kind, Numbers) and kind.counts is not None:
        return ",".join(["1"] * (kind.counts[0] - 1) + [number])
    return number


def refusal(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main_module.main(list(words)) == 2, words
    captured = capsys.readouterr()
    assert (
        captured.out == "" and captured.err.count("\n") == 1 and captured.err.startswith("excite: ")
    ), captured.err
    return captured.err


def test_all_commands_are_covered():
    assert set(commands()) == set(POSITIONALS)


def test_every_numeric_option_states_its_range():
    forgotten = [
        (command, action.dest)
        for command, action in options()
        if not isinstance(action.type, NUMERIC) and action.dest not in TEXT
    ]
    assert not forgotten, "give these a type of excite.option_types, or list them as text here"


@pytest.mark.parametrize("pair", numeric(), ids=named)
def test_invalid_numbers_are_refused_with_the_name_of_the_option(pair, capsys):
    command, action = pair
    option = action.option_strings[0]
    for number in NEVER:
        text = fitting(action.type, number)
        line = refusal(capsys, command, *POSITIONALS[command], f"{option}={text}")
        assert option in line and len(line) < 400, line


@pytest.mark.parametrize("pair", numeric(), ids=named)
def test_the_ends_of_a_range_are_accepted_and_numbers_outside_are_refused(pair):
    kind = pair[1].type
    kind = kind.numbers if isinstance(kind, (NamedNumbers, WordOrNumbers)) else kind
    accepted = kind.accepted if isinstance(kind, (Number, Numbers)) else None
    if isinstance(kind, Numbers):
        accepted = kind.accepted[0] if isinstance(kind.accepted, tuple) else accepted
    whole = isinstance(kind, Number) and kind.whole
    number = Number(accepted, whole=whole)
    step = 1 if whole else max(abs(accepted.upper), 1.0) * 1e-6
    form = (lambda value: str(int(value))) if whole else repr
    for inside in (accepted.lower, accepted.upper):
        if accepted.accepts(inside):
            assert number(form(inside)) == inside
    for outside in (accepted.lower - step, accepted.upper + step):
        with pytest.raises(argparse.ArgumentTypeError, match=r"should be"):
            number(form(outside))


@pytest.mark.parametrize("text", ["1.5", "1e3", "0.0", "2.0"])
def test_integers_have_no_fraction(text, capsys):
    line = refusal(capsys, "design", "two_link", "-o", "unused", "--harmonics", text)
    assert "--harmonics" in line and "whole number" in line


@pytest.mark.parametrize("window", ["3,1", "2,2"])
def test_a_window_ends_after_it_starts(window, capsys):
    assert "increasing" in refusal(
        capsys, "identify", "two_link", "unused.csv", "-o", "unused", "--window", window
    )


@pytest.mark.parametrize(
    ("option", "text", "part"),
    [
        ("--start", "0,0,0", "2 number(s), one per moving joint (joint_1, joint_2), not 3"),
        ("--torque-noise", "1,2,3", "2 number(s), one per moving joint"),
        ("--payload", "tip:1,2", "1 or 4 or 10"),
        ("--box", "tip:0,1", "should hold 6"),
        ("--lock", "joint_1", "NAME=VALUE"),
    ],
)
def test_a_wrong_count_of_numbers_is_refused(option, text, part, capsys, tmp_path):
    line = refusal(capsys, "design", "two_link", "-o", str(tmp_path / "out"), f"{option}={text}")
    assert option in line and part in line
    assert not (tmp_path / "out").exists()
