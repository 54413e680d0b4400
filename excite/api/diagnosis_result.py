"""Diagnose a robot: find the effects that its base model lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from .. import _json
from .._system.output_files import output_files, output_folder
from .._system.progress import Progress, logger
from ..diagnosis import diagnosis, fitted_effects, residual_atlas
from ..diagnosis.diagnosis_file import document as diagnosis_document
from ..identification import identified_model
from ..identification import prior as prior_module
from ..recordings import Recording, recording_cost
from ..robot import base_parameters, inertial_parameters
from ..robot.limits import Limits
from .identification_result import RecordingSource, _read_both
from .robots import RobotSource, load_robot, resolve_limits

DIAGNOSIS_FILES = ("diagnosis.json", "model.json", "report.html")
"""Files of a diagnosis."""


@dataclass(frozen=True)
class DiagnosisResult:
    """Effects that a recording shows beyond the base model.

    Attributes:
        diagnosis: Findings, unexplained torque, and the errors on held-out recordings.
        recordings: Recordings that the model is fitted to.
        validation: Held-out recordings.
        with_report: True if the residual is analysed for a report.
    """

    diagnosis: diagnosis.Diagnosis
    recordings: tuple[Recording, ...]
    validation: tuple[Recording, ...]
    with_report: bool = True

    @cached_property
    def atlas(self) -> residual_atlas.Atlas | None:
        """Residual over every quantity that it may depend on; None without a report."""
        return residual_atlas.compute_atlas(self.diagnosis) if self.with_report else None

    @cached_property
    def _document(self) -> dict[str, Any]:
        return diagnosis_document(self.diagnosis, self.atlas)

    def document(self) -> dict[str, Any]:
        """Return the content of `diagnosis.json`."""
        return dict(self._document)

    @property
    def findings(self) -> list[Mapping[str, Any]]:
        """Effects that are reported, the most probable first."""
        return list(self._document["findings"])

    def model(self) -> dict[str, Any]:
        """Return the content of `model.json`: parameters with and without the findings."""
        plain = self.diagnosis.identified
        out = identified_model.model_document(self.diagnosis.refitted or plain, self.recordings)
        out["effects"] = [
            fitted_effects.entry(part, plain.model.robot) for part in self.diagnosis.parts
        ]
        out["without_effects"] = dict(
            zip(plain.model.parameters.names, plain.psi.tolist(), strict=True)
        )
        return out

    def html(self) -> str:
        """Return the report as HTML."""
        from .. import report  # slow to import

        atlas = self.atlas or residual_atlas.compute_atlas(self.diagnosis)
        remarks = [
            r for recording in (*self.recordings, *self.validation) for r in recording.remarks
        ]
        return report.diagnosis_page(self.diagnosis, self._document, atlas, remarks)

    def contents(self) -> dict[str, str]:
        """Return the files of the diagnosis by name."""
        out = {
            "diagnosis.json": _json.dumps(self._document),
            "model.json": _json.dumps(self.model()),
        }
        return out | ({"report.html": self.html()} if self.with_report else {})

    def save(self, folder: str | Path) -> list[Path]:
        """Write `diagnosis.json`, `model.json` and `report.html`; return their paths.

        Raises:
            UnusableInput: The files cannot be written.
        """
        return output_folder(Path(folder), DIAGNOSIS_FILES).replace(self.contents())

    def report(self, path: str | Path) -> Path:
        """Write the report alone; return its path.

        Raises:
            UnusableInput: The file cannot be written.
        """
        path = Path(path)
        return output_files(path).replace({path.name: self.html()})[0]

    def __repr__(self) -> str:
        robot, document = self.diagnosis.identified.model.robot, self._document
        effects = ", ".join(str(entry["effect"]) for entry in document["findings"]) or "no finding"
        return f"<DiagnosisResult {robot.name}: {document['verdict']}, {effects}>"


def diagnose(
    robot: RobotSource,
    recordings: Sequence[RecordingSource],
    validate: Sequence[RecordingSource],
    *,
    limits: str | Path | Limits | None = None,
    prior: str | Path | None = None,
    band: float | None = None,
    with_report: bool = True,
    progress: Progress | None = None,
) -> DiagnosisResult:
    """Find the effects that the base model lacks, as `excite diagnose` does.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot.
        recordings: Recordings that models are fitted to.
        validate: Held-out recordings.
        limits: Limits file or limits.
        prior: Trusted parameters: an `excite.prior/1` document or a `model.json`.
        band: Cutoff frequency of the low-pass filter [Hz]; None: 20, or higher if the data require
            it.
        with_report: Analyse the residual for the report, which takes a third of the time.
        progress: Called with each line of progress; None: the logger "excite" at level INFO.

    Raises:
        UnusableInput: An argument or a file cannot be used.
    """
    loaded = load_robot(robot)
    table = resolve_limits(loaded, limits)
    standard = inertial_parameters.standard(loaded, table, inertial_parameters.DRIVE)
    base = base_parameters.find(loaded, standard, table)
    trusted = (
        {} if prior is None else prior_module.read_trusted_parameters(Path(prior), loaded, standard)
    )
    train, held_out = _read_both(loaded, table, recordings, validate)
    report = progress or logger.info
    recording_cost.require_diagnosable([*train, *held_out], report)
    options = diagnosis.DiagnosisOptions(band, trusted)
    result = diagnosis.diagnose(loaded, standard, base, train, held_out, options, report)
    return DiagnosisResult(result, tuple(train), tuple(held_out), with_report)
