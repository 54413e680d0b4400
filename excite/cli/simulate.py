"""`excite simulate`: record a simulated robot with effects that its model lacks."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .. import api
from ..api.simulated_recording import checked_path, recording_files
from . import floating_simulate
from . import options as shared
from .outcome import Outcome, written_lines

SETTINGS = ("seed", "rate", "noise", "colour", "jitter", "encoder", "model_error")
"""Options that are fields of the settings of the simulator."""


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite simulate`: write the recording, its sidecar, its ground truth and a plot."""
    if arguments.floating:
        return floating_simulate.run(arguments)
    shared.require_floating(arguments, floating_simulate.FLOATING_ONLY)
    path = checked_path(arguments.out)
    output = recording_files(path, shared.input_files(arguments))
    result = api.simulate(
        arguments.robot,
        arguments.trajectory,
        arguments.effect,
        dense=arguments.dense,
        severity=arguments.severity,
        trusted=arguments.trusted,
        like=arguments.like,
        periods=arguments.periods,
        **{name: getattr(arguments, name) for name in SETTINGS},
    )
    written = output.replace(result.contents(path.name))
    keys = ("robot", "trajectory", "effects", "severity", "severity_trusted")
    document = {
        "files": [str(path) for path in written],
        "joints": list(result.joints),
        "rows": len(result.recording.t),
        **{key: result.truth[key] for key in keys},
    }
    return 0, document, _text(result, written)


def _text(result: api.SimulatedRecording, written: list[Path]) -> str:
    lines = [_effect_text(effect) for effect in result.effects]
    if result.effects:
        lines.append(
            f"severity {result.severity:.3g} after a refit of the base model "
            "(RMS torque over the noise, below 20 Hz), "
            f"{result.severity_trusted:.3g} without refit"
        )
    else:
        lines.append("nothing hidden; name what to hide: --effect NAME:JOINT[:k=v,…]")
    truth = next(path for path in written if path.name.endswith(".truth.json"))
    more = f"the same robot on another motion: --like {truth}"
    return "\n".join([*lines, *written_lines(written), more])


def _effect_text(effect: Any) -> str:
    """Return an effect with the values of its parameters in words."""
    place = "" if effect.joint is None else f" in {effect.joint}"
    values = [
        f"{q.name} {effect.values[q.name]:.4g}{'' if q.unit == '1' else ' ' + q.unit}"
        for q in effect.effect_type.parameters
    ]
    return f"{effect.name}{place}: {', '.join(values)}"
