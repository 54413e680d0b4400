"""What a recording's columns cannot say: `<name>.json` beside it."""

from __future__ import annotations

import os
import os.path
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import UnusableInput
from ..robot.robot import Robot
from ..schemas.document_file import DocumentFile
from ..schemas.recording import SCHEMA, SidecarDocument

KEYS = SidecarDocument.__struct_fields__


@dataclass(frozen=True)
class Sidecar:
    """drive_gain: torque per motor current of a joint [N m/A]. period: of the excitation [s].
    periodic: (start, end) of the window in which it repeats [s]. motor_side: `q` is the motor's
    encoder over the gear ratio. effort: what JointState's `effort` holds, "torque" [N m] or
    "current" [A]; None: not said. topic: the bag's topic to read. notes: anything. unknown: keys
    that no rule reads.
    """

    drive_gain: Mapping[str, float] = field(default_factory=dict)
    period: float | None = None
    periodic: tuple[float, float] | None = None
    motor_side: bool = False
    effort: str | None = None
    topic: str | None = None
    notes: str = ""
    unknown: tuple[str, ...] = ()


def beside(recording: Path) -> Path:
    """Where the sidecar of a recording lies: `run.csv` and the folder `run` both have
    `run.json`."""
    return (
        recording.parent / f"{recording.name if os.path.isdir(recording) else recording.stem}.json"
    )


def read(recording: Path, robot: Robot) -> Sidecar:
    """The sidecar of a recording; an empty one where there is none.

    A JSON document of another excite schema (a trajectory beside its CSV) is none.

    Raises:
        UnusableInput: The file cannot be read, has no schema, breaks a rule of
            `schemas.recording`, or names a joint that is not there.
    """
    path = beside(recording)
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
        raise UnusableInput(
            f'{path}: should hold "schema": "{SCHEMA}" to describe {recording.name}; add it, or move the file away'  # noqa: E501
        )
    document = file.converted(content, SidecarDocument)
    joints = {*robot.joints, *robot.mimics, *robot.options["locked"]}  # type: ignore[misc]
    for joint in document.drive_gain:
        if joint not in joints:
            raise file.error(
                f"'{joint}' is no joint of {robot.source}, which has {', '.join(robot.joints)}",
                "drive_gain",
            )
    return Sidecar(
        drive_gain={joint: float(gain) for joint, gain in document.drive_gain.items()},
        period=None if document.period is None else float(document.period),
        periodic=None
        if document.periodic is None
        else (float(document.periodic[0]), float(document.periodic[1])),
        motor_side=document.motor_side,
        effort=document.effort,
        topic=document.topic,
        notes=document.notes,
        unknown=tuple(sorted(set(content) - set(KEYS))),
    )
