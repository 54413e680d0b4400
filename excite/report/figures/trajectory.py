"""Figures of a motion: joint curves, torques, and the path in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..._types import FloatArray
from ...collision.workcell import Cell
from ...robot.limits import Limits
from ...robot.robot import Robot
from ...trajectory.rest_to_rest import Motion, SegmentKind
from .collision import VIEWS, fill_polygons, outlines, set_view
from .drawing import (
    BLUE,
    COMPACT_LAYOUT_JOINTS,
    GREY,
    INK,
    ORANGE,
    SEGMENT_WORDS,
    axes_grid,
    render_svg,
)
from .small_multiples import CurvePanel, draw_curves

QUANTITIES = ("position", "velocity", "acceleration", "jerk")
_UNITS = {"position": "{}", "velocity": "{}/s", "acceleration": "{}/s²", "jerk": "{}/s³"}


@dataclass(frozen=True)
class MotionScene:
    """A motion and what it is drawn with.

    Attributes:
        motion: The motion.
        limits: Limits of the joints.
        robot: The robot that moves.
        cell: Bodies of the robot and its surroundings, where their shapes are known.
    """

    motion: Motion
    limits: Limits
    robot: Robot
    cell: Cell | None = None


def sample_times(motion: Motion, at_most: int) -> FloatArray:
    """Times at which a motion is drawn, 200 a second but no more than `at_most`. Shape (N,) [s]."""
    return np.linspace(
        0.0, motion.duration, int(min(at_most, max(400, np.ceil(motion.duration * 200.0))))
    )


def is_prismatic(robot: Robot) -> list[bool]:
    """For each moving joint, whether it slides."""
    return [entry.kind == "prismatic" for entry in robot.entries]


def torque_units(robot: Robot) -> list[str]:
    """Unit of each moving joint's torque: N m, or N where it slides."""
    return [entry.unit("N m") for entry in robot.entries]


def draw_kinematics(scene: MotionScene) -> list[tuple[str, str]]:
    """Draw position, velocity, acceleration and jerk of every joint with their limits.

    Returns:
        One figure without a title, or for robots of many joints one per quantity: (title, SVG).
    """
    motion, robot = scene.motion, scene.robot
    t = sample_times(motion, 4000)[1:-1]  # jerk is not defined at the two ends
    curves = [motion.at(t, order) for order in range(4)]
    sliding = is_prismatic(robot)
    unit = "m" if all(sliding) else "rad" if not any(sliding) else "rad or m"
    heads = [f"{quantity} [{_UNITS[quantity].format(unit)}]" for quantity in QUANTITIES]

    def panel(order: int, j: int, title: str) -> CurvePanel:
        limits = _bounds(scene.limits, QUANTITIES[order], j)
        return CurvePanel(title, t, curves[order][:, j], limits)

    names = [
        f"{joint} (m)" if slides and not all(sliding) else joint
        for joint, slides in zip(short_names(robot.joints, 26), sliding, strict=True)
    ]
    if robot.n <= COMPACT_LAYOUT_JOINTS:
        cells = [
            panel(order, j, names[j] if order == 0 else "")
            for j in range(robot.n)
            for order in range(4)
        ]
        label = "Position, velocity, acceleration and jerk of every joint"
        return [("", draw_curves(label, cells, motion, columns=4, height=62.0, heads=heads))]
    return [
        (
            heads[order].capitalize(),
            draw_curves(
                heads[order],
                [panel(order, j, names[j]) for j in range(robot.n)],
                motion,
                columns=5,
                height=48.0,
            ),
        )
        for order in range(4)
    ]


def _bounds(limits: Limits, quantity: str, joint: int) -> tuple[float, float]:
    """Lower and upper limit of a joint's quantity."""
    value = getattr(limits, quantity)[joint]
    return (
        (float(value[0]), float(value[1]))
        if quantity == "position"
        else (-float(value), float(value))
    )


def short(name: str, length: int = 26) -> str:
    """Shorten a long name by leaving out its middle."""
    if len(name) <= length:
        return name
    return f"{name[: length // 2]}…{name[-(length // 2 - 1) :]}"


def short_names(names: Sequence[str], length: int) -> list[str]:
    """Shorten long names so that different ones stay different.

    The last word is left out first, if all names share it, such as `_joint`; then first words that
    all names share, such as the robot's name, as few as the length needs and none in front of a
    number; then the middle, as much as leaves different names different.

    Args:
        names: The names.
        length: Length that is aimed at.
    """
    if max(map(len, names), default=0) <= length:
        return list(names)
    ends = {name.rpartition("_")[2] for name in names}
    same_end = len(ends) == 1 and ends.pop().isalpha()
    kept = [name.rpartition("_")[0] for name in names] if same_end else list(names)
    kept = kept if all(kept) else list(names)
    longest = max(map(len, kept))
    if len(kept) > 1:
        starts = (k + 1 for k, letter in enumerate(kept[0]) if letter in "_-/.")
        shared = [k for k in starts if all(_continues(name, kept[0][:k]) for name in kept)]
        enough = [k for k in shared if longest - k <= length]
        first = min(enough, default=max(shared, default=0))
        kept = [name[first:] for name in kept]
    for tried in range(length, longest):
        shortened = [short(name, tried) for name in kept]
        if len(set(shortened)) == len(set(names)):
            return shortened
    return kept


