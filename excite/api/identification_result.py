"""Identify physically consistent parameters, and predict torque with an identified model."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import recordings
from .._system.blas_threads import single_blas_thread
from .._system.one_or_several import one_or_several
from .._system.progress import Progress, logger
from .._types import FloatArray, Paths
from ..designer import identifiability
from ..designer.options import torque_noise_levels
from ..diagnosis import fitted_effects
from ..errors import ExciteWarning, UnusableInput
from ..identification import (
    consistency,
    floating_model,
    identification,
    identified_model,
    lmi_check,
    torque_check,
)
from ..identification import prior as prior_module
from ..identification.consistency import Bounds
from ..identification.identification import Identification, IdentificationOptions
from ..recordings import Recording, RemarkKind, executed_motion, recording_cost, require_distinct
from ..recordings.periodicity import check_repetition, with_detected_period
from ..recordings.recording import require_drive_gains
from ..robot import base_parameters, inertial_parameters
from ..robot.inertial_parameters import Parameters
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..robot.samples import Samples
from ..schemas.bounds import BoundsFile
from ..schemas.document_file import DocumentFile
from ..trajectory import trajectory_file
from .input_files import argument_files
from .predicted_table import PredictedTable, csv_text, warn_of_unsettled_ends
from .robots import RobotSource, load_robot, resolve_limits
from .saved_identification import SavedIdentification
from .stated_recordings import stated_columns, with_recording_columns

if TYPE_CHECKING:
    from .floating_result import PredictedWrench

RecordingSource = str | Path | Recording
"""Path of a recording, or a recording that is already read."""
RecordingSources = RecordingSource | Sequence[RecordingSource]
"""A recording, or several."""
TrajectorySources = Paths
"""Path of an executed trajectory, or paths of several."""


@dataclass(frozen=True)
class IdentificationResult(SavedIdentification):
    """An identified model with its uncertainty.

    Attributes:
        identification: Parameters, confidence intervals, and the weights of data and prior.
        limits: Limits of the robot.
        lmi: Comparison with a conic solver; None if none was requested.
    """

    identification: Identification
    limits: Limits
    lmi: lmi_check.LmiCheck | None = None

    @cached_property
    def assumed_count(self) -> int:
        """Number of directions that are identifiable with the torque noise that a design assumes.

        That noise is 1 % of the torque limits at REFERENCE_RATE, as in `excite identifiability`.
        """
        model = self.identification.model
        noise = torque_noise_levels(self.limits, None)
        roots = [
            identifiability.information_root(
                model.robot, model.parameters, reference_samples(recording), noise
            )
            for recording in self.recordings
        ]
        return identifiability.analyse_root(
            model.parameters,
            model.base,
            np.vstack(roots),
            noise,
            model.robot,
            threshold=self.identification.options.threshold,
            samples=sum(map(len, self.recordings)),
        ).identifiable_count

    @property
    def doubts(self) -> list[dict[str, Any]]:
        """Unrepaired doubts about the recordings, with the recording that each is about."""
        return recording_doubts([*self.recordings, *self.validation])

    def document(self) -> dict[str, Any]:
        """Return the content of `model.json`."""
        out = identified_model.model_document(self.identification, self.recordings)
        if self.doubts:
            out["doubts"] = [dict(doubt) for doubt in self.doubts]
        if self.lmi is not None:
            out["lmi"] = {"gap": self.lmi.gap, "agrees": self.lmi.agrees}
        return with_recording_columns(out, [*self.recordings, *self.validation])

    def html(self) -> str:
        """Return the report as HTML."""
        from .. import report

        return report.identification_page(self.identification, self.remarks)

    def __repr__(self) -> str:
        result = self.identification
        identified, count = result.analysis.identifiable_count, result.model.base.count
        return (
            f"<IdentificationResult {result.model.robot.name}: {identified} of {count} "
            "directions identified>"
        )


REFERENCE_RATE = 100.0
"""Rows per second at which the torque noise of two rows counts as independent [Hz].

