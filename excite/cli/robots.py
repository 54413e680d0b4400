"""`excite robots`: list the built-in models."""

from __future__ import annotations

import argparse
from typing import Any

from ..robot.robot import builtin_names, load
from .outcome import Outcome


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite robots`: list the built-in models with their joints and moving mass."""
    rows: list[dict[str, Any]] = []
    for name in builtin_names():
        robot = load(name)
        mass = sum(robot.model.inertias[i].mass for i in range(1, robot.model.njoints))
        rows.append({"name": name, "joints": list(robot.joints), "mass": float(mass)})
    lines = [
        f"{row['name']:10} {len(row['joints'])} joints, {row['mass']:5.1f} kg moving"
        for row in rows
    ]
    return 0, {"robots": rows}, "\n".join(lines)
