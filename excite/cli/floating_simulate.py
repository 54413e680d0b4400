"""`excite simulate --floating`: simulate a recording of a robot whose base moves freely."""

from __future__ import annotations

import argparse
from pathlib import Path

from .._system.output_files import output_files
from ..api.floating_simulation import simulate_floating
from ..api.simulated_recording import checked_path
from ..recordings.floating_signals import WORLD
from . import options as shared
from .outcome import Outcome, written_lines

UNSUPPORTED = {
    "--effect": "effect",
    "--dense": "dense",
    "--severity": "severity",
    "--trusted": "trusted",
    "--like": "like",
    "--periods": "periods",
    "--rate": "rate",
    "--noise": "noise",
    "--colour": "colour",
    "--jitter": "jitter",
    "--encoder": "encoder",
}
"""Options of `excite simulate` that a floating base does not have."""
FLOATING_ONLY = {
    "--contact": "contact",
    "--wrench-noise": "wrench_noise",
    "--torque-noise": "torque_noise",
}
"""Options that only a floating base has."""


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite simulate --floating`: write the recording and its true parameters."""
    shared.refuse_with_floating(arguments, UNSUPPORTED)
    path = checked_path(arguments.out)
    inputs = [Path(arguments.robot), Path(arguments.trajectory)]
    output = output_files(path, [f"{path.stem}.truth.json"], inputs)
    result = simulate_floating(
        arguments.robot,
        arguments.trajectory,
        contacts=arguments.contact or (WORLD,),
        wrench_noise=arguments.wrench_noise,
        torque_noise=arguments.torque_noise,
        model_error=0.05 if arguments.model_error is None else arguments.model_error,
        seed=arguments.seed or 0,
    )
    written = output.replace(result.contents(path.name))
    document = {
        "files": [str(file) for file in written],
        "rows": len(result.table),
        "columns": list(result.columns),
    }
    return 0, document, "\n".join(written_lines(written))
