"""`python -m excite`, and the program `excite`: the command line, with Ctrl-C handled from the first moment on."""

from __future__ import annotations

import contextlib
import os
import sys


def main() -> int:
    """Run the command line with the arguments of the process and return its exit code."""
    try:
        from .cli.main import main as run

        return run()
    except KeyboardInterrupt:  # before `run` handles it
        with contextlib.suppress(OSError):  # standard error is closed or full
            os.write(2, b"excite: interrupted; nothing was written\n")
        os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
