"""Diagnose a robot: find the effects that its base model lacks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from .. import _json
from .._system.blas_threads import single_blas_thread
from .._system.one_or_several import one_or_several
from .._system.progress import Progress, logger
from ..diagnosis import decisions, diagnosis, fitted_effects
from ..diagnosis.decisions import Decisions, ExpectedEvidence
from ..diagnosis.diagnosis_file import document as diagnosis_document
from ..diagnosis.diagnosis_file import withhold_findings
from ..errors import UnusableInput
from ..identification import identified_model
from ..identification import prior as prior_module
from ..recordings import Recording, recording_cost
from ..robot import base_parameters, inertial_parameters
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..schemas.diagnosis import DiagnosisDocument, diagnosis_file, read_diagnosis
from ..trajectory import trajectory_file
from .identification_result import (
    RecordingSources,
    TrajectorySources,
    read_both,
    recording_doubts,
    robot_of_torque,
)
from .input_files import argument_files
from .robots import RobotSource, load_robot, resolve_limits
from .saved_result import SavedResult
from .stated_recordings import remarks_by_recording, with_recording_columns

DIAGNOSIS_FILES = ("diagnosis.json", "model.json", "report.html")
"""Files of a diagnosis."""


@dataclass(frozen=True)
class DiagnosisResult(SavedResult):
    """Effects that a recording shows beyond the base model.

    Attributes:
        diagnosis: Findings, unexplained torque, and the errors on held-out recordings.
        recordings: Recordings that the model is fitted to.
        validation: Held-out recordings.
        with_report: True if a report is written.
        decisions: What the discriminating recordings decided; None without any.
    """

    FILES = DIAGNOSIS_FILES

    diagnosis: diagnosis.Diagnosis
    recordings: tuple[Recording, ...]
    validation: tuple[Recording, ...]
    with_report: bool = True
    decisions: Decisions | None = None

    @property
    def doubts(self) -> list[dict[str, Any]]:
        """Unrepaired doubts about the recordings, with the recording that each is about."""
        return recording_doubts([*self.recordings, *self.validation])

    @cached_property
    def _document(self) -> dict[str, Any]:
        document = diagnosis_document(self.diagnosis, self.decisions)
        return withhold_findings(document, self.doubts) if self.doubts else document

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
        out = dict(self.diagnosis.document)
        if self.doubts:
            out = identified_model.model_document(plain, self.recordings)
            robot = plain.model.robot
            out["effects"] = [fitted_effects.entry(e, robot) for e in self.diagnosis.known]
        out["without_effects"] = dict(
            zip(plain.model.parameters.names, plain.psi.tolist(), strict=True)
        )
        return with_recording_columns(out, [*self.recordings, *self.validation])

    def html(self) -> str:
        """Return the report as HTML."""
        from .. import report  # slow to import

        remarks = remarks_by_recording([*self.recordings, *self.validation])
        return report.diagnosis_page(self.diagnosis, self._document, remarks)

    def contents(self) -> dict[str, str]:
        """Return the files of the diagnosis by name."""
        out = {
            "diagnosis.json": _json.dumps(self._document),
            "model.json": _json.dumps(self.model()),
        }
        return out | ({"report.html": self.html()} if self.with_report else {})

    def __repr__(self) -> str:
        robot, document = self.diagnosis.identified.model.robot, self._document
        effects = ", ".join(str(entry["effect"]) for entry in document["findings"]) or "no finding"
        return f"<DiagnosisResult {robot.name}: {document['verdict']}, {effects}>"


def diagnose(
    robot: RobotSource,
    recordings: RecordingSources,
    validate: RecordingSources,
    *,
    limits: str | Path | Limits | None = None,
    prior: str | Path | None = None,
    band: float | None = None,
    trajectory: TrajectorySources = (),
    columns: Mapping[str, str] = MappingProxyType({}),
    discriminating: RecordingSources = (),
    before: str | Path | None = None,
    with_report: bool = True,
    progress: Progress | None = None,
) -> DiagnosisResult:
    """Find the effects that the base model lacks, as `excite diagnose` does.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot.
        recordings: Recordings that models are fitted to, one or several.
        validate: Held-out recordings.
        limits: Limits file or limits.
        prior: Trusted knowledge: parameters in an `excite.prior/1` document, or parameters and
            effects of a `model.json`.
        band: Cutoff frequency of the low-pass filter [Hz]; None: chosen from the data.
        trajectory: The `trajectory.json` that was executed, or several: each recording takes
            period, window and commanded positions from the one that it holds.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in a CSV file.
        discriminating: Further recordings that models are fitted to, made to tell apart what
            `recordings` alone leave open.
        before: `diagnosis.json` of `recordings` alone; None: computed where `discriminating` needs
            it.
        with_report: Write a report.
        progress: Called with each line of progress; None: the logger "excite" at level INFO.

    Raises:
        UnusableInput: An argument or a file cannot be used.
    """
    recordings, validate = one_or_several(recordings), one_or_several(validate)
    discriminating = one_or_several(discriminating)
    if before is not None and not discriminating:
        raise UnusableInput(f"--before {before}: goes with --discriminating RECORDING")
    loaded = load_robot(robot)
    table = resolve_limits(loaded, limits)
    report = progress or logger.info
    train, held_out = read_both(
        loaded,
        table,
        [*recordings, *discriminating],
        validate,
        trajectory=trajectory,
        columns=columns,
        require_trajectory=not discriminating,
    )
    loaded = robot_of_torque(loaded, [*train, *held_out])
    earlier = None if before is None else _earlier(Path(before), loaded)
    standard = inertial_parameters.standard_parameters(loaded, table, inertial_parameters.DRIVE)
    base = base_parameters.find(loaded, standard, table)
    known = prior_module.read_prior(prior, loaded, standard)
    recording_cost.require_diagnosable([*train, *held_out], report)
    run = partial(
        diagnosis.diagnose, loaded, standard, base, progress=report, band=band, prior=known
    )
    with single_blas_thread():
        result = run(train=train, validate=held_out)
        decided = None
        if discriminating:
            if earlier is None:
                report("diagnosis of the earlier recordings alone")
                alone = run(train=train[: len(recordings)], validate=held_out)
                file = diagnosis_file(Path("diagnosis.json"))
                earlier = file.converted(diagnosis_document(alone), DiagnosisDocument)
            decided = decisions.decide(earlier, result, _expected(trajectory))
    inputs = argument_files(
        loaded.source,
        *(limits, prior, before, trajectory),
        recordings=(*recordings, *discriminating, *validate),
    )
    return DiagnosisResult(
        result, tuple(train), tuple(held_out), with_report, decided, inputs=inputs
    )


def _earlier(path: Path, robot: Robot) -> DiagnosisDocument:
    """Read the diagnosis of the earlier recordings.

    Raises:
        UnusableInput: The file cannot be used, or names other joints.
    """
    document = read_diagnosis(path)
    unknown = {f.joint for f in document.findings if f.joint is not None} - set(robot.joints)
    if unknown:
        raise UnusableInput(
            f"--before {path}: no joint '{min(unknown)}'; the joints are "
            f"{', '.join(robot.joints)}; give the diagnosis of this robot"
        )
    return document


def _expected(trajectories: TrajectorySources) -> list[ExpectedEvidence]:
    """Return the evidence that the designs among the executed trajectories expected."""
    paths = [trajectories] if isinstance(trajectories, str | Path) else list(trajectories)
    designs = (trajectory_file.read_trajectory(Path(path)).design for path in paths)
    expected = (ExpectedEvidence.of_design(design) for design in designs)
    return [evidence for evidence in expected if evidence is not None]
