"""What the health check of recordings had to say, as reports show it."""

from __future__ import annotations

from collections.abc import Sequence

from ..recordings import Remark
from .page import escape, number, plural, table


def said(remarks: Sequence[Remark]) -> str:
    """How much it had to say, as the end of a sentence."""
    return (
        f"the health check had {plural(len(remarks), 'remark')}"
        if remarks
        else "the health check had nothing to remark"
    )


def listed(remarks: Sequence[Remark]) -> str:
    """All of it as a table with its heading; nothing where there is none."""
    if not remarks:
        return ""
    rows = [
        (
            escape(r.kind.value),
            escape(r.joint or "all"),
            "–" if r.start is None or r.end is None else f"{number(r.start)} to {number(r.end)}",
            escape(r.text),
            "yes" if r.repaired else "no",
        )
        for r in remarks
    ]
    repaired = sum(r.repaired for r in remarks)
    head = f"<h3>Remarks on the recordings ({repaired} repaired by a stated rule)</h3>"
    return head + table(("about", "joint", "when [s]", "what", "repaired"), rows)
