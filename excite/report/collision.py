"""Does the motion touch anything? Least distances, where and when, and what was not held to them."""

from __future__ import annotations

from collections.abc import Sequence

from ..collision.continuous_check import Near
from ..collision.workcell import Cell
from ..trajectory.trajectory_file import Trajectory
from .figures.collision import closest, distances
from .page import Section, escape, figure, folded, paragraph, plural, table

LISTED = 8


def collision_section(trajectory: Trajectory, cell: Cell | None, near: Sequence[Near]) -> Section:
    """What was checked; without a cell, that nothing was."""
    text = trajectory.collision
    answer = f"{text[:1].upper()}{text[1:]}."
    if cell is None:
        advice = "Give the links shapes in the URDF's <collision> elements, and the surroundings with --scene; watch the first run."
        return Section(
            "collision", "Does it touch anything?", answer, paragraph(advice, "note"), "bad"
        )
    body = "".join(
        [
            figure(distances(cell, near, trajectory.motion)) + figure(closest(cell, near[0])) if near else "",
            _distances("least", near[:LISTED]),
            folded(f"{len(near) - LISTED} more pairs", _distances("at least", near[LISTED:])) if len(near) > LISTED else "",
            folded(f"{plural(len(cell.excepted), 'pair')} not held to {1e3 * cell.margin:g} mm",
                   table(("body", "body", "why"), [tuple(map(escape, (e.first, e.second, e.why))) for e in cell.excepted], ()))
            if cell.excepted else "",
            *(paragraph(note, "note") for note in cell.notes),
            paragraph("Red: the pair that is nearest to what it has to keep, at that moment. The least distance is proven for the moments "
                      "between those looked at, too; of bodies far apart it is a lower bound.", "note"),
        ]
    )  # fmt: skip
    bad = any(one.proven < one.pair.margin for one in near)
    return Section("collision", "Does it touch anything?", answer, body, "bad" if bad else "")


def _distances(least: str, near: Sequence[Near]) -> str:
    rows = [
        (
            escape(one.names),
            f"{1e3 * one.proven:.1f}",
            f"{1e3 * one.pair.margin:.1f}",
            f"{one.time:.2f}",
        )
        for one in near
    ]
    return table(("bodies", f"{least} [mm]", "to keep [mm]", "at [s]"), rows, (1, 2, 3))
