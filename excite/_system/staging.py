"""Staging directories: hidden directories in which files are completed before they are moved."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: no locks; the process number alone identifies the owner
    fcntl = None  # type: ignore[assignment]

SUFFIX = ".partial"
"""End of the names of staging directories."""
NAME_BYTES = 100
"""Bytes of a name that are part of the name of its staging directory; file systems allow 255 in
total."""
REUSE_AGE = 60.0
"""Age from which an unlocked staging directory is abandoned although a process with its number is
alive [s]: process numbers are reused, and each container has its own. A directory is locked within
a millisecond of its creation."""


class StagingDirectory:
    """A new directory `.<name>.<process>.<random>.partial`, locked while its process runs.

    The lock (`flock` on the directory) ends with the process, so that a later run can distinguish
    abandoned directories from those in use. As a context manager the directory removes itself.

    Attributes:
        path: The directory.
    """

    def __init__(self, parent: Path, name: str) -> None:
        """Create and lock the directory.

        Args:
            parent: Parent directory, on the file system to which the content will be moved.
            name: Name of the file or folder that is staged, for `remove_abandoned`.

        Raises:
            OSError: The directory cannot be created.
        """
        self.path = Path(
            tempfile.mkdtemp(prefix=f"{_prefix(name)}{os.getpid()}.", suffix=SUFFIX, dir=parent)
        )
        self._lock: int | None = None
        with contextlib.suppress(BlockingIOError):  # another process is checking its lock
            self._lock = _try_lock(self.path)

    def remove(self) -> None:
        """Remove the directory and release its lock."""
        shutil.rmtree(self.path, ignore_errors=True)
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> StagingDirectory:
        return self

    def __exit__(self, *_: object) -> None:
        self.remove()


def staging_directories(parent: Path, name: str) -> Iterator[tuple[Path, bool]]:
    """Find the staging directories of a name that belong to the user.

    Yields:
        Each directory, and True if it is abandoned: its process has ended without removing it.
    """
    pattern = re.compile(rf"{re.escape(_prefix(name))}(\d+)\.\w{{8}}{re.escape(SUFFIX)}")
    try:
        entries = list(os.scandir(parent))
    except OSError:
        return
    for entry in entries:
        match = pattern.fullmatch(entry.name)
        if match is None or not entry.is_dir(follow_symlinks=False):
            continue
        with contextlib.suppress(OSError):  # removed meanwhile, or no permission
            status = entry.stat(follow_symlinks=False)
            if not hasattr(os, "geteuid") or status.st_uid == os.geteuid():
                yield (
                    Path(entry.path),
                    _is_abandoned(Path(entry.path), int(match[1]), time.time() - status.st_ctime),
                )


def remove_abandoned(parent: Path, name: str) -> None:
    """Remove the staging directories of a name whose processes have ended."""
    for path, abandoned in staging_directories(parent, name):
        if abandoned:
            shutil.rmtree(path, ignore_errors=True)


@contextlib.contextmanager
def locked(directory: Path, patience: float = 5.0) -> Iterator[None]:
    """Hold the lock of a directory against other processes of this package.

    On file systems without locks for directories (some network file systems) it does nothing.

    Args:
        directory: An existing directory.
        patience: Longest time to wait for another process [s].

    Raises:
        OSError: Another process has held the lock for that time.
    """
    until = time.monotonic() + patience
    while True:
        try:
            handle = _try_lock(directory)
        except BlockingIOError:
            if time.monotonic() > until:
                raise
            time.sleep(0.01)
            continue
        if handle is None or os.path.samestat(os.fstat(handle), os.stat(directory)):
            break
        os.close(handle)  # the folder was exchanged meanwhile
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


def status_of(path: Path) -> os.stat_result | None:
    """Return the status of a path without following links; None if it does not exist."""
    try:
        return os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None


def write_new(path: Path, content: bytes, like: Path) -> None:
    """Write a new file to the disk.

    Args:
        path: The file, which must not exist.
        content: Its content.
        like: The file that it will replace, which determines its mode, and its owner if that is
            permitted. Without such a file the umask determines the mode.
    """
    with open(path, "xb") as stream:
        old = status_of(like)
        if old is not None and stat.S_ISREG(old.st_mode):
            if hasattr(os, "fchown") and os.geteuid() == 0:
                os.fchown(stream.fileno(), old.st_uid, old.st_gid)
            os.chmod(path, stat.S_IMODE(old.st_mode))
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def sync_directory(path: Path) -> None:
    """Write the entries of a directory to the disk, if the file system supports it."""
    with contextlib.suppress(OSError):
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _prefix(name: str) -> str:
    return f".{os.fsdecode(os.fsencode(name)[:NAME_BYTES])}."


def _is_abandoned(path: Path, process: int, age: float) -> bool:
    try:
        handle = _try_lock(path)
    except BlockingIOError:
        return False
    if handle is None:
        return not _is_alive(process)
    os.close(handle)
    return not _is_alive(process) or age > REUSE_AGE


def _is_alive(process: int) -> bool:
    if os.name == "nt":  # where os.kill(process, 0) ends the process
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # another user's
        return True
    return True


def _try_lock(directory: Path) -> int | None:
    """Take the lock of a directory.

    Returns:
        The handle that holds the lock; None if the file system has no locks.

    Raises:
        BlockingIOError: Another process holds the lock.
    """
    if fcntl is None:
        return None
    handle = os.open(directory, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise
    except OSError:
        os.close(handle)
        return None
    return handle
