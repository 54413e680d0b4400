"""Standard error of a command: a logging handler that shows progress and warnings.

On a terminal, progress is one line that is overwritten; elsewhere, each message is a line. tqdm
would take 37 ms to import and rich 40 ms, where `excite --help` takes 90 ms in total; neither shows
a message without a count in fewer lines than the class below.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
import sys
import time
import warnings
from collections.abc import Iterator

from .._system.console import say
from .._system.progress import logger
from ..errors import ExciteWarning


class Console(logging.Handler):
    """Standard error of a command, as a handler of the package's logger.

    Attributes:
        quiet: Print neither progress nor warnings.
        verbose: Print every progress message as a line, with the time since the command began.
    """

    def __init__(self, quiet: bool = False, verbose: bool = False) -> None:
        super().__init__(logging.INFO)
        self.quiet = quiet
        self.verbose = verbose
        self._begun = time.perf_counter()
        self._is_open = False
        self._warned: set[str] = set()

    @contextlib.contextmanager
    def attached(self) -> Iterator[None]:
        """Show the messages of the logger "excite" and all `ExciteWarning`s within the block."""
        level = logger.level
        logger.addHandler(self)
        logger.setLevel(logging.INFO)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("always", ExciteWarning)
                warnings.showwarning = self._show_warning  # type: ignore[assignment]
                yield
        finally:
            logger.removeHandler(self)
            logger.setLevel(level)
            self.finish()

    def emit(self, record: logging.LogRecord) -> None:
        """Show a message: as a warning from level WARNING on, as progress below."""
        if record.levelno >= logging.WARNING:
            self._warn(record.getMessage())
        else:
            self._progress(record.getMessage())

    def finish(self) -> None:
        """Remove a progress line that is still open."""
        if self._is_open:
            self._write("\r\x1b[K")
            self._is_open = False

    def _progress(self, text: str) -> None:
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

    def _warn(self, text: str) -> None:
        """Print a warning on a line of its own, once per command."""
        if self.quiet or text in self._warned:
            return
        self._warned.add(text)
        self.finish()
        say(f"warning: {text}")

    def _show_warning(self, message: Warning | str, category: type[Warning], *_: object) -> None:
        self._warn(str(message))

    @staticmethod
    def _write(text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # closed
            sys.stderr.write(text)
            sys.stderr.flush()


def _is_terminal() -> bool:
    return sys.stderr is not None and not sys.stderr.closed and sys.stderr.isatty()
