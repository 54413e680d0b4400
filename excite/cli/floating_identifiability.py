"""`excite identifiability --floating`: analyse a motion of a robot whose base moves freely."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from .._json import dumps
from .._system.output_files import output_folder
from ..api import floating_result
from ..api.identification_result import REFERENCE_RATE
from ..designer import floating_identifiability
from ..errors import UnusableInput
from ..identification import floating_regression
from ..identification.lowpass import Grid, LowPassFilter
from ..recordings.recording import DEFAULT_CUTOFF_HZ
from ..robot import floating_base
from ..robot.floating_base import Rows
from . import options as shared
from .floating_identify import load
from .outcome import Outcome, written_lines

UNSUPPORTED = ("--trajectory",)
"""Options of `excite identifiability` that a floating base does not have."""
FLOATING_ONLY = ("--rows", "--wrench-noise")
"""Options that only a floating base has."""
MAX_RATE_SHARE = 0.4
"""Cutoff frequency of the motion over its rate, at most."""


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite identifiability --floating`."""
    from .. import report

    shared.refuse_with_floating(arguments, UNSUPPORTED)
    output = output_folder(
        Path(arguments.out), ("identifiability.json", "report.html"), shared.input_files(arguments)
    )
    robot = load(arguments)
    rows = Rows(arguments.rows or "base")
    limits = floating_base.limits(robot, None if not arguments.limits else Path(arguments.limits))
    drive = shared.drive(arguments) if rows.has_joints else ()
    parameters = floating_base.standard_parameters(robot, limits, drive)
    base = floating_base.find_base_parameters(robot, parameters, rows)
    noise = floating_identifiability.assumed_noise(
        robot, limits, arguments.wrench_noise, shared.noise(arguments, robot.joint_robot)
    )
    recording = floating_result.read_floating_recording(
        arguments.motion, robot, shared.columns(arguments)
    )
    roots = []
    for segment in recording.segments():
        cutoff = min(DEFAULT_CUTOFF_HZ, MAX_RATE_SHARE * segment.rate)
        band = LowPassFilter(cutoff, segment.rate, len(segment))
        motion = floating_regression.filtered_motion(segment, robot, band, Grid.RECORDED, 1.0)
        root = floating_identifiability.information_root(robot, parameters, motion, noise, rows)
        roots.append(root * np.sqrt(REFERENCE_RATE / segment.rate))
    if not roots:
        raise UnusableInput(f"{recording.source}: has no gap-free stretch that is long enough")
    analysis = floating_identifiability.analyse(
        robot,
        parameters,
        base,
        np.vstack(roots),
        noise,
        rows,
        threshold=arguments.threshold,
        samples=len(recording),
    )
    page = report.identifiability_page(
        robot.joint_robot, parameters, base, analysis, arguments.motion, cases=()
    )
    text = dumps(analysis.document())
    written = output.replace({"identifiability.json": text, "report.html": page})
    line = (
        f"{robot.name}: {analysis.identifiable_count} of {base.count} directions practically "
        f"identifiable from {rows.value} rows (noise {noise.force:.3g} N, {noise.moment:.3g} N m, "
        f"{REFERENCE_RATE:g} rows a second)"
    )
    return 0, json.loads(text), "\n".join([line, *written_lines(written)])
