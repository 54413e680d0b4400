"""Score the answers of an analyst against the ground truth, by attribution.

A finding is right if it, or one of its equivalents, is hidden in its joint. Every rate has its 95 %
interval (Wilson 1927).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from excite._types import BoolArray, FloatArray
from excite.simulator.effects import EFFECT_TYPES, FORM_FAMILIES

GROUP_OF_CATEGORY = {"single": "sparse", "pair": "sparse"}
"""Group of a category, where they differ in name."""
EQUIVALENT_EFFECTS = ({"drag", "nonlinear_viscous"},)
"""Effects that the contract calls equivalent unless the motion tells them apart."""
BLIND = "blind"
"""Name of the analyst that looks at nothing."""
BLIND_EFFECTS = ("stribeck", "nonlinear_viscous", "hysteresis", "load_friction", "delay")
"""Effects that the blind analyst asserts at every joint."""
BLIND_PROBABILITY = 0.5
"""Probability that the blind analyst states for each."""
SEVERITY_LEVELS = (1.0, 3.0)
"""Unique severities from which an effect counts in the recall [1]."""
SPARSE_BINS = {"near 1": (0.7, 2.0), "from 3": (2.0, np.inf)}
"""Bins of the largest severity of a sparse case [1]: targets 1, and 3, 10 and 30."""
MIN_RATIO_GAIN = 0.2
"""Mean square per joint that the oracle gains, over that of the noise, from which a case has a
held-out gain [1]."""
RELIABILITY_BINS = np.linspace(0.0, 1.0, 11)
"""Edges of the bins of probability [1]."""
MIN_BIN_COUNT = 30
"""Findings from which a bin counts in the reliability."""
PROBABILITY_LIMIT = 1e-3
"""Distance from 0 and 1 to which probabilities are clipped in the log loss [1]."""
NORMAL_QUANTILE = 1.96
"""Quantile of the normal distribution for 95 % intervals."""
INCOMPARABLE_PARAMETERS = {
    # the contract states the loss at the largest torque seen, the truth at a fixed torque
    *(("torque_saturation", family, "loss") for family in FORM_FAMILIES),
    # Coulomb friction changes half as much as viscous friction, and both with the motion's power
    ("thermal_drift", "scored", "change"),
}
"""Parameters (effect, family, name) whose true value in the contract's sense is not known."""


@dataclass(frozen=True)
class Mark:
    """Comparison of an answer with the ground truth of its case.

    Figures that do not apply are None.

    Attributes:
        group: Group of the case; see `case_plan.GROUPS`.
        severity: The largest severity of its effects [1].
        answered: Whether the answer is a diagnosis.
        rights: For every finding, the most probable first, whether it is right.
        exact: Whether the first finding names an effect without its equivalents.
        equivalents: Number of equivalents of every finding.
        recalled: For every effect of the catalogue, unique severity and whether it is named.
        special: Whether the special effect of a dense robot is named.
        unknown: Whether an unmodelled effect was reported.
        probabilities: Of everything asserted or considered, probability and whether it is right.
        coverage: Of right findings, whether the interval of the severity covers the true one.
        errors: Of right findings, parameters as (name, relative error, whether value ± 2 std
            covers the truth).
        gain: Decrease of the held-out mean square, over that of the oracle [1].
        ratio: Held-out RMSE over the oracle's, geometric mean over the joints [1].
        model_ratio: Held-out RMSE of the re-read model over the claimed one, of the joint with the
            largest [1].
        seconds: Processor time that the analyst took [s].
    """

    group: str
    severity: float
    answered: bool
    rights: tuple[bool, ...]
    exact: bool
    equivalents: tuple[int, ...]
    recalled: tuple[tuple[float, bool], ...]
    special: bool | None
    unknown: bool
    probabilities: tuple[tuple[float, bool], ...]
    coverage: tuple[bool, ...]
    errors: tuple[tuple[str, float, bool | None], ...]
    gain: float | None
    ratio: float | None
    model_ratio: float | None
    seconds: float


