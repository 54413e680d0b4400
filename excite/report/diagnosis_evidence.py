"""Evidence of a diagnosis: held-out prediction, session changes, encoders, unmodelled torque."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ..diagnosis.diagnosis import Diagnosis
from ..robot.parameter_names import listed, percent, some
from .content import Section, Table, TableCell
from .figures import diagnosis as diagnosis_figures
from .figures import gear_encoders as encoder_figure
from .figures import session_changes as session_figure
from .figures import torque_fit
from .figures import unmodelled as unmodelled_figure
from .figures.session_changes import KIND_WORDS
from .figures.torque_fit import EXCERPT_SECONDS, FitLabels
from .formatting import number, plural, significant, value_with_error
from .torque_budget import NOISE_RATIO, JointBudget

UNFOLDED_RECORDINGS = 2
"""Recordings whose prediction is shown without a click."""
LISTED_PARAMETERS = 12
"""Base parameters that are listed with their change."""
NOTABLE_SHIFT = 2.0
"""Change of a base parameter that is listed [standard deviations]."""
DRAWN_UNKNOWN = 6
"""Unmodelled residuals that are drawn."""


# -- prediction ------------------------------------------------------------------------------------


def prediction_section(
    diagnosis: Diagnosis, document: Mapping[str, Any], budgets: Sequence[JointBudget]
) -> Section:
    """Build the section on held-out prediction by the base model and by the saved model."""
    robot = diagnosis.identified.model.robot
    predictions = list(
        diagnosis_figures.held_out_predictions(diagnosis, withheld="doubts" in document)
    )
    points = torque_fit.points_per_curve(predictions, robot.n)
    labels = FitLabels(
        "base model", "saved model", residuals=True, errors=[_floors(b) for b in budgets]
    )
    recordings = [
        {
            "source": Path(prediction.source).name,
            "figure": Markup(torque_fit.draw_torque_fit(prediction, robot, points, labels)),
        }
        for prediction in predictions
    ]
    shifted = [row for row in document["parameters"] if row["moved"] > NOTABLE_SHIFT]
    data = {
        "errors": _error_table(diagnosis, budgets),
        "parameters": _shifted_parameters(shifted) if shifted else None,
        "parameters_count": f" ({LISTED_PARAMETERS} of {len(shifted)})"
        if len(shifted) > LISTED_PARAMETERS
        else "",
        "recordings": recordings[:UNFOLDED_RECORDINGS],
        "others": recordings[UNFOLDED_RECORDINGS:],
        "others_summary": plural(len(recordings) - UNFOLDED_RECORDINGS, "more recording"),
        "band": number(document["band_hz"], 3),
        "has_standstill": not bool(diagnosis.held_out.moving.all()),
        "is_excerpt": any(p.time[-1] - p.time[0] > EXCERPT_SECONDS for p in predictions),
        "excerpt": f"{EXCERPT_SECONDS:g}",
    }
    answer, tone = _prediction_answer(budgets)
    question = "Does the saved model predict recordings that it has not seen?"
    return Section("better", question, answer, data, tone)


def _floors(budget: JointBudget) -> str:
    """Error of the saved model in noise floors."""
    return f"error {significant(budget.noise_ratio)} × noise"


def _prediction_answer(budgets: Sequence[JointBudget]) -> tuple[str, str]:
    """How near the held-out error is to noise, and its tone."""
    above = [b for b in budgets if b.noise_ratio > NOISE_RATIO]
    worse = [b.joint for b in budgets if b.is_worse]
    if not above:
        answer, tone = "Yes, down to the noise at every joint", "good"
    else:
        worst = max(above, key=lambda b: b.noise_ratio)
        answer = (
            f"Not down to the noise at {some([b.joint for b in above])}; the largest error is "
            f"{significant(worst.noise_ratio)} noise floors, at {worst.joint}"
        )
        tone = "warn"
    if worse:
        return f"{answer}. It predicts {some(worse)} worse than the base model.", "bad"
    return f"{answer}. No joint is predicted worse than by the base model.", tone


def _error_table(diagnosis: Diagnosis, budgets: Sequence[JointBudget]) -> Table:
    """Held-out errors of each joint with the base model and with the saved model."""
    held_out = diagnosis.held_out
    moving = held_out.moving.mean(axis=0)
    size = np.sqrt(np.mean(held_out.torque**2, axis=0, where=held_out.moving))
    rows = []
    for k, budget in enumerate(budgets):
        torque = max(float(size[k]), 1e-300)
        tone = "bad" if budget.is_worse else "good" if budget.is_improved else ""
        rows.append(
            (
                budget.joint,
                budget.unit,
                significant(budget.before, 3),
                TableCell(significant(budget.after, 3), tone=tone, bold=bool(tone)),
                significant(budget.floor, 3),
                significant(budget.noise_ratio),
                percent(budget.before / torque),
                percent(budget.after / torque),
                percent(float(moving[k])),
            )
        )
    head = (
        "joint",
        "unit",
        "error before",
        "error after",
        "noise floor",
        "after / noise",
        "before / torque",
        "after / torque",
        "in motion",
    )
    return Table(head, rows, (2, 3, 4, 5, 6, 7, 8))


def _shifted_parameters(shifted: Sequence[Mapping[str, Any]]) -> Table:
    """Base parameters that change most when the effects are modelled."""
    rows = [
        (row["name"], *(number(row[key], 3) for key in ("without", "with", "std", "moved")))
        for row in shifted[:LISTED_PARAMETERS]
    ]
    head = ("base parameter", "without effects", "with effects", "std", "change [std]")
    return Table(head, rows, (1, 2, 3, 4))


# -- sessions --------------------------------------------------------------------------------------


def session_changes_section(document: Mapping[str, Any]) -> Iterator[Section]:
    """Build the section on friction and offsets that differ between recordings, if any do."""
    changes = document["between_recordings"]
    if not changes:
        return
    joints = list(dict.fromkeys(change["joint"] for change in changes))
    recordings = list(dict.fromkeys(Path(change["recording"]).name for change in changes))
    rows = [
        (
            change["joint"],
            Path(change["recording"]).name,
            *(_change(change[kind]) for kind in KIND_WORDS),
        )
        for change in changes
    ]
    yield Section(
        "changes",
        "Is the robot the same in all recordings?",
        f"No: friction or torque offset of {some(joints)} differs in {some(recordings)}.",
        {
            "table": Table(("joint", "recording", *KIND_WORDS.values()), rows),
            "figure": Markup(session_figure.draw_session_changes(changes)),
        },
        "warn",
    )


def _change(value: Mapping[str, Any]) -> str:
    """A change with its standard error, and relative to the value where that is known."""
    text = value_with_error(value["value"], value["std"], value["unit"])
    share = value.get("relative")
    if share is not None:
        text += f" ({'+' if share > 0.0 else '−'}{percent(abs(share))})"
    return text.replace(" ", "\u00a0")


# -- encoders --------------------------------------------------------------------------------------


def encoders_section(diagnosis: Diagnosis, document: Mapping[str, Any]) -> Iterator[Section]:
    """Build the section on gears with an encoder on either side, if there are any."""
    gears = document["encoders"]
    if not gears:
        return
    stiff = [
        f"{joint} {number(gear['stiffness']['value'], 3)} {gear['stiffness']['unit']}"
        for joint, gear in gears.items()
        if gear["stiffness"]
    ]
    explained = 1.0 - float(np.median([gear["after"] / gear["before"] for gear in gears.values()]))
    answer = (
        f"The gears deflect under torque, with stiffness {listed(stiff)}."
        if stiff
        else "No gear deflects measurably."
    )
    answer += (
        f" Deflection, backlash, friction and the time between the readings explain "
        f"{percent(explained)} of the difference, on held-out data."
    )
    rows = [
        (
            joint,
            *(
                value_with_error(*(gear[key][k] for k in ("value", "std", "unit")))
                if gear[key]
                else "–"
                for key in ("stiffness", "lost_motion", "read_apart")
            ),
            number(gear["before"], 3),
            number(gear["after"], 3),
            gear["unit"],
        )
        for joint, gear in gears.items()
    ]
    head = (
        *("joint", "stiffness", "lost motion", "reading delay"),
        *("RMS difference", "unexplained", "unit"),
    )
    yield Section(
        "gears",
        "What do the two encoders say?",
        answer,
        {
            "table": Table(head, rows, (4, 5)),
            "figure": Markup(encoder_figure.draw_deflections(diagnosis)),
        },
    )


# -- unmodelled torque -----------------------------------------------------------------------------


def unknown_section(document: Mapping[str, Any], units: Mapping[str, str]) -> Iterator[Section]:
    """Build the section on torque that no effect explains, if there is any."""
    unknown = document["unknown"]
    if not unknown:
        return
    lines = [
        f"{entry['joint']}: {percent(entry['share'])} of the remaining squared error follows from "
        f"{entry['where']['regime']}, predicted in recordings that this was not fitted to "
        f"(probability {number(entry['probability'], 2)})."
        for entry in unknown
    ]
    figure = unmodelled_figure.draw_responses(unknown[:DRAWN_UNKNOWN], units)
    joints = some([entry["joint"] for entry in unknown])
    yield Section(
        "unknown",
        "What remains unknown?",
        f"Torque at {joints} that repeats with the motion and that no effect of the catalogue "
        "explains.",
        {
            "lines": lines,
            "figure": Markup(figure),
            "omitted": f"The first {DRAWN_UNKNOWN} of {len(unknown)}. "
            if len(unknown) > DRAWN_UNKNOWN
            else "",
        },
        "warn",
    )
