"""Path of the faulty inputs of the shared folder; tests that read them are skipped without it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_SHARED = Path(os.environ.get("EXCITE_SHARED", Path(__file__).resolve().parents[2] / "shared"))
INPUTS: Path | None = (
    _SHARED / "inputs" / "files" if (_SHARED / "inputs" / "files").is_dir() else None
)

needs_inputs = pytest.mark.skipif(
    INPUTS is None, reason=f"the shared inputs are not at {_SHARED / 'inputs' / 'files'}"
)
