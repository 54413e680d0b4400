"""`excite formats`: list the formats of `excite export`."""

from __future__ import annotations

import argparse

from ..exporters import FORMATS
from .outcome import Outcome


def run(arguments: argparse.Namespace) -> Outcome:
    """List the formats, each with one line that says what it is."""
    rows = [{"name": name, "description": text} for name, text in FORMATS.items()]
    width = max(map(len, FORMATS))
    return (
        0,
        {"formats": rows},
        "\n".join(f"{name:{width}}  {text}" for name, text in FORMATS.items()),
    )
