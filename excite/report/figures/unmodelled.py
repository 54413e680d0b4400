"""Figure of residuals that no effect explains, over the quantity that predicts them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .drawing import BLUE, GREY, limit_ticks, render_panels
from .trajectory import short_names

PANEL_HEIGHT = 1.6
"""Height of a panel's axes [in]."""


def draw_responses(unknown: Sequence[Mapping[str, Any]], units: Mapping[str, str]) -> str:
    """Draw a panel for each entry of `unknown` of `diagnosis.json` that has a response.

    Args:
        unknown: The entries.
        units: Unit of each joint's torque.
    """

    names = dict(zip(units, short_names(list(units), 24), strict=True))

    def draw(axes: Any, entry: Mapping[str, Any]) -> None:
        response = entry["where"]["response"]
        axes.axhline(0.0, color=GREY, linewidth=0.5)
        axes.plot(response["x"], response["y"], color=BLUE, linewidth=1.0)
        axes.set_title(names[entry["joint"]], loc="left", fontweight="bold", pad=3)
        over, along = response["over"], ", along the motion"
        axes.set_xlabel(over.replace(along, ""))
        name = f"torque{' along the motion' if along in over else ''} [{units[entry['joint']]}]"
        axes.set_ylabel("response" if response["relative"] else name)
        limit_ticks(axes, 5, 4)

    label = "Unexplained residual over the quantity that predicts it"
    return render_panels(label, unknown, draw, PANEL_HEIGHT)
