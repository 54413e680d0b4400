"""Writing whole files or none."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from .errors import UnusableInput


def write_all(folder: Path, contents: Mapping[str, str]) -> list[Path]:
    """Write several text files into a folder, or folders in it: all are complete before the first
    takes its name.

    Raises UnusableInput when the folder cannot be made or written.
    """
    staged: list[tuple[str, Path]] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in contents.items():
            final = folder / name
            final.parent.mkdir(exist_ok=True)
            handle, temporary = tempfile.mkstemp(dir=final.parent, prefix=f".{final.name}.")
            staged.append((temporary, final))
            with os.fdopen(handle, "w", encoding="utf-8", newline="") as stream:
                stream.write(text)
            os.chmod(temporary, 0o644)
        for temporary, target in staged:
            os.replace(temporary, target)
    except OSError as error:
        for temporary, _ in staged:
            Path(temporary).unlink(missing_ok=True)
        raise UnusableInput(
            f"{folder}: cannot be written ({error.strerror}); give another -o"
        ) from error
    return [final for _, final in staged]
