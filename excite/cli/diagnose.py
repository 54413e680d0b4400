"""`excite diagnose`: what the model of a robot leaves out."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .. import api
from .._system.output_files import output_folder
from ..api.diagnosis_result import DIAGNOSIS_FILES
from ..diagnosis.session_changes import KINDS
from . import options as shared
from .outcome import Outcome, with_files, written_lines


def run(arguments: argparse.Namespace) -> Outcome:
    """Read recordings, diagnose, report."""
    output = output_folder(Path(arguments.out), DIAGNOSIS_FILES)
    robot = shared.robot(arguments)
    result = api.diagnose(
        robot,
        arguments.recordings,
        arguments.validate,
        limits=shared.limits(arguments, robot),
        prior=arguments.prior,
        band=arguments.band,
        trajectory=arguments.trajectory,
        columns=shared.columns(arguments),
        with_report=not arguments.no_report,
        progress=arguments.console.progress,
    )
    written = output.replace(result.contents())
    document = result.document()
    return 0, with_files(document, written), _text(document, written)


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


def _text(stated: dict[str, Any], written: list[Path]) -> str:
    lines = [f"verdict: {stated['verdict']}"]
    doubts = stated.get("doubts", [])
    if doubts:
        lines.append(
            "the recordings are doubted; until that is resolved, no effect at a single joint is "
            "reported:"
        )
        lines += [f"  {Path(doubt['recording']).name}: {doubt['text']}" for doubt in doubts]
    for one in stated["findings"]:
        place = one["joint"] or "the whole robot"
        values = ", ".join(
            f"{key} {v['value']:.4g} ± {v['std']:.2g} {v['unit']}"
            for key, v in one["parameters"].items()
        )
        alike = f" (or {', '.join(one['equivalents'])})" if one["equivalents"] else ""
        lacking = f"; not shown: {', '.join(one['not_shown'])}" if "not_shown" in one else ""
        lines.append(
            f"{one['effect']}{alike} at {place}, probability {one['probability']:.2f}: "
            f"{values}{lacking}"
        )
    physics = [one for one in stated["unknown"] if one["where"]["regime"] != "recording"]
    lines += [
        f"unknown at {one['joint']}: {100 * one['share']:.0f} % of what is left repeats"
        for one in physics
    ]
    for one in stated["between_recordings"]:
        values = ", ".join(f"{kind} {_changed(one[kind])}" for kind in KINDS)
        lines.append(
            f"another friction or offset at {one['joint']} in {Path(one['recording']).name}: "
            f"{values}"
        )
    lines += [_gear(joint, gear) for joint, gear in stated["encoders"].items()]
    lines.append(f"{'joint':25}{'before':>11}{'after':>11}{'noise':>11}")
    lines += [
        f"{j:25}{v['rmse_before']:11.4g}{v['rmse_after']:11.4g}{v['noise_floor']:11.4g}"
        for j, v in stated["joints"].items()
    ]
    return "\n".join([*lines, *written_lines(written)])
