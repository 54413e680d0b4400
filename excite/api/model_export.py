"""Export an identified robot for a simulator or a controller."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from .._system.output_files import output_files
from ..errors import ExciteWarning, UnusableInput
from ..exporters.model_formats import model_text, remainders, require_format
from ..exporters.simulator_model import Remainder, SimulatorModel, simulator_model
from ..identification.identified_model import (
    IdentifiedModel,
    model_file,
    model_from_document,
    read_content,
)
from ..schemas.model import SCHEMA as MODEL_SCHEMA
from .identification_result import RecordingSource, read_recording
from .input_files import argument_files
from .robots import resolve_limits
from .stated_recordings import stated_columns, stated_recording


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


def read_fitted_model(model: str | Path) -> tuple[IdentifiedModel, dict[str, Any]]:
    """Read an identified robot, and the content of its `model.json`.

    Raises:
        UnusableInput: The file cannot be used.
    """
    file, content = read_content(Path(model))
    return model_from_document(file, content), content


def read_simulator_model(
    model: str | Path,
    *,
    recording: RecordingSource | None = None,
    limits: str | Path | None = None,
    columns: Mapping[str, str] = MappingProxyType({}),
) -> SimulatorModel:
    """Read an identified robot and prepare it for the files of simulators.

    Args:
        model: Path of a `model.json`.
        recording: Motion along which the torque of the effects is evaluated; None: the first
            recording of the model that is still in its place, if it can be read.
        limits: Limits file; None: the limits of the URDF.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in a CSV file;
            without any those that the model states for the recording.

    Raises:
        UnusableInput: A file cannot be used.
    """
    fitted, content = read_fitted_model(model)
    table = None if limits is None else resolve_limits(fitted.robot, limits)
    if recording is not None:
        named = columns or stated_columns(content, recording)
        motion = read_recording(recording, fitted.robot, columns=named)
        return simulator_model(fitted, content, recording=motion, limits=table)
    stated = stated_recording(content, Path(model).parent)
    if stated is not None:
        path, named = stated
        try:
            motion = read_recording(path, fitted.robot, columns=columns or named)
            return simulator_model(fitted, content, recording=motion, limits=table)
        except UnusableInput as error:  # the robot is complete without the recording
            warnings.warn(
                f"{error}; the torque of what a format does not hold is therefore unknown, all "
                "else is exported (--recording FILE states another motion)",
                ExciteWarning,
                stacklevel=3,
            )
    return simulator_model(fitted, content, limits=table)


def export_model(
    model: str | Path,
    format: str,
    *,
    into: str | Path | None = None,
    recording: RecordingSource | None = None,
    limits: str | Path | None = None,
    columns: Mapping[str, str] = MappingProxyType({}),
) -> ExportedModel:
    """Export an identified robot for a simulator, as `excite export MODEL` does.

    Args:
        model: Path of a `model.json`.
        format: Name of a format; `excite.exporters.MODEL_FORMATS` lists them.
        into: The user's own MJCF, of which only what was identified changes.
        recording: Motion along which the torque of what the format does not hold is evaluated;
            None: the first recording of the model that is still in its place, if it can be read.
        limits: Limits file; None: the limits of the URDF.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in the CSV file
            of the recording; without any those that the model states for it.

    Raises:
        UnusableInput: A file cannot be used, or the format is unknown.
    """
    require_format(format)  # before anything is computed
    prepared = read_simulator_model(model, recording=recording, limits=limits, columns=columns)
    text = model_text(prepared, format, None if into is None else Path(into))
    measured = [] if recording is None else [recording]
    inputs = argument_files(None, model, into, limits, recordings=measured)
    return ExportedModel(prepared, format, text, inputs)
