"""Figures of the residual atlas: one table for the robot, and all curves of a joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._types import FloatArray
from ...diagnosis.residual_atlas import SIGNIFICANT, Atlas, AtlasCurve
from ...diagnosis.residual_curves import CurveKind
from ..formatting import number
from . import svg
from .drawing import BLUE, FIGURE_WIDTH, GREY, GRID_COLOR, INK, ORANGE, RED, SOFT, thin_curve
from .heatmap import Heatmap, draw_heatmap
from .trajectory import short

_COLUMNS = 4
"""Number of panels in a row."""
_TOTAL_WIDTH = FIGURE_WIDTH * svg.UNITS_PER_INCH
"""Width of the figure [SVG units]."""
_LEFT_MARGIN = 32.0
"""Distance of the first column of panels from the left edge [SVG units]."""
_RIGHT_MARGIN = 6.0
"""Distance of the last column of panels from the right edge [SVG units]."""
_COLUMN_GAP = 32.0
"""Horizontal distance between panels [SVG units]."""
_TOP = 44.0
"""Distance of the first row of panels from the upper edge [SVG units]."""
_PANEL_HEIGHT = 74.0
"""Height of a panel [SVG units]."""
_ROW_STEP = 128.0
"""Distance from the top of one row of panels to that of the next [SVG units]."""
_LAST_ROW_GAP = 24.0
"""Height that the last row does not need below its labels [SVG units]."""
_AXIS_HEADROOM = 1.15
"""End of the vertical axis over the largest value of the curves [1]."""
_LETTER_WIDTH = 4.2
"""Mean width of a letter of the legend [SVG units]."""
_CURVE_POINTS = 160
"""Points of a curve that a small panel can show."""
_DOTTED_POINTS = 30
"""Curves of at most so many points are drawn with dots."""
_OTHER_SPEED = "speed of "
"""Beginning of the names of abscissae that are the speed of another joint."""
_COLUMN_ORDER = (
    "speed",
    "direction",
    "load",
    "load, along the motion",
    "position",
    "position, along the motion",
    "order",
)
_PHASES = {-2.0: "− faster", -1.0: "− slower", 1.0: "+ slower", 2.0: "+ faster"}
"""Direction of motion and sign of its acceleration."""


def select_panels(panels: Sequence[AtlasCurve]) -> list[AtlasCurve]:
    """Select the curves of a joint to show: of the other joints' speeds the most significant."""
    other = [p for p in panels if p.against.startswith(_OTHER_SPEED)]
    same = [p for p in panels if not p.against.startswith(_OTHER_SPEED)]
    return [*same, max(other, key=lambda p: p.score_before)] if other else same


def draw_overview(atlas: Atlas, joints: Sequence[str]) -> str:
    """Draw joints across abscissae, shaded by the share of the residual that depends on each.

    Cells without significance are blank.
    """
    rows = {j: {_column(p): p for p in select_panels(atlas.of(j))} for j in range(len(joints))}
    known = dict.fromkeys(
        name for row in sorted(rows.values(), key=len, reverse=True) for name in row
    )
    columns = [
        *(name for name in _COLUMN_ORDER if name in known),
        *(name for name in known if name not in _COLUMN_ORDER),
    ]
    values = np.full((len(joints), len(columns)), np.nan)
    words = [[""] * len(columns) for _ in joints]
    marked = np.zeros(values.shape, bool)
    for j, row in rows.items():
        for name, panel in row.items():
            k = columns.index(name)
            if panel.p_before < SIGNIFICANT:
                values[j, k] = panel.share_before
                words[j][k] = f"{100 * panel.share_before:.0f} %"
            marked[j, k] = panel.p_after < SIGNIFICANT
    return draw_heatmap(
        "Share of each joint's residual that depends on each quantity",
        Heatmap([short(joint, 22) for joint in joints], columns, values, words, marked),
        cell=(46.0, 20.0),
    )


def _column(panel: AtlasCurve) -> str:
    """Return the name of a curve's column in the overview."""
    is_other = panel.against.startswith(_OTHER_SPEED)
    return "another joint's speed" if is_other else panel.against


