"""The report of a diagnosis: is anything missing, what is it, where does it show, and how do we know."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..artefact import versions
from ..diagnose.diagnosis import Diagnosis
from .page import Section, escape, number, page, table


def diagnosis_page(found: Diagnosis, stated: Mapping[str, Any]) -> str:
    """The report of `excite diagnose` as HTML. stated: the document of the diagnosis, `diagnose.document.document`."""
    robot = found.identified.model.robot
    rows = [
        (
            escape(one["effect"]),
            escape(one["joint"] or "the whole robot"),
            number(one["probability"], 2),
            escape(", ".join(f"{k} {number(v['value'])} ± {number(v['std'], 2)} {v['unit']}" for k, v in one["parameters"].items())),
        )
        for one in stated["findings"]
    ]
    joints = [
        (escape(j), number(v["rmse_before"]), number(v["rmse_after"]), number(v["noise_floor"])) for j, v in stated["joints"].items()
    ]
    body = table(("effect", "joint", "probability", "parameters"), rows) if rows else ""
    body += table(("joint", "RMSE before", "RMSE after", "noise floor"), joints, (1, 2, 3))
    sections = [Section("missing", "Is anything missing?", f"The verdict: {stated['verdict']}.", body)]
    lede = "What the robot's model leaves out: where, what, how much, and how do we know."
    return page(f"Diagnosis of {robot.name}", lede, "", sections, f"excite {versions()['excite']}")
