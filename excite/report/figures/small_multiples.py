"""Small multiples of curves over time, written as SVG directly: a robot of 30 joints needs 150 of them, too many for matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...trajectory.rest_to_rest import Motion
from ..page import escape
from .drawing import (
    BLUE,
    FIGURE_WIDTH,
    GREY,
    INK,
    ORANGE,
    RED,
    SEGMENT_WORDS,
    SHADES,
    SOFT,
    thin_curve,
)

Array = np.ndarray
_UNITS = 72.0
_LEFT, _RIGHT, _GAP, _TITLE, _FOOT = 30.0, 6.0, 32.0, 15.0, 30.0
_OFF_SCALE = 5.0
"""Limits further from the curve's middle than this many of its half ranges are named, not drawn."""


@dataclass(frozen=True)
class Panel:
    """One curve with its limits. t, y: Shape (N,). band: half width around y, Shape (N,), or None."""

    title: str
    t: Array
    y: Array
    limits: tuple[float, float]
    band: Array | None = None


@dataclass(frozen=True)
class Plane:
    """Two closed curves in a plane with its limits. first, second: Shape (N, 2). across, up: limits of the two axes."""

    title: str
    first: Array
    second: Array
    across: tuple[float, float]
    up: tuple[float, float]


@dataclass(frozen=True)
class _Cell:
    """A panel's place in units of the SVG, and the scales from data to there."""

    x: float
    y: float
    width: float
    height: float
    span: tuple[float, float]
    low: float
    high: float

    def across(self, t: float) -> float:
        return self.x + self.width * (t - self.span[0]) / (self.span[1] - self.span[0])

    def up(self, value: float) -> float:
        return self.y + self.height * (1.0 - (value - self.low) / (self.high - self.low))


