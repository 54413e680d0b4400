"""The report of a design: limits, torque, clearance, identifiability, and how it was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from ..collision.continuous_check import PairDistance
from ..collision.workcell import Cell
from ..designer.certificate import CLEARANCE, format_percent, promised_share
from ..designer.constraint_margins import STAND
from ..designer.discrimination_result import DiscriminationResult
from ..designer.experiment_comparison import Scenario, compare_scenarios
from ..designer.identifiability import Identifiability
from ..designer.isolability_forecast import PairForecast
from ..designer.multistart import Attempt
from ..designer.stand_load import stand_loads
from ..designer.task_variance import TaskPrediction
from ..robot.base_parameters import Base
from ..robot.dynamics import torque_band
from ..robot.inertial_parameters import Parameters
from ..robot.limits import Stand
from ..robot.parameter_names import plural
from ..robot.robot import Robot
from ..trajectory.trajectory_file import Trajectory, package_versions
from .content import Banner, ReportContent, Section, Table, TableCell
from .design_provenance import (
    criteria_section,
    history_section,
    is_for_purpose,
    provenance_section,
)
from .discrimination import discrimination_section, isolability_section
from .figures import collision as collision_figures
from .figures import time_budget as time_budget_figure
from .figures import trajectory as trajectory_figures
from .figures import validation_motion as validation_figure
from .figures.drawing import COMPACT_LAYOUT_JOINTS
from .figures.small_multiples import CurvePanel, draw_curves
from .figures.trajectory import MotionScene
from .formatting import capitalized, number
from .identifiability import identifiability_sections, key_figures
from .render import render
from .task import task_section

ROUNDING = 1e-9
"""Relative margin below zero that is rounding, not a violation."""
NO_MARGIN = 5e-4
"""Relative margin below which a value is said to be at its bound."""
LISTED_MARGINS = 12
"""Margins that are listed before the others are folded."""
LISTED_PAIRS = 8
"""Pairs of bodies that are listed before the others are folded."""
LARGE_OVERLAP = 0.7
"""Overlap above which half of a model error's variance recurs in the second motion."""
_UNITS = {
    "position": "rad",
    "velocity": "rad/s",
    "acceleration": "rad/s²",
    "jerk": "rad/s³",
    "torque": "N m",
    "braking": "rad",
}
_STAND_UNITS = {"force": "N", "moment": "N m"}
_CRITERIA = {
    "a": "A, sum of variances (lower is better)",
    "d": "D, log volume (higher is better)",
    "e": "E, least eigenvalue (higher is better)",
    "cond": "condition number (lower is better)",
    "cond_regressor": "condition of the regressor (lower is better)",
}


@dataclass(frozen=True)
class _Subject:
    """A design and what it was made for."""

    trajectory: Trajectory
    robot: Robot
    parameters: Parameters
    base: Base
    identifiability: Identifiability
    cell: Cell | None = None

    @property
    def scene(self) -> MotionScene:
        """The motion with what its figures need."""
        return MotionScene(self.trajectory.motion, self.trajectory.limits, self.robot, self.cell)


