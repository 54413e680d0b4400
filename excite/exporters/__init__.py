"""Files for controllers: a certified motion in the format of a robot controller, and back.

`formats.py` lists the formats and says how to add one.
"""

from __future__ import annotations

from .file_format import Columns, Torque
from .formats import FORMATS, read, write

__all__ = ["FORMATS", "Columns", "Torque", "read", "write"]
