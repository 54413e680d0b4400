"""`excite diagnose`: find effects that the base model lacks."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import api
from .._system.output_files import output_folder
from ..api.diagnosis_result import DIAGNOSIS_FILES
from ..diagnosis.session_changes import KINDS
from ..report.formatting import significant, value_with_error
from ..report.torque_budget import effect_words, joint_budgets, sorted_findings
from ..robot.robot import Robot
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
        trajectory=arguments.trajectory,
        columns=shared.columns(arguments),
        with_report=not arguments.no_report,
    )
    written = output.replace(result.contents())
    document = result.document()
    robot_of_model = result.diagnosis.identified.model.robot
    return 0, with_files(document, written), _text(document, robot_of_model, written)


def _text(document: dict[str, Any], robot: Robot, written: list[Path]) -> str:
    """The diagnosis in lines of text."""
    lines = [f"verdict: {document['verdict']}"]
    doubts = document.get("doubts", [])
    if doubts:
        lines += ["", "the recordings are in doubt, so findings at single joints are withheld:"]
        lines += [f"  {Path(doubt['recording']).name}: {doubt['text']}" for doubt in doubts]
    budgets = joint_budgets(document, robot)
    lines += ["", "torque error on the held-out recordings (root mean square), and its causes:"]
    lines += _aligned([(b.joint, b.error, b.contributions) for b in budgets])
    if document["findings"]:
        lines += ["", "findings, with probability, size and standard errors:"]
        lines += _aligned([_finding(finding) for finding in sorted_findings(document)])
    if document["unknown"]:
        lines += ["", "torque that repeats with the motion and that no effect explains:"]
        lines += _aligned(
            [
                (
                    u["joint"],
                    f"{100 * u['share']:.0f} % of the remaining squared error, by "
                    f"{u['where']['regime']}",
                    f"probability {u['probability']:.2f}",
                )
                for u in document["unknown"]
            ]
        )
    if document["between_recordings"]:
        lines += ["", "friction and offsets that differ between the recordings:"]
        lines += _aligned(
            [
                (
                    c["joint"],
                    Path(c["recording"]).name,
                    ", ".join(f"{kind} {_change(c[kind])}" for kind in KINDS),
                )
                for c in document["between_recordings"]
            ]
        )
    if document["encoders"]:
        lines += ["", "two encoders:"]
        lines += _aligned([(j, _gear(gear)) for j, gear in document["encoders"].items()])
    return "\n".join([*lines, "", *written_lines(written)])


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines with the columns of a table."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  " + "  ".join(map(str.ljust, row, widths)).rstrip()  # the last column is not padded
        for row in rows
    ]


def _finding(finding: Mapping[str, Any]) -> tuple[str, ...]:
    """Joint, effect with its alternatives, probability, size and parameters."""
    name = " or ".join(effect_words(e) for e in (finding["effect"], *finding["equivalents"]))
    values = ", ".join(
        f"{key.replace('_', ' ')} {value_with_error(v['value'], v['std'], v['unit'])}"
        for key, v in finding["parameters"].items()
    )
    return (
        finding["joint"] or "whole robot",
        name,
        f"{finding['probability']:.2f}",
        f"{significant(finding['evidence']['severity'])} × noise",
        values,
    )


def _change(change: Mapping[str, Any]) -> str:
    """A change between recordings with its standard error."""
    share = change.get("relative")
    return value_with_error(change["value"], change["std"], change["unit"]) + (
        "" if share is None else f" ({100 * share:+.0f} %)"
    )


def _gear(gear: Mapping[str, Any]) -> str:
    """Gear parameters with standard errors."""
    names = {
        "stiffness": "stiffness",
        "lost_motion": "lost motion",
        "read_apart": "difference of the readings",
    }
    return ", ".join(
        f"{name} {value_with_error(gear[key]['value'], gear[key]['std'], gear[key]['unit'])}"
        for key, name in names.items()
        if gear[key] is not None
    )
