"""Result of a command: exit code, JSON document and text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

Outcome: TypeAlias = tuple[int, Any, str]
"""Exit code, JSON document, and text for people."""


def with_files(document: dict[str, Any], paths: Iterable[Path]) -> dict[str, Any]:
    """Return a document with the paths of the files that were written."""
    return document | {"files": [str(path) for path in paths]}


def written_lines(paths: Iterable[Path]) -> list[str]:
    """Return one line for each file that was written."""
    return [f"wrote {path}" for path in paths]


def doubt_line(doubts: Sequence[Mapping[str, Any]], subject: str) -> str:
    """Say that a result rests on recordings that are doubted.

    Args:
        doubts: Doubts about the recordings, at least one.
        subject: The result: "model".
    """
    from ..robot.parameter_names import plural  # slow to import

    kinds = ", ".join(sorted({str(doubt["kind"]) for doubt in doubts}))
    return (
        f"do not use this {subject}: the recordings are doubted "
        f"({plural(len(doubts), 'warning')}: {kinds}); correct them and identify again"
    )