def design_page(
    trajectory: Trajectory,
    robot: Robot,
    parameters: Parameters,
    base: Base,
    identifiability: Identifiability,
    attempts: Sequence[Attempt],
    *,
    cases: Sequence[Scenario] | None = None,
    second: Trajectory | None = None,
    cell: Cell | None = None,
    near: Sequence[PairDistance] = (),
    task: TaskPrediction | None = None,
    discrimination: DiscriminationResult | None = None,
    isolability: Sequence[PairForecast] = (),
) -> str:
    """Render the report of a design as HTML.

    Args:
        trajectory: The designed motion with its certificate.
        robot: The robot.
        parameters: Its nominal parameters.
        base: Its base parameters.
        identifiability: Analysis of the motion.
        attempts: Results of all starts of the optimiser, the best first.
        cases: Results of `compare_scenarios`; None: computed here.
        second: A second motion for validation.
        cell: Bodies that must not touch, where clearances were checked.
        near: Least distances of the pairs of bodies, the most critical first.
        task: Predicted torque band along the task that the motion was designed for.
        discrimination: What the recording is expected to decide between explanations.
        isolability: Expected log-odds between often confused effects, the least first.
    """
    subject = _Subject(trajectory, robot, parameters, base, identifiability, cell)
    if cases is None:
        cases = compare_scenarios(
            robot,
            parameters,
            base,
            trajectory.limits,
            trajectory.motion,
            noise=trajectory.noise,
            rate=trajectory.rate,
            threshold=identifiability.threshold,
        )
    stand = trajectory.limits.stand
    sections = [
        _limits_section(subject),
        _torque_section(subject),
        *([] if stand is None else [_stand_section(subject, stand)]),
        _collision_section(trajectory, cell, near),
        *identifiability_sections(identifiability, parameters, cases),
        _path_section(subject),
        *([] if task is None else [task_section(task, robot)]),
        *([] if discrimination is None else [discrimination_section(discrimination)]),
        *([isolability_section(isolability)] if isolability else []),
        *([] if second is None else [_validation_section(trajectory, second, robot)]),
        *([_plan_section(trajectory.design["plan"])] if "plan" in trajectory.design else []),
        history_section(attempts),
        criteria_section(trajectory),
        provenance_section(trajectory, robot, parameters),
    ]
    content = ReportContent(
        title=f"Excitation of {robot.name}",
        subtitle="An excitation trajectory for identification: whether it may be run, what it will "
        "identify, and how it was found.",
        banners=[
            _clearance_banner(trajectory),  # first: nothing unchecked follows a certificate
            _limits_banner(trajectory),
            _identifiability_banner(identifiability),
            *(Banner(text, "warn") for text in _warnings(subject)),
        ],
        cards=_cards(subject),
        sections=sections,
        footer=f"excite {package_versions()['excite']}, seed {trajectory.seed}",
    )
    return render("design", content)


def _criterion_value(criteria: Mapping[str, Any], name: str, plain: bool) -> float | None:
    """Look up a value of a trajectory's `criteria`; None where it is absent."""
    entries = criteria.get("optimum", {})
    value = (
        entries.get(name)
        if name == "cond_regressor"
        else entries.get("plain" if plain else "geometric", {}).get(name)
    )
    return None if value is None else float(value)


def relative_margins(trajectory: Trajectory) -> list[tuple[float, Mapping[str, Any]]]:
    """Every margin of a trajectory with its relative size, the smallest first.

    The relative size is the distance to the bound over the half width of the allowed range.
    """
    sized = ((_relative_margin(m, trajectory), m) for m in trajectory.margins)
    return sorted(sized, key=lambda pair: pair[0])


def _relative_margin(margin: Mapping[str, Any], trajectory: Trajectory) -> float:
    """Relative size of a margin, computed where the file does not state it."""
    if margin.get("margin") is not None:
        return float(margin["margin"])
    value, bound = float(margin["value"]), float(margin["bound"])
    if margin["limit"] == "position" and margin["joint"] in trajectory.joints:
        lower, upper = trajectory.limits.position[trajectory.joints.index(margin["joint"])]
        return float(min(value - lower, upper - value) / (0.5 * (upper - lower)))
    return 1.0 - value / bound if bound else -value


# -- first screen ----------------------------------------------------------------------------------


def _cards(subject: _Subject) -> list[tuple[str, str]]:
    """Key figures of a design."""
    trajectory = subject.trajectory
    motion = trajectory.motion
    name = str(trajectory.design.get("criterion", "a"))
    is_plain = bool(trajectory.design.get("plain", False))
    value = _criterion_value(trajectory.criteria, name, is_plain)
    criterion = (number(value), f"criterion: {_CRITERIA.get(name, name)}, per sample")
    return [
        *key_figures(subject.identifiability, subject.robot, subject.base),
        (
            f"{motion.duration:.1f} s",
            f"from rest to rest, {motion.periods} periods of {motion.fourier.period:g} s",
        ),
        *([] if is_for_purpose(trajectory) else [criterion]),
    ]


