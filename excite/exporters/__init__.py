"""Files for controllers and simulators: a certified motion, or an identified robot.

`formats.py` lists the formats of a motion, `model_formats.py` those of an identified robot; both
say how to add one.
"""

from __future__ import annotations

from .file_format import Columns, Torque
from .formats import FORMATS, read, write
from .model_formats import MODEL_FORMATS

__all__ = ["FORMATS", "MODEL_FORMATS", "Columns", "Torque", "read", "write"]