def small_multiples(
    label: str,
    panels: Sequence[Panel],
    motion: Motion,
    *,
    columns: int,
    height: float,
    heads: Sequence[str] = (),
) -> str:
    """A grid of panels, filled row by row, as SVG. height: of one panel's axes. heads: a heading above each column."""
    total = FIGURE_WIDTH * _UNITS
    width = (total - _LEFT - _RIGHT - _GAP * (columns - 1)) / columns
    top, rows = 18.0 + (14.0 if heads else 0.0), -(-len(panels) // columns)
    points = 400 if columns <= 3 else 320 if len(panels) <= 40 else 200
    parts = _legend(motion, total, banded=any(p.band is not None for p in panels))
    for k, head in enumerate(heads):
        parts.append(
            _text(_LEFT + k * (width + _GAP) + 0.5 * width, 28.0, head, size=8.5, anchor="middle")
        )
    for k, panel in enumerate(panels):
        row, column = divmod(k, columns)
        low, high, drawn = _range(panel)
        place = (_LEFT + column * (width + _GAP), top + row * (height + _TITLE + 8.0) + _TITLE)
        cell = _Cell(*place, width, height, (0.0, motion.duration), low, high)
        parts += _panel(panel, cell, motion, drawn, points)
        parts += _time_axis(cell, labelled=k + columns >= len(panels))
    bottom = top + rows * (height + _TITLE + 8.0) - 8.0 + _FOOT
    head = f'<svg viewBox="0 0 {_short(total)} {_short(bottom)}" role="img" aria-label="{escape(label)}" '
    return f'{head}style="max-width:{FIGURE_WIDTH * 96:.0f}px" font-family="sans-serif" fill="{INK}">{"".join(parts)}</svg>'


def planes(
    label: str,
    panels: Sequence[Plane],
    names: tuple[str, str],
    axes: str,
    *,
    columns: int,
    height: float,
) -> str:
    """A grid of planes as SVG. names: of the two curves. axes: what is drawn against what, said once."""
    total = FIGURE_WIDTH * _UNITS
    width = (total - _LEFT - _RIGHT - _GAP * (columns - 1)) / columns
    entries = [("line", BLUE, names[0]), ("line", ORANGE, names[1]), ("dashed", RED, "limit")]
    parts = [_text(_LEFT, 10.0, axes, size=7.5, color=SOFT), *_key(entries, total)]
    step = height + _TITLE + 20.0
    for k, panel in enumerate(panels):
        row, column = divmod(k, columns)
        x, y = (
            _extent(np.concatenate([panel.first[:, i], panel.second[:, i]]), limits)
            for i, limits in enumerate((panel.across, panel.up))
        )
        place = (_LEFT + column * (width + _GAP), 18.0 + row * step + _TITLE)
        cell = _Cell(*place, width, height, (x[0], x[1]), y[0], y[1])
        parts += _plane(panel, cell, x[2], y[2])
    bottom = 18.0 + -(-len(panels) // columns) * step
    head = f'<svg viewBox="0 0 {_short(total)} {_short(bottom)}" role="img" aria-label="{escape(label)}" '
    return f'{head}style="max-width:{FIGURE_WIDTH * 96:.0f}px" font-family="sans-serif" fill="{INK}">{"".join(parts)}</svg>'


def _extent(values: Array, limits: tuple[float, float]) -> tuple[float, float, list[float]]:
    """Lower and upper end of an axis, and the limits near enough to be in sight."""
    low, high = float(values.min()), float(values.max())
    drawn = [
        v
        for v in limits
        if np.isfinite(v) and low - 0.3 * (high - low) <= v <= high + 0.3 * (high - low)
    ]
    low, high = min([low, *drawn]), max([high, *drawn])
    pad = 0.06 * max(high - low, 1e-9)
    return low - pad, high + pad, drawn


def _plane(panel: Plane, cell: _Cell, across: list[float], up: list[float]) -> list[str]:
    left, right, top, bottom = cell.x, cell.x + cell.width, cell.y, cell.y + cell.height
    parts = [_text(left, top - 4.0, panel.title, size=8.0, weight=600)]
    for tick in ticks(*cell.span, 3):
        x = cell.across(tick)
        parts += [
            _line(x, top, x, bottom, "#eef1f4"),
            _text(x, bottom + 10.0, _tick(tick), size=7.0, anchor="middle", color=SOFT),
        ]
    for tick in ticks(cell.low, cell.high, 3):
        y = cell.up(tick)
        parts += [
            _line(left, y, right, y, "#eef1f4"),
            _text(left - 3.0, y + 2.4, _tick(tick), size=7.0, anchor="end", color=SOFT),
        ]
    parts += [_line(cell.across(v), top, cell.across(v), bottom, RED, dashed=True) for v in across]
    parts += [_line(left, cell.up(v), right, cell.up(v), RED, dashed=True) for v in up]
    for curve, color in ((panel.first, BLUE), (panel.second, ORANGE)):
        points = "L".join(f"{_short(cell.across(x))} {_short(cell.up(y))}" for x, y in curve)
        parts.append(f'<path d="M{points}Z" fill="none" stroke="{color}" stroke-linejoin="round"/>')
    return [*parts, _line(left, bottom, right, bottom, GREY), _line(left, top, left, bottom, GREY)]


def _tick(value: float) -> str:
    return f"{value:.6g}".replace("-", "−")


def _range(panel: Panel) -> tuple[float, float, list[float]]:
    """Lower and upper end of the axis, and the limits that are in sight."""
    half = 0.0 if panel.band is None else panel.band
    low, high = float((panel.y - half).min()), float((panel.y + half).max())
    middle, reach = 0.5 * (low + high), max(0.5 * (high - low), 1e-9)
    drawn = [v for v in panel.limits if np.isfinite(v) and abs(v - middle) <= _OFF_SCALE * reach]
    low, high = min([low, *drawn]), max([high, *drawn])
    pad = 0.08 * max(high - low, 1e-9)
    return low - pad, high + pad, drawn


def _panel(panel: Panel, cell: _Cell, motion: Motion, drawn: list[float], points: int) -> list[str]:
    parts = [_text(cell.x, cell.y - 4.0, panel.title, size=8.0, weight=600)] if panel.title else []
    shaded = [
        (cell.across(s.start), cell.across(s.end), SHADES[s.kind])
        for s in motion.segments
        if s.kind in SHADES and s.end > s.start
    ]
    parts += [
        _rectangle(start, cell.y, end - start, cell.height, color) for start, end, color in shaded
    ]
    for tick in ticks(cell.low, cell.high, 3):
        y = cell.up(tick)
        parts.append(_line(cell.x, y, cell.x + cell.width, y, "#eef1f4"))
        parts.append(_text(cell.x - 3.0, y + 2.4, _tick(tick), size=7.0, anchor="end", color=SOFT))
    if panel.band is not None:
        above, below = (
            _points(cell, *thin_curve(panel.t, panel.y + sign * panel.band, points))
            for sign in (1.0, -1.0)
        )
        parts.append(
            f'<path d="M{"L".join([*above, *reversed(below)])}Z" fill="{BLUE}" fill-opacity=".25"/>'
        )
    curve = _points(cell, *thin_curve(panel.t, panel.y, points))
    parts.append(
        f'<path d="M{"L".join(curve)}" fill="none" stroke="{BLUE}" stroke-linejoin="round"/>'
    )
    parts += [
        _line(cell.x, cell.up(v), cell.x + cell.width, cell.up(v), RED, dashed=True) for v in drawn
    ]
    hidden = [v for v in panel.limits if np.isfinite(v) and v not in drawn]
    if hidden:
        both = len(hidden) == 2 and np.isclose(hidden[0], -hidden[1])
        text = (
            f"limit ±{hidden[1]:.4g}" if both else "limit " + ", ".join(f"{v:.4g}" for v in hidden)
        )
        parts.append(
            _text(
                cell.x + cell.width,
                cell.y - 4.0,
                text.replace("-", "−"),
                size=6.5,
                anchor="end",
                color=RED,
            )
        )
    return parts


def _time_axis(cell: _Cell, *, labelled: bool) -> list[str]:
    bottom = cell.y + cell.height
    parts = [
        _line(cell.x, bottom, cell.x + cell.width, bottom, GREY),
        _line(cell.x, cell.y, cell.x, bottom, GREY),
    ]
    for tick in ticks(*cell.span, 3):
        parts.append(_line(cell.across(tick), bottom, cell.across(tick), bottom + 2.5, GREY))
        if labelled:
            parts.append(
                _text(
                    cell.across(tick),
                    bottom + 10.5,
                    f"{tick:g}",
                    size=7.0,
                    anchor="middle",
                    color=SOFT,
                )
            )
    if labelled:
        parts.append(
            _text(cell.x + 0.5 * cell.width, bottom + 22.0, "time [s]", size=7.5, anchor="middle")
        )
    return parts


def _legend(motion: Motion, total: float, *, banded: bool) -> list[str]:
    """What lines and shades mean, once, at the top right."""
    kinds = {s.kind for s in motion.segments if s.end > s.start}
    entries = [("line", BLUE, "nominal robot" if banded else "motion"), ("dashed", RED, "limit")]
    if banded:
        entries.insert(1, ("box", BLUE, "every robot in the ball"))
    if kinds & {"ramp_in", "ramp_out"}:
        entries.append(("box", SHADES["ramp_in"], SEGMENT_WORDS["ramp_in"]))
    if kinds & {"approach", "return"}:
        entries.append(("box", SHADES["approach"], SEGMENT_WORDS["approach"]))
    return _key(entries, total)


def _key(entries: Sequence[tuple[str, str, str]], total: float) -> list[str]:
    """Shape, colour and word of each entry, set from the right."""
    x, parts = total - _RIGHT, list[str]()
    for shape, color, label in reversed(entries):
        x -= 4.4 * len(label)
        parts.append(_text(x, 10.0, label, size=7.5))
        x -= 18.0
        if shape == "box":
            parts.append(_rectangle(x, 4.5, 14.0, 6.0, color, 0.25 if color == BLUE else 1.0))
        else:
            parts.append(_line(x, 7.5, x + 14.0, 7.5, color, dashed=shape == "dashed", width=1.2))
        x -= 12.0
    return parts


def ticks(low: float, high: float, least: int) -> list[float]:
    """Round numbers inside a range, 1, 2 or 5 times a power of ten apart: as few as there can be, but at least `least`."""
    power = 10.0 ** np.ceil(np.log10(high - low))
    for step in (s * power * scale for scale in (1.0, 0.1, 0.01) for s in (1.0, 0.5, 0.2)):
        count = np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1.0)
        if len(count) >= least:
            break
    return [float(v) for v in count * step + 0.0]


def _short(value: float) -> str:
    text = f"{value:.1f}"
    return text[:-2] if text.endswith(".0") else text


def _points(cell: _Cell, t: Array, y: Array) -> list[str]:
    across, up = cell.across(0.0), cell.up(0.0)
    xs = across + (cell.across(1.0) - across) * t
    ys = up + (cell.up(1.0) - up) * y
    return [f"{_short(a)} {_short(b)}" for a, b in zip(xs, ys, strict=True)]


def _line(
    x1: float,
    y1: float,
    x2: float,
    y2: float,
    color: str,
    *,
    dashed: bool = False,
    width: float = 0.8,
) -> str:
    dash = ' stroke-dasharray="4 2"' if dashed else ""
    return f'<path d="M{_short(x1)} {_short(y1)}L{_short(x2)} {_short(y2)}" stroke="{color}" stroke-width="{width}"{dash}/>'


def _rectangle(
    x: float, y: float, width: float, height: float, color: str, opacity: float = 1.0
) -> str:
    alpha = "" if opacity == 1.0 else f' fill-opacity="{opacity}"'
    return f'<rect x="{_short(x)}" y="{_short(y)}" width="{width:.1f}" height="{height:.1f}" fill="{color}"{alpha}/>'


def _text(
    x: float,
    y: float,
    text: str,
    *,
    size: float,
    anchor: str = "",
    color: str = "",
    weight: int = 0,
) -> str:
    extra = f' text-anchor="{anchor}"' if anchor else ""
    extra += f' fill="{color}"' if color else ""
    extra += f' font-weight="{weight}"' if weight else ""
    return (
        f'<text x="{_short(x)}" y="{_short(y)}" font-size="{size:g}"{extra}>{escape(text)}</text>'
    )
