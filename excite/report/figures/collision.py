"""Bodies in space, seen from three sides, and their distances over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ..._types import FloatArray
from ...collision.continuous_check import PairDistance
from ...collision.distance_query import Body
from ...collision.geometry import Shape, ShapeKind
from ...collision.workcell import Cell
from ...trajectory.rest_to_rest import Motion
from .drawing import BLUE, GREY, INK, RED, axes_grid, limit_ticks, render_svg
from .small_multiples import CurvePanel, draw_curves

VIEWS = (((0, 2), "side (x–z)"), ((1, 2), "front (y–z)"), ((0, 1), "top (x–y)"))
CIRCLE_ANGLES = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
"""Corners of the polygon that stands for a circle [rad]."""
DRAWN_PAIRS = 6
DISTANCE_SAMPLES = 500
"""Times at which distances are drawn."""


def draw_distances(cell: Cell, nearest: Sequence[PairDistance], motion: Motion) -> str:
    """Draw the distance of the nearest pairs over time, with the clearance to keep [mm]."""
    t = np.linspace(0.0, motion.duration, DISTANCE_SAMPLES)
    drawn, query = nearest[:DRAWN_PAIRS], cell.distance_query()
    numbers = [cell.pairs.index(entry.pair) for entry in drawn]
    values = 1e3 * np.array(
        [[query.set_configuration(q).distance(k) for k in numbers] for q in motion.at(t)]
    )
    panels = [
        CurvePanel(f"{entry.names} [mm]", t, values[:, i], (1e3 * entry.pair.margin, np.inf))
        for i, entry in enumerate(drawn)
    ]
    return draw_curves(
        "Distance of the nearest pairs of bodies over time", panels, motion, columns=2, height=80.0
    )


def draw_nearest_moment(cell: Cell, near: PairDistance) -> str:
    """Draw the robot in its surroundings at the moment when a pair of bodies is nearest."""
    pair = {near.pair.first, near.pair.second}

    def draw(figure: Any) -> None:
        panels = axes_grid(figure, 1, 3, margins=(0.5, 0.1, 0.45, 0.45), gaps=(0.55, 0.0))
        middle, reach = _frame(cell, near.pose)
        for axes, (view, name) in zip(panels.flat, VIEWS, strict=True):
            for number, body in enumerate(cell.bodies):
                color = RED if number in pair else GREY if body.is_surrounding else BLUE
                fill_polygons(
                    axes,
                    outlines(cell, body, near.pose, view),
                    color,
                    0.55 if number in pair else 0.3,
                )
            set_view(axes, middle, reach, view, name)

    return render_svg(f"The moment when {near.names} are nearest, seen from three sides", 3.9, draw)


def set_view(axes: Any, middle: FloatArray, reach: float, view: tuple[int, int], name: str) -> None:
    """Set the extent and the labels of a view."""
    a, b = view
    axes.set_xlim(middle[a] - reach, middle[a] + reach)
    axes.set_ylim(middle[b] - reach, middle[b] + reach)
    axes.set_aspect("equal")
    limit_ticks(axes, 5, 5)
    axes.set_title(name, loc="left")
    axes.set_xlabel(f"{'xyz'[a]} [m]")
    axes.set_ylabel(f"{'xyz'[b]} [m]", labelpad=1)


def fill_polygons(axes: Any, polygons: Iterator[FloatArray], color: str, alpha: float) -> None:
    """Fill polygons with a thin outline."""
    for polygon in polygons:
        axes.fill(
            polygon[:, 0],
            polygon[:, 1],
            facecolor=color,
            edgecolor=INK,
            alpha=alpha,
            linewidth=0.4,
            zorder=1,
        )


def outlines(cell: Cell, body: Body, q: FloatArray, view: tuple[int, int]) -> Iterator[FloatArray]:
    """Convex outlines of a body's shapes in a view. Shape (m, 2) each [m]."""
    from scipy.spatial import ConvexHull, QhullError

    data = cell.robot.model.createData()
    pin.forwardKinematics(cell.robot.model, data, cell.robot.expand(q))
    for shape, placement in zip(body.shapes, body.placements, strict=True):
        if shape.kind is ShapeKind.FLOOR:
            if 2 in view:
                height = float(placement.translation[2])
                yield np.array(
                    [[-50.0, height], [50.0, height], [50.0, height - 50.0], [-50.0, height - 50.0]]
                )
            continue
        at = data.oMi[body.joint] * placement
        points = (_points(shape) @ at.rotation.T + at.translation)[:, view]
        if shape.kind in (ShapeKind.SPHERE, ShapeKind.CAPSULE):
            ring = shape.size[0] * np.column_stack([np.cos(CIRCLE_ANGLES), np.sin(CIRCLE_ANGLES)])
            points = (points[:, None] + ring).reshape(-1, 2)
        try:
            yield points[ConvexHull(points).vertices]
        except QhullError:  # seen edge on
            yield points


def _points(shape: Shape) -> FloatArray:
    """Points whose convex hull, plus the radius of a round shape, is the shape. Shape (m, 3)."""
    if shape.kind is ShapeKind.SPHERE:
        return np.zeros((1, 3))
    if shape.kind is ShapeKind.CAPSULE:
        return np.array([[0.0, 0.0, -0.5 * shape.size[1]], [0.0, 0.0, 0.5 * shape.size[1]]])
    return shape.triangles().reshape(-1, 3)


def _frame(cell: Cell, q: FloatArray) -> tuple[FloatArray, float]:
    """Middle, shape (3,), and half width of a cube around the robot at a pose q, shape (n,) [m]."""
    robot_bodies = [body for body in cell.bodies if not body.is_surrounding]
    side, top = (
        np.vstack([p for body in robot_bodies for p in outlines(cell, body, q, view)])
        for view in ((0, 2), (0, 1))
    )
    low, high = (
        np.array([pick(side[:, 0]), pick(top[:, 1]), pick(side[:, 1])]) for pick in (np.min, np.max)
    )
    return 0.5 * (low + high), 0.55 * float((high - low).max()) + 0.05
