"""Identify a robot with position servos from commanded and measured positions, without torque."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from .._system.blas_threads import single_blas_thread
from .._system.one_or_several import one_or_several
from .._system.progress import Progress, logger
from .._types import FloatArray
from ..errors import UnusableInput
from ..identification import servo_identification
from ..identification.consistency import Bounds
from ..identification.servo_document import servo_model_document
from ..identification.servo_identification import ServoIdentification, ServoOptions
from ..recordings import Recording, require_distinct
from ..robot import base_parameters, inertial_parameters
from ..robot.limits import Limits
from ..robot.robot import Robot
from .identification_result import (
    RecordingSources,
    TrajectorySources,
    read_bounds,
    read_recording,
    recording_name,
    require_recordings,
)
from .input_files import argument_files
from .robots import RobotSource, load_robot, resolve_limits
from .saved_identification import SavedIdentification
from .stated_recordings import with_recording_columns


@dataclass(frozen=True)
class ServoIdentificationResult(SavedIdentification):
    """A robot and its position loops, identified without torque.

    The unit of its parameters is that of `scale_statement`.

    Attributes:
        identification: Parameters, position loops, and position errors.
    """

    identification: ServoIdentification

    @cached_property
    def _document(self) -> dict[str, Any]:
        out = servo_model_document(self.identification, self.recordings)
        return with_recording_columns(out, [*self.recordings, *self.validation])

    def document(self) -> dict[str, Any]:
        """Return the content of `model.json`."""
        return self._document

    def html(self) -> str:
        """Return the report as HTML."""
        from ..report.servo import servo_page

        return servo_page(self.identification)

    def __repr__(self) -> str:
        result = self.identification
        error = float(np.sqrt(np.mean([r.error() ** 2 for r in result.fits])))
        return (
            f"<ServoIdentificationResult {result.model.robot.name}: position RMSE {error:.3g} in "
            "the recordings fitted>"
        )


def gain_pairs(gains: Sequence[float], robot: Robot) -> FloatArray:
    """Return K_p and K_d of each joint. Shape (2, n).

    Args:
        gains: One pair, or one for each joint.
        robot: The robot.

    Raises:
        UnusableInput: The number of gains does not fit the joints.
    """
    if len(gains) not in (2, 2 * robot.n):
        raise UnusableInput(
            f"--gains: should hold KP,KD once or for each of the {robot.n} joints "
            f"({', '.join(robot.joints)}), not {len(gains)} numbers"
        )
    return np.broadcast_to(np.array(gains, float).reshape(-1, 2), (robot.n, 2)).T.copy()


def lacks_torque(recording: Recording) -> bool:
    """Return whether a recording has commanded positions and no torque or current at all."""
    return recording.tau is None and recording.current is None and recording.qref is not None


def identify_servo(
    robot: RobotSource,
    recordings: RecordingSources,
    *,
    validate: RecordingSources = (),
    limits: str | Path | Limits | None = None,
    drive: str | Sequence[str] = inertial_parameters.DRIVE,
    bounds: str | Path | Bounds | None = None,
    gains: Sequence[float] | None = None,
    trajectory: TrajectorySources = (),
    columns: Mapping[str, str] = MappingProxyType({}),
    options: ServoOptions = ServoOptions(),  # noqa: B008  # immutable
    progress: Progress | None = None,
    **choices: Any,
) -> ServoIdentificationResult:
    """Identify a robot with position servos, as `excite identify --from position` does.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot.
        recordings: Recordings with `q` and `qref` that the model is fitted to; torque in them is
            not used.
        validate: Held-out recordings; the model is not fitted to them.
        limits: Limits file or limits.
        drive: Joint parameters of the model, in addition to the inertial parameters.
        bounds: Bounds of masses and centres of mass, or a TOML file with them.
        gains: K_p and K_d of the position loops: one pair, or one for each joint [N m/rad, N m
            s/rad]; None: they are estimated, and all torques are ratios to them.
        trajectory: The `trajectory.json` that was executed, for commanded positions.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in a CSV file.
        options: Further choices; single fields may be given by keyword, e.g. `window=2.0`.
        progress: Called with each line of progress; None: the logger "excite" at level INFO.
        **choices: Fields of `ServoOptions`.

    Raises:
        UnusableInput: An argument or a file cannot be used.
    """
    recordings, validate = one_or_several(recordings), one_or_several(validate)
    require_recordings(recordings)
    loaded = load_robot(robot)
    table = resolve_limits(loaded, limits)
    report = progress or logger.info
    report(f"reading {', '.join(map(recording_name, (*recordings, *validate)))}")
    train, held_out = (
        [
            read_recording(path, loaded, limits=table, trajectory=trajectory, columns=columns)
            for path in paths
        ]
        for paths in (recordings, validate)
    )
    require_distinct(train, held_out)
    standard = inertial_parameters.standard_parameters(loaded, table, drive)
    base = base_parameters.find(loaded, standard, table)
    chosen = dataclasses.replace(
        options,
        gains=options.gains if gains is None else gain_pairs(gains, loaded),
        bounds=options.bounds
        if bounds is None
        else bounds
        if isinstance(bounds, Bounds)
        else read_bounds(bounds, standard),
        **choices,
    )
    with single_blas_thread():
        result = servo_identification.identify_servo(
            loaded, standard, base, train, held_out, chosen, report
        )
    inputs = argument_files(
        loaded.source, limits, bounds, trajectory, recordings=(*recordings, *validate)
    )
    return ServoIdentificationResult(result, tuple(train), tuple(held_out), inputs=inputs)
