"""The report of a design: does the motion obey its limits, what will it show, and how did it come about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..collision.continuous_check import Near
from ..collision.workcell import Cell
from ..designer.certificate import CLEARANCE
from ..designer.experiment_comparison import Scenario, what_would_help
from ..designer.identifiability import Identifiability
from ..robot.base_parameters import Base
from ..robot.dynamics import torque_band
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from ..trajectory.trajectory_file import Trajectory, versions
from .collision import collision_section
from .figures import trajectory as trajectory_module
from .figures.drawing import MANY
from .figures.trajectory import Scene
from .identifiability import headline, sections
from .origin import criteria_section, history_section, made_section
from .page import (
    Section,
    banner,
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
from .pair import plan_section, validation_section
from .record import DesignRecord

_ROUNDING = 1e-9
_UNITS = {
    "position": "rad",
    "velocity": "rad/s",
    "acceleration": "rad/s²",
    "jerk": "rad/s³",
    "torque": "N m",
    "braking": "rad",
}
_CLOSEST = 12
CRITERIA = {
    "a": "A, sum of variances (lower is better)",
    "d": "D, log volume (higher is better)",
    "e": "E, least eigenvalue (higher is better)",
    "cond": "condition number (lower is better)",
    "cond_regressor": "condition of the regressor (lower is better)",
}


@dataclass(frozen=True)
class Design:
    """What the report is about."""

    trajectory: Trajectory
    robot: Robot
    parameters: Parameters
    base: Base
    found: Identifiability
    record: DesignRecord
    cell: Cell | None = None

    @property
    def scene(self) -> Scene:
        """What the figures of the motion need."""
        return Scene(self.trajectory.motion, self.trajectory.limits, self.robot, self.cell)


def design_page(
    trajectory: Trajectory,
    robot: Robot,
    parameters: Parameters,
    base: Base,
    identifiability: Identifiability,
    record: DesignRecord,
    *,
    cases: Sequence[Scenario] | None = None,
    second: Trajectory | None = None,
    cell: Cell | None = None,
    near: Sequence[Near] = (),
) -> str:
    """The report of a design as HTML. cases: what `what_would_help` found; None: computed here. second: for validation.

    cell, near: what must not be touched, and the least distances, where collisions were checked.
    """
    subject = Design(trajectory, robot, parameters, base, identifiability, record, cell)
    if cases is None:
        cases = what_would_help(
            robot, parameters, base, trajectory.limits, trajectory.motion,
            noise=trajectory.noise, rate=trajectory.rate, threshold=identifiability.threshold,
        )  # fmt: skip
    parts = [
        limits_section(subject),
        torque_section(subject),
        collision_section(trajectory, cell, near),
        *sections(identifiability, parameters, cases),
        path_section(subject),
        *([] if second is None else [validation_section(trajectory, second, robot)]),
        *([plan_section(trajectory.design["plan"])] if "plan" in trajectory.design else []),
        history_section(record),
        criteria_section(trajectory),
        made_section(trajectory, robot, parameters, record),
    ]
    lede = "An excitation trajectory for identification: what it obeys, what it will show, and how it was found."
    return page(
        f"Excitation of {robot.name}",
        lede,
        _head(subject),
        parts,
        f"excite {versions()['excite']}, seed {trajectory.seed}",
    )


# -- header --------------------------------------------------------------------------------------------------


def _head(subject: Design) -> str:
    t = subject.trajectory
    motion = t.motion
    name = str(t.design.get("criterion", "a"))
    value = criterion_value(t.criteria, name, bool(t.design.get("plain", False)))
    what = CRITERIA.get(name, name)
    entries = [
        *headline(subject.found, subject.robot, subject.base),
        (
            f"{motion.duration:.1f} s",
            f"from rest to rest, {motion.periods} periods of {motion.fourier.period:g} s",
        ),
        (number(value), f"criterion: {what}, per sample"),
    ]
    return (
        cards(entries)
        + _verdict(t)
        + "".join(banner(text, "warn") for text in warnings_of(subject))
    )


def criterion_value(
    criteria: Mapping[str, Any], name: str, plain: bool, part: str = "optimum"
) -> float | None:
    """One number of a trajectory's `criteria`, None where it is absent."""
    entries = criteria.get(part, {})
    value = (
        entries.get(name)
        if name == "cond_regressor"
        else entries.get("plain" if plain else "geometric", {}).get(name)
    )
    return None if value is None else float(value)


