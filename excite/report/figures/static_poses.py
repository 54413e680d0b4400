"""Figure of static poses: the robot at each of them, from the side or the front."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._types import FloatArray
from .collision import VIEWS, fill_polygons, outlines, set_view
from .drawing import GREY, axes_grid, render_svg
from .trajectory import MotionScene, draw_skeleton, skeleton

COLUMNS = 3
"""Poses next to each other."""
ROW_HEIGHT = 2.6
"""Height of a row of poses [in]."""


def draw_poses(scene: MotionScene, poses: FloatArray) -> str:
    """Draw the robot at each pose, in the vertical plane in which its poses extend most.

    Args:
        scene: The robot and its surroundings.
        poses: Poses. Shape (P, n) [rad or m].

    Returns:
        The SVG.
    """
    joints, tips = skeleton(scene.robot, poses)
    points = np.concatenate([joints.reshape(-1, 3), tips.reshape(-1, 3)])
    low, high = points.min(axis=0), points.max(axis=0)
    reach = 0.5 * float(np.max(high - low)) * 1.08 + 1e-3
    middle, extent = 0.5 * (low + high), np.std(points, axis=0)
    (a, b), name = max(VIEWS[:2], key=lambda view: extent[view[0][0]])
    rows = -(-len(poses) // COLUMNS)

    def draw(figure: Any) -> None:
        panels = axes_grid(figure, rows, COLUMNS, margins=(0.5, 0.1, 0.5, 0.35), gaps=(0.55, 0.6))
        for k, axes in enumerate(panels.flat):
            if k >= len(poses):
                axes.set_axis_off()
                continue
            if scene.cell is not None:
                for body in scene.cell.bodies:
                    shapes = outlines(scene.cell, body, poses[k], (a, b))
                    fill_polygons(axes, shapes, GREY, 0.35 if body.is_surrounding else 0.2)
            draw_skeleton(axes, scene.robot, (joints[k], tips[k]), (a, b), 1.0)
            set_view(axes, middle, reach, (a, b), f"pose {k + 1}, {name}")

    return render_svg("The robot at its static poses", ROW_HEIGHT * rows, draw)