def are_equivalent(name: str, other: str) -> bool:
    """Return whether two effect names mean the same."""
    return name == other or any({name, other} <= group for group in EQUIVALENT_EFFECTS)


def names_effect(
    finding: Mapping[str, Any], effect: Mapping[str, Any], *, exactly: bool = False
) -> bool:
    """Return whether a finding, or one of its equivalents, names a hidden effect in its joint.

    A delay of the clock is a delay of every joint.

    Args:
        finding: Entry of `findings`.
        effect: Entry of `effects` in the ground truth.
        exactly: Do not look at the equivalents.
    """
    if effect["outsider"] or effect["joint"] not in (None, finding.get("joint")):
        return False
    names = (finding["effect"], *(() if exactly else finding.get("equivalents", ())))
    return any(are_equivalent(str(name), str(effect["effect"])) for name in names)


def blind_answer(case: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer that asserts all frictions and a delay at every joint of a case."""
    findings = [
        {"effect": name, "joint": joint, "probability": BLIND_PROBABILITY, "equivalents": []}
        for joint in case["joints"]
        for name in BLIND_EFFECTS
    ]
    return {"seconds": 0.0, "answer": {"findings": findings, "unknown": [], "joints": {}}}


def compare_answer(case: Mapping[str, Any], entry: Mapping[str, Any]) -> Mark:
    """Compare an answer with the ground truth of its case.

    Args:
        case: Ground truth; see `generate_cases.ground_truth`.
        entry: `seconds`, `answer` and `predicted` of an analyst; see `run_analyst.ask`.
    """
    spec, answer, effects = case["spec"], entry["answer"], case["effects"]
    answered = _is_diagnosis(answer)
    findings = sorted(answer["findings"], key=_minus_probability) if answered else []
    considered = [*findings, *(answer.get("considered", ()) if answered else ())]
    named = _named_effects(findings, effects)
    nameable = [k for k, effect in enumerate(effects) if not effect["outsider"]]
    special = [k for k in nameable if effects[k]["effect"] in spec["names"]]
    matches = [
        (finding, effect)
        for finding in findings
        for effect in effects
        if finding["effect"] == effect["effect"] and names_effect(finding, effect, exactly=True)
    ]
    return Mark(
        group=GROUP_OF_CATEGORY.get(spec["category"], spec["category"]),
        severity=max((float(effect["severity"]) for effect in effects), default=0.0),
        answered=answered,
        rights=tuple(_is_right(finding, effects) for finding in findings),
        exact=bool(findings)
        and any(names_effect(findings[0], effect, exactly=True) for effect in effects),
        equivalents=tuple(len(finding.get("equivalents", ())) for finding in findings),
        recalled=tuple((float(effects[k]["unique_severity"]), k in named) for k in nameable),
        special=special[0] in named if spec["category"] == "dense" and special else None,
        unknown=bool(answered and any(map(_is_physical, answer["unknown"]))),
        probabilities=tuple(
            (float(finding["probability"]), _is_right(finding, effects)) for finding in considered
        ),
        coverage=tuple(
            interval[0] <= float(effect["severity"]) <= interval[1]
            for finding, effect in matches
            if (interval := (finding.get("evidence") or {}).get("severity_interval"))
        ),
        errors=tuple(
            error
            for finding, effect in matches
            for error in _parameter_errors(finding, with_contract_values(effect, case))
        ),
        gain=_held_out_gain(case, answer) if answered else None,
        ratio=_oracle_ratio(case, answer) if answered else None,
        model_ratio=_model_ratio(answer, entry.get("predicted")) if answered else None,
        seconds=float(entry["seconds"]),
    )


def _minus_probability(finding: Mapping[str, Any]) -> float:
    """Return the key that sorts findings, the most probable first."""
    return -float(finding["probability"])


def _is_right(finding: Mapping[str, Any], effects: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether a finding or one of its equivalents is hidden in its joint."""
    return any(names_effect(finding, effect) for effect in effects)


def _named_effects(
    findings: Sequence[Mapping[str, Any]], effects: Sequence[Mapping[str, Any]]
) -> set[int]:
    """Return the effects that are named: each finding names one, by its name before equivalents."""
    named: set[int] = set()
    used: set[int] = set()
    for exactly in (True, False):
        for f, finding in enumerate(findings):
            for k, effect in enumerate(effects):
                if (
                    f not in used
                    and k not in named
                    and names_effect(finding, effect, exactly=exactly)
                ):
                    named.add(k)
                    used.add(f)
    return named


def _is_physical(unknown: Any) -> bool:
    """Return whether an unknown is unmodelled physics and not a change between sessions."""
    return (
        not isinstance(unknown, dict) or (unknown.get("where") or {}).get("regime") != "recording"
    )


def _is_diagnosis(answer: Any) -> bool:
    """Return whether an answer has findings with name and probability, unknowns and joints."""
    return (
        isinstance(answer, dict)
        and all(isinstance(answer.get(key), list) for key in ("findings", "unknown"))
        and isinstance(answer.get("joints"), dict)
        and all(
            isinstance(finding, dict)
            and isinstance(finding.get("effect"), str)
            and isinstance(finding.get("probability"), (int, float))
            for finding in (*answer["findings"], *answer.get("considered", ()))
        )
    )


def _claimed_rmse(joints: Iterable[str], answer: Mapping[str, Any]) -> FloatArray | None:
    """Return the RMSE that an answer claims for its model, shape (n,) [N m], or None."""
    values = [answer["joints"].get(name, {}).get("rmse_after") for name in joints]
    return None if any(value is None for value in values) else np.array(values, float)


def _held_out_gain(case: Mapping[str, Any], answer: Mapping[str, Any]) -> float | None:
    """Return the decrease of the held-out mean square, over the decrease by the oracle.

    It sums over joints in units of noise: 1 is the oracle, 0 the base model. None where the oracle
    gains almost nothing.
    """
    held_out, after = case["held_out"], _claimed_rmse(case["joints"], answer)
    noise, before, oracle = (np.array(held_out[key]) for key in ("noise", "before", "oracle"))
    possible = float(np.sum((before**2 - oracle**2) / noise**2))
    if after is None or possible < MIN_RATIO_GAIN * len(noise):
        return None
    return float(np.sum((before**2 - after**2) / noise**2)) / possible


def _oracle_ratio(case: Mapping[str, Any], answer: Mapping[str, Any]) -> float | None:
    """Return the held-out RMSE over the oracle's, geometric mean over the joints."""
    after = _claimed_rmse(case["joints"], answer)
    if after is None:
        return None
    return float(np.exp(np.mean(np.log(after / np.array(case["held_out"]["oracle"])))))


def _model_ratio(answer: Mapping[str, Any], predicted: Mapping[str, float] | None) -> float | None:
    """Return the largest ratio of the RMSE of the re-read model to the claimed one, of all joints.

    Infinite where the model cannot be re-read; None where no RMSE is claimed.
    """
    after = _claimed_rmse(answer["joints"], answer) if answer["joints"] else None
    if after is None:
        return None
    if predicted is None:
        return float("inf")
    return float(np.max(np.array([predicted[name] for name in answer["joints"]]) / after))


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
    """Return relative error and coverage (value ± 2 std) of each parameter that both state."""
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


def score(marks: Sequence[Mark]) -> dict[str, Any]:
    """Return all figures of an analyst, each with `value` (null without cases) and `count`."""
    by_group = {
        group: [mark for mark in marks if mark.group == group]
        for group in ("sparse", "dense", "half_dense", "null", "out_of_catalogue")
    }
    sparse, dense = by_group["sparse"], by_group["dense"]
    out: dict[str, Any] = {"cases": len(marks), "answered": rate(m.answered for m in marks)}
    for group in ("sparse", "dense", "half_dense"):
        members = by_group[group]
        for level in SEVERITY_LEVELS:
            out[f"{group}_recall_{level:g}"] = rate(
                named for m in members for unique, named in m.recalled if unique >= level
            )
        out[f"{group}_precision"] = rate(right for m in members for right in m.rights)
    for name, (low, high) in SPARSE_BINS.items():
        out[f"sparse_first_{name}"] = rate(m.exact for m in sparse if low <= m.severity < high)
    gains = [m.gain for m in dense if m.gain is not None]
    model_ratios = [m.model_ratio for m in marks if m.model_ratio is not None]
    errors = [error for m in marks for _, error, _ in m.errors]
    return out | {
        "equivalents": summary([k for m in marks for k in m.equivalents], np.mean),
        "special": rate(m.special for m in dense if m.special is not None),
        "severity_coverage": rate(inside for m in marks for inside in m.coverage),
        "gain_median": summary(gains, np.median),
        "gain_low": summary(gains, lambda values: np.quantile(values, 0.1)),
        "oracle_ratio": summary([m.ratio for m in dense if m.ratio is not None], np.median),
        "null_asserted": rate(
            bool(m.rights) or m.unknown or not m.answered for m in by_group["null"]
        ),
        "unknown_not_named": rate(m.unknown and not m.rights for m in by_group["out_of_catalogue"]),
        "unknown_reported": rate(m.unknown for m in by_group["out_of_catalogue"]),
        "probability": probability_score([pair for m in marks for pair in m.probabilities]),
        "parameter_error": summary(errors, np.median),
        "parameter_coverage": rate(
            inside for m in marks for _, _, inside in m.errors if inside is not None
        ),
        "model_ratio": summary(model_ratios, np.max),
        "seconds": summary([m.seconds for m in marks if m.group == "dense"], np.median),
        "seconds_max": summary([m.seconds for m in marks], np.max),
    }


def rate(flags: Iterable[object]) -> dict[str, Any]:
    """Return a rate with its 95 % interval (Wilson 1927)."""
    values = [bool(flag) for flag in flags]
    if not values:
        return {"value": None, "count": 0}
    n, p, z = len(values), float(np.mean(values)), NORMAL_QUANTILE
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + (z / (2 * n)) ** 2)
    return {
        "value": p,
        "count": n,
        "interval": [max(float(middle - half), 0.0), min(float(middle + half), 1.0)],
    }


