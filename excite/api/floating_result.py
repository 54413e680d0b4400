"""Identify floating-base robots, and predict wrenches with their models."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from .. import recordings
from .._system.blas_threads import single_blas_thread
from .._system.one_or_several import one_or_several
from .._system.progress import Progress, logger
from .._types import FloatArray
from ..errors import UnusableInput
from ..identification import floating_identification, floating_model
from ..identification.consistency import Bounds
from ..identification.floating_identification import FloatingIdentification, FloatingOptions
from ..identification.floating_model import FloatingIdentifiedModel
from ..identification.inertia_distance import Distance
from ..recordings import Recording, require_distinct
from ..robot import floating_base
from ..robot.floating_base import FloatingRobot, Rows
from .identification_result import (
    RecordingSource,
    RecordingSources,
    read_bounds,
    require_recordings,
)
from .input_files import argument_files
from .predicted_table import PredictedTable, csv_text, warn_of_unsettled_ends
from .robots import RobotSource
from .saved_identification import SavedIdentification
from .stated_recordings import with_recording_columns


@dataclass(frozen=True)
class FloatingIdentificationResult(SavedIdentification):
    """An identified floating-base robot.

    Attributes:
        identification: Parameters, weights and predictions.
    """

    identification: FloatingIdentification

    def document(self) -> dict[str, Any]:
        """Return the content of `model.json`."""
        out = floating_model.model_document(self.identification, self.recordings)
        return with_recording_columns(out, [*self.recordings, *self.validation])

    def html(self) -> str:
        """Return the report as HTML."""
        from ..report.floating_identification import floating_identification_page

        return floating_identification_page(self.identification, self.remarks)

    def __repr__(self) -> str:
        result = self.identification
        return (
            f"<FloatingIdentificationResult {result.model.name}: "
            f"{result.analysis.identifiable_count} of {result.model.base.count} directions "
            "identified>"
        )


def load_floating_robot(source: RobotSource | FloatingRobot, **options: Any) -> FloatingRobot:
    """Load a robot with a free flyer between the world and its base.

    Args:
        source: Path of a URDF or name of a built-in model; a loaded robot is used as it is.
        **options: `joints`, `lock`, `payload`, `gravity` of `load_robot`.

    Raises:
        UnusableInput: The file cannot be used, or a joint or link is unknown.
    """
    if isinstance(source, FloatingRobot):
        return source
    return floating_base.load(source, **options)


def read_floating_recording(
    path: RecordingSource,
    robot: FloatingRobot,
    columns: Mapping[str, str] = MappingProxyType({}),
) -> Recording:
    """Read a recording with the pose of the base and contact wrenches.

    Args:
        path: CSV file with the columns `t`, `base.x` … `base.qw`, `q.<joint>`, and where recorded
            `wrench.<frame>.fx` … `.mz`, `imu.*`, `tau.<joint>`; a recording is returned unchanged.
        robot: The robot.
        columns: Standard names of columns -> differing names in the file.

    Raises:
        UnusableInput: The file cannot be used, or a wrench names an unknown frame.
    """
    if isinstance(path, Recording):
        return path
    recording = recordings.read(Path(path), robot.joint_robot, None, columns, floating=True)
    for frame in recording.contacts:
        floating_base.require_frame(robot, frame, recording.source)
    return recording


def identify_floating(
    robot: RobotSource | FloatingRobot,
    recordings_of_fit: RecordingSources,
    *,
    validate: RecordingSources = (),
    limits: str | Path | None = None,
    bounds: str | Path | Bounds | None = None,
    columns: Mapping[str, str] = MappingProxyType({}),
    options: FloatingOptions = FloatingOptions(),  # noqa: B008  # immutable
    progress: Progress | None = None,
    **choices: Any,
) -> FloatingIdentificationResult:
    """Identify the bodies of a floating-base robot, as `excite identify --floating` does.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot.
        recordings_of_fit: Recordings that the model is fitted to, one or several.
        validate: Held-out recordings; the model is not fitted to them.
        limits: Limits file, for the scales of joint parameters.
        bounds: Bounds of masses and centres of mass, or a TOML file with them.
        columns: Standard names of columns -> differing names in a CSV file.
        options: Rows, distance, γ, band and further choices; single fields may be given by keyword.
        progress: Called with each line of progress; None: the logger "excite" at level INFO.
        **choices: Fields of `FloatingOptions`; `distance` and `rows` may be words.

    Raises:
        UnusableInput: An argument or a file cannot be used.
    """
    loaded = load_floating_robot(robot)
    table = floating_base.limits(loaded, None if limits is None else Path(limits))
    recordings_of_fit, validate = one_or_several(recordings_of_fit), one_or_several(validate)
    require_recordings(recordings_of_fit)
    train, held_out = (
        [read_floating_recording(path, loaded, columns) for path in paths]
        for paths in (recordings_of_fit, validate)
    )
    require_distinct(train, held_out)
    if isinstance(choices.get("distance"), str):
        choices["distance"] = Distance(choices["distance"])
    if isinstance(choices.get("rows"), str):
        choices["rows"] = Rows(choices["rows"])
    chosen = dataclasses.replace(options, **choices)
    if bounds is not None:
        standard = floating_base.standard_parameters(loaded)
        inertial = bounds if isinstance(bounds, Bounds) else read_bounds(bounds, standard)
        chosen = dataclasses.replace(chosen, bounds=inertial)
    with single_blas_thread():
        result = floating_identification.identify(
            loaded, train, held_out, chosen, table, progress or logger.info
        )
    inputs = argument_files(
        loaded.joint_robot.source, limits, bounds, recordings=(*recordings_of_fit, *validate)
    )
    return FloatingIdentificationResult(result, tuple(train), tuple(held_out), inputs=inputs)


@dataclass(frozen=True)
class PredictedWrench(PredictedTable):
    """Wrench and joint torque that the model of a floating-base robot predicts.

    Attributes:
        columns: Names of the columns: `wrench.world.fx`, …, `tau.<joint>`, …
        time: Times of the recording's rows. Shape (N,) [s].
        values: Predicted values. Shape (N, r) [N, N m].
    """

    columns: tuple[str, ...]
    time: FloatArray
    values: FloatArray

    def csv(self) -> str:
        """Return the table as CSV."""
        return csv_text(self.columns, self.time, self.values)

    def __repr__(self) -> str:
        return f"<PredictedWrench of {len(self.columns)} columns at {len(self.time)} times>"


def predict_floating(
    model: FloatingIdentifiedModel,
    recording: RecordingSource,
    columns: Mapping[str, str] = MappingProxyType({}),
) -> PredictedWrench:
    """Predict wrench and torque along a recording with the model of a floating-base robot.

    Args:
        model: The model.
        recording: Recording of the motion.
        columns: Standard names of columns -> differing names in a CSV file.

    Raises:
        UnusableInput: The recording cannot be used.
    """
    motion = read_floating_recording(recording, model.robot, columns)
    time, values = model.predict(motion)
    if not np.isfinite(values).all():
        raise UnusableInput(f"{model.source}: its prediction is not finite; identify again")
    warn_of_unsettled_ends(motion, float(model.hertz.min()))
    inputs = argument_files(None, model.source, recordings=[recording])
    return PredictedWrench(model.columns, time, values, inputs=inputs)
