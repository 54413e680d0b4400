"""The report of motions on the feet: contact, limits, distances, and what they make visible."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from .._types import FloatArray
from ..collision.continuous_check import PairDistance
from ..designer.certificate import CLEARANCE, CertificateVerdict, LimitMargin, format_percent
from ..designer.identifiability import Identifiability
from ..designer.support_design import SupportDesign
from ..designer.support_kinematics import SupportSamples
from ..designer.support_trajectory import StatedFoot, SupportTrajectory
from ..robot.floating_base import Rows
from ..robot.limits import QUANTITIES
from ..robot.parameter_names import plural
from ..trajectory.trajectory_file import package_versions
from .content import Banner, ReportContent, Section, Table, TableCell
from .figures import collision as collision_figures
from .figures import information_spectrum
from .figures.pressure import SolePicture, draw_pressure, edge_distance
from .formatting import capitalized, number
from .identifiability import without_verdict
from .render import render

LISTED_MARGINS = 15
"""Margins that are listed."""

LISTED_PAIRS = 12
"""Pairs of bodies that are listed."""

LISTED_DIRECTIONS = 12
"""Directions that are listed."""

PRESSURE = "centre of pressure"
"""Name of the centre of pressure among the kinds of limits."""

_UNITS = {
    "position": "rad",
    "velocity": "rad/s",
    "acceleration": "rad/s²",
    "torque": "N m",
    "normal force": "N",
    PRESSURE: "m",
    CLEARANCE: "m",
}


def support_design_page(
    trajectory: SupportTrajectory, design: SupportDesign, samples: Sequence[SupportSamples]
) -> str:
    """Render the report of motions on the feet as HTML.

    Args:
        trajectory: Content of the trajectory file.
        design: The design with its certificate.
        samples: The motions as exported.
    """
    analysis = design.analysis(Rows.BASE)
    pictures = [_picture(design, number, samples) for number in range(len(design.stance.feet))]
    content = ReportContent(
        title=f"{design.robot.name} on its feet",
        subtitle="Whole-body motions for identification from the wrench of the ground: whether "
        "they may be run, and what they make visible.",
        banners=_banners(design, analysis, pictures),
        cards=_cards(design, pictures),
        sections=[
            _pressure_section(design, pictures, samples),
            _limits_section(design),
            _clearance_section(design),
            _visible_section(design, analysis),
            _provenance_section(trajectory, design),
        ],
        footer=f"excite {package_versions()['excite']}, seed {trajectory.seed}",
    )
    return render("support_design", content)


def _picture(design: SupportDesign, number: int, samples: Sequence[SupportSamples]) -> SolePicture:
    """Return a sole with the centre of pressure of all motions."""
    foot, sole = design.stance.feet[number], design.options.soles[number]
    paths = []
    for part in samples:
        wrench = part.wrenches[:, number]
        paths.append(np.column_stack([-wrench[:, 4], wrench[:, 3]]) / wrench[:, 2:3])
    return SolePicture(
        foot.frame,
        np.array(foot.in_world.translation[:2]),
        np.array([foot.half_length, foot.half_width]),
        design.stance.contact.margin,
        np.array(sole.outline, float).reshape(-1, 2),
        paths,
    )


def _total_pressure(design: SupportDesign, samples: Sequence[SupportSamples]) -> list[FloatArray]:
    """Return the centre of pressure of the robot on two feet, motion by motion."""
    feet = design.stance.feet
    if len(feet) == 1:
        return []
    out = []
    for part in samples:
        forces = part.wrenches[:, :, 2]
        local = np.stack([-part.wrenches[:, :, 4], part.wrenches[:, :, 3]], axis=-1)
        centres = np.array([foot.in_world.translation[:2] for foot in feet])
        moments = local + centres * forces[..., None]
        out.append(moments.sum(axis=1) / forces.sum(axis=1)[:, None])
    return out


def _banners(
    design: SupportDesign, analysis: Identifiability, pictures: Sequence[SolePicture]
) -> list[Banner]:
    """Verdicts: may it be run, and what does it show."""
    certificate = design.certificate
    nearest = _nearest_limit(design)
    if certificate.limits is CertificateVerdict.CERTIFIED:
        least = 1e3 * min(float(edge_distance(picture).min()) for picture in pictures)
        text = (
            "Limits: certified, also between samples. The feet stay where they are, the centre of "
            f"pressure never comes nearer than {least:.0f} mm to an edge, and the closest limit is "
            f"the {_margin_words(nearest)}."
        )
        limits = Banner(text, "good")
    else:
        limits = Banner(
            f"Limits: FAILED; {certificate.failure_reason()}. Do not run these motions.", "bad"
        )
    clearance = {
        CertificateVerdict.CERTIFIED: Banner(
            f"Clearance: certified; {certificate.collision}.", "good"
        ),
        CertificateVerdict.FAILED: Banner(
            f"Clearance: FAILED; {certificate.collision}. Do not run these motions.", "bad"
        ),
        CertificateVerdict.NOT_CHECKED: Banner(
            f"Clearance: not checked; {certificate.collision}. Links may hit each other: watch the "
            "motions in simulation first.",
            "warn",
        ),
    }[certificate.clearance]
    deviation = 100.0 * float(np.sqrt(analysis.threshold))
    seen = (
        f"{analysis.identifiable_count} of {design.base.count} directions of the base parameters "
        f"become visible in the wrench of the ground (known to ±{deviation:.2g} % or better)."
    )
    return [clearance, limits, Banner(seen, "good" if analysis.identifiable_count else "bad")]


def _nearest_limit(design: SupportDesign) -> LimitMargin:
    """Return the margin to a limit that is the smallest, clearances aside."""
    limits = [m for m in design.certificate.margins if m.limit != CLEARANCE]
    return min(limits, key=lambda margin: margin.spare_share)


def _margin_words(margin: LimitMargin) -> str:
    """Return a margin as the end of a sentence."""
    free = format_percent(max(margin.free_share, 0.0))
    return f"{margin.limit} of {margin.joint}, {free} free"


def _cards(design: SupportDesign, pictures: Sequence[SolePicture]) -> list[tuple[str, str]]:
    """Key figures."""
    both = design.analysis(Rows.BOTH)
    least = 1e3 * min(float(edge_distance(picture).min()) for picture in pictures)
    margin = 1e3 * design.stance.contact.margin
    counts = design.identifiable_counts()
    each = design.duration / len(counts)
    return [
        (f"{counts[-1]} of {design.base.count}", "directions visible in the wrench of the ground"),
        (f"{both.identifiable_count} of {len(both.directions)}", "with joint torques as well"),
        (f"{plural(len(counts), 'motion')} of {each:g} s", "from rest to rest, in any order"),
        (f"{least:.0f} mm", f"from the pressure to the nearest edge; {margin:g} mm are required"),
    ]


def _pressure_section(
    design: SupportDesign, pictures: Sequence[SolePicture], samples: Sequence[SupportSamples]
) -> Section:
    """Contact of the feet: pressure, normal force and friction."""
    nearest = {(m.limit, m.joint): m for m in design.certificate.margins}
    weight = design.stance.weight
    rows = []
    for index, picture in enumerate(pictures):
        friction, turning = (
            nearest[kind, picture.name] for kind in ("friction", "turning friction")
        )
        force = min(float(part.wrenches[:, index, 2].min()) for part in samples)
        rows.append(
            (
                picture.name,
                f"{2e3 * picture.half[0]:.0f} × {2e3 * picture.half[1]:.0f}",
                f"{1e3 * edge_distance(picture).min():.1f}",
                f"{100.0 * force / weight:.0f} % of the weight",
                f"{abs(friction.value):.2f} of {abs(friction.bound):g}",
                f"{100.0 * abs(turning.value):.0f} % used",
            )
        )
    head = (
        "foot",
        "sole [mm]",
        "to an edge [mm]",
        "least normal force",
        "friction",
        "turning friction",
    )
    count = len(design.stance.feet)
    answer = (
        f"Yes: on {'both feet' if count == 2 else 'the foot'} it stays inside the dashed "
        f"rectangle, {1e3 * design.stance.contact.margin:g} mm from the edges."
    )
    notes = [
        "Two feet share the wrench so that their centres of pressure lie at the same distance from "
        "the line between the soles. A robot that shares it otherwise has other pressures in its "
        "feet and other torques in its legs, but the same sum."
    ]
    return Section(
        "pressure",
        "Does the centre of pressure stay inside the feet?",
        answer,
        {
            "picture": Markup(draw_pressure(pictures, _total_pressure(design, samples))),
            "tables": [Table(head, rows, (1, 2, 3, 4, 5))],
            "notes": notes if count == 2 else [],
        },
    )


def _limits_section(design: SupportDesign) -> Section:
    """Margins to the limits: the nearest of each kind, and the nearest of all."""
    margins = [m for m in design.certificate.margins if m.limit != CLEARANCE]
    ordered = sorted(margins, key=lambda margin: margin.free_share)
    kinds: dict[str, LimitMargin] = {}
    for margin in ordered:
        kinds.setdefault(margin.limit, margin)
    absent = [
        quantity
        for quantity in ("acceleration",)
        if not np.isfinite(getattr(design.limits, quantity)).all()
    ]
    notes = [
        f"No {quantity} limit is stated for some joints; none was enforced there."
        for quantity in absent
    ]
    notes.append(
        "The margin is the distance to the bound at the worst moment of all motions, between "
        "samples too, as a share of the half width of the allowed range. Torque limits hold for "
        "the nominal robot."
    )
    head = ("limit", "joint or axis", "at [s]", "value", "bound", "margin", "used")
    return Section(
        "limits",
        "Which limits are the closest?",
        f"The {_margin_words(ordered[0])}, is the closest of {len(margins)}; all hold."
        if design.certificate.limits is CertificateVerdict.CERTIFIED
        else f"{capitalized(design.certificate.failure_reason())}.",
        {
            "tables": [
                Table(head, [_margin_row(design, m) for m in kinds.values()], (2, 3, 4, 5)),
                Table(
                    head, [_margin_row(design, m) for m in ordered[:LISTED_MARGINS]], (2, 3, 4, 5)
                ),
            ],
            "notes": notes,
        },
    )


def _margin_row(design: SupportDesign, margin: LimitMargin) -> tuple[str | TableCell, ...]:
    """Return the row of a margin."""
    unit = _UNITS.get(margin.limit, "")
    if margin.joint in design.robot.joints:
        index = design.robot.joints.index(margin.joint)
        unit = design.robot.joint_robot.entries[index].unit(unit)
    is_violated = margin.spare_share < 0.0
    return (
        margin.limit,
        margin.joint,
        f"{margin.time:.2f}",
        number(margin.value),
        f"{number(margin.bound)} {unit}".rstrip(),
        TableCell(format_percent(margin.free_share), tone="bad" if is_violated else ""),
        TableCell("", share=1.0 - margin.free_share, exceeded=is_violated),
    )


def _clearance_section(design: SupportDesign) -> Section:
    """Least distances between bodies, and to the ground."""
    question, certificate, cell = "Does it touch anything?", design.certificate, design.cell
    answer = f"{capitalized(certificate.collision)}."
    if cell is None:
        return Section("clearance", question, answer, {}, "warn")
    distances = certificate.pair_distances
    figures = (
        [Markup(collision_figures.draw_nearest_moment(cell, distances[0]))] if distances else []
    )
    excepted = Table(
        ("body", "body", "reason"), [(e.first, e.second, e.why) for e in cell.excepted]
    )
    return Section(
        "clearance",
        question,
        answer,
        {
            "figures": figures,
            "tables": [_distance_table(distances), *([excepted] if cell.excepted else [])],
            "notes": [
                *cell.notes,
                "Distances are proven between samples. The soles on the ground touch it; all other "
                "bodies keep their distance from it.",
            ],
        },
    )


def _distance_table(distances: Sequence[PairDistance]) -> Table:
    """Return the table of the pairs that are nearest to their clearance."""
    rows = [
        (
            near.names,
            f"{1e3 * near.proven:.1f}",
            f"{1e3 * near.pair.margin:.1f}",
            f"{near.time:.2f}",
        )
        for near in distances[:LISTED_PAIRS]
    ]
    head = ("bodies", "least distance [mm]", "required [mm]", "at [s]")
    return Table(head, rows, (1, 2, 3))


def _visible_section(design: SupportDesign, analysis: Identifiability) -> Section:
    """Directions that the wrench shows, motion by motion and body by body."""
    counts = design.identifiable_counts()
    rows = [
        (f"{motion}", f"{count}", f"+{count - before}")
        for motion, (before, count) in enumerate(zip([0, *counts], counts, strict=False), start=1)
    ]
    directions = [
        (capitalized(without_verdict(d.words)), f"±{number(100.0 * d.deviation, 2)} %")
        for d in analysis.directions[:LISTED_DIRECTIONS]
    ]
    answer = (
        f"{counts[-1]} of {design.base.count} directions, with a noise of "
        f"{number(design.noise.force, 3)} N and {number(design.noise.moment, 3)} N m at "
        f"{design.options.rate:g} rows a second; the first motion shows {counts[0]}."
    )
    return Section(
        "visible",
        "How many parameters become visible?",
        answer,
        {
            "figures": [
                Markup(information_spectrum.draw_spectrum(analysis)),
                Markup(information_spectrum.draw_shares(analysis.links, analysis.joints)),
            ],
            "tables": [
                Table(("after motion", "visible", "more"), rows, (0, 1, 2)),
                Table(("the most accurate directions", "standard deviation"), directions, (1,)),
            ],
        },
    )


def _provenance_section(trajectory: SupportTrajectory, design: SupportDesign) -> Section:
    """Feet, contact, limits with their sources, and versions."""
    contact, options = trajectory.contact, design.options
    margins = ", ".join(f"{kind} {share:.0%}" for kind, share in trajectory.limits.margin.items())
    facts = [
        ("robot", f"{trajectory.robot['name']} ({Path(str(trajectory.robot['source'])).name})"),
        ("SHA-256 of the URDF", str(trajectory.robot["sha256"])),
        *((f"sole of {foot.frame}", _sole_words(foot)) for foot in trajectory.feet),
        ("friction of the soles", f"{contact.friction:g}"),
        ("margin of the centre of pressure", f"{1e3 * contact.margin:g} mm"),
        ("least normal force of a foot", f"{contact.least_share:.0%} of its share of the weight"),
        ("kept free of the limits", margins or "nothing"),
        ("criterion", f"{trajectory.criterion.upper()} of the base rows"),
        ("starts, iterations", f"{options.starts}, {options.iterations}"),
        ("versions", ", ".join(f"{k} {v}" for k, v in trajectory.versions.items())),
    ]
    limits = design.limits
    rows = [
        (joint, quantity, _limit_text(getattr(limits, quantity)[i]), limits.sources[quantity][i])
        for i, joint in enumerate(limits.joints)
        for quantity in QUANTITIES
        if np.isfinite(getattr(limits, quantity)[i]).all()
    ]
    return Section(
        "made",
        "How was this computed?",
        "From the nominal robot, the soles and the limits below; `excite verify trajectory.json` "
        "computes all verdicts again from the file.",
        {
            "tables": [
                Table(("quantity", "value"), facts),
                Table(("joint", "limit", "value", "source"), rows, (2,)),
            ]
        },
    )


def _sole_words(foot: StatedFoot) -> str:
    """Return the size of a sole and where it comes from."""
    size = f"{2e3 * foot.half_length:.0f} mm by {2e3 * foot.half_width:.0f} mm"
    inside = ", the largest rectangle inside their convex hull" if foot.outline else ""
    return f"{size}, from {foot.sole_source}{inside}"


def _limit_text(value: FloatArray) -> str:
    """Format a limit, which may be a range."""
    return " to ".join(number(float(v)) for v in np.atleast_1d(value))
