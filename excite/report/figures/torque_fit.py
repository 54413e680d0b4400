"""Figure of measured and predicted torque of every joint, with the residual."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..._types import FloatArray
from ...identification.identification import Prediction
from ...robot.parameter_names import multiple, percent
from ...robot.robot import Robot
from .drawing import (
    BLUE,
    COMPACT_LAYOUT_JOINTS,
    GREY,
    INK,
    ORANGE,
    SUBTITLE_HEIGHT,
    limit_ticks,
    render_svg,
    set_titles,
    thin_curve,
)
from .trajectory import short_names, torque_units

EXCERPT_SECONDS = 40.0
"""Longer recordings are drawn in part [s]; the tables state the error of all of it."""
NOISE_BAND_FLOORS = 2.0
"""Noise floors on either side that contain 95 % of normal noise."""
POINTS_PER_PAGE = 60_000
"""Points of all curves of a page, so that it stays small enough for a browser."""


@dataclass(frozen=True)
class FitLabels:
    """Names of the two models, and what is drawn of the first.

    Attributes:
        nominal: Name of the model of `Prediction.nominal`.
        fitted: Name of the model of `Prediction.fitted`.
        residuals: Whether the residual of the first is drawn too.
        errors: Error of each joint in words; empty: as `Prediction` computes it.
    """

    nominal: str = "nominal robot"
    fitted: str = "identified"
    residuals: bool = False
    errors: Sequence[str] = field(default_factory=tuple)


@dataclass(frozen=True)
class _RowHeights:
    """Heights of a joint's torque panel, of its residual panel, and of the gap below [in]."""

    torque: float
    residual: float
    gap: float = 0.62


def drawn_interval(prediction: Prediction) -> tuple[float, float]:
    """Start and end of the drawn part [s].

    Of a long recording it is the stretch around the largest error relative to a joint's RMS torque.
    """
    first, last = float(prediction.time[0]), float(prediction.time[-1])
    if last - first <= EXCERPT_SECONDS:
        return first, last
    residual = np.where(prediction.moving, prediction.measured - prediction.fitted, 0.0)
    worst = int(np.argmax(np.max(np.abs(residual) / np.maximum(prediction.size(), 1e-300), axis=1)))
    start = float(
        np.clip(prediction.time[worst] - 0.5 * EXCERPT_SECONDS, first, last - EXCERPT_SECONDS)
    )
    return start, start + EXCERPT_SECONDS


def draw_torque_fit(
    prediction: Prediction, robot: Robot, points: int, labels: FitLabels | None = None
) -> str:
    """Draw measured, nominal and identified torque, and below it the residual with its noise band.

    Args:
        prediction: Torques along a recording.
        robot: The robot.
        points: Largest number of points of a curve.
        labels: Names of the two models; nominal and identified robot when None.
    """
    title = f"Measured and predicted torque of every joint on {prediction.source}"
    return draw_fit(prediction, robot.joints, torque_units(robot), title, points, labels)


