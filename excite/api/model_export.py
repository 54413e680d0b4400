"""Export an identified robot for a simulator or a controller."""

from __future__ import annotations

import os.path
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .._system.output_files import output_files
from ..errors import UnusableInput
from ..exporters.model_formats import model_text, remainders, require_format
from ..exporters.simulator_model import Remainder, SimulatorModel, simulator_model
from ..identification.identified_model import model_file, model_from_document
from ..recordings import Recording
from ..schemas.model import SCHEMA as MODEL_SCHEMA
from .identification_result import RecordingSource, read_recording
from .input_files import argument_files
from .robots import resolve_limits


@dataclass(frozen=True)
class ExportedModel:
    """An identified robot as the text of a file for a simulator.

    Attributes:
        model: The robot.
        format: Name of the format.
        text: Text of the file.
        inputs: Files that it was computed from, which `save` and `report` do not replace.
    """

    model: SimulatorModel
    format: str
    text: str
    inputs: tuple[Path, ...] = field(default=(), repr=False)

    @property
    def remainders(self) -> list[Remainder]:
        """The parts of the model that the format does not hold, the largest first."""
        return remainders(self.model, self.format)

    def document(self) -> dict[str, Any]:
        """Return what `excite export --json` prints."""
        return {
            "format": self.format,
            "joints": list(self.model.joints),
            "along": self.model.rms_source or None,
            "not_held": [part.document() for part in self.remainders],
        }

    def save(self, path: str | Path) -> Path:
        """Write the file; return its path.

        Raises:
            UnusableInput: The file cannot be written, or is among `inputs`.
        """
        path = Path(path)
        return output_files(path, inputs=self.inputs).replace({path.name: self.text})[0]

    def report(self, path: str | Path) -> Path:
        """Write what the format does not hold as a text file; return its path.

        Raises:
            UnusableInput: The file cannot be written, or is among `inputs`.
        """
        path = Path(path)
        lines = [part.text for part in self.remainders] or ["the file holds everything"]
        return output_files(path, inputs=self.inputs).replace({path.name: "\n".join(lines) + "\n"})[
            0
        ]

    def __repr__(self) -> str:
        return f"<ExportedModel {self.model.model.robot.name}: {self.format}>"


def is_model(path: str | Path) -> bool:
    """Return whether a file states the schema of an identified robot.

    Args:
        path: The file; where it cannot be read, the answer is False.
    """
    try:
        content = model_file(Path(path)).json()
    except UnusableInput:
        return False
    schema = content.get("schema") if isinstance(content, dict) else None
    return isinstance(schema, str) and schema == MODEL_SCHEMA


def read_simulator_model(
    model: str | Path,
    *,
    recording: RecordingSource | None = None,
    limits: str | Path | None = None,
) -> SimulatorModel:
    """Read an identified robot and prepare it for the files of simulators.

    Args:
        model: Path of a `model.json`.
        recording: Motion along which the torque of the effects is evaluated; None: the first
            recording of the model that is still in its place.
        limits: Limits file; None: the limits of the URDF.

    Raises:
        UnusableInput: A file cannot be used.
    """
    file = model_file(Path(model))
    content = file.json()
    file.schema(content, (MODEL_SCHEMA,))
    fitted = model_from_document(file, content)
    motion: Recording | None = None
    if recording is None:
        recording = _stated_recording(content, Path(model))
    if recording is not None:
        motion = read_recording(recording, fitted.robot)
    table = None if limits is None else resolve_limits(fitted.robot, limits)
    return simulator_model(fitted, content, recording=motion, limits=table)


def _stated_recording(content: Mapping[str, Any], path: Path) -> Path | None:
    """The first of the model's recordings that is in the place that it states; a model without
    effects needs none."""
    for key in ("validation", "fit"):
        for entry in content.get(key) or []:
            stated = Path(str(entry.get("recording", "")))
            for place in (stated, path.parent / stated.name):
                if os.path.isfile(place):  # False for names that no file can have
                    return place
    return next(
        (
            place
            for stated in content.get("recordings", [])
            for place in (Path(str(stated)), path.parent / Path(str(stated)).name)
            if os.path.isfile(place)
        ),
        None,
    )


def export_model(
    model: str | Path,
    format: str,
    *,
    into: str | Path | None = None,
    recording: RecordingSource | None = None,
    limits: str | Path | None = None,
) -> ExportedModel:
    """Export an identified robot for a simulator, as `excite export MODEL` does.

    Args:
        model: Path of a `model.json`.
        format: Name of a format; `excite.exporters.MODEL_FORMATS` lists them.
        into: The user's own MJCF, of which only what was identified changes.
        recording: Motion along which the torque of what the format does not hold is evaluated;
            None: the first recording of the model that is still in its place.
        limits: Limits file; None: the limits of the URDF.

    Raises:
        UnusableInput: A file cannot be used, or the format is unknown.
    """
    require_format(format)  # before anything is computed
    prepared = read_simulator_model(model, recording=recording, limits=limits)
    text = model_text(prepared, format, None if into is None else Path(into))
    measured = [] if recording is None else [recording]
    inputs = argument_files(None, model, into, limits, recordings=measured)
    return ExportedModel(prepared, format, text, inputs)
