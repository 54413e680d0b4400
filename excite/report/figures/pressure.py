"""Soles on the ground, seen from above, with the paths of their centres of pressure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._types import FloatArray
from .drawing import (
    BLUE,
    FIGURE_WIDTH,
    GREY,
    INK,
    ORANGE,
    RED,
    SOFT,
    axes_grid,
    limit_ticks,
    render_svg,
)

PAD = 0.03
"""Empty space around the soles [m]."""

LARGEST_HEIGHT = 4.2
"""Largest height of the figure [in]: it belongs to the first screen of a report."""

SMALLEST_HEIGHT = 2.0
"""Smallest height of the figure [in]."""


@dataclass(frozen=True)
class SolePicture:
    """A sole on the ground and the path of its centre of pressure.

    Attributes:
        name: Name of the foot's frame.
        centre: Centre of the sole in the world (x, y). Shape (2,) [m].
        half: Half of its length and of its width. Shape (2,) [m].
        margin: Distance that the centre of pressure keeps from the edge [m].
        outline: Corners of the sole about its centre, none for a rectangle. Shape (m, 2) [m].
        paths: Centre of pressure about the centre, motion by motion. Shape (N, 2) each [m].
    """

    name: str
    centre: FloatArray
    half: FloatArray
    margin: float
    outline: FloatArray
    paths: Sequence[FloatArray]


def draw_pressure(soles: Sequence[SolePicture], total: Sequence[FloatArray]) -> str:
    """Draw the soles with the allowed rectangle and the paths of the centre of pressure.

    Args:
        soles: The soles.
        total: Centre of pressure of the whole robot in the world, motion by motion; none for a
            single foot. Shape (N, 2) each [m].
    """
    corners = np.vstack([s.centre + sign * s.half for s in soles for sign in (-1.0, 1.0)])
    low, high = corners.min(axis=0) - PAD, corners.max(axis=0) + PAD
    # the robot looks to the right: x along the width of the page, y (its left) up
    ratio = float((high - low)[1] / (high - low)[0])
    height = float(np.clip(ratio * (FIGURE_WIDTH - 0.7) + 0.75, SMALLEST_HEIGHT, LARGEST_HEIGHT))

    def draw(figure: Any) -> None:
        axes = axes_grid(figure, 1, 1, margins=(0.55, 0.15, 0.3, 0.45))[0, 0]
        axes.set_aspect("equal")
        limit_ticks(axes, 8, 5)
        for path in total:
            axes.plot(*(1e3 * path.T), color=GREY, linewidth=0.6, alpha=0.8)
        for sole in soles:
            _draw_sole(axes, sole)
        handles = _legend(has_total=bool(total))
        axes.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
        axes.set_xlim(1e3 * low[0], 1e3 * high[0])
        axes.set_ylim(1e3 * low[1], 1e3 * high[1])
        axes.set_xlabel("x, forwards [mm]")
        axes.set_ylabel("y, to the left [mm]", labelpad=1)

    return render_svg("Soles from above with the paths of the centre of pressure", height, draw)


def _draw_sole(axes: Any, sole: SolePicture) -> None:
    """Draw one sole, the rectangle that its centre of pressure may use, and its paths."""
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    rectangle = sole.half * square
    outline = sole.outline if len(sole.outline) else rectangle
    axes.fill(*(1e3 * (sole.centre + outline).T), facecolor="#eef3f9", edgecolor=INK, linewidth=1.0)
    if len(sole.outline):
        axes.fill(*(1e3 * (sole.centre + rectangle).T), fill=False, edgecolor=SOFT, linewidth=0.6)
    allowed = (sole.half - sole.margin) * square
    axes.fill(
        *(1e3 * (sole.centre + allowed).T), fill=False, edgecolor=RED, linewidth=0.9, linestyle="--"
    )
    for path in sole.paths:
        axes.plot(*(1e3 * (sole.centre + path).T), color=BLUE, linewidth=0.7, alpha=0.8)
    distance = edge_distance(sole)
    every = np.vstack(sole.paths)
    nearest = sole.centre + every[int(np.argmin(distance))]
    axes.plot(*(1e3 * nearest), marker="o", markersize=4.0, color=ORANGE)
    axes.annotate(
        f"{1e3 * distance.min():.0f} mm from the edge",
        1e3 * nearest,
        xytext=(6, 6),
        textcoords="offset points",
        color=INK,
    )
    axes.text(
        *(1e3 * (sole.centre + np.array([-sole.half[0], sole.half[1]]))),
        f" {sole.name}",
        va="top",
        color=SOFT,
    )


def edge_distance(sole: SolePicture) -> FloatArray:
    """Return the distance of the centre of pressure from the rectangle's edge. Shape (N,) [m]."""
    return np.asarray((sole.half - np.abs(np.vstack(sole.paths))).min(axis=1))


def _legend(*, has_total: bool) -> list[Any]:
    """Return the meaning of the lines."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=BLUE, label="centre of pressure of a foot"),
        Line2D([], [], color=RED, linestyle="--", label="where it may be"),
        Line2D([], [], color=ORANGE, marker="o", linestyle="none", label="nearest to the edge"),
    ]
    if has_total:
        handles.append(Line2D([], [], color=GREY, label="of the whole robot"))
    return handles
