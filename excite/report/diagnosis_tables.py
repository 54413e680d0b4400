"""Tables of what a diagnosis is worth: errors on held-out recordings, simulation ahead, parameters without and with the findings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..diagnosis.diagnosis import Diagnosis
from ..robot.parameter_names import percent
from ..robot.robot import Robot
from .figures.trajectory import torque_units
from .page import escape, folded, number, table

Stated = Mapping[str, Any]


def ahead(stated: Stated, robot: Robot) -> str:
    """Simulation ahead and parameters, without and with the findings; nothing where there are none."""
    out = ""
    if stated["simulation"]:
        rows = [
            (
                escape(joint),
                unit,
                number(v["before"], 3),
                number(v["after"], 3),
                escape(percent(v["after"] / max(v["before"], 1e-300))),
            )
            for (joint, v), unit in zip(
                stated["simulation"]["joints"].items(),
                ("m" if u == "N" else "rad" for u in torque_units(robot)),
                strict=True,
            )
        ]
        out += f"<h3>Simulated {number(stated['simulation']['seconds'], 2)} s ahead from held-out torque</h3>"
        out += table(
            ("joint", "unit", "RMS before", "RMS after", "after / before"), rows, (2, 3, 4)
        )
    moved = [row for row in stated["parameters"] if row["moved"] > 2.0]
    if moved:
        shown = [
            (
                escape(r["name"]),
                number(r["without"], 4),
                number(r["with"], 4),
                number(r["std"], 2),
                number(r["moved"], 3),
            )
            for r in moved[:12]
        ]
        more = f" (12 of {len(moved)})" if len(moved) > 12 else ""
        head = ("base parameter", "without", "with", "std", "moved, in std")
        out += folded(f"Parameters that the findings move{more}", table(head, shown, (1, 2, 3, 4)))
    return out


def errors(found: Diagnosis, stated: Stated) -> str:
    robot = found.identified.model.robot
    torque, moving = found.torque, found.moving.mean(axis=0)
    changed, rows = bool(stated["findings"]), []
    for k, (joint, unit) in enumerate(zip(robot.joints, torque_units(robot), strict=True)):
        before, after, floor = float(found.before[k]), float(found.after[k]), float(found.floor[k])
        tone = "bad" if after > 1.005 * before else "good" if after < 0.98 * before else ""
        rows.append(
            (
                escape(joint),
                unit,
                number(before),
                f'<b class="{tone}">{number(after)}</b>' if changed else "–",
                number(floor),
                number(after / floor, 3),
                escape(percent(before / max(torque[k], 1e-300))),
                escape(percent(after / max(torque[k], 1e-300))) if changed else "–",
                escape(percent(float(moving[k]))),
            )
        )
    head = (
        "joint",
        "unit",
        "RMSE before",
        "RMSE after",
        "noise floor",
        "after / floor",
        "relative before",
        "relative after",
        "in motion",
    )
    return table(head, rows, (2, 3, 4, 5, 6, 7, 8))
