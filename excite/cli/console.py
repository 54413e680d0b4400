"""What a command prints on standard error: progress, warnings, remarks."""

from __future__ import annotations

import shutil
import sys
import time
from dataclasses import dataclass, field


@dataclass
class Console:
    """Standard error of a command.

    On a terminal, progress is one line that is written over; elsewhere, each message is a line of its own.

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
        if sys.stderr.isatty() and not self.verbose:
            width = shutil.get_terminal_size().columns
            print(f"\r\x1b[K{text[: width - 1]}", end="", file=sys.stderr, flush=True)
            self._is_open = True
        else:
            print(text, file=sys.stderr, flush=True)

    def warn(self, text: str) -> None:
        """Print a warning on a line of its own."""
        if not self.quiet:
            self.finish()
            print(f"warning: {text}", file=sys.stderr, flush=True)

    def finish(self) -> None:
        """Remove a progress line that is still open."""
        if self._is_open:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
            self._is_open = False
