"""Figures of a diagnosis: gains of effects, held-out prediction, and correlations of effects."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..._types import FloatArray
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
from .torque_fit import NOISE_BAND_FLOORS, drawn_interval
from .trajectory import short, torque_units

_TORQUE_HEIGHT = 1.15
"""Height of a joint's torque panel [in]."""
_RESIDUAL_HEIGHT = 0.85
"""Height of a joint's residual panel [in]."""
_ROW_GAP = 0.62
"""Gap between rows of joints [in]."""


def effect_words(effect: str) -> str:
    """Name of an effect in a sentence."""
    return effect.replace("_", " ")


def draw_gains(document: Mapping[str, Any]) -> str:
    """Draw the held-out gain of every effect alone, the findings in blue.

    Args:
        document: The diagnosis as in `diagnosis.json`.
    """
    findings = {(f["effect"], f["joint"]) for f in document["findings"]}
    entries = [(entry, True) for entry in document["findings"]]
    entries += [
        (entry, False)
        for entry in document["considered"]
        if (entry["effect"], entry["joint"]) not in findings
    ]
    entries.sort(key=lambda pair: -pair[0]["evidence"]["held_out_gain"])
    labels = [
        f"{effect_words(entry['effect'])}, {short(entry['joint'] or 'whole robot', 22)}"
        for entry, _ in entries
    ]
    gains = np.array([entry["evidence"]["held_out_gain"] for entry, _ in entries])

    def draw(figure: Any) -> None:
        width, height = figure.get_size_inches()
        axes = figure.add_axes(
            (2.6 / width, 0.42 / height, (width - 2.6 - 0.8) / width, (height - 0.5) / height)
        )
        y = np.arange(len(entries))[::-1]
        colors = [BLUE if is_finding else GREY for _, is_finding in entries]
        axes.barh(y, gains, color=colors, height=0.62)
        axes.tick_params(axis="y", length=0, labelsize=8, labelcolor=INK)
        axes.set_xlabel(
            "gain of log-likelihood on held-out recordings, each effect alone with the base model"
        )
        limit_ticks(axes, 6, 3)
        axes.set_yticks(y, labels)
        for place, gain in zip(y, gains, strict=True):
            axes.annotate(
                f"{gain:.0f}".replace("-", "−"),
                (max(gain, 0.0), place),
                (4.0, 0.0),
                textcoords="offset points",
                va="center",
                fontsize=7,
                color=SOFT,
            )

    return render_svg("Held-out gain of each effect", 0.5 + 0.22 * len(entries), draw)


# -- prediction ------------------------------------------------------------------------------------


def held_out_predictions(diagnosis: Diagnosis) -> Iterator[Prediction]:
    """Held-out predictions: `nominal` is the base model, `fitted` has the findings."""
    motions = diagnosis.motions[1]
    residuals = (
        split_by_motion(np.where(diagnosis.moving, residual, np.nan), motions)
        for residual in diagnosis.residuals
    )
    for source, group in itertools.groupby(
        zip(motions, *residuals, strict=True), key=lambda entry: entry[0].segment.source
    ):
        stretches, without, with_findings = zip(*group, strict=True)
        time = np.concatenate([stretch.time for stretch in stretches])
        measured = np.concatenate([stretch.torque for stretch in stretches])
        before, after = (measured - np.concatenate(parts) for parts in (without, with_findings))
        starts = np.cumsum([0, *(len(stretch) for stretch in stretches)])[:-1]
        yield Prediction(
            source,
            time,
            measured,
            before,
            after,
            diagnosis.floor,
            tuple(int(start) for start in starts),
        )


