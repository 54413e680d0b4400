"""`excite predict`: torque by an identified model along a recording."""

from __future__ import annotations

import argparse

from .. import api
from .outcome import Outcome


def run(arguments: argparse.Namespace) -> Outcome:
    """Predict torque at the recording's own times."""
    result = api.predict(arguments.model, arguments.recording)
    path = result.save(arguments.out)
    return 0, {"file": str(path), "rows": len(result.time)}, f"wrote {path}"
