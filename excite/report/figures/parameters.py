"""Figures of base parameters: changes with intervals, and shares of data and prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._types import FloatArray
from .drawing import BLUE, GREEN, GREY, INK, ORANGE, SOFT, limit_ticks, render_svg

_LINE_HEIGHT = 0.155
"""Height of a parameter's line [in]."""
_AXIS_FACTOR = 1.2
"""Half range of the axis over the largest change."""
_NARROW_INTERVAL = 0.5
"""Intervals narrower than this share of a parameter's scale widen the axis; others are cut."""


@dataclass(frozen=True)
class ParameterChange:
    """Change of a base parameter from its nominal value, in units of its scale.

    Attributes:
        name: Name of the parameter.
        data: Change by the data alone; None where they do not identify it.
        half_width: Half width of its 95 % interval.
        value: Change of the physically consistent model.
        is_inertial: Whether it is a parameter of links, not of a joint drive alone.
    """

    name: str
    data: float | None
    half_width: float
    value: float
    is_inertial: bool


def draw_changes(entries: Sequence[ParameterChange]) -> str:
    """Draw a line for each base parameter: links on the left, joint drives on the right."""
    groups = [
        ("links", [e for e in entries if e.is_inertial]),
        ("friction, rotor inertia, offset", [e for e in entries if not e.is_inertial]),
    ]
    groups = [(title, group) for title, group in groups if group]
    rows = max(len(group) for _, group in groups)
    height = 0.85 + _LINE_HEIGHT * rows

    def draw(figure: Any) -> None:
        width = figure.get_size_inches()[0]
        cell = (width - 0.6 - 0.75 * (len(groups) - 1) - 0.15) / len(groups)
        for k, (title, group) in enumerate(groups):
            size = _LINE_HEIGHT * len(group)
            left = 0.6 + k * (cell + 0.75)
            axes = figure.add_axes(
                (left / width, (height - 0.42 - size) / height, cell / width, size / height)
            )
            _draw_intervals(axes, group)
            axes.set_title(title, loc="left", y=1.0)  # no search above the ticks
        _legend(figure)

    return render_svg("Change of every base parameter with its 95 % interval", height, draw)


def _draw_intervals(axes: Any, group: Sequence[ParameterChange]) -> None:
    """Draw the interval and the identified value of each parameter."""
    limit = _limit(group)
    axes.axvline(0.0, color=INK, linewidth=0.8)
    rows = np.arange(len(group))
    data = np.array([np.nan if e.data is None else e.data for e in group], float)
    half = np.array([e.half_width for e in group], float)
    known = np.isfinite(data) & np.isfinite(half)
    # all intervals in one line, interrupted by NaN: an artist for each takes matplotlib long
    ends = np.clip([data - half, data + half], -limit, limit)[:, known]
    axes.plot(
        np.vstack([ends, np.full(known.sum(), np.nan)]).ravel(order="F"),
        np.repeat(rows[known], 3),
        color=BLUE,
        linewidth=1.1,
        alpha=0.55,
        solid_capstyle="butt",
    )
    is_inside = known & (np.abs(data) <= limit)
    axes.plot(data[is_inside], rows[is_inside], "o", color=BLUE, markersize=2.6)
    for sign, marker in ((1.0, ">"), (-1.0, "<")):
        beyond = known & (sign * data > limit)
        axes.plot(
            np.full(beyond.sum(), sign * limit),
            rows[beyond],
            marker,
            color=BLUE,
            markersize=3.5,
            clip_on=False,
        )
    axes.plot(
        np.clip([e.value for e in group], -limit, limit),
        rows,
        "D",
        color=ORANGE,
        markersize=5.0,
        markerfacecolor="none",
        markeredgewidth=0.9,
    )
    axes.set_xlim(-limit, limit)
    limit_ticks(axes, 5, 5)
    axes.xaxis.set_major_formatter(
        lambda value, _: f"{100.0 * value:+.5g} %".replace("-", "−") if value else "nominal"
    )
    vague = [entry.data is None or entry.half_width > 1.0 for entry in group]
    axes.set_yticks(range(len(group)), [e.name for e in group], fontsize=6.8)
    for label, pale in zip(axes.get_yticklabels(), vague, strict=True):
        label.set_color(GREY if pale else INK)
    axes.set_ylim(len(group) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)


def _limit(group: Sequence[ParameterChange]) -> float:
    """Half range of the axis."""
    narrow = [
        abs(e.data) + e.half_width
        for e in group
        if e.data is not None and e.half_width < _NARROW_INTERVAL
    ]
    return _AXIS_FACTOR * max([0.02, *narrow, *(abs(e.value) for e in group)])


def _legend(figure: Any) -> None:
    """Legend of both columns."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=BLUE, marker="o", markersize=2.6),
        Line2D(
            [],
            [],
            color=ORANGE,
            marker="D",
            markersize=5.0,
            markerfacecolor="none",
            linestyle="none",
        ),
    ]
    labels = ["data alone, 95 % interval", "identified: physically consistent, with prior"]
    figure.legend(
        handles, labels, loc="upper right", ncols=2, bbox_to_anchor=(0.995, 1.0), borderaxespad=0.0
    )


def draw_data_shares(shares: FloatArray) -> str:
    """Draw the weight of the data in each direction, in the order of the spectrum."""

    def draw(figure: Any) -> None:
        width, height = figure.get_size_inches()
        axes = figure.add_axes(
            (0.6 / width, 0.42 / height, (width - 0.85 - 0.6) / width, (height - 0.72) / height)
        )
        rank = np.arange(1, len(shares) + 1)
        axes.bar(rank, 1.0 - shares, bottom=shares, color="#f0d9bf", width=0.8, label="prior")
        axes.bar(rank, shares, color=GREEN, alpha=0.75, width=0.8, label="data")
        axes.axhline(0.5, color=INK, linewidth=0.8, dashes=(4, 2))
        axes.set_xlim(0.2, len(shares) + 0.8)
        axes.set_ylim(0.0, 1.0)
        axes.set_yticks([0.0, 0.5, 1.0], ["0 %", "50 %", "100 %"])
        axes.set_xlabel("direction of the parameters, the most accurate first")
        axes.tick_params(colors=SOFT)
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(
            handles[::-1],
            labels[::-1],
            loc="upper right",
            ncols=2,
            bbox_to_anchor=(0.93, 1.0),
            borderaxespad=0.0,
        )

    return render_svg("Weight of the data in each direction", 1.9, draw)