def _limits_banner(trajectory: Trajectory) -> Banner:
    """The verdict on the limits of the joints."""
    margins = [(r, m) for r, m in relative_margins(trajectory) if m["limit"] != CLEARANCE]
    if not margins:
        return Banner("Limits: not checked. Check the motion before running it.", "warn")
    spare = [_spare_share(relative, m, trajectory) for relative, m in margins]
    violated = sum(share < -ROUNDING for share in spare)
    relative, worst = margins[int(np.argmin(spare))]
    if violated:
        which = f"the worst is the {worst['limit']} of {worst['joint']}"
        text = f"Limits: FAILED. {plural(violated, 'limit')} violated; {which}."
        return Banner(f"{text} Do not run this motion.", "bad")
    if trajectory.forced:
        return Banner("Written although a check failed (--force). Do not run this motion.", "bad")
    text = f"Limits: certified. All {len(margins)} hold; the closest is the {worst['limit']} of "
    words = _margin_words(relative, promised_share(trajectory, worst["limit"]))
    return Banner(f"{text}{worst['joint']}, {words}.", "good")


def _spare_share(relative: float, margin: Mapping[str, Any], trajectory: Trajectory) -> float:
    """Relative margin beyond the promised one, by which the certificate finds the closest [1]."""
    return relative - promised_share(trajectory, margin["limit"])


def _margin_words(relative: float, promised: float) -> str:
    """A relative margin, and what of it is promised, as the end of a sentence."""
    if relative < NO_MARGIN:
        return "at its bound"
    text = f"with a margin of {100.0 * relative:.2g} %"
    return f"{text}, {format_percent(promised)} promised" if promised else text


def _clearance_banner(trajectory: Trajectory) -> Banner:
    """The verdict on the clearances."""
    text = trajectory.collision
    if "not checked" in text:
        advice = (
            "The motion was not tested against the robot's own links or its surroundings. "
            "Watch the first run at low speed."
        )
        return Banner(f"Clearance: not checked; {text}. {advice}", "warn")
    is_violated = any(
        relative < -ROUNDING and margin["limit"] == CLEARANCE
        for relative, margin in relative_margins(trajectory)
    )
    if is_violated or text.startswith("COLLISION"):
        return Banner(f"Clearance: FAILED; {text}. Do not run this motion.", "bad")
    return Banner(f"Clearance: certified; {text}.", "good")


def _identifiability_banner(identifiability: Identifiability) -> Banner:
    """The verdict on what the motion will identify."""
    seen, count = identifiability.identifiable_count, len(identifiability.directions)
    text = f"Identifiability: {seen} of {plural(count, 'direction')} of the base parameters"
    threshold = float(np.sqrt(identifiability.threshold))
    text += f" will be known to ±{100.0 * threshold:.2g} % or better."
    return Banner(text, "good" if seen == count else "warn")


def _warnings(subject: _Subject) -> list[str]:
    """Further warnings to read before the motion is run."""
    warnings = list[str]()
    limits = subject.trajectory.limits
    if subject.parameters.repaired:
        links = ", ".join(subject.parameters.repaired)
        warnings.append(
            f"The inertia of {links} in the URDF is not physically consistent: the metric uses a "
            "substitute."
        )
    optional = ("acceleration", "jerk")
    absent = [q for q in optional if not np.isfinite(getattr(limits, q)).all()]
    if absent:
        warnings.append(
            f"No {' or '.join(absent)} limit is stated for some joints; none was enforced there."
        )
    derived = [q for q in optional if "derived" in limits.sources.get(q, ())]
    if derived:
        warnings.append(
            f"The {' and '.join(derived)} limits are derived from the motion, for the ramps only: "
            "neither the URDF nor a limits file states any."
        )
    return warnings


