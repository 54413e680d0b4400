"""`excite design --floating --support`: motions of a robot that stands on one or two feet."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from .._system.output_files import output_folder
from ..api.design_result import CellOptions
from ..api.support_design_result import SUPPORT_FILES, SupportDesignResult, design_support
from ..designer.criteria import Criterion
from ..designer.options import DesignOptions
from ..designer.support_design import SupportOptions
from ..designer.support_stance import ContactLimits, SoleSize
from ..errors import UnusableInput
from ..robot.floating_base import Rows
from . import floating_identify
from . import options as shared
from .outcome import Outcome, with_files, written_lines

UNSUPPORTED = (
    "--plain",
    "--given",
    "--columns",
    "--trajectory",
    "--for",
    "--for-payload",
    "--static",
    "--poses",
    "--discriminate",
    "--validation",
    "--period",
    "--optimise-period",
    "--time",
    "--periods",
    "--samples",
    "--start",
    "--box",
    "--floor",
    "--no-floor",
    "--force",
    "--speed",
    *shared.OF_EXCITATION,
)
"""Options of `excite design` that a design in support does not have."""
FLOATING_ONLY = (
    "--support",
    "--sole",
    "--cop-margin",
    "--friction",
    "--duration",
    "--motions",
    "--wrench-noise",
)
"""Options that only a design in support has."""


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite design --floating --support`."""
    shared.refuse_with_floating(arguments, UNSUPPORTED)
    if arguments.uncertainty not in (0.0, DesignOptions().uncertainty):
        raise UnusableInput(
            "--uncertainty: torque limits in support hold for the nominal robot; leave it out, or "
            "lower the limits with --limits"
        )
    options = _options(arguments)
    robot = floating_identify.load(arguments)
    options = replace(options, torque_noise=shared.noise(arguments, robot.joint_robot))
    limits = shared.limits(arguments, robot.joint_robot)
    output = output_folder(Path(arguments.out), SUPPORT_FILES, shared.input_files(arguments))
    cell = CellOptions(
        scene=arguments.scene,
        clearance=arguments.clearance,
        srdf=arguments.srdf,
        packages=arguments.packages,
        check=not arguments.no_collision,
    )
    result = design_support(robot, options, limits=limits, cell=cell)
    written = output.replace(result.contents())
    document = with_files(result.document(), written)
    return 0, document, "\n".join([*_lines(result), *written_lines(written)])


def _options(arguments: argparse.Namespace) -> SupportOptions:
    """Return the options of the design.

    Raises:
        UnusableInput: Feet are not stated, or there are other than one or two.
    """
    if arguments.support is None:
        raise UnusableInput(
            "--floating: name the frames of the soles on the ground with --support FRAME[,FRAME]"
        )
    frames = tuple(name.strip() for name in arguments.support.split(","))
    if len(frames) > 2 or not all(frames):
        raise UnusableInput(f"--support {arguments.support}: name one or two frames")
    default, contact = SupportOptions(frames, ()), ContactLimits()
    if arguments.cop_margin is not None:
        contact = ContactLimits(contact.friction, arguments.cop_margin)
    if arguments.friction is not None:
        contact = ContactLimits(arguments.friction, contact.margin)
    return SupportOptions(
        frames=frames,
        soles=_soles(arguments.sole, len(frames)),
        contact=contact,
        count=arguments.motions or 1,
        duration=arguments.duration or default.duration,
        harmonics=arguments.harmonics or default.harmonics,
        criterion=Criterion(arguments.criterion),
        wrench_noise=arguments.wrench_noise,
        rate=arguments.rate,
        starts=arguments.starts or default.starts,
        iterations=arguments.iterations,
        seed=arguments.seed,
    )


def _soles(stated: tuple[float, ...] | None, count: int) -> tuple[SoleSize, ...]:
    """Return the stated sole of each foot; none where they are to be found from its shapes."""
    if stated is None:
        return ()
    length, width, *centre = stated
    x, y, z = (*centre, 0.0, 0.0, 0.0)[:3]
    return (SoleSize(0.5 * length, 0.5 * width, (x, y), z, source="--sole"),) * count


def _lines(result: SupportDesignResult) -> list[str]:
    """Return the summary of a design for people."""
    design = result.design
    counts = design.identifiable_counts()
    both = design.analysis(Rows.BOTH)
    motions = "1 motion" if len(counts) == 1 else f"{len(counts)} motions"
    return [
        f"{design.robot.name}: {counts[-1]} of {design.base.count} directions practically "
        f"identifiable from the base rows (noise {design.noise.force:.3g} N, "
        f"{design.noise.moment:.3g} N m)",
        f"with joint torques {both.identifiable_count} of {len(both.directions)} directions, "
        "those of the joints included",
        f"{motions} of {design.duration / len(counts):g} s from rest to rest on "
        f"{' and '.join(foot.frame for foot in design.stance.feet)}",
        *(
            f"sole of {foot.frame}: {2e3 * foot.half_length:.0f} mm by "
            f"{2e3 * foot.half_width:.0f} mm, from {sole.source}"
            for foot, sole in zip(design.stance.feet, design.options.soles, strict=True)
        ),
        *design.certificate.verdict_lines(),
        f"designed in {design.seconds:.1f} s",
    ]
