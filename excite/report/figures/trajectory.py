"""What the motion looks like: joint curves, torques, the path in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ...collision.workcell import Cell
from ...robot.limits import Limits
from ...robot.robot import Robot
from ...trajectory.rest_to_rest import Motion
from ..page import escape
from .collision import VIEWS, fill, outlines, window
from .drawing import BLUE, GREY, INK, COMPACT_LAYOUT_JOINTS, ORANGE, SEGMENT_WORDS, axes_grid, render_svg
from .small_multiples import Panel, small_multiples

Array = np.ndarray
QUANTITIES = ("position", "velocity", "acceleration", "jerk")
_UNITS = {"position": "{}", "velocity": "{}/s", "acceleration": "{}/s²", "jerk": "{}/s³"}


@dataclass(frozen=True)
class Scene:
    """What is drawn: a motion, the limits it should obey, the robot that moves, and all bodies where their shapes are known."""

    motion: Motion
    limits: Limits
    robot: Robot
    cell: Cell | None = None


def dense(motion: Motion, most: int) -> Array:
    """Times that cover the whole motion, at most `most` [s]."""
    return np.linspace(
        0.0, motion.duration, int(min(most, max(400, np.ceil(motion.duration * 200.0))))
    )


def is_prismatic(robot: Robot) -> list[bool]:
    """Which of the moving joints slide."""
    return [entry.kind == "prismatic" for entry in robot.entries]


def torque_units(robot: Robot) -> list[str]:
    """What the torque of each moving joint is measured in."""
    return [entry.unit("N m") for entry in robot.entries]


def kinematics(scene: Scene) -> list[str]:
    """Position, velocity, acceleration and jerk of every joint with their limits: one figure, or one per quantity."""
    motion, robot = scene.motion, scene.robot
    t = dense(motion, 4000)[1:-1]  # jerk is not defined at the two ends
    curves = [motion.at(t, order) for order in range(4)]
    sliding = is_prismatic(robot)
    unit = "m" if all(sliding) else "rad" if not any(sliding) else "rad or m"
    heads = [f"{quantity} [{_UNITS[quantity].format(unit)}]" for quantity in QUANTITIES]

    def panel(order: int, j: int, title: str) -> Panel:
        return Panel(title, t, curves[order][:, j], _bounds(scene.limits, QUANTITIES[order], j))

    names = [
        f"{short(joint)} (m)" if slides and not all(sliding) else short(joint)
        for joint, slides in zip(robot.joints, sliding, strict=True)
    ]
    if robot.n <= COMPACT_LAYOUT_JOINTS:
        cells = [
            panel(order, j, names[j] if order == 0 else "")
            for j in range(robot.n)
            for order in range(4)
        ]
        return [
            small_multiples(
                "Position, velocity, acceleration and jerk of every joint",
                cells,
                motion,
                columns=4,
                height=62.0,
                heads=heads,
            )
        ]
    return [
        f"<h3>{escape(heads[order].capitalize())}</h3>"
        + small_multiples(
            heads[order],
            [panel(order, j, names[j]) for j in range(robot.n)],
            motion,
            columns=5,
            height=48.0,
        )
        for order in range(4)
    ]


def _bounds(limits: Limits, quantity: str, joint: int) -> tuple[float, float]:
    value = getattr(limits, quantity)[joint]
    return (
        (float(value[0]), float(value[1]))
        if quantity == "position"
        else (-float(value), float(value))
    )


def short(name: str, most: int = 26) -> str:
    """A long name with its middle left out."""
    return name if len(name) <= most else f"{name[: most // 2]}…{name[-(most // 2 - 1) :]}"


def torques(t: Array, nominal: Array, width: Array, scene: Scene) -> str:
    """Torque of every joint, the band of uncertain robots around it, and the limits."""
    robot = scene.robot
    columns = 1 if robot.n == 1 else 2 if robot.n <= 4 else 3 if robot.n <= COMPACT_LAYOUT_JOINTS else 5
    banded, cells = bool(np.any(width > 0.0)), []
    for j, (joint, unit) in enumerate(zip(robot.joints, torque_units(robot), strict=True)):
        limit = float(scene.limits.torque[j])
        title = f"{short(joint, 22)} [{unit}]"
        cells.append(
            Panel(title, t, nominal[:, j], (-limit, limit), width[:, j] if banded else None)
        )
    height = 52.0 if robot.n > COMPACT_LAYOUT_JOINTS else 90.0
    return small_multiples(
        "Torque of every joint with its limits", cells, scene.motion, columns=columns, height=height
    )


# -- the path in space ---------------------------------------------------------------------------------------


def branch_ends(robot: Robot) -> list[int]:
    """Per branch of the tree the frame that ends it: of the last joint's frames the furthest from the joint."""
    model = robot.model
    parents = {model.parents[i] for i in range(1, model.njoints)}
    tips = []
    for joint in (i for i in range(1, model.njoints) if i not in parents):
        owned = [k for k, frame in enumerate(model.frames) if frame.parentJoint == joint]
        tips.append(
            max(owned, key=lambda k: float(np.linalg.norm(model.frames[k].placement.translation)))
        )
    return tips


