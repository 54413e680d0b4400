"""Report of `excite payload`: mass, centre of mass and inertia of what is attached to a link."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..trajectory.trajectory_file import package_versions
from .content import Banner, ReportContent, Section, Table, TableCell
from .formatting import number, value_with_error
from .render import render

NAMES = {
    "mass": "mass",
    "centre_x": "centre of mass, x",
    "centre_y": "centre of mass, y",
    "centre_z": "centre of mass, z",
}
"""Quantities in words; moments are about the centre of mass."""


def payload_page(document: Mapping[str, Any]) -> str:
    """Render the report of a payload as HTML.

    Args:
        document: Content of `payload.json`.
    """
    mass = document["payload"]["mass"]
    link = document["link"]
    if mass["shown"]:
        half = mass["interval"][1] - mass["value"]
        verdict = f"{number(mass['value'])} ± {number(half, 2)} kg (95 %) at {link}."
    else:
        verdict = f"The recordings do not show the payload at {link}."
    hidden = document["not_shown"]
    content = ReportContent(
        title=f"Payload of {document['robot']['name']}",
        subtitle=f"The body attached to {link}, in the frame of that link.",
        banners=[
            *_doubts(document),
            Banner(verdict, "good" if mass["shown"] else "warn"),
            *_mounting(document),
            *(Banner(words, "warn") for words in stated_mass_words(document)),
        ],
        cards=[
            (f"{number(mass['value'])} kg", "mass"),
            (f"{10 - len(hidden)} of 10", "quantities decided by the recordings"),
        ],
        sections=[
            _values_section(document),
            _friction_section(document),
            Section(
                "snippets",
                "How do I tell my controller?",
                "Values of the estimate, in the frame of the link above; none of these texts has "
                "been tried on hardware.",
                {"snippets": list(document["snippets"].items())},
            ),
        ],
        footer=f"excite {package_versions()['excite']}",
    )
    return render("summary", content)


def _doubts(document: Mapping[str, Any]) -> list[Banner]:
    """Unrepaired doubts about the recordings, with which the payload says little."""
    doubts = [f"{Path(d['recording']).name}: {d['text']}" for d in document.get("doubts", [])]
    if not doubts:
        return []
    text = "Do not use this payload: the recordings are doubted."
    return [Banner(text, "bad"), *(Banner(doubt, "warn") for doubt in doubts)]


def stated_mass_words(document: Mapping[str, Any]) -> list[str]:
    """Return a sentence where the torque alone shows another mass than the stated one, or none."""
    other, stated = document["mass_by_torque"], document["stated_mass"]
    if other is None:
        return []
    percentage = 100.0 * abs(other["value"] / stated - 1.0)
    size = "large" if other["value"] > stated else "small"
    return [
        f"The torque alone shows {value_with_error(**other, unit='kg')} and not the stated "
        f"{number(stated)} kg: torque is {number(percentage, 2)} % too {size}, as by a wrong "
        "drive_gain, or the recordings differ by more than the payload. Then centre and moments "
        "of inertia are wrong as well."
    ]


def _mounting(document: Mapping[str, Any]) -> list[Banner]:
    """A warning where the payload was mounted differently between recordings."""
    mounting = document["mounting"]
    if mounting is None or mounting["verdict"] == "same":
        return []
    return [
        Banner(
            "The payload differs between the recordings with it (probability by chance "
            f"{number(mounting['p_value'], 2)}): it was mounted differently or slipped.",
            "bad",
        )
    ]


def _values_section(document: Mapping[str, Any]) -> Section:
    """The ten quantities."""
    rows = []
    for name, entry in document["payload"].items():
        low, high = entry["interval"]
        rows.append(
            (
                NAMES.get(name, f"{name} about the centre"),
                number(entry["value"]),
                number(entry["std"], 2),
                f"{number(low)} to {number(high)}",
                entry["unit"],
                TableCell("shown", tone="good")
                if entry["shown"]
                else TableCell("not shown", tone="warn"),
            )
        )
    prior = document["shape"] or "a light ball of the estimated mass, as none was stated"
    return Section(
        "values",
        "What is attached?",
        f"Prior of the moments of inertia: {prior}. What the recordings do not decide is not "
        "shown; its value is the prior's.",
        {
            "tables": [
                Table(("quantity", "value", "std", "95 % interval", "unit", ""), rows, (1, 2, 3))
            ]
        },
    )


def _friction_section(document: Mapping[str, Any]) -> Section:
    """Load friction and the remaining torque of each joint."""
    friction = document["load_friction"] or {}
    rows = [
        (joint, number(friction.get(joint), 3), number(residual, 3))
        for joint, residual in document["residual"].items()
    ]
    names = [
        f"{key}: {', '.join(Path(str(name)).name for name in document[key])}"
        for key in ("with", "without")
    ]
    return Section(
        "friction",
        "How much of the torque is friction that grows with the load?",
        "It is fitted jointly: left out, it would be taken for mass. Friction and offsets may "
        "differ between the recordings with and without the payload.",
        {
            "tables": [
                Table(("joint", "load friction [1]", "remaining torque [N m]"), rows, (1, 2))
            ],
            "notes": names,
        },
    )
