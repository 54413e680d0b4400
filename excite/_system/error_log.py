"""Logs of unexpected errors."""

from __future__ import annotations

import contextlib
import os
import platform
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path

from .. import __version__
from .private_directory import private_directory

PACKAGES = ("casadi", "coal", "joblib", "matplotlib", "mujoco", "numpy", "pin", "ruckig", "scipy")
"""Packages whose versions are logged."""


def write_error_log(error: BaseException, argv: Sequence[str]) -> Path | None:
    """Write a log with the data that are needed to reproduce an error.

    Its folder is `$XDG_STATE_HOME/excite`, or else the directory of temporary files.

    Args:
        error: The error.
        argv: Arguments of the command.

    Returns:
        The file, which only the user can read; None if it cannot be written.
    """
    lines = [
        f"time: {time.strftime('%Y-%m-%d %H:%M:%S %z')}",
        f"command: excite {' '.join(map(repr, argv))}",
        f"directory: {_current_directory()}",
        f"system: {platform.platform()}, Python {platform.python_version()}",
        "versions: excite "
        f"{__version__}{''.join(f', {name} {version}' for name, version in _versions())}",
        "",
        "".join(traceback.format_exception(error)),
    ]
    for folder in (private_directory("XDG_STATE_HOME", ".local/state"), None):
        with contextlib.suppress(OSError):
            prefix = time.strftime(
                "error-%Y%m%d-%H%M%S-" if folder else "excite-error-%Y%m%d-%H%M%S-"
            )
            handle, name = tempfile.mkstemp(".log", prefix, folder)
            with open(handle, "w", encoding="utf-8", errors="backslashreplace") as stream:
                stream.write("\n".join(lines))
            return Path(name)
    return None


def _versions() -> Iterator[tuple[str, str]]:
    from importlib import metadata  # takes 10 ms

    for name in PACKAGES:
        # OSError: too many open files
        with contextlib.suppress(metadata.PackageNotFoundError, OSError):
            yield name, metadata.version(name)


def _current_directory() -> str:
    try:
        return os.getcwd()
    except OSError:
        return f"none; {sys.executable}"
