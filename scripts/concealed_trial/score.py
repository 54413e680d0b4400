"""Score the answers of an analyst against the ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from excite._types import BoolArray, FloatArray
from excite.simulator.effects import EFFECT_TYPES, FORM_FAMILIES

SEVERITY_BINS = ((0.0, 0.7), (0.7, 2.0), (2.0, 6.0), (6.0, 18.0), (18.0, np.inf))
"""Bins of severity [1], around the targets 1, 3, 10 and 30."""
EQUIVALENT_EFFECTS = ({"drag", "nonlinear_viscous"},)
"""Effects that the contract calls equivalent unless the motion tells them apart."""
INCOMPARABLE_PARAMETERS = {
    # the contract states the loss at the largest torque seen, the truth at a fixed torque
    *(("torque_saturation", family, "loss") for family in FORM_FAMILIES),
    # Coulomb friction changes half as much as viscous friction, and both with the motion's power
    ("thermal_drift", "scored", "change"),
}
"""Parameters (effect, family, name) whose true value in the contract's sense is not known."""
NO_FINDING, UNKNOWN, NO_ANSWER = "(nothing)", "(unknown)", "(no answer)"
"""First answers that name no effect."""
NORMAL_QUANTILE = 1.96
"""Quantile of the normal distribution for 95 % intervals."""


@dataclass(frozen=True)
class Mark:
    """Comparison of an answer with the ground truth of its case.

    Figures that do not apply are None.

    Attributes:
        category: Category of the case.
        nuisance: Its nuisance condition.
        trusted: Whether it has a trusted prior.
        truth: Names of the hidden effects.
        severity: The largest of their severities, each alone [1].
        answered: Whether the answer is a diagnosis.
        named: Findings as (effect, joint, probability, equivalents), the most probable first.
        unknown: Whether an unmodelled effect was reported.
        joint: Whether a rightly named effect is in the right joint.
        overlap: Intersection over union of the time intervals of a contact [1].
        errors: Parameters as (name, relative error, whether value ± 2 std covers the truth).
        gain: Explained share of the held-out torque, over that of the oracle [1].
        seconds: Time that the analyst took [s].
    """

    category: str
    nuisance: str
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
        """The first effect of the answer, or a constant for an answer without one."""
        if not self.answered:
            return NO_ANSWER
        return self.named[0][0] if self.named else UNKNOWN if self.unknown else NO_FINDING

    @property
    def has_no_finding(self) -> bool:
        """True where the answer reports neither an effect nor an unknown."""
        return self.answered and not self.named and not self.unknown


def are_equivalent(name: str, other: str) -> bool:
    """Return whether two effect names mean the same."""
    return name == other or any({name, other} <= group for group in EQUIVALENT_EFFECTS)


def compare_answer(case: Mapping[str, Any], entry: Mapping[str, Any]) -> Mark:
    """Compare an answer with the ground truth of its case.

    Args:
        case: Ground truth; see `generate_cases.ground_truth`.
        entry: `seconds` and `answer` of an analyst.
    """
    spec, answer = case["spec"], entry["answer"]
    answered = _is_diagnosis(answer)
    findings = answer["findings"] if answered else []
    named = tuple(
        (str(f["effect"]), f.get("joint"), float(f["probability"]), tuple(f.get("equivalents", ())))
        for f in findings
    )
    truth = tuple(effect["effect"] for effect in case["effects"])
    nameable = [effect for effect in case["effects"] if not effect["outsider"]]
    right = [
        (finding, effect)
        for finding in findings
        for effect in nameable
        if are_equivalent(str(finding["effect"]), effect["effect"])
    ]
    joint = (
        None
        if not right
        else any(finding.get("joint") == effect["joint"] for finding, effect in right)
    )
    return Mark(
        category=spec["category"],
        nuisance=spec["nuisance"],
        trusted=spec["trusted"],
        truth=truth,
        severity=max((float(effect["severity"]) for effect in case["effects"]), default=0.0),
        answered=answered,
        named=named,
        unknown=bool(answered and any(map(_is_physical, answer["unknown"]))),
        joint=joint,
        overlap=_interval_overlap(right),
        errors=tuple(
            error
            for finding, effect in right
            if finding.get("joint") == effect["joint"]
            for error in _parameter_errors(finding, with_contract_values(effect, case))
        ),
        gain=_held_out_gain(case, answer) if answered and nameable else None,
        seconds=float(entry["seconds"]),
    )


def _is_physical(unknown: Any) -> bool:
    """Return whether an unknown is unmodelled physics and not a change between sessions."""
    return (
        not isinstance(unknown, dict) or (unknown.get("where") or {}).get("regime") != "recording"
    )


