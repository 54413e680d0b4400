"""What a diagnosis found and considered, and the torque it predicts: the pictures beside the atlas."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ...diagnosis.diagnosis import Diagnosis
from ...diagnosis.isolability import Isolability
from ...effects.recorded_motion import split_by_motion
from ...identification.identification import Prediction
from .drawing import (
    BLUE,
    COMPACT_LAYOUT_JOINTS,
    GREY,
    INK,
    ORANGE,
    SOFT,
    limit_ticks,
    render_svg,
    thin_curve,
)
from .heatmap import Heatmap, draw_heatmap
from .torque_fit import SURE, window
from .trajectory import short, torque_units

Array = np.ndarray
_TORQUE, _RESIDUAL, _GAP = 1.15, 0.85, 0.62


def bars(stated: Mapping[str, Any]) -> str:
    """Held-out gain of every alternative alone, the findings in blue."""
    found = [(one, True) for one in stated["findings"]]
    names = {(one["effect"], one["joint"]) for one, _ in found}
    entries = found + [
        (one, False) for one in stated["considered"] if (one["effect"], one["joint"]) not in names
    ]
    entries = sorted(entries, key=lambda e: -e[0]["evidence"]["held_out_gain"])
    labels = [
        f"{told(one['effect'])}, {short(one['joint'] or 'whole robot', 22)}" for one, _ in entries
    ]
    gains = np.array([one["evidence"]["held_out_gain"] for one, _ in entries])

    def draw(figure: Any) -> None:
        width, height = figure.get_size_inches()
        axes = figure.add_axes(
            (2.6 / width, 0.42 / height, (width - 2.6 - 0.8) / width, (height - 0.5) / height)
        )
        y = np.arange(len(entries))[::-1]
        axes.barh(y, gains, color=[BLUE if chosen else GREY for _, chosen in entries], height=0.62)
        axes.set_yticks(y, labels)
        axes.tick_params(axis="y", length=0, labelsize=8, labelcolor=INK)
        axes.set_xlabel(
            "log-likelihood gained on the recordings it was not fitted to, alone beside the base model"
        )
        limit_ticks(axes, 6, 3)
        axes.set_yticks(y, labels)
        for place, gain in zip(y, gains, strict=True):
            words, at = f"{gain:.0f}".replace("-", "−"), (max(gain, 0.0), place)
            axes.annotate(
                words,
                at,
                (4.0, 0.0),
                textcoords="offset points",
                va="center",
                fontsize=7,
                color=SOFT,
            )

    return render_svg("Held-out gain of what was considered", 0.5 + 0.22 * len(entries), draw)


def told(effect: str) -> str:
    """An effect's name in a sentence."""
    return effect.replace("_", " ")


# -- prediction ------------------------------------------------------------------------------------------------------


def predictions(found: Diagnosis) -> Iterator[Prediction]:
    """Held-out recordings with the torque of the base model (`nominal`) and of that with the findings (`fitted`)."""
    every = found.motions[1]
    left = (split_by_motion(np.where(found.moving, residual, np.nan), every) for residual in found.residuals)
    for source, group in itertools.groupby(
        zip(every, *left, strict=True), key=lambda own: own[0].segment.source
    ):
        tracks, bare, named = zip(*group, strict=True)
        time = np.concatenate([track.time for track in tracks])
        measured = np.concatenate([track.torque for track in tracks])
        before, after = (measured - np.concatenate(parts) for parts in (bare, named))
        starts = np.cumsum([0, *(len(track) for track in tracks)])[:-1]
        yield Prediction(
            source, time, measured, before, after, found.floor, tuple(int(s) for s in starts)
        )


