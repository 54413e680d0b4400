"""Tables of shades for many numbers between 0 and 1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._types import BoolArray, FloatArray
from . import svg
from .drawing import FIGURE_WIDTH, INK, ORANGE, SOFT

_FULL_SHADE = (31, 95, 168)
"""Red, green and blue of a cell of value 1; a cell of value 0 is white."""
_LETTER_WIDTH = 4.6
"""Mean width of a letter of a label [units of the SVG]."""


@dataclass(frozen=True)
class Heatmap:
    """A table of shades.

    Attributes:
        rows: Labels of the rows.
        columns: Labels of the columns.
        values: 0 to 1; NaN where there is no value. Shape (rows, columns).
        words: Text in each cell; None where there is no cell at all.
        marked: Cells with a dot. Shape (rows, columns).
    """

    rows: Sequence[str]
    columns: Sequence[str]
    values: FloatArray
    words: Sequence[Sequence[str | None]]
    marked: BoolArray | None = None


def draw_heatmap(
    label: str, heatmap: Heatmap, *, cell: tuple[float, float], max_width: float = FIGURE_WIDTH
) -> str:
    """Draw a table of shades.

    Args:
        label: Description for screen readers.
        heatmap: The table.
        cell: Largest width and the height of a cell [units of the SVG].
        max_width: Largest width of the picture [in].
    """
    left = 10.0 + _LETTER_WIDTH * max(len(r) for r in heatmap.rows)
    slant = 0.7 * _LETTER_WIDTH * max(len(c) for c in heatmap.columns)
    top, right = 14.0 + slant, 6.0 + slant
    available = max_width * svg.UNITS_PER_INCH - left - right
    width = min(cell[0], available / len(heatmap.columns))
    total = left + right + width * len(heatmap.columns)
    bottom = top + cell[1] * len(heatmap.rows) + 6.0
    elements = []
    for k, name in enumerate(heatmap.columns):
        x = left + (k + 0.5) * width
        elements.append(svg.text(x, top - 5.0, name, size=8.0, rotation=-45.0))
    for i, name in enumerate(heatmap.rows):
        y = top + i * cell[1]
        middle = y + 0.5 * cell[1] + 3.0
        elements.append(svg.text(left - 6.0, middle, name, size=8.0, anchor="end"))
        for k in range(len(heatmap.columns)):
            elements += _cell(heatmap, i, k, (left + k * width, y, width, cell[1]))
    return svg.picture(label, total, bottom, elements, INK)


def _cell(heatmap: Heatmap, i: int, k: int, box: tuple[float, float, float, float]) -> list[str]:
    """Elements of a cell; box: x, y, width and height."""
    word, (x, y, width, height) = heatmap.words[i][k], box
    if word is None:
        return []
    value = float(heatmap.values[i, k])
    if np.isnan(value):
        color, ink = "#f4f6f8", SOFT
    else:
        share = min(max(value, 0.0), 1.0)
        color = f"rgb({','.join(str(round(255 - share * (255 - c))) for c in _FULL_SHADE)})"
        ink = "#fff" if share > 0.55 else INK
    elements = [svg.rectangle(x + 0.5, y + 0.5, width - 1.0, height - 1.0, color, stroke="#dde2e8")]
    if word:
        middle = (x + 0.5 * width, y + 0.5 * height + 2.6)
        elements.append(svg.text(*middle, word, size=7.0, anchor="middle", color=ink))
    if heatmap.marked is not None and heatmap.marked[i, k]:
        elements.append(svg.circle(x + width - 5.0, y + 5.0, 2.6, ORANGE, stroke="#fff"))
    return elements
