"""`excite diagnose`: find effects that the base model lacks."""

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
    """Run `excite diagnose`."""
    output = output_folder(Path(arguments.out), DIAGNOSIS_FILES)
    robot = shared.robot(arguments)
    result = api.diagnose(
        robot,
        arguments.recordings,
        arguments.validate,
        limits=shared.limits(arguments, robot),
        prior=arguments.prior,
        band=arguments.band,
        with_report=not arguments.no_report,
    )
    written = output.replace(result.contents())
    document = result.document()
    return 0, with_files(document, written), _text(document, written)


def _change_text(change: dict[str, Any]) -> str:
    share = change.get("relative")
    return f"{change['value']:+.3g} ± {change['std']:.2g} {change['unit']}" + (
        "" if share is None else f" ({100 * share:+.0f} %)"
    )


def _gear_text(joint: str, gear: dict[str, Any]) -> str:
    estimates = {
        "stiffness": gear["stiffness"],
        "lost motion": gear["lost_motion"],
        "difference of the readings": gear["read_apart"],
    }
    words = [
        f"{name} {v['value']:.3g} ± {v['std']:.2g} {v['unit']}"
        for name, v in estimates.items()
        if v is not None
    ]
    return f"two encoders at {joint}: {', '.join(words)}"


def _text(document: dict[str, Any], written: list[Path]) -> str:
    lines = [f"verdict: {document['verdict']}"]
    for finding in document["findings"]:
        place = finding["joint"] or "the whole robot"
        values = ", ".join(
            f"{key} {v['value']:.4g} ± {v['std']:.2g} {v['unit']}"
            for key, v in finding["parameters"].items()
        )
        alternatives = finding["equivalents"]
        alternatives_text = f" (or {', '.join(alternatives)})" if alternatives else ""
        missing = finding.get("not_shown", [])
        missing_text = f"; not shown: {', '.join(missing)}" if missing else ""
        lines.append(
            f"{finding['effect']}{alternatives_text} at {place}, "
            f"probability {finding['probability']:.2f}: {values}{missing_text}"
        )
    physics = [u for u in document["unknown"] if u["where"]["regime"] != "recording"]
    lines += [
        f"unknown at {entry['joint']}: {100 * entry['share']:.0f} % of the residual is repeatable"
        for entry in physics
    ]
    for change in document["between_recordings"]:
        values = ", ".join(f"{kind} {_change_text(change[kind])}" for kind in KINDS)
        lines.append(
            f"different friction or offset at {change['joint']} in "
            f"{Path(change['recording']).name}: {values}"
        )
    lines += [_gear_text(joint, gear) for joint, gear in document["encoders"].items()]
    lines.append(f"{'joint':25}{'before':>11}{'after':>11}{'noise':>11}")
    lines += [
        f"{j:25}{v['rmse_before']:11.4g}{v['rmse_after']:11.4g}{v['noise_floor']:11.4g}"
        for j, v in document["joints"].items()
    ]
    return "\n".join([*lines, *written_lines(written)])
