"""Measured torque against predicted, joint by joint, and what is left: the picture that a model is judged by."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...identification.identification import Prediction
from ...robot.parameter_names import multiple, percent
from ...robot.robot import Robot
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
from .trajectory import short, torque_units

Array = np.ndarray
EXCERPT = 40.0
"""Longer recordings are drawn in part [s]; the error of all of it is in the table."""
SURE = 2.0
"""Noise floors that hold 95 % of the noise."""


@dataclass(frozen=True)
class _Row:
    """Height of a joint's torque panel and of its residual's, and what lies between rows of joints [in]."""

    torque: float
    residual: float
    gap: float = 0.62


def window(prediction: Prediction) -> tuple[float, float]:
    """Start and end of what is drawn [s]: all of it, or the stretch around the largest error relative to a joint's torque."""
    first, last = float(prediction.time[0]), float(prediction.time[-1])
    if last - first <= EXCERPT:
        return first, last
    size = np.sqrt(np.mean(prediction.measured**2, axis=0))
    worst = int(
        np.argmax(
            np.max(
                np.abs(np.nan_to_num(prediction.measured - prediction.fitted))
                / np.maximum(size, 1e-300),
                axis=1,
            )
        )
    )
    start = float(np.clip(prediction.time[worst] - 0.5 * EXCERPT, first, last - EXCERPT))
    return start, start + EXCERPT


def traces(prediction: Prediction, robot: Robot, points: int) -> str:
    """Torque measured, before and after, and the residual below it with its noise's band. points: of a curve at the most."""
    columns = (
        1 if robot.n == 1 else 2 if robot.n <= 4 else 3 if robot.n <= COMPACT_LAYOUT_JOINTS else 5
    )
    size = _Row(1.5, 0.8) if columns <= 2 else _Row(1.05, 0.55)
    rows = -(-robot.n // columns)
    height = 0.3 + rows * (size.torque + size.residual + size.gap)
    span = window(prediction)
    units = torque_units(robot)

    def draw(figure: Any) -> None:
        width = figure.get_size_inches()[0]
        cell = (width - 0.55 - 0.1 - 0.5 * (columns - 1)) / columns
        for joint in range(robot.n):
            row, column = divmod(joint, columns)
            left = 0.55 + column * (cell + 0.5)
            top = height - 0.3 - row * (size.torque + size.residual + size.gap) - 0.16
            upper = figure.add_axes(
                (left / width, (top - size.torque) / height, cell / width, size.torque / height)
            )
            bottom = top - size.torque - 0.07 - size.residual
            lower = figure.add_axes(
                (left / width, bottom / height, cell / width, size.residual / height), sharex=upper
            )
            _torque(upper, prediction, joint, span, points)
            _residual(lower, prediction, joint, span, points)
            upper.set_title(
                f"{short(robot.joints[joint], 22)} [{units[joint]}]",
                loc="left",
                fontweight="bold",
                pad=3,
            )
            upper.set_title(
                _error_words(prediction, joint), loc="right", fontsize=7, color=SOFT, pad=3
            )
            if joint + columns >= robot.n:
                lower.set_xlabel("time [s]")
            if column == 0:
                lower.set_ylabel("residual")
        _legend(figure, floored=prediction.noise_floor is not None)

    return render_svg(
        f"Measured and predicted torque of every joint on {prediction.source}", height, draw
    )


def _error_words(prediction: Prediction, joint: int) -> str:
    text = percent(float(prediction.relative()[joint]))
    floors = prediction.error_over_noise_floor()
    return f"error {text}" if floors is None else f"{multiple(floors[joint])} floors, {text}"


def _legend(figure: Any, *, floored: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Line2D([], [], color=color) for color in (INK, GREY, BLUE, ORANGE)]
    labels = ["measured", "nominal robot", "identified", "residual: measured − identified"]
    if floored:
        handles.append(Patch(color=GREY, alpha=0.35))
        labels.append(f"±{SURE:g} noise floors")
    figure.legend(
        handles,
        labels,
        loc="upper right",
        ncols=len(labels),
        bbox_to_anchor=(0.995, 1.0),
        borderaxespad=0.0,
    )


def _torque(
    axes: Any, prediction: Prediction, joint: int, span: tuple[float, float], points: int
) -> None:
    for values, color, width in (
        (prediction.nominal, GREY, 0.8),
        (prediction.measured, INK, 1.3),
        (prediction.fitted, BLUE, 0.8),
    ):
        axes.plot(*_curve(prediction, values[:, joint], span, points), color=color, linewidth=width)
    limit_ticks(axes, 6, 3)
    axes.tick_params(labelbottom=False)
    axes.set_xlim(*span)


def _residual(
    axes: Any, prediction: Prediction, joint: int, span: tuple[float, float], points: int
) -> None:
    left = prediction.measured[:, joint] - prediction.fitted[:, joint]
    axes.axhline(0.0, color=GREY, linewidth=0.5)
    if prediction.noise_floor is not None:
        reach = SURE * float(prediction.noise_floor[joint])
        axes.axhspan(-reach, reach, color=GREY, alpha=0.35, linewidth=0.0)
    axes.plot(*_curve(prediction, left, span, points), color=ORANGE, linewidth=0.7)
    limit_ticks(axes, 6, 2)


def _curve(
    prediction: Prediction, values: Array, span: tuple[float, float], points: int
) -> tuple[Array, Array]:
    """Points of a curve with a break wherever a stretch ends."""
    times: list[Array] = []
    curve: list[Array] = []
    total = max(1, int(np.sum((prediction.time >= span[0]) & (prediction.time <= span[1]))))
    for start, stop in itertools.pairwise((*prediction.starts, len(values))):
        t = prediction.time[start:stop]
        inside = (t >= span[0]) & (t <= span[1])
        if inside.any():
            kept = thin_curve(
                t[inside], values[start:stop][inside], max(8, points * int(inside.sum()) // total)
            )
            times += [kept[0], np.array([kept[0][-1]])]
            curve += [kept[1], np.array([np.nan])]
    return np.concatenate(times), np.concatenate(curve)


def drawn_points(predictions: Sequence[Prediction], joints: int) -> int:
    """Points of a curve, so that all curves of a page stay below what a browser likes to load."""
    return int(np.clip(60_000 / (4 * joints * max(1, len(predictions))), 60, 700))
