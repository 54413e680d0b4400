"""Sidecar of a recording: properties that its columns cannot state, in `<name>.json`."""

from __future__ import annotations

import os.path
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import UnusableInput
from ..robot.robot import Robot
from ..schemas.document_file import DocumentFile
from ..schemas.recording import SCHEMA, SidecarDocument
from .text_file import SUFFIXES

KEYS = SidecarDocument.__struct_fields__
"""Keys that a sidecar may have; others are ignored."""


@dataclass(frozen=True)
class Sidecar:
    """Stated properties of a recording.

    Attributes:
        drive_gain: Torque per motor current of each joint [N m/A].
        period: Period of the excitation [s].
        periodic: Start and end of the window in which it repeats [s].
        motor_side: True if `q` is the motor encoder divided by the gear ratio.
        effort: Content of `effort` in JointState messages, of a bag or in a CSV file, "torque"
            [N m] or "current" [A], or of the torque in any file, "without gravity" [N m]; None if
            not stated.
        topic: Topic to read, of a bag or of PlotJuggler's CSV.
        position_gain: Gain of each joint's position loop, in any unit: recordings of one robot with
            different gains are compared by their ratio [1].
        error_limit: Position error of each joint at which its motor saturates [rad or m].
        notes: Free text.
        unknown: Keys of the file that are ignored.
    """

    drive_gain: Mapping[str, float] = field(default_factory=dict)
    period: float | None = None
    periodic: tuple[float, float] | None = None
    motor_side: bool = False
    effort: str | None = None
    topic: str | None = None
    position_gain: Mapping[str, float] = field(default_factory=dict)
    error_limit: Mapping[str, float] = field(default_factory=dict)
    notes: str = ""
    unknown: tuple[str, ...] = ()


def sidecar_path(recording: Path) -> Path:
    """Return the path of a recording's sidecar: `run.json` for `run.csv`, for `run.csv.gz` and for
    the folder `run`."""
    if recording.name in ("", ".."):  # the working folder, or one above it
        recording = recording.resolve()
    if os.path.isdir(recording):
        return recording.parent / f"{recording.name}.json"
    content = recording.with_suffix("") if recording.suffix in SUFFIXES else recording
    return recording.parent / f"{content.stem}.json"


def read(recording: Path, robot: Robot) -> Sidecar:
    """Read the sidecar of a recording.

    A JSON document of another excite schema, such as the trajectory next to its CSV file, is no
    sidecar.

    Args:
        recording: Path of the recording.
        robot: Robot that it records.

    Returns:
        The sidecar, an empty one where there is none.

    Raises:
        UnusableInput: The file cannot be read, has no schema, breaks a rule of
            `schemas.recording`, or names a joint that does not exist.
    """
    path = sidecar_path(recording)
    if path == recording or not os.path.isfile(path):
        return Sidecar()
    file = DocumentFile(
        path,
        "the sidecar of a recording",
        f"correct it, or move it away from {recording.name}",
        f"one of {SCHEMA}",
    )
    content = file.json()
    schema = content.get("schema") if isinstance(content, dict) else None
    if (
        isinstance(schema, str)
        and schema.startswith("excite.")
        and not schema.startswith("excite.recording/")
    ):
        return Sidecar()
    if schema != SCHEMA:
        expected = f'"schema": "{SCHEMA}" to describe {recording.name}'
        raise UnusableInput(f"{path}: should hold {expected}; add it, or move the file away")
    document = file.converted(content, SidecarDocument)
    joints = {*robot.joints, *robot.mimics, *robot.options["locked"]}  # type: ignore[misc]
    for key in ("drive_gain", "position_gain", "error_limit"):
        for joint in getattr(document, key):
            if joint not in joints:
                raise file.error(
                    f"'{joint}' is no joint of {robot.source}, which has {', '.join(robot.joints)}",
                    key,
                )
    window = document.periodic
    return Sidecar(
        drive_gain={joint: float(gain) for joint, gain in document.drive_gain.items()},
        period=None if document.period is None else float(document.period),
        periodic=None if window is None else (float(window[0]), float(window[1])),
        motor_side=document.motor_side,
        effort=document.effort,
        topic=document.topic,
        position_gain={joint: float(value) for joint, value in document.position_gain.items()},
        error_limit={joint: float(value) for joint, value in document.error_limit.items()},
        notes=document.notes,
        unknown=tuple(sorted(set(content) - set(KEYS))),
    )