# -- limits, torque, path --------------------------------------------------------------------------


def _limits_section(subject: _Subject) -> Section:
    """Margins to the limits of position, velocity, acceleration, jerk and torque."""
    margins = relative_margins(subject.trajectory)
    answer, tone = _limits_answer(
        [(r, m) for r, m in margins if m["limit"] != "torque"], subject.trajectory
    )
    head = ("limit", "joint", "at [s]", "value", "bound", "margin", "used")
    rows = [_margin_row(relative, m, subject.robot) for relative, m in margins]
    closest, others = Table(head, rows, (2, 3, 4, 5)).split(LISTED_MARGINS)
    figures = trajectory_figures.draw_kinematics(subject.scene)
    data = {
        "figures": [(title, Markup(svg)) for title, svg in figures],
        "closest": closest,
        "others": others,
        "others_summary": plural(len(others.rows), "more margin"),
    }
    return Section("limits", "Does it stay within its limits?", answer, data, tone)


def _limits_answer(
    margins: Sequence[tuple[float, Mapping[str, Any]]], trajectory: Trajectory
) -> tuple[str, str]:
    """Answer and tone."""
    if not margins:
        return "No limit of position, velocity, acceleration or jerk was checked.", ""
    spare = [_spare_share(relative, m, trajectory) for relative, m in margins]
    violated = [m for share, (_, m) in zip(spare, margins, strict=True) if share < -ROUNDING]
    relative, worst = margins[int(np.argmin(spare))]
    place = f"the {worst['limit']} of {worst['joint']} at {worst['time']:.2f} s"
    if violated:
        return f"No: {plural(len(violated), 'limit')} violated, the worst {place}.", "bad"
    words = _margin_words(relative, promised_share(trajectory, worst["limit"]))
    return f"Yes; closest is {place}, {words}.", ""


def _margin_row(
    relative: float, margin: Mapping[str, Any], robot: Robot
) -> tuple[str | TableCell, ...]:
    """Row of the table of margins."""
    limit, joint = str(margin["limit"]), str(margin["joint"])
    unit = _STAND_UNITS[joint] if limit == STAND else _UNITS.get(limit, "m")
    if joint in robot.joints:
        unit = robot.entries[robot.joints.index(joint)].unit(unit)
    is_violated = relative < -ROUNDING
    size = (
        f"{number(100.0 * relative, 2 if relative < 1.0 else 3) if abs(relative) >= 1e-4 else 0} %"
    )
    return (
        f"{limit} (ramps)" if margin.get("ramps_only") else limit,
        joint,
        f"{float(margin['time']):.2f}",
        number(float(margin["value"])),
        f"{number(float(margin['bound']))} {unit}",
        TableCell(size, tone="bad" if is_violated else ""),
        TableCell("", share=1.0 - relative, exceeded=is_violated),
    )


def _torque_section(subject: _Subject) -> Section:
    """Torques with their limits, for uncertain parameters too."""
    trajectory, robot = subject.trajectory, subject.robot
    radius = float(trajectory.design.get("uncertainty", 0.0))
    at_most = 1000 if robot.n <= COMPACT_LAYOUT_JOINTS else 600
    t = trajectory_figures.sample_times(trajectory.motion, at_most)
    nominal, width = torque_band(robot, subject.parameters, trajectory.motion.samples(t), radius)
    ratio = (np.abs(nominal) + width).max(axis=0) / trajectory.limits.torque
    worst = int(np.argmax(ratio))
    answer = (
        f"The most heavily loaded joint is {robot.joints[worst]}: it needs up to "
        f"{100.0 * ratio[worst]:.0f} % of its torque limit, "
    )
    answer += (
        f"for any robot within {number(radius)} of the nominal parameters."
        if radius
        else "for the nominal parameters."
    )
    data = {
        "figure": Markup(trajectory_figures.draw_torques(t, nominal, width, subject.scene)),
        "radius": number(radius) if radius else "",
        "mass_change": f"{100 * radius * np.sqrt(2.0):.0f} %",
    }
    return Section(
        "torque",
        "Are the torque limits sufficient?",
        answer,
        data,
        "bad" if ratio[worst] > 1 else "",
    )


