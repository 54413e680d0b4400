"""The part of a `diagnosis.json` that the design of an experiment reads, schema
excite.diagnosis/1."""

from __future__ import annotations

from typing import Annotated

import msgspec

from .quantities import Name

SCHEMA = "excite.diagnosis/1"
Probability = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]


class FindingParameter(msgspec.Struct):
    """A parameter of a finding with its standard deviation, null where it is unknown."""

    value: float | None = None
    std: float | None = None
    unit: str = ""


class FindingDocument(msgspec.Struct):
    """An effect that is reported, or was considered."""

    effect: Name
    joint: Name | None
    probability: Probability
    equivalents: list[Name] = []
    parameters: dict[str, FindingParameter] = {}
    other: Name | None = msgspec.field(name="from", default=None)


class DiagnosisDocument(msgspec.Struct):
    """The explanations of a diagnosis."""

    schema: str
    findings: list[FindingDocument]
    considered: list[FindingDocument] = []
