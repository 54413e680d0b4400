"""`report.html`: what people look at. Each section's heading is a question, then its answer, then the plot that shows it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .design import design_page
from .diagnosis import diagnosis_page
from .identifiability import identifiability_page
from .identification import identification_page
from .record import DesignRecord

__all__ = [
    "DesignRecord",
    "design_page",
    "design_report",
    "diagnosis_page",
    "identifiability_page",
    "identifiability_report",
    "identification_page",
]


def design_report(path: Path, *subject: Any, **options: Any) -> None:
    """Write what `design_page` returns. Raises OSError when the file cannot be written."""
    path.write_text(design_page(*subject, **options), encoding="utf-8")


def identifiability_report(path: Path, *subject: Any, **options: Any) -> None:
    """Write what `identifiability_page` returns. Raises OSError when the file cannot be written."""
    path.write_text(identifiability_page(*subject, **options), encoding="utf-8")
