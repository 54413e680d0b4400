"""Standard streams of the command line, in any encoding, closed, full or disconnected."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import TextIO

from ..errors import UnusableInput


@contextlib.contextmanager
def prepared() -> Iterator[None]:
    """Make standard output and standard error usable within the block.

    Characters that the encoding lacks are replaced. A closed stream and its file descriptor are
    replaced by the null device: otherwise a file that is opened later would get the descriptor and
    receive the output of libraries.
    """
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(handle)
    before = sys.stdout, sys.stderr
    with open(os.devnull, "w", encoding="utf-8") as null:
        sys.stdout, sys.stderr = sys.stdout or null, sys.stderr or null
        errors = getattr(sys.stdout, "errors", None)
        _set_errors(sys.stdout, "replace")
        try:
            yield
        finally:
            if errors is not None:
                _set_errors(sys.stdout, errors)
            sys.stdout, sys.stderr = before


def say(text: str) -> None:
    """Print a line on standard error; ignore a stream that is full, disconnected or closed."""
    try:
        sys.stderr.write(f"{text}\n")  # at once: a signal may come between two pieces of a line
        sys.stderr.flush()
    except (OSError, ValueError):  # full, disconnected or closed
        _discard(sys.stderr, 2)


def emit(text: str) -> None:
    """Print the result of a command on standard output.

    A reader that has ended (`| head`) is no error.

    Raises:
        UnusableInput: The text cannot be written, for example because a disk is full.
    """
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        _discard(sys.stdout, 1)
    except (OSError, UnicodeError) as error:
        _discard(sys.stdout, 1)
        reason = getattr(error, "strerror", None) or str(error)
        raise UnusableInput(
            f"standard output cannot be written ({reason}); send it elsewhere"
        ) from error


def _set_errors(stream: TextIO, errors: str) -> None:
    if hasattr(stream, "reconfigure"):
        stream.reconfigure(errors=errors)


def _discard(stream: TextIO, handle: int) -> None:
    """Send the buffer of a stream and all later output to the null device."""
    with contextlib.suppress(OSError, ValueError):
        if stream.fileno() != handle:  # the calling program has replaced it
            return
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, handle)
        os.close(null)
        stream.flush()
