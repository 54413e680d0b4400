"""Evaluate CasADi functions over many samples, compiled in the background where possible.

CasADi's interpreter starts at once and performs the same operations in the same order, so that
switching to compiled functions when they are ready does not change any bit of a result. The
environment variable EXCITE_COMPILER names the compiler; if it is empty, none is used.

The cache is a directory that only the user can access; without one nothing is compiled. The file
`<key>.sha256` names the library `<sha256>.so` of a piece of code, whose content is checked before
it is loaded. If anything is wrong with a library, the interpreter continues. A compiler is limited
in time and memory and ends with this process.
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
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from .._system.private_directory import is_private, opened_privately, private_directory
from .._system.staging import StagingDirectory, remove_abandoned, staging_directories
from .._types import FloatArray

COMPILER_OPTIONS = ("-O1", "-fPIC", "-shared", "-ffp-contract=off")
"""Options of the compiler; contracted operations would round differently."""

MAX_INSTRUCTIONS = 300_000
"""Instructions of CasADi's interpreter above which nothing is compiled [1].

gcc 12 needs 1 s and 90 MB for a Panda (12,000 instructions, 0.3 MB of C), 33 s and 840 MB for a
chain of 30 joints (230,000 instructions, 6 MB), and over 150 s for a chain of 60.
"""

COMPILER_SECONDS = 120
"""Largest processor time of the compiler [s]."""

COMPILER_KILOBYTES = 2_000_000
"""Largest address space of the compiler [kB]."""

WAITING_FACTOR = 10
"""Largest waiting time for the compiler over its processor time [1]."""

BATCH_STEP = 64
"""Numbers of samples of `PaddedFunction` are rounded up to multiples of this [1]."""

STAGING = "compilation"
"""Name of the staging directories of compilers."""

# Runs the compiler in its own process group. Standard input is a pipe whose other end is held by
# the process that wants the library: when that process ends for any reason, the pipe closes and the
# group is killed.
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
class CompiledLibrary:
    """Compiled functions in the cache, possibly still being compiled in the background.

    Attributes:
        folder: Directory of the cache.
        key: SHA-256 of the C code, the compiler, its options and the machine, shortened.
    """

    folder: Path
    key: str

    @property
    def record(self) -> Path:
        """File that holds the SHA-256 of the library."""
        return self.folder / f"{self.key}.sha256"

    @property
    def source(self) -> str:
        """Name of the C file."""
        return f"{self.key}.c"

    def is_ready(self) -> bool:
        """Return whether the compiler has ended; the library is not checked."""
        return self.record.exists()

    def is_intact(self) -> bool:
        """Return whether the library exists with the content that the compiler wrote."""
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
            The compiled function; None where it cannot be loaded: the directory or a file is not
            private, the content is not that of the compiler, or the system refuses to load it.
        """
        try:
            with opened_privately(self.folder) as directory:
                digest = None if directory is None else self._checked(directory)
                if digest is None:
                    return None
                # the descriptor denotes the checked directory even if its name was redirected
                pinned = Path(f"/proc/self/fd/{directory}")
                return ca.external(
                    name, str((pinned if pinned.exists() else self.folder) / f"{digest}.so")
                )
        except (OSError, RuntimeError):  # CasADi raises it where the system's loader fails
            return None

    def remove(self) -> None:
        """Remove the record of the library."""
        with contextlib.suppress(OSError):
            self.record.unlink()

    def publish(self, built: Path) -> None:
        """Move a library from its staging directory to its place.

        Args:
            built: Path of the library in its staging directory.

        Raises:
            OSError: A file cannot be moved or written.
        """
        digest = hashlib.sha256(built.read_bytes()).hexdigest()
        built.chmod(0o600)
        os.replace(built, self.folder / f"{digest}.so")
        record = built.with_suffix(".sha256")
        record.touch(mode=0o600)
        record.write_text(digest, encoding="ascii")
        os.replace(record, self.record)

    def _checked(self, directory: int) -> str | None:
        """Return the SHA-256 of an intact library, else None; OSError where a file is missing."""
        digest = _read_private(self.record.name, directory).decode("ascii", "replace")
        if not re.fullmatch("[0-9a-f]{64}", digest):
            return None
        return (
            digest
            if hashlib.sha256(_read_private(f"{digest}.so", directory)).hexdigest() == digest
            else None
        )


def _read_private(name: str, directory: int) -> bytes:
    """Read a file of a directory; OSError where it is not a private regular file."""
    handle = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=directory)
    with open(handle, "rb") as stream:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode) or not is_private(status):
            raise PermissionError(f"{name}: is not private")
        return stream.read()


def find_compiler() -> str | None:
    """Return the path of a C compiler, None where there is none."""
    named = os.environ.get("EXCITE_COMPILER")
    names = ("cc", "gcc", "clang") if named is None else (named,)
    return next((path for name in names if name and (path := shutil.which(name))), None)


def find_library(functions: Sequence[ca.Function]) -> CompiledLibrary | None:
    """Find the library of functions, or begin to build it.

    Args:
        functions: Functions of CasADi.

    Returns:
        The library, which may not be ready yet; None where there is no compiler or private cache,
        or where there is too much code.
    """
    program = find_compiler()
    is_small = sum(function.n_instructions() for function in functions) <= MAX_INSTRUCTIONS
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
        "\0".join((code, program, *COMPILER_OPTIONS, platform.machine())).encode(
            "utf-8", "surrogateescape"
        )
    ).hexdigest()[:32]
    cached = CompiledLibrary(folder, key)
    if cached.is_intact():
        return cached
    cached.remove()
    remove_abandoned(folder, STAGING)
    if any(
        (path / cached.source).exists()
        for path, abandoned in staging_directories(folder, STAGING)
        if not abandoned
    ):
        return cached  # another process is compiling it
    try:
        _Compilation(program, code, cached).start()
    except (OSError, RuntimeError):  # a full disk, no more processes or threads
        return None
    return cached


