"""What the recording will tell, as pictures: spectrum, links, base parameters, scenarios, and the optimiser's history."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...designer.experiment_comparison import Scenario
from ...designer.identifiability import Identifiability, Share
from ...designer.sqp import FEASIBLE
from ...robot.parameter_names import percent
from ..record import DesignRecord
from .drawing import BLUE, GREEN, GREY, INK, ORANGE, RED, SOFT, few_log, few_ticks, grid, render
from .trajectory import short

Array = np.ndarray
_KINDS = (
    ("mass and centre of mass", ("m",), BLUE),
    ("inertia", ("I",), GREEN),
    ("drive (friction, rotor, offset)", ("F", "t"), ORANGE),
)


def spectrum(found: Identifiability) -> str:
    """Scale-free variance of every direction, the best seen first, on a logarithmic scale with the threshold."""
    variances = np.array([d.variance for d in found.directions])
    good = np.array([d.identifiable for d in found.directions])
    finite = variances[np.isfinite(variances)]
    top = 10.0 * float(max(finite.max(initial=0.0), found.threshold))
    shown, rank = np.where(np.isfinite(variances), variances, top), np.arange(1, len(variances) + 1)

    def draw(figure: Any) -> None:
        axes = grid(figure, 1, 1, margins=(0.6, 0.85, 0.3, 0.42))[0, 0]
        axes.set_yscale("log")
        few_log(axes)
        for chosen, color, label in (
            (good, GREEN, "identifiable"),
            (~good, RED, "not identifiable"),
        ):
            if not chosen.any():
                continue
            axes.vlines(
                rank[chosen],
                min(shown.min(), found.threshold) / 3.0,
                shown[chosen],
                color=color,
                alpha=0.25,
                linewidth=1.0,
            )
            axes.plot(
                rank[chosen],
                shown[chosen],
                "o",
                color=color,
                markersize=3.6,
                label=f"{label} ({int(chosen.sum())})",
            )
        unseen = ~np.isfinite(variances)
        if unseen.any():
            axes.plot(
                rank[unseen],
                shown[unseen],
                "^",
                color=RED,
                markersize=6,
                label=f"not excited at all ({int(unseen.sum())})",
            )
        axes.axhline(found.threshold, color=INK, linewidth=0.9, dashes=(4, 2))
        text = f"threshold ±{percent(np.sqrt(found.threshold))}"
        axes.annotate(
            text,
            (0.0, found.threshold),
            (4, 3),
            axes.get_yaxis_transform(),
            textcoords="offset points",
            fontsize=7.5,
        )
        axes.set_ylim(
            min(shown.min(), found.threshold) / 3.0, 3.0 * max(shown.max(), found.threshold)
        )
        axes.set_xlim(0.2, len(rank) + 0.8)
        axes.set_xlabel("direction of the parameters, the best seen first")
        axes.set_ylabel("scale-free variance 1/λ")
        axes.legend(loc="lower right")
        _deviation_axis(axes)

    return render("Scale-free variance of every direction", 3.1, draw)


def _deviation_axis(axes: Any) -> None:
    """The same scale as a relative standard deviation, on the right."""
    low, high = axes.get_ylim()
    ticks = [k for k in range(-8, 9, 1 if high / low < 1e16 else 2) if low < 100.0**k < high]
    right = axes.secondary_yaxis("right")
    right.set_yticks(
        [100.0**k for k in ticks],
        [f"±{percent(10.0**k)}" if k < 1 else f"{10**k} times" for k in ticks],
    )
    right.set_ylabel("standard deviation in the metric", color=SOFT)


def shares(links: Sequence[Share], joints: Sequence[Share]) -> str:
    """One bar per link, and per joint for its drive: how much of what can be known the recording shows."""
    columns = [("links: mass, centre of mass, inertia", links)]
    if joints:
        columns.append(("joints: rotor inertia, friction, offset", joints))
    most = max(len(links), len(joints))

    def draw(figure: Any) -> None:
        width, height = figure.get_size_inches()
        for k, (title, entries) in enumerate(columns):
            left, top = 1.75 + k * 5.3, 0.32
            size = 0.21 * len(entries)
            axes = figure.add_axes(
                (left / width, (height - top - size) / height, 3.0 / width, size / height)
            )
            for row, entry in enumerate(entries):
                value = entry.identifiable_share
                axes.barh(row, 1.0, color="#edf0f3", height=0.7)
                if value is not None:
                    axes.barh(row, value, color=BLUE, height=0.7)
                text = "nothing to see" if value is None else f"{100 * value:.0f} %"
                axes.text(
                    1.015,
                    row,
                    text,
                    va="center",
                    fontsize=7.5,
                    color=INK if value is not None else SOFT,
                )
            axes.set_yticks(
                range(len(entries)), [short(e.name, 28) for e in entries], fontsize=7.5, color=INK
            )
            axes.set_ylim(len(entries) - 0.5, -0.5)
            axes.set_xlim(0.0, 1.0)
            axes.set_xticks([])
            axes.tick_params(length=0)
            for side in ("left", "bottom"):
                axes.spines[side].set_visible(False)
            axes.set_title(title, loc="left")

    return render("Share of each link and joint that is identifiable", 0.45 + 0.21 * most, draw)


def deviations(found: Identifiability) -> str:
    """Predicted standard deviation of each base parameter against its nominal size, both on logarithmic scales."""
    names = [b.name for b in found.base_parameters]
    size = np.abs([b.nominal for b in found.base_parameters])
    std = np.array([b.std for b in found.base_parameters])
    usable = np.isfinite(std) & (std > 0.0)
    known = size > 1e-9 * max(size.max(initial=0.0), 1e-30)
    span = size[known & usable]
    low, high = (float(span.min()) / 3.0, float(span.max()) * 3.0) if len(span) else (0.1, 10.0)
    low = max(low, high * 1e-9)
    x = np.where(known, np.maximum(size, low), low / 12.0)

    def draw(figure: Any) -> None:
        axes = grid(figure, 1, 1, margins=(0.6, 1.0, 0.3, 0.42))[0, 0]
        axes.set_xscale("log")
        axes.set_yscale("log")
        few_log(axes)
        top = float(std[usable].max()) * 8.0 if usable.any() else high
        if usable.any():
            axes.set_ylim(float(std[usable].min()) / 5.0, top)
        for ratio, text in ((0.01, "1 %"), (0.1, "10 %"), (1.0, "100 %")):
            end = min(high, top / ratio)
            axes.plot(
                (low, end),
                (ratio * low, ratio * end),
                color=GREY,
                linewidth=0.7,
                dashes=(3, 2),
                zorder=1,
            )
            axes.annotate(
                text,
                (end, ratio * end),
                (3, 0),
                textcoords="offset points",
                fontsize=7,
                color=SOFT,
                va="center",
            )
        for label, starts, color in _KINDS:
            chosen = usable & np.array([_kind(n) in starts for n in names])
            if chosen.any():
                axes.plot(
                    x[chosen],
                    std[chosen],
                    "o",
                    color=color,
                    markersize=4,
                    alpha=0.85,
                    label=label,
                    zorder=2,
                )
        _label_worst(
            axes, names, x, std, np.where(known & usable, std / np.maximum(size, 1e-300), 0.0)
        )
        if (~known & usable).any():
            axes.axvspan(low / 40.0, low / 3.6, color="#f3f5f7", linewidth=0, zorder=0)
            axes.annotate(
                "nominal 0",
                (low / 12.0, 0.985),
                xycoords=axes.get_xaxis_transform(),
                ha="center",
                va="top",
                fontsize=7,
                color=SOFT,
            )
        axes.set_xlim(low / 40.0 if (~known & usable).any() else low / 1.5, high * 1.05)
        axes.set_xlabel("|nominal value| of the base parameter [SI]")
        axes.set_ylabel("predicted standard deviation [SI]")
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(
            handles,
            labels,
            loc="upper left",
            ncols=3,
            bbox_to_anchor=(0.05, 0.995),
            borderaxespad=0.0,
        )

    return render("Predicted standard deviations against nominal values", 3.9, draw)


def _kind(name: str) -> str:
    """'m', 'I' (inertia), 'F' (friction and rotor inertia) or 't' (offset)."""
    return "F" if name.startswith("Ia") else name[0]


def _label_worst(axes: Any, names: Sequence[str], x: Array, y: Array, ratio: Array) -> None:
    taken: list[tuple[float, float]] = []
    for k in np.argsort(-ratio)[:12]:
        place = (float(np.log10(x[k])), float(np.log10(y[k])))
        free = all(abs(place[0] - a) > 0.4 or abs(place[1] - b) > 0.5 for a, b in taken)
        if ratio[k] > 0.1 and free and len(taken) < 6:
            taken.append(place)
            axes.annotate(names[k], (x[k], y[k]), (4, 3), textcoords="offset points", fontsize=7)


def scenarios(cases: Sequence[Scenario], threshold: float) -> str:
    """Sorted variances as the motion is, and with each change."""
    names = {"now": "as designed", "time": "twice the time", "speed": "twice the speed"}

    def draw(figure: Any) -> None:
        axes = grid(figure, 1, 1, margins=(0.6, 0.15, 0.3, 0.42))[0, 0]
        axes.set_yscale("log")
        few_log(axes)
        for case, color in zip(cases, (BLUE, ORANGE, GREEN), strict=False):
            kept = case.eigenvalues > 0.0
            rank = np.arange(1, len(kept) + 1)[kept]
            label = f"{names.get(case.name, case.name)}: {case.identifiable} identifiable"
            axes.plot(
                rank,
                1.0 / case.eigenvalues[kept],
                "o-",
                color=color,
                markersize=2.2,
                linewidth=0.9,
                label=label,
            )
        axes.axhline(threshold, color=INK, linewidth=0.9, dashes=(4, 2))
        axes.annotate(
            "threshold",
            (0.0, threshold),
            (4, 3),
            axes.get_yaxis_transform(),
            textcoords="offset points",
            fontsize=7.5,
        )
        axes.set_xlim(0.2, len(cases[0].eigenvalues) + 0.8)
        axes.set_xlabel("direction of the parameters, the best seen first")
        axes.set_ylabel("scale-free variance 1/λ")
        axes.legend(loc="upper left")

    return render("Variances with twice the time and twice the speed", 2.9, draw)


def history(record: DesignRecord) -> str:
    """Objective of all starts against iterations, and where each of them ended."""
    several = len(record.starts) > 1
    final = max(max(s.get("stage") or [0]) for s in record.starts)

    def draw(figure: Any) -> None:
        width, height = figure.get_size_inches()
        left = figure.add_axes(
            (
                0.6 / width,
                0.42 / height,
                (6.6 if several else 9.8) / width,
                (height - 0.72) / height,
            )
        )
        order = [k for k in range(len(record.starts)) if k != record.chosen] + [record.chosen]
        for k in order:
            start, best = record.starts[k], k == record.chosen
            iterations = np.flatnonzero(
                np.array(start.get("stage") or [0] * len(start["objective"]), int) == final
            )
            value, worst = (
                np.array(start[key], float)[iterations] for key in ("objective", "worst")
            )
            color, label = BLUE if best else GREY, "chosen start" if best else None
            left.plot(
                iterations,
                value,
                color=color,
                linewidth=1.5 if best else 0.8,
                zorder=3 if best else 2,
                label=label,
            )
            outside = worst > FEASIBLE
            left.plot(
                iterations[outside], value[outside], "x", color=color, markersize=3.5, zorder=3
            )
        left.set_xlabel("iterations")
        left.set_ylabel("log of the criterion (lower is better)")
        left.set_title("Every start; × marks iterates outside a limit", loc="left")
        left.legend(loc="upper right")
        if several:
            _ends(
                figure.add_axes(
                    (8.0 / width, 0.42 / height, 2.4 / width, (height - 0.72) / height)
                ),
                record,
            )
        few_ticks(left, 6, 5)

    return render("Objective of every start against iterations", 3.0, draw)


def _ends(axes: Any, record: DesignRecord) -> None:
    values = np.array([float(s["value"]) for s in record.starts])
    excess = 100.0 * np.expm1(np.minimum(values - values.min(), 20.0))
    for place, k in enumerate(np.argsort(values, kind="stable"), start=1):
        feasible = bool(record.starts[k]["feasible"])
        color = BLUE if k == record.chosen else GREY if feasible else RED
        stopped = bool(record.starts[k].get("stopped"))
        fill = "white" if stopped else color
        axes.plot(
            place,
            excess[k],
            "o" if feasible else "x",
            color=color,
            markerfacecolor=fill,
            markersize=4 if len(values) <= 40 else 2.5,
        )
    some = any(s.get("stopped") for s in record.starts)
    axes.set_title("Where they ended" + (" (○ stopped)" if some else ", sorted"), loc="left")
    axes.set_xlabel("start, the best first")
    axes.set_ylabel("% above the best")
    axes.set_xlim(0.3, len(values) + 0.7)
    axes.set_ylim(-0.05 * max(1.0, excess.max()), 1.08 * max(1.0, excess.max()))
    few_ticks(axes, 5, 5)
    if len(values) <= 8:
        axes.set_xticks(range(1, len(values) + 1))
