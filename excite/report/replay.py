"""Report of `excite replay`: recorded and simulated positions under the recorded commands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from .._types import FloatArray
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
            "figures": [Markup(_drawing(model.joints, data, errors))],
            "tables": [Table(head, rows, tuple(range(1, len(head))))],
            "notes": lost,
        },
    )


def _drawing(joints: Sequence[str], data: ReplayInput, errors: Sequence[ReplayErrors]) -> str:
    """Positions of the robot as described and as identified, as SVG."""
    before, after = ((e.name, e.free.q) for e in (errors[0], errors[-1]))
    return draw_replay(joints, data.t, data.q, before, after)


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
    rows = []
    for j, joint in enumerate(model.joints):
        share = "–" if loop.explained is None else f"{100.0 * float(loop.explained[j]):.1f} %"
        values = [loop.forward[j], *loop.gains[:, j], loop.constant[j], 1e3 * loop.delay[j]]
        values.append(1e3 * loop.lag[j])
        rows.append((joint, *(number(float(v), 4) for v in values), share))
    head = (
        "joint",
        "feed-forward",
        "Kp [N m/rad or N/m]",
        "Kd [N m s/rad or N s/m]",
        "Ki [N m/(rad s) or N/(m s)]",
        "constant [N m or N]",
        "delay [ms]",
        "lag [ms]",
        "explained torque",
    )
    answers = {
        "fitted": "The loop is fitted to the recorded torque; both robots have the same one.",
        "stated": "The gains are stated; both robots have the same ones.",
        "model": "The loop was identified with the model; both robots have the same one.",
    }
    return Section(
        "loop",
        "Which position loop follows the commands?",
        answers[loop.origin],
        {"tables": [Table(head, rows, tuple(range(1, len(head))))]},
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


def draw_replay(
    joints: Sequence[str],
    t: FloatArray,
    recorded: FloatArray,
    before: tuple[str, FloatArray],
    after: tuple[str, FloatArray],
) -> str:
    """Draw recorded and other positions, and their difference, one row a joint, as SVG.

    Args:
        joints: Names of the joints.
        t: Times. Shape (N,) [s].
        recorded: Recorded positions. Shape (N, n) [rad or m].
        before: Name and positions before the identification. Shape (N, n) [rad or m].
        after: The same after it.
    """
    curves = (*before, ORANGE), (*after, BLUE)

    def draw(figure: Any) -> None:
        axes = axes_grid(figure, len(joints), 2, margins=(0.65, 0.15, 0.45, 0.4), gaps=(0.6, 0.22))
        for j, joint in enumerate(joints):
            left, right = axes[j]
            left.plot(*thin_curve(t, recorded[:, j], DRAWN_POINTS), color=INK, label="recorded")
            for name, positions, color in curves:
                q = np.where(np.isfinite(positions[:, j]), positions[:, j], np.nan)
                shown = np.where(np.abs(q - recorded[:, j]) < 1.0, q, np.nan)
                left.plot(*thin_curve(t, shown, DRAWN_POINTS), color=color, label=name)
                right.plot(*thin_curve(t, shown - recorded[:, j], DRAWN_POINTS), color=color)
            left.set_ylabel("rad or m")
            left.set_title(joint, loc="left", pad=3)
            for axis in (left, right):
                limit_ticks(axis, 6)
                axis.set_xlim(t[0], t[-1])
                axis.tick_params(labelbottom=j == len(joints) - 1)
        axes[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
        axes[0, 1].set_title("simulated − recorded", loc="right", pad=3)
        for axis in axes[-1]:
            axis.set_xlabel("t [s]")

    height = 0.85 + 1.15 * len(joints)
    return render_svg("Recorded and simulated positions", height, draw)