The number of identifiable directions must not depend on the rate at which a motion is sampled or
recorded. Current loops filter torque to about half of this rate.
"""


def reference_samples(recording: Recording) -> Samples:
    """Return the motion of a recording at REFERENCE_RATE, within its periodic window if any."""
    if recording.repetition is not None:
        recording = recording.between(*recording.repetition[1])
    samples = recording.samples()
    count = max(1, round(len(samples) * REFERENCE_RATE / recording.rate))
    return samples.rows(np.linspace(0, len(samples) - 1, count).round().astype(int))


@dataclass(frozen=True)
class PredictedTorque(PredictedTable):
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
        """Return the table `t,tau.<joint>…` as CSV."""
        return csv_text([f"tau.{joint}" for joint in self.joints], self.time, self.torque)

    def __repr__(self) -> str:
        return f"<PredictedTorque of {len(self.joints)} joints at {len(self.time)} times>"


def read_recording(
    path: RecordingSource,
    robot: RobotSource,
    *,
    limits: str | Path | Limits | None = None,
    period: float | None = None,
    window: tuple[float, float] | None = None,
    trajectory: TrajectorySources = (),
    columns: Mapping[str, str] = MappingProxyType({}),
) -> Recording:
    """Read a recording, check it, and repair faults that are safe to repair.

    Args:
        path: CSV, `.npz`, rosbag2 folder, `.mcap`, text of `ros2 topic echo` or RTDE file of
            Universal Robots; a recording is returned unchanged.
        robot: The robot that was recorded; joints are matched by name.
        limits: Limits that positions and torques are compared with; None: those of the URDF, if it
            has any.
        period: Period of the excitation [s], if the `.json` of the recording does not state it.
        window: Times between which the motion is periodic [s].
        trajectory: The `trajectory.json` that was executed, or several of which one was executed:
            period, window and commanded positions are taken from it.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in a CSV file.

    Raises:
        UnusableInput: The file cannot be read, contains impossible values, or holds none of the
            motions of `trajectory`.
    """
    if isinstance(path, Recording):
        return path
    loaded = load_robot(robot)
    table = None if limits is None else resolve_limits(loaded, limits)
    recording = with_period(recordings.read(Path(path), loaded, table, columns), period, window)
    return with_trajectory(recording, trajectory)


def with_trajectory(
    recording: Recording, trajectory: TrajectorySources, *, required: bool = True
) -> Recording:
    """Return the recording with period, window and commanded positions of an executed motion.

    Args:
        recording: The recording.
        trajectory: Trajectory files; the first that fits is used.
        required: Raise an error if none fits, else leave the recording as it is.

    Raises:
        UnusableInput: A file cannot be used, or the recording holds none of the motions.
    """
    paths = one_or_several(trajectory)
    for path in paths:
        planned = trajectory_file.read_trajectory(Path(path))
        aligned = executed_motion.apply_trajectory(recording, planned, str(path))
        if aligned is not None:
            for remark in aligned.remarks[len(recording.remarks) :]:
                if remark.repaired:
                    warnings.warn(f"{aligned.source}: {remark.text}", ExciteWarning, stacklevel=3)
            return aligned
    if paths and required:
        raise UnusableInput(
            f"{recording.source}: does not hold the motion of {', '.join(map(str, paths))}; give "
            "the trajectory.json that was executed, or leave --trajectory out"
        )
    return recording


def with_period(
    recording: Recording, period: float | None, window: tuple[float, float] | None
) -> Recording:
    """Return a recording with a stated period.

    Args:
        recording: The recording.
        period: Period [s]; None: the recording is returned unchanged.
        window: Times between which the motion is periodic [s]; None: all of the recording.

    Raises:
        UnusableInput: The period is not shorter than the recording or does not fit it, or a window
            is stated without a period.
    """
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
    return _warned(recording, check_repetition(dataclasses.replace(recording, sidecar=sidecar)))


def _warned(before: Recording, after: Recording) -> Recording:
    """Warn of the remarks that a check has added to a recording."""
    for remark in after.remarks[len(before.remarks) :]:
        warnings.warn(f"{after.source}: {remark.text}", ExciteWarning, stacklevel=3)
    return after


def identify(
    robot: RobotSource,
    recordings: RecordingSources,
    *,
    validate: RecordingSources = (),
    limits: str | Path | Limits | None = None,
    drive: str | Sequence[str] = inertial_parameters.DRIVE,
    bounds: str | Path | Bounds | None = None,
    prior: str | Path | None = None,
    period: float | None = None,
    window: tuple[float, float] | None = None,
    trajectory: TrajectorySources = (),
    columns: Mapping[str, str] = MappingProxyType({}),
    options: IdentificationOptions = IdentificationOptions(),  # noqa: B008  # immutable
    check_lmi: bool = False,
    progress: Progress | None = None,
    **choices: Any,
) -> IdentificationResult:
    """Identify physically consistent parameters from recordings, as `excite identify` does.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot.
        recordings: Recordings that the model is fitted to, one or several.
        validate: Held-out recordings; the model is not fitted to them.
        limits: Limits file or limits.
        drive: Joint parameters of the model, in addition to the inertial parameters.
        bounds: Bounds of masses and centres of mass, or a TOML file with them.
        prior: Trusted parameters: an `excite.prior/1` document or a `model.json`.
        period: Period of the excitation [s], if the `.json` of a recording does not state it.
        window: Times between which the motion is periodic [s].
        trajectory: The `trajectory.json` that was executed, or several: each recording takes
            period, window and commanded positions from the one that it holds.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in a CSV file.
        options: Estimator, distance, band and further choices; single fields may be given by
            keyword, e.g. `band=20.0`.
        check_lmi: Compare the estimate with that of a conic solver.
        progress: Called with each line of progress; None: the logger "excite" at level INFO.
        **choices: Fields of `IdentificationOptions`.

    Raises:
        UnusableInput: An argument or a file cannot be used.
    """
    recordings, validate = one_or_several(recordings), one_or_several(validate)
    loaded = load_robot(robot)
    table = resolve_limits(loaded, limits)
    report = progress or logger.info
    report(f"reading {', '.join(map(recording_name, (*recordings, *validate)))}")
    train, held_out = read_both(
        loaded,
        table,
        recordings,
        validate,
        period=period,
        window=window,
        trajectory=trajectory,
        columns=columns,
    )
    train, held_out = (
        [with_detected_period(recording) for recording in group] for group in (train, held_out)
    )
    loaded = robot_of_torque(loaded, [*train, *held_out])
    standard = inertial_parameters.standard_parameters(loaded, table, drive)
    base = base_parameters.find(loaded, standard, table)
    known = prior_module.read_prior(prior, loaded, standard)
    if known.model is not None and known.model.effects:
        warnings.warn(
            f"{prior}: has effects, which an identification leaves out; "
            "'excite diagnose --prior' knows them",
            ExciteWarning,
            stacklevel=2,
        )
    inertial_bounds = bounds if isinstance(bounds, Bounds) else read_bounds(bounds, standard)
    chosen = dataclasses.replace(
        options,
        bounds=inertial_bounds,
        trusted=known.parameters,
        widths=known.widths,
        **choices,
    )
    recording_cost.require_identifiable([*train, *held_out], report)
    with single_blas_thread():
        result = identification.identify(loaded, standard, base, train, held_out, chosen, report)
    return IdentificationResult(
        result,
        tuple(train),
        tuple(held_out),
        table,
        _compare_lmi(result) if check_lmi else None,
        inputs=argument_files(
            loaded.source,
            *(limits, bounds, prior, trajectory),
            recordings=(*recordings, *validate),
        ),
    )


def predict(
    model: str | Path,
    recording: RecordingSource,
    *,
    columns: Mapping[str, str] = MappingProxyType({}),
) -> PredictedTorque | PredictedWrench:
    """Predict the torque along a recording with an identified model, as `excite predict` does.

    The model of a floating base predicts its contact wrench, and the torque of its joints if it was
    fitted to them.

    Args:
        model: Path of a `model.json`.
        recording: Recording of the motion, or a designed `trajectory.csv`.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in a CSV file;
            without any those that the model states for the recording.

    Raises:
        UnusableInput: A file cannot be used.
    """
    file, content = identified_model.read_content(Path(model))
    named = columns or stated_columns(content, recording)
    if floating_model.is_floating(content):
        from .floating_result import predict_floating  # imports this module

        floating = floating_model.model_from_document(file, content)
        return predict_floating(floating, recording, named)
    fitted = identified_model.model_from_document(file, content)
    motion = read_recording(recording, fitted.robot, columns=named)
    for remark in motion.doubts:
        if remark.kind is RemarkKind.LOCKED:
            warnings.warn(f"{motion.source}: {remark.text}", ExciteWarning, stacklevel=2)
    time, torque = fitted_effects.predict(fitted, motion)
    if not np.isfinite(torque).all():
        joint = fitted.robot.joints[int(np.argmin(np.isfinite(torque).all(axis=0)))]
        raise UnusableInput(
            f"{model}: the torque that it predicts at joint '{joint}' is not finite; identify again"
        )
    warn_of_unsettled_ends(motion, fitted.hertz)
    inputs = argument_files(None, model, recordings=[recording])
    return PredictedTorque(fitted.robot.joints, time, torque, inputs=inputs)


def read_bounds(path: str | Path | None, standard: Parameters) -> Bounds:
    """Read bounds of masses and centres of mass from a TOML file.

    Args:
        path: The file; None: no bounds.
        standard: Parameters of the robot.

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


