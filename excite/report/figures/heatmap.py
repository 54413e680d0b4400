"""Tables of shades, written as SVG directly: what stands out of many numbers between 0 and 1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..page import escape
from .drawing import FIGURE_WIDTH, INK, ORANGE, SOFT

Array = np.ndarray
_UNITS = 72.0
_DARK = (31, 95, 168)
_LETTER = 4.6
"""Width of a letter of a label."""


@dataclass(frozen=True)
class Heat:
    """values: 0 to 1, NaN where there is nothing to show. words: in cells, None for no cell at all. marked: with a dot. Shapes (r, c)."""

    rows: Sequence[str]
    columns: Sequence[str]
    values: Array
    words: Sequence[Sequence[str | None]]
    marked: Array | None = None


def heat(label: str, shown: Heat, *, cell: tuple[float, float], most: float = FIGURE_WIDTH) -> str:
    """The table as SVG. cell: the largest width and the height of a cell."""
    left = 10.0 + _LETTER * max(len(r) for r in shown.rows)
    slant = 0.7 * _LETTER * max(len(c) for c in shown.columns)
    top, right = 14.0 + slant, 6.0 + slant
    width = min(cell[0], (most * _UNITS - left - right) / len(shown.columns))
    total, bottom = left + right + width * len(shown.columns), top + cell[1] * len(shown.rows) + 6.0
    parts = []
    for k, name in enumerate(shown.columns):
        x = left + (k + 0.5) * width
        parts.append(
            f'<text transform="translate({x:.1f} {top - 5.0:.1f}) rotate(-45)" font-size="8">{escape(name)}</text>'
        )
    for i, name in enumerate(shown.rows):
        y = top + i * cell[1]
        parts.append(
            f'<text x="{left - 6.0:.1f}" y="{y + 0.5 * cell[1] + 3.0:.1f}" font-size="8" text-anchor="end">{escape(name)}</text>'
        )
        for k in range(len(shown.columns)):
            parts += _cell(shown, i, k, (left + k * width, y, width, cell[1]))
    head = f'<svg viewBox="0 0 {total:.1f} {bottom:.1f}" role="img" aria-label="{escape(label)}" '
    return f'{head}style="max-width:{total / _UNITS * 96:.0f}px" font-family="sans-serif" fill="{INK}">{"".join(parts)}</svg>'


def _cell(shown: Heat, i: int, k: int, box: tuple[float, float, float, float]) -> list[str]:
    word, (x, y, width, height) = shown.words[i][k], box
    if word is None:
        return []
    value = float(shown.values[i, k])
    if np.isnan(value):
        color, ink = "#f4f6f8", SOFT
    else:
        share = min(max(value, 0.0), 1.0)
        color = f"rgb({','.join(str(round(255 - share * (255 - c))) for c in _DARK)})"
        ink = "#fff" if share > 0.55 else INK
    place = (
        f'x="{x + 0.5:.1f}" y="{y + 0.5:.1f}" width="{width - 1.0:.1f}" height="{height - 1.0:.1f}"'
    )
    parts = [f'<rect {place} fill="{color}" stroke="#dde2e8" stroke-width=".4"/>']
    if word:
        middle = f'x="{x + 0.5 * width:.1f}" y="{y + 0.5 * height + 2.6:.1f}"'
        parts.append(
            f'<text {middle} font-size="7" text-anchor="middle" fill="{ink}">{escape(word)}</text>'
        )
    if shown.marked is not None and shown.marked[i, k]:
        parts.append(
            f'<circle cx="{x + width - 5.0:.1f}" cy="{y + 5.0:.1f}" r="2.6" fill="{ORANGE}" stroke="#fff" stroke-width=".8"/>'
        )
    return parts
