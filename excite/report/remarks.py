"""Remarks of the data-quality checks on recordings, as reports show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..recordings import Remark
from ..robot.parameter_names import plural
from .content import Table
from .formatting import seconds_between

RemarksByRecording = Mapping[str, Sequence[Remark]]
"""Remarks by the name of their recording."""


def count_remarks(remarks: RemarksByRecording) -> str:
    """Number of remarks, as the end of a sentence."""
    count = sum(map(len, remarks.values()))
    if not count:
        return "the data-quality checks have no remark"
    return f"the data-quality checks have {plural(count, 'remark')}"


def list_remarks(remarks: RemarksByRecording) -> dict[str, Any]:
    """List all remarks in a table; empty where there is none.

    A remark that is the same for several joints or recordings is one row.
    """
    alike: dict[tuple[str, ...], list[tuple[str, Remark]]] = {}
    for recording, of_recording in remarks.items():
        for remark in of_recording:
            text = remark.text.removeprefix(f"joint '{remark.joint}': ")
            row = remark.kind.value, _time(remark), text, _yes(remark.repaired)
            alike.setdefault(row, []).append((recording, remark))
    rows = []
    for (kind, time, text, repaired), group in alike.items():
        names = dict.fromkeys(recording for recording, _ in group)
        joints = dict.fromkeys(remark.joint or "all" for _, remark in group)
        rows.append((kind, ", ".join(names), ", ".join(joints), time, text, repaired))
    if not rows:
        return {}
    return {
        "repaired": sum(remark.repaired for group in remarks.values() for remark in group),
        "table": Table(("about", "recording", "joint", "time [s]", "remark", "repaired"), rows),
    }


def _time(remark: Remark) -> str:
    """Return the time at which it occurs [s]; a dash if that is all of the recording."""
    if remark.start is None or remark.end is None:
        return "–"
    return seconds_between(remark.start, remark.end)


def _yes(value: bool) -> str:
    return "yes" if value else "no"
