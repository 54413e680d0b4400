"""Draw matplotlib figures as small inline SVG.

Matplotlib is imported only when a figure is drawn, and its pyplot never.
"""

from __future__ import annotations

import io
import itertools
import warnings
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from ..._types import FloatArray
from ..formatting import number, power_of_ten
from . import svg

T = TypeVar("T")

BLUE = "#2f6fb5"
ORANGE = "#d9822b"
GREY = "#9aa4af"
RED = "#b3261e"
GREEN = "#1f7a4d"
INK = "#1c2530"
"""Colour of texts and of measured signals."""
SOFT = "#5b6775"
"""Colour of secondary texts."""
GRID_COLOR = "#eef1f4"

SEGMENT_COLORS = {
    "approach": "#e3e8ee",
    "ramp_in": "#fbe6cc",
    "ramp_out": "#fbe6cc",
    "return": "#e3e8ee",
}
"""Background of the segments of a motion; the excitation itself has none."""
SEGMENT_WORDS = {"approach": "approach and return", "ramp_in": "ramps", "fourier": "excitation"}

FIGURE_WIDTH = 10.6
"""Width of a figure [in]."""
SUBTITLE_HEIGHT = 0.15
"""Height of a second line below the title of a panel [in]."""
PANELS_PER_ROW = 3
"""Small panels side by side in `render_panels`."""
PANEL_FONT_SIZE = 9.0
"""Size of the texts at the axes of `render_panels` [pt]."""
COMPACT_LAYOUT_JOINTS = 10
"""Robots with more joints than this get smaller panels and one figure per quantity."""

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "text.parse_math": False,  # a name may contain a $; no text is typeset as mathematics
    "font.size": 8.0,
    "font.family": "DejaVu Sans",
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.0,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.minor.size": 0.0,
    "ytick.minor.size": 0.0,
    "lines.linewidth": 1.0,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
    "figure.facecolor": "white",
    "axes.unicode_minus": True,
}


def render_svg(label: str, height: float, draw: Callable[[Any], None]) -> str:
    """Draw a figure and return its SVG, the same from run to run.

    Args:
        label: Description for screen readers.
        height: Height [in].
        draw: Draws on the matplotlib figure.
    """
    import matplotlib
    from matplotlib.figure import Figure

    # the salt makes ids unique among the figures of a page and equal from run to run
    with matplotlib.rc_context({**_STYLE, "svg.hashsalt": label}), warnings.catch_warnings():
        # the browser sets the text; matplotlib's own font is only used to measure it
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure = Figure(figsize=(FIGURE_WIDTH, height))
        draw(figure)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return svg.shorten(buffer.getvalue(), label, FIGURE_WIDTH)


def axes_grid(
    figure: Any,
    rows: int,
    columns: int,
    *,
    margins: Sequence[float],
    gaps: tuple[float, float] = (0.45, 0.3),
) -> Any:
    """Add axes in a grid.

    Args:
        figure: Matplotlib figure.
        rows: Number of rows.
        columns: Number of columns.
        margins: Left, right, top and bottom margin [in].
        gaps: Gap between columns and between rows [in].

    Returns:
        Array of axes, shape (rows, columns).
    """
    width, height = figure.get_size_inches()
    left, right, top, bottom = margins
    cell = (
        (width - left - right - gaps[0] * (columns - 1)) / columns,
        (height - top - bottom - gaps[1] * (rows - 1)) / rows,
    )
    axes = np.empty((rows, columns), object)
    for i in range(rows):
        for j in range(columns):
            x, y = left + j * (cell[0] + gaps[0]), height - top - cell[1] - i * (cell[1] + gaps[1])
            axes[i, j] = figure.add_axes((x / width, y / height, cell[0] / width, cell[1] / height))
    return axes


def render_panels(
    label: str,
    entries: Sequence[T],
    draw: Callable[[Any, T], None],
    height: float,
    *,
    subtitles: bool = False,
) -> str:
    """Draw a small panel for each entry, three in a row.

    Args:
        label: Description for screen readers.
        entries: Data of each panel.
        draw: Draws one entry on its axes.
        height: Height of a panel's axes [in].
        subtitles: Whether panels have a second line below their title.
    """
    rows = -(-len(entries) // PANELS_PER_ROW)
    line = SUBTITLE_HEIGHT if subtitles else 0.0
    gap = 0.75 + line

    def draw_all(figure: Any) -> None:
        cells = axes_grid(
            figure, rows, PANELS_PER_ROW, margins=(0.7, 0.1, 0.25 + line, 0.5), gaps=(0.75, gap)
        ).ravel()
        for axes, entry in zip(cells, entries, strict=False):
            draw(axes, entry)
            axes.tick_params(labelsize=PANEL_FONT_SIZE)
            axes.xaxis.label.set_size(PANEL_FONT_SIZE)
            axes.yaxis.label.set_size(PANEL_FONT_SIZE)
        for axes in cells[len(entries) :]:
            axes.set_axis_off()

    return render_svg(label, rows * (height + gap), draw_all)


def set_titles(axes: Any, title: str, subtitle: str) -> None:
    """Write the title of a panel and below it a second line, both on the left."""
    size = 72.0 * SUBTITLE_HEIGHT
    axes.set_title(title, loc="left", fontweight="bold", pad=3.0 + size)
    axes.annotate(
        subtitle, (0.0, 1.0), (0.0, 3.0), "axes fraction", "offset points", fontsize=8, color=SOFT
    )


def thin_curve(t: FloatArray, y: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Reduce a curve to about `count` points that keep the extremes of every stretch of it.

    Args:
        t: Abscissae, ascending. Shape (N,).
        y: Ordinates. Shape (N,).
        count: Number of points to keep.
    """
    if len(t) <= count:
        return t, y
    edges = np.linspace(0, len(t), count // 2 + 1).astype(int)
    keep = {0, len(t) - 1}
    for start, stop in itertools.pairwise(edges):
        keep |= {start + int(np.argmin(y[start:stop])), start + int(np.argmax(y[start:stop]))}
    index = np.array(sorted(keep))
    return t[index], y[index]


def limit_ticks(axes: Any, x: int = 4, y: int = 3) -> None:
    """Set at most so many ticks as fit a small panel, with a light grid."""
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(x))
    axes.yaxis.set_major_locator(MaxNLocator(y))
    axes.grid(visible=True, color=GRID_COLOR, linewidth=0.5)
    axes.set_axisbelow(True)


def set_decade_ticks(axes: Any, *, divided: bool = False) -> None:
    """Set ticks at the decades of logarithmic axes, with a light horizontal grid.

    Args:
        axes: Matplotlib axes.
        divided: Whether there are ticks at 2 and 5 of each decade too.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    subs = (1.0, 2.0, 5.0) if divided else (1.0,)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_locator(LogLocator(10.0, subs, numticks=9))
            axis.set_minor_locator(NullLocator())
            # plain text: matplotlib's own labels go through its slow mathematics typesetter
            axis.set_major_formatter(FuncFormatter(_plain_label if divided else _decade_label))
    axes.grid(visible=True, axis="y", color=GRID_COLOR, linewidth=0.5)
    axes.set_axisbelow(True)


def _plain_label(value: float, _: int) -> str:
    """Label of a tick on a logarithmic axis whose decades are divided."""
    return number(value, 1)


def _decade_label(value: float, _: int) -> str:
    """Label of a tick on a logarithmic axis."""
    return power_of_ten(int(np.rint(np.log10(value)))) if value > 0.0 else ""
