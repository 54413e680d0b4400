"""The command line: parse, call a command, print its result."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import warnings
from collections.abc import Callable, Sequence

from ..errors import ExciteError, ExciteWarning
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
        argv: Its arguments; those of the process when None.

    Returns:
        The exit code: 0 done, 1 a check failed or nothing is feasible, 2 unusable input.
    """
    console = Console()
    with warnings.catch_warnings():
        warnings.simplefilter("always", ExciteWarning)
        warnings.showwarning = _WarningPrinter(console)  # type: ignore[assignment]
        try:
            words = sys.argv[1:] if argv is None else list(argv)
            arguments = parser().parse_args(words or ["--help"])
            console = arguments.console = Console(arguments.quiet, arguments.verbose)
            warnings.showwarning = _WarningPrinter(console)  # type: ignore[assignment]
            from threadpoolctl import threadpool_limits

            module = importlib.import_module(f"{__package__}.{arguments.command}")
            run: Callable[[argparse.Namespace], tuple[int, object, str]] = module.run
            with threadpool_limits(1):  # small matrices: BLAS threads cost more than they bring
                code, document, text = run(arguments)
            console.finish()
        except ExciteError as error:
            console.finish()
            print(f"excite: {' '.join(str(error).split())}", file=sys.stderr)
            return error.exit_code
        except KeyboardInterrupt:
            print("excite: interrupted; nothing was written", file=sys.stderr)
            return 1
    try:
        if arguments.json:
            from .._json import plain

            json.dump(plain(document), sys.stdout, allow_nan=False)
            print()
        else:
            print(text)
        sys.stdout.flush()
    except BrokenPipeError:
        sys.stderr.close()
    return code
