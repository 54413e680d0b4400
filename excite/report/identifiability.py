"""What a recording will tell: the sections on identifiability, and the short report made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..designer.experiment_comparison import Scenario
from ..designer.identifiability import BaseParameter, Direction, Identifiability
from ..robot.base_parameters import Base
from ..robot.inertial_parameters import Parameters
from ..robot.parameter_names import percent, spoken
from ..robot.robot import Robot
from ..trajectory.trajectory_file import versions
from .figures import information_spectrum as figures
from .page import (
    Section,
    bullets,
    cards,
    escape,
    figure,
    folded,
    number,
    page,
    paragraph,
    plural,
    table,
)

_SHOWN = 10
_SCENARIOS = {
    "now": "as designed",
    "time": "twice the recording time",
    "speed": "twice the speed, the same time",
}


def spectrum_section(found: Identifiability) -> Section:
    """(d) How well is each direction seen?"""
    count, seen = len(found.directions), found.identifiable
    best, worst = found.directions[0], found.directions[-1]
    tail = f"the worst {_known(worst)}."
    answer = f"{seen} of {plural(count, 'direction')} of the base parameters are practically identifiable; "
    answer += f"the best is known to ±{percent(best.deviation)}, {tail}"
    note = (
        "Each point is an independent combination of base parameters. Its variance is scale-free: a standard deviation of 10 % means about "
        "10 % of the robot's nominal masses, lengths and friction in that combination, before any prior knowledge. "
        f"Below the dashed line (variance {number(found.threshold)}) it counts as identifiable."
    )
    return Section(
        "spectrum",
        "How well will the recording show each direction?",
        answer,
        figure(figures.spectrum(found)) + paragraph(note, "note"),
    )


def _known(direction: Direction) -> str:
    if not np.isfinite(direction.variance):
        return "is not excited at all"
    return (
        "is no better than a guess"
        if direction.variance >= 1.0
        else f"to ±{percent(direction.deviation)}"
    )


def parts_section(found: Identifiability) -> Section:
    """(e) Which links, joints and directions?"""
    known = [s for s in found.links if s.identifiable_share is not None]
    ranked = sorted(known, key=lambda s: -(s.identifiable_share or 0.0))
    if ranked:
        high, low = ranked[0], ranked[-1]
        answer = f"Of the links, {high.name} is shown best ({_share(high.identifiable_share)} of what can be known of it)"
        answer += (
            f" and {low.name} least ({_share(low.identifiable_share)})." if len(ranked) > 1 else "."
        )
    else:
        answer = "No link's inertial parameters can be known from torques of this robot."
    missing = [d for d in found.directions if not d.identifiable]
    body = figure(figures.shares(found.links, found.joints))
    body += paragraph(
        "A bar is the part of a link's (or a drive's) observable parameters that lies in identifiable directions; "
        "what no motion could show does not count.",
        "note",
    )
    if missing:
        body += f"<h3>{escape(_heading(len(missing)))}</h3>" + bullets(
            bare(d.words) for d in missing[:_SHOWN]
        )
        if len(missing) > _SHOWN:
            body += folded(
                f"{len(missing) - _SHOWN} more that are seen even less",
                bullets(bare(d.words) for d in missing[_SHOWN:]),
            )
    else:
        body += paragraph("Every direction is identifiable.", "good")
    seen = [d.words for d in found.directions if d.identifiable]
    if seen:
        body += folded(
            f"{plural(len(seen), 'direction')} that will be seen, the best first",
            bullets(map(capital, seen)),
        )
    return Section("parts", "Which links and joints can be identified?", answer, body)


def _heading(count: int) -> str:
    return f"{plural(count, 'direction')} will not be seen" + (
        ", those nearest to it first" if count > 1 else ""
    )


def bare(words: str) -> str:
    """What a direction consists of, without the verdict in front."""
    return capital(words.removeprefix("not seen: "))


def capital(text: str) -> str:
    """With a capital first letter, the rest as it is."""
    return text[:1].upper() + text[1:]


def _share(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.0f} %"


def parameters_section(found: Identifiability, parameters: Parameters) -> Section:
    """(f) How accurate will the base parameters be?"""
    entries = found.base_parameters
    accurate = sum(1 for b in entries if _relative(b) <= 0.1)
    nonzero = sum(1 for b in entries if b.nominal != 0.0)
    answer = f"{accurate} of {plural(nonzero, 'base parameter')} with a nominal value will be known to 10 % of it or better."
    rows = [
        (
            f"<code>{escape(b.name)}</code>",
            escape(spoken(b.name, parameters)),
            number(b.nominal),
            number(b.std, 2),
            percent(_relative(b)) if np.isfinite(_relative(b)) else "–",
            f"<code>{escape(b.expression)}</code>",
        )
        for b in entries
    ]
    listing = table(
        ("name", "named after", "nominal", "std", "std/nominal", "stands for"), rows, (2, 3, 4)
    )
    note = (
        "Least standard deviation of an unbiased fit (Cramér–Rao) with the stated torque noise, white, independent from sample to sample. "
        "Models that are wrong, filtered noise and friction that the model lacks make the true errors larger."
    )
    body = (
        figure(figures.deviations(found))
        + paragraph(note, "note")
        + folded("All base parameters", listing, unfolded=len(rows) <= 14)
    )
    return Section("parameters", "How accurate will the base parameters be?", answer, body)


def _relative(entry: BaseParameter) -> float:
    return entry.std / abs(entry.nominal) if entry.nominal != 0.0 else float("inf")


def scenarios_section(cases: Sequence[Scenario], threshold: float) -> Section:
    """(g) What would more time or more speed buy?"""
    answer = ". ".join(case.words for case in cases[1:]) + "."
    rows = [
        (
            escape(_SCENARIOS.get(case.name, case.name)),
            f"{case.identifiable} of {len(case.eigenvalues)}",
            escape(
                ", ".join(f"{b.limit} of {b.joint} ({b.factor:.2g}×)" for b in case.broken)
                or "none"
            ),
        )
        for case in cases
    ]
    body = table(("motion", "identifiable", "limits it would break"), rows, (1,)) + figure(
        figures.scenarios(cases, threshold)
    )
    return Section("more", "What would twice the time or twice the speed buy?", answer, body)


def sections(
    found: Identifiability, parameters: Parameters, cases: Sequence[Scenario]
) -> list[Section]:
    """All sections on identifiability, in order."""
    out = [spectrum_section(found), parts_section(found), parameters_section(found, parameters)]
    return [*out, scenarios_section(cases, found.threshold)] if cases else out


def noise_section(found: Identifiability, robot: Robot, stated: Mapping[str, str]) -> Section:
    """How the figures were obtained. stated: further facts, name -> text."""
    facts = {
        "robot": f"{robot.name} ({robot.source})",
        "SHA-256 of the URDF": robot.sha256,
        "samples": "–" if found.samples is None else str(found.samples),
        "threshold": number(found.threshold),
        **stated,
        "versions": ", ".join(f"{k} {v}" for k, v in versions().items()),
    }
    body = table(("", ""), [(escape(k), escape(v)) for k, v in facts.items()])
    rows = [(escape(j), number(v, 3)) for j, v in zip(found.joint_names, found.noise, strict=True)]
    body += "<h3>Standard deviation of the torque noise</h3>" + table(
        ("joint", "N m (N)"), rows, (1,)
    )
    answer = f"From {robot.name}'s nominal parameters, the motion itself, and an assumed torque noise per joint."
    return Section("made", "How was this computed?", answer, body)


def headline(found: Identifiability, robot: Robot, base: Base) -> list[tuple[str, str]]:
    """Cards that every report shows."""
    return [
        (str(robot.n), "moving joints" if robot.n != 1 else "moving joint"),
        (str(base.count), "base parameters"),
        (f"{found.identifiable} of {len(found.directions)}", "directions identifiable"),
    ]


def identifiability_page(
    robot: Robot,
    parameters: Parameters,
    base: Base,
    found: Identifiability,
    motion: str = "",
    *,
    cases: Sequence[Scenario] = (),
    stated: Mapping[str, str] | None = None,
) -> str:
    """The report of `excite identifiability` as HTML. motion: what was analysed, in words or by its file's name.

    cases: what `what_would_help` found, where the motion is known. stated: further facts to show, name -> text.
    """
    head = cards(headline(found, robot, base))
    facts = ({"motion": motion} if motion else {}) | dict(stated or {})
    parts = [*sections(found, parameters, cases), noise_section(found, robot, facts)]
    lede = f"What {motion or 'this motion'} tells about the robot's inertial parameters and drives."
    return page(
        f"Identifiability of {robot.name}", lede, head, parts, f"excite {versions()['excite']}"
    )
