"""Figure of a time budget: the accuracy of each combination of period and harmonics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .drawing import BLUE, INK, axes_grid, limit_ticks, render_svg


def draw_candidates(
    candidates: Sequence[Mapping[str, Any]],
    excess: Sequence[float],
    chosen: int,
    tolerance: float,
) -> str:
    """Draw the standard deviation of each candidate against its period.

    Args:
        candidates: Candidates of the plan, with `period` [s] and `harmonics`.
        excess: Standard deviation of each above the least [%].
        chosen: Index of the chosen candidate.
        tolerance: Excess up to which candidates count as equal [1].
    """
    period = np.array([float(c["period"]) for c in candidates])
    above = np.array(excess)
    most_harmonics = {
        t: max(c["harmonics"] for c in candidates if float(c["period"]) == t) for t in period
    }

    def draw(figure: Any) -> None:
        axes = axes_grid(figure, 1, 1, margins=(0.6, 0.2, 0.32, 0.42))[0, 0]
        label = "candidate, with its number of harmonics"
        axes.plot(period, above, "o", color=BLUE, markersize=4, label=label)
        for candidate, x, y in zip(candidates, period, above, strict=True):
            offset = 1 if candidate["harmonics"] == most_harmonics[x] else -7
            axes.annotate(
                f"{candidate['harmonics']}",
                (x, y),
                (7, offset),
                textcoords="offset points",
                fontsize=8,
            )
        axes.plot(
            period[chosen],
            above[chosen],
            "o",
            markersize=9,
            markerfacecolor="none",
            markeredgecolor=INK,
            linestyle="",
            label="chosen",
        )
        bound = 100.0 * tolerance
        axes.axhline(bound, color=INK, linewidth=0.8, dashes=(4, 2), label="tolerance")
        limit_ticks(axes, 8, 5)
        axes.set_xlim(0.0, 1.1 * period.max())
        axes.set_ylim(-0.06 * max(above.max(), 10.0), 1.12 * max(above.max(), 10.0))
        axes.set_xlabel("period [s]")
        axes.set_ylabel("standard deviation above the least [%]")
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(
            handles,
            labels,
            loc="upper left",
            ncols=3,
            bbox_to_anchor=(0.05, 1.0),
            borderaxespad=0.2,
        )

    return render_svg("Standard deviation against period and harmonics", 2.6, draw)