def skeleton(robot: Robot, q: Array) -> tuple[Array, Array]:
    """Joint origins (base first) and the ends of all branches at each pose. Shapes (N, n) -> (N, njoints, 3), (N, m, 3) [m]."""
    model, data, ends_of = robot.model, robot.model.createData(), branch_ends(robot)
    joints, ends = np.empty((len(q), model.njoints, 3)), np.empty((len(q), len(ends_of), 3))
    for k, configuration in enumerate(robot.expand(q)):
        pin.forwardKinematics(model, data, configuration)
        joints[k] = [placement.translation for placement in data.oMi]
        ends[k] = [pin.updateFramePlacement(model, data, tip).translation for tip in ends_of]
    return joints, ends


def path(scene: Scene) -> tuple[str, Array]:
    """Three views of the path of each branch's end with the robot as sticks, its bodies and surroundings where these are known;
    and the extent of it [m]. Shape (2, 3)."""
    motion, robot = scene.motion, scene.robot
    t = dense(motion, 700)
    _, ends = skeleton(robot, motion.at(t))
    part = motion.segment("fourier")
    poses = motion.at(part.start + motion.fourier.period * np.arange(4) / 4.0)
    joints, tips = skeleton(robot, poses)
    kinds = np.array(
        [next((s.kind for s in motion.segments if s.start <= x <= s.end), "fourier") for x in t]
    )
    everything = np.concatenate([ends.reshape(-1, 3), joints.reshape(-1, 3), tips.reshape(-1, 3)])
    low, high = everything.min(axis=0), everything.max(axis=0)
    reach = 0.5 * float(np.max(high - low)) * 1.08 + 1e-3
    middle = 0.5 * (low + high)

    def draw(figure: Any) -> None:
        panels = axes_grid(figure, 1, 3, margins=(0.5, 0.1, 0.5, 0.45), gaps=(0.55, 0.0))
        for axes, ((a, b), name) in zip(panels.flat, VIEWS, strict=True):
            if scene.cell is not None:
                for body in scene.cell.bodies:
                    fill(
                        axes,
                        outlines(scene.cell, body, poses[0], (a, b)),
                        GREY,
                        0.35 if body.around else 0.2,
                    )
            for k in range(len(poses)):
                _sticks(axes, robot, (joints[k], tips[k]), (a, b), 1.0 if k == 0 else 0.28)
            for m in range(ends.shape[1]):
                _path(axes, ends[:, m, a], ends[:, m, b], kinds)
            window(axes, middle, reach, (a, b), name)
        _path_legend(figure)

    return render_svg("The path in space, seen from three sides", 4.0, draw), np.array(
        [ends.reshape(-1, 3).min(axis=0), ends.reshape(-1, 3).max(axis=0)]
    )


def _path(axes: Any, x: Array, y: Array, kinds: Array) -> None:
    for color, chosen, width in (
        (ORANGE, kinds != "fourier", 2.4),
        (BLUE, kinds == "fourier", 0.9),
    ):  # ramps retrace the path
        axes.plot(
            np.where(chosen, x, np.nan),
            np.where(chosen, y, np.nan),
            color=color,
            linewidth=width,
            zorder=2,
        )


def _sticks(
    axes: Any, robot: Robot, points: tuple[Array, Array], view: tuple[int, int], alpha: float
) -> None:
    (a, b), (joints, tips) = view, points
    parents, leaves = (
        list(robot.model.parents),
        [robot.model.frames[k].parentJoint for k in branch_ends(robot)],
    )
    lines = [(joints[parents[i]], joints[i]) for i in range(1, len(joints))] + [
        (joints[leaf], tip) for leaf, tip in zip(leaves, tips, strict=True)
    ]
    for begin, end in lines:
        axes.plot(
            [begin[a], end[a]],
            [begin[b], end[b]],
            color=INK,
            alpha=alpha,
            linewidth=1.8,
            solid_capstyle="round",
            zorder=3,
        )
    axes.plot(joints[1:, a], joints[1:, b], "o", color=INK, alpha=alpha, markersize=2.8, zorder=3)


def _path_legend(figure: Any) -> None:
    from matplotlib.lines import Line2D

    entries = (
        (BLUE, f"path, {SEGMENT_WORDS['fourier']}", 1.2),
        (ORANGE, "path, ramps, approach and return", 1.2),
        (INK, "robot at the start of a period", 2.0),
        (GREY, "a quarter of the period later each", 2.0),
    )
    handles = [
        Line2D([], [], color=color, linewidth=width, label=label) for color, label, width in entries
    ]
    height = figure.get_size_inches()[1]
    figure.legend(
        handles=handles,
        loc="upper right",
        ncols=4,
        bbox_to_anchor=(0.995, 1.0 - 0.02 / height),
        borderaxespad=0.0,
    )
