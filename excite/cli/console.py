"""Standard error of a command: progress, warnings, remarks."""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from dataclasses import dataclass, field

from .._system.console import say


@dataclass
class Console:
    """Standard error of a command.

    On a terminal, progress is one line that is written over; elsewhere, each message is a line.

    Attributes:
        quiet: Print neither progress nor warnings.
        verbose: Print every progress message as a line, with the time since the command began.
    """

    quiet: bool = False
    verbose: bool = False
    _begun: float = field(default_factory=time.perf_counter)
    _is_open: bool = False

    def progress(self, text: str) -> None:
        """Show what the command is doing."""
        if self.quiet:
            return
        if self.verbose:
            text = f"{time.perf_counter() - self._begun:7.2f} s  {text}"
        elif _is_terminal():
            width = shutil.get_terminal_size().columns
            self._write(f"\r\x1b[K{text[: width - 1]}")
            self._is_open = True
            return
        say(text)

    def warn(self, text: str) -> None:
        """Print a warning on a line of its own."""
        if not self.quiet:
            self.finish()
            say(f"warning: {text}")

    def finish(self) -> None:
        """Remove a progress line that is still open."""
        if self._is_open:
            self._write("\r\x1b[K")
            self._is_open = False

    @staticmethod
    def _write(text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # cut off or closed
            sys.stderr.write(text)
            sys.stderr.flush()


def _is_terminal() -> bool:
    return sys.stderr is not None and not sys.stderr.closed and sys.stderr.isatty()
