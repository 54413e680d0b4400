"""Output files of a command: all are replaced together or none is, also when the process is killed.

Guarantees:

* Every file is complete and on the disk before the first takes its place. After a refusal or an
  error all are as they were.
* A folder that belongs to the command (`output_folder`) is replaced as a whole: a new folder is
  completed beside it, in `.<folder>.<process>.<random>.partial`, and takes its name by one rename,
  or exchanges names with the old folder atomically (`renameat2` with RENAME_EXCHANGE on Linux,
  `renamex_np` with RENAME_SWAP on macOS). A process that is killed at any moment leaves either the
  old set or the new one. Other entries of the folder are carried over as hard links to the same
  files.
* Where that is impossible the files are replaced in place: the old ones are moved away, the main
  file first, then the new ones are moved in, the main file last. A process that is killed in
  between leaves an incomplete set without its main file, never old files beside new ones. This
  holds for files beside each other in a folder of the user's (`output_files`), and for a folder
  that is a mount point or above or at the current directory, holds links in place of files of the
  set, more than `folder_exchange.MOST_ENTRIES` entries, entries of other owners or of another file
  system, or that is on a file system without hard links or without exchange. A single file is
  replaced by one rename.
* What a killed process leaves in staging directories is removed by the next run that writes to the
  same place.
* Symbolic links are followed: the file that a link leads to is replaced, the link stays. A target
  that is no regular file (a device, pipe, socket or folder) is refused.
* A new file gets the mode that the umask leaves; a replaced file keeps its mode.
* Ctrl-C, SIGTERM and SIGHUP wait until all files are replaced, which takes milliseconds.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import stat
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import UnusableInput
from .folder_exchange import replace_folder
from .staging import (
    StagingDirectory,
    locked,
    remove_abandoned,
    status_of,
    sync_directory,
    write_new,
)
from .text import displayable

_SPECIAL_FILES = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISCHR, "a character device"),
    (stat.S_ISBLK, "a block device"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
)
_replaced: list[Path] = []


def replaced_files() -> tuple[Path, ...]:
    """All files that this process has replaced so far, so that messages about interruptions can be
    true."""
    return tuple(_replaced)


@dataclass(frozen=True)
class OutputFiles:
    """The files that a command writes, checked before its computation and replaced together after
    it.

    Attributes:
        folder: The folder that all names are relative to.
        names: All names the command may write, the main file first. A name may have a subfolder:
            `validation/trajectory.json`.
        owns_folder: Whether the folder is the command's own, so that it may be exchanged as a
            whole.
    """

    folder: Path
    names: tuple[str, ...]
    owns_folder: bool

    def check(self, inputs: Sequence[Path] = ()) -> None:
        """Check that the files can be written, without writing anything.

        Args:
            inputs: Files that the command reads and that must not be replaced.

        Raises:
            UnusableInput: The folder cannot be written, or a target is no regular file, or one of
                the inputs.
        """
        if os.path.exists(self.folder) and not os.path.isdir(self.folder):
            raise self._refusal("is not a folder")
        targets = self._targets()
        for name, target in targets.items():
            if any(_is_same_file(path, target) for path in inputs):
                raise _refusal(self.folder / name, "is an input of this command", "give another -o")
        for target in targets.values():
            parent = next(parent for parent in target.parents if os.path.exists(parent))
            if not os.path.isdir(parent):
                raise self._refusal(f"{parent} is not a folder")
            if not os.access(parent, os.W_OK | os.X_OK):
                raise self._refusal(f"no permission to write in {parent}")

    def replace(self, contents: Mapping[str, str]) -> list[Path]:
        """Replace the files.

        Args:
            contents: The text of each file. Files of `names` that are not among them are removed:
                they belong to an earlier result.

        Returns:
            The paths of the files, as the user named the folder.

        Raises:
            UnusableInput: The files cannot be written. They are as they were before.
        """
        if not contents.keys() <= set(self.names):
            raise ValueError(
                f"not among the output files: {sorted(contents.keys() - set(self.names))}"
            )
        files = {name: displayable(text).encode() for name, text in contents.items()}
        written = [self.folder / name for name in contents]
        self.check()
        with _uninterrupted():
            created: list[Path] = []
            try:
                self._replace(files, created)
            except OSError as error:
                _remove_empty(created)
                raise self._refusal(error.strerror or type(error).__name__) from error
            _replaced.extend(written)
        return written

    def _replace(self, files: Mapping[str, bytes], created: list[Path]) -> None:
        """Replace the files, by the folder if possible, else in place. Folders that had to be made
        are added to `created`."""
        folder, targets = Path(os.path.realpath(self.folder)), self._targets()
        main = targets[self.names[0]].name
        remove_abandoned(folder.parent, folder.name)
        for parent in {target.parent for target in targets.values()}:
            remove_abandoned(parent, main)
        created += _make_folders(folder.parent if self.owns_folder else folder)
        has_links = any(folder / name != target for name, target in targets.items())
        if (
            self.owns_folder
            and not has_links
            and replace_folder(folder, files, frozenset(self.names))
        ):
            return
        for name in files:
            created += _make_folders(targets[name].parent)
        parents = sorted(
            {target.parent for target in targets.values() if os.path.isdir(target.parent)}
        )
        with contextlib.ExitStack() as stack:
            stagings: dict[Path, Path] = {}
            for parent in parents:
                stagings[parent] = stack.enter_context(StagingDirectory(parent, main)).path
            staged: dict[Path, Path] = {}
            for name, content in files.items():
                target = targets[name]
                staged[target] = stagings[target.parent] / f"new{len(staged)}"
                write_new(staged[target], content, like=target)
            for parent in parents:
                stack.enter_context(locked(parent))
            _move_in(
                staged,
                [target for target in targets.values() if target.parent in stagings],
                stagings,
            )
            for parent in parents:
                sync_directory(parent)
        unused = {(folder / name).parent for name in self.names} - {
            (folder / name).parent for name in files
        }
        _remove_empty(unused - {folder})

    def _targets(self) -> dict[str, Path]:
        """The file that each name leads to, through links. Raises UnusableInput for what cannot be
        replaced."""
        targets: dict[str, Path] = {}
        for name in self.names:
            path = self.folder / name
            target = Path(os.path.realpath(path))
            try:
                kind = _special_file(os.stat(path))
            except OSError as error:
                if error.errno == errno.ENAMETOOLONG:
                    raise _refusal(path, "its name is too long", "give another -o") from error
                kind = "a loop of symbolic links" if error.errno == errno.ELOOP else None
            if kind is not None:
                raise _refusal(
                    path, f"is {kind}, not a regular file", "give the name of a file with -o"
                )
            if _is_standard_stream(target):
                raise _refusal(
                    path,
                    "is where standard output or standard error go",
                    "give the name of another file with -o",
                )
            if target in targets.values():
                raise _refusal(
                    path, "leads to the same file as another output", "remove the symbolic link"
                )
            targets[name] = target
        return targets

    def _refusal(self, reason: str) -> UnusableInput:
        return _refusal(self.folder, reason, "give another -o")


def output_folder(folder: Path, names: Sequence[str]) -> OutputFiles:
    """The output files of a command in a folder of their own.

    Args:
        folder: The folder, which need not exist.
        names: All names the command may write in it, the main file first.

    Raises:
        UnusableInput: They cannot be written, as far as can be told without writing.
    """
    files = OutputFiles(folder, tuple(names), owns_folder=True)
    files.check()
    return files


def output_files(
    path: Path, siblings: Sequence[str] = (), inputs: Sequence[Path] = ()
) -> OutputFiles:
    """An output file, and others beside it, in a folder of the user's.

    Args:
        path: The main file.
        siblings: Names of the others.
        inputs: Files that the command reads and that must not be replaced.

    Raises:
        UnusableInput: They cannot be written, as far as can be told without writing.
    """
    if path.name in ("", ".."):
        raise _refusal(path, "is a folder, not a regular file", "give the name of a file with -o")
    files = OutputFiles(path.parent, (path.name, *siblings), owns_folder=False)
    files.check(inputs)
    return files


def _refusal(path: Path, reason: str, remedy: str) -> UnusableInput:
    return UnusableInput(f"{path}: cannot be written ({reason}); {remedy}")


def _special_file(status: os.stat_result) -> str | None:
    """Return the kind of a file in words, None for a regular file."""
    if stat.S_ISREG(status.st_mode):
        return None
    return next(
        (words for predicate, words in _SPECIAL_FILES if predicate(status.st_mode)),
        "a special file",
    )


def _is_same_file(one: Path, other: Path) -> bool:
    try:
        return os.path.samefile(one, other)
    except OSError:  # one is absent
        return False


def _is_standard_stream(path: Path) -> bool:
    """Return whether standard output or standard error go to a file: it must stay."""
    status = status_of(path)
    for handle in (1, 2):
        with contextlib.suppress(OSError):  # closed
            if status is not None and os.path.samestat(status, os.fstat(handle)):
                return True
    return False


def _make_folders(folder: Path) -> list[Path]:
    """Create a folder and what is missing above it; returns what was created, the outermost
    first."""
    missing = [path for path in (folder, *folder.parents) if not os.path.exists(path)]
    missing.reverse()
    for path in missing:
        path.mkdir(exist_ok=True)
    return missing


def _remove_empty(folders: Iterable[Path]) -> None:
    """Remove those of the folders that are empty, the innermost first."""
    for folder in sorted(folders, key=lambda path: len(path.parts), reverse=True):
        with contextlib.suppress(OSError):
            folder.rmdir()


def _move_in(
    staged: Mapping[Path, Path], targets: Sequence[Path], stagings: Mapping[Path, Path]
) -> None:
    """Move the old files away, the main one first, and the new ones in, the main one last; an error
    undoes all of it.

    Args:
        staged: The new file of each target.
        targets: All files of the set, the main one first; those without a new file are removed.
        stagings: The staging directory beside the targets of each folder.
    """
    if len(targets) == 1 and targets[0] in staged:
        os.replace(staged[targets[0]], targets[0])
        return
    moved: dict[Path, Path] = {}
    placed: list[Path] = []
    try:
        for target in targets:
            if status_of(target) is not None:
                kept = stagings[target.parent] / f"old{len(moved)}"
                os.rename(target, kept)
                moved[target] = kept
        for target in reversed(targets):
            if target in staged:
                os.rename(staged[target], target)
                placed.append(target)
    except OSError:
        for target in placed:
            target.unlink()
        for target, kept in moved.items():
            os.rename(kept, target)
        raise


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Let signals that end a process wait until the block is done."""
    if (
        threading.current_thread() is not threading.main_thread()
    ):  # signals are handled in the main thread
        yield
        return
    waiting: list[int] = []
    kinds = [
        getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
    ]
    handlers = {
        kind: handler
        for kind in kinds
        if (handler := signal.getsignal(kind)) not in (None, signal.SIG_IGN)
    }
    for kind in handlers:
        signal.signal(kind, lambda number, frame: waiting.append(number))
    try:
        yield
    finally:
        for kind, handler in handlers.items():
            signal.signal(kind, handler)
        for number in dict.fromkeys(waiting):
            signal.raise_signal(number)
