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
from ..report import verdict
from ..report.decisions import HEAD, decision_rows, decisions_answer
from ..report.formatting import capitalized, significant, uncapitalized
from ..report.torque_budget import (
    certainty_words,
    change_words,
    filter_words,
    finding_parameter_words,
    joint_budgets,
    known_words,
    origin_words,
    parameter_words,
    prior_words,
    probability_words,
    regime_words,
    sorted_findings,
    undecided_words,
)
from ..robot.robot import Robot
from ..schemas.effects import effect_words
from . import options as shared
from .outcome import Outcome, with_files, written_lines


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite diagnose`."""
    output = output_folder(Path(arguments.out), DIAGNOSIS_FILES, shared.input_files(arguments))
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
        discriminating=arguments.discriminating,
        before=arguments.before,
        with_report=not arguments.no_report,
    )
    written = output.replace(result.contents())
    document = result.document()
    robot_of_model = result.diagnosis.identified.model.robot
    return 0, with_files(document, written), diagnosis_text(document, robot_of_model, written)


def diagnosis_text(document: dict[str, Any], robot: Robot, written: list[Path]) -> str:
    """Return a diagnosis in lines of text.

    Args:
        document: Content of `diagnosis.json`.
        robot: The robot.
        written: Files that were written.
    """
    lines, budgets = [f"verdict: {document['verdict']}"], joint_budgets(document, robot)
    doubts = document.get("doubts", [])
    if doubts:
        lines += ["", "the recordings are in doubt, so findings at single joints are withheld:"]
        lines += [f"  {Path(doubt['recording']).name}: {doubt['text']}" for doubt in doubts]
    else:
        lines += [
            "",
            f"{capitalized(verdict.verdict_words(document, budgets))}.",
            f"Use: {verdict.use_words(budgets)}.",
            f"Next: {verdict.next_words(document, budgets)}.",
        ]
    if "decisions" in document:
        lines += ["", f"further recordings: {decisions_answer(document)[0]}"]
        rows = decision_rows(document)
        lines += _aligned([HEAD, *rows]) if rows else []
    lines += [
        "",
        f"torque error below {document['band_hz']:.3g} Hz on the held-out recordings (root mean "
        "square, joints in motion), and its causes:",
    ]
    lines += _aligned([(b.joint, b.error, b.causes) for b in budgets])
    if doubts and (refuted := prior_words(budgets)):
        lines += ["", f"{capitalized(refuted)}."]
    for words in filter_words(document), known_words(document):
        lines += ["", words] if words else []
    if document["findings"]:
        lines += [
            "",
            "findings: probability, size over the residual torque, parameters with standard errors",
        ]
        lines += _aligned([_finding(finding) for finding in sorted_findings(document)])
    if document["unknown"]:
        lines += ["", "torque that repeats with the motion and that no effect explains:"]
        lines += _aligned(
            [
                (
                    u["joint"],
                    f"{100 * u['share']:.0f} % of the remaining squared error, by "
                    f"{regime_words(u)}",
                    certainty_words(u),
                )
                for u in document["unknown"]
            ]
        )
    if document["between_recordings"]:
        lines += [
            "",
            "friction and offsets that differ between the recordings, if the model lacks nothing "
            "else:",
        ]
        lines += _aligned(
            [
                (
                    c["joint"],
                    Path(c["recording"]).name,
                    ", ".join(f"{kind} {change_words(c[kind])}" for kind in KINDS),
                )
                for c in document["between_recordings"]
            ]
        )
    if undecided := document["undecided_between_recordings"]:
        words = undecided_words(undecided, len(document["joints"]))
        lines += ["", f"friction and offsets in all recordings: {uncapitalized(words)}"]
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
    return (
        finding["joint"] or "whole robot",
        " or ".join(effect_words(e) for e in (finding["effect"], *finding["equivalents"]))
        + origin_words(finding),
        probability_words(finding["probability"]),
        f"{significant(finding['evidence']['severity'])} × residual",
        finding_parameter_words(finding),
    )


def _gear(gear: Mapping[str, Any]) -> str:
    """Gear parameters with standard errors."""
    names = ("stiffness", "lost_motion", "read_apart")
    return parameter_words({name: gear[name] for name in names if gear[name] is not None})