def summary(values: Sequence[float], statistic: Callable[[Any], Any]) -> dict[str, Any]:
    """Return a statistic of values."""
    return {"value": float(statistic(values)) if values else None, "count": len(values)}


def probability_score(pairs: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """Return log loss and reliability of probabilities.

    Args:
        pairs: Probability, and whether the finding is right.

    Returns:
        `log_loss` [nats per finding], `base_rate_log_loss` (of always saying the share of right
        findings), `bins` of width 0.1, and `error`: the largest deviation of reported from observed
        in a bin of at least `MIN_BIN_COUNT`.
    """
    if not pairs:
        return {"log_loss": None, "base_rate_log_loss": None, "bins": [], "error": None, "count": 0}
    probability, right = np.array([p for p, _ in pairs], float), np.array([r for _, r in pairs])
    bins = []
    for low, high in pairwise(RELIABILITY_BINS):
        inside = (probability >= low) & ((probability < high) | (high == 1.0))
        if inside.any():
            bins.append(
                {
                    "reported": float(probability[inside].mean()),
                    "observed": float(right[inside].mean()),
                    "count": int(inside.sum()),
                }
            )
    errors = [abs(b["reported"] - b["observed"]) for b in bins if b["count"] >= MIN_BIN_COUNT]
    return {
        "log_loss": _log_loss(probability, right),
        "base_rate_log_loss": _log_loss(np.full(len(right), right.mean()), right),
        "bins": bins,
        "error": max(errors, default=None),
        "count": len(pairs),
    }


def _log_loss(probability: FloatArray, right: BoolArray) -> float:
    """Return the mean negative log-likelihood of outcomes [nats]."""
    p = np.clip(probability, PROBABILITY_LIMIT, 1.0 - PROBABILITY_LIMIT)
    return float(-np.mean(np.log(np.where(right, p, 1.0 - p))))
