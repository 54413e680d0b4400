"""Figure of friction and offsets that differ between recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .drawing import BLUE, GREY, axes_grid, limit_ticks, render_svg
from .trajectory import short_names

KIND_WORDS = {
    "coulomb": "Coulomb friction",
    "viscous": "viscous friction",
    "offset": "torque offset",
}
"""Parameters that may differ between recordings."""
_ROW_HEIGHT = 0.24
"""Height of a row, a joint in a recording [in]."""
_LETTER_WIDTH = 0.075
"""Mean width of a letter of its name [in]."""


def draw_session_changes(changes: Sequence[Mapping[str, Any]]) -> str:
    """Draw a row for each joint and recording, with a column for each parameter.

    Args:
        changes: `between_recordings` of `diagnosis.json`.
    """
    joints = list(dict.fromkeys(change["joint"] for change in changes))
    recordings = list(dict.fromkeys(Path(change["recording"]).stem for change in changes))
    shown = dict(zip(joints, short_names(joints, 20), strict=True))
    stems = dict(zip(recordings, short_names(recordings, 20), strict=True))
    names = [
        shown[change["joint"]]
        + (f", {stems[Path(change['recording']).stem]}" if recordings[1:] else "")
        for change in changes
    ]

    def draw(figure: Any) -> None:
        left = 0.25 + _LETTER_WIDTH * max(map(len, names))
        margins = left, 0.15, 0.3, 0.3
        columns = axes_grid(figure, 1, len(KIND_WORDS), margins=margins, gaps=(0.3, 0.0))[0]
        for axes, kind in zip(columns, KIND_WORDS, strict=True):
            values, std = (
                np.array([change[kind][key] for change in changes], float)
                for key in ("value", "std")
            )
            style: dict[str, Any] = {"markersize": 3.5, "elinewidth": 1.0, "capsize": 2.0}
            axes.axvline(0.0, color=GREY, linewidth=0.5)
            axes.errorbar(values, range(len(changes)), xerr=2.0 * std, fmt="o", color=BLUE, **style)
            limit_ticks(axes, 4, 4)
            axes.set_ylim(len(changes) - 0.5, -0.5)
            axes.set_yticks(range(len(changes)), names if axes is columns[0] else [])
            units = " or ".join(dict.fromkeys(change[kind]["unit"] for change in changes))
            axes.set_title(f"{KIND_WORDS[kind]} [{units}]", loc="left", fontweight="bold", pad=3)

    label = "Friction and torque offsets that differ between recordings"
    return render_svg(label, 0.6 + _ROW_HEIGHT * len(changes), draw)
