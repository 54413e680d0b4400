"""The report of a diagnosis: where the torque error comes from, how sure that is, what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ..diagnosis.diagnosis import Diagnosis
from ..effects import EFFECTS, EFFECTS_BY_NAME
from ..recordings import Remark
from ..robot.parameter_names import listed, some
from ..trajectory.trajectory_file import package_versions
from .content import Banner, ReportContent, Section, Table
from .diagnosis_evidence import (
    encoders_section,
    prediction_section,
    session_changes_section,
    unknown_section,
)
from .figures import diagnosis as diagnosis_figures
from .figures.trajectory import torque_units
from .formatting import capitalized, number, plural, significant, value_with_error
from .remarks import count_remarks, list_remarks
from .render import render
from .torque_budget import JointBudget, effect_words, joint_budgets, sorted_findings

Document = Mapping[str, Any]
"""The diagnosis as in `diagnosis.json`, or a part of it."""

DRAWN_CURVES = 12
"""Curves of effects that are shown without a click."""
SHOWN_SENTENCES = 10
"""Joints whose sentence is shown without a click."""
_VERDICTS = {
    "no-mismatch": ("The base model lacks nothing that these recordings show.", "good"),
    "explained": ("The effects below explain all that the base model lacks.", "good"),
    "partly-explained": ("The effects below explain a part of what the base model lacks.", "warn"),
    "unexplained": ("The base model lacks something that no known effect explains.", "bad"),
}
_NOISE_FLOORS = {
    "periods": "the difference between repeated periods",
    "differences": "the torque's spectrum above that of the motion, assumed white below it; no "
    "period was recorded twice, so it may be too low",
}


def diagnosis_page(diagnosis: Diagnosis, document: Document, remarks: Sequence[Remark] = ()) -> str:
    """Render the report of `excite diagnose` as HTML.

    Args:
        diagnosis: The result.
        document: The same as in `diagnosis.json`; findings are withheld in it if a recording is in
            doubt.
        remarks: Remarks of the data-quality checks on all recordings.
    """
    robot = diagnosis.identified.model.robot
    units = dict(zip(robot.joints, torque_units(robot), strict=True))
    budgets = joint_budgets(document, robot)
    content = ReportContent(
        title=f"Diagnosis of {robot.name}",
        subtitle="What the base model (rigid links, rotor inertia, viscous and Coulomb friction, "
        "offset) lacks, found in the torque that it does not predict.",
        banners=_banners(document),
        cards=(),
        sections=[
            _budget_section(document, budgets),
            _findings_section(document, units),
            *unknown_section(document, units),
            *session_changes_section(document),
            prediction_section(diagnosis, document, budgets),
            *encoders_section(diagnosis, document),
            _next_section(diagnosis, document),
            _considered_section(diagnosis, document),
            _provenance_section(diagnosis, remarks),
        ],
        footer=f"excite {package_versions()['excite']}",
    )
    return render("diagnosis", content)


# -- first screen ----------------------------------------------------------------------------------


def _banners(document: Document) -> list[Banner]:
    """Doubts about the recordings, or else the verdict."""
    doubts = document.get("doubts", [])
    if doubts:
        text = (
            "Findings are withheld: a recording may not hold what its columns say, and then a "
            "torque error says nothing about a joint. Resolve this first, then diagnose again."
        )
        return [
            Banner(text, "bad"),
            *(Banner(f"{Path(d['recording']).name}: {d['text']}", "warn") for d in doubts),
        ]
    text, tone = _VERDICTS[document["verdict"]]
    return [Banner(f"{capitalized(document['verdict'])}. {text}", tone)]


def _budget_section(document: Document, budgets: Sequence[JointBudget]) -> Section:
    """The torque budget of every joint, as a picture and in words."""
    improved = [b for b in budgets if b.is_improved]
    if "doubts" in document:
        answer, tone = "Not known while findings are withheld: only the error is shown.", "warn"
    elif not improved:
        answer = "From nothing that the diagnosis knows: no effect reduces the error."
        tone = _VERDICTS[document["verdict"]][1]
    else:
        best = max(improved, key=lambda b: 1.0 - b.after / b.before)
        answer = (
            f"On recordings that it has not seen, the model with effects reduces the error at "
            f"{len(improved)} of {plural(len(budgets), 'joint')}, most at {best.joint}: "
            f"{significant(best.before)} → {significant(best.after)} {best.unit}."
        )
        tone = ""
    data = {
        "figure": Markup(diagnosis_figures.draw_budget(budgets)),
        "sentences": [f"{b.joint}: {b.sentence}." for b in budgets],
        "shown": SHOWN_SENTENCES,
        "has_uncertain": any(not p.is_certain for b in improved for p in b.parts),
    }
    return Section("budget", "Where does the torque error come from?", answer, data, tone)


# -- findings --------------------------------------------------------------------------------------


def _findings_section(document: Document, units: Mapping[str, str]) -> Section:
    """The findings: how sure, how large, and with what they may be confused."""
    findings = sorted_findings(document)
    rows = [
        (
            finding["joint"] or "whole robot",
            effect_words(finding["effect"]) + _origin(finding),
            number(finding["probability"], 2),
            _size(finding["evidence"]),
            _parameters(finding),
            listed([effect_words(name) for name in finding["equivalents"]])
            if finding["equivalents"]
            else "–",
        )
        for finding in findings
    ]
    head = ("joint", "effect", "probability", "size [noise]", "parameters", "or instead")
    # a curve over the angle is too coarse for a ripple of many periods a turn
    curves = [f for f in findings if f["curve"] and f["where"]["regime"] != "order"]
    data = {
        "table": Table(head, rows, (2, 3)) if rows else None,
        "effects": _descriptions(findings),
        "curves": Markup(diagnosis_figures.draw_effect_curves(curves[:DRAWN_CURVES], units))
        if curves
        else "",
        "more_curves": Markup(diagnosis_figures.draw_effect_curves(curves[DRAWN_CURVES:], units))
        if curves[DRAWN_CURVES:]
        else "",
    }
    answer, tone = _findings_answer(document)
    return Section("what", "Which effects are there, and how sure is that?", answer, data, tone)


def _findings_answer(document: Document) -> tuple[str, str]:
    """The findings in a sentence, and its tone."""
    groups: dict[str, list[str]] = {}
    for finding in document["findings"]:
        groups.setdefault(finding["effect"], []).append(finding["joint"] or "the whole robot")
    if groups:
        texts = [
            f"{effect_words(effect)} ({some(joints, 2)})"
            for effect, joints in sorted(groups.items(), key=lambda group: -len(group[1]))
        ]
        count = plural(len(document["findings"]), "finding")
        return f"{count}: {listed(texts)}.", ""
    if "doubts" in document:
        return "Not stated: findings at single joints are withheld; see above.", "warn"
    if document["unknown"]:
        return "No finding: the torque that is missing resembles no known effect.", "warn"
    return "No finding: no known effect is needed to explain these recordings.", "good"


def _origin(finding: Document) -> str:
    """The other joint of an effect, or the interval in which it acts."""
    text = f" from {finding['from']}" if finding.get("from") else ""
    if finding["where"]["time"] is None:
        return text
    start, end = finding["where"]["time"]
    recording = Path(finding["where"]["recording"]).name
    return f"{text}, {number(start)} to {number(end)} s of {recording} only"


def _size(evidence: Document) -> str:
    """Severity with its 90 % interval."""
    low, high = evidence["severity_interval"]
    return f"{significant(evidence['severity'])} ({significant(low)} … {significant(high)})"


def _parameters(finding: Document) -> str:
    """Parameters with standard errors."""
    texts = [
        f"{key.replace('_', ' ')} {value_with_error(v['value'], v['std'], v['unit'])}"
        for key, v in finding["parameters"].items()
    ]
    return ", ".join(texts).replace(" ± ", "\u00a0±\u00a0") or "–"


def _descriptions(findings: Sequence[Document]) -> Table | None:
    """Signature and equation of every effect that was found."""
    effects = [EFFECTS_BY_NAME[name] for name in dict.fromkeys(f["effect"] for f in findings)]
    rows = [(effect_words(e.name), capitalized(e.signature), e.equation) for e in effects]
    return Table(("effect", "how it shows", "equation"), rows) if rows else None


# -- next experiment -------------------------------------------------------------------------------


def _next_section(diagnosis: Diagnosis, document: Document) -> Section:
    """Experiments that separate or confirm effects."""
    groups: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for finding in document["findings"]:
        key = finding["effect"], tuple(finding["equivalents"])
        groups.setdefault(key, []).append(finding["joint"] or "the whole robot")
    lines = []
    for (effect, equivalents), joints in sorted(groups.items(), key=lambda g: not g[0][1]):
        experiments = [EFFECTS_BY_NAME[name].experiment for name in (effect, *equivalents)]
        names = [effect_words(name) for name in equivalents]
        purpose = (
            f"To tell {effect_words(effect)} from {listed(names)}"
            if names
            else (f"To confirm {effect_words(effect)}")
        )
        lines.append(f"{purpose} ({some(joints, 2)}): {'; '.join(dict.fromkeys(experiments))}.")
    lines += [
        f"For the unknown torque at {entry['joint']}: {entry['experiment']}."
        for entry in document["unknown"]
    ]
    if diagnosis.method != "periods":
        lines.append(
            "Repeat the same period a few times in one recording: the difference between periods "
            "is noise, and the noise floor becomes known."
        )
    if "doubts" in document:
        answer = "Resolve the doubts about the recordings named at the top of this page."
    elif any(equivalents for _, equivalents in groups):
        answer = "Record the motions that tell apart what these recordings cannot."
    elif groups or document["unknown"]:
        answer = "Nothing must be decided; these motions would show the effects most clearly."
    else:
        answer = "Nothing; other speeds, loads or temperatures may show more."
    return Section("next", "What to record next?", answer, {"lines": lines})


# -- considered, provenance ------------------------------------------------------------------------


def _considered_section(diagnosis: Diagnosis, document: Document) -> Section:
    """Effects that are not reported, and those that these recordings could not show."""
    considered = document["considered"]
    rows = [
        (
            effect_words(entry["effect"]),
            entry["joint"] or "whole robot",
            number(entry["probability"], 2),
            number(entry["evidence"]["log_bayes_factor"], 3),
            "yes" if entry["modelled"] else "no",
        )
        for entry in considered
    ]
    absorbed = [
        effect_words(effect.name)
        for effect in EFFECTS
        if effect.prior_only
        and not diagnosis.options.trusted
        and (not diagnosis.options.names or effect.name in diagnosis.options.names)
    ]
    head = ("effect", "joint", "probability", "log Bayes factor", "in the saved model")
    answer = (
        f"{plural(len(considered), 'effect')} had some evidence, too little to be reported."
        if considered and "doubts" not in document
        else f"{plural(len(considered), 'effect')} had some evidence; those at single joints are "
        "withheld."
        if considered
        else "No other effect had evidence."
    )
    data = {
        "table": Table(head, rows, (2, 3)) if rows else None,
        "absorbed": listed(absorbed) if absorbed else "",
    }
    return Section("considered", "What else was considered?", answer, data)


def _provenance_section(diagnosis: Diagnosis, remarks: Sequence[Remark]) -> Section:
    """Data, method and versions."""
    identified, robot = diagnosis.identified, diagnosis.identified.model.robot
    groups = (diagnosis.model.motions, diagnosis.held_out.motions)
    fitted, held_out = (list(dict.fromkeys(m.segment.source for m in group)) for group in groups)
    rows = [sum(map(len, group)) for group in groups]
    trusted = diagnosis.options.trusted
    answer = (
        f"All effects and the base model were fitted jointly to "
        f"{plural(len(fitted), 'recording')}; {plural(len(held_out), 'other recording')} served "
        f"only to measure the error; "
        f"{count_remarks(remarks)}."
    )
    refit = f"{plural(len(trusted), 'value')} fixed by --prior" if trusted else "all refitted"
    facts = {
        "robot": f"{robot.name} ({robot.source})",
        "SHA-256 of the URDF": robot.sha256,
        "fitted to": ", ".join(fitted),
        "held out": ", ".join(held_out),
        "rows": f"{rows[0]} fitted, {rows[1]} held out, × {plural(robot.n, 'joint')}",
        "band": f"below {number(diagnosis.hertz)} Hz",
        "base model": f"{identified.model.base.count} parameters, {refit}",
        "noise floor": _NOISE_FLOORS.get(diagnosis.method, diagnosis.method),
        "versions": ", ".join(f"{k} {v}" for k, v in package_versions().items()),
    }
    data = {
        "facts": Table(("quantity", "value"), list(facts.items())),
        "remarks": list_remarks(remarks),
    }
    return Section("made", "How was it made?", answer, data)