def draw_fit(
    prediction: Prediction,
    names: Sequence[str],
    units: Sequence[str],
    title: str,
    points: int,
    labels: FitLabels | None = None,
) -> str:
    """Draw measured and predicted rows, and below each the residual.

    Args:
        prediction: Rows along a recording.
        names: Name of each row.
        units: Unit of each row.
        title: Title of the figure, for people who cannot see it.
        points: Largest number of points of a curve.
        labels: Names of the two models; nominal and identified robot when None.
    """
    labels, count = labels or FitLabels(), len(names)
    columns = 1 if count == 1 else 2 if count <= 4 else 3 if count <= COMPACT_LAYOUT_JOINTS else 5
    size = _RowHeights(1.5, 0.8) if columns <= 2 else _RowHeights(1.05, 0.55)
    rows = -(-count // columns)
    step = size.torque + size.residual + size.gap + SUBTITLE_HEIGHT
    height = 0.3 + rows * step
    span = drawn_interval(prediction)

    shown = short_names(names, 22 if columns <= 3 else 14)

    def draw(figure: Any) -> None:
        width = figure.get_size_inches()[0]
        cell = (width - 0.55 - 0.1 - 0.5 * (columns - 1)) / columns
        for joint in range(count):
            row, column = divmod(joint, columns)
            left = 0.55 + column * (cell + 0.5)
            top = height - 0.3 - row * step - 0.16 - SUBTITLE_HEIGHT
            upper = figure.add_axes(
                (left / width, (top - size.torque) / height, cell / width, size.torque / height)
            )
            bottom = top - size.torque - 0.07 - size.residual
            lower = figure.add_axes(
                (left / width, bottom / height, cell / width, size.residual / height), sharex=upper
            )
            _torque(upper, prediction, joint, span, points)
            _residual(lower, prediction, joint, span, points, compared=labels.residuals)
            error = labels.errors[joint] if labels.errors else _error_words(prediction, joint)
            set_titles(upper, f"{shown[joint]} [{units[joint]}]", error)
            if joint + columns >= count:
                lower.set_xlabel("time [s]")
            if column == 0:
                lower.set_ylabel("residual")
                lower.yaxis.set_label_coords(-0.44 / cell, 0.5)  # in the margin of 0.55 in
        _legend(figure, labels, has_floor=prediction.noise_floor is not None)

    return render_svg(title, height, draw)


def _error_words(prediction: Prediction, joint: int) -> str:
    """Error of a joint."""
    text = percent(float(prediction.relative()[joint]))
    floors = prediction.error_over_noise_floor()
    return f"error {text}" if floors is None else f"{multiple(floors[joint])} floors, {text}"


def _legend(figure: Any, names: FitLabels, *, has_floor: bool) -> None:
    """Legend of all panels."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Line2D([], [], color=color) for color in (INK, GREY, BLUE, ORANGE)]
    nominal = f"{names.nominal} and its residual" if names.residuals else names.nominal
    labels = ["measured", nominal, names.fitted, f"residual: measured − {names.fitted}"]
    if has_floor:
        handles.append(Patch(color=GREY, alpha=0.35))
        labels.append(f"±{NOISE_BAND_FLOORS:g} noise floors")
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
    """Draw the torque panel of a joint."""
    for values, color, width in (
        (prediction.nominal, GREY, 0.8),
        (prediction.measured, INK, 1.3),
        (prediction.fitted, BLUE, 0.8),
    ):
        axes.plot(*_curve(prediction, values[:, joint], span, points), color=color, linewidth=width)
    limit_ticks(axes, 6, 3)
    axes.tick_params(labelbottom=False, labelsize=8)
    axes.set_xlim(*span)


def _residual(
    axes: Any,
    prediction: Prediction,
    joint: int,
    span: tuple[float, float],
    points: int,
    *,
    compared: bool,
) -> None:
    """Draw the residual panel of a joint, with the nominal robot's residual if it is compared."""
    axes.axhline(0.0, color=GREY, linewidth=0.5)
    if prediction.noise_floor is not None:
        reach = NOISE_BAND_FLOORS * float(prediction.noise_floor[joint])
        axes.axhspan(-reach, reach, color=GREY, alpha=0.35, linewidth=0.0)
    models = [(prediction.nominal, GREY)] if compared else []
    for values, color in (*models, (prediction.fitted, ORANGE)):
        residual = prediction.measured[:, joint] - values[:, joint]
        axes.plot(*_curve(prediction, residual, span, points), color=color, linewidth=0.7)
    limit_ticks(axes, 6, 2)
    axes.tick_params(labelsize=8)


def _curve(
    prediction: Prediction, values: FloatArray, span: tuple[float, float], points: int
) -> tuple[FloatArray, FloatArray]:
    """Points of a curve, interrupted where a segment of the recording ends."""
    times: list[FloatArray] = []
    curve: list[FloatArray] = []
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


def points_per_curve(predictions: Sequence[Prediction], joints: int) -> int:
    """Number of points of a curve, so that all of a page have at most `POINTS_PER_PAGE`."""
    return int(np.clip(POINTS_PER_PAGE / (4 * joints * max(1, len(predictions))), 60, 700))
