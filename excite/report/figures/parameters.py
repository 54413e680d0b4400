"""Where each base parameter went from its nominal value, with its interval, on one scale for all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .drawing import BLUE, GREEN, GREY, INK, ORANGE, SOFT, limit_ticks, render_svg

Array = np.ndarray
_LINE = 0.155
_ROOM = 1.2
_SHARP = 0.5
"""An interval narrower than this share of a parameter's scale may widen the axis; others are cut off."""


@dataclass(frozen=True)
class Moved:
    """A base parameter's way from its nominal value in units of its scale. data: by the data alone; None where it isn't shown.

    half: of its 95 % interval. value: as the consistent model has it. body: of a link, not of a drive alone.
    """

    name: str
    data: float | None
    half: float
    value: float
    body: bool


def changes(entries: Sequence[Moved]) -> str:
    """A line for each base parameter: bodies on the left, drives on the right."""
    groups = [
        ("bodies", [e for e in entries if e.body]),
        ("friction, rotor inertia, offset", [e for e in entries if not e.body]),
    ]
    groups = [(title, group) for title, group in groups if group]
    most = max(len(group) for _, group in groups)
    height = 0.85 + _LINE * most

    def draw(figure: Any) -> None:
        width = figure.get_size_inches()[0]
        cell = (width - 0.6 - 0.75 * (len(groups) - 1) - 0.15) / len(groups)
        for k, (title, group) in enumerate(groups):
            size = _LINE * len(group)
            left = 0.6 + k * (cell + 0.75)
            axes = figure.add_axes(
                (left / width, (height - 0.42 - size) / height, cell / width, size / height)
            )
            _forest(axes, group)
            axes.set_title(title, loc="left")
        _legend(figure)

    return render_svg("Change of every base parameter with its 95 % interval", height, draw)


def _forest(axes: Any, group: Sequence[Moved]) -> None:
    limit = _limit(group)
    axes.axvline(0.0, color=INK, linewidth=0.8)
    for row, entry in enumerate(group):
        known = entry.data is not None and np.isfinite(entry.half)
        if known and entry.data is not None:
            low, high = entry.data - entry.half, entry.data + entry.half
            axes.plot(
                np.clip([low, high], -limit, limit),
                [row, row],
                color=BLUE,
                linewidth=1.1,
                alpha=0.55,
                solid_capstyle="butt",
            )
            if abs(entry.data) <= limit:
                axes.plot(entry.data, row, "o", color=BLUE, markersize=2.6)
            else:
                axes.plot(
                    np.sign(entry.data) * limit,
                    row,
                    ">" if entry.data > 0 else "<",
                    color=BLUE,
                    markersize=3.5,
                    clip_on=False,
                )
        axes.plot(
            np.clip(entry.value, -limit, limit),
            row,
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
    vague = [entry.data is None or entry.half > 1.0 for entry in group]
    axes.set_yticks(range(len(group)), [e.name for e in group], fontsize=6.8)
    for label, pale in zip(axes.get_yticklabels(), vague, strict=True):
        label.set_color(GREY if pale else INK)
    axes.set_ylim(len(group) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)


def _limit(group: Sequence[Moved]) -> float:
    sharp = [abs(e.data) + e.half for e in group if e.data is not None and e.half < _SHARP]
    return _ROOM * max([0.02, *sharp, *(abs(e.value) for e in group)])


def _legend(figure: Any) -> None:
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
    labels = ["by the data alone, 95 % interval", "as identified: consistent, with the prior"]
    figure.legend(
        handles, labels, loc="upper right", ncols=2, bbox_to_anchor=(0.995, 1.0), borderaxespad=0.0
    )


def decided(shares: Array) -> str:
    """How much of each direction's value the data decided, in the order of the spectrum; the rest is the prior's."""

    def draw(figure: Any) -> None:
        width, height = figure.get_size_inches()
        axes = figure.add_axes(
            (0.6 / width, 0.42 / height, (width - 0.85 - 0.6) / width, (height - 0.72) / height)
        )
        rank = np.arange(1, len(shares) + 1)
        axes.bar(
            rank, 1.0 - shares, bottom=shares, color="#f0d9bf", width=0.8, label="the prior decided"
        )
        axes.bar(rank, shares, color=GREEN, alpha=0.75, width=0.8, label="the data decided")
        axes.axhline(0.5, color=INK, linewidth=0.8, dashes=(4, 2))
        axes.set_xlim(0.2, len(shares) + 0.8)
        axes.set_ylim(0.0, 1.0)
        axes.set_yticks([0.0, 0.5, 1.0], ["0 %", "50 %", "100 %"])
        axes.set_xlabel("direction of the parameters, the best seen first")
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

    return render_svg("Share of each direction that the data decided", 1.9, draw)
