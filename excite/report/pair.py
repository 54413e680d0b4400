"""Sections of what a design may have besides its motion: a second one for validation, and a plan for a budget of robot time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..robot.robot import Robot
from ..trajectory.trajectory_file import Trajectory
from .figures.drawing import BLUE, INK, COMPACT_LAYOUT_JOINTS, axes_grid, limit_ticks, render_svg
from .figures.small_multiples import Plane, planes
from .figures.trajectory import is_prismatic, short
from .page import Section, escape, figure, number, paragraph, table

Array = np.ndarray
_LIKE = 0.7
"""Overlap beyond which more than half of the variance of an error in one motion returns in the other."""


def validation_section(first: Trajectory, second: Trajectory, robot: Robot) -> Section:
    """(i) Is the second motion a different one that asks for the same parameters?"""
    facts = first.design["validation"]
    independent = facts["independent"]
    value, usual = (
        float(facts["overlap"]),
        None if independent is None else float(independent["overlap"]),
    )
    beside = "" if usual is None else f"; another start of the design comes to {usual:.2f}"
    answer = f"{'Yes' if value <= _LIKE else 'Only in part'}: the motions overlap by {value:.2f} (0 no common ground, 1 the same{beside})"
    answer += f", and the criterion of the second is {_compared(first, facts['criterion'])}."
    head = ("joint", "torque correlation", *(("another start",) if independent else ()))
    rows = [
        (
            escape(joint),
            f"{c:.2f}",
            *((f"{independent['torque_correlation'][joint]:.2f}",) if independent else ()),
        )
        for joint, c in facts["torque_correlation"].items()
    ]
    note = (
        "Overlap: an unknown error that is a random function of each joint's own place and speed has means along the two motions "
        f"that correlate by this; the function varies over {100 * facts['width']:.0f} % of half the range (at most half a turn) and of the "
        "speed limit, and speeds of both signs count as one. Torque correlation: the largest magnitude over all shifts in time; with a "
        "few harmonics half of it and more is chance. Fit the parameters to recordings of the first motion, and judge the model by its "
        "torque on the second, which is in the folder validation."
    )
    body = (
        figure(_planes(first, second, robot)) + table(head, rows, (1, 2)) + paragraph(note, "note")
    )
    return Section(
        "validation", "Is the validation motion another one that asks for the same?", answer, body
    )


def _compared(trajectory: Trajectory, values: Mapping[str, float]) -> str:
    name, before, after = (
        str(trajectory.design["criterion"]),
        float(values["first"]),
        float(values["second"]),
    )
    worse = (after < before) == (name in ("d", "e"))
    size = (
        f"{abs(after - before):.2g}"
        if name == "d"
        else f"{100.0 * abs(after / before - 1.0):.2g} %"
    )
    return f"{size} {'worse' if worse else 'better'}" if after != before else "the same"


def _planes(first: Trajectory, second: Trajectory, robot: Robot) -> str:
    """Speed against place of every joint over a period, both motions."""
    curves = []
    for trajectory in (first, second):
        fourier = trajectory.motion.fourier
        t = fourier.grid(300 if robot.n <= COMPACT_LAYOUT_JOINTS else 150)
        curves.append(np.stack([fourier.at(t), fourier.at(t, 1)], axis=-1))
    limits, sliding = first.limits, is_prismatic(robot)
    # a whole turn away is the same place; only joints that may turn so far are shown there
    free = np.array([not slides for slides in sliding]) & (
        limits.position[:, 1] - limits.position[:, 0] >= 2.0 * np.pi
    )
    apart = second.motion.fourier.offset - first.motion.fourier.offset
    curves[1][:, :, 0] -= np.where(free, 2.0 * np.pi * np.rint(apart / (2.0 * np.pi)), 0.0)
    panels = [
        Plane(
            f"{short(joint)} (m)" if slides else short(joint), curves[0][:, j], curves[1][:, j],
            (-np.inf, np.inf) if free[j] else (float(limits.position[j, 0]), float(limits.position[j, 1])),
            (-float(limits.velocity[j]), float(limits.velocity[j])),
        )
        for j, (joint, slides) in enumerate(zip(robot.joints, sliding, strict=True))
    ]  # fmt: skip
    columns, height = (min(robot.n, 3), 110.0) if robot.n <= COMPACT_LAYOUT_JOINTS else (5, 80.0)
    axes = (
        f"velocity [rad/s] against position [rad]{', whole turns left out' if free.any() else ''}"
    )
    return planes(
        "Velocity against position of every joint",
        panels,
        ("motion", "validation"),
        axes,
        columns=columns,
        height=height,
    )


def plan_section(plan: Mapping[str, Any]) -> Section:
    """(j) Why this period and these harmonics?"""
    candidates = plan["candidates"]
    chosen = candidates[plan["chosen"]]
    least = min(float(c["deviation"]) for c in candidates)
    excess = [100.0 * (float(c["deviation"]) / least - 1.0) for c in candidates]
    above = excess[plan["chosen"]]
    rank = f"within {above:.1f} % of the" if above > 0.0 else "the"
    answer = f"Into {plan['budget']:g} s fit {chosen['repeats']} periods of {chosen['period']:g} s; with {chosen['harmonics']} harmonics "
    answer += f"they predict {rank} least standard deviation of the {len(candidates)} ways tried."
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
    note = (
        "Each way fills the time and was optimised for a few iterations from one start; the standard deviation is what all its samples "
        f"predict, above the least. The one with the fewest harmonics and samples within {100 * plan['tolerance']:.0f} % was chosen and "
        "optimised to the end."
    )
    body = (
        figure(_trade_off(candidates, excess, plan))
        + table(head, rows, (0, 2, 3, 4, 5, 6))
        + paragraph(note, "note")
    )
    return Section("plan", "Why this period and these harmonics?", answer, body)


def _trade_off(
    candidates: list[Mapping[str, Any]], excess: list[float], plan: Mapping[str, Any]
) -> str:
    """Standard deviation against period; the number at each point is that of harmonics."""
    period, above = np.array([float(c["period"]) for c in candidates]), np.array(excess)

    def draw(canvas: Any) -> None:
        axes = axes_grid(canvas, 1, 1, margins=(0.6, 0.2, 0.32, 0.42))[0, 0]
        axes.plot(
            period, above, "o", color=BLUE, markersize=4, label="tried, with so many harmonics"
        )
        for c, x, y in zip(candidates, period, above, strict=True):
            most = c["harmonics"] == max(
                other["harmonics"] for other in candidates if other["period"] == c["period"]
            )
            axes.annotate(
                f"{c['harmonics']}",
                (x, y),
                (7, 1 if most else -7),
                textcoords="offset points",
                fontsize=8,
            )
        place = (period[plan["chosen"]], above[plan["chosen"]])
        axes.plot(
            *place,
            "o",
            markersize=9,
            markerfacecolor="none",
            markeredgecolor=INK,
            linestyle="",
            label="chosen",
        )
        axes.axhline(
            100.0 * plan["tolerance"],
            color=INK,
            linewidth=0.8,
            dashes=(4, 2),
            label="as good as the least",
        )
        limit_ticks(axes, 8, 5)
        axes.set_xlim(0.0, 1.1 * period.max())
        axes.set_ylim(-0.06 * max(above.max(), 10.0), 1.12 * max(above.max(), 10.0))
        axes.set_xlabel("period [s]")
        axes.set_ylabel("standard deviation above the least [%]")
        handles, labels = axes.get_legend_handles_labels()
        canvas.legend(
            handles,
            labels,
            loc="upper left",
            ncols=3,
            bbox_to_anchor=(0.05, 1.0),
            borderaxespad=0.2,
        )

    return render_svg("Standard deviation against period and harmonics", 2.6, draw)
