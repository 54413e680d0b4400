"""What of the drives differs between recordings: the part of a diagnosis's report that only some have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..diagnosis.diagnosis import Diagnosis
from ..robot.parameter_names import percent, some
from .figures.drawing import BLUE, GREY, limit_ticks, render_panels
from .figures.trajectory import short
from .page import Section, escape, figure, number, paragraph, table

_WORDS = {"coulomb": "Coulomb friction", "viscous": "viscous friction", "offset": "torque offset"}
_HEIGHT = 2.0


def section(found: Diagnosis, stated: Mapping[str, Any]) -> Iterator[Section]:
    """One section, or none where all recordings are of the same drives."""
    told = stated["between_recordings"]
    if not told:
        return
    joints = list(dict.fromkeys(one["joint"] for one in told))
    answer = f"No: friction or torque offset of {some(joints)} is another in {some(_names(told))}."
    left = dict(
        zip(found.identified.model.robot.joints, (found.rmse_without_changes / found.floor).tolist(), strict=True)
    )
    rows = [
        (
            escape(one["joint"]),
            escape(Path(one["recording"]).name),
            *(_with(one[kind]) for kind in _WORDS),
            number(left[one["joint"]], 3),
        )
        for one in told
    ]
    note = "Against the first recording, ± one standard error between stretches of time. A colder robot rubs more, a sensor drifts. The "
    note += "search let each recording have its own, lest that look like another effect; the held-out errors do not: no model knows the day. "
    note += "Warm up alike, or record temp.<joint>: then friction by temperature is a law that can be found. Floors left: held-out error "
    note += "but for that, over the noise floor. Dots: ± two standard errors."
    body = (
        table(("joint", "recording", *_WORDS.values(), "floors left"), rows, (5,))
        + figure(_drawn(told))
        + paragraph(note, "note")
    )
    yield Section("changes", "Is the robot the same in all recordings?", answer, body, "warn")


def all_that_is(stated: Mapping[str, Any]) -> bool:
    """Whether such changes are all that a diagnosis has no name for."""
    unknown = stated["unknown"]
    return bool(unknown) and all(one["where"]["regime"] == "recording" for one in unknown)


def _names(told: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(Path(one["recording"]).name for one in told))


def _with(value: Mapping[str, Any]) -> str:
    share = value.get("relative")
    part = "" if share is None else f" ({'+' if share > 0.0 else '−'}{percent(abs(share))})"
    return escape(
        f"{number(value['value'], 3)} ± {number(value['std'], 2)} {value['unit']}{part}".replace(
            " ", "\u00a0"
        )
    )


def _drawn(told: Sequence[Mapping[str, Any]]) -> str:
    """A panel of each kind, a dot of each joint and recording."""

    def draw(axes: Any, kind: str) -> None:
        x = np.arange(len(told))
        values, std = (
            np.array([one[kind][key] for one in told], float) for key in ("value", "std")
        )
        axes.axhline(0.0, color=GREY, linewidth=0.5)
        axes.errorbar(
            x, values, 2.0 * std, fmt="o", color=BLUE, markersize=3.5, elinewidth=1.0, capsize=2.0
        )
        limit_ticks(axes, 5, 4)
        axes.set_xlim(-0.5, len(told) - 0.5)
        several = len(_names(told)) > 1
        names = [
            f"{short(one['joint'], 14)}, {short(Path(one['recording']).stem, 10)}"
            if several
            else short(one["joint"], 14)
            for one in told
        ]
        axes.set_xticks(x, names, rotation=30.0, ha="right")
        units = " or ".join(dict.fromkeys(one[kind]["unit"] for one in told))
        axes.set_title(f"change of {_WORDS[kind]} [{units}]", loc="left", fontweight="bold", pad=3)

    return render_panels(
        "What of the drives differs between recordings", list(_WORDS), draw, _HEIGHT
    )
