"""`excite simulate --floating`: simulate a recording of a robot whose base moves freely."""

from __future__ import annotations

import argparse
from pathlib import Path

from .._system.output_files import output_files
from ..api.floating_simulation import SimulatedFloatingRecording, simulate_floating
from ..api.simulated_recording import checked_path
from ..api.standing_simulation import DEFAULT_RATE, simulate_standing
from ..errors import UnusableInput
from ..recordings.floating_signals import WORLD
from . import options as shared
from .outcome import Outcome, written_lines

UNSUPPORTED = (
    "--effect",
    "--dense",
    "--severity",
    "--trusted",
    "--like",
    "--periods",
    "--noise",
    "--colour",
    "--jitter",
    "--encoder",
)
"""Options of `excite simulate` that a floating base does not have."""
FLOATING_ONLY = (
    "--contact",
    "--wrench-noise",
    "--torque-noise",
)
"""Options that only a floating base has."""


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite simulate --floating`: write the recording and its true parameters.

    A robot on the feet of a `trajectory.json` is simulated with contact; the motion of a CSV file
    is taken as it is.
    """
    shared.refuse_with_floating(arguments, UNSUPPORTED)
    path = checked_path(arguments.out)
    motion = Path(arguments.trajectory)
    output = output_files(path, [f"{path.stem}.truth.json"], shared.input_files(arguments))
    choices = {
        "wrench_noise": arguments.wrench_noise,
        "torque_noise": arguments.torque_noise,
        "model_error": 0.05 if arguments.model_error is None else arguments.model_error,
        "seed": arguments.seed or 0,
    }
    if motion.suffix == ".json":
        result = simulate_standing(
            arguments.robot,
            motion,
            contacts=arguments.contact,
            rate=arguments.rate or DEFAULT_RATE,
            **choices,
        )
    elif arguments.rate is not None:
        raise UnusableInput("--rate: the recording has the times of the CSV file; leave it out")
    else:
        result = simulate_floating(
            arguments.robot, motion, contacts=arguments.contact or (WORLD,), **choices
        )
    written = output.replace(result.contents(path.name))
    document = {
        "files": [str(file) for file in written],
        "rows": len(result.table),
        "columns": list(result.columns),
        "standing": result.truth.get("standing"),
    }
    return 0, document, "\n".join([*_lines(result), *written_lines(written)])


def _lines(result: SimulatedFloatingRecording) -> list[str]:
    """Return how well a robot on its feet follows the plan."""
    standing = result.truth.get("standing")
    if standing is None:
        return []
    joint, error = max(standing["tracking_error"].items(), key=lambda item: item[1])
    return [
        f"follows the plan within {1e3 * error:.2g} mrad or mm ({joint}); the soles slip by up to "
        f"{1e3 * standing['slip']:.2g} mm"
    ]
