"""Types shared by all modules; shapes of arrays are stated in docstrings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Array of double-precision numbers."""
IntArray = NDArray[np.intp]
"""Array of indices or counts."""
BoolArray = NDArray[np.bool_]
"""Mask."""
Paths = str | Path | Sequence[str | Path]
"""A path, or several."""
