"""`excite identifiability`: analyse which parameters a motion makes identifiable."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from .._json import dumps
from .._system.output_files import output_folder
from ..api.design_result import compare_experiments, motion_samples
from ..api.identification_result import REFERENCE_RATE
from ..api.task_design import is_recording
from ..designer import experiment_comparison, identifiability
from ..designer.options import torque_noise_levels
from ..robot import base_parameters, inertial_parameters
from . import floating_identifiability
from . import options as shared
from .outcome import Outcome, written_lines


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite identifiability`."""
    from .. import report

    if arguments.floating:
        return floating_identifiability.run(arguments)
    shared.require_floating(arguments, floating_identifiability.FLOATING_ONLY)
    if not is_recording(arguments.motion):
        reason = f"is for a recording, and {arguments.motion} is a trajectory; leave it out"
        shared.refuse_given(arguments, ["--trajectory", "--columns"], reason)
    output = output_folder(
        Path(arguments.out), ("identifiability.json", "report.html"), shared.input_files(arguments)
    )
    robot = shared.robot(arguments)
    limits = shared.limits(arguments, robot)
    samples, robot, trajectory = motion_samples(
        Path(arguments.motion), robot, arguments.trajectory, shared.columns(arguments)
    )
    standard = inertial_parameters.standard_parameters(robot, limits, shared.drive(arguments))
    base = base_parameters.find(robot, standard, limits)
    stated = shared.noise(arguments, robot)
    noise = (
        torque_noise_levels(limits, stated) if trajectory is None or stated else trajectory.noise
    )
    root = identifiability.information_root(robot, standard, samples, noise)
    analysis = identifiability.analyse_root(
        standard, base, root, noise, robot, threshold=arguments.threshold, samples=len(samples)
    )
    cases: tuple[experiment_comparison.Scenario, ...] = ()
    if trajectory is not None:
        cases = compare_experiments(robot, standard, base, trajectory, arguments.threshold)
    page = report.identifiability_page(
        robot, standard, base, analysis, arguments.motion, cases=cases
    )
    text = dumps(analysis.document())
    contents = {"identifiability.json": text, "report.html": page}
    written = output.replace(contents)
    document = json.loads(text)
    identifiable = sum(bool(direction["identifiable"]) for direction in document["directions"])
    source = "as stated" if trajectory is None or stated else f"of {arguments.motion}"
    assumed = shared.noise_in_words(noise, limits, source)
    line = (
        f"{robot.name}: {identifiable} of {base.count} directions practically identifiable "
        f"(torque noise {assumed}, {REFERENCE_RATE:g} rows a second)"
    )
    return 0, document, "\n".join([line, *written_lines(written)])
