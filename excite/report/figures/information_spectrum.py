"""Figures on identifiability: spectrum, links, base parameters, scenarios, optimiser's history."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..._types import FloatArray
from ...designer.experiment_comparison import Scenario
from ...designer.identifiability import Identifiability, IdentifiableShare
from ...designer.multistart import Attempt
from ...robot.parameter_names import percent
from .drawing import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    RED,
    SOFT,
    axes_grid,
    limit_ticks,
    render_svg,
    set_decade_ticks,
)
from .trajectory import short

_KINDS = (
    ("mass and centre of mass", ("m",), BLUE),
    ("inertia", ("I",), GREEN),
    ("drive (friction, rotor, offset)", ("F", "t"), ORANGE),
)


def draw_spectrum(identifiability: Identifiability) -> str:
    """Draw the dimensionless variance of every direction, the most accurate first."""
    variances = np.array([d.variance for d in identifiability.directions])
    good = np.array([d.identifiable for d in identifiability.directions])
    finite = variances[np.isfinite(variances)]
    top = 10.0 * float(max(finite.max(initial=0.0), identifiability.threshold))
    shown, rank = np.where(np.isfinite(variances), variances, top), np.arange(1, len(variances) + 1)

    def draw(figure: Any) -> None:
        axes = axes_grid(figure, 1, 1, margins=(0.6, 0.85, 0.3, 0.42))[0, 0]
        axes.set_yscale("log")
        set_decade_ticks(axes)
        for chosen, color, label in (
            (good, GREEN, "identifiable"),
            (~good, RED, "not identifiable"),
        ):
            if not chosen.any():
                continue
            axes.vlines(
                rank[chosen],
                min(shown.min(), identifiability.threshold) / 3.0,
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
        axes.axhline(identifiability.threshold, color=INK, linewidth=0.9, dashes=(4, 2))
        text = f"threshold ±{percent(np.sqrt(identifiability.threshold))}"
        axes.annotate(
            text,
            (0.0, identifiability.threshold),
            (4, 3),
            axes.get_yaxis_transform(),
            textcoords="offset points",
            fontsize=7.5,
        )
        axes.set_ylim(
            min(shown.min(), identifiability.threshold) / 3.0,
            3.0 * max(shown.max(), identifiability.threshold),
        )
        axes.set_xlim(0.2, len(rank) + 0.8)
        axes.set_xlabel("direction of the parameters, the most accurate first")
        axes.set_ylabel("dimensionless variance 1/λ")
        axes.legend(loc="lower right")
        _deviation_axis(axes)

    return render_svg("Dimensionless variance of every direction", 3.1, draw)


def _deviation_axis(axes: Any) -> None:
    """Add the same scale as a standard deviation, on the right."""
    low, high = axes.get_ylim()
    ticks = [k for k in range(-8, 9, 1 if high / low < 1e16 else 2) if low < 100.0**k < high]
    right = axes.secondary_yaxis("right")
    right.set_yticks(
        [100.0**k for k in ticks],
        [f"±{percent(10.0**k)}" if k < 1 else f"{10**k} times" for k in ticks],
    )
    right.set_ylabel("standard deviation in the metric", color=SOFT)


def draw_shares(links: Sequence[IdentifiableShare], joints: Sequence[IdentifiableShare]) -> str:
    """Draw the identifiable share of each link, and of each joint's drive parameters."""
    columns = [("links: mass, centre of mass, inertia", links)]
    if joints:
        columns.append(("joints: rotor inertia, friction, offset", joints))
    rows = max(len(links), len(joints))

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
                text = "not observable" if value is None else f"{100 * value:.0f} %"
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

    return render_svg("Share of each link and joint that is identifiable", 0.45 + 0.21 * rows, draw)


def draw_deviations(identifiability: Identifiability) -> str:
    """Draw the predicted standard deviation of each base parameter against its nominal value."""
    names = [b.name for b in identifiability.base_parameters]
    size = np.abs([b.nominal for b in identifiability.base_parameters])
    std = np.array([b.std for b in identifiability.base_parameters])
    usable = np.isfinite(std) & (std > 0.0)
    known = size > 1e-9 * max(size.max(initial=0.0), 1e-30)
    span = size[known & usable]
    low, high = (float(span.min()) / 3.0, float(span.max()) * 3.0) if len(span) else (0.1, 10.0)
    low = max(low, high * 1e-9)
    x = np.where(known, np.maximum(size, low), low / 12.0)

    def draw(figure: Any) -> None:
        axes = axes_grid(figure, 1, 1, margins=(0.6, 1.0, 0.3, 0.42))[0, 0]
        axes.set_xscale("log")
        axes.set_yscale("log")
        set_decade_ticks(axes)
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
        relative = np.divide(std, size, out=np.zeros_like(std), where=known & usable)
        _label_worst(axes, names, x, std, relative)
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

    return render_svg("Predicted standard deviations against nominal values", 3.9, draw)


