"""Progress of long computations: messages to the logger "excite" at level INFO.

In a program, `logging.basicConfig(level=logging.INFO)` shows them; without a handler they are
discarded. Warnings are issued as `ExciteWarning` by the module `warnings`. The command line
attaches a handler that shows both on standard error.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TypeAlias

Progress: TypeAlias = Callable[[str], None]
"""Function that is called with a line of text now and then."""

logger = logging.getLogger("excite")
logger.addHandler(logging.NullHandler())
