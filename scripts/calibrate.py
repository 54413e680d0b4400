#!/usr/bin/env python
"""Fit the diagnosis's probabilities and parameter intervals to a trial whose key is open (the tuning family, or a run of before).

    scripts/calibrate.py out/tuning --analyst excite

Prints constants of `excite/diagnose/belief.py` and, for the effects in `excite/diagnose/catalogue/`, by how much they leave more or less
than most (`loose`), and for each parameter the relative standard deviation that makes value ± 2 std cover 95 % of the true values (`form`).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from concealed_trial import commitment
from concealed_trial.score import equal, whole
from scipy.optimize import minimize

from excite.diagnosis.interval import FORM
from excite.effects import EFFECTS_BY_NAME

Array = np.ndarray
RIDGE = 0.02
"""Weight against large weights, a finding."""
LOOSE_CASES = 5.0
"""As many cases say that an effect leaves what most do."""
PRIOR_CASES, PRIOR_FORM = 2.0, 0.1
"""What is said of a parameter that few cases show: as many cases with errors of this deviation. What is fitted to all other
effects covers nine in ten of an effect's parameters: a law that nobody has seen needs no less, whatever the cases at hand say."""


def findings(folder: Path, analyst: str) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Every finding, doubted ones too, with its case."""
    cases = commitment.unlock(
        folder / "key", (folder / "sealed.sha256").read_text(encoding="utf-8").strip()
    )
    out = []
    for path in sorted((folder / "answers" / analyst).glob("*.json")):
        answer = json.loads(path.read_text(encoding="utf-8"))["answer"]
        if isinstance(answer, dict):
            stated = [*answer["findings"], *answer["considered"]]
            out += [(one, cases[path.stem]) for one in stated if "odds" in one["evidence"]]
    return out


def right(one: dict[str, Any], case: dict[str, Any]) -> bool:
    return any(hidden(name, case) for name in (one["effect"], *one["equivalents"]))


def hidden(name: str, case: dict[str, Any]) -> bool:
    return any(equal(name, effect["effect"]) for effect in case["effects"])


def weights(stated: list[tuple[dict[str, Any], dict[str, Any]]]) -> tuple[float, float]:
    """Logistic regression of what was right on the logarithm of odds, with a small ridge: bias and slope."""
    x = np.array([[1.0, np.log(one["evidence"]["odds"])] for one, _ in stated])
    y = np.array([right(*pair) for pair in stated], float)

    def cost(w: Array) -> float:
        z = x @ w
        return float(np.logaddexp(0.0, z).sum() - y @ z + RIDGE * len(y) * 0.01 * w[1] ** 2)

    bias, slope = minimize(cost, np.zeros(2)).x
    return round(float(bias), 2), round(float(slope), 2)


def leaves(stated: list[tuple[dict[str, Any], dict[str, Any]]]) -> tuple[float, float]:
    """Mean and standard deviation of the logarithm of the share that rightly named laws leave, those of a loose law by its own measure."""
    named = [one for one, case in stated if hidden(one["effect"], case)]
    left = np.array(
        [np.log(one["evidence"]["left"]) - EFFECTS_BY_NAME[one["effect"]].residual_log_offset for one in named]
    )
    return round(float(left.mean()), 2), round(float(left.std()), 2)


def loose(stated: list[tuple[dict[str, Any], dict[str, Any]]], mean: float) -> dict[str, float]:
    """By how much the logarithm of the share that an effect leaves, where it is rightly named, differs from the mean of all; drawn towards
    no difference where few cases show it."""
    left: dict[str, list[float]] = {}
    for one, case in stated:
        if hidden(one["effect"], case):
            left.setdefault(one["effect"], []).append(float(np.log(one["evidence"]["left"])) - mean)
    return {
        name: round(sum(own) / (len(own) + LOOSE_CASES), 1) for name, own in sorted(left.items())
    }


def forms(stated: list[tuple[dict[str, Any], dict[str, Any]]]) -> dict[str, dict[str, float]]:
    """Relative deviation of each parameter beyond what the fit says of it, from rightly named findings at the right joint."""
    errors: dict[str, dict[str, list[float]]] = {}
    for one, case in stated:
        for effect in case["effects"]:
            if (
                effect["outsider"]
                or one["effect"] != effect["effect"]
                or one["joint"] != effect["joint"]
            ):
                continue
            for name, true in whole(effect, case)["parameters"].items():
                said = one["parameters"].get(name)
                if said and said["value"] and said["std"] is not None and true["value"]:
                    size = abs(said["value"])
                    used = EFFECTS_BY_NAME[effect["effect"]].form_std.get(name, FORM) * size
                    own = max(said["std"] ** 2 - used**2, 0.0)
                    lacking = max(
                        (0.5 * (said["value"] - true["value"])) ** 2 - own, 0.0
                    )  # of ± 2 std
                    errors.setdefault(one["effect"], {}).setdefault(name, []).append(
                        min(float(np.sqrt(lacking)) / size, 2.0)
                    )
    out: dict[str, dict[str, float]] = {}
    for effect_name, own in sorted(errors.items()):
        for name, values in own.items():
            # what 95 % need at the most, drawn towards the usual where few cases show it
            high = float(np.quantile(values, 0.95))
            share = len(values) / (len(values) + PRIOR_CASES)
            out.setdefault(effect_name, {})[name] = round(
                share * high + (1.0 - share) * PRIOR_FORM, 3
            )
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--analyst", default="excite")
    arguments = parser.parse_args()
    stated = findings(arguments.folder, arguments.analyst)
    print(
        f"BIAS, SLOPE = {weights(stated)}  # {len(stated)} findings, {np.mean([right(*pair) for pair in stated]):.2f} right"
    )
    mean, spread = leaves(stated)
    print(f"LEAVES, SPREAD = {mean, spread}")
    print(f"loose: {loose(stated, mean)}")
    for effect, own in forms(stated).items():
        print(f"{effect}: form={own}")


if __name__ == "__main__":
    main()
