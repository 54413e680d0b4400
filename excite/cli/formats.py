"""`excite formats`: list the formats of `excite export`."""

from __future__ import annotations

import argparse

from ..exporters import FORMATS, MODEL_FORMATS
from .outcome import Outcome


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite formats`: list the formats, each with a description in one line."""
    groups = {"trajectory": FORMATS, "model": MODEL_FORMATS}
    rows = [
        {"name": name, "description": text, "of": kind}
        for kind, formats in groups.items()
        for name, text in formats.items()
    ]
    width = max(len(row["name"]) for row in rows)
    lines = ["of a trajectory.json:"]
    lines += [f"  {name:{width}}  {text}" for name, text in FORMATS.items()]
    lines += ["of a model.json:"]
    lines += [f"  {name:{width}}  {text}" for name, text in MODEL_FORMATS.items()]
    return 0, {"formats": rows}, "\n".join(lines)
