"""Staging directories: fresh, hidden directories in which files are completed before they take
their place."""

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
except (
    ImportError
):  # Windows: without locks, the process number alone tells whether an owner is alive
    fcntl = None  # type: ignore[assignment]

SUFFIX = ".partial"
NAME_BYTES = 100
"""Bytes of a name that enter the name of its staging directory; file systems allow 255 for all of
it."""
REUSE_AGE = 60.0
"""Age [s] from which an unlocked staging directory is abandoned although a process of its number is
alive: numbers are reused, and each container counts its own. Locking a directory after its creation
takes well under a millisecond."""


class StagingDirectory:
    """A fresh directory `.<name>.<process>.<random>.partial`, locked for as long as its process
    lives.

    The lock (`flock` on the directory) ends with the process, however that ends, so that a later
    run can tell abandoned directories from those in use. As a context manager it removes itself at
    the end.

    Attributes:
        path: The directory.
    """

    def __init__(self, parent: Path, name: str) -> None:
        """Create and lock the directory.

        Args:
            parent: Where; on the file system of the place to which its content will be moved.
            name: What is staged; `remove_abandoned` looks for this name.

        Raises:
            OSError: The directory cannot be created.
        """
        self.path = Path(
            tempfile.mkdtemp(prefix=f"{_prefix(name)}{os.getpid()}.", suffix=SUFFIX, dir=parent)
        )
        self._lock: int | None = None
        with contextlib.suppress(
            BlockingIOError
        ):  # somebody looks whether it is abandoned, just now
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
    """Find the user's own staging directories of a name.

    Yields:
        Each directory, and whether it is abandoned: its process ended without removing it.
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
        with contextlib.suppress(OSError):  # removed in the meantime, or not ours to open
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

    Where the file system has no locks for directories (some network file systems) none is held.

    Args:
        directory: An existing directory.
        patience: How long to wait for another process [s].

    Raises:
        OSError: Another process held the lock all the time.
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
        os.close(handle)  # the folder was exchanged for another in the meantime
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


def status_of(path: Path) -> os.stat_result | None:
    """The status of a path itself, not of what a link leads to; None where there is nothing."""
    try:
        return os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None


def write_new(path: Path, content: bytes, like: Path) -> None:
    """Write a new file to the disk.

    Args:
        path: The file, which must not exist.
        content: All of it.
        like: The file that it will replace: it gets its mode, and its owner where that is
            permitted. Where there is none, the umask decides.
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
    """Write a directory's entries to the disk, where the file system can do that."""
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
    if os.name == "nt":  # where os.kill(process, 0) is no question
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # another user's
        return True
    return True


def _try_lock(directory: Path) -> int | None:
    """Take a directory's lock.

    Returns:
        The handle that holds it; None where there are no such locks.

    Raises:
        BlockingIOError: Somebody else holds it.
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