def rooms(trajectory: Trajectory) -> list[tuple[float, Mapping[str, Any]]]:
    """Every margin with its room, a share of the half width of the allowed range; the closest first."""
    return sorted(((_room(m, trajectory), m) for m in trajectory.margins), key=lambda pair: pair[0])


def _room(margin: Mapping[str, Any], trajectory: Trajectory) -> float:
    if margin.get("margin") is not None:
        return float(margin["margin"])
    value, bound = float(margin["value"]), float(margin["bound"])
    if margin["limit"] == "position" and margin["joint"] in trajectory.joints:
        lower, upper = trajectory.limits.position[trajectory.joints.index(margin["joint"])]
        return float(min(value - lower, upper - value) / (0.5 * (upper - lower)))
    return 1.0 - value / bound if bound else -value


def _verdict(trajectory: Trajectory) -> str:
    """Both parts of the certificate, clearance and limits, as banners."""
    return _clearance_banner(trajectory) + _limits_banner(trajectory)


def _limits_banner(trajectory: Trajectory) -> str:
    closest = [(room, margin) for room, margin in rooms(trajectory) if margin["limit"] != CLEARANCE]
    if not closest:
        return banner("Limits: not checked.", "bad")
    room, worst = closest[0]
    broken = sum(1 for r, _ in closest if r < -_ROUNDING)
    if broken:
        reason = f"{plural(broken, 'limit')} broken, worst the {worst['limit']} of {worst['joint']}"
        return banner(f"Limits: FAILED. {reason}. Do not run this motion.", "bad")
    if trajectory.forced:
        return banner("Written although a check failed (--force). Do not run this motion.", "bad")
    text = f"Limits: certified. All {len(closest)} hold; the closest is the {worst['limit']} of {worst['joint']}, {_room_words(room)}."
    return banner(text, "good")


def _room_words(room: float) -> str:
    return "right at its bound" if room < 5e-4 else f"with {100.0 * room:.2g} % to spare"


def _clearance_banner(trajectory: Trajectory) -> str:
    text = trajectory.collision
    if "not checked" in text:
        more = "The motion was not tested against the robot's own body or its surroundings. Watch the first run at low speed."
        return banner(f"Clearance: not checked; {text}. {more}", "warn")
    short = any(
        room < -_ROUNDING for room, margin in rooms(trajectory) if margin["limit"] == CLEARANCE
    )
    if short or text.startswith("COLLISION"):
        return banner(f"Clearance: FAILED; {text}. Do not run this motion.", "bad")
    return banner(f"Clearance: certified; {text}.", "good")


def warnings_of(subject: Design) -> list[str]:
    """What a user should know before running the motion."""
    out = list(subject.record.notes)
    if subject.parameters.repaired:
        out.append(
            f"No proper body in {', '.join(subject.parameters.repaired)}: the metric uses a substitute for its inertia."
        )
    missing = [
        q
        for q in ("acceleration", "jerk")
        if not np.isfinite(getattr(subject.trajectory.limits, q)).all()
    ]
    if missing:
        out.append(
            f"No {' or '.join(missing)} limit is stated for some joints; none was enforced there."
        )
    derived = [
        q
        for q in ("acceleration", "jerk")
        if "derived" in subject.trajectory.limits.sources.get(q, ())
    ]
    if derived:
        text = f"The {' and '.join(derived)} limits are derived from the motion, for the ramps only"
        out.append(f"{text}: neither the URDF nor a limits file states any.")
    return out


# -- limits --------------------------------------------------------------------------------------------------


