"""Sections on identifiability, and the short report made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from ..designer.experiment_comparison import Scenario
from ..designer.identifiability import BaseParameter, Direction, Identifiability
from ..robot.base_parameters import Base
from ..robot.inertial_parameters import Parameters
from ..robot.parameter_names import percent, plural, spoken
from ..robot.robot import Robot
from ..trajectory.trajectory_file import package_versions
from .content import Banner, ReportContent, Section, Table, TableCell
from .figures import information_spectrum as figures
from .formatting import capitalized, number
from .render import render

LISTED_DIRECTIONS = 10
"""Directions that are listed before the others are folded."""
UNFOLDED_PARAMETERS = 14
"""Longest table of base parameters that is shown without a click."""
ACCURATE = 0.1
"""Relative standard deviation up to which a parameter counts as accurately known."""
_SCENARIO_NAMES = {
    "now": "as designed",
    "time": "twice the recording time",
    "speed": "twice the speed, the same time",
}


def identifiability_page(
    robot: Robot,
    parameters: Parameters,
    base: Base,
    identifiability: Identifiability,
    motion: str = "",
    *,
    cases: Sequence[Scenario] = (),
    stated: Mapping[str, str] | None = None,
) -> str:
    """Render the report of `excite identifiability` as HTML.

    Args:
        robot: The robot.
        parameters: Its nominal parameters.
        base: Its base parameters.
        identifiability: The analysis to report.
        motion: Description or file name of the motion that was analysed.
        cases: Results of `compare_scenarios`, where the motion is known.
        stated: Further facts to list, name to text.
    """
    facts = ({"motion": motion} if motion else {}) | dict(stated or {})
    count, total = identifiability.identifiable_count, len(identifiability.directions)
    verdict = (
        f"This motion identifies {count} of {plural(total, 'direction')} of the base parameters."
    )
    content = ReportContent(
        title=f"Identifiability of {robot.name}",
        subtitle=f"Inertial and drive parameters that {motion or 'this motion'} can identify.",
        banners=[Banner(verdict, "good" if count == total else "warn")],
        cards=key_figures(identifiability, robot, base),
        sections=[
            *identifiability_sections(identifiability, parameters, cases),
            _provenance_section(identifiability, robot, facts),
        ],
        footer=f"excite {package_versions()['excite']}",
    )
    return render("identifiability", content)


def key_figures(
    identifiability: Identifiability, robot: Robot, base: Base
) -> list[tuple[str, str]]:
    """Key figures that every report on identifiability shows."""
    return [
        (str(robot.n), "moving joints" if robot.n != 1 else "moving joint"),
        (str(base.count), "base parameters"),
        (
            f"{identifiability.identifiable_count} of {len(identifiability.directions)}",
            "directions identifiable",
        ),
    ]


def identifiability_sections(
    identifiability: Identifiability, parameters: Parameters, cases: Sequence[Scenario]
) -> list[Section]:
    """Build all sections on identifiability, in order."""
    sections = [
        _spectrum_section(identifiability),
        _parts_section(identifiability),
        _parameters_section(identifiability, parameters),
    ]
    if cases:
        sections.append(_scenarios_section(cases, identifiability.threshold))
    return sections


def without_verdict(words: str) -> str:
    """Remove the verdict in front of a direction's description."""
    return capitalized(words.removeprefix("not seen: "))


def _spectrum_section(identifiability: Identifiability) -> Section:
    """How accurately the recording will show each direction."""
    count, seen = len(identifiability.directions), identifiability.identifiable_count
    best, worst = identifiability.directions[0], identifiability.directions[-1]
    return Section(
        "spectrum",
        "How accurately will the recording show each direction?",
        f"{seen} of {plural(count, 'direction')} of the base parameters are practically "
        f"identifiable; the best is known to ±{percent(best.deviation)}, the worst "
        f"{_accuracy(worst)}.",
        {
            "figure": Markup(figures.draw_spectrum(identifiability)),
            "threshold": number(identifiability.threshold),
        },
    )


def _accuracy(direction: Direction) -> str:
    """Accuracy of a direction, as the end of a sentence."""
    if not np.isfinite(direction.variance):
        return "is not excited at all"
    if direction.variance >= 1.0:
        return "is no better than a guess"
    return f"to ±{percent(direction.deviation)}"


