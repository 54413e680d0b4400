"""`excite effects`: list the catalogue of effects."""

from __future__ import annotations

import argparse

from ..effects import EFFECTS
from .outcome import Outcome


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite effects`: list all effects with their parameters and units."""
    rows = [
        {"name": effect.name, "description": effect.signature, "parameters": dict(effect.units)}
        for effect in EFFECTS
    ]
    width = max(len(str(row["name"])) for row in rows)
    lines = []
    for effect in EFFECTS:
        units = ", ".join(f"{name} [{unit}]" for name, unit in effect.units.items())
        lines.append(f"{effect.name:{width}}  {effect.signature}: {units}")
    return 0, {"effects": rows}, "\n".join(lines)