class _Compilation:
    """Running compiler of this process."""

    def __init__(self, program: str, code: str, library: CompiledLibrary) -> None:
        """Start the compiler.

        Args:
            program: Path of the compiler.
            code: C code.
            library: CompiledLibrary to build.
        """
        self._library, self._owner = library, os.getpid()
        self._staging = StagingDirectory(library.folder, STAGING)
        try:
            (self._staging.path / library.source).write_text(code, encoding="utf-8")
            bounds = (str(COMPILER_SECONDS), str(COMPILER_KILOBYTES))
            command = (program, *COMPILER_OPTIONS, library.source, "-o", "functions.so")
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
        """Wait for the compiler in a thread; RuntimeError where the system has no more threads."""
        _running.add(self)
        try:
            threading.Thread(target=self._collect, daemon=True).start()
        except RuntimeError:
            self.stop()
            raise

    def _collect(self) -> None:
        """Publish the library when the compiler ends; stop it when its time is over."""
        try:
            # a compiler that waits takes no processor time
            if self._process.wait(WAITING_FACTOR * COMPILER_SECONDS) == 0:
                self._library.publish(self._staging.path / "functions.so")
        except (OSError, subprocess.TimeoutExpired):  # the interpreter continues
            pass
        finally:
            self.stop()

    def stop(self) -> None:
        """Stop the compiler with its child processes, and remove its files."""
        if self._owner != os.getpid():
            return
        if self._process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self.close_pipe()
        self._staging.remove()
        _running.discard(self)

    def close_pipe(self) -> None:
        """Close the pipe that keeps the compiler alive; a forked process must not hold it."""
        if self._process.stdin is not None:
            self._process.stdin.close()


_running: set[_Compilation] = set()


def _stop_compilers() -> None:
    """Stop all compilers of this process."""
    for compilation in list(_running):
        compilation.stop()


def _close_pipes() -> None:
    """Close the pipes of all compilers, in a forked process."""
    for compilation in list(_running):
        compilation.close_pipe()


atexit.register(_stop_compilers)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_close_pipes)


class MappedFunction:
    """CasADi function over a fixed number of samples that accesses numpy memory directly.

    Attributes:
        inputs: Arrays of the arguments, by sample.
        results: Arrays of the results, by sample; the next call overwrites them.
    """

    def __init__(
        self, function: ca.Function, count: int, library: CompiledLibrary | None = None
    ) -> None:
        """Allocate the memory and begin with the interpreter.

        Args:
            function: Function of one sample.
            count: Number of samples.
            library: Library of the function. It replaces the interpreter at the first call at which
                it is ready, if it can be loaded.
        """
        self.results = [np.zeros((count, *_shape(function, i))) for i in range(function.n_out())]
        self.inputs = [
            np.zeros((count, *_shape(function, i, False))) for i in range(function.n_in())
        ]
        self._function, self._count, self._library = function, count, library
        self._use(function)

    def _use(self, function: ca.Function) -> None:
        """Evaluate a function from now on."""
        self._mapped = function.map(self._count)
        # `_run` borrows the map and the buffer without keeping them alive
        self._buffer, self._run = self._mapped.buffer()
        for i, array in enumerate(self.inputs):
            self._buffer.set_arg(i, memoryview(array))  # type: ignore[arg-type]
        for i, array in enumerate(self.results):
            self._buffer.set_res(i, memoryview(array))  # type: ignore[arg-type]

    def __call__(self, *arguments: FloatArray) -> list[FloatArray]:
        """Evaluate the function. Shape of arguments and results: (N, …)."""
        if self._library is not None and self._library.is_ready():
            compiled = self._library.load(self._function.name())
            if compiled is not None and _signature(compiled) == _signature(self._function):
                self._use(compiled)
            self._library = None  # it is loaded only once
        for target, argument in zip(self.inputs, arguments, strict=True):
            np.copyto(target, argument.reshape(target.shape))
        self._run()
        return self.results


class PaddedFunction:
    """`MappedFunction` for any number of samples, rounded up so that few sizes are built."""

    def __init__(self, function: ca.Function, library: CompiledLibrary | None = None) -> None:
        """Store the function of one sample and its library."""
        self._function, self._library = function, library
        self._sizes: dict[int, MappedFunction] = {}

    def __call__(self, *arguments: FloatArray) -> list[FloatArray]:
        """Evaluate the function. Shape of arguments and results: (N, …)."""
        count = len(arguments[0])
        size = BATCH_STEP * -(-count // BATCH_STEP)
        if size not in self._sizes:
            self._sizes[size] = MappedFunction(self._function, size, self._library)
        padded = [np.concatenate([a, np.zeros((size - count, *a.shape[1:]))]) for a in arguments]
        return [result[:count] for result in self._sizes[size](*padded)]


def _signature(function: ca.Function) -> list[tuple[int, int]]:
    """Return the sizes of all arguments and results."""
    sizes = [function.size_in(i) for i in range(function.n_in())]
    return sizes + [function.size_out(i) for i in range(function.n_out())]


def _shape(function: ca.Function, index: int, out: bool = True) -> tuple[int, ...]:
    """Return the shape of a result or an argument, its columns first."""
    rows, columns = function.size_out(index) if out else function.size_in(index)
    return (rows,) if columns == 1 else (columns, rows)
