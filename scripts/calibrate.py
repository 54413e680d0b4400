#!/usr/bin/env python
"""Fit the diagnosis's probabilities and parameter intervals to a trial whose answers are scored.

    scripts/calibrate.py out/tuning --analyst excite

Use the tuning family, or an earlier run. It prints constants of `excite/diagnosis/belief.py`; for
the effects, how much the unexplained fraction of each differs from the mean (`loose`), and for each
parameter the relative standard deviation with which value ± 2 std covers 95 % of the true values
(`form`).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from concealed_trial import commitment
from concealed_trial.run import TrialFolder
from concealed_trial.score import are_equivalent, with_contract_values
from scipy.optimize import minimize

from excite._types import FloatArray
from excite.diagnosis.interval import FORM
from excite.effects import EFFECTS_BY_NAME

RIDGE = 0.02
"""Weight of the penalty on the slope, per finding."""
LOOSE_CASES = 5.0
"""Weight of the mean over effects, in cases."""
PRIOR_CASES = 2.0
"""Weight of `PRIOR_FORM`, in cases."""
PRIOR_FORM = 0.1
"""Relative standard deviation of a parameter that few cases show [1].

It covers nine in ten parameters of all effects.
"""


def findings(folder: Path, analyst: str) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Return every finding, considered ones included, with the ground truth of its case."""
    trial = TrialFolder(folder)
    cases = commitment.open_ground_truth(trial.key, trial.published_hash())
    out = []
    for path in sorted((folder / "answers" / analyst).glob("*.json")):
        answer = json.loads(path.read_text(encoding="utf-8"))["answer"]
        if isinstance(answer, dict):
            reported = [*answer["findings"], *answer["considered"]]
            out += [
                (finding, cases[path.stem]) for finding in reported if "odds" in finding["evidence"]
            ]
    return out


def is_right(finding: dict[str, Any], case: dict[str, Any]) -> bool:
    """Return True if a finding or one of its equivalents is hidden."""
    return any(is_hidden(name, case) for name in (finding["effect"], *finding["equivalents"]))


def is_hidden(name: str, case: dict[str, Any]) -> bool:
    """Return True if an effect is hidden in a case."""
    return any(are_equivalent(name, effect["effect"]) for effect in case["effects"])


def fit_calibration(pairs: list[tuple[dict[str, Any], dict[str, Any]]]) -> tuple[float, float]:
    """Return bias and slope of a logistic regression of truth on log-odds, with a small ridge."""
    x = np.array([[1.0, np.log(finding["evidence"]["odds"])] for finding, _ in pairs])
    y = np.array([is_right(*pair) for pair in pairs], float)

    def cost(w: FloatArray) -> float:
        z = x @ w
        return float(np.logaddexp(0.0, z).sum() - y @ z + RIDGE * len(y) * 0.01 * w[1] ** 2)

    bias, slope = minimize(cost, np.zeros(2)).x
    return round(float(bias), 2), round(float(slope), 2)


def unexplained_statistics(
    pairs: list[tuple[dict[str, Any], dict[str, Any]]],
) -> tuple[float, float]:
    """Return mean and standard deviation of the log unexplained fraction of right findings.

    It is relative to the offset of each effect.
    """
    named = [finding for finding, case in pairs if is_hidden(finding["effect"], case)]
    logs = np.array(
        [
            np.log(finding["evidence"]["left"])
            - EFFECTS_BY_NAME[finding["effect"]].residual_log_offset
            for finding in named
        ]
    )
    return round(float(logs.mean()), 2), round(float(logs.std()), 2)


def unexplained_offsets(
    pairs: list[tuple[dict[str, Any], dict[str, Any]]], mean: float
) -> dict[str, float]:
    """Return the offset of each effect's log unexplained fraction from the mean of all.

    It is shrunk towards zero where few cases show the effect.
    """
    logs: dict[str, list[float]] = {}
    for finding, case in pairs:
        if is_hidden(finding["effect"], case):
            logs.setdefault(finding["effect"], []).append(
                float(np.log(finding["evidence"]["left"])) - mean
            )
    return {
        name: round(sum(values) / (len(values) + LOOSE_CASES), 1)
        for name, values in sorted(logs.items())
    }


def parameter_deviations(
    pairs: list[tuple[dict[str, Any], dict[str, Any]]],
) -> dict[str, dict[str, float]]:
    """Return the relative deviation of each parameter beyond the fit's own standard deviation.

    Only right findings in the right joint count.
    """
    errors: dict[str, dict[str, list[float]]] = {}
    for finding, case in pairs:
        for effect in case["effects"]:
            if (
                effect["outsider"]
                or finding["effect"] != effect["effect"]
                or finding["joint"] != effect["joint"]
            ):
                continue
            for name, true in with_contract_values(effect, case)["parameters"].items():
                reported = finding["parameters"].get(name)
                if reported and reported["value"] and reported["std"] is not None and true["value"]:
                    size = abs(reported["value"])
                    used = EFFECTS_BY_NAME[effect["effect"]].form_std.get(name, FORM) * size
                    variance = max(reported["std"] ** 2 - used**2, 0.0)
                    excess = max(
                        (0.5 * (reported["value"] - true["value"])) ** 2 - variance, 0.0
                    )  # of ± 2 std
                    errors.setdefault(finding["effect"], {}).setdefault(name, []).append(
                        min(float(np.sqrt(excess)) / size, 2.0)
                    )
    out: dict[str, dict[str, float]] = {}
    for effect_name, by_parameter in sorted(errors.items()):
        for name, values in by_parameter.items():
            # the 95 % quantile, shrunk towards the usual value where few cases show it
            high = float(np.quantile(values, 0.95))
            share = len(values) / (len(values) + PRIOR_CASES)
            out.setdefault(effect_name, {})[name] = round(
                share * high + (1.0 - share) * PRIOR_FORM, 3
            )
    return out


def main() -> None:
    """Print the constants."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--analyst", default="excite")
    arguments = parser.parse_args()
    pairs = findings(arguments.folder, arguments.analyst)
    print(
        f"BIAS, SLOPE = {fit_calibration(pairs)}  # {len(pairs)} findings, "
        f"{np.mean([is_right(*pair) for pair in pairs]):.2f} right"
    )
    mean, spread = unexplained_statistics(pairs)
    print(f"LEAVES, SPREAD = {mean, spread}")
    print(f"loose: {unexplained_offsets(pairs, mean)}")
    for effect, deviations in parameter_deviations(pairs).items():
        print(f"{effect}: form={deviations}")


if __name__ == "__main__":
    main()
