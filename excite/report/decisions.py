"""Decisions of discriminating recordings in words: odds before, expected and after."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ..robot.parameter_names import plural, some
from ..schemas.effects import effect_words
from .content import Section, Table, TableCell
from .formatting import odds_words
from .torque_budget import Document

HEAD = ("joint", "question", "odds before", "expected", "odds after", "decision")
"""Titles of the table."""


def decision_rows(document: Document) -> list[tuple[str, ...]]:
    """Return joint, question, odds before, expected and after, and decision of each pair.

    All odds are those of the first effect of the question.
    """
    rows: list[tuple[str, ...]] = []
    for entry in document.get("decisions", ()):
        odds = entry["log_odds"]
        names = effect_words(entry["effect"]), effect_words(entry["rival"])
        decided = entry["decided_for"]
        rows.append(
            (
                entry["joint"] or "whole robot",
                " or ".join(names) + "?",
                odds_words(odds["before"]),
                _expected_words(odds["expected"], odds["after"]),
                odds_words(odds["after"]),
                "open"
                if decided is None
                else effect_words(decided) + ("" if _is_found(document, entry) else ", not found"),
            )
        )
    return rows


def _is_found(document: Document, entry: Document) -> bool:
    """Tell whether the effect that a pair is decided for is a finding of all recordings.

    It need not be: what explains more than its rival may be superfluous next to other effects.
    """
    return any(
        finding["joint"] == entry["joint"]
        and entry["decided_for"] in (finding["effect"], *finding["equivalents"])
        for finding in document["findings"]
    )


def _expected_words(expected: Mapping[str, float] | None, after: float) -> str:
    """Return the odds that were expected if that effect acts which the recordings favour."""
    if expected is None:
        return "–"
    return odds_words(expected["effect" if after >= 0.0 else "rival"])


def decisions_answer(document: Document) -> tuple[str, str]:
    """Return in a sentence what was decided, and its tone."""
    entries = document["decisions"]
    if not entries:
        return "Nothing had to be decided: the earlier recordings left no two effects open.", "good"
    decided = [entry for entry in entries if entry["decided_for"] is not None]
    names: dict[bool, list[str]] = {True: [], False: []}
    for entry in decided:
        place = f"{effect_words(entry['decided_for'])} at {entry['joint'] or 'the whole robot'}"
        if place not in (group := names[_is_found(document, entry)]):
            group.append(place)
    text = f"{len(decided)} of {plural(len(entries), 'open pair')} decided"
    text += f": {some(names[True])}." if names[True] else "."
    if names[False]:
        text += f" Ahead of its rivals, but superfluous next to the findings: {some(names[False])}."
    if len(decided) < len(entries):
        text += " The others stay open: one more recording of that kind, or another experiment."
    return text, "good" if len(decided) == len(entries) else "warn"


def decisions_section(document: Document) -> Iterator[Section]:
    """Build the section on the discriminating recordings, if there are any."""
    if "decisions" not in document:
        return
    rows: list[list[str | TableCell]] = [
        [*row[:-1], TableCell(row[-1], "warn" if row[-1] == "open" else "good")]
        for row in decision_rows(document)
    ]
    answer, tone = decisions_answer(document)
    data = {"table": Table(HEAD, rows, (2, 3, 4))}
    yield Section("decisions", "What did the further recording decide?", answer, data, tone)
