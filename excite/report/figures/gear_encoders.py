"""Figure of gear deflections measured by an encoder on either side."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...diagnosis.diagnosis import Diagnosis
from ...diagnosis.gear_encoders import GearEstimate
from .drawing import GREY, INK, ORANGE, limit_ticks, render_panels
from .trajectory import short_names, torque_units

PANEL_HEIGHT = 1.9
"""Height of a panel's axes [in]."""
MAX_DOTS = 1500
"""Largest number of measured points in a panel."""


def draw_deflections(diagnosis: Diagnosis) -> str:
    """Draw the deflection of each gear over the torque that it transmits."""
    robot = diagnosis.identified.model.robot
    units, names = torque_units(robot), short_names(robot.joints, 20)

    def draw(axes: Any, gear: GearEstimate) -> None:
        _draw_deflection(axes, gear)
        unit = "mm" if units[gear.joint] == "N" else "mrad"
        title = f"{names[gear.joint]} [{unit}]"
        axes.set_title(title, loc="left", fontweight="bold", pad=3)
        axes.set_xlabel(f"transmitted torque [{units[gear.joint]}]")

    label = "Deflection of the gears between two encoders"
    return render_panels(label, diagnosis.gears, draw, PANEL_HEIGHT)


def _draw_deflection(axes: Any, gear: GearEstimate) -> None:
    """Draw measured points and the fitted curve of a gear."""
    load = np.linspace(gear.load.min(), gear.load.max(), 101)
    axes.axhline(0.0, color=GREY, linewidth=0.5)
    step = slice(None, None, -(-len(gear.load) // MAX_DOTS))
    deflection = 1e3 * gear.deflection[step]
    axes.plot(gear.load[step], deflection, ".", color=INK, markersize=1.5, alpha=0.35)
    axes.plot(load, 1e3 * gear.curve(load), color=ORANGE, linewidth=1.2)
    limit_ticks(axes, 5, 4)
