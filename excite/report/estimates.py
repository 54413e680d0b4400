"""What the parameters became: base parameters, drives, directions and who decided them, bodies."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..identification import consistency, estimators
from ..identification.identification import Identification
from ..identification.identified_model import JOINT_PARAMETER_UNITS, base_parameter_table
from ..robot.parameter_names import percent, spoken
from .figures import inertia_ellipsoids, information_spectrum
from .figures import parameters as parameters_module
from .figures.inertia_ellipsoids import Body, Change
from .figures.parameters import Moved
from .figures.trajectory import is_prismatic
from .identifiability import without_verdict as bare
from .page import Section, bullets, escape, figure, folded, number, paragraph, plural, table

Array = np.ndarray
_SHOWN = 8
_NOTICED = 0.05
"""Distance of two bodies from which on one speaks of a change: a mass by 7 %."""
_KINDS = {
    "rotor_inertia": "rotor inertia",
    "viscous": "viscous friction",
    "coulomb": "Coulomb friction",
    "offset": "offset",
}


def parameters_section(found: Identification) -> Section:
    """What were the parameters, what are they now?"""
    parameters, base = found.model.parameters, found.model.base
    entries = base_parameter_table(found)
    scale = np.sqrt(found.metric.norms(base.matrix))
    edge = 10 * parameters.bodies
    moved = [
        _moved(e, s, bool(place < edge))
        for e, s, place in zip(entries, scale, base.independent, strict=True)
    ]
    body = figure(parameters_module.changes(moved))
    body += paragraph(
        "One scale for all: 100 % is what a change by the whole of the robot's own masses, lengths and friction amounts to in that "
        "parameter (the metric's unit); a drive's parameter that the URDF does not state may go from 0 to 100 %. Bars that run out of the "
        "picture, with pale names: the recording does not show that parameter alone. Intervals: of the data alone, 95 %, for noise of the "
        "colour found.",
        "note",
    )
    rows = [_row(e, parameters) for e in entries]
    head = ("name", "named after", "nominal", "by the data", "± (95 %)", "identified", "stands for")
    body += folded(
        "All base parameters [SI]", table(head, rows, (2, 3, 4, 5)), unfolded=len(rows) <= 14
    )
    if parameters.drive:
        body += "<h3>Friction and rotor inertia of each joint: nominal → identified</h3>" + _drives(
            found
        )
    return Section(
        "parameters",
        "What were the parameters, what are they now?",
        _parameters_answer(found, entries, moved),
        body,
    )


def _moved(entry: dict[str, Any], scale: float, body: bool) -> Moved:
    nominal, scale = entry["nominal"], max(float(scale), 1e-300)
    data = None if entry["data"] is None else (entry["data"] - nominal) / scale
    half = (
        np.inf
        if entry["interval"] is None
        else 0.5 * (entry["interval"][1] - entry["interval"][0]) / scale
    )
    return Moved(entry["name"], data, float(half), (entry["value"] - nominal) / scale, body)


def _parameters_answer(
    found: Identification, entries: list[dict[str, Any]], moved: list[Moved]
) -> str:
    sure = [k for k, m in enumerate(moved) if m.data is not None and abs(m.data) > m.half]
    answer = f"{len(sure)} of {plural(len(moved), 'base parameter')} differ from the nominal robot beyond their 95 % interval"
    if not sure:
        return answer + "."
    most = max(sure, key=lambda k: (moved[k].body, abs(moved[k].value)))
    name = spoken(entries[most]["name"], found.model.parameters)
    grouped = (
        "" if entries[most]["expression"] == entries[most]["name"] else " (with what moves with it)"
    )
    which = "of the bodies' furthest went" if moved[most].body else "furthest went"
    return f"{answer}; {which} {name}{grouped}, from {number(entries[most]['nominal'], 3)} to {number(entries[most]['value'], 3)}."


def _row(entry: dict[str, Any], parameters: Any) -> tuple[str, ...]:
    interval = entry["interval"]
    return (
        f"<code>{escape(entry['name'])}</code>",
        escape(spoken(entry["name"], parameters)),
        number(entry["nominal"]),
        number(entry["data"]),
        "not shown" if interval is None else number(0.5 * (interval[1] - interval[0]), 2),
        f"<b>{number(entry['value'])}</b>",
        f"<code>{escape(entry['expression'])}</code>",
    )


def _drives(found: Identification) -> str:
    """Drive parameters of every joint with what data and prior together leave open."""
    robot, parameters = found.model.robot, found.model.parameters
    half = estimators.student_quantile(found.data.degrees_of_freedom) * np.sqrt(
        np.maximum(np.diag(found.posterior.covariance), 0.0)
    )
    scale = np.diag(found.metric.scale)
    rows = []
    for j, joint in enumerate(robot.joints):
        cells = [escape(joint)]
        for kind in parameters.drive:
            k = parameters.block(kind).start + j
            vague = half[k] > 2.0 * scale[k]
            open_ = '<span class="warn">not shown</span>' if vague else f"± {number(half[k], 2)}"
            cells.append(
                f"{number(parameters.nominal[k], 3)} → <b>{number(found.psi[k], 3)}</b> {open_}"
            )
        rows.append(cells)
    sliding = is_prismatic(robot)
    told = robot.entries[0].unit if all(sliding) else str
    head = [
        "joint",
        *(f"{_KINDS[kind]} [{told(JOINT_PARAMETER_UNITS[kind])}]" for kind in parameters.drive),
    ]
    text = "± is 95 % of what data and prior together leave open. 'Not shown': neither narrows the value down, "
    text += "though its sum with others may be known."
    if any(sliding) and not all(sliding):
        text += " Of sliding joints: kg, N s/m and N."
    return table(head, rows) + paragraph(text, "note")


# -- directions ----------------------------------------------------------------------------------------------


def directions_section(found: Identification) -> Section:
    """Which directions did the recording show, which did the prior decide?"""
    analysis, shares = found.analysis, found.data_shares()
    count, ours = len(shares), int(np.sum(shares > 0.5))
    sharp = percent(float(np.sqrt(analysis.threshold)))
    answer = f"The recording identifies {analysis.identifiable_count} of {plural(count, 'direction')} to ±{sharp} or better; "
    answer += f"of all, the data decided {ours}, the prior {'none' if ours == count else f'the other {count - ours}'}."
    body = figure(information_spectrum.draw_spectrum(analysis)) + figure(
        parameters_module.decided(shares)
    )
    body += paragraph(
        "Upper plot: variance of independent combinations of parameters by the data alone, scale-free. Lower plot, same order: λ/(λ + 2γ), "
        "how far the identified value lies towards what the data say rather than where the nominal robot is. A weak direction that "
        "the data decided is as uncertain as the upper plot says; one that the prior decided is as good as the URDF.",
        "note",
    )
    weak = [(d, s) for d, s in zip(analysis.directions, shares, strict=True) if not d.identifiable]
    if weak:
        lines = [
            f"{bare(d.words)}; decided by the {'data' if s > 0.5 else 'prior'} ({100 * s:.0f} % data)"
            for d, s in weak[::-1]
        ]
        body += "<h3>The worst directions, the worst first</h3>" + bullets(lines[:_SHOWN])
        if len(lines) > _SHOWN:
            body += folded(
                f"{len(lines) - _SHOWN} more that are not identified", bullets(lines[_SHOWN:])
            )
    body += "<h3>Links and joints</h3>" + figure(
        information_spectrum.draw_shares(analysis.links, analysis.joints)
    )
    return Section(
        "directions",
        "Which directions did the recording show, which did the prior decide?",
        answer,
        body,
    )


# -- bodies --------------------------------------------------------------------------------------------------


def body_changes(found: Identification) -> list[Change]:
    """Each link's body as the nominal robot has it and as identified."""
    parameters = found.model.parameters
    before, after = (
        consistency.inertial_rows(parameters, psi)
        for psi in (consistency.consistent_nominal(parameters), found.psi)
    )
    shown = {s.name: s.identifiable_share for s in found.analysis.links}
    return [
        Change(link, Body(a), Body(b), shown.get(link))
        for link, a, b in zip(parameters.links, before, after, strict=True)
    ]


