"""Output files of a command: all are replaced or none, even if the process is killed.

Guarantees:

* Every file is complete and on the disk before the first one is replaced. After an error all files
  are unchanged.
* A folder that belongs to the command (`output_folder`) is replaced as a unit: a new folder is
  completed next to it, `.<folder>.<process>.<random>.partial`. It is renamed, or its name is
  exchanged atomically with that of the old folder (`renameat2` with RENAME_EXCHANGE on Linux,
  `renamex_np` with RENAME_SWAP on macOS). A process that is killed at any moment leaves either the
  old set or the new one. Other entries of the folder are kept as hard links to the same files.
* If that is impossible, the files are replaced in place: the old files are moved away, the main
  file first, then the new files are moved in, the main file last. A process that is killed in
  between leaves an incomplete set without its main file, never a mixture of old and new files. This
  applies to files in a folder of the user (`output_files`), and to a folder that is a mount point,
  contains the current directory, contains links instead of files of the set, more than
  `folder_exchange.MAX_ENTRIES` entries, or entries of other owners or of another file system, or
  that is on a file system without hard links or without exchange. A single file is replaced by one
  rename.
* Staging directories of killed processes are removed by the next run that writes to the same place.
* Symbolic links are followed: the target of the link is replaced, the link stays. A target that is
  no regular file (a device, pipe, socket or folder) is refused.
* A new file gets the mode of the umask; a replaced file keeps its mode.
* Ctrl-C, SIGTERM and SIGHUP are delayed until all files are replaced, which takes milliseconds.
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
    """Return all files that this process has replaced so far, for messages about interruptions."""
    return tuple(_replaced)


@dataclass(frozen=True)
class OutputFiles:
    """Files that a command writes: checked before its computation, replaced together after it.

    Attributes:
        folder: Folder that all names are relative to.
        names: All names that the command may write, the main file first. A name may have a
            subfolder: `validation/trajectory.json`.
        owns_folder: True if the folder belongs to the command, so that it may be exchanged.
        option: Option that names the files, for messages.
    """

    folder: Path
    names: tuple[str, ...]
    owns_folder: bool
    option: str = "-o"

    def check(self, inputs: Sequence[Path] = ()) -> None:
        """Check that the files can be written, without writing anything.

        Args:
            inputs: Files that the command reads and that must not be replaced.

        Raises:
            UnusableInput: The folder cannot be written, or a target is no regular file or one of
                the inputs.
        """
        if os.path.exists(self.folder) and not os.path.isdir(self.folder):
            raise self._refusal("is not a folder")
        targets = self._targets()
        for name, target in targets.items():
            if any(_is_same_file(path, target) for path in inputs):
                raise _refusal(
                    self.folder / name, "is an input of this command", f"give another {self.option}"
                )
        for target in targets.values():
            parent = next(parent for parent in target.parents if os.path.exists(parent))
            if not os.path.isdir(parent):
                raise self._refusal(f"{parent} is not a folder")
            if not os.access(parent, os.W_OK | os.X_OK):
                raise self._refusal(f"no permission to write in {parent}")

    def replace(self, contents: Mapping[str, str]) -> list[Path]:
        """Replace the files.

        Args:
            contents: Text of each file. Files of `names` without a text are removed: they belong
                to an earlier result.

        Returns:
            The paths of the files, relative to the folder as the user stated it.

        Raises:
            UnusableInput: The files cannot be written; they are unchanged.
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
        """Replace the files, by exchanging the folder if possible, else in place.

        Args:
            files: Content of each file.
            created: List to which new folders are appended.
        """
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
        """Resolve the links of each name.

        Raises:
            UnusableInput: A file cannot be replaced.
        """
        targets: dict[str, Path] = {}
        for name in self.names:
            path = self.folder / name
            target = Path(os.path.realpath(path))
            try:
                kind = _special_file(os.stat(path))
            except OSError as error:
                if error.errno == errno.ENAMETOOLONG:
                    raise _refusal(
                        path, "its name is too long", f"give another {self.option}"
                    ) from error
                kind = "a loop of symbolic links" if error.errno == errno.ELOOP else None
            if kind is not None:
                raise _refusal(
                    path,
                    f"is {kind}, not a regular file",
                    f"give the name of a file with {self.option}",
                )
            if _is_standard_stream(target):
                raise _refusal(
                    path,
                    "is where standard output or standard error go",
                    f"give the name of another file with {self.option}",
                )
            if target in targets.values():
                raise _refusal(
                    path, "leads to the same file as another output", "remove the symbolic link"
                )
            targets[name] = target
        return targets

    def _refusal(self, reason: str) -> UnusableInput:
        return _refusal(self.folder, reason, f"give another {self.option}")


def output_folder(folder: Path, names: Sequence[str], inputs: Sequence[Path] = ()) -> OutputFiles:
    """Return the output files of a command that has a folder of its own.

    Args:
        folder: The folder, which need not exist.
        names: All names that the command may write in it, the main file first.
        inputs: Files that the command reads and that must not be replaced.

    Raises:
        UnusableInput: The files cannot be written, as far as can be checked without writing.
    """
    files = OutputFiles(folder, tuple(names), owns_folder=True)
    files.check(inputs)
    return files


def output_files(
    path: Path,
    siblings: Sequence[str] = (),
    inputs: Sequence[Path] = (),
    option: str = "-o",
) -> OutputFiles:
    """Return an output file, and others next to it, in a folder of the user.

    Args:
        path: The main file.
        siblings: Names of the other files.
        inputs: Files that the command reads and that must not be replaced.
        option: Option that names the file, for messages.

    Raises:
        UnusableInput: The files cannot be written, as far as can be checked without writing.
    """
    if path.name in ("", ".."):
        raise _refusal(
            path, "is a folder, not a regular file", f"give the name of a file with {option}"
        )
    files = OutputFiles(path.parent, (path.name, *siblings), owns_folder=False, option=option)
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


def _is_same_file(first: Path, second: Path) -> bool:
    try:
        return os.path.samefile(first, second)
    except OSError:  # a file is absent
        return False


def _is_standard_stream(path: Path) -> bool:
    """True if standard output or standard error are redirected to a file: it must stay."""
    status = status_of(path)
    for handle in (1, 2):
        with contextlib.suppress(OSError):  # closed
            if status is not None and os.path.samestat(status, os.fstat(handle)):
                return True
    return False


def _make_folders(folder: Path) -> list[Path]:
    """Create a folder and its missing parents; return the new folders, the outermost first."""
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
    """Move the old files away, the main file first, and the new files in, the main file last.

    After an error the old files are restored.

    Args:
        staged: The new file of each target.
        targets: All files of the set, the main file first; those without a new file are removed.
        stagings: Staging directory of each folder.
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
    """Delay signals that end the process until the end of the block."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may handle signals
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
