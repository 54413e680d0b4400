"""Grids of small panels: curves over time with their limits, and curves in a phase plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._types import FloatArray
from ...trajectory.rest_to_rest import Motion
from . import svg
from .drawing import (
    BLUE,
    FIGURE_WIDTH,
    GREY,
    GRID_COLOR,
    INK,
    ORANGE,
    RED,
    SEGMENT_COLORS,
    SEGMENT_WORDS,
    SOFT,
    thin_curve,
)

_TOTAL_WIDTH = FIGURE_WIDTH * svg.UNITS_PER_INCH
_LEFT_MARGIN = 30.0
_RIGHT_MARGIN = 6.0
_COLUMN_GAP = 32.0
_TITLE_HEIGHT = 15.0
_FOOT_HEIGHT = 30.0
"""Room below the last row for the time axis and its label."""
_LETTER_WIDTH = 4.4
"""Mean width of a letter of the legend; all lengths in units of the SVG."""
MAX_LIMIT_DISTANCE = 5.0
"""Limits further from the curve's middle than this many of its half ranges are named, not drawn."""
MIN_RANGE_SHARE = 2e-4
"""Smallest range of an axis over its largest value [1]: the ticks, at least a tenth of it apart,
differ in six digits."""
NEAR_LIMIT_SHARE = 0.3
"""Limits of a phase plane are drawn within this share of the curves' range beyond it."""


@dataclass(frozen=True)
class CurvePanel:
    """A curve over time with its limits.

    Attributes:
        title: Title; the panel has none where it is empty.
        t: Time [s]. Shape (N,).
        y: Values. Shape (N,).
        limits: Lower and upper limit; infinite where there is none.
        band: Half width of a band around the curve. Shape (N,).
    """

    title: str
    t: FloatArray
    y: FloatArray
    limits: tuple[float, float]
    band: FloatArray | None = None


@dataclass(frozen=True)
class PhasePlane:
    """Two closed curves in a plane.

    Attributes:
        title: Title of the panel.
        first: Points of the first curve. Shape (N, 2).
        second: Points of the second curve. Shape (N, 2).
        horizontal_limits: Limits of the horizontal quantity.
        vertical_limits: Limits of the vertical quantity.
    """

    title: str
    first: FloatArray
    second: FloatArray
    horizontal_limits: tuple[float, float]
    vertical_limits: tuple[float, float]


@dataclass(frozen=True)
class _Axes:
    """A panel's place in units of the SVG, and the ranges of its two axes."""

    x: float
    y: float
    width: float
    height: float
    x_range: tuple[float, float]
    y_range: tuple[float, float]

    @property
    def right(self) -> float:
        return self.x + self.width

    @property
    def bottom(self) -> float:
        return self.y + self.height

    def x_of(self, value: float) -> float:
        """Horizontal place of a value."""
        low, high = self.x_range
        return self.x + self.width * (value - low) / (high - low)

    def y_of(self, value: float) -> float:
        """Vertical place of a value."""
        low, high = self.y_range
        return self.y + self.height * (1.0 - (value - low) / (high - low))

    def points(self, x: FloatArray, y: FloatArray) -> list[str]:
        """Points of a path."""
        across, up = self.x_of(0.0), self.y_of(0.0)
        return svg.points_of(across + (self.x_of(1.0) - across) * x, up + (self.y_of(1.0) - up) * y)