def _kind(name: str) -> str:
    """Kind of a parameter: 'm', 'I' (inertia), 'F' (friction, rotor inertia) or 't' (offset)."""
    return "F" if name.startswith("Ia") else name[0]


def _label_worst(
    axes: Any, names: Sequence[str], x: FloatArray, y: FloatArray, ratio: FloatArray
) -> None:
    """Name the points of largest ratio, as far as there is room."""
    labelled: list[tuple[float, float]] = []
    for k in np.argsort(-ratio)[:12]:
        place = (float(np.log10(x[k])), float(np.log10(y[k])))
        free = all(abs(place[0] - a) > 0.4 or abs(place[1] - b) > 0.5 for a, b in labelled)
        if ratio[k] > 0.1 and free and len(labelled) < 6:
            labelled.append(place)
            axes.annotate(names[k], (x[k], y[k]), (4, 3), textcoords="offset points", fontsize=7)


def draw_scenarios(cases: Sequence[Scenario], threshold: float) -> str:
    """Draw the sorted variances of the motion as it is, and of each scenario."""
    names = {"now": "as designed", "time": "twice the time", "speed": "twice the speed"}

    def draw(figure: Any) -> None:
        axes = axes_grid(figure, 1, 1, margins=(0.6, 0.15, 0.3, 0.42))[0, 0]
        axes.set_yscale("log")
        set_decade_ticks(axes)
        for case, color in zip(cases, (BLUE, ORANGE, GREEN), strict=False):
            kept = case.eigenvalues > 0.0
            rank = np.arange(1, len(kept) + 1)[kept]
            label = f"{names.get(case.name, case.name)}: {case.identifiable_count} identifiable"
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
        axes.set_xlabel("direction of the parameters, the most accurate first")
        axes.set_ylabel("dimensionless variance 1/λ")
        axes.legend(loc="upper left")

    return render_svg("Variances with twice the time and twice the speed", 2.9, draw)


def draw_history(attempts: Sequence[Attempt]) -> str:
    """Draw the objective of all starts against iterations, and their final values."""

    several = len(attempts) > 1
    final = max(max(a.history.stage) for a in attempts)

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
        for attempt in reversed(attempts):
            best = attempt is attempts[0]
            last = np.array(attempt.history.stage) == final
            value, worst = (
                np.array(row)[last] for row in (attempt.history.objective, attempt.history.worst)
            )
            iteration = np.flatnonzero(last)
            inside = worst <= 1.0 + 1e-3
            color = BLUE if best else GREY
            left.plot(
                iteration,
                value,
                color=color,
                linewidth=1.5 if best else 0.8,
                zorder=3 if best else 2,
                label="chosen start" if best else None,
            )
            left.plot(
                iteration[~inside], value[~inside], "x", color=color, markersize=3.5, zorder=3
            )
        left.set_xlabel("iteration")
        left.set_ylabel("log of the criterion (lower is better)")
        left.set_title("Every start; × marks iterates outside a limit", loc="left")
        left.legend(loc="upper right")
        if several:
            _ends(
                figure.add_axes(
                    (8.0 / width, 0.42 / height, 2.4 / width, (height - 0.72) / height)
                ),
                attempts,
            )
        limit_ticks(left, 6, 5)

    return render_svg("Objective of every start against iterations", 3.0, draw)


def _ends(axes: Any, attempts: Sequence[Attempt]) -> None:
    """Draw the final value of each start above the best."""
    values = np.array([a.objective for a in attempts])
    excess = 100.0 * np.expm1(np.minimum(values - values.min(), 20.0))
    for place, k in enumerate(np.argsort(values, kind="stable"), start=1):
        feasible = attempts[k].feasible
        color = BLUE if k == 0 else GREY if feasible else RED
        fill = "white" if attempts[k].stopped else color
        axes.plot(
            place,
            excess[k],
            "o" if feasible else "x",
            color=color,
            markerfacecolor=fill,
            markersize=4 if len(values) <= 40 else 2.5,
        )
    any_stopped = any(a.stopped for a in attempts)
    axes.set_title(
        "Final values" + (" (○ stopped early)" if any_stopped else ", sorted"), loc="left"
    )
    axes.set_xlabel("start, the best first")
    axes.set_ylabel("% above the best")
    axes.set_xlim(0.3, len(values) + 0.7)
    axes.set_ylim(-0.05 * max(1.0, excess.max()), 1.08 * max(1.0, excess.max()))
    limit_ticks(axes, 5, 5)
    if len(values) <= 8:
        axes.set_xticks(range(1, len(values) + 1))