def limits_section(subject: Design) -> Section:
    """(b) Does it stay within its limits?"""
    trajectory = subject.trajectory
    every = rooms(trajectory)
    kinematic = [(r, m) for r, m in every if m["limit"] != "torque"]
    answer = _limits_answer(kinematic)
    body = "".join(figure(svg) for svg in trajectory_module.kinematics(subject.scene))
    head = ("limit", "joint", "at [s]", "value", "bound", "room", "used")
    listing = [_margin_row(room, m, subject.robot) for room, m in every]
    body += f"<h3>The {min(_CLOSEST, len(listing))} closest margins</h3>" + table(
        head, listing[:_CLOSEST], (2, 3, 4, 5)
    )
    if len(listing) > _CLOSEST:
        body += folded(
            f"{len(listing) - _CLOSEST} more margins", table(head, listing[_CLOSEST:], (2, 3, 4, 5))
        )
    body += paragraph(
        "Room is the distance to the bound as a share of the half width of the allowed range, at the worst moment of the motion.",
        "note",
    )
    return Section(
        "limits",
        "Does it stay within its limits?",
        answer,
        body,
        "bad" if answer.startswith("No") else "",
    )


def _limits_answer(margins: Sequence[tuple[float, Mapping[str, Any]]]) -> str:
    if not margins:
        return "No limit of position, velocity, acceleration or jerk was checked."
    broken = [m for r, m in margins if r < -_ROUNDING]
    if broken:
        worst = broken[0]
        return f"No: {plural(len(broken), 'limit')} broken, worst the {worst['limit']} of {worst['joint']} at {worst['time']:.2f} s."
    room, worst = margins[0]
    return f"Yes; closest is the {worst['limit']} of {worst['joint']} at {worst['time']:.2f} s, {_room_words(room)}."


def _margin_row(room: float, margin: Mapping[str, Any], robot: Robot) -> tuple[str, ...]:
    limit, joint = str(margin["limit"]), str(margin["joint"])
    unit = _UNITS.get(limit, "m")
    if joint in robot.joints:
        unit = robot.entries[robot.joints.index(joint)].unit(unit)
    return (
        escape(limit),
        escape(joint),
        f"{float(margin['time']):.2f}",
        number(float(margin["value"])),
        f"{number(float(margin['bound']))} {unit}",
        f'<span class="{"bad" if room < -_ROUNDING else ""}">{number(100.0 * room, 2) if abs(room) >= 1e-4 else "0"} %</span>',
        meter(1.0 - room, broken=room < -_ROUNDING),
    )


def torque_section(subject: Design) -> Section:
    """(c) Are the drives strong enough, for uncertain parameters too?"""
    trajectory, robot = subject.trajectory, subject.robot
    radius = float(trajectory.design.get("uncertainty", 0.0))
    t = trajectory_module.dense(trajectory.motion, 1000 if robot.n <= MANY else 600)
    nominal, width = torque_band(robot, subject.parameters, trajectory.motion.samples(t), radius)
    ratio = (np.abs(nominal) + width).max(axis=0) / trajectory.limits.torque
    worst = int(np.argmax(ratio))
    answer = f"The most loaded drive is {robot.joints[worst]}: up to {100.0 * ratio[worst]:.0f} % of its torque limit"
    answer += (
        f", for any robot within {number(radius)} of the nominal parameters."
        if radius
        else ", for the nominal parameters."
    )
    note = (
        f"The band holds the torque of every robot within r = {number(radius)} of the nominal parameters in the metric, exactly "
        f"(r = {number(radius)} is a change of one mass by about {100 * radius * np.sqrt(2.0):.0f} %)."
        if radius
        else "No uncertainty of the robot's parameters was asked for."
    )
    svg = trajectory_module.torques(t, nominal, width, subject.scene)
    return Section(
        "torque", "Are the drives strong enough?", answer, figure(svg) + paragraph(note, "note")
    )


def path_section(subject: Design) -> Section:
    """(h) Where in space does it move?"""
    svg, extent = trajectory_module.path(subject.scene)
    size, single = extent[1] - extent[0], len(trajectory_module.branch_ends(subject.robot)) == 1
    box = " × ".join(f"{length:.2f}" for length in size)
    answer = f"The {'end of the robot stays' if single else 'ends of the robot stay'} in a box of {box} m, "
    answer += f"between {number(float(extent[0, 2]), 3)} and {number(float(extent[1, 2]), 3)} m above the base's origin."
    return Section("path", "Where in space does it move?", answer, figure(svg))
