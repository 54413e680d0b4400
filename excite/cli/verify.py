"""`excite verify`: recompute every limit, the clearance and the criteria of a trajectory."""

from __future__ import annotations

import argparse

from .. import api
from .outcome import Outcome


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite verify`: recompute everything from the file and its sources."""
    result = api.verify(
        arguments.trajectory,
        robot=arguments.robot,
        limits=arguments.limits,
        packages=arguments.packages,
    )
    return (0 if result.ok else 1), result.document(), result.text()
