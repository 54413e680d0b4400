"""Recordings that a `model.json` states: where they are, and how their columns are read."""

from __future__ import annotations

import os.path
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..recordings import Recording
from ..recordings.csv_reader import read_column_names
from ..recordings.remark import Remark

COLUMNS_KEY = "recording_columns"
"""Key of the columns of recordings that were read with `--columns`."""


def with_recording_columns(
    document: Mapping[str, Any], recordings: Iterable[Recording]
) -> dict[str, Any]:
    """Return the content of a `model.json` with the names of columns of its recordings.

    Args:
        document: The content.
        recordings: Recordings that the model was fitted to, and those held out.
    """
    columns = {
        recording.source: dict(recording.columns) for recording in recordings if recording.columns
    }
    return {**document, COLUMNS_KEY: columns} if columns else dict(document)


def stated_columns(content: Mapping[str, Any], recording: object) -> Mapping[str, str]:
    """Return the names of columns with which the model's recording at a path was read.

    A model states the paths of its recordings as they were typed, in the working directory of that
    time. A recording is therefore known by its file name, too, if it has the columns.

    Args:
        content: Content of a `model.json`.
        recording: Path of a recording; other objects are no file of the model.

    Returns:
        Names of columns; empty if the model states none, or recordings of that file name that
        differ in them.

    Raises:
        UnusableInput: A recording of a stated file name is no CSV file.
    """
    if not isinstance(recording, str | Path):
        return {}
    path = Path(recording)
    stated = {
        source: columns
        for source, columns in (content.get(COLUMNS_KEY) or {}).items()
        if Path(source).name == path.name
    }
    if not stated or not os.path.isfile(path):
        return {}
    names = read_column_names(path)
    matches = {
        source: dict(columns)
        for source, columns in stated.items()
        if set(columns.values()) <= set(names)
    }
    for source, columns in matches.items():
        if os.path.realpath(source) == os.path.realpath(path):
            return columns
    first, *others = [*matches.values()] or [{}]
    return first if all(columns == first for columns in others) else {}


def stated_recording(
    content: Mapping[str, Any], folder: Path
) -> tuple[Path, Mapping[str, str]] | None:
    """Return the first of a model's recordings that still exists, and the names of its columns.

    Args:
        content: Content of a `model.json`.
        folder: Folder of the `model.json`, in which recordings are searched, too.

    Returns:
        Path and columns; None if no recording is in its place.
    """
    sources = [
        str(entry.get("recording", ""))
        for key in ("validation", "fit")
        for entry in content.get(key) or []
    ]
    for source in (*sources, *map(str, content.get("recordings", []))):
        for place in (Path(source), folder / Path(source).name):
            if os.path.isfile(place):  # False for names that no file can have
                return place, dict((content.get(COLUMNS_KEY) or {}).get(source, {}))
    return None


def remarks_by_recording(recordings: Sequence[Recording]) -> dict[str, list[Remark]]:
    """Return the remarks of the data-quality checks by the name of their recording.

    Recordings in several folders with the same name are stated with their paths.
    """
    sources = list(dict.fromkeys(recording.source for recording in recordings))
    names = Counter(Path(source).name for source in sources)
    out: dict[str, list[Remark]] = {}
    for recording in recordings:
        name = Path(recording.source).name
        key = recording.source if names[name] > 1 else name
        out.setdefault(key, []).extend(recording.remarks)
    return out
