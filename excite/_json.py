"""Strict JSON: what a parser of the standard reads everywhere, with numbers that read back
exactly."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ._system.text import displayable


def plain(value: Any) -> Any:
    """A value as strict JSON holds it: arrays as lists, what is not finite as null."""
    if isinstance(value, str):  # lone surrogates: names of files that are not UTF-8
        return displayable(value)
    if isinstance(value, Mapping):
        return {plain(str(k)): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def dumps(document: Any) -> str:
    """Strict JSON, keys in the order given, numbers that read back exactly."""
    return json.dumps(plain(document), indent=1, allow_nan=False, ensure_ascii=False)
