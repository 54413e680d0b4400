"""Fit the constants of `excite/diagnosis/probability.py` to answered tuning cases.

    scripts/concealed_trial run --family tuning --cases 120 -o out/tune \\
        --analyst 'excite=excite diagnose {robot} {train} --validate {validate} {prior} -o {out}'
    python scripts/calibrate.py out/tune

The temperature T, the counts a and b of the odds that joints share, and the log odds of all other
effects minimise the log loss of every effect that the answers state with its evidence, asserted or
not. The table compares it with the log loss of always stating the base rate, and the stated
probabilities with the frequencies. Cases of the family "scored" are refused.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from concealed_trial.run import TrialFolder
from concealed_trial.score import RELIABILITY_BINS, names_effect

from excite._types import BoolArray, FloatArray
from excite.diagnosis import posterior, probability

TEMPERATURES = np.geomspace(1.0, 200.0, 24)
"""Temperatures that are tried."""
COUNTS = ((0.5, 0.5), (0.5, 1.0), (0.5, 2.0), (1.0, 1.0), (1.0, 3.0), (2.0, 1.0))
"""Counts a and b that are tried."""
LOG_ODDS = np.arange(-8.0, 0.1, 1.0)
"""Prior log odds that are tried."""
LIMIT = 1e-3
"""Distance of a probability from 0 and 1 at least."""


@dataclass(frozen=True)
class StatedEffect:
    """An effect of an answer, with its evidence.

    Attributes:
        case: Name of the case.
        effect: Name of the effect.
        joints: Number of joints of the robot.
        log_bayes_factor: Evidence for it.
        right: Whether it, or an equivalent, is hidden in its joint.
    """

    case: str
    effect: str
    joints: int
    log_bayes_factor: float
    right: bool


def read_effects(folder: TrialFolder, analyst: str) -> list[StatedEffect]:
    """Return the effects of all answers of an analyst."""
    out = []
    for path in sorted((folder.answers / analyst).glob("*.json")):
        answer = json.loads(path.read_text(encoding="utf-8"))["answer"]
        truth = json.loads((folder.key / path.name).read_text(encoding="utf-8"))
        if truth["spec"]["family"] != "tuning":
            sys.exit(f"{path}: a scored case must not set constants; use tuning cases")
        for entry in (*answer.get("findings", ()), *answer.get("considered", ())):
            evidence = entry["evidence"]
            out.append(
                StatedEffect(
                    path.stem,
                    entry["effect"],
                    len(truth["joints"]),
                    float(evidence["log_bayes_factor"]),
                    any(names_effect(entry, effect) for effect in truth["effects"]),
                )
            )
    return out


def probabilities(
    effects: Sequence[StatedEffect],
    temperature: float,
    counts: tuple[float, float],
    log_odds: float,
) -> FloatArray:
    """Return the probability of every effect with given constants."""
    probability.TEMPERATURE, probability.SHARED_COUNTS = temperature, counts
    odds = np.full(len(effects), log_odds)
    for name, case in {(e.effect, e.case) for e in effects if e.effect in posterior.DENSE_NAMES}:
        members = [i for i, e in enumerate(effects) if (e.effect, e.case) == (name, case)]
        factors = np.full(effects[members[0]].joints, -np.inf)
        factors[: len(members)] = [effects[i].log_bayes_factor for i in members]
        odds[members] = probability.shared_log_odds(factors)
    return probability.probability(np.array([e.log_bayes_factor for e in effects]), odds)


def log_loss(stated: FloatArray, right: BoolArray) -> float:
    """Return the mean log loss of probabilities [nat]."""
    p = np.clip(stated, LIMIT, 1.0 - LIMIT)
    return float(-np.mean(np.where(right, np.log(p), np.log(1.0 - p))))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the script; return its exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder of an answered trial of tuning cases")
    parser.add_argument("--analyst", default="excite", help="name of the answers (default excite)")
    arguments = parser.parse_args(argv)
    effects = read_effects(TrialFolder(arguments.folder), arguments.analyst)
    right = np.array([e.right for e in effects])
    constants = (probability.TEMPERATURE, probability.SHARED_COUNTS, probability.RARE_LOG_ODDS)
    present = probabilities(effects, *constants)
    base = log_loss(np.full(len(right), right.mean()), right)
    print(f"{len(effects)} effects, {int(right.sum())} right; log loss of the base rate {base:.4f}")
    print(f"present constants {constants}: log loss {log_loss(present, right):.4f}")
    best = min(
        itertools.product(TEMPERATURES.tolist(), COUNTS, LOG_ODDS.tolist()),
        key=lambda c: log_loss(probabilities(effects, *c), right),
    )
    stated = probabilities(effects, *best)
    print(f"T {best[0]:.3g}, a and b {best[1]}, log odds {best[2]:g}: ", end="")
    print(f"log loss {log_loss(stated, right):.4f}")
    print(f"{'stated':>12}{'right':>8}{'effects':>9}")
    for low, high in itertools.pairwise(RELIABILITY_BINS.tolist()):
        inside = (stated >= low) & ((stated < high) | (high == 1.0))
        if inside.any():
            mean = float(stated[inside].mean())
            print(f"{mean:12.2f}{right[inside].mean():8.2f}{int(inside.sum()):9d}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
