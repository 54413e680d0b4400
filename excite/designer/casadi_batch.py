"""Generated C of the dynamics, compiled in the background where there is a compiler, and kept for the next time.

CasADi's virtual machine starts at once and computes the same operations in the same order, so that switching to the
library when it is ready changes no bit of the result. EXCITE_COMPILER names the compiler; empty, none is used.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import casadi as ca
import numpy as np

Array = np.ndarray
FLAGS = ("-O1", "-fPIC", "-shared", "-ffp-contract=off")  # fused operations would round differently


def cache() -> Path:
    """The folder of compiled libraries."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "excite"


def compiler() -> str | None:
    """Path of a C compiler, or None."""
    named = os.environ.get("EXCITE_COMPILER")
    names = ("cc", "gcc", "clang") if named is None else (named,)
    return next((path for name in names if name and (path := shutil.which(name))), None)


def library(functions: Sequence[ca.Function]) -> Path | None:
    """Where the compiled functions are, or will be once a compiler that runs in the background is done; None without one."""
    program = compiler()
    if program is None or platform.system() == "Windows":
        return None
    generator = ca.CodeGenerator("functions.c")
    for function in functions:
        generator.add(function)
    code = generator.dump()
    key = hashlib.sha256(
        "\0".join((code, program, *FLAGS, platform.machine())).encode()
    ).hexdigest()
    folder = cache()
    target = folder / f"{key[:32]}.so"
    if target.exists():
        return target
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", suffix=".c", dir=folder, delete=False) as file:
            file.write(code)
        _compile(program, Path(file.name), target)
    except OSError:  # a read-only home: the virtual machine does it
        return None
    return target


def _compile(program: str, source: Path, target: Path) -> None:
    """Compile in a process of its own that outlives this one; the library appears under its name whole or not at all."""
    built = source.with_suffix(".so")
    first = shlex.join(["nice", program, *FLAGS, str(source), "-o", str(built)])
    script = f"{first} && {shlex.join(['mv', str(built), str(target)])}; {shlex.join(['rm', '-f', str(source), str(built)])}"
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(
        ["/bin/sh", "-c", script], stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
    )
    threading.Thread(target=process.wait, daemon=True).start()  # somebody has to collect it


class Mapped:
    """A CasADi function over `count` samples, reading and writing numpy memory directly.

    library: looked for at each call until it is there; then it replaces the virtual machine.
    """

    def __init__(self, function: ca.Function, count: int, library: Path | None = None) -> None:
        self.results = [np.zeros((count, *_shape(function, i))) for i in range(function.n_out())]
        self.inputs = [
            np.zeros((count, *_shape(function, i, False))) for i in range(function.n_in())
        ]
        self._name, self._count, self._library = function.name(), count, library
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
        if self._library is not None and self._library.exists():
            self._use(ca.external(self._name, str(self._library)))
            self._library = None
        for target, argument in zip(self.inputs, arguments, strict=True):
            np.copyto(target, argument.reshape(target.shape))
        self._run()
        return self.results


class Padded:
    """`Mapped` for any number of samples: rounded up, so that few sizes are built."""

    def __init__(self, function: ca.Function, library: Path | None = None, step: int = 64) -> None:
        self._build: Callable[[int], Mapped] = lambda count: Mapped(function, count, library)
        self._step, self._sizes = step, {}  # type: int, dict[int, Mapped]

    def __call__(self, *arguments: Array) -> list[Array]:
        count = len(arguments[0])
        size = self._step * -(-count // self._step)
        if size not in self._sizes:
            self._sizes[size] = self._build(size)
        padded = [np.concatenate([a, np.zeros((size - count, *a.shape[1:]))]) for a in arguments]
        return [result[:count] for result in self._sizes[size](*padded)]


def _shape(function: ca.Function, index: int, out: bool = True) -> tuple[int, ...]:
    rows, columns = function.size_out(index) if out else function.size_in(index)
    return (rows,) if columns == 1 else (columns, rows)