def _continues(name: str, start: str) -> bool:
    """Tell whether a name has a start, and then a letter."""
    return name.startswith(start) and name[len(start) : len(start) + 1].isalpha()


def draw_torques(t: FloatArray, nominal: FloatArray, width: FloatArray, scene: MotionScene) -> str:
    """Draw the torque of every joint with its limits.

    Args:
        t: Time [s]. Shape (N,).
        nominal: Torque of the nominal robot [N m or N]. Shape (N, n).
        width: Half width of the band over uncertain parameters. Shape (N, n).
        scene: The motion and its limits.
    """
    robot = scene.robot
    columns = (
        1 if robot.n == 1 else 2 if robot.n <= 4 else 3 if robot.n <= COMPACT_LAYOUT_JOINTS else 5
    )
    banded, cells = bool(np.any(width > 0.0)), []
    names = short_names(robot.joints, 22)
    for j, (joint, unit) in enumerate(zip(names, torque_units(robot), strict=True)):
        limit = float(scene.limits.torque[j])
        title = f"{joint} [{unit}]"
        cells.append(
            CurvePanel(title, t, nominal[:, j], (-limit, limit), width[:, j] if banded else None)
        )
    height = 52.0 if robot.n > COMPACT_LAYOUT_JOINTS else 90.0
    return draw_curves(
        "Torque of every joint with its limits", cells, scene.motion, columns=columns, height=height
    )


def branch_ends(robot: Robot) -> list[int]:
    """Frame at the end of each branch: of its last joint the one furthest from the joint."""
    model = robot.model
    parents = {model.parents[i] for i in range(1, model.njoints)}
    tips = []
    for joint in (i for i in range(1, model.njoints) if i not in parents):
        frames = [k for k, frame in enumerate(model.frames) if frame.parentJoint == joint]
        tips.append(
            max(frames, key=lambda k: float(np.linalg.norm(model.frames[k].placement.translation)))
        )
    return tips


def skeleton(robot: Robot, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute joint origins and branch ends at each pose.

    Args:
        robot: The robot.
        q: Joint positions. Shape (N, n).

    Returns:
        Joint origins, the base first, shape (N, njoints, 3), and branch ends, shape (N, m, 3) [m].
    """
    model, data, ends_of = robot.model, robot.model.createData(), branch_ends(robot)
    joints, ends = np.empty((len(q), model.njoints, 3)), np.empty((len(q), len(ends_of), 3))
    for k, configuration in enumerate(robot.expand(q)):
        pin.forwardKinematics(model, data, configuration)
        joints[k] = [placement.translation for placement in data.oMi]
        ends[k] = [pin.updateFramePlacement(model, data, tip).translation for tip in ends_of]
    return joints, ends


def draw_path(scene: MotionScene) -> tuple[str, FloatArray]:
    """Draw the path of each branch's end in three views, with the robot and its surroundings.

    Returns:
        The SVG, and the least and largest coordinates of the path. Shape (2, 3) [m].
    """
    motion, robot = scene.motion, scene.robot
    t = sample_times(motion, 700)
    _, ends = skeleton(robot, motion.at(t))
    part = motion.segment(SegmentKind.FOURIER)
    quarters: FloatArray = part.start + motion.fourier.period * np.arange(4.0) / 4.0
    poses = motion.at(quarters)
    joints, tips = skeleton(robot, poses)
    kinds = np.array(
        [
            next((s.kind for s in motion.segments if s.start <= x <= s.end), SegmentKind.FOURIER)
            for x in t
        ]
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
                    fill_polygons(
                        axes,
                        outlines(scene.cell, body, poses[0], (a, b)),
                        GREY,
                        0.35 if body.is_surrounding else 0.2,
                    )
            for k in range(len(poses)):
                draw_skeleton(axes, robot, (joints[k], tips[k]), (a, b), 1.0 if k == 0 else 0.28)
            for m in range(ends.shape[1]):
                _draw_path(axes, ends[:, m, a], ends[:, m, b], kinds)
            set_view(axes, middle, reach, (a, b), name)
        _path_legend(figure)

    return render_svg("The path in space, seen from three sides", 4.0, draw), np.array(
        [ends.reshape(-1, 3).min(axis=0), ends.reshape(-1, 3).max(axis=0)]
    )


def _draw_path(axes: Any, x: FloatArray, y: FloatArray, kinds: Any) -> None:
    """Draw a path with its ramps in another colour; kinds: segment at each point. Shape (N,)."""
    for color, chosen, width in (
        (ORANGE, kinds != SegmentKind.FOURIER, 2.4),
        (BLUE, kinds == SegmentKind.FOURIER, 0.9),
    ):  # ramps retrace the path
        axes.plot(
            np.where(chosen, x, np.nan),
            np.where(chosen, y, np.nan),
            color=color,
            linewidth=width,
            zorder=2,
        )


def draw_skeleton(
    axes: Any,
    robot: Robot,
    points: tuple[FloatArray, FloatArray],
    view: tuple[int, int],
    alpha: float,
) -> None:
    """Draw the robot as sticks; points: joint origins and branch ends."""
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
    """Legend of the path."""
    from matplotlib.lines import Line2D

    entries = (
        (BLUE, f"path, {SEGMENT_WORDS['fourier']}", 1.2),
        (ORANGE, "path, ramps, approach and return", 1.2),
        (INK, "robot at the start of a period", 2.0),
        (GREY, "a quarter, half and three quarters of a period later", 2.0),
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
