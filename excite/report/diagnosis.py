"""The report of a diagnosis: is anything missing, what is it, where does it show, and how do we know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..diagnosis import residual_atlas as atlas
from ..diagnosis.diagnosis import QUIET, Diagnosis
from ..diagnosis.isolability import ALIKE, EffectAtJoint, isolability
from ..diagnosis.residual_atlas import SIGNIFICANT, Atlas
from ..effects import EFFECTS, EFFECTS_BY_NAME
from ..recordings import Remark
from ..robot.parameter_names import listed, percent, some
from ..trajectory.trajectory_file import package_versions
from . import changes, diagnosis_tables, gears, unnamed
from . import remarks as remarked
from .figures import diagnosis as diagnosis_module
from .figures import residual_atlas as atlas_figures
from .figures.diagnosis import told
from .figures.torque_fit import EXCERPT, drawn_points
from .figures.trajectory import torque_units
from .page import (
    Section,
    banner,
    bullets,
    cards,
    escape,
    figure,
    folded,
    meter,
    number,
    page,
    paragraph,
    plural,
    table,
)

Array = np.ndarray
Stated = Mapping[str, Any]
_UNFOLDED = 3
_WORTH = 0.2
"""Probability from which a name that is not asserted is worth a word."""
_SIZES = {
    "amplitude", "exponent", "frequency", "gain", "loss", "mass", "mu", "order", "stiffness", "time_constant", "velocity", "width",
}  # fmt: skip
_SIGNED = {("spring", "stiffness")}
"""Parameters that are never negative; but a spring may push away."""
_VERDICTS = {
    "no-mismatch": ("Nothing that these recordings could show is missing from the model.", "good"),
    "explained": ("Something was missing, and the findings explain it down to the noise.", "good"),
    "partly-explained": ("Something is missing; the findings explain part of it.", "warn"),
    "unexplained": ("Something is missing, and no effect of the catalogue takes it.", "bad"),
}
_FLOORS = {
    "periods": "what differs between repeated periods",
    "differences": "the torque's spectrum above the motion, taken to be white below: no period was recorded twice, so it may be too low",
}


def diagnosis_page(
    found: Diagnosis, stated: Stated, looked: Atlas, remarks: Sequence[Remark] = ()
) -> str:
    """The report of `excite diagnose` as HTML.

    stated: the document of the diagnosis, `diagnose.document.document`. looked: its atlas, `diagnose.atlas.look`. remarks: what the
    health check of all recordings found.
    """
    sections = [
        _missing(found, stated),
        *changes.section(found, stated),
        _what(found, stated),
        _where(found, looked),
        _better(found, stated),
        *gears.section(found, stated),
        _apart(found, stated),
        _next(found, stated),
        _made(found, looked, remarks),
    ]
    lede = "What the robot's model leaves out: where it shows, what it is, how large it is, and how we know."
    robot = found.identified.model.robot
    return page(
        f"Diagnosis of {robot.name}",
        lede,
        _head(found, stated),
        sections,
        f"excite {package_versions()['excite']}",
    )


def _head(found: Diagnosis, stated: Stated) -> str:
    text, tone = _VERDICTS[stated["verdict"]]
    if changes.all_that_is(stated):
        found_all = (
            "The findings explain what is missing from the model"
            if stated["findings"]
            else "Nothing is missing from the model"
        )
        text, tone = f"{found_all}, but the robot's drives differ between the recordings.", "warn"
    ratio = found.after / found.floor
    relative = [
        float(np.max(x / np.maximum(found.torque, 1e-300))) for x in (found.before, found.after)
    ]
    change = (
        f"{percent(relative[0])} → {percent(relative[1])}"
        if stated["findings"]
        else percent(relative[0])
    )
    entries = [
        (stated["verdict"], "verdict"),
        (str(len(stated["findings"])), "finding" if len(stated["findings"]) == 1 else "findings"),
        (change, "held-out error over RMS torque, worst joint"),
        (f"{number(float(ratio.max()), 3)}", "noise floors, worst joint, after"),
        (f"{len(stated['unknown'])} of {len(found.floor)}", "joints with something unknown"),
    ]
    return cards(entries) + banner(text, tone)


def _place(joint: str | None) -> str:
    return joint or "the whole robot"


def _named(effect: str, joint: str | None) -> str:
    """'stribeck at joint_2'."""
    return f"{told(effect)} at {joint}" if joint else f"{told(effect)} of the whole robot"


# -- is anything missing ---------------------------------------------------------------------------------------------


def _missing(found: Diagnosis, stated: Stated) -> Section:
    joints = stated["joints"]
    loud = [j for j, v in joints.items() if v["rmse_before"] > QUIET * v["noise_floor"]]
    if not loud:
        answer = f"No: on what was held out every joint's residual is within {QUIET:g} noise floors of the base model."
    else:
        worst = max(loud, key=lambda j: joints[j]["rmse_before"] / joints[j]["noise_floor"])
        ratio = number(joints[worst]["rmse_before"] / joints[worst]["noise_floor"], 3)
        answer = f"{'Yes' if stated['findings'] or stated['unknown'] else 'Hardly'}: the base model leaves more than noise in "
        answer += f"{some(loud)}, the most in {worst}: {ratio} noise floors, {percent(joints[worst]['systematic_share'])} of its power."
    rows = []
    for joint, v in joints.items():
        ratio_before, ratio_after = (
            v["rmse_before"] / v["noise_floor"],
            v["rmse_after"] / v["noise_floor"],
        )
        after = (
            f"{meter(v['unexplained_share'])} {escape(percent(v['unexplained_share']))}"
            if stated["findings"]
            else "–"
        )
        rows.append(
            (
                escape(joint),
                f"{meter(v['systematic_share'])} {escape(percent(v['systematic_share']))}",
                number(ratio_before, 3),
                after,
                number(ratio_after, 3) if stated["findings"] else "–",
            )
        )
    head = (
        "joint",
        "systematic share, base model",
        "noise floors",
        "unexplained with the findings",
        "noise floors",
    )
    body = table(head, rows, (2, 4))
    body += paragraph(
        f"The noise floor is {_FLOORS.get(found.method, found.method)}. Systematic: 1 − (floor / RMSE)².",
        "note",
    )
    return Section("missing", "Is anything missing?", answer, body, _VERDICTS[stated["verdict"]][1])


# -- what ------------------------------------------------------------------------------------------------------------


def _what(found: Diagnosis, stated: Stated) -> Section:
    findings = stated["findings"]
    if findings:
        named = [
            f"{_named(f['effect'], f['joint'])} (probability {number(f['probability'], 2)})"
            for f in findings
        ]
        answer = listed(named)
        answer = answer[0].upper() + answer[1:] + "."
    elif changes.all_that_is(stated):
        joints = some([u["joint"] for u in stated["unknown"]])
        answer = f"No law is missing: friction or offset of {joints} is another in the recordings held out."
    elif stated["unknown"]:
        verb = "shows" if len(stated["unknown"]) == 1 else "show"
        answer = f"Not known: {some([u['joint'] for u in stated['unknown']])} {verb} torque that no name predicts."
    else:
        answer = "Nothing is asserted: no effect of the catalogue predicts what was held out better than the base model by enough."
    doubted = max(stated["considered"], key=lambda one: float(one["probability"]), default=None)
    if not findings and doubted and doubted["probability"] > _WORTH:
        answer += f" The likeliest, {_named(doubted['effect'], doubted['joint'])}, has probability {number(doubted['probability'], 2)}."
    body = "".join(_finding(one) for one in findings)
    body += "".join(_refuted(one) for one in stated["considered"] if "foretold" in one["evidence"])
    if stated["unknown"]:
        body += "<h3>Left without a name</h3>"
        body += unnamed.told(found, stated)
    if findings or stated["considered"]:
        body += "<h3>What else was considered</h3>" + figure(diagnosis_module.bars(stated))
        note = "Blue: asserted. An effect that gains much alone may be another one's shadow: it counts only if it gains beside the others."
        body += paragraph(note, "note")
        body += folded("The same as a table", _considered(stated["considered"]))
    return Section(
        "what",
        "What is it?",
        answer,
        body,
        "" if findings else "warn" if stated["unknown"] else "good",
    )


def _finding(one: Stated) -> str:
    effect = EFFECTS_BY_NAME[one["effect"]]
    source = f" (from {one['from']})" if one.get("from") else ""
    body = f"<h3>{escape(told(one['effect']))}: {escape(_place(one['joint']))}{escape(source)}</h3>"
    signature = effect.signature
    body += paragraph(f"{effect.source}. {signature[0].upper()}{signature[1:]}.", "lede")
    rows = [
        (
            escape(key.replace("_", " ")),
            number(v["value"]),
            "± " + number(v["std"], 2) if v["std"] is not None else "–",
            _interval(v, key in _SIZES and (one["effect"], key) not in _SIGNED),
            escape(v["unit"]),
        )
        for key, v in one["parameters"].items()
    ]
    body += table(
        ("parameter", "value", "standard error", "95 % interval", "unit"), rows, (1, 2, 3)
    )
    facts = [
        f"Probability {number(one['probability'], 2)} that it is this"
        + (
            f" or {listed([told(e) for e in one['equivalents']])}, which these recordings cannot tell from it."
            if one["equivalents"]
            else "."
        )
    ]
    if "not_shown" in one:
        facts.append(
            f"No joint feels its {listed([name.replace('_', ' ') for name in one['not_shown']])} in these recordings."
        )
    time = one["where"]["time"]
    if time is not None:
        facts.append(
            f"Only from {number(time[0])} to {number(time[1])} s of {Path(one['where']['recording']).name}."
        )
    facts.append(f"What would tell it from others ({listed([told(c) for c in effect.are_confusable])}): {one['experiment']}."
                 if effect.are_confusable else f"What would confirm it: {one['experiment']}.")  # fmt: skip
    return body + bullets(facts)


def _refuted(one: Stated) -> str:
    """Of a name that the recordings fitted suggest and those held out speak against."""
    name, times = (
        _named(one["effect"], one["joint"]),
        number(float(np.sqrt(one["evidence"]["foretold"])), 2),
    )
    return paragraph(
        f"Refuted: {name}. What is learnt of it from some recordings makes what is left of the others {times} times as large.",
        "note",
    )


def _interval(v: Stated, size: bool) -> str:
    """size: whether it is never below zero, which is where its interval ends."""
    std = v["std"]
    if std is None or not np.isfinite(std):
        return "–"
    if std < 1e-6 * abs(v["value"]):
        return "on a grid"
    low, high = v["value"] - 1.96 * std, v["value"] + 1.96 * std
    return f"{number(max(low, 0.0) if size else low, 3)} … {number(high, 3)}"


def _considered(considered: Sequence[Stated]) -> str:
    rows = [
        (
            escape(told(c["effect"])),
            escape(_place(c["joint"])),
            number(c["probability"], 2) if c["probability"] else "–",
            number(c["evidence"]["held_out_gain"]),
            number(c["evidence"]["severity"], 3),
            escape(
                ", ".join(
                    f"{k} {number(v['value'], 3)} {v['unit']}" for k, v in c["parameters"].items()
                )
            ),
        )
        for c in considered
    ]
    return table(
        ("effect", "joint", "probability", "held-out gain", "severity", "parameters, alone"),
        rows,
        (2, 3, 4),
    )


# -- where -----------------------------------------------------------------------------------------------------------


def _where(found: Diagnosis, looked: Atlas) -> Section:
    robot, changed = found.identified.model.robot, bool(found.verdict.chosen)
    shown = looked.shown
    if not looked.panels:
        return Section(
            "where",
            "Where does it show?",
            "Nowhere that could be looked at: no joint moves.",
            "",
            "warn",
        )
    if shown:
        first = shown[0]
        gone = sum(p.p_after >= SIGNIFICANT for p in shown)
        answer = f"The clearest is {robot.joints[first.joint]} against {first.against}, which shows {percent(first.share_before)} of its "
        answer += f"residual; {plural(len(shown), 'curve')} of {len(looked.panels)} {'is' if len(shown) == 1 else 'are'} not noise"
        answer += (
            f"; with the findings {gone} of them {'is' if gone == 1 else 'are'}."
            if changed
            else "."
        )
    else:
        answer = f"Nowhere: none of {plural(len(looked.panels), 'curve')} of the held-out residual differs from noise."
    body = figure(atlas_figures.draw_overview(looked, robot.joints))
    body += paragraph(
        f"Shade: share of the joint's held-out residual that repeats with it; blank: may be noise (p ≥ {SIGNIFICANT:g} with every look "
        "counted). "
        + ("Orange dot: still there with the findings. " if changed else "")
        + "One cause shows in many columns: the motion ties them together. "
        "Along the motion: positive brakes, as friction does.",
        "note",
    )
    units = torque_units(robot)
    loud = sorted(
        {p.joint for p in shown}, key=lambda j: -max(p.score_before for p in shown if p.joint == j)
    )
    rest = [j for j in range(robot.n) if j not in loud and looked.of(j)]
    named = {h.joint for h in found.verdict.chosen if h.joint is not None}
    first_joints = sorted(loud, key=lambda j: j not in named)[
        : max(_UNFOLDED, len(named & set(loud)))
    ]
    pictures = {
        j: f"<h3>{escape(robot.joints[j])}</h3>"
        + figure(
            atlas_figures.draw_joint(
                looked.of(j), robot.joints[j], units[j], float(found.floor[j]), has_findings=changed
            )
        )
        for j in [*loud, *rest]
    }
    body += "".join(pictures[j] for j in first_joints)
    others = [j for j in pictures if j not in first_joints]
    if others:
        body += folded(
            "The other joint" if len(others) == 1 else f"The other {len(others)} joints",
            "".join(pictures[j] for j in others),
        )
    return Section("where", "Where does it show?", answer, body)


# -- does it predict -------------------------------------------------------------------------------------------------


def _better(found: Diagnosis, stated: Stated) -> Section:
    robot, question = found.identified.model.robot, "Does the model with it predict better?"
    shown = list(diagnosis_module.predictions(found))
    points = drawn_points(shown, robot.n)
    gain = 1.0 - found.after / found.before
    best, worst = int(np.argmax(gain)), int(np.argmin(gain))
    if not found.verdict.chosen:
        answer, tone = (
            "There is nothing to compare: no finding joined the base model, whose error is shown.",
            "",
        )
    else:
        answer = f"{'Yes' if gain[best] > 0.02 else 'No'}: held out, {robot.joints[best]}'s RMSE falls by {percent(max(gain[best], 0.0))}, "
        answer += f"to {number(found.after[best], 3)} {torque_units(robot)[best]}"
        answer += (
            f"; {robot.joints[worst]}'s rises by {percent(-gain[worst])}."
            if gain[worst] < -0.005
            else "; no joint gets worse."
        )
        tone = "good" if gain[best] > 0.02 and gain[worst] >= -0.005 else "warn"
    body = diagnosis_tables.errors(found, stated) + diagnosis_tables.ahead(stated, robot)
    parts = [
        f"<h3>{escape(one.source)}</h3>" + figure(diagnosis_module.traces(one, found, points))
        for one in shown
    ]
    body += "".join(parts[:2])
    if len(parts) > 2:
        body += folded(plural(len(parts) - 2, "more recording"), "".join(parts[2:]))
    note = f"Torque below {number(stated['band_hz'], 3)} Hz, the same filter on both sides; base model and findings fitted to the other "
    note += "recordings. "
    if not found.moving.all():
        note += "Where a joint stands still nothing is predicted or judged: static friction is whatever holds it. "
    if any(one.time[-1] - one.time[0] > EXCERPT for one in shown):
        note += f"Of recordings longer than {EXCERPT:g} s the stretch around the largest error is drawn; the table is of all of it."
    return Section("better", question, answer, body + paragraph(note.strip(), "note"), tone)


# -- what cannot be told apart ---------------------------------------------------------------------------------------


def _apart(found: Diagnosis, stated: Stated) -> Section:
    robot, one = found.identified.model.robot, isolability(found.design)
    pairs = one.pairs()

    def said(c: EffectAtJoint) -> str:
        return _named(c.effect, None if c.joint is None else robot.joints[c.joint])

    tested = {c.effect for c in one.candidates}
    wanted = [e.name for e in EFFECTS if not found.options.names or e.name in found.options.names]
    absorbed = [
        n for n in wanted if n not in tested and EFFECTS_BY_NAME[n].prior_only and not found.options.trusted
    ]
    silent = [n for n in wanted if n not in tested and n not in absorbed]
    if pairs:
        answer = f"{plural(len(pairs), 'pair')} of {len(one.candidates)} effects and joints, above all {said(pairs[0][0])} and "
        answer += f"{said(pairs[0][1])} (canonical correlation {number(pairs[0][2], 2)})."
    else:
        answer = (
            f"No pair of {len(one.candidates)} effects and joints is more alike than {ALIKE:g}."
        )
    body = ""
    if absorbed:
        words = listed([told(n) for n in absorbed])
        body += banner(
            f"Refitting the base model takes these up whole; only a trusted prior (--prior) would show them: {words}.",
            "warn",
        )
    if silent:
        body += paragraph(f"This motion says nothing about: {listed([told(n) for n in silent])}.")
    if pairs:
        body += bullets(f"{said(a)} and {said(b)}: {number(value, 3)}" for a, b, value in pairs[:8])
    named = [h.joint for h in found.verdict.chosen if h.joint is not None]
    order = list(dict.fromkeys([*named, *np.argsort(-found.before / found.floor).tolist()]))
    pictures = [
        f"<h3>{escape(robot.joints[j])}</h3>"
        + figure(diagnosis_module.alike(one, j, robot.joints[j]))
        for j in order
        if len(one.of(j)) > 1
    ]
    body += "".join(pictures[:1])
    if pictures[1:]:
        body += folded(f"The other {plural(len(pictures) - 1, 'joint')}", "".join(pictures[1:]))
    note = "Largest canonical correlation between the torques of two effects, each in the shape that fits best, once the base model is "
    note += "refit: at 1 no data of this motion can tell them apart; it says nothing about whether either is there."
    return Section(
        "apart",
        "What cannot be told apart by these recordings?",
        answer,
        body + paragraph(note, "note"),
    )


# -- what next, how --------------------------------------------------------------------------------------------------


def _next(found: Diagnosis, stated: Stated) -> Section:
    lines = []
    for one in stated["findings"]:
        for name in one["equivalents"]:
            told_apart = (
                f"To tell {told(one['effect'])} from {told(name)} at {_place(one['joint'])}: "
            )
            lines.append(told_apart + f"{one['experiment']}; and {EFFECTS_BY_NAME[name].experiment}.")
        if not one["equivalents"]:
            lines.append(f"To pin down {_named(one['effect'], one['joint'])}: {one['experiment']}.")
    lines += [
        f"For what has no name in {one['joint']}: {one['experiment']}." for one in stated["unknown"]
    ]
    if found.method != "periods":
        lines.append(
            "Repeat the same period a few times in one recording: what differs between periods is noise, and the floor becomes known."
        )
    if lines:
        answer = "Record " + (
            "what would decide between the names that are left"
            if stated["findings"]
            else "a motion that isolates it"
        )
        answer += ", in the order below."
    else:
        answer = "Nothing needs to be recorded for these joints and this band; other speeds, loads or temperatures may show more."
    return Section("next", "What to do next?", answer, bullets(lines) if lines else "")


def _made(found: Diagnosis, looked: Atlas, remarks: Sequence[Remark]) -> Section:
    identified, robot = found.identified, found.identified.model.robot
    sources = [list(dict.fromkeys(t.segment.source for t in half)) for half in found.motions]
    answer = f"{plural(len(found.design.shapes), 'shape')} of {len(EFFECTS)} effects, alone and together, each refit with the base model on "
    answer += f"{plural(len(sources[0]), 'recording')} and judged on {plural(len(sources[1]), 'other recording')}; "
    answer += f"{remarked.said(remarks)}."
    facts = {
        "robot": f"{robot.name} ({robot.source})",
        "SHA-256 of the URDF": robot.sha256,
        "fitted to": ", ".join(sources[0]),
        "held out": ", ".join(sources[1]),
        "rows": f"{sum(map(len, found.motions[0]))} fitted, {sum(map(len, found.motions[1]))} held out, × {plural(robot.n, 'joint')}",
        "band": f"{number(found.hertz)} Hz",
        "base model": f"{identified.model.base.count} parameters, "
        + (
            f"{plural(len(found.options.trusted), 'value')} held fast by --prior"
            if found.options.trusted
            else "all refit"
        ),
        "noise floor": _FLOORS.get(found.method, found.method),
        "p-values": f"{atlas.DRAWS} nulls by random signs of {looked.blocks} blocks; the largest of {len(looked.panels)} counts",
        "versions": ", ".join(f"{k} {v}" for k, v in package_versions().items()),
    }
    body = table(
        ("what", "value"), [(escape(k), escape(v)) for k, v in facts.items()]
    ) + remarked.listed(remarks)
    return Section("made", "How was it made?", answer, body)