def draw_joint(
    panels: Sequence[AtlasCurve], joint: str, unit: str, floor: float, *, has_findings: bool
) -> str:
    """Draw all curves of a joint, before and after the findings, with the noise floor.

    Args:
        panels: Curves of the joint.
        joint: Name of the joint.
        unit: Unit of its torque.
        floor: Noise floor [N m or N].
        has_findings: True if there is a model with findings to compare.
    """
    selected = select_panels(panels)
    reach = _reaches(selected, floor, has_findings=has_findings)
    scale = f"residual [{unit}], the same scale in all panels"
    elements = _legend(has_findings=has_findings)
    elements.append(svg.text(_LEFT_MARGIN, 11.0, scale, size=7.5, color=SOFT))
    free = _TOTAL_WIDTH - _LEFT_MARGIN - _RIGHT_MARGIN - _COLUMN_GAP * (_COLUMNS - 1)
    width = free / _COLUMNS
    for k, panel in enumerate(selected):
        row, column = divmod(k, _COLUMNS)
        x, y = _LEFT_MARGIN + column * (width + _COLUMN_GAP), _TOP + row * _ROW_STEP
        axes = _PanelAxes.of(panel, x, y, width, reach[panel.kind is CurveKind.AMPLITUDE])
        elements += _draw_panel(axes, panel, floor, has_findings=has_findings)
    bottom = _TOP + -(-len(selected) // _COLUMNS) * _ROW_STEP - _LAST_ROW_GAP
    label = f"Held-out residual of {joint} over each quantity"
    return svg.picture(label, _TOTAL_WIDTH, bottom, elements, INK)


@dataclass(frozen=True)
class _PanelAxes:
    """Position and scales of a panel.

    Attributes:
        x: Left edge [SVG units].
        y: Upper edge [SVG units].
        width: Width [SVG units].
        low: Least abscissa, as drawn: its logarithm or bin number where the axis has these.
        high: Largest abscissa, as drawn.
        floor: Lower end of the vertical axis [unit of the torque].
        reach: Upper end of the vertical axis [unit of the torque].
    """

    x: float
    y: float
    width: float
    low: float
    high: float
    floor: float
    reach: float

    @classmethod
    def of(cls, panel: AtlasCurve, x: float, y: float, width: float, reach: float) -> _PanelAxes:
        """Return axes whose range a panel's curve fills."""
        places = _places(panel)
        pad = 0.4 if panel.against == "direction" else 0.04 * float(np.ptp(places))
        lower = 0.0 if panel.kind is CurveKind.AMPLITUDE else -reach
        return cls(x, y, width, float(places.min()) - pad, float(places.max()) + pad, lower, reach)

    @property
    def right(self) -> float:
        return self.x + self.width

    @property
    def bottom(self) -> float:
        return self.y + _PANEL_HEIGHT

    def x_of(self, place: FloatArray | float) -> FloatArray:
        """Return the horizontal coordinate of an abscissa [SVG units]."""
        return np.asarray(
            self.x + self.width * (np.asarray(place) - self.low) / (self.high - self.low)
        )

    def y_of(self, value: FloatArray | float) -> FloatArray:
        """Return the vertical coordinate of a value, clipped to the panel [SVG units]."""
        inside = np.clip(value, self.floor, self.reach)
        return np.asarray(
            self.y + _PANEL_HEIGHT * (1.0 - (inside - self.floor) / (self.reach - self.floor))
        )

    def points(self, places: FloatArray, values: FloatArray) -> list[str]:
        """Return the points of a path."""
        return svg.points_of(self.x_of(places), self.y_of(values))


def _places(panel: AtlasCurve) -> FloatArray:
    """Return the centres of the bins along the axis as drawn."""
    if panel.against == "direction":
        return np.arange(len(panel.centres), dtype=float)
    return np.log10(panel.centres) if panel.logarithmic else panel.centres


def _reaches(
    panels: Sequence[AtlasCurve], floor: float, *, has_findings: bool
) -> dict[bool, float]:
    """Return the upper ends of the vertical axes, the same for all panels of a joint.

    Returns:
        Upper end for curves of means (False) and of amplitudes (True).
    """
    out = {}
    for is_amplitude in (False, True):
        alike = [p for p in panels if (p.kind is CurveKind.AMPLITUDE) is is_amplitude]
        curves = [p.mean_before for p in alike]
        curves += [p.mean_after for p in alike] if has_findings else []
        out[is_amplitude] = _AXIS_HEADROOM * max([floor, *(float(np.abs(c).max()) for c in curves)])
    return out


def _draw_panel(
    axes: _PanelAxes, panel: AtlasCurve, floor: float, *, has_findings: bool
) -> list[str]:
    """Draw a panel and return its SVG elements."""
    places, is_significant = _places(panel), panel.p_before < SIGNIFICANT
    weight = 600 if is_significant else 0
    p_values = p_value(panel.p_before) + (f" → {p_value(panel.p_after)}" if has_findings else "")
    title_color, p_color = (INK, RED) if is_significant else (SOFT, SOFT)
    title = short(panel.against, 32)
    elements = [
        svg.text(axes.x, axes.y - 13.0, title, size=8.0, color=title_color, weight=weight),
        svg.text(axes.x, axes.y - 4.0, p_values, size=6.5, color=p_color),
        *_draw_axes(axes, panel),
    ]
    lower = 0.0 if panel.kind is CurveKind.AMPLITUDE else -floor
    top, bottom = float(axes.y_of(floor)), float(axes.y_of(lower))
    elements.append(svg.rectangle(axes.x, top, axes.width, bottom - top, GREY, opacity=0.35))
    zero = float(axes.y_of(0.0))
    elements.append(svg.line(axes.x, zero, axes.right, zero, GREY, width=0.5))
    opacity = 1.0 if is_significant else 0.45
    if panel.kind is not CurveKind.AMPLITUDE:
        above, below = (
            axes.points(places, panel.mean_before + sign * 2.0 * panel.error)
            for sign in (1.0, -1.0)
        )
        elements.append(svg.polygon([*above, *reversed(below)], ORANGE, 0.22 * opacity))
    curves = [(panel.mean_before, ORANGE), *([(panel.mean_after, BLUE)] if has_findings else [])]
    for values, color in curves:
        points = axes.points(*thin_curve(places, values, _CURVE_POINTS))
        elements.append(svg.curve(points, color, width=1.1, opacity=opacity))
        if len(places) <= _DOTTED_POINTS:
            elements += [
                svg.circle(float(x), float(y), 1.5, color, opacity=opacity)
                for x, y in zip(axes.x_of(places), axes.y_of(values), strict=True)
            ]
    edge_color, edge_width = (RED, 2.0) if is_significant else (GREY, 0.8)
    edge = svg.line(axes.x, axes.y, axes.x, axes.bottom, edge_color, width=edge_width)
    return [*elements, edge]


def _draw_axes(axes: _PanelAxes, panel: AtlasCurve) -> list[str]:
    """Draw ticks, grid and unit of a panel."""
    elements = [svg.line(axes.x, axes.bottom, axes.right, axes.bottom, GREY)]
    for place, word in _horizontal_ticks(axes, panel):
        x = float(axes.x_of(place))
        elements += [
            svg.line(x, axes.y, x, axes.bottom, GRID_COLOR, width=0.6),
            svg.text(x, axes.bottom + 9.0, word, size=6.5, anchor="middle", color=SOFT),
        ]
    for value in svg.round_ticks(axes.floor, axes.reach, 3):
        y = float(axes.y_of(value))
        elements += [
            svg.line(axes.x, y, axes.right, y, GRID_COLOR, width=0.6),
            svg.text(axes.x - 3.0, y + 2.4, number(value), size=6.5, anchor="end", color=SOFT),
        ]
    if panel.unit:
        middle = axes.x + 0.5 * axes.width
        unit = f"[{panel.unit}]"
        elements.append(
            svg.text(middle, axes.bottom + 18.0, unit, size=6.5, anchor="middle", color=SOFT)
        )
    return elements


def _horizontal_ticks(axes: _PanelAxes, panel: AtlasCurve) -> list[tuple[float, str]]:
    """Return abscissa and label of each tick of the horizontal axis."""
    if panel.against == "direction":
        return [(float(k), _PHASES[float(v)]) for k, v in enumerate(panel.centres)]
    if not panel.logarithmic:
        return [(v, number(v)) for v in svg.round_ticks(axes.low, axes.high, 3)]
    values = [(s, e, s * 10.0**e) for e in range(-6, 7) for s in (1.0, 2.0, 5.0)]
    visible = [(s, v) for s, _, v in values if axes.low <= np.log10(v) <= axes.high]
    decades = [(s, v) for s, v in visible if s == 1.0]
    chosen = decades if len(visible) > 5 and len(decades) > 1 else visible
    return [(float(np.log10(v)), number(v)) for _, v in chosen]


def p_value(p: float) -> str:
    """Format a p-value: 'p ≤ 0.001', 'p = 0.03'."""
    return "p ≤ 0.001" if p <= 0.001 else f"p = {number(p, 2)}"


def _legend(*, has_findings: bool) -> list[str]:
    """Draw the legend of lines and shades, aligned to the right."""
    entries = [(ORANGE, 1.4, 1.0, "base model"), (ORANGE, 7.0, 0.22, "±2 standard errors")]
    if has_findings:
        entries.append((BLUE, 1.4, 1.0, "with the findings"))
    entries += [
        (GREY, 7.0, 0.35, "noise floor"),
        (RED, 2.0, 1.0, f"p < {number(SIGNIFICANT)}, corrected for all curves"),
    ]
    x, elements = _TOTAL_WIDTH - _RIGHT_MARGIN, list[str]()
    for color, width, opacity, word in reversed(entries):
        x -= _LETTER_WIDTH * len(word)
        elements.append(svg.text(x, 11.0, word, size=7.5))
        elements.append(svg.line(x - 20.0, 8.5, x - 5.0, 8.5, color, width=width, opacity=opacity))
        x -= 30.0
    return elements
