"""Run a command: every outcome is an exit code and at most one line on standard error."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Sequence

from ..errors import ExciteError
from .console import prepared, say
from .error_log import write_error_log
from .output_files import replaced_files
from .signals import exit_with, handled

INTERRUPTED = 1
"""Exit code after an interruption."""
UNEXPECTED = 70
"""Exit code after an unexpected error: EX_SOFTWARE of <sysexits.h>."""
TRACKER_WARNING = "ignore:resource_tracker:UserWarning"
"""Filter of the warning with which joblib's resource tracker, which outlives an interrupted run,
removes its folders of shared memory."""


def run(command: Callable[[], int], argv: Sequence[str], *, owns_process: bool) -> int:
    """Run a command.

    Args:
        command: Returns its exit code; exceptions are reported.
        argv: Arguments of the command, for the log of an unexpected error.
        owns_process: True if the process ends after the command: signals then end it at once.

    Returns:
        The exit code: that of the command or of the `ExciteError` it raised, 1 after an
        interruption, 70 after an unexpected error.
    """
    already = len(replaced_files())

    def written() -> str:
        return ", ".join(map(str, replaced_files()[already:]))

    def interrupted(word: str) -> str:
        return (
            f"excite: {word} after all files were written: {paths}"
            if (paths := written())
            else f"excite: {word}; nothing was written"
        )

    def end(word: str) -> None:
        with contextlib.suppress(OSError):  # standard error is closed or full
            os.write(2, f"{interrupted(word)}\n".encode("utf-8", "replace"))
        active_children = getattr(sys.modules.get("multiprocessing"), "active_children", list)
        for child in active_children():
            with contextlib.suppress(OSError):
                os.kill(child.pid, signal.SIGKILL)
        os._exit(INTERRUPTED)

    if owns_process:
        filters = filter(None, [os.environ.get("PYTHONWARNINGS"), TRACKER_WARNING])
        os.environ["PYTHONWARNINGS"] = ",".join(filters)
    with prepared(), handled(end if owns_process else None):
        try:
            code, message = _outcome(command, argv)
            if message:
                paths = written()
                earlier = f"; files that were written before: {paths}" if paths else ""
                say(f"excite: {message}{earlier}")
        except KeyboardInterrupt as interruption:
            say(interrupted(str(interruption) or "interrupted"))
            code = INTERRUPTED
        if owns_process:
            exit_with(code)
        return code


def _outcome(command: Callable[[], int], argv: Sequence[str]) -> tuple[int, str]:
    """Return the exit code of a command, and the line about an error; empty without."""
    try:
        return command(), ""
    except ExciteError as error:
        return error.exit_code, _one_line(error)
    except SystemExit as end:  # --help, --version
        return end.code if isinstance(end.code, int) else 0, ""
    except Exception as error:
        return UNEXPECTED, _report_unexpected(error, argv)


def _report_unexpected(error: Exception, argv: Sequence[str]) -> str:
    """Log an unexpected error and return the line about it."""
    log = None
    with contextlib.suppress(MemoryError, RecursionError, OSError):
        log = write_error_log(error, argv)
    place = "no log of it could be written" if log is None else f"its log is {log}"
    if isinstance(error, MemoryError):
        details = _one_line(error) or "no details"
        return f"out of memory ({details}); use fewer samples, harmonics or joints; {place}"
    return (
        f"unexpected error, please report it: {type(error).__name__}: {_one_line(error)}; {place}"
    )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
