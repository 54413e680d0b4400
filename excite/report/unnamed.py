"""What no name takes, in a diagnosis's report: which features foresee it, and the residual over them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..diagnosis.diagnosis import Diagnosis
from ..robot.parameter_names import percent
from .figures.drawing import BLUE, GREY, limit_ticks, render_panels
from .figures.trajectory import short, torque_units
from .page import bullets, figure, paragraph

_HEIGHT, _MOST = 1.6, 6


def told(found: Diagnosis, stated: Mapping[str, Any]) -> str:
    """Joints with what a flexible model foresees, and its curves."""
    lines = []
    for one in stated["unknown"]:
        line = f"{one['joint']}: {percent(one['share'])} of what is left is more than noise"
        if one["where"]["regime"] == "recording":
            line += f"; {one['where']['statement'].partition(': ')[2]}"
        if "foreseen" in one["where"]:
            line += f"; {one['where']['regime']} foresees {percent(one['where']['foreseen'])} of it in recordings that it was not fitted to"
        lines.append(line)
    curved = [one for one in stated["unknown"] if "response" in one["where"]]
    body = bullets(lines)
    if not curved:
        return body
    note = f"The first {_MOST} of {len(curved)}. " if len(curved) > _MOST else ""
    note += "What is left, over what foresees it best: its mean between steps. Of what goes on after a cause: the response to a short one, "
    note += "over its largest."
    robot = found.identified.model.robot
    units = dict(zip(robot.joints, torque_units(robot), strict=True))
    return body + figure(_curves(curved[:_MOST], units)) + paragraph(note, "note")


def _curves(unknown: Sequence[Mapping[str, Any]], units: Mapping[str, str]) -> str:
    def draw(axes: Any, one: Mapping[str, Any]) -> None:
        response = one["where"]["response"]
        axes.axhline(0.0, color=GREY, linewidth=0.5)
        axes.plot(response["x"], response["y"], color=BLUE, linewidth=1.0)
        unit = "" if response["relative"] else f" [{units[one['joint']]}]"
        axes.set_title(short(one["joint"], 24) + unit, loc="left", fontweight="bold", pad=3)
        axes.set_xlabel(response["over"])
        limit_ticks(axes, 5, 4)

    return render_panels(
        "What is left without a name, over what foresees it", unknown, draw, _HEIGHT
    )
