"""Evidence of a diagnosis: residual curves, prediction, encoders, sessions, separability."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ..diagnosis.diagnosis import Diagnosis
from ..diagnosis.isolability import ALIKE, EffectAtJoint, isolability
from ..diagnosis.residual_atlas import SIGNIFICANT, Atlas
from ..effects import EFFECTS, EFFECTS_BY_NAME
from ..robot.parameter_names import listed, percent, some
from ..robot.robot import Robot
from .content import Section, Table, TableCell
from .figures import diagnosis as diagnosis_figures
from .figures import gear_encoders as encoder_figure
from .figures import residual_atlas as atlas_figures
from .figures import session_changes as session_figure
from .figures.diagnosis import effect_words
from .figures.session_changes import KIND_WORDS
from .figures.torque_fit import EXCERPT_SECONDS, points_per_curve
from .figures.trajectory import torque_units
from .formatting import number, plural, value_with_error

UNFOLDED_JOINTS = 3
"""Joints whose residual curves are shown without a click."""
UNFOLDED_RECORDINGS = 2
"""Recordings whose prediction is shown without a click."""
LISTED_PAIRS = 8
"""Inseparable pairs of effects that are listed."""
LISTED_PARAMETERS = 12
"""Base parameters that are listed with their change."""
NOTABLE_IMPROVEMENT = 0.02
"""Relative decrease of the held-out error from which it counts as an improvement."""
NOTABLE_WORSENING = 0.005
"""Relative increase of the held-out error from which it is mentioned."""
NOTABLE_SHIFT = 2.0
"""Change of a base parameter that is listed [standard deviations]."""


# -- residual --------------------------------------------------------------------------------------


def residual_section(diagnosis: Diagnosis, atlas: Atlas) -> Section:
    """Build the section on the quantities that the held-out residual depends on."""
    robot, has_findings = diagnosis.identified.model.robot, bool(diagnosis.verdict.chosen)
    question = "What does the residual depend on?"
    if not atlas.panels:
        answer = "Nothing could be tested: no joint moves."
        return Section("where", question, answer, {}, "warn")
    units = torque_units(robot)
    significant = sorted(
        {p.joint for p in atlas.shown},
        key=lambda j: -max(p.score_before for p in atlas.shown if p.joint == j),
    )
    others = [j for j in range(robot.n) if j not in significant and atlas.of(j)]
    with_finding = {h.joint for h in diagnosis.verdict.chosen if h.joint is not None}
    unfolded = sorted(significant, key=lambda j: j not in with_finding)
    unfolded = unfolded[: max(UNFOLDED_JOINTS, len(with_finding & set(significant)))]
    figures = {
        j: {
            "joint": robot.joints[j],
            "figure": Markup(
                atlas_figures.draw_joint(
                    atlas.of(j),
                    robot.joints[j],
                    units[j],
                    float(diagnosis.floor[j]),
                    has_findings=has_findings,
                )
            ),
        }
        for j in [*significant, *others]
    }
    folded = [figures[j] for j in figures if j not in unfolded]
    data = {
        "overview": Markup(atlas_figures.draw_overview(atlas, robot.joints)),
        "significance": f"{SIGNIFICANT:g}",
        "has_findings": has_findings,
        "joints": [figures[j] for j in unfolded],
        "others": folded,
        "others_summary": "The other joint"
        if len(folded) == 1
        else f"The other {len(folded)} joints",
    }
    answer = _residual_answer(atlas, robot, has_findings=has_findings)
    return Section("where", question, answer, data)


def _residual_answer(atlas: Atlas, robot: Robot, *, has_findings: bool) -> str:
    """The most significant dependence, and how many there are."""
    shown, total = atlas.shown, len(atlas.panels)
    if not shown:
        return f"On nothing: none of {plural(total, 'curve')} differs significantly from noise."
    first = shown[0]
    verb = "differs" if len(shown) == 1 else "differ"
    answer = (
        f"The most significant is {robot.joints[first.joint]} against {first.against}, which "
        f"explains {percent(first.share_before)} of its residual; {plural(len(shown), 'curve')} of "
        f"{total} {verb} significantly from noise"
    )
    if not has_findings:
        return answer + "."
    removed = sum(p.p_after >= SIGNIFICANT for p in shown)
    return f"{answer}, and the findings remove {removed} of them."


# -- prediction ------------------------------------------------------------------------------------


def prediction_section(diagnosis: Diagnosis, document: Mapping[str, Any]) -> Section:
    """Build the section on held-out prediction without and with the findings."""
    robot = diagnosis.identified.model.robot
    predictions = list(diagnosis_figures.held_out_predictions(diagnosis))
    points = points_per_curve(predictions, robot.n)
    recordings = [
        {
            "source": prediction.source,
            "figure": Markup(diagnosis_figures.draw_predictions(prediction, diagnosis, points)),
        }
        for prediction in predictions
    ]
    answer, tone = _prediction_answer(diagnosis)
    shifted = [row for row in document["parameters"] if row["moved"] > NOTABLE_SHIFT]
    data = {
        "errors": _error_table(diagnosis, document),
        "simulation": _simulation(document, robot),
        "parameters": _shifted_parameters(shifted) if shifted else None,
        "parameters_count": f" ({LISTED_PARAMETERS} of {len(shifted)})"
        if len(shifted) > LISTED_PARAMETERS
        else "",
        "recordings": recordings[:UNFOLDED_RECORDINGS],
        "others": recordings[UNFOLDED_RECORDINGS:],
        "others_summary": plural(len(recordings) - UNFOLDED_RECORDINGS, "more recording"),
        "band": number(document["band_hz"], 3),
        "has_standstill": not bool(diagnosis.moving.all()),
        "is_excerpt": any(p.time[-1] - p.time[0] > EXCERPT_SECONDS for p in predictions),
        "excerpt": f"{EXCERPT_SECONDS:g}",
    }
    return Section("better", "Do the findings improve the prediction?", answer, data, tone)


def _prediction_answer(diagnosis: Diagnosis) -> tuple[str, str]:
    """Change of the held-out error, and its tone."""
    if not diagnosis.verdict.chosen:
        return "There is no finding to compare; the error of the base model is shown.", ""
    robot = diagnosis.identified.model.robot
    gain = 1.0 - diagnosis.after / diagnosis.before
    best, worst = int(np.argmax(gain)), int(np.argmin(gain))
    is_better = bool(gain[best] > NOTABLE_IMPROVEMENT)
    is_worse = bool(gain[worst] < -NOTABLE_WORSENING)
    answer = (
        f"{'Yes' if is_better else 'No'}: on held-out recordings the RMSE of {robot.joints[best]} "
        f"falls by {percent(max(gain[best], 0.0))}, to {number(diagnosis.after[best], 3)} "
        f"{torque_units(robot)[best]}"
    )
    if is_worse:
        answer += f"; that of {robot.joints[worst]} rises by {percent(-gain[worst])}."
    else:
        answer += "; it rises for no joint."
    return answer, "good" if is_better and not is_worse else "warn"


def _error_table(diagnosis: Diagnosis, document: Mapping[str, Any]) -> Table:
    """Held-out errors of each joint without and with the findings."""
    robot = diagnosis.identified.model.robot
    moving = diagnosis.moving.mean(axis=0)
    has_findings = bool(document["findings"])
    rows = []
    for k, (joint, unit) in enumerate(zip(robot.joints, torque_units(robot), strict=True)):
        before, after = float(diagnosis.before[k]), float(diagnosis.after[k])
        floor, torque = float(diagnosis.floor[k]), max(float(diagnosis.torque[k]), 1e-300)
        tone = ""
        if after > (1.0 + NOTABLE_WORSENING) * before:
            tone = "bad"
        elif after < (1.0 - NOTABLE_IMPROVEMENT) * before:
            tone = "good"
        rows.append(
            (
                joint,
                unit,
                number(before),
                TableCell(number(after), tone=tone, bold=True) if has_findings else "–",
                number(floor),
                number(after / floor, 3),
                percent(before / torque),
                percent(after / torque) if has_findings else "–",
                percent(float(moving[k])),
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
        "in motion",
    )
    return Table(head, rows, (2, 3, 4, 5, 6, 7, 8))


def _simulation(document: Mapping[str, Any], robot: Robot) -> dict[str, Any]:
    """Position errors of a simulation from held-out torque; empty where there was none."""
    simulation = document["simulation"]
    if not simulation:
        return {}
    units = ("m" if unit == "N" else "rad" for unit in torque_units(robot))
    rows = [
        (
            joint,
            unit,
            number(v["before"], 3),
            number(v["after"], 3),
            percent(v["after"] / max(v["before"], 1e-300)),
        )
        for (joint, v), unit in zip(simulation["joints"].items(), units, strict=True)
    ]
    head = ("joint", "unit", "RMS before", "RMS after", "after / before")
    return {
        "seconds": number(simulation["seconds"], 2),
        "table": Table(head, rows, (2, 3, 4)),
    }


def _shifted_parameters(shifted: Sequence[Mapping[str, Any]]) -> Table:
    """Base parameters that change most when the findings are modelled."""
    rows = [
        (
            row["name"],
            number(row["without"], 4),
            number(row["with"], 4),
            number(row["std"], 2),
            number(row["moved"], 3),
        )
        for row in shifted[:LISTED_PARAMETERS]
    ]
    head = ("base parameter", "without", "with", "std", "change [std]")
    return Table(head, rows, (1, 2, 3, 4))


# -- sessions --------------------------------------------------------------------------------------


def session_changes_section(diagnosis: Diagnosis, document: Mapping[str, Any]) -> Iterator[Section]:
    """Build the section on friction and offsets that differ between recordings, if any do."""
    changes = document["between_recordings"]
    if not changes:
        return
    joints = list(dict.fromkeys(change["joint"] for change in changes))
    recordings = list(dict.fromkeys(Path(change["recording"]).name for change in changes))
    ratio = (diagnosis.rmse_without_changes / diagnosis.floor).tolist()
    residual = dict(zip(diagnosis.identified.model.robot.joints, ratio, strict=True))
    rows = [
        (
            change["joint"],
            Path(change["recording"]).name,
            *(_change(change[kind]) for kind in KIND_WORDS),
            number(residual[change["joint"]], 3),
        )
        for change in changes
    ]
    head = ("joint", "recording", *KIND_WORDS.values(), "error in noise floors without it")
    yield Section(
        "changes",
        "Is the robot the same in all recordings?",
        f"No: friction or torque offset of {some(joints)} differs in {some(recordings)}.",
        {
            "table": Table(head, rows, (5,)),
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
            *(_estimate(gear[key]) for key in ("stiffness", "lost_motion", "read_apart")),
            number(gear["before"], 3),
            number(gear["after"], 3),
        )
        for joint, gear in gears.items()
    ]
    head = ("joint", "stiffness", "lost motion", "reading delay", "RMS difference", "unexplained")
    yield Section(
        "gears",
        "What do the two encoders say?",
        answer,
        {
            "table": Table(head, rows),
            "figure": Markup(encoder_figure.draw_deflections(diagnosis)),
        },
    )


def _estimate(value: Mapping[str, Any] | None) -> str:
    """An estimate with its standard error."""
    if value is None:
        return "–"
    return value_with_error(value["value"], value["std"], value["unit"])


# -- separability ----------------------------------------------------------------------------------


def separability_section(diagnosis: Diagnosis) -> Section:
    """Build the section on effects that these recordings cannot distinguish."""
    robot, result = diagnosis.identified.model.robot, isolability(diagnosis.design)
    pairs, trusted = result.pairs(), diagnosis.options.trusted

    def words(candidate: EffectAtJoint) -> str:
        name = effect_words(candidate.effect)
        if candidate.joint is None:
            return f"{name} of the whole robot"
        return f"{name} at {robot.joints[candidate.joint]}"

    tested = {candidate.effect for candidate in result.candidates}
    wanted = diagnosis.options.names or tuple(effect.name for effect in EFFECTS)
    untested = [effect.name for effect in EFFECTS if effect.name in wanted]
    untested = [name for name in untested if name not in tested]
    absorbed = [name for name in untested if EFFECTS_BY_NAME[name].prior_only and not trusted]
    unseen = [name for name in untested if name not in absorbed]
    count = len(result.candidates)
    if pairs:
        first, second, correlation = pairs[0]
        answer = (
            f"{plural(len(pairs), 'pair')} of {count} effects and joints, above all {words(first)} "
            f"and {words(second)} (canonical correlation {number(correlation, 2)})."
        )
    else:
        answer = f"No two of {count} effects and joints have a correlation above {ALIKE:g}."
    joints = [h.joint for h in diagnosis.verdict.chosen if h.joint is not None]
    by_error = np.argsort(-diagnosis.before / diagnosis.floor).tolist()
    figures = [
        {
            "joint": robot.joints[j],
            "figure": Markup(diagnosis_figures.draw_correlations(result, j, robot.joints[j])),
        }
        for j in dict.fromkeys([*joints, *by_error])
        if len(result.of(j)) > 1
    ]
    data = {
        "absorbed": listed([effect_words(name) for name in absorbed]) if absorbed else "",
        "unseen": listed([effect_words(name) for name in unseen]) if unseen else "",
        "pairs": [f"{words(a)} and {words(b)}: {number(v, 3)}" for a, b, v in pairs[:LISTED_PAIRS]],
        "joints": figures[:1],
        "others": figures[1:],
        "others_summary": f"The other {plural(len(figures) - 1, 'joint')}",
    }
    return Section("apart", "Which effects can these recordings not distinguish?", answer, data)
