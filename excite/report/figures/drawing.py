"""Matplotlib figures as small inline SVG. Matplotlib is imported only when something is drawn, and never its pyplot."""

from __future__ import annotations

import io
import itertools
import re
import warnings
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from ..._system.text import displayable
from ..page import escape, power_of_ten

Array = np.ndarray
T = TypeVar("T")
BLUE, ORANGE, GREY, RED, GREEN, INK, SOFT = (
    "#2f6fb5",
    "#d9822b",
    "#9aa4af",
    "#b3261e",
    "#1f7a4d",
    "#1c2530",
    "#5b6775",
)
SHADES = {"approach": "#e3e8ee", "ramp_in": "#fbe6cc", "ramp_out": "#fbe6cc", "return": "#e3e8ee"}
SEGMENT_WORDS = {"approach": "approach and return", "ramp_in": "ramps", "fourier": "excitation"}
WIDTH = 10.6
"""Width of a figure [in]; 72 units of the SVG each."""
_ACROSS = 3
"""Small panels in a row."""
MANY = 10
"""Robots with more joints than this get one figure per quantity."""
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "text.parse_math": False,  # a name may have a $; nothing here is typeset as mathematics
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


def render(label: str, height: float, draw: Callable[[Any], None], width: float = WIDTH) -> str:
    """Draw on a figure of `width` x `height` inches and return its SVG; `label` is what a screen reader says."""
    import matplotlib
    from matplotlib.figure import Figure

    label = displayable(label)  # it may name a file
    # the salt keeps the ids of one figure from those of another, and the same from run to run
    with matplotlib.rc_context({**_STYLE, "svg.hashsalt": label}), warnings.catch_warnings():
        # text stays text in the SVG; matplotlib's own font only measures it
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        canvas = Figure(figsize=(width, height))
        draw(canvas)
        buffer = io.StringIO()
        canvas.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return _slim(buffer.getvalue(), label, width)


def _slim(svg: str, label: str, width: float) -> str:
    """Matplotlib's SVG without what HTML does not need: prolog, metadata, ids of groups, excess digits, its own fonts."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
    svg = re.sub(r"<!--.*?-->", "", svg, flags=re.S)
    svg = re.sub(r"<[^>]*>", _slim_tag, svg)
    box = re.search(r'viewBox="[^"]*"', svg)
    head = f'<svg {box[0] if box else ""} role="img" aria-label="{escape(label)}" style="max-width:{width * 96:.0f}px">'
    svg = head + svg[svg.index(">") + 1 :]
    return re.sub(r">\s+<", "><", svg).strip()


def _slim_tag(tag: re.Match[str]) -> str:
    """One tag without ids, excess digits and fonts; text between tags, such as names, stays."""
    text = re.sub(r'^<g id="[^"]*"', "<g", tag[0]).replace("xlink:href", "href")
    text = re.sub(
        r'(?<= d=")[^"]*', lambda m: re.sub(r"-?\d+\.\d+", _short, " ".join(m[0].split())), text
    )
    text = re.sub(r"\d+\.\d{3,}", lambda m: f"{float(m[0]):.2f}", text)
    text = re.sub(r"font-family:[^;\"]*", "font-family: sans-serif", text)
    return re.sub(r"(font: [^;\"]*?px) [^;\"]*", r"\1 sans-serif", text)


def _short(match: re.Match[str]) -> str:
    text = f"{float(match[0]):.1f}"
    return text[:-2] if text.endswith(".0") else text


def grid(
    figure: Any,
    rows: int,
    columns: int,
    *,
    margins: Sequence[float],
    gaps: tuple[float, float] = (0.45, 0.3),
    share: str = "",
) -> Any:
    """Axes in a grid, margins (left, right, top, bottom) and gaps (between columns, rows) in inches. Shape (rows, columns)."""
    width, height = figure.get_size_inches()
    left, right, top, bottom = margins
    cell = (
        (width - left - right - gaps[0] * (columns - 1)) / columns,
        (height - top - bottom - gaps[1] * (rows - 1)) / rows,
    )
    out = np.empty((rows, columns), object)
    for i in range(rows):
        for j in range(columns):
            x, y = left + j * (cell[0] + gaps[0]), height - top - cell[1] - i * (cell[1] + gaps[1])
            first = out[0, 0] if "x" in share and (i or j) else None
            out[i, j] = figure.add_axes(
                (x / width, y / height, cell[0] / width, cell[1] / height), sharex=first
            )
    return out


def panels(title: str, things: Sequence[T], draw: Callable[[Any, T], None], height: float) -> str:
    """A small panel of each thing, three in a row. draw: onto axes. height: of a panel's axes [inches]."""
    rows = -(-len(things) // _ACROSS)

    def every(figure: Any) -> None:
        cells = grid(
            figure, rows, _ACROSS, margins=(0.55, 0.1, 0.25, 0.45), gaps=(0.55, 0.7)
        ).ravel()
        for axes, thing in zip(cells, things, strict=False):
            draw(axes, thing)
        for axes in cells[len(things) :]:
            axes.set_axis_off()

    return render(title, rows * (height + 0.7), every)


def thin(t: Array, y: Array, count: int) -> tuple[Array, Array]:
    """At most `count` points of a curve that keep the extremes of every stretch of it."""
    if len(t) <= count:
        return t, y
    edges = np.linspace(0, len(t), count // 2 + 1).astype(int)
    keep = {0, len(t) - 1}
    for start, stop in itertools.pairwise(edges):
        keep |= {start + int(np.argmin(y[start:stop])), start + int(np.argmax(y[start:stop]))}
    index = np.array(sorted(keep))
    return t[index], y[index]


def few_ticks(axes: Any, x: int = 4, y: int = 3) -> None:
    """Ticks that fit a small panel."""
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(x))
    axes.yaxis.set_major_locator(MaxNLocator(y))
    axes.grid(visible=True, color="#eef1f4", linewidth=0.5)
    axes.set_axisbelow(True)


def few_log(axes: Any) -> None:
    """A light grid at decades, without minor ticks."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_locator(LogLocator(10.0, numticks=9))
            axis.set_minor_locator(NullLocator())
            # plain text: matplotlib's own labels go through its slow mathematics typesetter
            axis.set_major_formatter(
                FuncFormatter(
                    lambda value, _: (
                        power_of_ten(int(np.rint(np.log10(value)))) if value > 0.0 else ""
                    )
                )
            )
    axes.grid(visible=True, axis="y", color="#eef1f4", linewidth=0.5)
    axes.set_axisbelow(True)
