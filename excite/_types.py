"""Array types shared by all modules; shapes are stated in docstrings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Array of double-precision numbers."""
IntArray = NDArray[np.intp]
"""Array of indices or counts."""
BoolArray = NDArray[np.bool_]
"""Mask."""
