"""`excite formats`: list the formats of `excite export`."""

from __future__ import annotations

import argparse

from ..exporters import FORMATS
from .outcome import Outcome


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite formats`: list the formats, each with a description in one line."""
    rows = [{"name": name, "description": text} for name, text in FORMATS.items()]
    width = max(map(len, FORMATS))
    return (
        0,
        {"formats": rows},
        "\n".join(f"{name:{width}}  {text}" for name, text in FORMATS.items()),
    )
