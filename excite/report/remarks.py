"""Remarks of the data-quality checks on recordings, as reports show them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..recordings import Remark
from ..robot.parameter_names import plural
from .content import Table
from .formatting import seconds_between


def count_remarks(remarks: Sequence[Remark]) -> str:
    """Number of remarks, as the end of a sentence."""
    if not remarks:
        return "the data-quality checks have no remark"
    return f"the data-quality checks have {plural(len(remarks), 'remark')}"


def list_remarks(remarks: Sequence[Remark]) -> dict[str, Any]:
    """List all remarks in a table; empty where there is none."""
    if not remarks:
        return {}
    rows = [
        (
            remark.kind.value,
            remark.joint or "all",
            "–"
            if remark.start is None or remark.end is None
            else seconds_between(remark.start, remark.end),
            remark.text,
            "yes" if remark.repaired else "no",
        )
        for remark in remarks
    ]
    return {
        "repaired": sum(remark.repaired for remark in remarks),
        "table": Table(("about", "joint", "time [s]", "remark", "repaired"), rows),
    }
