"""What two encoders say of the gears between them: the part of a diagnosis's report that only some robots have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..diagnosis.diagnosis import Diagnosis
from ..diagnosis.gear_encoders import GearEstimate
from ..robot.parameter_names import listed, percent
from .figures.drawing import GREY, INK, ORANGE, limit_ticks, render_panels
from .figures.trajectory import short, torque_units
from .page import Section, escape, figure, number, paragraph, table

_HEIGHT, _DOTS = 1.9, 1500


def section(found: Diagnosis, stated: Mapping[str, Any]) -> Iterator[Section]:
    """One section, or none where no joint has two encoders."""
    told = stated["encoders"]
    if not told:
        return
    stiff = [
        f"{joint} {number(v['stiffness']['value'], 3)} {v['stiffness']['unit']}"
        for joint, v in told.items()
        if v["stiffness"]
    ]
    taken = 1.0 - float(np.median([v["after"] / v["before"] for v in told.values()]))
    answer = (
        f"Torque winds the gears up: {listed(stiff)}."
        if stiff
        else "No gear winds up enough to be seen."
    )
    answer += f" With play, friction and the time between their readings this takes {percent(taken)} of how they differ, held out."
    rows = [
        (
            escape(joint),
            *(_with(v[k]) for k in ("stiffness", "lost_motion", "read_apart")),
            number(v["before"], 3),
            number(v["after"], 3),
        )
        for joint, v in told.items()
    ]
    head = ("joint", "stiffness", "lost motion", "read apart by", "RMS difference", "unexplained")
    note = "Motor's position less the link's: torque over stiffness, play where torque changes its sign, friction that holds some "
    note += "back, and speed times the time by which the link's encoder is read later. Not stated: a stiffness as good as infinite, a "
    note += "play that is none or where torque keeps its sign. Dots: held out, without friction, that time, and what an encoder off its "
    note += "centre errs by once a turn; orange: stiffness and play."
    yield Section(
        "gears",
        "What do the two encoders say?",
        answer,
        table(head, rows) + figure(_curves(found)) + paragraph(note, "note"),
    )


def _with(value: Mapping[str, Any] | None) -> str:
    return (
        "–"
        if value is None
        else escape(f"{number(value['value'], 3)} ± {number(value['std'], 2)} {value['unit']}")
    )


def _curves(found: Diagnosis) -> str:
    """Wind-up over the torque carried, a panel a joint."""
    robot = found.identified.model.robot
    units = torque_units(robot)

    def draw(axes: Any, gear: GearEstimate) -> None:
        _panel(axes, gear)
        linear = units[gear.joint] == "N"
        axes.set_title(
            f"{short(robot.joints[gear.joint], 20)} [{'mm' if linear else 'mrad'}]",
            loc="left",
            fontweight="bold",
            pad=3,
        )
        axes.set_xlabel(f"torque that the gear carries [{units[gear.joint]}]")

    return render_panels("Wind-up of the gears between two encoders", found.gears, draw, _HEIGHT)


def _panel(axes: Any, gear: GearEstimate) -> None:
    load = np.linspace(gear.load.min(), gear.load.max(), 101)
    axes.axhline(0.0, color=GREY, linewidth=0.5)
    shown = slice(None, None, -(-len(gear.load) // _DOTS))
    axes.plot(
        gear.load[shown], 1e3 * gear.windup[shown], ".", color=INK, markersize=1.5, alpha=0.35
    )
    axes.plot(load, 1e3 * gear.curve(load), color=ORANGE, linewidth=1.2)
    limit_ticks(axes, 5, 4)