def draw_curves(
    label: str,
    panels: Sequence[CurvePanel],
    motion: Motion,
    *,
    columns: int,
    height: float,
    heads: Sequence[str] = (),
) -> str:
    """Draw panels of curves over the time of a motion, filled row by row.

    Args:
        label: Description for screen readers.
        panels: The panels.
        motion: Its segments are shaded.
        columns: Panels in a row.
        height: Height of a panel's axes [units of the SVG].
        heads: Heading above each column.
    """
    width = _panel_width(columns)
    top, rows = 18.0 + (14.0 if heads else 0.0), -(-len(panels) // columns)
    points = 400 if columns <= 3 else 320 if len(panels) <= 40 else 200
    elements = _curve_legend(motion, banded=any(p.band is not None for p in panels))
    for k, head in enumerate(heads):
        middle = _LEFT_MARGIN + k * (width + _COLUMN_GAP) + 0.5 * width
        elements.append(svg.text(middle, 28.0, head, size=8.5, anchor="middle"))
    for k, panel in enumerate(panels):
        row, column = divmod(k, columns)
        low, high, visible_limits = _curve_range(panel)
        axes = _Axes(
            _LEFT_MARGIN + column * (width + _COLUMN_GAP),
            top + row * (height + _TITLE_HEIGHT + 8.0) + _TITLE_HEIGHT,
            width,
            height,
            (0.0, motion.duration),
            (low, high),
        )
        elements += _draw_curve_panel(panel, axes, motion, visible_limits, points)
        elements += _time_axis(axes, labelled=k + columns >= len(panels))
    bottom = top + rows * (height + _TITLE_HEIGHT + 8.0) - 8.0 + _FOOT_HEIGHT
    return svg.picture(label, _TOTAL_WIDTH, bottom, elements, INK)


def draw_phase_planes(
    label: str,
    panels: Sequence[PhasePlane],
    names: tuple[str, str],
    axes_words: str,
    *,
    columns: int,
    height: float,
) -> str:
    """Draw phase planes, filled row by row.

    Args:
        label: Description for screen readers.
        panels: The panels.
        names: Names of the two curves.
        axes_words: Quantities of the axes of all panels, stated once.
        columns: Panels in a row.
        height: Height of a panel's axes [units of the SVG].
    """
    width = _panel_width(columns)
    entries = [("line", BLUE, names[0]), ("line", ORANGE, names[1]), ("dashed", RED, "limit")]
    elements = [
        svg.text(_LEFT_MARGIN, 10.0, axes_words, size=7.5, color=SOFT),
        *_legend(entries),
    ]
    step = height + _TITLE_HEIGHT + 20.0
    for k, panel in enumerate(panels):
        row, column = divmod(k, columns)
        x, y = (
            _plane_range(np.concatenate([panel.first[:, i], panel.second[:, i]]), limits)
            for i, limits in enumerate((panel.horizontal_limits, panel.vertical_limits))
        )
        axes = _Axes(
            _LEFT_MARGIN + column * (width + _COLUMN_GAP),
            18.0 + row * step + _TITLE_HEIGHT,
            width,
            height,
            (x[0], x[1]),
            (y[0], y[1]),
        )
        elements += _draw_plane(panel, axes, x[2], y[2])
    bottom = 18.0 + -(-len(panels) // columns) * step
    return svg.picture(label, _TOTAL_WIDTH, bottom, elements, INK)


def _panel_width(columns: int) -> float:
    """Width of a panel's axes."""
    free = _TOTAL_WIDTH - _LEFT_MARGIN - _RIGHT_MARGIN - _COLUMN_GAP * (columns - 1)
    return free / columns


def _plane_range(
    values: FloatArray, limits: tuple[float, float]
) -> tuple[float, float, list[float]]:
    """Lower and upper end of an axis, and the limits near enough to be drawn."""
    low, high = float(values.min()), float(values.max())
    near = NEAR_LIMIT_SHARE * (high - low)
    visible = [v for v in limits if np.isfinite(v) and low - near <= v <= high + near]
    low, high = min([low, *visible]), max([high, *visible])
    return (*_padded(low, high, 0.06), visible)


def _curve_range(panel: CurvePanel) -> tuple[float, float, list[float]]:
    """Lower and upper end of the axis, and the limits near enough to be drawn."""
    half = 0.0 if panel.band is None else panel.band
    low, high = float((panel.y - half).min()), float((panel.y + half).max())
    middle, reach = 0.5 * (low + high), max(0.5 * (high - low), 1e-9)
    visible = [
        v for v in panel.limits if np.isfinite(v) and abs(v - middle) <= MAX_LIMIT_DISTANCE * reach
    ]
    low, high = min([low, *visible]), max([high, *visible])
    return (*_padded(low, high, 0.08), visible)


def _padded(low: float, high: float, share: float) -> tuple[float, float]:
    """Range with a margin at both ends of a share of it; a constant is drawn in the middle."""
    least = max(MIN_RANGE_SHARE * max(abs(low), abs(high)), 1e-9)
    pad = share * max(high - low, least) + 0.5 * max(least - (high - low), 0.0)
    return low - pad, high + pad


def _draw_plane(
    panel: PhasePlane, axes: _Axes, x_limits: list[float], y_limits: list[float]
) -> list[str]:
    """Elements of a phase plane."""
    elements = [svg.text(axes.x, axes.y - 4.0, panel.title, size=8.0, weight=600)]
    for tick in svg.round_ticks(*axes.x_range, 3):
        x = axes.x_of(tick)
        elements += [
            svg.line(x, axes.y, x, axes.bottom, GRID_COLOR),
            svg.text(x, axes.bottom + 10.0, _tick(tick), size=7.0, anchor="middle", color=SOFT),
        ]
    elements += _horizontal_grid(axes)
    for value in x_limits:
        x = axes.x_of(value)
        elements.append(svg.line(x, axes.y, x, axes.bottom, RED, dashed=True))
    elements += _limit_lines(axes, y_limits)
    for points, color in ((panel.first, BLUE), (panel.second, ORANGE)):
        elements.append(svg.curve(axes.points(points[:, 0], points[:, 1]), color, closed=True))
    return [*elements, *_frame(axes)]


def _draw_curve_panel(
    panel: CurvePanel, axes: _Axes, motion: Motion, visible_limits: list[float], points: int
) -> list[str]:
    """Elements of a panel over time, without its time axis."""
    elements = []
    if panel.title:
        elements.append(svg.text(axes.x, axes.y - 4.0, panel.title, size=8.0, weight=600))
    for segment in motion.segments:
        if segment.kind in SEGMENT_COLORS and segment.end > segment.start:
            start, end = axes.x_of(segment.start), axes.x_of(segment.end)
            color = SEGMENT_COLORS[segment.kind]
            elements.append(svg.rectangle(start, axes.y, end - start, axes.height, color))
    elements += _horizontal_grid(axes)
    if panel.band is not None:
        above, below = (
            axes.points(*thin_curve(panel.t, panel.y + sign * panel.band, points))
            for sign in (1.0, -1.0)
        )
        elements.append(svg.polygon([*above, *reversed(below)], BLUE, 0.25))
    elements.append(svg.curve(axes.points(*thin_curve(panel.t, panel.y, points)), BLUE))
    elements += _limit_lines(axes, visible_limits)
    hidden = [v for v in panel.limits if np.isfinite(v) and v not in visible_limits]
    if hidden:
        symmetric = len(hidden) == 2 and np.isclose(hidden[0], -hidden[1])
        words = f"±{hidden[1]:.4g}" if symmetric else ", ".join(f"{v:.4g}" for v in hidden)
        words = f"limit {words}".replace("-", "−")
        elements.append(
            svg.text(axes.right, axes.y - 4.0, words, size=6.5, anchor="end", color=RED)
        )
    return elements


def _horizontal_grid(axes: _Axes) -> list[str]:
    """Grid lines and labels of the vertical axis."""
    elements = []
    for tick in svg.round_ticks(*axes.y_range, 3):
        y = axes.y_of(tick)
        elements += [
            svg.line(axes.x, y, axes.right, y, GRID_COLOR),
            svg.text(axes.x - 3.0, y + 2.4, _tick(tick), size=7.0, anchor="end", color=SOFT),
        ]
    return elements


def _limit_lines(axes: _Axes, limits: Sequence[float]) -> list[str]:
    """Dashed lines at limits of the vertical quantity."""
    return [
        svg.line(axes.x, axes.y_of(v), axes.right, axes.y_of(v), RED, dashed=True) for v in limits
    ]


def _frame(axes: _Axes) -> list[str]:
    """The two axes."""
    return [
        svg.line(axes.x, axes.bottom, axes.right, axes.bottom, GREY),
        svg.line(axes.x, axes.y, axes.x, axes.bottom, GREY),
    ]


def _tick(value: float) -> str:
    """Label of a tick."""
    return f"{value:.6g}".replace("-", "−")


def _time_axis(axes: _Axes, *, labelled: bool) -> list[str]:
    """Axes of a panel over time; only those of the lowest panels are labelled."""
    elements = _frame(axes)
    bottom = axes.bottom
    for tick in svg.round_ticks(*axes.x_range, 3):
        x = axes.x_of(tick)
        elements.append(svg.line(x, bottom, x, bottom + 2.5, GREY))
        if labelled:
            elements.append(
                svg.text(x, bottom + 10.5, f"{tick:g}", size=7.0, anchor="middle", color=SOFT)
            )
    if labelled:
        middle = axes.x + 0.5 * axes.width
        elements.append(svg.text(middle, bottom + 22.0, "time [s]", size=7.5, anchor="middle"))
    return elements


def _curve_legend(motion: Motion, *, banded: bool) -> list[str]:
    """Meaning of lines and shades, once, at the top right."""
    kinds = {s.kind for s in motion.segments if s.end > s.start}
    entries = [("line", BLUE, "nominal robot" if banded else "motion"), ("dashed", RED, "limit")]
    if banded:
        entries.insert(1, ("box", BLUE, "range over uncertain parameters"))
    if kinds & {"ramp_in", "ramp_out"}:
        entries.append(("box", SEGMENT_COLORS["ramp_in"], SEGMENT_WORDS["ramp_in"]))
    if kinds & {"approach", "return"}:
        entries.append(("box", SEGMENT_COLORS["approach"], SEGMENT_WORDS["approach"]))
    return _legend(entries)


def _legend(entries: Sequence[tuple[str, str, str]]) -> list[str]:
    """Legend at the top right; entries: shape ("line", "dashed" or "box"), colour and words."""
    x, elements = _TOTAL_WIDTH - _RIGHT_MARGIN, list[str]()
    for shape, color, words in reversed(entries):
        x -= _LETTER_WIDTH * len(words)
        elements.append(svg.text(x, 10.0, words, size=7.5))
        x -= 18.0
        if shape == "box":
            opacity = 0.25 if color == BLUE else 1.0
            elements.append(svg.rectangle(x, 4.5, 14.0, 6.0, color, opacity=opacity))
        else:
            dashed = shape == "dashed"
            elements.append(svg.line(x, 7.5, x + 14.0, 7.5, color, width=1.2, dashed=dashed))
        x -= 12.0
    return elements