def recording_name(source: RecordingSource) -> str:
    """Return the name of a recording, or its path."""
    return source.source if isinstance(source, Recording) else str(source)


def require_recordings(recordings: Sequence[RecordingSource]) -> None:
    """Check that there is a recording that a model can be fitted to.

    Raises:
        UnusableInput: There is none.
    """
    if not recordings:
        raise UnusableInput("recordings: none is given; give at least one to fit the model to")


def read_both(
    robot: Robot,
    limits: Limits,
    train: Sequence[RecordingSource],
    held_out: Sequence[RecordingSource],
    *,
    period: float | None = None,
    window: tuple[float, float] | None = None,
    trajectory: TrajectorySources = (),
    columns: Mapping[str, str] = MappingProxyType({}),
    require_trajectory: bool = True,
) -> tuple[list[Recording], list[Recording]]:
    """Read training and validation recordings.

    With `require_trajectory` every training recording has to hold the motion of a trajectory.

    Raises:
        UnusableInput: A file cannot be used, there is no training recording, or a recording is in
            both sets.
    """
    require_recordings(train)
    sets = [
        [
            read_recording(
                path, robot, limits=limits, period=period, window=window, columns=columns
            )
            for path in paths
        ]
        for paths in (train, held_out)
    ]
    require_distinct(*sets)
    require_drive_gains([recording for group in sets for recording in group])
    if trajectory:  # a validation recording may hold another motion
        sets = [
            [
                with_trajectory(recording, trajectory, required=is_fitted)
                for recording in recordings_of_set
            ]
            for recordings_of_set, is_fitted in zip(sets, (require_trajectory, False), strict=True)
        ]
    train_set, held_out_set = (
        [with_torque_doubts(recording, robot, limits) for recording in recordings_of_set]
        for recordings_of_set in sets
    )
    return train_set, held_out_set


