"""Sections on the identified parameters: base parameters, directions and link inertias."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from ..identification import consistency, estimators
from ..identification.identification import Identification
from ..identification.identified_model import JOINT_PARAMETER_UNITS, base_parameter_table
from ..identification.link_estimates import link_estimates
from ..robot.inertial_parameters import Parameters
from ..robot.parameter_names import DRIVE_WORDS, percent, plural, spoken
from .content import Section, Table, TableCell
from .figures import inertia_ellipsoids, information_spectrum
from .figures import parameters as parameter_figures
from .figures.inertia_ellipsoids import LinkBody, LinkBodyChange
from .figures.parameters import ParameterChange
from .figures.trajectory import is_prismatic
from .formatting import number
from .identifiability import UNFOLDED_PARAMETERS, without_verdict

LISTED_DIRECTIONS = 8
"""Directions that are listed before the others are folded."""
NOTABLE_DISTANCE = 0.05
"""Distance of two inertias from which a change is notable: a mass by 7 %."""
SMALLEST_DISTANCE = 0.01
"""Distances below this are not stated as numbers."""


# -- base parameters -------------------------------------------------------------------------------


def parameters_section(identification: Identification) -> Section:
    """Build the section on base parameters, nominal and identified."""
    model = identification.model
    parameters, base = model.parameters, model.base
    entries = base_parameter_table(parameters, base, identification.data, identification.psi)
    scale = np.sqrt(identification.metric.norms(base.matrix))
    drive_start = 10 * parameters.bodies
    changes = [
        _parameter_change(entry, float(size), bool(index < drive_start))
        for entry, size, index in zip(entries, scale, base.independent, strict=True)
    ]
    head = ("name", "named after", "nominal", "by the data", "± (95 %)", "identified", "expression")
    rows = [_parameter_row(entry, parameters) for entry in entries]
    sliding = is_prismatic(model.robot)
    data = {
        "figure": Markup(parameter_figures.draw_changes(changes)),
        "table": Table(head, rows, (2, 3, 4, 5)),
        "open": len(rows) <= UNFOLDED_PARAMETERS,
        "drives": _drive_table(identification) if parameters.drive else None,
        "has_mixed_joints": any(sliding) and not all(sliding),
    }
    answer = _parameters_answer(identification, entries, changes)
    return Section("parameters", "How did the base parameters change?", answer, data)


def _parameter_change(entry: Mapping[str, Any], scale: float, is_inertial: bool) -> ParameterChange:
    """Change of a base parameter in units of its scale."""
    nominal, scale = entry["nominal"], max(scale, 1e-300)
    interval = entry["interval"]
    return ParameterChange(
        name=entry["name"],
        data=None if entry["data"] is None else (entry["data"] - nominal) / scale,
        half_width=np.inf if interval is None else 0.5 * (interval[1] - interval[0]) / scale,
        value=(entry["value"] - nominal) / scale,
        is_inertial=is_inertial,
    )


def _parameters_answer(
    identification: Identification,
    entries: Sequence[Mapping[str, Any]],
    changes: Sequence[ParameterChange],
) -> str:
    """Number of significant changes, and the largest."""
    significant = [
        k for k, c in enumerate(changes) if c.data is not None and abs(c.data) > c.half_width
    ]
    answer = (
        f"{len(significant)} of {plural(len(changes), 'base parameter')} differ from the nominal "
        "robot beyond their 95 % interval"
    )
    if not significant:
        return answer + "."
    largest = max(significant, key=lambda k: (changes[k].is_inertial, abs(changes[k].value)))
    entry = entries[largest]
    name = spoken(entry["name"], identification.model.parameters)
    grouped = "" if entry["expression"] == entry["name"] else " (with the terms grouped with it)"
    kind = " of an inertial parameter" if changes[largest].is_inertial else ""
    values = f"{number(entry['nominal'], 3)} to {number(entry['value'], 3)}"
    return f"{answer}; the largest change{kind} is {name}{grouped}, from {values}."


def _parameter_row(entry: Mapping[str, Any], parameters: Parameters) -> tuple[str | TableCell, ...]:
    """Row of the table of base parameters."""
    interval = entry["interval"]
    return (
        TableCell(entry["name"], code=True),
        spoken(entry["name"], parameters),
        number(entry["nominal"]),
        number(entry["data"]),
        "not shown" if interval is None else number(0.5 * (interval[1] - interval[0]), 2),
        TableCell(number(entry["value"]), bold=True),
        TableCell(entry["expression"], code=True),
    )


def _drive_table(identification: Identification) -> Table:
    """Friction, rotor inertia and offset of every joint with their 95 % intervals."""
    robot, parameters = identification.model.robot, identification.model.parameters
    variance = np.maximum(np.diag(identification.posterior.covariance), 0.0)
    quantile = estimators.student_quantile(identification.data.degrees_of_freedom)
    half = quantile * np.sqrt(variance)
    scale = np.diag(identification.metric.scale)
    rows = []
    for j, joint in enumerate(robot.joints):
        cells: list[str | TableCell] = [joint]
        for kind in parameters.drive:
            k = parameters.block(kind).start + j
            is_open = half[k] > 2.0 * scale[k]
            cells.append(
                TableCell(
                    number(identification.psi[k], 3),
                    bold=True,
                    before=f"{number(parameters.nominal[k], 3)} → ",
                    after="not shown" if is_open else f"± {number(half[k], 2)}",
                    after_tone="warn" if is_open else "",
                )
            )
        rows.append(cells)
    to_unit = robot.entries[0].unit if all(is_prismatic(robot)) else str
    head = [
        f"{DRIVE_WORDS[kind]} [{to_unit(JOINT_PARAMETER_UNITS[kind])}]" for kind in parameters.drive
    ]
    return Table(("joint", *head), rows)


# -- directions ------------------------------------------------------------------------------------


def directions_section(identification: Identification) -> Section:
    """Build the section on the directions that the data and the prior determine."""
    analysis, shares = identification.analysis, identification.data_shares()
    count, by_data = len(shares), int(np.sum(shares > 0.5))
    accuracy = percent(float(np.sqrt(analysis.threshold)))
    by_prior = "none" if by_data == count else f"the other {count - by_data}"
    pairs = zip(analysis.directions, shares, strict=True)
    weak = [(direction, share) for direction, share in pairs if not direction.identifiable]
    data = {
        "spectrum": Markup(information_spectrum.draw_spectrum(analysis)),
        "shares": Markup(parameter_figures.draw_data_shares(shares)),
        "weak": [
            f"{without_verdict(direction.words)}; determined by the "
            f"{'data' if share > 0.5 else 'prior'} ({100 * share:.0f} % data)"
            for direction, share in reversed(weak)
        ],
        "listed": LISTED_DIRECTIONS,
        "parts": Markup(information_spectrum.draw_shares(analysis.links, analysis.joints)),
    }
    return Section(
        "directions",
        "Which directions did the recording determine, which the prior?",
        f"The recording identifies {analysis.identifiable_count} of {plural(count, 'direction')} "
        f"to ±{accuracy} or better; the data determine {by_data} of all, the prior {by_prior}.",
        data,
    )


# -- link inertias ---------------------------------------------------------------------------------


def link_body_changes(identification: Identification) -> list[LinkBodyChange]:
    """Inertia of each link, nominal and identified."""
    parameters = identification.model.parameters
    before, after = (
        consistency.inertial_rows(parameters, psi)
        for psi in (consistency.consistent_nominal(parameters), identification.psi)
    )
    shown = {s.name: s.identifiable_share for s in identification.analysis.links}
    return [
        LinkBodyChange(link, LinkBody(a), LinkBody(b), shown.get(link))
        for link, a, b in zip(parameters.links, before, after, strict=True)
    ]


def bodies_section(identification: Identification) -> Section:
    """Build the section on mass, centre of mass and inertia of each link."""
    changes = link_body_changes(identification)
    links = link_estimates(
        identification.model.parameters, identification.posterior, identification.prior
    )
    rows = [
        (
            c.link,
            TableCell(
                f"{number(c.after.mass, 3)} ± {number(link.mass_deviation, 2)}",
                bold=not link.is_prior,
                before=f"{number(c.before.mass, 3)} → ",
            ),
            f"{100.0 * link.mass_share:.0f} %" + (" – the prior's" if link.is_prior else ""),
            ", ".join(f"{1e3 * v:.0f}" for v in link.centre)
            + f" ± {1e3 * float(link.centre_deviation.max()):.2g}",
            f"{100.0 * link.centre_share:.0f} %",
            f"{1e3 * c.shift:.1f}",
            TableCell(_half_axes(c.after), bold=True, before=f"{_half_axes(c.before)} → "),
            f"{c.distance:.2f}",
            "–" if c.share is None else f"{100.0 * c.share:.0f} %",
        )
        for c, link in zip(changes, links, strict=True)
    ]
    head = (
        "link",
        "mass [kg]",
        "mass: data decide",
        "centre of mass [mm]",
        "centre: data decide",
        "shift of centre [mm]",
        "half axes [mm]",
        "distance",
        "identifiable share",
    )
    data = {
        "figure": Markup(inertia_ellipsoids.draw_ellipsoids(changes)),
        "table": Table(head, rows, (1, 2, 3, 4, 5, 6, 7, 8)),
        "repaired": ", ".join(identification.model.parameters.repaired),
    }
    return Section("bodies", "How did each link's inertia change?", _bodies_answer(changes), data)


def _bodies_answer(changes: Sequence[LinkBodyChange]) -> str:
    """Number of notable changes, and the largest."""
    largest = max(changes, key=lambda c: c.distance)
    notable = sum(c.distance > NOTABLE_DISTANCE for c in changes)
    if not notable:
        is_small = largest.distance < SMALLEST_DISTANCE
        size = "by less than 0.01" if is_small else f"by {largest.distance:.2f}"
        return (
            f"Hardly: {largest.link} changed most, {size} in the metric (a mass by 10 % is 0.07)."
        )
    answer = (
        f"{notable} of {plural(len(changes), 'link')} changed notably, {largest.link} most: "
        f"{number(largest.before.mass, 3)} → {number(largest.after.mass, 3)} kg, its centre of "
        f"mass by {1e3 * largest.shift:.0f}\u00a0mm"
    )
    if largest.share is None:
        return answer + "."
    return f"{answer}; its identifiable share is {100.0 * largest.share:.0f} %."


def _half_axes(body: LinkBody) -> str:
    """Half axes of the ellipsoid of a link [mm]."""
    digits = 0 if body.half_axes[0] >= 0.02 else 1
    return " × ".join(f"{1e3 * v:.{digits}f}" for v in body.half_axes)
