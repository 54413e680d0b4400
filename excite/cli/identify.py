"""`excite identify` and `excite predict`: recordings and models from the command line."""

from __future__ import annotations

import argparse
import csv
import dataclasses
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import recordings
from .._system.output_files import output_files, output_folder
from ..diagnosis import whole
from ..errors import UnusableInput
from ..identification import consistency, identification, identified_model, lmi_check, torque_check
from ..identification import prior as prior_module
from ..identification.consistency import Bounds
from ..identification.estimators import Method
from ..identification.identification import Identification, Options
from ..identification.inertia_distance import Distance
from ..recordings import Recording, recording_cost
from ..robot import base_parameters, inertial_parameters
from ..robot.inertial_parameters import Parameters
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..schemas.bounds import BoundsFile
from ..schemas.document_file import DocumentFile
from ..trajectory import trajectory_file
from . import options as told

Array = np.ndarray
Outcome = tuple[int, Any, str]


def identify(arguments: argparse.Namespace, say: Callable[[str], None]) -> Outcome:
    """Read, identify, report."""
    from .. import report

    output = output_folder(Path(arguments.out), ("model.json", "identified.urdf", "report.html"))
    robot = told.robot(arguments)
    table = told.limits(arguments, robot)
    standard = inertial_parameters.standard(robot, table, told.drive(arguments))
    found = base_parameters.find(robot, standard, table)
    window = (arguments.period, arguments.window)
    known = prior_module.trusted(Path(arguments.prior), robot, standard) if arguments.prior else {}
    options = _options(arguments, standard, known)
    say(f"reading {', '.join([*arguments.recordings, *arguments.validate])}")
    train, held_out = (
        [_read(Path(path), robot, table, *window) for path in paths]
        for paths in (arguments.recordings, arguments.validate)
    )
    recordings.refuse_same(train, held_out)
    recording_cost.require_identifiable([*train, *held_out], say)
    train, held_out = (
        [torque_check.checked(one, robot, table) for one in some] for some in (train, held_out)
    )
    result = identification.identify(robot, standard, found, train, held_out, options, say)
    document = identified_model.document(result, train)
    checked = _lmi(result) if arguments.check_lmi else None
    if checked is not None:
        document["lmi"] = {"gap": checked.gap, "agrees": checked.agrees}
    remarks = [remark for recording in (*train, *held_out) for remark in recording.remarks]
    contents = {
        "model.json": trajectory_file.dumps(document),
        "identified.urdf": document["urdf"],
        "report.html": report.identification_page(result, remarks),
    }
    written = output.replace(contents)
    facts = [one.words for one in (result.endogeneity, result.simulation) if one is not None]
    if checked is not None:
        facts.append(
            f"conic solver: {'agrees' if checked.agrees else 'DISAGREES'}, objective {checked.gap:+.2g} relative"
        )
    code = 1 if checked is not None and not checked.agrees else 0
    return (
        code,
        document | {"files": [str(path) for path in written]},
        _text(result, facts, written),
    )


def _read(
    path: Path,
    robot: Robot,
    table: Limits,
    period: float | None,
    window: tuple[float, float] | None,
) -> Recording:
    recording = recordings.read(path, robot, table)
    if window and period is None:
        raise UnusableInput(
            f"--window {window[0]:g},{window[1]:g}: needs --period S, the time after which the motion repeats"
        )
    if period is None:
        return recording
    if not 0.0 < period < float(recording.t[-1] - recording.t[0]):
        raise UnusableInput(
            f"--period {period:g}: should be shorter than the recording; {path} is {np.ptp(recording.t):.6g} s long"
        )
    recording.check_period(period, window, "--period" if window is None else "--period, --window")
    return dataclasses.replace(
        recording, sidecar=dataclasses.replace(recording.sidecar, period=period, periodic=window)
    )


def _options(
    arguments: argparse.Namespace, standard: Parameters, known: Mapping[int, float]
) -> Options:
    gamma = (
        arguments.gamma
        if isinstance(arguments.gamma, str)
        else (arguments.gamma[0], arguments.gamma[-1])
    )
    return Options(
        method=Method(arguments.estimator),
        distance=Distance(arguments.distance),
        gamma=gamma,
        band=arguments.band,
        threshold=arguments.threshold,
        bounds=_bounds(Path(arguments.bounds), standard) if arguments.bounds else Bounds(),
        align=arguments.align,
        trusted=known,
        hausman=arguments.hausman,
        simulate=arguments.simulate,
        refine=arguments.refine,
    )


