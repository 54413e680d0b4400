"""What the answers were worth, once the key is open."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from excite.simulator.effects import FAMILIES, KINDS

Array = np.ndarray
BINS = ((0.0, 0.7), (0.7, 2.0), (2.0, 6.0), (6.0, 18.0), (18.0, np.inf))
SAME = ({"drag", "nonlinear_viscous"},)
"""Names that the contract calls equivalent unless the motion tells them apart."""
APART = {
    # the loss at a fixed torque, not at the largest seen, which the key does not tell
    *(("torque_saturation", family, "loss") for family in FAMILIES),
    # Coulomb friction changes half as much as viscous friction, and either as much as the motion heats the joint
    ("thermal_drift", "scored", "change"),
}
"""Parameters (effect, family, name) that the key states otherwise than the contract, without what would turn one into the other."""
NOTHING, UNKNOWN, NO_ANSWER = "(nothing)", "(unknown)", "(no answer)"


@dataclass(frozen=True)
class Mark:
    """One answer beside its truth. truth: names hidden; severity: the largest of theirs, alone.

    named: (name, joint, probability, equivalents) as found, most certain first. Figures that do not apply are None.
    """

    sort: str
    trap: str
    trusted: bool
    truth: tuple[str, ...]
    severity: float
    answered: bool
    named: tuple[tuple[str, str | None, float, tuple[str, ...]], ...]
    unknown: bool
    joint: bool | None
    overlap: float | None
    errors: tuple[tuple[str, float, bool | None], ...]
    gain: float | None
    seconds: float

    @property
    def first(self) -> str:
        """The answer in one word."""
        if not self.answered:
            return NO_ANSWER
        return self.named[0][0] if self.named else UNKNOWN if self.unknown else NOTHING

    @property
    def silent(self) -> bool:
        return self.answered and not self.named and not self.unknown


def equal(name: str, other: str) -> bool:
    """Whether two names mean the same thing."""
    return name == other or any({name, other} <= group for group in SAME)


def mark(case: Mapping[str, Any], entry: Mapping[str, Any]) -> Mark:
    """Compare an answer with a case's key."""
    spec, answer = case["spec"], entry["answer"]
    answered = _readable(answer)
    findings = answer["findings"] if answered else []
    named = tuple(
        (str(f["effect"]), f.get("joint"), float(f["probability"]), tuple(f.get("equivalents", ())))
        for f in findings
    )
    truth = tuple(e["effect"] for e in case["effects"])
    known = [e for e in case["effects"] if not e["outsider"]]
    right = [(f, e) for f in findings for e in known if equal(str(f["effect"]), e["effect"])]
    joint = None if not right else any(f.get("joint") == e["joint"] for f, e in right)
    return Mark(
        sort=spec["sort"],
        trap=spec["trap"],
        trusted=spec["trusted"],
        truth=truth,
        severity=max((float(e["severity"]) for e in case["effects"]), default=0.0),
        answered=answered,
        named=named,
        unknown=bool(answered and any(map(_physics, answer["unknown"]))),
        joint=joint,
        overlap=_overlap(right),
        errors=tuple(
            error
            for f, e in right
            if f.get("joint") == e["joint"]
            for error in _errors(f, whole(e, case))
        ),
        gain=_gain(case, answer) if answered and known else None,
        seconds=float(entry["seconds"]),
    )


def _physics(unknown: Any) -> bool:
    """Whether an unknown is one: that friction is another on another day is no physics that a model lacks."""
    return (
        not isinstance(unknown, dict) or (unknown.get("where") or {}).get("regime") != "recording"
    )


def _readable(answer: Any) -> bool:
    """Whether an answer is one: findings with a name and a probability each, unknowns, joints."""
    if not isinstance(answer, dict) or not all(
        isinstance(answer.get(key), list) for key in ("findings", "unknown")
    ):
        return False
    whole = all(
        isinstance(f, dict) and isinstance(f.get("effect"), str) for f in answer["findings"]
    )
    return (
        whole
        and all(isinstance(f.get("probability"), (int, float)) for f in answer["findings"])
        and isinstance(answer.get("joints"), dict)
    )


