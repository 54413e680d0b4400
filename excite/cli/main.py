"""The command line: parse the arguments, run the command, print its result."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from collections.abc import Callable, Sequence

from .._system import process
from .._system.blas_threads import single_blas_thread
from .._system.console import emit
from .parser import parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        argv: Arguments of the command; None: those of the process, which ends after the command.

    Returns:
        The exit code: 0 done, 1 a check failed or nothing is feasible, 2 unusable input, 70 an
        unexpected error.
    """
    stated = sys.argv[1:] if argv is None else list(argv)
    return process.run(lambda: _execute(stated), stated, owns_process=argv is None)


def _execute(argv: Sequence[str]) -> int:
    """Run a command and print its result; return the exit code."""
    arguments = parser().parse_args(argv or ["--help"])
    from .console import Console  # here, so that help does not wait for the import of logging

    with Console(arguments.quiet, arguments.verbose).attached():
        module = importlib.import_module(f"{__package__}.{arguments.command}")
        run: Callable[[argparse.Namespace], tuple[int, object, str]] = module.run
        with single_blas_thread():
            code, document, text = run(arguments)
    if arguments.json:
        from .._json import plain

        text = json.dumps(plain(document), allow_nan=False)
    emit(f"{text}\n")
    return code
