"""`excite predict`: predict the torque along a recording with an identified model."""

from __future__ import annotations

import argparse
from pathlib import Path

from .. import api
from .._system.output_files import output_files
from . import options as shared
from .outcome import Outcome


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite predict`: predict torque at the times of the recording."""
    path = Path(arguments.out)
    output = output_files(path, inputs=shared.input_files(arguments))
    result = api.predict(arguments.model, arguments.recording, columns=shared.columns(arguments))
    path = output.replace({path.name: result.csv()})[0]
    return 0, {"file": str(path), "rows": len(result.time)}, f"wrote {path}"