def _overlap(right: Iterable[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> float | None:
    """Intersection over union of the true and the stated interval of a contact, the best of those stated."""
    best = None
    for finding, effect in right:
        if effect["effect"] != "contact":
            continue
        a, b = (effect["details"][key]["value"] for key in ("start", "end"))
        stated = (finding.get("where") or {}).get("time")
        c, d = stated if stated else (0.0, 0.0)
        both = max(0.0, min(b, d) - max(a, c))
        best = max(best or 0.0, both / (max(b, d) - min(a, c)))
    return best


def whole(effect: Mapping[str, Any], case: Mapping[str, Any]) -> Mapping[str, Any]:
    """An effect with its parameters as the contract means them, where the key has those of its law; those `APART` are left out.

    Viscous friction that differs by direction is all of it, the key states what was added.
    """
    name, family = effect["effect"], effect.get("family", "")
    own = (
        float(case["truth"]["drive"]["viscous"][effect["joint"]])
        if name == "asymmetric_viscous"
        else 0.0
    )
    law = {
        key: float(one["value"]) + own
        for key, one in {**effect["parameters"], **effect["details"]}.items()
    }
    meaning = KINDS[name].meant.get(family)
    values = law if meaning is None else {**law, **meaning(law)}
    kept = {
        key: true for key, true in effect["parameters"].items() if (name, family, key) not in APART
    }
    return {
        **effect,
        "parameters": {key: {**true, "value": values[key]} for key, true in kept.items()},
    }


def _errors(
    finding: Mapping[str, Any], effect: Mapping[str, Any]
) -> list[tuple[str, float, bool | None]]:
    """Relative error of each parameter that both name, and whether value ± 2 std covers the truth.

    Nothing where the finding has the other of two equal names: a drag's coefficient and a power law's have different units.
    """
    if finding["effect"] != effect["effect"]:
        return []
    out = []
    for name, true in effect["parameters"].items():
        said = finding.get("parameters", {}).get(name)
        if said is None or said.get("value") is None or not true["value"]:
            continue
        away = abs(float(said["value"]) - float(true["value"]))
        std = said.get("std")
        out.append(
            (
                f"{effect['effect']}.{name}",
                away / abs(float(true["value"])),
                None if std is None else away <= 2.0 * float(std),
            )
        )
    return out


def _gain(case: Mapping[str, Any], answer: Mapping[str, Any]) -> float | None:
    """Held-out mean square that the answer takes off the base model's, over what an oracle takes off; over joints, in noise units.

    1 is the oracle's, 0 the base model's. None where there is nothing to gain.
    """
    held = case["held_out"]
    noise, before, oracle = (np.array(held[key]) for key in ("noise", "before", "oracle"))
    stated = [answer["joints"].get(name, {}).get("rmse_after") for name in case["joints"]]
    if any(value is None for value in stated):
        return None
    after = np.array(stated, float)
    room = float((np.square(before) - np.square(oracle)) @ (1.0 / np.square(noise)))
    if room < 0.2 * len(noise):
        return None
    return float((np.square(before) - np.square(after)) @ (1.0 / np.square(noise))) / room


def score(marks: Sequence[Mark]) -> dict[str, Any]:
    """All figures of one analyst. A share is {"value", "count"}; "of" an empty set is null."""
    nulls = [m for m in marks if m.sort == "null"]
    hidden = [m for m in marks if m.sort != "null"]
    named = [m for m in hidden if m.sort in ("single", "pair")]
    singles, pairs = ([m for m in hidden if m.sort == sort] for sort in ("single", "pair"))
    outsiders = [m for m in hidden if m.sort == "outsider"]
    within = [m for m in named if _within(m)]
    covered = [inside for m in named for _, _, inside in m.errors if inside is not None]
    errors = [error for m in named for _, error, _ in m.errors]
    gains = [m.gain for m in named if m.gain is not None]
    return {
        "cases": len(marks),
        "false_alarms": _share(not m.silent for m in nulls),
        "false_alarms_by_trap": {
            trap: _share(not m.silent for m in nulls if m.trap == trap)
            for trap in sorted({m.trap for m in nulls})
        },
        "abstained": _share(m.silent or not m.answered for m in hidden),
        "right_first": _share(_right(m) for m in named),
        "right_first_from_3": _share(_right(m) for m in named if m.severity >= BINS[2][0]),
        "right_first_by_severity": {
            _words(b): _share(_right(m) for m in named if b[0] <= m.severity < b[1]) for b in BINS
        },
        "within_equivalents": _share(_within(m) for m in named),
        "equivalents": {
            "value": float(np.mean([len(m.named[0][3]) for m in within])) if within else None,
            "count": len(within),
        },
        "right_joint": _share(bool(m.joint) for m in named if m.joint is not None),
        "contact_overlap": _mean([m.overlap for m in named if m.overlap is not None]),
        "parameter_error": {
            "value": float(np.median(errors)) if errors else None,
            "count": len(errors),
        },
        "interval_coverage": _share(covered),
        "both_of_two": _share(
            all(any(equal(n[0], t) for n in m.named) for t in m.truth) for m in pairs
        ),
        "unknown_where_it_is": _share(m.unknown for m in outsiders),
        "right_first_single": _share(_right(m) for m in singles),
        "right_first_trusted": _share(_right(m) for m in singles if m.trusted),
        "held_out_gain": {"value": float(np.median(gains)) if gains else None, "count": len(gains)},
        "calibration": calibration(marks),
        "seconds": float(np.median([m.seconds for m in marks])) if marks else None,
    }


def _words(bounds: tuple[float, float]) -> str:
    return f"{bounds[0]:g}-{bounds[1]:g}" if np.isfinite(bounds[1]) else f"{bounds[0]:g}+"


def _share(flags: Iterable[object]) -> dict[str, Any]:
    """With the 95 % interval of a binomial rate (Wilson 1927)."""
    values = [bool(flag) for flag in flags]
    if not values:
        return {"value": None, "count": 0}
    n, p, z = len(values), float(np.mean(values)), 1.96
    middle, half = (
        (p + z * z / (2 * n)) / (1 + z * z / n),
        z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + (z / (2 * n)) ** 2),
    )
    return {
        "value": p,
        "count": n,
        "interval": [max(float(middle - half), 0.0), min(float(middle + half), 1.0)],
    }


def _mean(values: Sequence[float]) -> dict[str, Any]:
    return {"value": float(np.mean(values)) if values else None, "count": len(values)}


def _right(m: Mark) -> bool:
    return bool(m.named) and any(equal(m.named[0][0], t) for t in m.truth)


def _within(m: Mark) -> bool:
    return bool(m.named) and any(
        equal(name, t) for name in (m.named[0][0], *m.named[0][3]) for t in m.truth
    )


def stated(marks: Iterable[Mark]) -> tuple[Array, Array]:
    """Probability of every finding, and whether the truth is its effect or one of its equivalents, in its joint or not."""
    pairs = [
        (p, any(equal(n, t) for n in (name, *more) for t in m.truth))
        for m in marks
        for name, _, p, more in m.named
    ]
    return np.array([p for p, _ in pairs], float), np.array([r for _, r in pairs], bool)


def calibration(marks: Iterable[Mark], bins: int = 5) -> dict[str, Any]:
    """Reliability from 0.5 to 1, and the expected calibration error."""
    probability, right = stated(marks)
    edges, rows = np.linspace(0.5, 1.0, bins + 1), []
    for low, high in pairwise(edges):
        here = (probability >= low) & ((probability < high) | (high == 1.0))
        if here.any():
            rows.append(
                {
                    "said": float(probability[here].mean()),
                    "was": float(right[here].mean()),
                    "count": int(here.sum()),
                }
            )
    total = sum(row["count"] for row in rows)
    return {
        "bins": rows,
        "error": sum(row["count"] * abs(row["said"] - row["was"]) for row in rows) / total
        if total
        else None,
    }


def confusion(marks: Iterable[Mark]) -> dict[str, dict[str, int]]:
    """How often a single truth (or nothing, or an outsider) was answered by which first name."""
    out: dict[str, dict[str, int]] = {}
    for m in marks:
        if m.sort == "pair":
            continue
        row = out.setdefault(m.truth[0] if m.truth else NOTHING, {})
        row[m.first] = row.get(m.first, 0) + 1
    return out
