"""The command line: parse, call a command, print its result."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import warnings
from collections.abc import Callable, Sequence

from .._system import process
from .._system.console import emit
from ..errors import ExciteWarning
from .console import Console
from .parser import parser


class _WarningPrinter:
    """Print each warning once a command, however often it is given."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._printed: set[str] = set()

    def __call__(self, message: Warning | str, category: type[Warning], *_: object) -> None:
        if str(message) not in self._printed:
            self._printed.add(str(message))
            self._console.warn(str(message))


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        argv: Its arguments; those of the process where None, which ends after the command then.

    Returns:
        The exit code: 0 done, 1 a check failed or nothing is feasible, 2 unusable input, 70 an
        unforeseen error.
    """
    stated = sys.argv[1:] if argv is None else list(argv)
    return process.run(lambda: _execute(stated), stated, owns_process=argv is None)


def _execute(argv: Sequence[str]) -> int:
    """Run a command and print its result; return the exit code."""
    arguments = parser().parse_args(argv or ["--help"])
    console = arguments.console = Console(arguments.quiet, arguments.verbose)
    with warnings.catch_warnings():
        warnings.simplefilter("always", ExciteWarning)
        warnings.showwarning = _WarningPrinter(console)  # type: ignore[assignment]
        from threadpoolctl import threadpool_limits

        module = importlib.import_module(f"{__package__}.{arguments.command}")
        run: Callable[[argparse.Namespace], tuple[int, object, str]] = module.run
        try:
            with threadpool_limits(1):  # small matrices: BLAS threads cost more than they bring
                code, document, text = run(arguments)
        finally:
            console.finish()
    if arguments.json:
        from .._json import plain

        text = json.dumps(plain(document), allow_nan=False)
    emit(f"{text}\n")
    return code
