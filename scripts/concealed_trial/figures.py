"""Confusion matrix and reliability diagram of a trial, as SVG."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from excite.simulator.effects import CATALOGUE_NAMES, OUT_OF_CATALOGUE_NAMES

from .score import NO_ANSWER, NO_FINDING, UNKNOWN


def _svg(width: float, height: float, draw: Callable[[Any], None]) -> str:
    """Draw a figure and return it as SVG."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(
        {
            "svg.fonttype": "none",
            "font.size": 7.5,
            "svg.hashsalt": "trial",
            "font.family": "DejaVu Sans",
        }
    ):
        figure = Figure(figsize=(width, height), layout="constrained")
        draw(figure)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def confusion(tables: Mapping[str, Mapping[str, Mapping[str, int]]]) -> str:
    """Draw a confusion matrix per analyst.

    Rows are the hidden effect, columns the first effect answered; the shade is the row's share.
    """
    rows = [NO_FINDING, *CATALOGUE_NAMES, *OUT_OF_CATALOGUE_NAMES]
    columns = [NO_FINDING, UNKNOWN, NO_ANSWER, *CATALOGUE_NAMES]

    def draw(figure: Any) -> None:
        axes = figure.subplots(1, len(tables), sharey=True, squeeze=False)[0]
        for axis, (name, table) in zip(axes, tables.items(), strict=True):
            counts = np.array([[table.get(r, {}).get(c, 0) for c in columns] for r in rows], float)
            shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
            axis.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="equal")
            for i, j in np.argwhere(counts > 0):
                right = rows[i] == columns[j] or (
                    rows[i] in OUT_OF_CATALOGUE_NAMES and columns[j] == UNKNOWN
                )
                axis.text(
                    j,
                    i,
                    f"{counts[i, j]:.0f}",
                    ha="center",
                    va="center",
                    fontsize=6,
                    color="white" if shares[i, j] > 0.5 else "#1c2530",
                    fontweight="bold" if right else "normal",
                )
            axis.set_xticks(range(len(columns)), columns, rotation=90)
            axis.set_yticks(range(len(rows)), rows)
            axis.axhline(0.5, color="#9aa4af", linewidth=0.6)
            axis.axhline(len(CATALOGUE_NAMES) + 0.5, color="#9aa4af", linewidth=0.6)
            axis.axvline(2.5, color="#9aa4af", linewidth=0.6)
            axis.set_title(name, loc="left")
            axis.set_xlabel("answered first")
        axes[0].set_ylabel("hidden")

    return _svg(1.4 + 4.6 * len(tables), 6.9, draw)


def reliability(calibrations: Mapping[str, Mapping[str, Any]]) -> str:
    """Draw how often findings are true against the probability that was reported."""

    def draw(figure: Any) -> None:
        axes = figure.subplots(1, len(calibrations), sharey=True, squeeze=False)[0]
        for axis, (name, calibration) in zip(axes, calibrations.items(), strict=True):
            axis.plot([0.5, 1.0], [0.5, 1.0], color="#9aa4af", linewidth=0.8)
            for row in calibration["bins"]:
                axis.plot(
                    row["reported"],
                    row["observed"],
                    "o",
                    color="#2f6fb5",
                    markersize=2.5 + 1.2 * np.sqrt(row["count"]) ** 0.8,
                )
                axis.annotate(
                    f"{row['count']}",
                    (row["reported"], row["observed"]),
                    xytext=(5, -9),
                    textcoords="offset points",
                    fontsize=6.5,
                )
            error = calibration["error"]
            axis.set_title(f"{name}{'' if error is None else f', error {error:.2f}'}", loc="left")
            axis.set_xlim(0.48, 1.02)
            axis.set_ylim(-0.03, 1.03)
            axis.set_xlabel("reported probability")
        axes[0].set_ylabel("share of true findings")

    return _svg(0.6 + 2.6 * len(calibrations), 2.9, draw)