def draw_predictions(prediction: Prediction, diagnosis: Diagnosis, points: int) -> str:
    """Draw measured and predicted torque of every joint, and both residuals with the noise band.

    Args:
        prediction: Torques along a held-out recording.
        diagnosis: The diagnosis.
        points: Largest number of points of a curve.
    """
    robot, has_findings = diagnosis.identified.model.robot, bool(diagnosis.verdict.chosen)
    is_compact = robot.n > COMPACT_LAYOUT_JOINTS
    columns = 5 if is_compact else 1 if robot.n == 1 else 2 if robot.n <= 4 else 3
    rows = -(-robot.n // columns)
    step = _TORQUE_HEIGHT + _RESIDUAL_HEIGHT + _ROW_GAP
    height, interval = 0.3 + rows * step, drawn_interval(prediction)
    units = torque_units(robot)

    def draw(figure: Any) -> None:
        width = figure.get_size_inches()[0]
        cell = (width - 0.55 - 0.1 - 0.5 * (columns - 1)) / columns
        for joint in range(robot.n):
            row, column = divmod(joint, columns)
            left, top = 0.55 + column * (cell + 0.5), height - 0.46 - row * step
            upper = figure.add_axes(
                (
                    left / width,
                    (top - _TORQUE_HEIGHT) / height,
                    cell / width,
                    _TORQUE_HEIGHT / height,
                )
            )
            bottom = top - _TORQUE_HEIGHT - 0.07 - _RESIDUAL_HEIGHT
            lower = figure.add_axes(
                (left / width, bottom / height, cell / width, _RESIDUAL_HEIGHT / height),
                sharex=upper,
            )
            torques = [
                (prediction.measured, INK, 1.3),
                (prediction.nominal, ORANGE, 0.7),
                (prediction.fitted, BLUE, 0.7),
            ]
            residuals = [
                (prediction.measured - prediction.nominal, ORANGE, 0.7),
                (prediction.measured - prediction.fitted, BLUE, 0.8),
            ]
            if not has_findings:
                torques, residuals = torques[:-1], residuals[:-1]
            _draw_curves(upper, prediction, joint, interval, points, torques)
            lower.axhline(0.0, color=GREY, linewidth=0.5)
            reach = NOISE_BAND_FLOORS * float(diagnosis.floor[joint])
            lower.axhspan(-reach, reach, color=GREY, alpha=0.35, linewidth=0.0)
            _draw_curves(lower, prediction, joint, interval, points, residuals)
            title = f"{short(robot.joints[joint], 20)} [{units[joint]}]"
            upper.set_title(title, loc="left", fontweight="bold", pad=3)
            limit_ticks(upper, 6, 3)
            limit_ticks(lower, 6, 3)
            upper.tick_params(labelbottom=False)
            upper.set_xlim(*interval)
            if joint + columns >= robot.n:
                lower.set_xlabel("time [s]")
            if column == 0:
                lower.set_ylabel("residual")
        _legend(figure, has_findings=has_findings)

    label = f"Measured and predicted torque on {prediction.source}, without and with the findings"
    return render_svg(label, height, draw)


def _draw_curves(
    axes: Any,
    prediction: Prediction,
    joint: int,
    interval: tuple[float, float],
    points: int,
    curves: Sequence[tuple[FloatArray, str, float]],
) -> None:
    """Draw curves (values, colour, width), interrupted where a stretch of the recording ends."""
    for values, color, width in curves:
        for start, stop in itertools.pairwise((*prediction.starts, len(values))):
            t = prediction.time[start:stop]
            inside = (t >= interval[0]) & (t <= interval[1])
            if inside.any():
                axes.plot(
                    *thin_curve(t[inside], values[start:stop, joint][inside], points),
                    color=color,
                    linewidth=width,
                )


def _legend(figure: Any, *, has_findings: bool) -> None:
    """Legend of all panels."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[tuple[Any, str]] = [
        (Line2D([], [], color=INK), "measured"),
        (Line2D([], [], color=ORANGE), "base model"),
    ]
    if has_findings:
        entries.append((Line2D([], [], color=BLUE), "with the findings"))
    entries.append((Patch(color=GREY, alpha=0.35), f"±{NOISE_BAND_FLOORS:g} noise floors"))
    handles, labels = zip(*entries, strict=True)
    figure.legend(
        handles,
        labels,
        loc="upper right",
        ncols=len(labels),
        bbox_to_anchor=(0.995, 1.0),
        borderaxespad=0.0,
    )


# -- separability ----------------------------------------------------------------------------------


def draw_correlations(isolability: Isolability, joint: int, name: str) -> str:
    """Draw the correlations between the effects at a joint, similar ones next to each other."""
    order = _cluster_order(isolability.matrix, isolability.of(joint))
    values = isolability.matrix[np.ix_(order, order)].copy()
    values[np.triu_indices(len(order))] = np.nan
    candidates = [isolability.candidates[k] for k in order]
    names = [
        effect_words(c.effect) + (", whole robot" if c.joint is None else "") for c in candidates
    ]
    words = [
        [None if np.isnan(v) else f"{v:.2f}".replace("0.", ".") for v in row] for row in values
    ]
    return draw_heatmap(
        f"Correlations between effects at {name}",
        Heatmap(names[1:], names[:-1], values[1:, :-1], words[1:]),
        cell=(34.0, 17.0),
    )


def _cluster_order(matrix: FloatArray, indices: Sequence[int]) -> list[int]:
    """Order by average-linkage clustering."""
    if len(indices) < 3:
        return list(indices)
    from scipy.cluster import hierarchy  # slow to import
    from scipy.spatial.distance import squareform

    distance = 1.0 - matrix[np.ix_(indices, indices)]
    np.fill_diagonal(distance, 0.0)
    tree = hierarchy.linkage(
        squareform(np.maximum(distance, 0.0), checks=False), "average", optimal_ordering=True
    )
    return [indices[int(k)] for k in hierarchy.leaves_list(tree)]
