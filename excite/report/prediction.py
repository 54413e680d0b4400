"""Does the model predict another recording? The section that a model is judged by."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..identification.identification import Identification, Prediction
from ..robot.parameter_names import multiple, percent, some
from ..robot.robot import Robot
from .figures import torque_fit
from .figures.torque_fit import EXCERPT, SURE
from .figures.trajectory import torque_units
from .page import Section, banner, escape, figure, folded, number, paragraph, plural, table

Array = np.ndarray
WITHIN = 1.2
"""Noise floors up to which an error counts as noise (CONTRACT, verdict)."""
WELL, ROUGHLY = 0.1, 0.3
"""Error over RMS torque up to which a joint counts as predicted well, or roughly, where no noise floor is known."""
_UNFOLDED = 2
_QUESTION = "Does the model predict another recording?"


def section(found: Identification) -> Section:
    """Measured against predicted torque: of the recordings held out, or with a warning of those it was fitted to."""
    robot, held_out = found.model.robot, bool(found.validations)
    shown = found.validations or found.fits
    points = torque_fit.drawn_points(shown, robot.n)
    body = (
        ""
        if held_out
        else banner(
            "These are the recordings the model was fitted to: a small error here says little.",
            "warn",
        )
    )
    fitted = {one.source for one in found.fits}
    cheated = any(one.source in fitted for one in found.validations)
    if cheated:
        body += banner(
            "A recording that the model was fitted to is among those held out: its error says little.",
            "warn",
        )
    parts = [
        f"<h3>{escape(one.source)}</h3>{_table(one, robot)}{figure(torque_fit.traces(one, robot, points))}"
        for one in shown
    ]
    body += "".join(parts[:_UNFOLDED])
    if len(parts) > _UNFOLDED:
        body += folded(plural(len(parts) - _UNFOLDED, "more recording"), "".join(parts[_UNFOLDED:]))
    body += paragraph(_note(shown, found), "note")
    if held_out:
        tables = "".join(f"<h3>{escape(one.source)}</h3>{_table(one, robot)}" for one in found.fits)
        body += folded("The same table for the recordings it was fitted to", tables)
        text, tone = verdict(shown, robot)
        return Section(
            "prediction", _QUESTION, text, body, "warn" if cheated and tone == "good" else tone
        )
    answer = (
        "Not known, for no recording was held out: give one of another motion with --validate. "
    )
    answer += f"The error of the fit {_span(shown, robot)}."
    return Section("prediction", _QUESTION, answer, body, "warn")


def verdict(predictions: Sequence[Prediction], robot: Robot) -> tuple[str, str]:
    """The answer in a sentence, and its tone."""
    where = "on " + (
        Path(predictions[0].source).name
        if len(predictions) == 1
        else f"{len(predictions)} held-out recordings"
    )
    relative = np.max([one.relative() for one in predictions], axis=0)
    ratios = [ratio for one in predictions if (ratio := one.error_over_noise_floor()) is not None]
    span = _span(predictions, robot)
    if len(ratios) == len(predictions):
        ratio = np.max(ratios, axis=0)
        worst = int(np.argmax(ratio))
        beyond = [j for j, r in zip(robot.joints, ratio, strict=True) if r > WITHIN]
        if not beyond:
            text = f"Yes, down to the noise: {where} the worst joint, {robot.joints[worst]}, errs by {multiple(ratio[worst])} noise floors."
            return text, "good"
        text = f"Not down to the noise: {where} the error {span}; in {some(beyond)} it is more than {WITHIN:g} noise floors, "
        return text + f"up to {multiple(ratio[worst])} in {robot.joints[worst]}.", "warn"
    useless = [j for j, r in zip(robot.joints, relative, strict=True) if r >= 1.0]
    poor = [j for j, r in zip(robot.joints, relative, strict=True) if ROUGHLY < r < 1.0]
    if useless:
        return (
            f"Not for {some(useless)}, where predicting no torque at all would err less; {where} the error {span}.",
            "bad",
        )
    if poor:
        return f"Not well for {some(poor)}: {where} the error {span}.", "warn"
    return (
        (f"Yes: {where} the error {span}.", "good")
        if relative.max() <= WELL
        else (f"Roughly: {where} the error {span}.", "")
    )


def _span(predictions: Sequence[Prediction], robot: Robot) -> str:
    """'is 4.1 % (joint_1) to 9 % (joint_5) of a joint's RMS torque (nominal robot: 65 % to 100 %)'."""
    relative = np.max([one.relative() for one in predictions], axis=0)
    before = np.max([one.relative("nominal") for one in predictions], axis=0)
    best, worst = int(np.argmin(relative)), int(np.argmax(relative))
    if robot.n == 1:
        return f"is {percent(relative[0])} of the RMS torque (nominal robot: {percent(before[0])})"
    text = f"is {percent(relative[best])} ({robot.joints[best]}) to {percent(relative[worst])} ({robot.joints[worst]})"
    return f"{text} of a joint's RMS torque (nominal robot: {percent(before.min())} to {percent(before.max())})"


def _table(one: Prediction, robot: Robot) -> str:
    before, after = one.error("nominal"), one.error()
    relative, relative_before, ratios = (
        one.relative(),
        one.relative("nominal"),
        one.error_over_noise_floor(),
    )
    rows = []
    for k, (joint, unit) in enumerate(zip(robot.joints, torque_units(robot), strict=True)):
        floor = None if one.noise_floor is None else float(one.noise_floor[k])
        ratio = None if ratios is None else float(ratios[k])
        tone = (
            "bad"
            if after[k] > before[k] or relative[k] >= 1.0
            else "good"
            if ratio is not None and ratio <= WITHIN
            else ""
        )
        rows.append(
            (
                escape(joint),
                unit,
                _torque(before[k]),
                f'<b class="{tone}">{_torque(after[k])}</b>',
                _torque(floor),
                "–" if ratio is None else multiple(ratio),
                escape(percent(relative_before[k])),
                f'<b class="{tone}">{escape(percent(relative[k]))}</b>',
            )
        )
    head = (
        "joint",
        "unit",
        "RMSE before",
        "RMSE after",
        "noise floor",
        "after / floor",
        "relative before",
        "relative after",
    )
    return table(head, rows, (2, 3, 4, 5, 6, 7))


def _torque(value: float | None) -> str:
    """Three digits, four where three would take a power of ten."""
    return number(value, 4 if value is not None and value >= 1000.0 else 3)


def _note(predictions: Sequence[Prediction], found: Identification) -> str:
    text = f"Torque below {number(found.spectra.hertz, 3)} Hz, the same filter on both sides. "
    text += "Relative: over the RMS of the measured torque. Before: the nominal robot, as the URDF has it. "
    if any(one.noise_floor is not None for one in predictions):
        text += f"Noise floor: standard deviation between repeated periods; {SURE:g} of them hold 95 % of the noise. "
    if any(one.noise_floor is None for one in predictions):
        text += "Where no period repeats, no noise floor is known: an error may be noise or physics that the model lacks. "
    if any(one.time[-1] - one.time[0] > EXCERPT for one in predictions):
        text += f"Of recordings longer than {EXCERPT:g} s the stretch around the largest error is drawn; the table is of all of it."
    return text.strip()
