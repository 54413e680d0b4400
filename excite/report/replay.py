"""Report of `excite replay`: recorded and simulated positions under the recorded commands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ..exporters.mjcf_file import HOLDS
from ..exporters.mujoco_replay import (
    PositionLoop,
    ReplayErrors,
    ReplayInput,
    fitting_horizons,
)
from ..exporters.simulator_model import SimulatorModel
from ..trajectory.trajectory_file import package_versions
from .content import Banner, ReportContent, Section, Table
from .figures.drawing import BLUE, INK, ORANGE, axes_grid, limit_ticks, render_svg, thin_curve
from .formatting import number
from .render import render

DRAWN_POINTS = 1200
"""Points of a curve; more are not visible at the width of the figure."""


def replay_page(
    model: SimulatorModel,
    source: str,
    data: ReplayInput,
    loop: PositionLoop | None,
    errors: Sequence[ReplayErrors],
) -> str:
    """Render the report of a replay as HTML.

    Args:
        model: The identified robot.
        source: Name of the recording.
        data: The stretch that was replayed.
        loop: Position loop; None: the torque was replayed.
        errors: Errors of each robot, the robot as described first.
    """
    before, after = (float(np.sqrt(np.mean(e.position**2))) for e in (errors[0], errors[-1]))
    command = "recorded torque" if loop is None else "commanded positions"
    verdict = (
        f"Free run of {number(float(data.t[-1]), 3)} s under the {command}: position error "
        f"{number(before, 3)} before, {number(after, 3)} after (RMS over joints, rad or m)."
    )
    content = ReportContent(
        title=f"Replay of {Path(source).name} with {model.model.robot.name}",
        subtitle="The exported robot in MuJoCo under the recorded commands.",
        banners=[Banner(verdict, "good" if after < before else "warn")],
        cards=[
            (number(before, 3), "position error before [rad or m]"),
            (number(after, 3), "position error after [rad or m]"),
        ],
        sections=[
            _free_section(model, data, errors, loop is None),
            _horizon_section(model, data, errors),
            *([] if loop is None else [_loop_section(model, loop)]),
            _remainder_section(model),
        ],
        footer=f"excite {package_versions()['excite']}",
    )
    return render("summary", content)


def _free_section(
    model: SimulatorModel, data: ReplayInput, errors: Sequence[ReplayErrors], is_torque: bool
) -> Section:
    """The simulation from the first recorded state to the end."""
    rows = []
    for j, joint in enumerate(model.joints):
        row = [joint]
        for e in errors:
            row += [number(float(e.position[j]), 3), number(float(e.torque[j]), 3)]
        rows.append(tuple(row))
    head = ["joint"]
    for e in errors:
        head += [f"position, {e.name}", f"torque, {e.name}"]
    lost = [
        f"{e.name}: lost at {number(e.lost, 3)} s, from where the error counts as 1 rad or m"
        for e in errors
        if e.lost is not None
    ]
    answer = "RMS of simulated minus recorded position [rad or m] and motor torque [N m or N]."
    if is_torque:
        answer += " Under replayed torque nothing pulls the robot back: errors grow with time."
    return Section(
        "free",
        "How far does the simulated robot deviate in a free run?",
        answer,
        {
            "figures": [Markup(draw_replay(model.joints, data, errors))],
            "tables": [Table(head, rows, tuple(range(1, len(head))))],
            "notes": lost,
        },
    )


def _horizon_section(
    model: SimulatorModel, data: ReplayInput, errors: Sequence[ReplayErrors]
) -> Section:
    """Simulations of short windows from recorded states."""
    rows = []
    for k, horizon in enumerate(fitting_horizons(data)):
        for j, joint in enumerate(model.joints):
            values = [number(float(e.horizons[k, j]), 3) for e in errors]
            rows.append((f"{horizon:g} s", joint, *values))
    head = ["horizon", "joint", *(e.name for e in errors)]
    return Section(
        "horizons",
        "How far does it deviate over short horizons?",
        "RMS position error over windows that start from the recorded state [rad or m].",
        {"tables": [Table(head, rows, tuple(range(2, len(head))))]},
    )


def _loop_section(model: SimulatorModel, loop: PositionLoop) -> Section:
    """The position loop."""
    fitted = loop.explained is not None
    rows = []
    for j, joint in enumerate(model.joints):
        share = "–" if loop.explained is None else f"{100.0 * float(loop.explained[j]):.1f} %"
        values = [loop.forward[j], *loop.gains[:, j], loop.constant[j]]
        rows.append((joint, *(number(float(v), 4) for v in values), share))
    head = (
        "joint",
        "feed-forward",
        "Kp [N m/rad]",
        "Kd [N m s/rad]",
        "Ki [N m/(rad s)]",
        "constant [N m]",
        "explained torque",
    )
    answer = (
        "The loop is fitted to the recorded torque; both robots have the same one."
        if fitted
        else "The gains are stated; both robots have the same ones."
    )
    return Section(
        "loop",
        "Which position loop follows the commands?",
        answer,
        {"tables": [Table(head, rows, tuple(range(1, 7)))]},
    )


def _remainder_section(model: SimulatorModel) -> Section:
    """The parts of the model that MJCF does not hold."""
    parts = model.remainders(HOLDS)
    answer = (
        "The friction module adds what MJCF has no field for."
        if parts
        else "Nothing: MJCF holds everything that was identified."
    )
    return Section(
        "remainder",
        "What does the exported MJCF not hold?",
        answer,
        {"notes": [part.text for part in parts]},
    )


def draw_replay(joints: Sequence[str], data: ReplayInput, errors: Sequence[ReplayErrors]) -> str:
    """Draw recorded and simulated positions, and their difference, one row a joint, as SVG.

    Args:
        joints: Names of the joints.
        data: The recording.
        errors: Errors of each robot, the robot as described first.
    """
    curves = (errors[0], ORANGE), (errors[-1], BLUE)

    def draw(figure: Any) -> None:
        axes = axes_grid(figure, len(joints), 2, margins=(0.65, 0.15, 0.45, 0.4), gaps=(0.6, 0.22))
        for j, joint in enumerate(joints):
            left, right = axes[j]
            left.plot(
                *thin_curve(data.t, data.motion.q[:, j], DRAWN_POINTS), color=INK, label="recorded"
            )
            for e, color in curves:
                q = np.where(np.isfinite(e.free.q[:, j]), e.free.q[:, j], np.nan)
                inside = np.abs(q - data.motion.q[:, j]) < 1.0
                shown = np.where(inside, q, np.nan)
                left.plot(*thin_curve(data.t, shown, DRAWN_POINTS), color=color, label=e.name)
                right.plot(
                    *thin_curve(data.t, shown - data.motion.q[:, j], DRAWN_POINTS), color=color
                )
            left.set_ylabel("rad or m")
            left.set_title(joint, loc="left", pad=3)
            for axis in (left, right):
                limit_ticks(axis, 6)
                axis.set_xlim(0.0, data.t[-1])
                axis.tick_params(labelbottom=j == len(joints) - 1)
        axes[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
        axes[0, 1].set_title("simulated − recorded", loc="right", pad=3)
        for axis in axes[-1]:
            axis.set_xlabel("t [s]")

    height = 0.85 + 1.15 * len(joints)
    return render_svg("Recorded and simulated positions", height, draw)
