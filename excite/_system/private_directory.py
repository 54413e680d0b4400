"""Directories that only the user can read and write: the cache of compiled code, and the logs."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path


def private_directory(variable: str, default: str) -> Path | None:
    """Find or create the package's private directory of a kind (XDG Base Directory Specification).

    Args:
        variable: Environment variable with the parent directory; relative paths are ignored, as
            the specification requires.
        default: Parent directory relative to the user's home, if the variable is not set.

    Returns:
        `<directory>/excite`, owned by the user and not accessible to others; None if there is no
        such directory and none can be created.
    """
    parent = os.environ.get(variable, "")
    if not os.path.isabs(parent):
        home = os.path.expanduser("~")
        if not (os.path.isabs(home) and os.path.isdir(home)):
            return None
        parent = os.path.join(home, default)
    path = Path(parent) / "excite"
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        with opened_privately(path) as handle:
            return path if handle is not None else None
    except OSError:
        return None


@contextlib.contextmanager
def opened_privately(path: Path) -> Iterator[int | None]:
    """Open a directory and check that only the user can read and write it.

    Yields:
        Its file descriptor, or None if it is not private. Files that are opened relative to the
        descriptor are in the directory that was checked, even if its name is changed meanwhile.

    Raises:
        OSError: The path is no directory or cannot be opened.
    """
    if not hasattr(os, "geteuid"):  # Windows
        yield None
        return
    handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield handle if is_private(os.fstat(handle)) else None
    finally:
        os.close(handle)


def is_private(status: os.stat_result) -> bool:
    """True if a file or directory belongs to the user, and others can neither read nor write it."""
    return status.st_uid == os.geteuid() and not stat.S_IMODE(status.st_mode) & 0o077