def bodies_section(found: Identification) -> Section:
    """How did each link's body change?"""
    changes = body_changes(found)
    most = max(changes, key=lambda c: c.distance)
    noticed = sum(c.distance > _NOTICED for c in changes)
    if most.distance <= _NOTICED:
        size = f"by {most.distance:.2f}" if most.distance >= 0.01 else "by less than 0.01"
        answer = f"Hardly: {most.link} changed most, {size} in the metric (a mass by 10 % is 0.07)."
    else:
        answer = f"{noticed} of {'1 body' if len(changes) == 1 else f'{len(changes)} bodies'} changed noticeably, {most.link} most: "
        answer += f"{number(most.before.mass, 3)} → {number(most.after.mass, 3)} kg, its centre of mass by {1e3 * most.shift:.0f}\u00a0mm"
        answer += (
            "."
            if most.share is None
            else f"; the recording shows {100.0 * most.share:.0f} % of what torque can tell of it."
        )
    rows = [
        (
            escape(c.link),
            f"{number(c.before.mass, 3)} → <b>{number(c.after.mass, 3)}</b>",
            f"{1e3 * c.shift:.1f}",
            f"{_axes(c.before)} → <b>{_axes(c.after)}</b>",
            f"{c.distance:.2f}",
            "–" if c.share is None else f"{100.0 * c.share:.0f} %",
        )
        for c in changes
    ]
    head = ("link", "mass [kg]", "centre moved [mm]", "half axes [mm]", "distance", "shown")
    note = (
        "Solid ellipsoids of uniform density with the link's mass, centre of mass and inertia, in the frame of the joint that moves it, "
        "links fixed to it included. Distance: affine-invariant; a mass by 10 % is 0.07. Shown: of what torque can tell of the link, which "
        "is never all of it, the part that the recording does. Where that is small the prior drew the body, and a change may belong to a "
        "neighbour."
    )
    if found.model.parameters.repaired:
        note += f" No proper body in the URDF: {', '.join(found.model.parameters.repaired)}; a small substitute is drawn as nominal."
    body = (
        figure(inertia_ellipsoids.ellipsoids(changes))
        + table(head, rows, (1, 2, 3, 4, 5))
        + paragraph(note, "note")
    )
    return Section("bodies", "How did each link's body change?", answer, body)


def _axes(body: Body) -> str:
    digits = 0 if body.half_axes[0] >= 0.02 else 1
    return " × ".join(f"{1e3 * v:.{digits}f}" for v in body.half_axes)
