"""Writing whole files or none."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from .errors import UnusableInput


def write_all(folder: Path, contents: Mapping[str, str]) -> list[Path]:
    """Write several text files into a folder: all are complete before the first takes its name.

    Raises UnusableInput when the folder cannot be made or written.
    """
    staged: list[tuple[str, Path]] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in contents.items():
            handle, temporary = tempfile.mkstemp(dir=folder, prefix=f".{name}.")
            staged.append((temporary, folder / name))
            with os.fdopen(handle, "w", encoding="utf-8", newline="") as stream:
                stream.write(text)
            os.chmod(temporary, 0o644)
        for temporary, final in staged:
            os.replace(temporary, final)
    except OSError as error:
        for temporary, _ in staged:
            Path(temporary).unlink(missing_ok=True)
        raise UnusableInput(f"{folder}: cannot be written ({error.strerror}); give another -o") from error
    return [final for _, final in staged]
