"""Directories that nobody but the user can write to or read: the cache of compiled code, the
logs."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path


def private_directory(variable: str, default: str) -> Path | None:
    """Find or create the package's private directory of a kind (XDG Base Directory Specification).

    Args:
        variable: The environment variable that names the directory above it; relative paths are
            ignored, as the specification says.
        default: That directory where the variable is unset, relative to the user's home.

    Returns:
        `<directory>/excite`, owned by the user and accessible to nobody else; None where there is
        no such directory and none can be created.
    """
    above = os.environ.get(variable, "")
    if not os.path.isabs(above):
        home = os.path.expanduser("~")
        if not (os.path.isabs(home) and os.path.isdir(home)):
            return None
        above = os.path.join(home, default)
    path = Path(above) / "excite"
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        with opened_privately(path) as handle:
            return path if handle is not None else None
    except OSError:
        return None


@contextlib.contextmanager
def opened_privately(path: Path) -> Iterator[int | None]:
    """Open a directory and check that nobody but the user can write to or read it.

    Yields:
        Its file descriptor, or None where it is not private. What is opened relative to the
        descriptor is in the directory that was checked, whatever happens to its name.

    Raises:
        OSError: It is no directory or cannot be opened.
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
    """Return whether a file or directory is the user's, and nobody else can write to or read it."""
    return status.st_uid == os.geteuid() and not stat.S_IMODE(status.st_mode) & 0o077
