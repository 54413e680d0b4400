"""`excite diagnose` from the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .. import recordings
from .._system.output_files import output_folder
from ..diagnosis import diagnosis, residual_atlas, whole
from ..diagnosis.diagnosis_file import document
from ..diagnosis.session_changes import KINDS
from ..identification import identified_model, torque_check
from ..identification import prior as prior_module
from ..recordings import recording_cost
from ..robot import base_parameters, inertial_parameters
from ..trajectory import trajectory_file
from . import options as told

Outcome = tuple[int, Any, str]


def diagnose(arguments: argparse.Namespace, say: Callable[[str], None]) -> Outcome:
    """Read, diagnose, report."""
    output = output_folder(Path(arguments.out), ("diagnosis.json", "model.json", "report.html"))
    robot = told.robot(arguments)
    table = told.limits(arguments, robot)
    standard = inertial_parameters.standard(robot, table, inertial_parameters.DRIVE)
    found = base_parameters.find(robot, standard, table)
    known = prior_module.trusted(Path(arguments.prior), robot, standard) if arguments.prior else {}
    both = (arguments.recordings, arguments.validate)
    train, held_out = (
        [recordings.read(Path(path), robot, table) for path in paths] for paths in both
    )
    recordings.refuse_same(train, held_out)
    recording_cost.require_diagnosable([*train, *held_out], say)
    train, held_out = (
        [torque_check.checked(one, robot, table) for one in some] for some in (train, held_out)
    )
    result = diagnosis.diagnose(
        robot, standard, found, train, held_out, diagnosis.Options(arguments.band, known), say
    )
    looked = None if arguments.no_report else residual_atlas.look(result)
    told_all = document(result, looked)
    contents = {
        "diagnosis.json": trajectory_file.dumps(told_all),
        "model.json": trajectory_file.dumps(_model(result, train)),
    }
    if looked is not None:
        from .. import report  # slow to import

        contents["report.html"] = report.diagnosis_page(
            result, told_all, looked, [r for one in (*train, *held_out) for r in one.remarks]
        )
    written = output.replace(contents)
    return (
        0,
        told_all | {"files": [str(path) for path in written]},
        _text(told_all, [str(path) for path in written]),
    )


def _model(result: diagnosis.Diagnosis, train: Sequence[recordings.Recording]) -> dict[str, Any]:
    """`model.json` with the findings, and what the parameters would be without them."""
    robot, plain = result.identified.model.robot, result.identified
    stated = identified_model.document(result.refitted or plain, train)
    names = plain.model.parameters.names
    stated["effects"] = [whole.entry(part, robot) for part in result.parts]
    stated["without_effects"] = dict(zip(names, plain.psi.tolist(), strict=True))
    return stated


def _changed(told: dict[str, Any]) -> str:
    share = told.get("relative")
    return f"{told['value']:+.3g} ± {told['std']:.2g} {told['unit']}" + (
        "" if share is None else f" ({100 * share:+.0f} %)"
    )


def _gear(joint: str, gear: dict[str, Any]) -> str:
    told = {
        "stiffness": gear["stiffness"],
        "lost motion": gear["lost_motion"],
        "read apart by": gear["read_apart"],
    }
    words = [
        f"{name} {v['value']:.3g} ± {v['std']:.2g} {v['unit']}"
        for name, v in told.items()
        if v is not None
    ]
    return f"two encoders at {joint}: {', '.join(words)}"


def _text(stated: dict[str, Any], written: list[str]) -> str:
    lines = [f"verdict: {stated['verdict']}"]
    for one in stated["findings"]:
        place = one["joint"] or "the whole robot"
        values = ", ".join(
            f"{key} {v['value']:.4g} ± {v['std']:.2g} {v['unit']}"
            for key, v in one["parameters"].items()
        )
        alike = f" (or {', '.join(one['equivalents'])})" if one["equivalents"] else ""
        lacking = f"; not shown: {', '.join(one['not_shown'])}" if "not_shown" in one else ""
        lines.append(
            f"{one['effect']}{alike} at {place}, probability {one['probability']:.2f}: {values}{lacking}"
        )
    physics = [one for one in stated["unknown"] if one["where"]["regime"] != "recording"]
    lines += [
        f"unknown at {one['joint']}: {100 * one['share']:.0f} % of what is left repeats"
        for one in physics
    ]
    for one in stated["between_recordings"]:
        values = ", ".join(f"{kind} {_changed(one[kind])}" for kind in KINDS)
        lines.append(
            f"another friction or offset at {one['joint']} in {Path(one['recording']).name}: {values}"
        )
    lines += [_gear(joint, gear) for joint, gear in stated["encoders"].items()]
    lines.append(f"{'joint':25}{'before':>11}{'after':>11}{'noise':>11}")
    lines += [
        f"{j:25}{v['rmse_before']:11.4g}{v['rmse_after']:11.4g}{v['noise_floor']:11.4g}"
        for j, v in stated["joints"].items()
    ]
    return "\n".join([*lines, *(f"wrote {path}" for path in written)])
