"""Replace a folder atomically: complete a new one next to it, then exchange their names."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import glob
import os
import stat
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from .staging import StagingDirectory, locked, status_of, sync_directory, write_new

MAX_ENTRIES = 10_000
"""Largest number of entries of a folder that is exchanged: linking them takes about a second."""
ATTEMPTS = 3
"""Number of attempts, if another process replaces the folder at the same time."""
AT_FDCWD = -100
"""Directory descriptor for relative paths, of <fcntl.h>."""
RENAME_EXCHANGE = 2
"""Flag of `renameat2`, of <linux/fs.h>."""
RENAME_SWAP = 2
"""Flag of `renamex_np`, of <sys/stdio.h> of macOS."""


class _NotExchangeable(Exception):
    """The folder has to be written in place."""


def replace_folder(folder: Path, files: Mapping[str, bytes], names: frozenset[str]) -> bool:
    """Replace a set of files by replacing their folder.

    A process that is killed leaves the old or the new set. Entries that are not in the set are
    kept, files as hard links.

    Args:
        folder: The folder, without symbolic links in its path. Its parent must exist.
        files: The content of each new file, by its name relative to the folder.
        names: All names of the set; files of the set that are not in `files` are removed.

    Returns:
        False if the folder cannot be exchanged; nothing was changed then.
    """
    try:
        return any(_replace_once(folder, files, names) for _ in range(ATTEMPTS))
    except (OSError, NotImplementedError, _NotExchangeable):
        return False


def _replace_once(folder: Path, files: Mapping[str, bytes], names: frozenset[str]) -> bool:
    """Replace the folder; return False if another process has replaced it meanwhile."""
    with StagingDirectory(folder.parent, folder.name) as staging, contextlib.ExitStack() as stack:
        fresh = staging.path / "new"
        fresh.mkdir()
        before = status_of(folder)
        if before is not None:
            _require_plain(folder, before)
            stack.enter_context(locked(folder))
            _copy_attributes(folder, fresh)
        for name, content in files.items():
            (fresh / name).parent.mkdir(exist_ok=True)
            write_new(fresh / name, content, like=folder / name)
        is_empty = before is None or not os.listdir(folder)
        if not is_empty:
            _link_others(folder, fresh, names)
        for path, _, _ in os.walk(fresh, topdown=False):
            sync_directory(Path(path))
        if is_empty:
            try:
                os.rename(fresh, folder)
            except OSError as error:
                if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
                    return False
                raise
        else:
            _exchange(fresh, folder)
            _carry_over(fresh, folder, names)
        sync_directory(folder.parent)
    return True


def _require_plain(folder: Path, status: os.stat_result) -> None:
    """Check that a folder may be exchanged.

    Raises:
        _NotExchangeable: It has another owner, is a mount point, or is in use as the current
            directory of a process, home or temporary directory.
    """
    if not hasattr(os, "geteuid") or os.path.ismount(folder) or not _is_own_folder(status):
        raise _NotExchangeable
    for directory in _directories_in_use():
        if os.path.isabs(directory) and os.path.commonpath([folder, directory]) == str(folder):
            raise _NotExchangeable


def _directories_in_use() -> Iterator[str]:
    """Home of the user, temporary directory, and current directories of all visible processes."""
    yield os.path.expanduser("~")
    yield os.path.realpath(tempfile.gettempdir())
    for link in glob.iglob("/proc/[0-9]*/cwd"):
        with contextlib.suppress(OSError):  # the process has ended, or is another user's
            yield os.readlink(link)
    with contextlib.suppress(OSError):  # the current directory was removed
        yield str(Path.cwd())


def _is_own_folder(status: os.stat_result) -> bool:
    return (
        stat.S_ISDIR(status.st_mode)
        and status.st_uid == os.geteuid()
        and status.st_mode & stat.S_IRWXU == stat.S_IRWXU
    )


def _link_others(folder: Path, fresh: Path, names: frozenset[str]) -> None:
    """Recreate the entries of a folder that are not in the set; files become hard links.

    Raises:
        OSError, _NotExchangeable: An entry cannot be recreated.
    """
    count, device = 0, os.lstat(folder).st_dev
    pending = [Path()]
    recreated = []
    while pending:
        inner = pending.pop()
        for entry in os.scandir(folder / inner):
            name = inner / entry.name
            if name.as_posix() in names:
                continue
            count += 1
            status = entry.stat(follow_symlinks=False)
            if count > MAX_ENTRIES or status.st_dev != device:
                raise _NotExchangeable
            if not stat.S_ISDIR(status.st_mode):
                os.link(entry.path, fresh / name, follow_symlinks=False)
                continue
            if not _is_own_folder(status):
                raise _NotExchangeable
            (fresh / name).mkdir(exist_ok=True)
            pending.append(name)
            recreated.append(name)
    for name in reversed(recreated):  # inner folders first
        old = os.lstat(folder / name)
        if not os.listdir(fresh / name) and _holds_only(folder, name, names):
            os.rmdir(fresh / name)
            continue
        _copy_attributes(folder / name, fresh / name)
        os.utime(fresh / name, ns=(old.st_atime_ns, old.st_mtime_ns))


def _holds_only(folder: Path, name: Path, names: frozenset[str]) -> bool:
    """True if a path is a folder that contains files of the set and nothing else."""
    path = folder / name
    if path.is_symlink() or not path.is_dir():
        return False
    entries = os.listdir(path)
    return bool(entries) and all((name / entry).as_posix() in names for entry in entries)


def _copy_attributes(folder: Path, fresh: Path) -> None:
    """Copy group, mode and extended attributes of a folder, with its access control lists."""
    status = os.lstat(folder)
    if os.lstat(fresh).st_gid != status.st_gid:
        os.chown(fresh, -1, status.st_gid)
    os.chmod(fresh, stat.S_IMODE(status.st_mode))
    if sys.platform == "linux":
        for name in os.listxattr(folder):
            os.setxattr(fresh, name, os.getxattr(folder, name))


def _exchange(first: Path, second: Path) -> None:
    """Exchange the names of two folders atomically.

    Raises:
        OSError, _NotExchangeable: The file system or the operating system does not support it.
    """
    library = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(first), os.fsencode(second)
    try:
        if sys.platform == "linux":
            failed = library.renameat2(AT_FDCWD, names[0], AT_FDCWD, names[1], RENAME_EXCHANGE)
        elif sys.platform == "darwin":
            failed = library.renamex_np(*names, RENAME_SWAP)
        else:
            raise _NotExchangeable
    except AttributeError as error:  # an old C library
        raise _NotExchangeable from error
    if failed:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _carry_over(old: Path, folder: Path, names: frozenset[str]) -> None:
    """Move entries that other processes have added or replaced while the new folder was staged."""
    for path, folders, others in os.walk(old):
        inner = Path(path).relative_to(old)
        for entry in [*folders, *others]:
            name = inner / entry
            if name.as_posix() in names:
                continue
            here, there = os.lstat(old / name), status_of(folder / name)
            is_changed = (
                there is not None
                and not stat.S_ISDIR(here.st_mode)
                and not os.path.samestat(here, there)
            )
            is_added = there is None and not _holds_only(old, name, names)
            if is_changed or is_added:
                os.replace(old / name, folder / name)
        folders[:] = [entry for entry in folders if (Path(path) / entry).is_dir()]
