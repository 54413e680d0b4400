"""Generated C of the dynamics, compiled in the background where there is a compiler, and kept for the next run.

CasADi's interpreter starts at once and computes the same operations in the same order, so that switching to the compiled
functions when they are ready changes no bit of a result. EXCITE_COMPILER names the compiler; if it is empty, none is used.

The cache is a directory that nobody but the user can access; without one nothing is compiled. `<key>.sha256` names the library
`<sha256>.so` of a piece of code, whose content is checked before it is loaded. Whatever is wrong with a library, the
interpreter goes on. A compiler is bounded in time and memory, and ends with this process.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import platform
import re
import shutil
import signal
import stat
import subprocess
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from .._system.private_directory import is_private, opened_privately, private_directory
from .._system.staging import StagingDirectory, remove_abandoned, staging_directories

Array = np.ndarray
FLAGS = ("-O1", "-fPIC", "-shared", "-ffp-contract=off")  # fused operations would round differently
MOST_INSTRUCTIONS = 300_000
"""Instructions of CasADi's interpreter beyond which nothing is compiled. gcc 12 needs 1 s and 90 MB for a Panda (12,000
instructions, 0.3 MB of C), 33 s and 840 MB for a chain of 30 joints (230,000 instructions, 6 MB), over 150 s for one of 60."""
COMPILER_SECONDS = 120
"""Processor time that the compiler may take [s]."""
COMPILER_KILOBYTES = 2_000_000
"""Address space that the compiler may take [kB]."""
STAGING = "compilation"
"""Name of the staging directories of compilers."""

# Runs the compiler in a process group of its own. Standard input is a pipe whose other end is held by the process that wants
# the library: when that process ends, however it ends, the pipe closes and the group is killed.
SCRIPT = """
ulimit -c 0
ulimit -t "$1"
ulimit -v "$2"
shift 2
exec 3<&0
nice "$@" </dev/null 3<&- &
compiler=$!
{ read -r line <&3; kill -s KILL -- "-$$"; } &
watcher=$!
exec 3<&-
wait "$compiler"
status=$?
kill "$watcher"
exit "$status"
"""


@dataclass(frozen=True)
class Library:
    """Compiled functions in the cache: there already, or as soon as a compiler in the background is done.

    Attributes:
        folder: The cache.
        key: SHA-256 of the C code, the compiler, its options and the machine, shortened.
    """

    folder: Path
    key: str

    @property
    def record(self) -> Path:
        """The file that holds the SHA-256 of the library."""
        return self.folder / f"{self.key}.sha256"

    @property
    def source(self) -> str:
        """Name of the C file."""
        return f"{self.key}.c"

    def is_ready(self) -> bool:
        """Return whether the compiler is done. The library has not been checked then."""
        return self.record.exists()

    def is_intact(self) -> bool:
        """Return whether the library is there and has the content that the compiler wrote."""
        try:
            with opened_privately(self.folder) as directory:
                return directory is not None and self._checked(directory) is not None
        except OSError:
            return False

    def load(self, name: str) -> ca.Function | None:
        """Load a function.

        Args:
            name: Name of the function.

        Returns:
            The compiled function; None where it cannot be loaded, so that the interpreter has to go on: the directory or a file is
            not private, the content is not what the compiler wrote, or the system refuses to load it.
        """
        try:
            with opened_privately(self.folder) as directory:
                digest = None if directory is None else self._checked(directory)
                if digest is None:
                    return None
                # by the descriptor: the directory that was checked, even if its name leads elsewhere by now
                pinned = Path(f"/proc/self/fd/{directory}")
                return ca.external(
                    name, str((pinned if pinned.exists() else self.folder) / f"{digest}.so")
                )
        except (OSError, RuntimeError):  # CasADi's word for what the system's loader refuses
            return None

    def remove(self) -> None:
        """Remove what is recorded under the key."""
        with contextlib.suppress(OSError):
            self.record.unlink()

    def publish(self, built: Path) -> None:
        """Move a library from its staging directory to its place.

        Raises:
            OSError: That is not possible.
        """
        digest = hashlib.sha256(built.read_bytes()).hexdigest()
        built.chmod(0o600)
        os.replace(built, self.folder / f"{digest}.so")
        record = built.with_suffix(".sha256")
        record.touch(mode=0o600)
        record.write_text(digest, encoding="ascii")
        os.replace(record, self.record)

    def _checked(self, directory: int) -> str | None:
        """The SHA-256 of the library, where that is what its content has. Raises OSError where a file is missing."""
        digest = _read_private(self.record.name, directory).decode("ascii", "replace")
        if not re.fullmatch("[0-9a-f]{64}", digest):
            return None
        return (
            digest
            if hashlib.sha256(_read_private(f"{digest}.so", directory)).hexdigest() == digest
            else None
        )


def _read_private(name: str, directory: int) -> bytes:
    """Read a file of a directory. Raises OSError where it is missing or not a private regular file."""
    handle = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=directory)
    with open(handle, "rb") as stream:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode) or not is_private(status):
            raise PermissionError(f"{name}: is not private")
        return stream.read()


def compiler() -> str | None:
    """Path of a C compiler, or None."""
    named = os.environ.get("EXCITE_COMPILER")
    names = ("cc", "gcc", "clang") if named is None else (named,)
    return next((path for name in names if name and (path := shutil.which(name))), None)


def library(functions: Sequence[ca.Function]) -> Library | None:
    """Find or begin to build the library of some functions.

    Args:
        functions: Functions of CasADi.

    Returns:
        The library, which may not be ready; None where there is no compiler, no private cache, or too much code.
    """
    program = compiler()
    is_small = sum(function.n_instructions() for function in functions) <= MOST_INSTRUCTIONS
    if program is None or not is_small or platform.system() == "Windows":
        return None
    folder = private_directory("XDG_CACHE_HOME", ".cache")
    if folder is None:
        return None
    generator = ca.CodeGenerator("functions.c")
    for function in functions:
        generator.add(function)
    code = generator.dump()
    key = hashlib.sha256(
        "\0".join((code, program, *FLAGS, platform.machine())).encode("utf-8", "surrogateescape")
    ).hexdigest()[:32]
    found = Library(folder, key)
    if found.is_intact():
        return found
    found.remove()
    remove_abandoned(folder, STAGING)
    if any(
        (path / found.source).exists()
        for path, abandoned in staging_directories(folder, STAGING)
        if not abandoned
    ):
        return found  # another process is compiling it
    try:
        _Compilation(program, code, found).start()
    except OSError:  # a full disk, no more processes
        return None
    return found


class _Compilation:
    """A compiler at work for this process."""

    def __init__(self, program: str, code: str, library: Library) -> None:
        self._library, self._owner = library, os.getpid()
        self._staging = StagingDirectory(library.folder, STAGING)
        try:
            (self._staging.path / library.source).write_text(code, encoding="utf-8")
            bounds = (str(COMPILER_SECONDS), str(COMPILER_KILOBYTES))
            command = (program, *FLAGS, library.source, "-o", "functions.so")
            self._process = subprocess.Popen(
                ["/bin/sh", "-c", SCRIPT, "excite", *bounds, *command],
                cwd=self._staging.path,
                env={**os.environ, "TMPDIR": str(self._staging.path)},
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError:
            self._staging.remove()
            raise

    def start(self) -> None:
        """Wait for the compiler in a thread."""
        _running.add(self)
        threading.Thread(target=self._collect, daemon=True).start()

    def _collect(self) -> None:
        """Publish the library when the compiler is done, or end the compiler when its time is over."""
        try:
            if (
                self._process.wait(10 * COMPILER_SECONDS) == 0
            ):  # a compiler that waits takes no processor time
                self._library.publish(self._staging.path / "functions.so")
        except (OSError, subprocess.TimeoutExpired):  # the interpreter goes on
            pass
        finally:
            self.stop()

    def stop(self) -> None:
        """End the compiler and whatever it has started, and remove its files."""
        if self._owner != os.getpid():
            return
        if self._process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self.let_go()
        self._staging.remove()
        _running.discard(self)

    def let_go(self) -> None:
        """Close the pipe whose end ends the compiler: a forked process must not keep it open."""
        if self._process.stdin is not None:
            self._process.stdin.close()


_running: set[_Compilation] = set()


def _stop_compilers() -> None:
    for compilation in list(_running):
        compilation.stop()


def _let_go_of_compilers() -> None:
    for compilation in list(_running):
        compilation.let_go()


atexit.register(_stop_compilers)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go_of_compilers)


class Mapped:
    """A CasADi function over `count` samples, reading and writing numpy memory directly.

    Args:
        function: The function of one sample.
        count: Number of samples.
        library: Where the function is compiled, or will be. It is looked for at each call until it is ready, and replaces the
            interpreter then, if it can be loaded.
    """

    def __init__(self, function: ca.Function, count: int, library: Library | None = None) -> None:
        self.results = [np.zeros((count, *_shape(function, i))) for i in range(function.n_out())]
        self.inputs = [
            np.zeros((count, *_shape(function, i, False))) for i in range(function.n_in())
        ]
        self._function, self._count, self._library = function, count, library
        self._use(function)

    def _use(self, function: ca.Function) -> None:
        self._mapped = function.map(self._count)
        self._buffer, self._run = (
            self._mapped.buffer()
        )  # `run` borrows both without keeping them alive
        for i, array in enumerate(self.inputs):
            self._buffer.set_arg(i, memoryview(array))  # type: ignore[arg-type]
        for i, array in enumerate(self.results):
            self._buffer.set_res(i, memoryview(array))  # type: ignore[arg-type]

    def __call__(self, *arguments: Array) -> list[Array]:
        if self._library is not None and self._library.is_ready():
            compiled = self._library.load(self._function.name())
            if compiled is not None and _signature(compiled) == _signature(self._function):
                self._use(compiled)
            self._library = None  # found or not: it is not looked for again
        for target, argument in zip(self.inputs, arguments, strict=True):
            np.copyto(target, argument.reshape(target.shape))
        self._run()
        return self.results


class Padded:
    """`Mapped` for any number of samples: rounded up, so that few sizes are built."""

    def __init__(
        self, function: ca.Function, library: Library | None = None, step: int = 64
    ) -> None:
        self._build: Callable[[int], Mapped] = lambda count: Mapped(function, count, library)
        self._step, self._sizes = step, {}  # type: int, dict[int, Mapped]

    def __call__(self, *arguments: Array) -> list[Array]:
        count = len(arguments[0])
        size = self._step * -(-count // self._step)
        if size not in self._sizes:
            self._sizes[size] = self._build(size)
        padded = [np.concatenate([a, np.zeros((size - count, *a.shape[1:]))]) for a in arguments]
        return [result[:count] for result in self._sizes[size](*padded)]


def _signature(function: ca.Function) -> list[tuple[int, int]]:
    """Sizes of all arguments and results."""
    sizes = [function.size_in(i) for i in range(function.n_in())]
    return sizes + [function.size_out(i) for i in range(function.n_out())]


def _shape(function: ca.Function, index: int, out: bool = True) -> tuple[int, ...]:
    rows, columns = function.size_out(index) if out else function.size_in(index)
    return (rows,) if columns == 1 else (columns, rows)
