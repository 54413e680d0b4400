"""Identify physically consistent parameters from recordings, and predict torque by a model."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import _json, recordings
from .._system.output_files import output_files, output_folder
from .._types import FloatArray
from ..diagnosis import fitted_effects
from ..errors import UnusableInput
from ..identification import consistency, identification, identified_model, lmi_check, torque_check
from ..identification import prior as prior_module
from ..identification.consistency import Bounds
from ..identification.identification import Identification, IdentificationOptions
from ..recordings import Recording, recording_cost, require_distinct
from ..robot import base_parameters, inertial_parameters
from ..robot.inertial_parameters import Parameters
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..schemas.bounds import BoundsFile
from ..schemas.document_file import DocumentFile
from .robots import RobotSource, load_robot, resolve_limits

IDENTIFICATION_FILES = ("model.json", "identified.urdf", "report.html")
Progress = Callable[[str], None]
RecordingSource = str | Path | Recording


@dataclass(frozen=True)
class IdentificationResult:
    """An identified model with its uncertainty.

    Attributes:
        identification: Parameters, intervals, and what the data and the prior decided.
        recordings: Recordings that the model is fitted to.
        validation: Recordings that it is judged by.
        lmi: Comparison with a conic solver, None where none was asked for.
    """

    identification: Identification
    recordings: tuple[Recording, ...]
    validation: tuple[Recording, ...]
    lmi: lmi_check.LmiCheck | None = None

    @property
    def parameters(self) -> dict[str, float]:
        """Identified standard parameters by name, in SI units."""
        found = self.identification
        return dict(zip(found.model.parameters.names, found.psi.tolist(), strict=True))

    def document(self) -> dict[str, Any]:
        """Return the content of `model.json`."""
        out = identified_model.model_document(self.identification, self.recordings)
        if self.lmi is not None:
            out["lmi"] = {"gap": self.lmi.gap, "agrees": self.lmi.agrees}
        return out

    def html(self) -> str:
        """Return the report as HTML."""
        from .. import report

        remarks = [
            r for recording in (*self.recordings, *self.validation) for r in recording.remarks
        ]
        return report.identification_page(self.identification, remarks)

    def contents(self, document: Mapping[str, Any] | None = None) -> dict[str, str]:
        """Return the files of the identification by name."""
        document = self.document() if document is None else document
        return {
            "model.json": _json.dumps(document),
            "identified.urdf": str(document["urdf"]),
            "report.html": self.html(),
        }

    def save(self, folder: str | Path) -> list[Path]:
        """Write `model.json`, `identified.urdf` and `report.html`; return their paths."""
        return output_folder(Path(folder), IDENTIFICATION_FILES).replace(self.contents())

    def report(self, path: str | Path) -> Path:
        """Write the report alone."""
        path = Path(path)
        return output_files(path).replace({path.name: self.html()})[0]

    def __repr__(self) -> str:
        found = self.identification
        known, count = found.analysis.identifiable_count, found.model.base.count
        return f"<IdentificationResult {found.model.robot.name}: {known} of {count} directions identified>"  # noqa: E501


@dataclass(frozen=True)
class PredictedTorque:
    """Torque that a model predicts along a recording.

    Attributes:
        joints: Names of the joints.
        time: Times of the recording's rows. Shape (N,) [s].
        torque: Predicted torque. Shape (N, n) [N m].
    """

    joints: tuple[str, ...]
    time: FloatArray
    torque: FloatArray

    def csv(self) -> str:
        """Return the rows `t,tau.<joint>…`."""
        stream = io.StringIO()
        header = ["t", *(f"tau.{joint}" for joint in self.joints)]
        csv.writer(stream, lineterminator="\n").writerow(header)
        np.savetxt(stream, np.column_stack([self.time, self.torque]), fmt="%.9g", delimiter=",")
        return stream.getvalue()

    def save(self, path: str | Path) -> Path:
        """Write the rows as CSV."""
        path = Path(path)
        return output_files(path).replace({path.name: self.csv()})[0]

    def __repr__(self) -> str:
        return f"<PredictedTorque of {len(self.joints)} joints at {len(self.time)} times>"


def read_recording(
    path: RecordingSource,
    robot: RobotSource,
    *,
    limits: str | Path | Limits | None = None,
    period: float | None = None,
    window: tuple[float, float] | None = None,
) -> Recording:
    """Read a recording, check it, and repair what is safe to repair.

    Args:
        path: CSV, `.npz`, rosbag2 folder, `.mcap` or Universal Robots' RTDE file; a recording is
            returned as it is.
        robot: The robot that was recorded; joints are matched by name.
        limits: Limits that positions and torques are compared with; None: the URDF's, where it has
            them.
        period: Period of the excitation [s], where the recording's `.json` does not state it.
        window: Times between which the motion repeats [s].

    Raises:
        UnusableInput: The file cannot be read, or holds numbers that no measurement has.
    """
    if isinstance(path, Recording):
        return path
    loaded = load_robot(robot)
    table = None if limits is None else resolve_limits(loaded, limits)
    return with_period(recordings.read(Path(path), loaded, table), period, window)


def with_period(
    recording: Recording, period: float | None, window: tuple[float, float] | None
) -> Recording:
    """Return the recording with a stated period and the window in which it repeats."""
    if window is not None and period is None:
        raise UnusableInput(
            f"--window {window[0]:g},{window[1]:g}: needs --period S, the time after which the "
            "motion repeats"
        )
    if period is None:
        return recording
    length = float(np.ptp(recording.t))
    if not 0.0 < period < length:
        raise UnusableInput(
            f"--period {period:g}: should be shorter than the recording; {recording.source} is "
            f"{length:.6g} s long"
        )
    stated_by = "--period" if window is None else "--period, --window"
    recording.check_period(period, window, stated_by)
    sidecar = dataclasses.replace(recording.sidecar, period=period, periodic=window)
    return dataclasses.replace(recording, sidecar=sidecar)


def identify(
    robot: RobotSource,
    recordings: Sequence[RecordingSource],
    *,
    validate: Sequence[RecordingSource] = (),
    limits: str | Path | Limits | None = None,
    drive: tuple[str, ...] = inertial_parameters.DRIVE,
    bounds: str | Path | Bounds | None = None,
    prior: str | Path | None = None,
    period: float | None = None,
    window: tuple[float, float] | None = None,
    options: IdentificationOptions = IdentificationOptions(),  # noqa: B008  # immutable
    check_lmi: bool = False,
    progress: Progress | None = None,
    **choices: Any,
) -> IdentificationResult:
    """Identify physically consistent parameters from recordings, as `excite identify` does.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot.
        recordings: Recordings that the model is fitted to.
        validate: Recordings to judge the model by; no fit uses them.
        limits: Limits file or limits.
        drive: Joint parameters besides the inertial ones.
        bounds: Bounds of masses and centres of mass, or a TOML file with them.
        prior: Parameters that are right as they stand: `excite.prior/1` or a `model.json`.
        period: Period of the excitation [s], where a recording's `.json` does not state it.
        window: Times between which the motion repeats [s].
        options: Estimator, distance, band and further choices; single ones may be given by keyword,
            as `band=20.0`.
        check_lmi: Compare with a conic solver.
        progress: Called with a line of text now and then.
        **choices: Fields of `Options`.

    Raises:
        UnusableInput: An argument or a file cannot be used.
    """
    loaded = load_robot(robot)
    table = resolve_limits(loaded, limits)
    standard = inertial_parameters.standard(loaded, table, drive)
    base = base_parameters.find(loaded, standard, table)
    known = (
        {} if prior is None else prior_module.read_trusted_parameters(Path(prior), loaded, standard)
    )
    limits_of_bodies = bounds if isinstance(bounds, Bounds) else read_bounds(bounds, standard)
    chosen = dataclasses.replace(options, bounds=limits_of_bodies, trusted=known, **choices)
    say = progress or (lambda text: None)
    say(f"reading {', '.join(map(_name, (*recordings, *validate)))}")
    train, held_out = _read_both(loaded, table, recordings, validate, period, window)
    recording_cost.require_identifiable([*train, *held_out], say)
    found = identification.identify(loaded, standard, base, train, held_out, chosen, say)
    return IdentificationResult(
        found, tuple(train), tuple(held_out), _compare_lmi(found) if check_lmi else None
    )


def predict(model: str | Path, recording: RecordingSource) -> PredictedTorque:
    """Predict torque along a recording by an identified model, as `excite predict` does.

    Args:
        model: Path of a `model.json`.
        recording: The motion; a designed `trajectory.csv` will do too.

    Raises:
        UnusableInput: A file cannot be used.
    """
    fitted = identified_model.read_model(Path(model))
    motion = read_recording(recording, fitted.robot)
    time, torque = fitted_effects.predict(fitted, motion)
    if not np.isfinite(torque).all():
        joint = fitted.robot.joints[int(np.argmin(np.isfinite(torque).all(axis=0)))]
        raise UnusableInput(
            f"{model}: the torque that it predicts at joint '{joint}' is not finite; identify again"
        )
    return PredictedTorque(fitted.robot.joints, time, torque)


def read_bounds(path: str | Path | None, standard: Parameters) -> Bounds:
    """Read bounds of masses and centres of mass from a TOML file; none without a path.

    Raises:
        UnusableInput: The file is missing, breaks a rule of `schemas.bounds`, or names a link that
            does not move.
    """
    if path is None:
        return Bounds()
    file = DocumentFile(
        Path(path), "bounds", "correct it", "a TOML file with [links.NAME] mass = [least, most]"
    )
    mass, centre = {}, {}
    for link, entry in file.converted(file.toml(), BoundsFile).links.items():
        if link not in standard.links:
            known = ", ".join(standard.links)
            raise file.error(f"no moving link '{link}'; there are {known}", "links")
        if entry.mass is not None:
            mass[link] = (float(entry.mass[0]), float(entry.mass[1]))
        if entry.centre is not None:
            centre[link] = np.array(entry.centre, float)
    return Bounds(mass, centre)


def _name(source: RecordingSource) -> str:
    return source.source if isinstance(source, Recording) else str(source)


def _read_both(
    robot: Robot,
    limits: Limits,
    train: Sequence[RecordingSource],
    held_out: Sequence[RecordingSource],
    period: float | None = None,
    window: tuple[float, float] | None = None,
) -> tuple[list[Recording], list[Recording]]:
    """Read training and validation recordings; refuse one that is both."""
    both = [
        [read_recording(one, robot, limits=limits, period=period, window=window) for one in paths]
        for paths in (train, held_out)
    ]
    require_distinct(*both)
    train_set, held_out_set = (
        [torque_check.check_torque(one, robot, limits) for one in some] for some in both
    )
    return train_set, held_out_set


def _compare_lmi(found: Identification) -> lmi_check.LmiCheck:
    """Compare the estimate with a conic solver's; a refined one is compared at where refinement
    started."""
    data, model, bounds = found.data, found.model, found.options.bounds
    root, target, estimate = (
        data.information_root @ model.base.matrix,
        data.information_root @ data.theta,
        found.posterior,
    )
    if found.options.refine:
        estimate = consistency.maximum_a_posteriori(
            model.parameters, root, target, found.prior, bounds
        )
    return lmi_check.check_estimate(model.parameters, root, target, found.prior, estimate, bounds)
