"""`excite design --for-payload LINK --static`: poses at rest for a payload."""

from __future__ import annotations

import argparse
from pathlib import Path

from .. import api
from .._system.output_files import output_folder
from .._system.progress import logger
from ..api.static_design_result import STATIC_FILES, STATIC_POSES
from ..designer.options import DesignOptions
from ..errors import UnusableInput
from . import options as shared
from .outcome import Outcome, with_files, written_lines

UNSUPPORTED = (
    "--plain",
    "--given",
    "--columns",
    "--trajectory",
    "--for",
    "--discriminate",
    "--validation",
    "--time",
    "--period",
    "--optimise-period",
    "--harmonics",
    "--periods",
    "--samples",
    "--starts",
    "--iterations",
    *shared.OF_EXCITATION,
)
"""Options of `excite design` that static poses do not have."""


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite design --for-payload LINK --static`."""
    if not arguments.static:
        raise UnusableInput("--poses: is the number of static poses; add --static")
    if arguments.for_payload is None:
        raise UnusableInput("--static: shows a payload; name its link with --for-payload LINK")
    shared.refuse_given(arguments, UNSUPPORTED, "is not available with --static; leave it out")
    if arguments.criterion != "a":
        raise UnusableInput("--static: has the D-criterion; leave --criterion out")
    robot = shared.robot(arguments)
    limits = shared.limits(arguments, robot)
    output = output_folder(Path(arguments.out), STATIC_FILES, shared.input_files(arguments))
    result = api.design_static(
        robot,
        arguments.for_payload,
        poses=arguments.poses or STATIC_POSES,
        limits=limits,
        cell=shared.cell_options(arguments),
        options=DesignOptions(
            rate=arguments.rate,
            uncertainty=arguments.uncertainty,
            noise=shared.noise(arguments, robot),
            boxes=shared.boxes(arguments),
            seed=arguments.seed,
        ),
        start=None if not arguments.start else shared.of_joints("--start", arguments.start, robot),
        speed=arguments.speed,
        force=arguments.force,
    )
    logger.info("writing the report")
    written = output.replace(result.contents())
    design = result.design
    lines = [
        f"{robot.name}: {len(design.poses)} static poses, each reached from both sides; one is "
        f"worth {design.efficiency:.2g} random ones",
        design.deviation.text,
        f"{result.trajectory.motion.duration:.2f} s from rest to rest",
        *design.certificate.verdict_lines(),
        *written_lines(written),
    ]
    return (0 if result.ok else 1), with_files(result.document(), written), "\n".join(lines)
