"""Replace a folder as a whole: complete a new one beside it, then exchange their names
atomically."""

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

MOST_ENTRIES = 10_000
"""Entries of a folder beyond which it is not exchanged: linking them all takes about a second."""
ATTEMPTS = 3
"""How often a folder is staged again because another process has replaced it in the meantime."""
AT_FDCWD, RENAME_EXCHANGE = -100, 2  # <fcntl.h>, <linux/fs.h>
RENAME_SWAP = 2  # <sys/stdio.h> of macOS


class _NotExchangeable(Exception):
    """The folder has to be written in place."""


def replace_folder(folder: Path, files: Mapping[str, bytes], names: frozenset[str]) -> bool:
    """Replace a set of files in a folder by replacing the folder, such that a killed process leaves
    the old or the new set.

    Entries that are not of the set are carried over, files as hard links.

    Args:
        folder: The folder, without symbolic links in its path. It need not exist, its parent must.
        files: The content of each new file, by its name relative to the folder.
        names: Names of the whole set; those without a new file are left out of the new folder.

    Returns:
        False where the folder cannot be exchanged; nothing was changed then.
    """
    try:
        return any(_replace_once(folder, files, names) for _ in range(ATTEMPTS))
    except (OSError, NotImplementedError, _NotExchangeable):
        return False


def _replace_once(folder: Path, files: Mapping[str, bytes], names: frozenset[str]) -> bool:
    """Replace the folder; False where another process has replaced it in the meantime."""
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
    """Raise _NotExchangeable for folders of other owners, mount points, and folders that some
    program relies on to stay."""
    if not hasattr(os, "geteuid") or os.path.ismount(folder) or not _is_own_folder(status):
        raise _NotExchangeable
    for directory in _directories_in_use():
        if os.path.isabs(directory) and os.path.commonpath([folder, directory]) == str(folder):
            raise _NotExchangeable


def _directories_in_use() -> Iterator[str]:
    """The user's home, the temporary directory, and the current directories of all processes, as
    far as they are shown."""
    yield os.path.expanduser("~")
    yield os.path.realpath(tempfile.gettempdir())
    for link in glob.iglob("/proc/[0-9]*/cwd"):
        with contextlib.suppress(OSError):  # ended, or another user's
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
    """Recreate the entries of a folder that are not of the set: folders as folders, everything else
    as hard links.

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
            if count > MOST_ENTRIES or status.st_dev != device:
                raise _NotExchangeable
            if not stat.S_ISDIR(status.st_mode):
                os.link(entry.path, fresh / name, follow_symlinks=False)
                continue
            if not _is_own_folder(status):
                raise _NotExchangeable
            (fresh / name).mkdir(exist_ok=True)
            pending.append(name)
            recreated.append(name)
    for name in reversed(recreated):  # inner folders come after the ones that hold them
        old = os.lstat(folder / name)
        if not os.listdir(fresh / name) and _holds_only(folder, name, names):
            os.rmdir(fresh / name)
            continue
        _copy_attributes(folder / name, fresh / name)
        os.utime(fresh / name, ns=(old.st_atime_ns, old.st_mtime_ns))


def _holds_only(folder: Path, name: Path, names: frozenset[str]) -> bool:
    """Return whether a path is a folder that holds files of the set and nothing else."""
    path = folder / name
    if path.is_symlink() or not path.is_dir():
        return False
    entries = os.listdir(path)
    return bool(entries) and all((name / entry).as_posix() in names for entry in entries)


def _copy_attributes(folder: Path, fresh: Path) -> None:
    """Copy a folder's group, mode and extended attributes (access control lists among them) to
    another folder."""
    status = os.lstat(folder)
    if os.lstat(fresh).st_gid != status.st_gid:
        os.chown(fresh, -1, status.st_gid)
    os.chmod(fresh, stat.S_IMODE(status.st_mode))
    if sys.platform == "linux":
        for name in os.listxattr(folder):
            os.setxattr(fresh, name, os.getxattr(folder, name))


def _exchange(one: Path, other: Path) -> None:
    """Exchange the names of two folders atomically.

    Raises:
        OSError, _NotExchangeable: The file system or the operating system cannot do that.
    """
    library = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(one), os.fsencode(other)
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
    """Move entries that others have added or replaced in the old folder while the new one was
    staged."""
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
