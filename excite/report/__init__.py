"""Reports for people: each section asks a question, answers it, and shows the evidence."""

from __future__ import annotations

from .design import design_page
from .diagnosis import diagnosis_page
from .identifiability import identifiability_page
from .identification import identification_page

__all__ = [
    "design_page",
    "diagnosis_page",
    "identifiability_page",
    "identification_page",
]
