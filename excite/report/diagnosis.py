"""The report of a diagnosis: missing effects, their evidence, and the next experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ..diagnosis import residual_atlas
from ..diagnosis.diagnosis import EXPLAINED_RMSE_RATIO, Diagnosis
from ..diagnosis.residual_atlas import Atlas
from ..effects import EFFECTS, EFFECTS_BY_NAME
from ..recordings import Remark
from ..robot.parameter_names import listed, percent, some
from ..trajectory.trajectory_file import package_versions
from .content import Banner, ReportContent, Section, Table, TableCell
from .diagnosis_evidence import (
    encoders_section,
    prediction_section,
    residual_section,
    separability_section,
    session_changes_section,
)
from .figures import diagnosis as diagnosis_figures
from .figures import unmodelled as unmodelled_figure
from .figures.diagnosis import effect_words
from .figures.trajectory import torque_units
from .formatting import capitalized, number, plural, value_with_error
from .remarks import count_remarks, list_remarks
from .render import render

Document = Mapping[str, Any]
"""The diagnosis as in `diagnosis.json`, or a part of it."""

NOTABLE_PROBABILITY = 0.2
"""Probability from which an effect that is not reported is mentioned."""
DRAWN_UNKNOWN = 6
"""Unmodelled residuals that are drawn."""
GRID_RESOLUTION = 1e-6
"""Relative standard error below which a parameter was chosen from a grid."""
_NONNEGATIVE = {
    "amplitude",
    "exponent",
    "frequency",
    "gain",
    "loss",
    "mass",
    "mu",
    "order",
    "stiffness",
    "time_constant",
    "velocity",
    "width",
}
"""Parameters that are never negative."""
_SIGNED = {("spring", "stiffness")}
"""Exceptions: a spring may also push away from its centre."""
_VERDICTS = {
    "no-mismatch": ("These recordings show nothing that the model lacks.", "good"),
    "explained": ("The model lacks an effect, and the findings explain it down to noise.", "good"),
    "partly-explained": ("The model lacks effects; the findings explain a part of them.", "warn"),
    "unexplained": ("The model lacks an effect, and none of the catalogue explains it.", "bad"),
}
_NOISE_FLOORS = {
    "periods": "the difference between repeated periods",
    "differences": "the torque's spectrum above that of the motion, assumed white below it; no "
    "period was recorded twice, so it may be too low",
}


def diagnosis_page(
    diagnosis: Diagnosis, document: Document, atlas: Atlas, remarks: Sequence[Remark] = ()
) -> str:
    """Render the report of `excite diagnose` as HTML.

    Args:
        diagnosis: The result.
        document: The same as in `diagnosis.json`.
        atlas: Residual over everything that it might depend on.
        remarks: Remarks of the data-quality checks on all recordings.
    """
    content = ReportContent(
        title=f"Diagnosis of {diagnosis.identified.model.robot.name}",
        subtitle="Effects that the robot's model lacks: which, how large, and on what evidence.",
        banners=_banners(document),
        cards=_cards(diagnosis, document),
        sections=[
            _missing_section(diagnosis, document),
            *session_changes_section(diagnosis, document),
            _effects_section(diagnosis, document),
            residual_section(diagnosis, atlas),
            prediction_section(diagnosis, document),
            *encoders_section(diagnosis, document),
            separability_section(diagnosis),
            _next_section(diagnosis, document),
            _provenance_section(diagnosis, atlas, remarks),
        ],
        footer=f"excite {package_versions()['excite']}",
    )
    return render("diagnosis", content)


# -- first screen ----------------------------------------------------------------------------------


def _banners(document: Document) -> list[Banner]:
    """The verdict, then each finding with its parameters."""
    text, tone = _VERDICTS[document["verdict"]]
    if _has_only_session_changes(document):
        known = (
            "The findings explain what the model lacks"
            if document["findings"]
            else "The model lacks no effect"
        )
        text = f"{known}, but friction or offsets differ between the recordings."
        tone = "warn"
    banners = [Banner(f"Verdict: {document['verdict']}. {text}", tone)]
    for finding in document["findings"]:
        parameters = ", ".join(
            f"{name.replace('_', ' ')} {value_with_error(v['value'], v['std'], v['unit'])}"
            for name, v in finding["parameters"].items()
        )
        name = capitalized(_effect_at(finding["effect"], finding["joint"]))
        probability = f"probability {number(finding['probability'], 2)}"
        banners.append(Banner(f"{name}, {probability}: {parameters}.", "warn"))
    return banners


def _cards(diagnosis: Diagnosis, document: Document) -> list[tuple[str, str]]:
    """Key figures of a diagnosis."""
    count = len(document["findings"])
    before, after = (
        percent(float(np.max(error / np.maximum(diagnosis.torque, 1e-300))))
        for error in (diagnosis.before, diagnosis.after)
    )
    ratio = float((diagnosis.after / diagnosis.floor).max())
    return [
        (str(count), "finding" if count == 1 else "findings"),
        (
            f"{before} → {after}" if count else before,
            "held-out error over RMS torque, worst joint",
        ),
        (number(ratio, 3), "held-out error in noise floors, worst joint, with the findings"),
        (
            f"{len(document['unknown'])} of {len(diagnosis.floor)}",
            "joints with an unexplained residual",
        ),
    ]


def _place(joint: str | None) -> str:
    """Joint of an effect."""
    return joint or "the whole robot"


def _effect_at(effect: str, joint: str | None) -> str:
    """An effect with its joint: 'stribeck at joint_2'."""
    if joint is None:
        return f"{effect_words(effect)} of the whole robot"
    return f"{effect_words(effect)} at {joint}"


def _has_only_session_changes(document: Document) -> bool:
    """Tell whether all that is unexplained are changes between recordings."""
    unknown = document["unknown"]
    return bool(unknown) and all(u["where"]["regime"] == "recording" for u in unknown)


# -- is anything missing ---------------------------------------------------------------------------


def _missing_section(diagnosis: Diagnosis, document: Document) -> Section:
    """Held-out error of each joint against its noise floor."""
    joints = document["joints"]
    ratios = {j: v["rmse_before"] / v["noise_floor"] for j, v in joints.items()}
    above = [j for j, ratio in ratios.items() if ratio > EXPLAINED_RMSE_RATIO]
    if not above:
        answer = (
            "No: on the held-out recordings every joint's error with the base model is within "
            f"{EXPLAINED_RMSE_RATIO:g} noise floors."
        )
    else:
        worst = max(above, key=lambda j: ratios[j])
        is_certain = document["findings"] or document["unknown"]
        answer = (
            f"{'Yes' if is_certain else 'Hardly'}: the error with the base model is above noise "
            f"in {some(above)}, most in {worst}: {number(ratios[worst], 3)} noise floors, with "
            f"{percent(joints[worst]['systematic_share'])} of its power systematic."
        )
    has_findings = bool(document["findings"])
    rows = []
    for joint, v in joints.items():
        after: tuple[str | TableCell, str] = ("–", "–")
        if has_findings:
            after = (
                TableCell(percent(v["unexplained_share"]), share=v["unexplained_share"]),
                number(v["rmse_after"] / v["noise_floor"], 3),
            )
        before = TableCell(percent(v["systematic_share"]), share=v["systematic_share"])
        rows.append((joint, before, number(ratios[joint], 3), *after))
    head = (
        "joint",
        "systematic share, base model",
        "noise floors",
        "unexplained share with the findings",
        "noise floors",
    )
    data = {
        "table": Table(head, rows, (2, 4)),
        "noise_floor": _NOISE_FLOORS.get(diagnosis.method, diagnosis.method),
    }
    tone = _VERDICTS[document["verdict"]][1]
    return Section("missing", "Does the model lack anything?", answer, data, tone)


# -- findings --------------------------------------------------------------------------------------


def _effects_section(diagnosis: Diagnosis, document: Document) -> Section:
    """Findings with their parameters, what was refuted, considered and left unexplained."""
    considered, unknown = document["considered"], document["unknown"]
    data = {
        "findings": [_finding(finding) for finding in document["findings"]],
        "refuted": [
            {
                "name": _effect_at(entry["effect"], entry["joint"]),
                "times": number(float(np.sqrt(entry["evidence"]["foretold"])), 2),
            }
            for entry in considered
            if "foretold" in entry["evidence"]
        ],
        "unknown": _unmodelled(diagnosis, unknown) if unknown else {},
        "gains": None,
    }
    if document["findings"] or considered:
        data["gains"] = {
            "figure": Markup(diagnosis_figures.draw_gains(document)),
            "table": _considered_table(considered),
        }
    tone = "" if document["findings"] else "warn" if unknown else "good"
    return Section("what", "Which effect is it?", _effects_answer(document), data, tone)


def _effects_answer(document: Document) -> str:
    """The findings in a sentence."""
    if document["findings"]:
        names = [
            f"{_effect_at(f['effect'], f['joint'])} (probability {number(f['probability'], 2)})"
            for f in document["findings"]
        ]
        return capitalized(listed(names)) + "."
    joints = some([u["joint"] for u in document["unknown"]]) if document["unknown"] else ""
    if _has_only_session_changes(document):
        answer = (
            f"No effect is missing: friction or offset of {joints} differs in the held-out "
            "recordings."
        )
    elif document["unknown"]:
        verb = "has" if len(document["unknown"]) == 1 else "have"
        answer = f"Unknown: {joints} {verb} a torque residual that no effect predicts."
    else:
        answer = (
            "No finding: no effect of the catalogue predicts the held-out recordings sufficiently "
            "better than the base model."
        )
    likeliest = max(
        document["considered"], key=lambda entry: float(entry["probability"]), default=None
    )
    if likeliest and likeliest["probability"] > NOTABLE_PROBABILITY:
        name = _effect_at(likeliest["effect"], likeliest["joint"])
        probability = number(likeliest["probability"], 2)
        answer += f" The most probable, {name}, has probability {probability}."
    return answer


def _finding(finding: Document) -> dict[str, Any]:
    """A finding with its parameters and the evidence in words."""
    effect = EFFECTS_BY_NAME[finding["effect"]]
    source = f" (from {finding['from']})" if finding.get("from") else ""
    rows = [
        (
            key.replace("_", " "),
            number(v["value"]),
            "± " + number(v["std"], 2) if v["std"] is not None else "–",
            _interval(v, key in _NONNEGATIVE and (finding["effect"], key) not in _SIGNED),
            v["unit"],
        )
        for key, v in finding["parameters"].items()
    ]
    head = ("parameter", "value", "standard error", "95 % interval", "unit")
    probability = f"Probability {number(finding['probability'], 2)} that it is this effect"
    if finding["equivalents"]:
        alternatives = listed([effect_words(name) for name in finding["equivalents"]])
        probability += f" or {alternatives}, which these recordings cannot distinguish from it"
    facts = [probability + "."]
    if "not_shown" in finding:
        names = listed([name.replace("_", " ") for name in finding["not_shown"]])
        facts.append(f"These recordings do not show its {names}.")
    if finding["where"]["time"] is not None:
        start, end = finding["where"]["time"]
        recording = Path(finding["where"]["recording"]).name
        facts.append(f"Only from {number(start)} to {number(end)} s of {recording}.")
    purpose = "To confirm it"
    if effect.similar:
        names = listed([effect_words(name) for name in effect.similar])
        purpose = f"To distinguish it from {names}"
    facts.append(f"{purpose}: {finding['experiment']}.")
    return {
        "title": f"{effect_words(finding['effect'])}: {_place(finding['joint'])}{source}",
        "description": f"{effect.equation}. {capitalized(effect.signature)}.",
        "table": Table(head, rows, (1, 2, 3)),
        "facts": facts,
    }


def _interval(parameter: Document, is_nonnegative: bool) -> str:
    """95 % interval of a parameter; that of a nonnegative one ends at zero."""
    value, std = parameter["value"], parameter["std"]
    if std is None or not np.isfinite(std):
        return "–"
    if std < GRID_RESOLUTION * abs(value):
        return "on a grid"
    low, high = value - 1.96 * std, value + 1.96 * std
    return f"{number(max(low, 0.0) if is_nonnegative else low, 3)} … {number(high, 3)}"


def _considered_table(considered: Sequence[Document]) -> Table:
    """Effects that were considered and not reported."""
    rows = [
        (
            effect_words(entry["effect"]),
            _place(entry["joint"]),
            number(entry["probability"], 2) if entry["probability"] else "–",
            number(entry["evidence"]["held_out_gain"]),
            number(entry["evidence"]["severity"], 3),
            ", ".join(
                f"{key} {number(v['value'], 3)} {v['unit']}"
                for key, v in entry["parameters"].items()
            ),
        )
        for entry in considered
    ]
    head = ("effect", "joint", "probability", "held-out gain", "severity", "parameters, alone")
    return Table(head, rows, (2, 3, 4))


def _unmodelled(diagnosis: Diagnosis, unknown: Sequence[Document]) -> dict[str, Any]:
    """Joints with an unexplained residual, and the curves over what predicts it."""
    lines = []
    for entry in unknown:
        where = entry["where"]
        line = f"{entry['joint']}: {percent(entry['share'])} of the residual's power is not noise"
        if where["regime"] == "recording":
            line += f"; {where['statement'].partition(': ')[2]}"
        if "foreseen" in where:
            line += (
                f"; {where['regime']} predicts {percent(where['foreseen'])} of it in recordings "
                "that it was not fitted to"
            )
        lines.append(line)
    curves = [entry for entry in unknown if "response" in entry["where"]]
    robot = diagnosis.identified.model.robot
    units = dict(zip(robot.joints, torque_units(robot), strict=True))
    svg = unmodelled_figure.draw_responses(curves[:DRAWN_UNKNOWN], units) if curves else ""
    return {
        "lines": lines,
        "figure": Markup(svg),
        "omitted": f"The first {DRAWN_UNKNOWN} of {len(curves)}."
        if len(curves) > DRAWN_UNKNOWN
        else "",
    }


# -- next experiment, provenance -------------------------------------------------------------------


def _next_section(diagnosis: Diagnosis, document: Document) -> Section:
    """Experiments that separate or confirm effects."""
    lines = []
    for finding in document["findings"]:
        lines += [
            f"To distinguish {effect_words(finding['effect'])} from {effect_words(name)} at "
            f"{_place(finding['joint'])}: {finding['experiment']}; and "
            f"{EFFECTS_BY_NAME[name].experiment}."
            for name in finding["equivalents"]
        ]
        if not finding["equivalents"]:
            name = _effect_at(finding["effect"], finding["joint"])
            lines.append(f"To confirm {name}: {finding['experiment']}.")
    lines += [
        f"For the unexplained residual in {entry['joint']}: {entry['experiment']}."
        for entry in document["unknown"]
    ]
    if diagnosis.method != "periods":
        lines.append(
            "Repeat the same period a few times in one recording: the difference between periods "
            "is noise, and the noise floor becomes known."
        )
    if not lines:
        answer = (
            "Nothing needs to be recorded for these joints and this band; other speeds, loads or "
            "temperatures may show more."
        )
    elif document["findings"]:
        answer = "Record motions that separate the remaining effects, in the order below."
    else:
        answer = "Record a motion that isolates the effect, in the order below."
    return Section("next", "What to do next?", answer, {"lines": lines})


def _provenance_section(diagnosis: Diagnosis, atlas: Atlas, remarks: Sequence[Remark]) -> Section:
    """Data, method and versions."""
    identified, robot = diagnosis.identified, diagnosis.identified.model.robot
    fitted, held_out = (
        list(dict.fromkeys(motion.segment.source for motion in motions))
        for motions in diagnosis.motions
    )
    answer = (
        f"{plural(len(diagnosis.design.shapes), 'candidate model')} of {len(EFFECTS)} effects, "
        "alone and together, each refitted with the base model to "
        f"{plural(len(fitted), 'recording')} and evaluated on "
        f"{plural(len(held_out), 'other recording')}; {count_remarks(remarks)}."
    )
    trusted = diagnosis.options.trusted
    refit = f"{plural(len(trusted), 'value')} fixed by --prior" if trusted else "all refitted"
    rows_fitted, rows_held_out = (sum(map(len, motions)) for motions in diagnosis.motions)
    facts = {
        "robot": f"{robot.name} ({robot.source})",
        "SHA-256 of the URDF": robot.sha256,
        "fitted to": ", ".join(fitted),
        "held out": ", ".join(held_out),
        "rows": f"{rows_fitted} fitted, {rows_held_out} held out, × {plural(robot.n, 'joint')}",
        "band": f"{number(diagnosis.hertz)} Hz",
        "base model": f"{identified.model.base.count} parameters, {refit}",
        "noise floor": _NOISE_FLOORS.get(diagnosis.method, diagnosis.method),
        "p-values": f"{residual_atlas.DRAWS} permutations by random signs of {atlas.blocks} "
        f"blocks; maximum over {len(atlas.panels)} curves",
        "versions": ", ".join(f"{k} {v}" for k, v in package_versions().items()),
    }
    data = {
        "facts": Table(("quantity", "value"), list(facts.items())),
        "remarks": list_remarks(remarks),
    }
    return Section("made", "How was it made?", answer, data)
