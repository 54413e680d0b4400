"""`excite export`: write a trajectory for a controller, or an identified robot for a simulator."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

from .. import api
from .._system.output_files import output_files
from ..api.model_export import is_model
from ..exporters import MODEL_FORMATS
from ..exporters.goal_options import GoalOptions
from . import options as shared
from .outcome import Outcome

OF_TRAJECTORIES = {
    "--rate": "rate",
    "--speed": "speed",
    "--lead": "lead",
    "--path-tolerance": "path_tolerance",
    "--goal-tolerance": "goal_tolerance",
    "--robot": "robot",
    "--packages": "packages",
    "--force": "force",
}
"""Options that concern trajectories only, with the names of their attributes."""
OF_MODELS = {"--into": "into", "--recording": "recording", "--columns": "columns"}
"""Options that concern identified robots only."""


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite export`: the kind of the document decides, or the format if it cannot be read."""
    if is_model(arguments.source) or arguments.format in MODEL_FORMATS:
        _require_kind(arguments, OF_TRAJECTORIES, "a trajectory.json")
        return _export_model(arguments)
    _require_kind(arguments, OF_MODELS, "a model.json")
    result = api.export(
        arguments.source,
        arguments.format,
        arguments.out,
        speed=arguments.speed,
        rate=arguments.rate,
        force=arguments.force,
        robot=arguments.robot,
        limits=arguments.limits,
        packages=arguments.packages,
        goal=GoalOptions(arguments.lead, arguments.path_tolerance, arguments.goal_tolerance),
    )
    lines = [*result.verdict, f"wrote {result.path}", *result.next_steps]
    return 0, result.document(), "\n".join(lines)


def _require_kind(arguments: argparse.Namespace, options: Mapping[str, str], document: str) -> None:
    """Raise UnusableInput for an option that concerns the other kind of document."""
    reason = f"goes with {document}, which {arguments.source} is not; leave it out"
    shared.refuse_given(arguments, options, reason)


def _export_model(arguments: argparse.Namespace) -> Outcome:
    """Export an identified robot."""
    path = Path(arguments.out)
    inputs = [Path(arguments.source), *shared.input_files(arguments)]
    output = output_files(path, inputs=inputs)
    result = api.export_model(
        arguments.source,
        arguments.format,
        into=arguments.into,
        recording=arguments.recording,
        limits=arguments.limits,
        columns=shared.columns(arguments),
    )
    written = output.replace({path.name: result.text})[0]
    along = f", along {result.model.rms_source}" if result.model.rms_source else ""
    lines = [f"not in the file{along}:"] if result.remainders else []
    lines += [f"  {part.text}" for part in result.remainders]
    return 0, {"file": str(written), **result.document()}, "\n".join([*lines, f"wrote {written}"])