def _bounds(path: Path, standard: Parameters) -> Bounds:
    """Bounds of masses and centres of mass from a TOML file.

    Raises:
        UnusableInput: The file is missing, breaks a rule of `schemas.bounds`, or names a link that
            does not move.
    """
    file = DocumentFile(
        path, "bounds", "correct it", "a TOML file with [links.NAME] mass = [least, most]"
    )
    mass, centre = {}, {}
    for link, entry in file.converted(file.toml(), BoundsFile).links.items():
        if link not in standard.links:
            raise file.error(
                f"no moving link '{link}'; there are {', '.join(standard.links)}", "links"
            )
        if entry.mass is not None:
            mass[link] = (float(entry.mass[0]), float(entry.mass[1]))
        if entry.centre is not None:
            centre[link] = np.array(entry.centre, float)
    return Bounds(mass, centre)


def _lmi(found: Identification) -> lmi_check.Check:
    data, subject, bounds = found.data, found.model, found.options.bounds
    root, target, own = data.root @ subject.base.matrix, data.root @ data.theta, found.posterior
    if (
        found.options.refine
    ):  # a refined model no longer minimises what the conic solver does: compare where it started
        own = consistency.maximum_a_posteriori(
            subject.parameters, root, target, found.prior, bounds
        )
    return lmi_check.check(subject.parameters, root, target, found.prior, own, bounds)


def _text(found: Identification, facts: Sequence[str], written: Sequence[Path]) -> str:
    robot = found.model.robot
    shown = found.validations or found.fits
    lines = [
        f"{robot.name}: {found.analysis.identifiable} of {found.model.base.count} directions identified; band {found.spectra.hertz:.3g} Hz",
        f"{'held out' if found.validations else 'on the data fitted (no --validate)'}: torque error per joint",
        f"{'joint':25}{'nominal':>11}{'identified':>12}{'noise':>11}{'relative':>10}",
    ]
    for prediction in shown:
        if len(shown) > 1:
            lines.append(prediction.source)
        for i, joint in enumerate(robot.joints):
            floor = "" if prediction.floor is None else f"{prediction.floor[i]:.4g}"
            before, after, share = (
                prediction.error("nominal")[i],
                prediction.error()[i],
                prediction.relative()[i],
            )
            percent = f"{100 * share:.2f}%" if np.isfinite(share) else "-"
            lines.append(f"{joint:25}{before:11.4g}{after:12.4g}{floor:>11}{percent:>10}")
    common, spread = found.delay.common
    if abs(common) > 3.0 * spread and not found.options.align:
        order = "after" if common > 0 else "before"
        lines.append(
            f"torque comes {abs(1e3 * common):.3g} ms {order} position on average (--align takes that out)"
        )
    return "\n".join([*lines, *facts, *(f"wrote {path}" for path in written)])


def predict(arguments: argparse.Namespace) -> Outcome:
    """Torque along a recording at its own times."""
    path, inputs = Path(arguments.out), (Path(arguments.model), Path(arguments.recording))
    output = output_files(path, inputs=inputs)
    fitted = identified_model.read(inputs[0])
    recording = recordings.read(inputs[1], fitted.robot)
    times, torque = whole.predict(fitted, recording)
    if not np.isfinite(torque).all():
        joint = fitted.robot.joints[int(np.argmin(np.isfinite(torque).all(axis=0)))]
        raise UnusableInput(
            f"{arguments.model}: the torque that it predicts at joint '{joint}' is not finite; "
            "identify again"
        )
    stream = io.StringIO()
    header = ["t", *(f"tau.{joint}" for joint in fitted.robot.joints)]
    csv.writer(stream, lineterminator="\n").writerow(header)
    np.savetxt(stream, np.column_stack([times, torque]), fmt="%.9g", delimiter=",")
    written = output.replace({path.name: stream.getvalue()})[0]
    return 0, {"file": str(written), "rows": len(times)}, f"wrote {written}"
