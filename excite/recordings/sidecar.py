"""What a recording's columns cannot say: `<name>.json` beside it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import UnusableInput

SCHEMA = "excite.recording/1"
KEYS = ("schema", "drive_gain", "period", "periodic", "motor_side", "effort", "topic", "notes")


@dataclass(frozen=True)
class Sidecar:
    """drive_gain: torque per motor current of a joint [N m/A]. period: of the excitation [s]. periodic: (start, end) of the
    window in which it repeats [s]. motor_side: `q` is the motor's encoder over the gear ratio.
    effort: what JointState's `effort` holds, "torque" [N m] or "current" [A]; None: not said. topic: the bag's topic to read.
    notes: anything. unknown: keys that no rule reads.
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
    """Where the sidecar of a recording lies: `run.csv` and the folder `run` both have `run.json`."""
    return recording.parent / f"{recording.name if recording.is_dir() else recording.stem}.json"


def read(recording: Path) -> Sidecar:
    """The sidecar of a recording; an empty one where there is none.

    A JSON document of another excite schema (a trajectory beside its CSV) is none. Raises UnusableInput for a file that cannot
    be read, has no schema or holds a value of the wrong kind.
    """
    path = beside(recording)
    if path == recording or not path.is_file():
        return Sidecar()
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UnusableInput(
            f"{path}: is no JSON document ({error}); repair it or move it away from {recording.name}"
        ) from error
    schema = document.get("schema") if isinstance(document, dict) else None
    if (
        isinstance(schema, str)
        and schema.startswith("excite.")
        and not schema.startswith("excite.recording/")
    ):
        return Sidecar()
    if schema != SCHEMA:
        raise UnusableInput(
            f'{path}: should hold "schema": "{SCHEMA}" to describe {recording.name}; add it, or move the file away'
        )
    return _checked(path, document)


def _checked(path: Path, document: dict[str, Any]) -> Sidecar:
    gains = document.get("drive_gain", {})
    if not isinstance(gains, dict):
        raise UnusableInput(
            f'{path}: drive_gain should read {{"<joint>": N m/A, …}}, not {gains!r}'
        )
    for joint, gain in gains.items():
        if not _number(gain) or gain == 0.0:
            raise UnusableInput(
                f"{path}: drive_gain of joint '{joint}' should be a number other than 0 [N m/A], not {gain!r}"
            )
    period, window = document.get("period"), document.get("periodic")
    if period is not None and not (_number(period) and period > 0.0):
        raise UnusableInput(
            f"{path}: period should be a positive number of seconds, not {period!r}"
        )
    if window is not None and not (
        isinstance(window, list)
        and len(window) == 2
        and all(map(_number, window))
        and window[0] < window[1]
    ):
        raise UnusableInput(
            f"{path}: periodic should be [start, end] in seconds with start < end, not {window!r}"
        )
    motor_side, effort, topic = (
        document.get("motor_side", False),
        document.get("effort"),
        document.get("topic"),
    )
    if not isinstance(motor_side, bool):
        raise UnusableInput(f"{path}: motor_side should be true or false, not {motor_side!r}")
    if effort not in (None, "torque", "current"):
        raise UnusableInput(f'{path}: effort should be "torque" or "current", not {effort!r}')
    if not isinstance(topic, str | None):
        raise UnusableInput(
            f'{path}: topic should be a name such as "/joint_states", not {topic!r}'
        )
    return Sidecar(
        drive_gain={str(joint): float(gain) for joint, gain in gains.items()},
        period=None if period is None else float(period),
        periodic=None if window is None else (float(window[0]), float(window[1])),
        motor_side=motor_side,
        effort=effort,
        topic=topic,
        notes=str(document.get("notes", "")),
        unknown=tuple(sorted(set(document) - set(KEYS))),
    )


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
