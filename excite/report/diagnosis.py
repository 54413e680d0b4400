"""The report of a diagnosis: where the torque error comes from, how sure that is, what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from ..diagnosis.diagnosis import Diagnosis
from ..diagnosis.estimates import MIN_PROBABILITY
from ..diagnosis.session_changes import sources
from ..effects import EFFECTS, EFFECTS_BY_NAME
from ..robot.parameter_names import listed, plural
from ..schemas.effects import effect_words
from ..trajectory.trajectory_file import package_versions
from . import verdict
from .content import Banner, ReportContent, Section, Table, TableCell
from .decisions import decisions_section
from .diagnosis_evidence import (
    encoders_section,
    prediction_section,
    session_changes_section,
    unknown_section,
)
from .figures import diagnosis as diagnosis_figures
from .figures.trajectory import torque_units
from .formatting import capitalized, number, significant
from .remarks import RemarksByRecording, count_remarks, list_remarks
from .render import render
from .torque_budget import (
    Document,
    JointBudget,
    base_words,
    finding_parameter_words,
    joint_budgets,
    joint_words,
    known_words,
    origin_words,
    places_where,
    probability_words,
    sorted_findings,
)

DRAWN_CURVES = 15
"""Curves of effects that are drawn, those of the largest effects."""
SHOWN_SENTENCES = 10
"""Joints whose sentence is shown without a click."""
CURVE_LEVEL = 0.1
"""Part of the largest torque of a curve above which it is not near zero."""
CURVE_POINTS = 3
"""Bins not near zero that a curve needs to be drawn."""
_NOISE_FLOORS = {
    "periods": "the difference between repeated periods",
    "differences": "estimated from the torque's spectrum above that of the motion; no period was "
    "recorded twice",
}


def diagnosis_page(
    diagnosis: Diagnosis, document: Document, remarks: RemarksByRecording | None = None
) -> str:
    """Render the report of `excite diagnose` as HTML.

    Args:
        diagnosis: The result.
        document: The same as in `diagnosis.json`; findings are withheld in it if a recording is in
            doubt.
        remarks: Remarks of the data-quality checks, by recording.
    """
    robot = diagnosis.identified.model.robot
    units = dict(zip(robot.joints, torque_units(robot), strict=True))
    budgets = joint_budgets(document, robot)
    content = ReportContent(
        title=f"Diagnosis of {robot.name}",
        subtitle="What the base model (rigid links, rotor inertia, viscous and Coulomb friction, "
        f"offset) lacks. {known_words(document)}".rstrip(),
        banners=_banners(document, budgets),
        cards=(),
        sections=[
            *decisions_section(document),
            _budget_section(diagnosis, document, budgets),
            _findings_section(document, budgets, units),
            *unknown_section(document, units),
            *session_changes_section(document),
            prediction_section(diagnosis, document, budgets),
            *encoders_section(diagnosis, document),
            _next_section(diagnosis, document, budgets),
            _considered_section(diagnosis, document),
            _provenance_section(diagnosis, remarks or {}),
        ],
        footer=f"excite {package_versions()['excite']}",
    )
    return render("diagnosis", content)


# -- first screen ----------------------------------------------------------------------------------


def _banners(document: Document, budgets: Sequence[JointBudget]) -> list[Banner]:
    """Doubts about the recordings, or else the verdict."""
    if "doubts" in document:
        text = (
            "Findings are withheld: a recording may not hold what its columns say, and then a "
            "torque error says nothing about a joint. Resolve this first, then diagnose again."
        )
        doubts = [f"{Path(d['recording']).name}: {d['text']}" for d in document["doubts"]]
        return [Banner(text, "bad"), *(Banner(doubt, "warn") for doubt in doubts)]
    head = capitalized(document["verdict"].replace("-", " "))
    next_action = verdict.next_words(document, budgets)
    return [
        Banner(
            f"{head}: {verdict.verdict_words(document, budgets)}.",
            verdict.tone(document, budgets),
        ),
        Banner(f"Use: {verdict.use_words(budgets)}. Next: {next_action}.", ""),
    ]


def _budget_section(
    diagnosis: Diagnosis, document: Document, budgets: Sequence[JointBudget]
) -> Section:
    """The torque budget of every joint, as a picture and in words."""
    improved = sorted((b for b in budgets if b.is_improved), key=lambda b: b.after / b.before)
    causes = {
        "parameters of the prior that are in doubt": lambda b: b.is_misled,
        "friction or offset that changed between the recordings": lambda b: b.is_changed,
        "speeds that the fitted recordings do not have": lambda b: b.is_extrapolated,
        "torque that no known effect explains": lambda b: b.unknown and not b.is_misled,
    }
    texts = [
        f"{cause} ({places})"
        for cause, holds in causes.items()
        if (places := places_where(budgets, holds))
    ]
    answer, tone = "Not known: no effect found reduces the error.", "warn"
    if "doubts" in document:
        answer = "Not known while findings are withheld: only the error is shown."
    elif improved:
        most = (
            f", most at {improved[0].joint}: {improved[0].error}"
            if improved[1:]
            else f": {improved[0].error}"
        )
        places = joint_words([b.joint for b in improved], len(budgets))
        answer = f"The saved model reduces the error on unseen recordings at {places}{most}."
        tone = ""
    elif all(b.is_explained for b in budgets):
        answer, tone = "From noise alone, at every joint.", "good"
    elif texts:
        answer = f"Mostly from {listed(texts)}."
    seconds = sum(float(m.time[-1] - m.time[0]) for m in diagnosis.held_out.motions)
    data = {
        "figure": Markup(diagnosis_figures.draw_budget(budgets)),
        "sentences": [
            f"{b.joint}: error {b.error}{'; ' if b.causes else ''}{b.causes}." for b in budgets
        ],
        "shown": SHOWN_SENTENCES,
        "seconds": number(seconds, 2 if seconds < 100.0 else 3),
        "base": base_words(diagnosis),
        "is_noise_known": diagnosis.noise.method == "periods",
        "has_changed": any(b.is_changed for b in budgets),
        "has_uncertain": any(not p.is_certain for b in improved for p in b.parts),
    }
    return Section("budget", "Where does the torque error come from?", answer, data, tone)


# -- findings --------------------------------------------------------------------------------------


def _findings_section(
    document: Document, budgets: Sequence[JointBudget], units: Mapping[str, str]
) -> Section:
    """The findings: how sure, how large, and with what they may be confused."""
    findings, rows = sorted_findings(document), []
    for k, finding in enumerate(findings):
        is_first = k == 0 or findings[k - 1]["joint"] != finding["joint"]
        alternatives = [effect_words(name) for name in finding["equivalents"]]
        rows.append(
            (
                (finding["joint"] or "whole\u00a0robot") if is_first else "",
                TableCell(
                    effect_words(finding["effect"]) + origin_words(finding),
                    note=f"or {' or '.join(alternatives)}" if alternatives else "",
                ),
                probability_words(finding["probability"]),
                _size(finding["evidence"]),
                finding_parameter_words(finding).replace(" ", "\u00a0").replace(",\u00a0", ", "),
            )
        )
    head = ("joint", "effect", "probability", "size [× residual]", "parameters")
    effects = [EFFECTS_BY_NAME[name] for name in dict.fromkeys(f["effect"] for f in findings)]
    signatures = [(effect_words(e.name), capitalized(e.signature), e.equation) for e in effects]
    sizes = sorted(f["evidence"]["severity"] for f in findings if _is_drawn(f))
    smallest = sizes[-DRAWN_CURVES:][0] if sizes else 0.0
    curves = [f for f in findings if _is_drawn(f) and f["evidence"]["severity"] >= smallest]
    data = {
        "table": Table(head, rows, (2, 3)),
        "has_alternatives": any(finding["equivalents"] for finding in findings),
        "effects": Table(("effect", "how it shows", "equation"), signatures),
        "curves": Markup(diagnosis_figures.draw_effect_curves(curves, units)) if curves else "",
        "points": CURVE_POINTS,
    }
    answer, tone = _findings_answer(document, budgets)
    return Section("what", "Which effects are there, and how sure is that?", answer, data, tone)


def _findings_answer(document: Document, budgets: Sequence[JointBudget]) -> tuple[str, str]:
    """The findings in a sentence, and its tone."""
    groups: dict[str, list[str]] = {}
    for finding in sorted_findings(document):
        groups.setdefault(finding["effect"], []).append(finding["joint"] or "the whole robot")
    if groups:
        count = len(document["joints"])
        texts = [
            f"{effect_words(effect)} ({joint_words(joints, count)})"
            for effect, joints in sorted(groups.items(), key=lambda group: -len(group[1]))
        ]
        return f"{plural(len(document['findings']), 'finding')}: {listed(texts)}.", ""
    if "doubts" in document:
        return "Not stated: findings at single joints are withheld; see above.", "warn"
    if document["unknown"]:
        return "No finding: no known effect explains the torque that is missing.", "warn"
    if any(b.is_unforeseen for b in budgets):
        return "No finding: no known effect explains the error that remains.", "warn"
    return "No finding: no known effect is needed to explain these recordings.", "good"


def _size(evidence: Document) -> str:
    """Severity with its 90 % interval."""
    low, high = evidence["severity_interval"]
    return f"{significant(evidence['severity'])} ({significant(low)} … {significant(high)})"


def _is_drawn(finding: Document) -> bool:
    """Tell whether a finding has a curve whose bins are fine enough to show its form."""
    # the period of a ripple is shorter than a bin of the angle
    if not finding["curve"] or finding["where"]["regime"] == "order":
        return False
    torque = np.abs(finding["curve"]["torque"])
    return int(np.sum(torque > CURVE_LEVEL * torque.max(initial=0.0))) >= CURVE_POINTS


# -- next experiment -------------------------------------------------------------------------------


def _next_section(
    diagnosis: Diagnosis, document: Document, budgets: Sequence[JointBudget]
) -> Section:
    """Experiments that separate or confirm effects."""
    actions = verdict.next_actions(document, budgets)
    lines = [action.line for group in actions for action in group]
    answer = "Nothing; other speeds, loads or temperatures may show more."
    if "doubts" in document:
        answer = "Resolve the doubts about the recordings named at the top of this page."
    elif lines:
        answer = "Motions that decide what these recordings leave open."
    elif document["findings"]:
        answer = "Nothing must be decided: every finding is sure, and no other effect resembles it."
    if diagnosis.noise.method != "periods":
        lines.append(
            "Repeat the same period a few times in one recording: the difference between periods "
            "is noise, and the noise floor becomes known."
        )
    return Section("next", "What to record next?", answer, {"lines": lines})


# -- considered, provenance ------------------------------------------------------------------------


def _considered_section(diagnosis: Diagnosis, document: Document) -> Section:
    """Effects that are not reported, and those that these recordings could not show."""
    rows = [
        (
            effect_words(entry["effect"]),
            entry["joint"] or "whole robot",
            probability_words(entry["probability"]),
            f"{entry['reason']}{', yet in the saved model' if entry['modelled'] else ''}",
        )
        for entry in document["considered"]
    ]
    wanted = () if diagnosis.identified.options.trusted else EFFECTS
    absorbed = [effect_words(effect.name) for effect in wanted if effect.prior_only]
    data = {
        "table": Table(
            ("effect", "joint", "probability", "why it is no finding"),
            rows,
            (2,),
        ),
        "absorbed": listed(absorbed) if absorbed else "",
    }
    verb = "is" if len(rows) == 1 else "are"
    answer = (
        f"{plural(len(rows), 'effect')} had some evidence but {verb} no finding, which needs a "
        f"probability of {MIN_PROBABILITY:g} and a place in the model."
    )
    if not rows:
        answer = "No other effect had evidence."
    return Section("considered", "What else was considered?", answer, data)


def _provenance_section(diagnosis: Diagnosis, remarks: RemarksByRecording) -> Section:
    """Data, method and versions."""
    robot, trusted = diagnosis.identified.model.robot, diagnosis.identified.options.trusted
    fitted = sources(diagnosis.model.motions)
    held_out = sources(diagnosis.held_out.motions)
    answer = (
        f"Base model and effects were fitted jointly to {plural(len(fitted), 'recording')}; "
        f"{plural(len(held_out), 'other recording')} served only to measure the error; "
        f"{count_remarks(remarks)}."
    )
    facts = {
        "robot": f"{robot.name} ({robot.source}), SHA-256 {robot.sha256}",
        "fitted to": ", ".join(fitted),
        "held out": ", ".join(held_out),
        "band": f"below {number(diagnosis.hertz)} Hz",
        "parameters fixed by --prior": str(len(trusted)),
        "noise floor": _NOISE_FLOORS.get(diagnosis.noise.method, diagnosis.noise.method),
        "versions": ", ".join(f"{k} {v}" for k, v in package_versions().items()),
    }
    table = Table(("quantity", "value"), list(facts.items()))
    data = {"facts": table, "remarks": list_remarks(remarks)}
    return Section("made", "How was it made?", answer, data)
