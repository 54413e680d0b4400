"""Torque prediction of an identified model: the section that judges it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from ..identification.identification import Identification, Prediction
from ..robot.parameter_names import multiple, percent, plural, some
from ..robot.robot import Robot
from .content import Section, Table, TableCell
from .figures import torque_fit
from .figures.torque_fit import EXCERPT_SECONDS, NOISE_BAND_FLOORS
from .figures.trajectory import torque_units
from .formatting import number

NOISE_RATIO = 1.2
"""Noise floors up to which an error counts as noise, as in the verdict of a diagnosis."""
GOOD_RELATIVE_ERROR = 0.1
"""Error over RMS torque up to which a prediction is good where no noise floor is known."""
FAIR_RELATIVE_ERROR = 0.3
"""Error over RMS torque up to which a prediction is fair."""
UNFOLDED_RECORDINGS = 2
"""Recordings that are shown without a click."""


def prediction_section(identification: Identification) -> Section:
    """Build the section on measured and predicted torque.

    It shows the recordings held out, or with a warning those the model was fitted to.
    """
    robot = identification.model.robot
    is_held_out = bool(identification.validations)
    predictions = identification.validations or identification.fits
    points = torque_fit.points_per_curve(predictions, robot.n)
    recordings = [
        {
            "source": prediction.source,
            "table": _error_table(prediction, robot),
            "figure": Markup(torque_fit.draw_torque_fit(prediction, robot, points)),
        }
        for prediction in predictions
    ]
    data = {
        "is_held_out": is_held_out,
        "is_contaminated": _is_contaminated(identification),
        "recordings": recordings[:UNFOLDED_RECORDINGS],
        "others": recordings[UNFOLDED_RECORDINGS:],
        "others_summary": plural(len(recordings) - UNFOLDED_RECORDINGS, "more recording"),
        "fitted": [
            {"source": prediction.source, "table": _error_table(prediction, robot)}
            for prediction in identification.fits
        ],
        "band": number(identification.spectra.hertz, 3),
        "has_floor": any(p.noise_floor is not None for p in predictions),
        "lacks_floor": any(p.noise_floor is None for p in predictions),
        "has_standstill": not all(p.moving.all() for p in predictions),
        "is_excerpt": any(p.time[-1] - p.time[0] > EXCERPT_SECONDS for p in predictions),
        "excerpt": f"{EXCERPT_SECONDS:g}",
        "noise_band": f"{NOISE_BAND_FLOORS:g}",
    }
    question = "Does the model predict another recording?"
    answer, tone = prediction_verdict(identification)
    return Section("prediction", question, answer, data, tone)


def prediction_verdict(identification: Identification) -> tuple[str, str]:
    """Answer whether the model predicts another recording, with the tone of the answer."""
    robot = identification.model.robot
    if not identification.validations:
        answer = (
            "Not known, because no recording was held out: give one of another motion with "
            f"--validate. The error of the fit {_error_range(identification.fits, robot)}."
        )
        return answer, "warn"
    answer, tone = _verdict(identification.validations, robot)
    if worse := identification.worsened_joints():
        answer = f"{answer} The nominal robot predicts {some(worse)} better."
        tone = "bad" if tone == "bad" else "warn"
    if _is_contaminated(identification) and tone == "good":
        tone = "warn"
    return answer, tone


def _is_contaminated(identification: Identification) -> bool:
    """Tell whether a recording is both fitted and held out."""
    fitted = {prediction.source for prediction in identification.fits}
    return any(prediction.source in fitted for prediction in identification.validations)


def _verdict(predictions: Sequence[Prediction], robot: Robot) -> tuple[str, str]:
    """Verdict on held-out recordings, and its tone."""
    where = "on " + (
        Path(predictions[0].source).name
        if len(predictions) == 1
        else f"{len(predictions)} held-out recordings"
    )
    relative = np.max([p.relative() for p in predictions], axis=0)
    ratios = [ratio for p in predictions if (ratio := p.error_over_noise_floor()) is not None]
    errors = f"{where} the error {_error_range(predictions, robot)}"
    if len(ratios) == len(predictions):
        ratio = np.max(ratios, axis=0)
        worst = int(np.argmax(ratio))
        beyond = [j for j, r in zip(robot.joints, ratio, strict=True) if r > NOISE_RATIO]
        worst_ratio = multiple(ratio[worst])
        if not beyond:
            text = (
                f"Yes, down to the noise: {where} the error of the worst joint, "
                f"{robot.joints[worst]}, is {worst_ratio} noise floors."
            )
            return text, "good"
        text = (
            f"Not down to the noise: {errors}; in {some(beyond)} it is more than "
            f"{NOISE_RATIO:g} noise floors, up to {worst_ratio} in {robot.joints[worst]}."
        )
        return text, "warn"
    useless = [j for j, r in zip(robot.joints, relative, strict=True) if r >= 1.0]
    poor = [j for j, r in zip(robot.joints, relative, strict=True) if FAIR_RELATIVE_ERROR < r < 1.0]
    if useless:
        text = (
            f"Not for {some(useless)}, where a prediction of no torque at all would have a "
            f"smaller error; {errors}."
        )
        return text, "bad"
    if poor:
        return f"Not well for {some(poor)}: {errors}.", "warn"
    if relative.max() <= GOOD_RELATIVE_ERROR:
        return f"Yes: {errors}.", "good"
    return f"Roughly: {errors}.", ""


def _error_range(predictions: Sequence[Prediction], robot: Robot) -> str:
    """Range of the relative errors: 'is 4.1 % (joint_1) to 9 % (joint_5) of …'."""
    relative = np.max([p.relative() for p in predictions], axis=0)
    before = np.max([p.relative("nominal") for p in predictions], axis=0)
    best, worst = int(np.argmin(relative)), int(np.argmax(relative))
    if robot.n == 1:
        return f"is {percent(relative[0])} of the RMS torque (nominal robot: {percent(before[0])})"
    return (
        f"is {percent(relative[best])} ({robot.joints[best]}) to {percent(relative[worst])} "
        f"({robot.joints[worst]}) of a joint's RMS torque "
        f"(nominal robot: {percent(before.min())} to {percent(before.max())})"
    )


def _error_table(prediction: Prediction, robot: Robot) -> Table:
    """Errors of each joint, of the nominal robot and of the identified one."""
    before, after = prediction.error("nominal"), prediction.error()
    relative, relative_before = prediction.relative(), prediction.relative("nominal")
    ratios, floors = prediction.error_over_noise_floor(), prediction.noise_floor
    rows = []
    for k, (joint, unit) in enumerate(zip(robot.joints, torque_units(robot), strict=True)):
        ratio = None if ratios is None else float(ratios[k])
        tone = ""
        if after[k] > before[k] or relative[k] >= 1.0:
            tone = "bad"
        elif ratio is not None and ratio <= NOISE_RATIO:
            tone = "good"
        rows.append(
            (
                joint,
                unit,
                _torque(before[k]),
                TableCell(_torque(after[k]), tone=tone, bold=True),
                _torque(None if floors is None else float(floors[k])),
                "–" if ratio is None else multiple(ratio),
                percent(relative_before[k]),
                TableCell(percent(relative[k]), tone=tone, bold=True),
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
    return Table(head, rows, (2, 3, 4, 5, 6, 7))


def _torque(value: float | None) -> str:
    """Format a torque with three digits, or four where three would need a power of ten."""
    return number(value, 4 if value is not None and value >= 1000.0 else 3)
