"""Decompose the torque of a robot by the joint model: all frictions, delay, ripple, rare effects.

    python scripts/joint_diagnosis.py ROBOT RECORDING… --validate RECORDING… [--limits FILE]

The model of `excite/diagnosis/joint_model.py` is to replace the selection stages of `excite
diagnose`. This script fits it to the recordings, prints the effects that the data need, and the
RMSE on the held-out recordings before and after. The log Bayes factors are not calibrated yet, so
they are not given as probabilities.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from excite import api
from excite.api.robots import resolve_limits
from excite.diagnosis import bandwidth, joint_model, posterior, selection
from excite.diagnosis.regression import rms
from excite.effects import recorded_motion
from excite.effects.recorded_motion import RecordedMotion
from excite.identification import identification, segments
from excite.identification.identification import Identification
from excite.robot import base_parameters, inertial_parameters


def prepare(
    source: str,
    recordings: Sequence[str | Path],
    validate: Sequence[str | Path],
    limits_file: Path | None = None,
) -> tuple[Identification, list[list[RecordedMotion]]]:
    """Fit the base model, and compute the motions of the training and held-out recordings."""
    robot = api.load_robot(source)
    limits = resolve_limits(robot, limits_file)
    standard = inertial_parameters.standard_parameters(robot, limits, inertial_parameters.DRIVE)
    base = base_parameters.find(robot, standard, limits)
    train, held_out = (
        [api.read_recording(path, robot, limits=limits) for path in paths]
        for paths in (recordings, validate)
    )
    pieces = [list(segments.extract_segments(group, average=False)) for group in (train, held_out)]
    hertz = bandwidth.needed_hertz(pieces[0])
    options = identification.IdentificationOptions(band=hertz)
    identified = identification.identify(robot, standard, base, train, (), options)
    fitted_robot = recorded_motion.fitted_robot(robot, standard, identified.psi)
    theta = base.matrix @ identified.psi
    return identified, [
        recorded_motion.recorded_motions(identified.model, fitted_robot, theta, group, hertz)
        for group in pieces
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the script; return its exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robot", help="path of a URDF, or name of a built-in model")
    parser.add_argument("recordings", nargs="+", help="training recordings")
    parser.add_argument("--validate", nargs="+", required=True, help="held-out recordings")
    parser.add_argument("--limits", type=Path, help="limits file")
    arguments = parser.parse_args(argv)
    identified, motions = prepare(
        arguments.robot, arguments.recordings, arguments.validate, arguments.limits
    )
    robot = identified.model.robot
    model, _ = selection.find_rare_effects(
        identified, motions[0], progress=lambda line: print(line, file=sys.stderr)
    )
    left_out, evidence = posterior.select(model)
    sigma = model.regression.sigma
    print(f"torque is recorded {1e3 * float(model.delays[0]):.2f} ms late")
    print(f"{'effect':20}{'joint':24}{'log Bayes':>10}{'severity':>10}")
    for entry in sorted(evidence, key=lambda e: -e.log_bayes_factor):
        severity = float((entry.severity / sigma).max())
        if set(entry.effects) <= left_out or severity < selection.MIN_SEVERITY:
            continue
        joint = "robot" if entry.joint is None else robot.joints[entry.joint]
        effect = entry.effects[0]
        values = model.models[effect].parameters(model.coefficients(effect))
        words = ", ".join(f"{key} {value:.4g}" for key, value in values.items())
        print(f"{entry.name:20}{joint:24}{entry.log_bayes_factor:10.1f}{severity:10.2f}  {words}")
    moving = np.concatenate([motion.moving for motion in motions[1]])
    before, after = (
        rms(residual, moving)
        for residual in joint_model.held_out_residuals(identified, model, motions[1])
    )
    print(f"{'joint':24}{'base model':>12}{'joint model':>12}   held-out RMSE [N m]")
    for row in zip(robot.joints, before, after, strict=True):
        print("{:24}{:12.4g}{:12.4g}".format(*row))
    return 0


if __name__ == "__main__":
    sys.exit(main())
