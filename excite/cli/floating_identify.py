"""`excite identify --floating`: identify a robot whose base moves freely."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .._system.output_files import output_folder
from ..api import floating_result
from ..api.floating_result import FloatingIdentificationResult
from ..api.saved_identification import IDENTIFICATION_FILES
from ..errors import UnusableInput
from ..identification.floating_identification import FloatingOptions
from ..identification.inertia_distance import Distance
from ..robot.floating_base import FloatingRobot, Rows
from . import options as shared
from .outcome import Outcome, with_files, written_lines

UNSUPPORTED = (
    "--align",
    "--hausman",
    "--simulate",
    "--refine",
    "--check-lmi",
    "--prior",
    "--period",
    "--window",
    "--trajectory",
)
"""Options of `excite identify` that a floating base does not have."""
FLOATING_ONLY = (
    "--rows",
    "--symmetric",
    "--no-wrench-offsets",
)
"""Options that only a floating base has."""


def load(arguments: argparse.Namespace) -> FloatingRobot:
    """Load the robot that the options describe, with a free flyer.

    Raises:
        UnusableInput: It cannot be used.
    """
    choices = shared.robot_choices(arguments)
    if choices.pop("mass") is not None:
        raise UnusableInput(
            "--mass: is not available with --floating; give the links an <inertial>"
        )
    choices.pop("packages")
    return floating_result.load_floating_robot(choices.pop("source"), **choices)


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite identify --floating`."""
    shared.refuse_with_floating(arguments, UNSUPPORTED)
    if arguments.estimator != "wls":
        raise UnusableInput(f"--estimator {arguments.estimator}: --floating has wls only")
    output = output_folder(Path(arguments.out), IDENTIFICATION_FILES, shared.input_files(arguments))
    result = floating_result.identify_floating(
        load(arguments),
        arguments.recordings,
        validate=arguments.validate,
        limits=arguments.limits or None,
        bounds=arguments.bounds,
        columns=shared.columns(arguments),
        options=_options(arguments),
    )
    document = result.document()
    written = output.replace(result.contents(document))
    return 0, with_files(document, written), _text(result, written)


def _options(arguments: argparse.Namespace) -> FloatingOptions:
    """Options of the identification."""
    gamma = arguments.gamma or "heldout"
    return FloatingOptions(
        rows=None if arguments.rows is None else Rows(arguments.rows),
        drive=shared.drive(arguments),
        distance=Distance(arguments.distance),
        gamma=gamma if isinstance(gamma, str) else gamma[0],
        band=arguments.band,
        threshold=arguments.threshold,
        symmetric=_symmetric(arguments.symmetric),
        offsets=not arguments.no_wrench_offsets,
    )


def _symmetric(text: str | None) -> tuple[str, str] | None:
    """Prefixes of `--symmetric`.

    Raises:
        UnusableInput: The text is not of the form LEFT:RIGHT.
    """
    if text is None:
        return None
    left, _, right = text.partition(":")
    if not left or not right or left == right:
        raise UnusableInput(f"--symmetric {text}: should read LEFT:RIGHT, as left_:right_")
    return left, right


def _text(result: FloatingIdentificationResult, written: Sequence[Path]) -> str:
    """Errors of the rows and shares of the bodies."""
    identification = result.identification
    model = identification.model
    lines = [
        f"{model.name}: {identification.analysis.identifiable_count} of {model.base.count} "
        f"directions identified from {model.rows.value} rows; γ "
        f"{identification.prior.inertial_weight:.3g}; bands {identification.hertz.min():.3g} to "
        f"{identification.hertz.max():.3g} Hz",
        f"{'held out' if identification.validations else 'on the data fitted (no --validate)'}: "
        "error of each row",
        f"{'row':25}{'signal':>11}{'nominal':>11}{'identified':>12}",
    ]
    predictions = identification.validations or identification.fits
    for prediction in predictions:
        if len(predictions) > 1:
            lines.append(prediction.source)
        for name, signal, before, after, unit in zip(
            model.joints,
            prediction.measured.std(axis=0),
            prediction.error("nominal"),
            prediction.error(),
            model.row_units(),
            strict=True,
        ):
            lines.append(f"{name:25} {signal:10.4g} {before:10.4g} {after:11.4g} {unit}")
    shares = identification.body_shares()
    ordered = sorted(shares, key=lambda link: -shares[link])
    decided = ", ".join(f"{link} {100.0 * shares[link]:.0f} %" for link in ordered[:5])
    lines.append(f"bodies that the data decide most: {decided}")
    return "\n".join([*lines, *written_lines(written)])