def recording_doubts(read: Sequence[Recording]) -> list[dict[str, Any]]:
    """Unrepaired doubts about recordings, with the recording that each is about."""
    return [
        {"recording": recording.source, **doubt.document()}
        for recording in read
        for doubt in recording.doubts
    ]


def with_torque_doubts(
    recording: Recording, robot: Robot, limits: Limits, *, has_payload: bool = False
) -> Recording:
    """Return the recording with the doubts about its torque."""
    loaded = robot_of_torque(robot, [recording])
    return torque_check.check_torque(recording, loaded, limits, has_payload=has_payload)


def robot_of_torque(robot: Robot, recordings: Sequence[Recording]) -> Robot:
    """Return the robot whose dynamics the recorded torque contains.

    Torque "without gravity" is that of the same links without gravity; it contains only the
    information about masses that accelerations give.

    Raises:
        UnusableInput: Some recordings are without gravity and others are not.
    """
    without = [
        recording.source
        for recording in recordings
        if recording.sidecar.effort == "without gravity"
    ]
    if not without:
        return robot
    if len(without) < len(recordings):
        other = next(
            recording.source for recording in recordings if recording.source not in without
        )
        raise UnusableInput(
            f"{without[0]}: holds torque without gravity but {other} does not; identify them apart"
        )
    model = robot.model.copy()
    model.gravity.linear = np.zeros(3)
    return dataclasses.replace(
        robot, model=model, options={**robot.options, "gravity": [0.0, 0.0, 0.0]}
    )


def _compare_lmi(result: Identification) -> lmi_check.LmiCheck:
    """Compare the estimate with that of a conic solver.

    The comparison of a refined model concerns the estimate from which the refinement started.
    """
    data, model, bounds = result.data, result.model, result.options.bounds
    root, target, estimate = (
        data.information_root @ model.base.matrix,
        data.information_root @ data.theta,
        result.posterior,
    )
    if result.options.refine:
        estimate = consistency.maximum_a_posteriori(
            model.parameters, root, target, result.prior, bounds
        )
    return lmi_check.check_estimate(model.parameters, root, target, result.prior, estimate, bounds)
