"""Evidence of a diagnosis: held-out prediction, session changes, encoders, unmodelled torque."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from ..diagnosis.diagnosis import Diagnosis
from ..robot.parameter_names import listed, percent
from .content import Section, Table, TableCell
from .figures import gear_encoders as encoder_figure
from .figures import session_changes as session_figure
from .figures import torque_fit
from .figures import unmodelled as unmodelled_figure
from .figures.diagnosis import held_out_predictions
from .figures.session_changes import KIND_WORDS
from .figures.torque_fit import EXCERPT_SECONDS, FitLabels
from .formatting import capitalized, number, significant, value_with_error
from .torque_budget import (
    Document,
    JointBudget,
    base_words,
    certainty_words,
    change_words,
    filter_words,
    joint_words,
    places_where,
    regime_words,
    small_words,
    undecided_words,
)

DRAWN_UNKNOWN = 6
"""Unmodelled residuals that are drawn."""


def prediction_section(
    diagnosis: Diagnosis, document: Document, budgets: Sequence[JointBudget]
) -> Section:
    """Build the section on held-out prediction by the base model and by the saved model."""
    robot = diagnosis.identified.model.robot
    predictions = list(held_out_predictions(diagnosis, withheld="doubts" in document))
    points = torque_fit.points_per_curve(predictions, robot.n)
    errors = [f"error {significant(b.noise_ratio)} × noise" for b in budgets]
    labels = FitLabels("base model", "saved model", residuals=True, errors=errors)
    figures = [
        (Path(p.source).name, Markup(torque_fit.draw_torque_fit(p, robot, points, labels)))
        for p in predictions
    ]
    data = {
        "errors": _error_table(diagnosis, budgets),
        "recordings": figures,
        "band": number(document["band_hz"], 3),
        "filter": filter_words(document),
        "base": base_words(diagnosis),
        "excerpt": f"{EXCERPT_SECONDS:g}",
    }
    answer, tone = _prediction_answer(budgets)
    question = "Does the saved model predict unseen recordings?"
    return Section("better", question, answer, data, tone)


def _prediction_answer(budgets: Sequence[JointBudget]) -> tuple[str, str]:
    """How near the held-out error is to noise, and its tone."""
    furthest = max(budgets, key=lambda b: b.noise_ratio)
    answer, tone = "Yes, down to the noise" + (" at every joint" if budgets[1:] else ""), "good"
    if above := places_where(budgets, lambda b: not b.is_explained):
        answer, tone = f"Its error is above the noise at {above}", "warn"
        ratio = f"{significant(furthest.noise_ratio)} × noise"
        answer += (
            f"; furthest from it is {furthest.joint}: {ratio}" if budgets[1:] else f": {ratio}"
        )
    if furthest.is_withheld:
        return f"{answer}. While findings are withheld, the base model is saved.", "warn"
    if worse := places_where(budgets, lambda b: b.is_worse):
        return f"{answer}. It predicts {worse} worse than the base model.", "bad"
    if not any(b.is_improved for b in budgets):
        return f"{answer}. The saved model predicts as the base model does.", tone
    return f"{answer}." + (
        " No joint is worse than by the base model." if budgets[1:] else ""
    ), tone


def _error_table(diagnosis: Diagnosis, budgets: Sequence[JointBudget]) -> Table:
    """Held-out errors of each joint with the base model and with the saved model."""
    held_out = diagnosis.held_out
    rows: list[Sequence[str | TableCell]] = []
    for budget, moving in zip(budgets, held_out.moving.mean(axis=0), strict=True):
        tone = "bad" if budget.is_worse else "good" if budget.is_improved else ""
        rows.append(
            (
                budget.joint,
                budget.unit,
                significant(budget.before, 3),
                TableCell(significant(budget.after, 3), tone=tone, bold=bool(tone)),
                significant(budget.floor, 3),
                significant(budget.noise_ratio),
                *(
                    percent(value / max(budget.torque, 1e-300))
                    for value in (budget.before, budget.after)
                ),
                percent(moving),
            )
        )
    head = "joint, unit, error before, error after, noise floor, after / noise, before / torque"
    head += ", after / torque, in motion"
    return Table(head.split(", "), rows, range(2, 9))


def session_changes_section(document: Document) -> Iterator[Section]:
    """Build the section on friction and offsets that differ between recordings, or may do."""
    changes, undecided = document["between_recordings"], document["undecided_between_recordings"]
    if not changes and not undecided:
        return
    question = "Is the robot the same in all recordings?"
    unknown = undecided_words(undecided, len(document["joints"])) if undecided else ""
    if not changes:
        yield Section("changes", question, unknown, {"table": None}, "warn")
        return
    joints = list(dict.fromkeys(change["joint"] for change in changes))
    recordings = list(dict.fromkeys(Path(change["recording"]).name for change in changes))
    rows = [
        (
            change["joint"] + (f", {Path(change['recording']).name}" if recordings[1:] else ""),
            percent(change["error_share"]),
            *(change_words(change[kind]).replace(" ", "\u00a0") for kind in KIND_WORDS),
        )
        for change in changes
    ]
    data = {
        "table": Table(("joint", "share of error", *KIND_WORDS.values()), rows, (1,)),
        "figure": Markup(session_figure.draw_session_changes(changes)),
    }
    places = joint_words(joints, len(document["joints"]))
    answer = (
        "Perhaps not: a change of friction or torque offset would explain a part of the error of "
        f"{listed(recordings)} at {places}. {unknown}".rstrip()
    )
    yield Section("changes", question, answer, data, "warn")


def encoders_section(diagnosis: Diagnosis, document: Document) -> Iterator[Section]:
    """Build the section on gears with an encoder on either side, if there are any."""
    gears = document["encoders"]
    if not gears:
        return
    explained = 1.0 - float(np.median([gear["after"] / gear["before"] for gear in gears.values()]))
    answer = (
        "Deflection, backlash, friction and the time between the readings explain "
        f"{percent(explained)} of the difference between both encoders, on held-out data."
    )
    rows = [
        (
            joint,
            *(
                value_with_error(**gear[key]) if gear[key] else "–"
                for key in ("stiffness", "lost_motion", "read_apart")
            ),
            f"{number(gear['before'], 3)} {gear['unit']}",
            f"{number(gear['after'], 3)} {gear['unit']}",
        )
        for joint, gear in gears.items()
    ]
    head = ["joint", "stiffness", "lost motion", "reading delay", "RMS difference", "unexplained"]
    figure = Markup(encoder_figure.draw_deflections(diagnosis))
    data = {"table": Table(head, rows), "figure": figure}
    yield Section("gears", "What do the two encoders say?", answer, data)


def unknown_section(document: Document, units: Mapping[str, str]) -> Iterator[Section]:
    """Build the section on torque that no effect explains, if there is any."""
    unknown = document["unknown"]
    if not unknown:
        return
    lines = [
        f"{entry['joint']}: {percent(entry['share'])} of the remaining squared error "
        f"{_dependence(entry)} ({certainty_words(entry)})."
        + (f" {capitalized(small_words(entry['too_small']))}." if entry["too_small"] else "")
        for entry in unknown
    ]
    figure = Markup(unmodelled_figure.draw_responses(unknown[:DRAWN_UNKNOWN], units))
    joints = joint_words([entry["joint"] for entry in unknown], len(document["joints"]))
    answer = f"Torque at {joints} that repeats with the motion and that no known effect explains."
    drawn = unknown[:DRAWN_UNKNOWN]
    data = {
        "lines": lines,
        "figure": figure,
        "omitted": len(unknown) - len(drawn),
        "has_response": any(entry["where"]["response"]["relative"] for entry in drawn),
    }
    yield Section("unknown", "What remains unknown?", answer, data, "warn")


def _dependence(entry: Document) -> str:
    """Say what torque depends on that no effect explains."""
    where = entry["where"]
    if where["regime"] == "repetition":
        return "repeats from period to period"
    if where.get("frequency_hz") is not None:
        drive = where["regime"].removeprefix("past ")
        return f"is a resonance of {number(where['frequency_hz'], 2)} Hz that the {drive} drives"
    return (
        f"follows from {regime_words(entry)}, predicted in recordings that this was not fitted to"
    )