def traces(one: Prediction, found: Diagnosis, points: int) -> str:
    """Torque measured and predicted of every joint, and below it both residuals with the noise's band."""
    robot, changed = found.identified.model.robot, bool(found.verdict.chosen)
    columns = (
        1 if robot.n == 1 else 2 if robot.n <= 4 else 3 if robot.n <= COMPACT_LAYOUT_JOINTS else 5
    )
    rows = -(-robot.n // columns)
    step = _TORQUE + _RESIDUAL + _GAP
    height, span, units = 0.3 + rows * step, window(one), torque_units(robot)

    def draw(figure: Any) -> None:
        width = figure.get_size_inches()[0]
        cell = (width - 0.55 - 0.1 - 0.5 * (columns - 1)) / columns
        for joint in range(robot.n):
            row, column = divmod(joint, columns)
            left, top = 0.55 + column * (cell + 0.5), height - 0.46 - row * step
            upper = figure.add_axes(
                (left / width, (top - _TORQUE) / height, cell / width, _TORQUE / height)
            )
            bottom = top - _TORQUE - 0.07 - _RESIDUAL
            lower = figure.add_axes(
                (left / width, bottom / height, cell / width, _RESIDUAL / height), sharex=upper
            )
            _curves(
                upper,
                one,
                joint,
                span,
                points,
                ((one.measured, INK, 1.3), (one.nominal, ORANGE, 0.7), (one.fitted, BLUE, 0.7)),
                changed,
            )
            lower.axhline(0.0, color=GREY, linewidth=0.5)
            reach = SURE * float(found.floor[joint])
            lower.axhspan(-reach, reach, color=GREY, alpha=0.35, linewidth=0.0)
            left_over = (
                (one.measured - one.nominal, ORANGE, 0.7),
                (one.measured - one.fitted, BLUE, 0.8),
            )
            _curves(lower, one, joint, span, points, left_over, changed)
            upper.set_title(
                f"{short(robot.joints[joint], 20)} [{units[joint]}]",
                loc="left",
                fontweight="bold",
                pad=3,
            )
            limit_ticks(upper, 6, 3)
            limit_ticks(lower, 6, 3)
            upper.tick_params(labelbottom=False)
            upper.set_xlim(*span)
            if joint + columns >= robot.n:
                lower.set_xlabel("time [s]")
            if column == 0:
                lower.set_ylabel("residual")
        _legend(figure, changed)

    return render_svg(
        f"Measured and predicted torque on {one.source}, before and after", height, draw
    )


def _curves(
    axes: Any,
    one: Prediction,
    joint: int,
    span: tuple[float, float],
    points: int,
    drawn: Sequence[tuple[Array, str, float]],
    changed: bool,
) -> None:
    """Curves with a break wherever a stretch ends; that of the findings only where there are some."""
    for values, color, width in drawn:
        if color == BLUE and not changed:
            continue
        for start, stop in itertools.pairwise((*one.starts, len(values))):
            t = one.time[start:stop]
            inside = (t >= span[0]) & (t <= span[1])
            if inside.any():
                axes.plot(
                    *thin_curve(t[inside], values[start:stop, joint][inside], points),
                    color=color,
                    linewidth=width,
                )


def _legend(figure: Any, changed: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[tuple[Any, str]] = [
        (Line2D([], [], color=INK), "measured"),
        (Line2D([], [], color=ORANGE), "base model"),
    ]
    if changed:
        entries.append((Line2D([], [], color=BLUE), "with the findings"))
    entries.append((Patch(color=GREY, alpha=0.35), f"±{SURE:g} noise floors"))
    handles, labels = zip(*entries, strict=True)
    figure.legend(
        handles,
        labels,
        loc="upper right",
        ncols=len(labels),
        bbox_to_anchor=(0.995, 1.0),
        borderaxespad=0.0,
    )


# -- isolability -----------------------------------------------------------------------------------------------------


def alike(one: Isolability, joint: int, name: str) -> str:
    """How alike the effects at a joint are, those alike next to each other."""
    which = _ordered(one.matrix, one.of(joint))
    values = one.matrix[np.ix_(which, which)].copy()
    values[np.triu_indices(len(which))] = np.nan
    names = [
        told(one.candidates[k].effect)
        + (", whole robot" if one.candidates[k].joint is None else "")
        for k in which
    ]
    words = [
        [None if np.isnan(v) else f"{v:.2f}".replace("0.", ".") for v in row] for row in values
    ]
    return draw_heatmap(
        f"How alike effects at {name} are",
        Heatmap(names[1:], names[:-1], values[1:, :-1], words[1:]),
        cell=(34.0, 17.0),
    )


def _ordered(matrix: Array, which: Sequence[int]) -> list[int]:
    """By an average-linkage tree, so that what is alike lies together."""
    if len(which) < 3:
        return list(which)
    from scipy.cluster import hierarchy  # slow to import
    from scipy.spatial.distance import squareform

    distance = 1.0 - matrix[np.ix_(which, which)]
    np.fill_diagonal(distance, 0.0)
    tree = hierarchy.linkage(
        squareform(np.maximum(distance, 0.0), checks=False), "average", optimal_ordering=True
    )
    return [which[int(k)] for k in hierarchy.leaves_list(tree)]
