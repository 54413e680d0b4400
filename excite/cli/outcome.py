"""The result of a command, as the command line prints it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeAlias

Outcome: TypeAlias = tuple[int, Any, str]
"""Exit code, JSON document, and text for people."""


def with_files(document: dict[str, Any], paths: Iterable[Path]) -> dict[str, Any]:
    """Add the paths of the written files to a document."""
    return document | {"files": [str(path) for path in paths]}


def written_lines(paths: Iterable[Path]) -> list[str]:
    """One line for each written file."""
    return [f"wrote {path}" for path in paths]
