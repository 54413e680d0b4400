"""The part of a `diagnosis.json` that the design of an experiment reads, schema
excite.diagnosis/1."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec

from .document_file import DocumentFile
from .quantities import Name

SCHEMA = "excite.diagnosis/1"
Probability = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]


class FindingParameter(msgspec.Struct):
    """A parameter of a finding with its standard deviation, null where it is unknown."""

    value: float | None = None
    std: float | None = None
    unit: str = ""


class RivalDocument(msgspec.Struct):
    """An equivalent of a finding, with the log odds of the finding over it [nat]."""

    effect: Name
    log_odds: float | None = None


class JointNoiseDocument(msgspec.Struct):
    """Torque noise of a joint below the cutoff frequency [N m]."""

    noise_floor: Annotated[float, msgspec.Meta(ge=0.0)] | None = None


class FindingDocument(msgspec.Struct):
    """An effect that is reported, or was considered."""

    effect: Name
    joint: Name | None
    probability: Probability
    equivalents: list[Name] = []
    rivals: list[RivalDocument] = []
    parameters: dict[str, FindingParameter] = {}
    other: Name | None = msgspec.field(name="from", default=None)


class ResponseDocument(msgspec.Struct):
    """Torque that no effect explains over a quantity, by points."""

    over: str
    x: list[float]
    y: list[float]
    relative: bool = False


class UnknownPlaceDocument(msgspec.Struct):
    """Regime of a torque that no effect explains, with its curve."""

    regime: str = ""
    response: ResponseDocument | None = None


class UnknownDocument(msgspec.Struct):
    """Torque that no effect explains."""

    joint: Name
    probability: Probability
    where: UnknownPlaceDocument = msgspec.field(default_factory=UnknownPlaceDocument)


class DiagnosisDocument(msgspec.Struct):
    """The explanations of a diagnosis, and the torque noise."""

    schema: str
    findings: list[FindingDocument]
    considered: list[FindingDocument] = []
    joints: dict[Name, JointNoiseDocument] = {}
    unknown: list[UnknownDocument] = []


def read_diagnosis(path: Path) -> DiagnosisDocument:
    """Read a `diagnosis.json`.

    Raises:
        UnusableInput: The file cannot be used.
    """
    file = diagnosis_file(path)
    content = file.json()
    file.schema(content, (SCHEMA,))
    return file.converted(content, DiagnosisDocument)


def diagnosis_file(path: Path) -> DocumentFile:
    """Return a `diagnosis.json`, which makes the messages about it."""
    return DocumentFile(
        path, "a diagnosis", "diagnose again", "the diagnosis.json of 'excite diagnose'"
    )