def _parts_section(identifiability: Identifiability) -> Section:
    """Links, joints and directions that can be identified."""
    known = [s for s in identifiability.links if s.identifiable_share is not None]
    ranked = sorted(known, key=lambda s: -(s.identifiable_share or 0.0))
    if ranked:
        best, worst = ranked[0], ranked[-1]
        answer = (
            f"The link with the highest identifiable share is {best.name} "
            f"({_share(best.identifiable_share)})"
        )
        if len(ranked) > 1:
            answer += f"; the lowest is {worst.name} ({_share(worst.identifiable_share)})"
        answer += "."
    else:
        answer = "No link's inertial parameters can be identified from torques of this robot."
    hidden = [without_verdict(d.words) for d in identifiability.directions if not d.identifiable]
    data = {
        "figure": Markup(figures.draw_shares(identifiability.links, identifiability.joints)),
        "hidden": hidden,
        "hidden_heading": f"{plural(len(hidden), 'direction')} not identifiable"
        + (", the nearest to the threshold first" if len(hidden) > 1 else ""),
        "listed": LISTED_DIRECTIONS,
        "identifiable": [
            capitalized(d.words) for d in identifiability.directions if d.identifiable
        ],
    }
    return Section("parts", "Which links and joints can be identified?", answer, data)


def _share(share: float | None) -> str:
    """A share in per cent."""
    return "–" if share is None else f"{100.0 * share:.0f} %"


def _parameters_section(identifiability: Identifiability, parameters: Parameters) -> Section:
    """Predicted accuracy of the base parameters."""
    entries = identifiability.base_parameters
    accurate = sum(1 for entry in entries if _relative_std(entry) <= ACCURATE)
    nonzero = sum(1 for entry in entries if entry.nominal != 0.0)
    rows = [
        (
            TableCell(entry.name, code=True),
            spoken(entry.name, parameters),
            number(entry.nominal),
            number(entry.std, 2),
            percent(_relative_std(entry)) if np.isfinite(_relative_std(entry)) else "–",
            TableCell(entry.expression, code=True),
        )
        for entry in entries
    ]
    head = ("name", "named after", "nominal", "std", "std/nominal", "expression")
    return Section(
        "parameters",
        "How accurate will the base parameters be?",
        f"{accurate} of {plural(nonzero, 'base parameter')} with a nominal value will be known to "
        f"{100 * ACCURATE:.0f} % of it or better.",
        {
            "figure": Markup(figures.draw_deviations(identifiability)),
            "table": Table(head, rows, (2, 3, 4)),
            "open": len(rows) <= UNFOLDED_PARAMETERS,
        },
    )


def _relative_std(entry: BaseParameter) -> float:
    """Standard deviation over the nominal value; infinite where that is 0."""
    return entry.std / abs(entry.nominal) if entry.nominal != 0.0 else float("inf")


def _scenarios_section(cases: Sequence[Scenario], threshold: float) -> Section:
    """Identifiability with more time or more speed."""
    rows = [
        (
            _SCENARIO_NAMES.get(case.name, case.name),
            f"{case.identifiable_count} of {len(case.eigenvalues)}",
            ", ".join(f"{b.limit} of {b.joint} ({b.factor:.2g}×)" for b in case.broken_limits)
            or "none",
        )
        for case in cases
    ]
    return Section(
        "more",
        "What would twice the time or twice the speed improve?",
        ". ".join(case.words for case in cases[1:]) + ".",
        {
            "table": Table(("motion", "identifiable", "limits it would break"), rows, (1,)),
            "figure": Markup(figures.draw_scenarios(cases, threshold)),
        },
    )


def _provenance_section(
    identifiability: Identifiability, robot: Robot, stated: Mapping[str, str]
) -> Section:
    """Inputs of the analysis; stated: further facts, name to text."""
    samples = identifiability.samples
    facts = {
        "robot": f"{robot.name} ({robot.source})",
        "SHA-256 of the URDF": robot.sha256,
        "samples": "–" if samples is None else str(samples),
        "threshold": number(identifiability.threshold),
        **stated,
        "versions": ", ".join(f"{k} {v}" for k, v in package_versions().items()),
    }
    noise = zip(identifiability.joint_names, identifiability.noise, strict=True)
    return Section(
        "made",
        "How was this computed?",
        f"From {robot.name}'s nominal parameters, the motion itself, and an assumed torque noise "
        "per joint.",
        {
            "facts": Table(("quantity", "value"), list(facts.items())),
            "noise": Table(("joint", "N m (N)"), [(j, number(v, 3)) for j, v in noise], (1,)),
        },
    )
