"""What the motion looks like: joint curves, torques, the path in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..limits import Limits
from ..motion import Motion
from ..robot import Robot
from .figures import BLUE, GREY, INK, MANY, ORANGE, RED, SEGMENT_WORDS, bound, few_ticks, grid, render, shade, shade_legend, thin

Array = np.ndarray
QUANTITIES = ("position", "velocity", "acceleration", "jerk")
_UNITS = {"position": "{}", "velocity": "{}/s", "acceleration": "{}/s²", "jerk": "{}/s³"}
_POINTS = 360


@dataclass(frozen=True)
class Scene:
    """What is drawn: a motion, the limits it should obey, the robot that moves."""

    motion: Motion
    limits: Limits
    robot: Robot


def dense(motion: Motion, most: int) -> Array:
    """Times that cover the whole motion, at most `most` [s]."""
    return np.linspace(0.0, motion.duration, int(min(most, max(400, np.ceil(motion.duration * 200.0)))))


def is_prismatic(robot: Robot) -> list[bool]:
    """Which of the moving joints slide."""
    return [entry.kind == "prismatic" for entry in robot.entries]


def kinematics(scene: Scene) -> list[str]:
    """Position, velocity, acceleration and jerk of every joint with their limits: one figure, or one per quantity."""
    motion, robot = scene.motion, scene.robot
    t = dense(motion, 4000)
    t = t[1:-1]  # jerk is not defined at the two ends
    curves = [motion.at(t, order) for order in range(4)]
    if robot.n <= MANY:
        return [_by_joint(t, curves, scene)]
    return [_by_quantity(t, curves[order], order, scene) for order in range(4)]


def _bounds(limits: Limits, quantity: str, joint: int) -> tuple[float, float]:
    value = getattr(limits, quantity)[joint]
    return (float(value[0]), float(value[1])) if quantity == "position" else (-float(value), float(value))


def _curve(axes: Any, curve: tuple[Array, Array], motion: Motion, between: tuple[float, float], points: int = _POINTS) -> None:
    t, y = curve
    shade(axes, motion)
    axes.plot(*thin(t, y, points), color=BLUE)
    bound(axes, *between, float(y.min()), float(y.max()))
    axes.set_xlim(0.0, motion.duration)
    few_ticks(axes)


def _by_joint(t: Array, curves: Sequence[Array], scene: Scene) -> str:
    motion, limits, robot = scene.motion, scene.limits, scene.robot
    sliding = is_prismatic(robot)
    unit = "m" if all(sliding) else "rad" if not any(sliding) else "rad or m"

    def draw(figure: Any) -> None:
        panels = grid(figure, robot.n, 4, margins=(0.42, 0.1, 0.62, 0.4), gaps=(0.42, 0.34), share="x")
        for j, joint in enumerate(robot.joints):
            for order, quantity in enumerate(QUANTITIES):
                axes = panels[j, order]
                _curve(axes, (t, curves[order][:, j]), motion, _bounds(limits, quantity, j))
                axes.tick_params(labelbottom=j == robot.n - 1)
                if j == 0:
                    head = f"{quantity} [{_UNITS[quantity].format(unit)}]"
                    axes.annotate(
                        head, (0.5, 1.0), (0, 20), "axes fraction", textcoords="offset points", ha="center", fontsize=8.5, color=INK
                    )
                if j == robot.n - 1:
                    axes.set_xlabel("time [s]")
            name = f"{joint} (m)" if sliding[j] and not all(sliding) else joint
            panels[j, 0].set_title(name, loc="left", fontsize=8.5, fontweight="bold", pad=4)
        shade_legend(figure, motion)

    return render("Position, velocity, acceleration and jerk of every joint", 1.05 + 1.22 * robot.n, draw)


def _by_quantity(t: Array, values: Array, order: int, scene: Scene) -> str:
    motion, limits, robot = scene.motion, scene.limits, scene.robot
    quantity, columns = QUANTITIES[order], 5
    rows, sliding = -(-robot.n // columns), is_prismatic(robot)

    def draw(figure: Any) -> None:
        panels = grid(figure, rows, columns, margins=(0.42, 0.1, 0.52, 0.4), gaps=(0.4, 0.3), share="x")
        for j, joint in enumerate(robot.joints):
            axes = panels.flat[j]
            _curve(axes, (t, values[:, j]), motion, _bounds(limits, quantity, j), 200)
            axes.tick_params(labelbottom=j + columns >= robot.n)
            axes.set_title(short(joint), loc="left", fontsize=7.5, pad=3)
            if j + columns >= robot.n:
                axes.set_xlabel("time [s]")
        for axes in panels.flat[robot.n :]:
            axes.set_visible(False)
        unit = _UNITS[quantity].format("m" if all(sliding) else "rad" if not any(sliding) else "rad or m")
        figure.text(0.005, 1.0 - 0.06 / figure.get_size_inches()[1], f"{quantity} [{unit}]", fontsize=9.5, fontweight="bold", va="top")
        shade_legend(figure, motion)

    return render(f"{quantity} of every joint", 0.95 + 1.12 * rows, draw)


def short(name: str, most: int = 26) -> str:
    """A long name with its middle left out."""
    return name if len(name) <= most else f"{name[: most // 2]}…{name[-(most // 2 - 1) :]}"


def torques(t: Array, nominal: Array, width: Array, scene: Scene) -> str:
    """Torque of every joint, the band of uncertain robots around it, and the limits."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    motion, limits, robot = scene.motion, scene.limits, scene.robot
    columns = 1 if robot.n == 1 else 2 if robot.n <= 4 else 3 if robot.n <= MANY else 5
    rows, sliding, banded = -(-robot.n // columns), is_prismatic(robot), bool(np.any(width > 0.0))

    def draw(figure: Any) -> None:
        panels = grid(figure, rows, columns, margins=(0.45, 0.1, 0.55, 0.4), gaps=(0.45, 0.34), share="x")
        for j, joint in enumerate(robot.joints):
            axes, middle, half = panels.flat[j], nominal[:, j], width[:, j]
            shade(axes, motion)
            if banded:
                upper, lower = thin(t, middle + half, _POINTS), thin(t, middle - half, _POINTS)
                axes.fill(
                    np.concatenate([upper[0], lower[0][::-1]]),
                    np.concatenate([upper[1], lower[1][::-1]]),
                    color=BLUE,
                    alpha=0.25,
                    linewidth=0,
                )
            axes.plot(*thin(t, middle, _POINTS), color=BLUE)
            bound(axes, -float(limits.torque[j]), float(limits.torque[j]), float((middle - half).min()), float((middle + half).max()))
            axes.set_xlim(0.0, motion.duration)
            few_ticks(axes)
            axes.tick_params(labelbottom=j + columns >= robot.n)
            axes.set_title(f"{short(joint)} [{'N' if sliding[j] else 'N m'}]", loc="left", fontsize=7.5 if robot.n > MANY else 8.5, pad=3)
            if j + columns >= robot.n:
                axes.set_xlabel("time [s]")
        for axes in panels.flat[robot.n :]:
            axes.set_visible(False)
        lines: list[tuple[str, Any]] = [("nominal", Line2D([], [], color=BLUE, linewidth=1.2, label="nominal robot"))]
        if banded:
            lines.append(("band", Patch(color=BLUE, alpha=0.25, label="every robot in the ball")))
        lines.append(("limit", Line2D([], [], color=RED, linewidth=0.8, dashes=(4, 2), label="limit")))
        shade_legend(figure, motion, lines)

    return render("Torque of every joint with its limits", 0.98 + (1.25 if robot.n > MANY else 1.6) * rows, draw)


# -- the path in space ---------------------------------------------------------------------------------------


def _tips(robot: Robot) -> list[int]:
    """Per branch of the tree the frame that ends it: of the last joint's frames the furthest from the joint."""
    model = robot.model
    parents = {model.parents[i] for i in range(1, model.njoints)}
    tips = []
    for joint in (i for i in range(1, model.njoints) if i not in parents):
        owned = [k for k, frame in enumerate(model.frames) if frame.parentJoint == joint]
        tips.append(max(owned, key=lambda k: float(np.linalg.norm(model.frames[k].placement.translation))))
    return tips


def skeleton(robot: Robot, q: Array) -> tuple[Array, Array]:
    """Joint origins (base first) and the ends of all branches at each pose. Shapes (N, n) -> (N, njoints, 3), (N, m, 3) [m]."""
    model, data, tips = robot.model, robot.model.createData(), _tips(robot)
    joints, ends = np.empty((len(q), model.njoints, 3)), np.empty((len(q), len(tips), 3))
    for k, configuration in enumerate(robot.expand(q)):
        pin.forwardKinematics(model, data, configuration)
        joints[k] = [placement.translation for placement in data.oMi]
        ends[k] = [pin.updateFramePlacement(model, data, tip).translation for tip in tips]
    return joints, ends


def path(motion: Motion, robot: Robot) -> tuple[str, Array]:
    """Three views of the path of each branch's end with the robot as a stick figure; and the extent of it [m]. Shape (2, 3)."""
    t = dense(motion, 700)
    _, ends = skeleton(robot, motion.at(t))
    part = motion.segment("fourier")
    poses = motion.at(part.start + motion.fourier.period * np.arange(4) / 4.0)
    joints, tips = skeleton(robot, poses)
    kinds = np.array([next((s.kind for s in motion.segments if s.start <= x <= s.end), "fourier") for x in t])
    everything = np.concatenate([ends.reshape(-1, 3), joints.reshape(-1, 3), tips.reshape(-1, 3)])
    low, high = everything.min(axis=0), everything.max(axis=0)
    reach = 0.5 * float(np.max(high - low)) * 1.08 + 1e-3
    middle = 0.5 * (low + high)

    def draw(figure: Any) -> None:
        panels = grid(figure, 1, 3, margins=(0.5, 0.1, 0.5, 0.45), gaps=(0.55, 0.0))
        for axes, (a, b), name in zip(panels.flat, ((0, 2), (1, 2), (0, 1)), ("side (x–z)", "front (y–z)", "top (x–y)"), strict=True):
            for k in range(len(poses)):
                _sticks(axes, robot, (joints[k], tips[k]), (a, b), 1.0 if k == 0 else 0.28)
            for m in range(ends.shape[1]):
                _path(axes, ends[:, m, a], ends[:, m, b], kinds)
            axes.set_xlim(middle[a] - reach, middle[a] + reach)
            axes.set_ylim(middle[b] - reach, middle[b] + reach)
            axes.set_aspect("equal")
            few_ticks(axes, 5, 5)
            axes.set_title(name, loc="left")
            axes.set_xlabel(f"{'xyz'[a]} [m]")
            axes.set_ylabel(f"{'xyz'[b]} [m]", labelpad=1)
        _path_legend(figure)

    return render("The path in space, seen from three sides", 4.0, draw), np.array(
        [ends.reshape(-1, 3).min(axis=0), ends.reshape(-1, 3).max(axis=0)]
    )


def _path(axes: Any, x: Array, y: Array, kinds: Array) -> None:
    for color, chosen, width in ((ORANGE, kinds != "fourier", 0.9), (BLUE, kinds == "fourier", 0.9)):
        axes.plot(np.where(chosen, x, np.nan), np.where(chosen, y, np.nan), color=color, linewidth=width, zorder=2)


def _sticks(axes: Any, robot: Robot, points: tuple[Array, Array], view: tuple[int, int], alpha: float) -> None:
    (a, b), (joints, tips) = view, points
    parents, leaves = list(robot.model.parents), [robot.model.frames[k].parentJoint for k in _tips(robot)]
    lines = [(joints[parents[i]], joints[i]) for i in range(1, len(joints))] + [
        (joints[leaf], tip) for leaf, tip in zip(leaves, tips, strict=True)
    ]
    for begin, end in lines:
        axes.plot([begin[a], end[a]], [begin[b], end[b]], color=INK, alpha=alpha, linewidth=1.8, solid_capstyle="round", zorder=3)
    axes.plot(joints[1:, a], joints[1:, b], "o", color=INK, alpha=alpha, markersize=2.8, zorder=3)


def _path_legend(figure: Any) -> None:
    from matplotlib.lines import Line2D

    entries = (
        (BLUE, f"path, {SEGMENT_WORDS['fourier']}", 1.2),
        (ORANGE, "path, ramps, approach and return", 1.2),
        (INK, "robot at the start of a period", 2.0),
        (GREY, "a quarter of the period later each", 2.0),
    )
    handles = [Line2D([], [], color=color, linewidth=width, label=label) for color, label, width in entries]
    height = figure.get_size_inches()[1]
    figure.legend(handles=handles, loc="upper right", ncols=4, bbox_to_anchor=(0.995, 1.0 - 0.02 / height), borderaxespad=0.0)
