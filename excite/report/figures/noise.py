"""Figures of torque, noise and residual spectra, of delays and of Coulomb friction widths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._types import FloatArray
from ...identification.torque_delay import TorqueDelay
from .drawing import (
    BLUE,
    COMPACT_LAYOUT_JOINTS,
    GREY,
    INK,
    ORANGE,
    RED,
    SOFT,
    axes_grid,
    limit_ticks,
    render_svg,
    set_decade_ticks,
    thin_curve,
)
from .trajectory import short_names

NORMAL_QUANTILE = 1.96
"""Standard errors on either side that contain 95 % of a normal distribution."""
_CURVE_POINTS = 160
"""Points of a curve that a small panel can show."""


@dataclass(frozen=True)
class PowerDensities:
    """Power densities of a signal of every joint.

    Attributes:
        frequency: Shape (F,) [Hz].
        power: Shape (F, n) [(N m)²/Hz].
    """

    frequency: FloatArray
    power: FloatArray


def draw_spectra(
    joints: Sequence[str],
    torque: PowerDensities,
    noise: PowerDensities,
    residual: PowerDensities,
    hertz: float,
    noise_words: str,
) -> str:
    """Draw torque, noise and residual of every joint over frequency.

    Args:
        joints: Names of the joints.
        torque: Power density of the torque.
        noise: Power density of its noise.
        residual: Power density of the residual of the fit.
        hertz: End of the band [Hz].
        noise_words: Description of the noise estimate.
    """
    columns = (
        1
        if len(joints) == 1
        else 2
        if len(joints) <= 4
        else 3
        if len(joints) <= COMPACT_LAYOUT_JOINTS
        else 5
    )
    rows = -(-len(joints) // columns)
    far, names = min(4.0 * hertz, float(torque.frequency[-1])), short_names(joints, 26)

    def draw(figure: Any) -> None:
        cells = axes_grid(figure, rows, columns, margins=(0.55, 0.1, 0.5, 0.42), gaps=(0.5, 0.45))
        for k in range(rows * columns):
            axes = cells[divmod(k, columns)]
            if k >= len(joints):
                axes.set_visible(False)
                continue
            _joint(axes, k, torque, noise, residual, far)
            axes.axvspan(hertz, far, color="#f3f5f7", linewidth=0.0, zorder=0)
            axes.axvline(hertz, color=INK, linewidth=0.9, dashes=(4, 2))
            # y: no search for a place above the ticks, which takes long
            axes.set_title(names[k], loc="left", y=1.0, fontweight="bold", pad=3)
            if k + columns >= len(joints):
                axes.set_xlabel("frequency [Hz]")
        handles, labels = cells[0, 0].get_legend_handles_labels()
        named = {"noise": noise_words}
        texts = [named.get(label, label) for label in labels]
        figure.legend(
            handles,
            texts,
            loc="upper right",
            ncols=3,
            bbox_to_anchor=(0.995, 1.0),
            borderaxespad=0.0,
        )

    return render_svg(
        "Power density of torque, noise and residual of every joint",
        0.9 + rows * 1.5 + (rows - 1) * 0.2,
        draw,
    )


def _joint(
    axes: Any,
    k: int,
    torque: PowerDensities,
    noise: PowerDensities,
    residual: PowerDensities,
    far: float,
) -> None:
    """Draw the spectra of a joint."""
    axes.set_yscale("log")
    for kind, color, width, label in (
        (torque, INK, 0.9, "torque"),
        (noise, GREY, 0.9, "noise"),
        (residual, ORANGE, 1.1, "residual of the fit"),
    ):
        kept = (kind.frequency <= far) & (kind.power[:, k] > 0.0)
        if kept.any():
            axes.plot(
                *thin_curve(kind.frequency[kept], kind.power[kept, k], _CURVE_POINTS),
                color=color,
                linewidth=width,
                label=label,
            )
    set_decade_ticks(axes)
    axes.set_xlim(0.0, far)


def draw_delays(
    joints: Sequence[str],
    delay: TorqueDelay,
    widths: FloatArray,
    edges: tuple[float, float],
    prismatic: Sequence[bool],
) -> str:
    """Draw delay and Coulomb friction width of each joint.

    Args:
        joints: Names of the joints.
        delay: Delays with their standard errors.
        widths: Velocity over which Coulomb friction changes sign. Shape (n,) [rad/s or m/s].
        edges: Smallest and largest candidate of these widths.
        prismatic: For each joint, whether it slides.
    """
    names, places = short_names(joints, 22), np.arange(len(joints))
    unit = "mm/s" if all(prismatic) else "mrad/s" if not any(prismatic) else "mrad/s or mm/s"
    cut = np.isclose(widths, edges[0]) | np.isclose(widths, edges[1])
    bars = {"fmt": "o", "color": BLUE, "markersize": 3.5, "capsize": 2, "linewidth": 1.0}

    def draw(figure: Any) -> None:
        width, height = figure.get_size_inches()
        size = height - 0.75
        left = figure.add_axes((1.5 / width, 0.45 / height, 3.9 / width, size / height))
        left.axvline(0.0, color=INK, linewidth=0.8)
        left.errorbar(
            1e3 * delay.seconds, places, xerr=1e3 * NORMAL_QUANTILE * delay.deviation, **bars
        )
        limit_ticks(left, 6, 4)
        left.set_xlabel("delay of torque after position [ms], 95 % interval")
        left.set_title("Delay", loc="left", fontweight="bold")
        left.set_yticks(places, names, fontsize=7, color=INK)
        right = figure.add_axes((6.1 / width, 0.45 / height, 4.3 / width, size / height))
        right.set_xscale("log")
        right.axvspan(1e3 * edges[0], 1e3 * edges[1], color="#f3f5f7", linewidth=0.0, zorder=0)
        right.plot(1e3 * widths[~cut], places[~cut], "o", color=BLUE, markersize=3.5)
        right.plot(
            1e3 * widths[cut], places[cut], "o", color=RED, markerfacecolor="white", markersize=4.5
        )
        ticks = [
            v
            for v in (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
            if 0.7e3 * edges[0] <= v <= 1.4e3 * edges[1]
        ]
        right.set_xticks(ticks, [f"{v:g}" for v in ticks])
        right.minorticks_off()
        right.grid(visible=True, color="#eef1f4", linewidth=0.5)
        right.set_axisbelow(True)
        right.set_xlim(0.7e3 * edges[0], 1.4e3 * edges[1])
        right.set_xlabel(
            f"width of Coulomb friction [{unit}]; hollow: smallest or largest candidate",
            color=SOFT,
        )
        right.set_title("Width of Coulomb friction", loc="left", fontweight="bold")
        right.set_yticks(places, [""] * len(places))
        for axes in (left, right):
            axes.set_ylim(len(places) - 0.5, -0.5)

    return render_svg(
        "Delay and width of Coulomb friction of every joint", 0.95 + 0.2 * max(2, len(joints)), draw
    )