def _stand_section(subject: _Subject, stand: Stand) -> Section:
    """Load on the stand that holds the base."""
    motion, robot = subject.trajectory.motion, subject.robot
    t = trajectory_figures.sample_times(motion, 1000)
    loads = stand_loads(robot, stand, motion.samples(t))
    bounds = {"force": stand.force, "moment": stand.moment}
    panels, used = [], []
    for values, (name, bound) in zip(loads.T, bounds.items(), strict=True):
        unit = _STAND_UNITS[name]
        panels.append(CurvePanel(f"{name} on the stand [{unit}]", t, values, (-np.inf, bound)))
        if np.isfinite(bound):
            peak = float(values.max())
            used.append(
                f"{number(peak, 3)} of {number(bound, 3)} {unit} ({100.0 * peak / bound:.0f} %)"
            )
    is_exceeded = any(
        margin["limit"] == STAND and relative < -ROUNDING
        for relative, margin in relative_margins(subject.trajectory)
    )
    answer = (
        f"{'No' if is_exceeded else 'Yes'}: its load reaches {' and '.join(used)}, the weight of "
        "the robot included."
    )
    point = ", ".join(f"{value:g}" for value in stand.point)
    data = {
        "figure": Markup(
            draw_curves("Load on the stand over time", panels, motion, columns=2, height=80.0)
        ),
        "point": point,
        "source": stand.source,
    }
    question = "Does the stand take the load?"
    return Section("stand", question, answer, data, "bad" if is_exceeded else "")


def _path_section(subject: _Subject) -> Section:
    """The space that the motion needs."""
    svg, extent = trajectory_figures.draw_path(subject.scene)
    is_single = len(trajectory_figures.branch_ends(subject.robot)) == 1
    box = " × ".join(f"{length:.2f}" for length in extent[1] - extent[0])
    answer = (
        f"The {'end of the robot stays' if is_single else 'ends of the robot stay'} in a box of "
        f"{box} m, between {number(float(extent[0, 2]), 3)} and {number(float(extent[1, 2]), 3)} m "
        "above the base's origin."
    )
    return Section("path", "Where in space does it move?", answer, {"figure": Markup(svg)})


# -- collision -------------------------------------------------------------------------------------


def _collision_section(
    trajectory: Trajectory, cell: Cell | None, nearest: Sequence[PairDistance]
) -> Section:
    """Least distances, and what was not checked."""
    question, answer = "Does it touch anything?", f"{capitalized(trajectory.collision)}."
    if cell is None:
        return Section("collision", question, answer, {"is_checked": False}, "bad")
    figures = []
    if nearest:
        figures = [
            collision_figures.draw_distances(cell, nearest, trajectory.motion),
            collision_figures.draw_nearest_moment(cell, nearest[0]),
        ]
    others = nearest[LISTED_PAIRS:]
    excepted = plural(len(cell.excepted), "pair")
    data = {
        "is_checked": True,
        "figures": [Markup(svg) for svg in figures],
        "nearest": Table(
            ("bodies", "least distance [mm]", "required [mm]", "at [s]"),
            [(*_distance_cells(entry), f"{entry.time:.2f}") for entry in nearest[:LISTED_PAIRS]],
            (1, 2, 3),
        ),
        "others": Table(
            ("bodies", "distance at least [mm]", "required [mm]"),
            [_distance_cells(entry) for entry in others],
            (1, 2),
        ),
        "others_summary": plural(len(others), "more pair"),
        "excepted": Table(
            ("body", "body", "reason"), [(e.first, e.second, e.why) for e in cell.excepted]
        ),
        "excepted_summary": f"{excepted} without the clearance of {1e3 * cell.margin:g} mm",
        "notes": list(cell.notes),
    }
    is_violated = any(entry.proven < entry.pair.margin for entry in nearest)
    return Section("collision", question, answer, data, "bad" if is_violated else "")


