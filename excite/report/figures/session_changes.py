"""Figure of friction and offsets that differ between recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .drawing import BLUE, GREY, limit_ticks, render_panels
from .trajectory import short_names

KIND_WORDS = {
    "coulomb": "Coulomb friction",
    "viscous": "viscous friction",
    "offset": "torque offset",
}
"""Parameters that may differ between recordings."""
PANEL_HEIGHT = 2.0
"""Height of a panel's axes [in]."""


def draw_session_changes(changes: Sequence[Mapping[str, Any]]) -> str:
    """Draw a panel for each parameter, with a dot for each joint and recording.

    Args:
        changes: `between_recordings` of `diagnosis.json`.
    """
    joints = list(dict.fromkeys(change["joint"] for change in changes))
    recordings = list(dict.fromkeys(Path(change["recording"]).stem for change in changes))
    shown = dict(zip(joints, short_names(joints, 14), strict=True))
    stems = dict(zip(recordings, short_names(recordings, 10), strict=True))
    names = [
        shown[change["joint"]]
        + (f", {stems[Path(change['recording']).stem]}" if recordings[1:] else "")
        for change in changes
    ]

    def draw(axes: Any, kind: str) -> None:
        x = np.arange(len(changes))
        values, std = (
            np.array([change[kind][key] for change in changes], float) for key in ("value", "std")
        )
        axes.axhline(0.0, color=GREY, linewidth=0.5)
        axes.errorbar(
            x, values, 2.0 * std, fmt="o", color=BLUE, markersize=3.5, elinewidth=1.0, capsize=2.0
        )
        limit_ticks(axes, 5, 4)
        axes.set_xlim(-0.5, len(changes) - 0.5)
        axes.set_xticks(x, names, rotation=25.0, ha="right")
        units = " or ".join(dict.fromkeys(change[kind]["unit"] for change in changes))
        title = f"change of {KIND_WORDS[kind]} [{units}]"
        axes.set_title(title, loc="left", fontweight="bold", pad=3)

    label = "Friction and torque offsets that differ between recordings"
    return render_panels(label, list(KIND_WORDS), draw, PANEL_HEIGHT)
