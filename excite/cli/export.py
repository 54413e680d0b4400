"""`excite export`: write a trajectory for a controller."""

from __future__ import annotations

import argparse

from .. import api
from .outcome import Outcome


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite export`: verify a trajectory and write the file for the controller."""
    result = api.export(
        arguments.trajectory,
        arguments.format,
        arguments.out,
        speed=arguments.speed,
        rate=arguments.rate,
        force=arguments.force,
        robot=arguments.robot,
        limits=arguments.limits,
        packages=arguments.packages,
    )
    return 0, result.document(), "\n".join([*result.verdict, f"wrote {result.path}"])