def _distance_cells(entry: PairDistance) -> tuple[str, str, str]:
    """Names of a pair of bodies, its least distance and the distance to keep [mm]."""
    return entry.names, f"{1e3 * entry.proven:.1f}", f"{1e3 * entry.pair.margin:.1f}"


# -- validation motion, time budget ----------------------------------------------------------------


def _validation_section(first: Trajectory, second: Trajectory, robot: Robot) -> Section:
    """Overlap of a second motion with the first."""
    facts = first.design["validation"]
    independent = facts["independent"]
    overlap = float(facts["overlap"])
    reference = (
        f"; another start of the design has {float(independent['overlap']):.2f}"
        if independent
        else ""
    )
    answer = (
        f"{'Yes' if overlap <= LARGE_OVERLAP else 'Only in part'}: the overlap of the motions is "
        f"{overlap:.2f} (0: nothing in common, 1: the same{reference}), and the criterion of the "
        f"second is {_compared(first, facts['criterion'])}."
    )
    rows = [
        (
            joint,
            f"{correlation:.2f}",
            *((f"{independent['torque_correlation'][joint]:.2f}",) if independent else ()),
        )
        for joint, correlation in facts["torque_correlation"].items()
    ]
    head = ("joint", "torque correlation", *(("another start",) if independent else ()))
    data = {
        "figure": Markup(validation_figure.draw_motion_pair(first, second, robot)),
        "table": Table(head, rows, (1, 2)),
        "width": f"{100 * facts['width']:.0f} %",
    }
    question = "Is the validation motion independent of the first?"
    return Section("validation", question, answer, data)


def _compared(trajectory: Trajectory, values: Mapping[str, float]) -> str:
    """Criterion of the second motion relative to the first, in words."""
    name = str(trajectory.design["criterion"])
    before, after = float(values["first"]), float(values["second"])
    if after == before:
        return "the same"
    is_worse = (after < before) == (name in ("d", "e"))
    difference = abs(after - before)
    size = f"{difference:.2g}" if name == "d" else f"{100.0 * abs(after / before - 1.0):.2g} %"
    return f"{size} {'worse' if is_worse else 'better'}"


def _plan_section(plan: Mapping[str, Any]) -> Section:
    """Choice of the period and the harmonics for a budget of robot time."""
    candidates = plan["candidates"]
    chosen = candidates[plan["chosen"]]
    least = min(float(c["deviation"]) for c in candidates)
    excess = [100.0 * (float(c["deviation"]) / least - 1.0) for c in candidates]
    above = excess[plan["chosen"]]
    answer = (
        f"{plan['budget']:g} s hold {chosen['repeats']} periods of {chosen['period']:g} s; with "
        f"{chosen['harmonics']} harmonics they predict "
        f"{f'within {above:.1f} % of the' if above > 0.0 else 'the'} least standard deviation of "
        f"the {len(candidates)} candidates."
    )
    head = (
        "period [s]",
        "harmonics",
        "repeats",
        "samples",
        "robot time [s]",
        "criterion per sample",
        "standard deviation",
    )
    rows = [
        (
            f"{c['period']:g}",
            f"{c['harmonics']}{' ← chosen' if c is chosen else ''}",
            f"{c['repeats']}",
            f"{c['samples']}",
            f"{c['robot_time']:.2f}",
            number(float(c["value"])),
            f"+{more:.1f} %",
        )
        for c, more in zip(candidates, excess, strict=True)
    ]
    svg = time_budget_figure.draw_candidates(
        candidates, excess, plan["chosen"], float(plan["tolerance"])
    )
    data = {
        "figure": Markup(svg),
        "table": Table(head, rows, (0, 2, 3, 4, 5, 6)),
        "tolerance": f"{100 * plan['tolerance']:.0f} %",
    }
    return Section("plan", "Why this period and these harmonics?", answer, data)