def _is_diagnosis(answer: Any) -> bool:
    """Return whether an answer has findings with name and probability, unknowns and joints."""
    if not isinstance(answer, dict) or not all(
        isinstance(answer.get(key), list) for key in ("findings", "unknown")
    ):
        return False
    has_names = all(
        isinstance(f, dict) and isinstance(f.get("effect"), str) for f in answer["findings"]
    )
    return (
        has_names
        and all(isinstance(f.get("probability"), (int, float)) for f in answer["findings"])
        and isinstance(answer.get("joints"), dict)
    )


def _interval_overlap(
    right: Iterable[tuple[Mapping[str, Any], Mapping[str, Any]]],
) -> float | None:
    """Return the best intersection over union of true and reported contact intervals."""
    best = None
    for finding, effect in right:
        if effect["effect"] != "contact":
            continue
        a, b = (effect["details"][key]["value"] for key in ("start", "end"))
        reported = (finding.get("where") or {}).get("time")
        c, d = reported if reported else (0.0, 0.0)
        intersection = max(0.0, min(b, d) - max(a, c))
        best = max(best or 0.0, intersection / (max(b, d) - min(a, c)))
    return best


def with_contract_values(effect: Mapping[str, Any], case: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a hidden effect with its parameters as the contract defines them.

    The ground truth states the parameters of the model form; `EffectType.conversions` converts
    them. Asymmetric viscous friction includes that of the base model, the truth states the
    difference. `INCOMPARABLE_PARAMETERS` are left out.

    Args:
        effect: Entry of `effects` in the ground truth.
        case: The ground truth.
    """
    name, family = effect["effect"], effect.get("family", "")
    base_viscous = (
        float(case["truth"]["drive"]["viscous"][effect["joint"]])
        if name == "asymmetric_viscous"
        else 0.0
    )
    form_values = {
        key: float(parameter["value"]) + base_viscous
        for key, parameter in {**effect["parameters"], **effect["details"]}.items()
    }
    conversion = EFFECT_TYPES[name].conversions.get(family)
    values = form_values if conversion is None else {**form_values, **conversion(form_values)}
    comparable = {
        key: parameter
        for key, parameter in effect["parameters"].items()
        if (name, family, key) not in INCOMPARABLE_PARAMETERS
    }
    return {
        **effect,
        "parameters": {
            key: {**parameter, "value": values[key]} for key, parameter in comparable.items()
        },
    }


def _parameter_errors(
    finding: Mapping[str, Any], effect: Mapping[str, Any]
) -> list[tuple[str, float, bool | None]]:
    """Return relative error and coverage (value ± 2 std) of each parameter that both state.

    Equivalent effects of different names have parameters of different units: no errors.
    """
    if finding["effect"] != effect["effect"]:
        return []
    errors: list[tuple[str, float, bool | None]] = []
    for name, true in effect["parameters"].items():
        reported = finding.get("parameters", {}).get(name)
        if reported is None or reported.get("value") is None or not true["value"]:
            continue
        error = abs(float(reported["value"]) - float(true["value"]))
        std = reported.get("std")
        errors.append(
            (
                f"{effect['effect']}.{name}",
                error / abs(float(true["value"])),
                None if std is None else error <= 2.0 * float(std),
            )
        )
    return errors


def _held_out_gain(case: Mapping[str, Any], answer: Mapping[str, Any]) -> float | None:
    """Return the decrease of the held-out mean square, over the decrease by the oracle.

    It sums over joints in units of noise: 1 is the oracle, 0 the base model. None where the oracle
    gains almost nothing.
    """
    held_out = case["held_out"]
    noise, before, oracle = (np.array(held_out[key]) for key in ("noise", "before", "oracle"))
    reported = [answer["joints"].get(name, {}).get("rmse_after") for name in case["joints"]]
    if any(value is None for value in reported):
        return None
    after = np.array(reported, float)
    possible = float((np.square(before) - np.square(oracle)) @ (1.0 / np.square(noise)))
    if possible < 0.2 * len(noise):
        return None
    return float((np.square(before) - np.square(after)) @ (1.0 / np.square(noise))) / possible


def score(marks: Sequence[Mark]) -> dict[str, Any]:
    """Return all figures of an analyst, each with `value` (null without cases) and `count`."""
    nulls = [m for m in marks if m.category == "null"]
    hidden = [m for m in marks if m.category != "null"]
    nameable = [m for m in hidden if m.category in ("single", "pair")]
    singles, pairs = (
        [m for m in hidden if m.category == category] for category in ("single", "pair")
    )
    unnamed = [m for m in hidden if m.category == "out_of_catalogue"]
    within = [m for m in nameable if _is_within_equivalents(m)]
    covered = [inside for m in nameable for _, _, inside in m.errors if inside is not None]
    errors = [error for m in nameable for _, error, _ in m.errors]
    gains = [m.gain for m in nameable if m.gain is not None]
    return {
        "cases": len(marks),
        "false_alarms": _rate(not m.has_no_finding for m in nulls),
        "false_alarms_by_nuisance": {
            nuisance: _rate(not m.has_no_finding for m in nulls if m.nuisance == nuisance)
            for nuisance in sorted({m.nuisance for m in nulls})
        },
        "abstained": _rate(m.has_no_finding or not m.answered for m in hidden),
        "right_first": _rate(_is_right(m) for m in nameable),
        "right_first_from_3": _rate(
            _is_right(m) for m in nameable if m.severity >= SEVERITY_BINS[2][0]
        ),
        "right_first_by_severity": {
            _bin_name(b): _rate(_is_right(m) for m in nameable if b[0] <= m.severity < b[1])
            for b in SEVERITY_BINS
        },
        "within_equivalents": _rate(_is_within_equivalents(m) for m in nameable),
        "equivalents": {
            "value": float(np.mean([len(m.named[0][3]) for m in within])) if within else None,
            "count": len(within),
        },
        "right_joint": _rate(bool(m.joint) for m in nameable if m.joint is not None),
        "contact_overlap": _mean([m.overlap for m in nameable if m.overlap is not None]),
        "parameter_error": {
            "value": float(np.median(errors)) if errors else None,
            "count": len(errors),
        },
        "interval_coverage": _rate(covered),
        "both_of_two": _rate(
            all(any(are_equivalent(n[0], t) for n in m.named) for t in m.truth) for m in pairs
        ),
        "unknown_where_it_is": _rate(m.unknown for m in unnamed),
        "right_first_single": _rate(_is_right(m) for m in singles),
        "right_first_trusted": _rate(_is_right(m) for m in singles if m.trusted),
        "held_out_gain": {"value": float(np.median(gains)) if gains else None, "count": len(gains)},
        "calibration": calibration(marks),
        "seconds": float(np.median([m.seconds for m in marks])) if marks else None,
    }


def _bin_name(bounds: tuple[float, float]) -> str:
    """Return the bounds of a bin as text."""
    return f"{bounds[0]:g}-{bounds[1]:g}" if np.isfinite(bounds[1]) else f"{bounds[0]:g}+"


def _rate(flags: Iterable[object]) -> dict[str, Any]:
    """Return a rate with its 95 % interval (Wilson 1927)."""
    values = [bool(flag) for flag in flags]
    if not values:
        return {"value": None, "count": 0}
    n, p, z = len(values), float(np.mean(values)), NORMAL_QUANTILE
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
    """Return the mean of values."""
    return {"value": float(np.mean(values)) if values else None, "count": len(values)}


def _is_right(m: Mark) -> bool:
    """Return whether the first finding is right."""
    return bool(m.named) and any(are_equivalent(m.named[0][0], t) for t in m.truth)


def _is_within_equivalents(m: Mark) -> bool:
    """Return whether the first finding or one of its equivalents is right."""
    return bool(m.named) and any(
        are_equivalent(name, t) for name in (m.named[0][0], *m.named[0][3]) for t in m.truth
    )


def reported_probabilities(marks: Iterable[Mark]) -> tuple[FloatArray, BoolArray]:
    """Return the probability of every finding, and whether it or an equivalent is true.

    The joint does not count.
    """
    pairs = [
        (p, any(are_equivalent(n, t) for n in (name, *equivalents) for t in m.truth))
        for m in marks
        for name, _, p, equivalents in m.named
    ]
    return np.array([p for p, _ in pairs], float), np.array([r for _, r in pairs], bool)


def calibration(marks: Iterable[Mark], bins: int = 5) -> dict[str, Any]:
    """Return the reliability between 0.5 and 1, and the expected calibration error."""
    probability, is_right = reported_probabilities(marks)
    edges, rows = np.linspace(0.5, 1.0, bins + 1), []
    for low, high in pairwise(edges):
        in_bin = (probability >= low) & ((probability < high) | (high == 1.0))
        if in_bin.any():
            rows.append(
                {
                    "reported": float(probability[in_bin].mean()),
                    "observed": float(is_right[in_bin].mean()),
                    "count": int(in_bin.sum()),
                }
            )
    total = sum(row["count"] for row in rows)
    return {
        "bins": rows,
        "error": sum(row["count"] * abs(row["reported"] - row["observed"]) for row in rows) / total
        if total
        else None,
    }


def confusion(marks: Iterable[Mark]) -> dict[str, dict[str, int]]:
    """Count the first answers per hidden effect, for cases with at most one effect."""
    counts: dict[str, dict[str, int]] = {}
    for m in marks:
        if m.category == "pair":
            continue
        row = counts.setdefault(m.truth[0] if m.truth else NO_FINDING, {})
        row[m.first] = row.get(m.first, 0) + 1
    return counts
