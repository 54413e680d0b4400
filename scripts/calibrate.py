"""Fit the constants of `excite/diagnosis/probability.py` to answered tuning cases.

    scripts/concealed_trial run --family tuning --cases 120 -o out/tune \\
        --analyst 'excite=excite diagnose {robot} {train} --validate {validate} {prior} -o {out}'
    python scripts/calibrate.py out/tune

Temperature and shared counts of the frictions, and temperature, prior log odds, size and spread of
all other effects, minimise the log loss of every effect that the answers state with its evidence,
asserted or not. The table compares it with the log loss of always stating the base rate, and the
stated probabilities with the frequencies. Cases of the family "scored" are refused.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from concealed_trial.run import TrialFolder
from concealed_trial.score import RELIABILITY_BINS, names_effect

from excite._types import BoolArray, FloatArray
from excite.diagnosis import posterior, probability

FRICTION_GRID = (
    np.geomspace(5.0, 200.0, 16).tolist(),
    [(0.1, 0.1), (0.2, 0.2), (0.2, 0.5), (0.5, 0.5), (0.5, 1.0), (1.0, 1.0), (1.0, 3.0)],
)
"""Values of TEMPERATURE and SHARED_COUNTS that are tried."""
RARE_GRID = (
    [2.0, 3.0, 5.0, 8.0, 12.0, 20.0],
    np.arange(-8.0, -1.9, 1.0).tolist(),
    [0.5, 0.6, 0.7, 0.8, 1.0, 1.2],
    [0.2, 0.35, 0.5, 0.7],
)
"""Values of RARE_TEMPERATURE, RARE_LOG_ODDS, RARE_SIZE and RARE_SPREAD that are tried."""
FRICTION_NAMES = ("TEMPERATURE", "SHARED_COUNTS")
RARE_NAMES = ("RARE_TEMPERATURE", "RARE_LOG_ODDS", "RARE_SIZE", "RARE_SPREAD")
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
        size: RMS torque beyond what all other effects could stand for, over the noise.
        right: Whether it, or an equivalent, is hidden in its joint.
    """

    case: str
    effect: str
    joints: int
    log_bayes_factor: float
    size: float
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
                    float(evidence["severity_beyond_others"]),
                    any(names_effect(entry, effect) for effect in truth["effects"]),
                )
            )
    return out


def friction_probabilities(effects: Sequence[StatedEffect]) -> FloatArray:
    """Return the probability of every friction with the present constants."""
    out = np.zeros(len(effects))
    for name, case in {(e.effect, e.case) for e in effects}:
        members = [i for i, e in enumerate(effects) if (e.effect, e.case) == (name, case)]
        factors = [effects[i].log_bayes_factor for i in members]
        out[members] = posterior.shared_probabilities(effects[members[0]].joints, factors)
    return out


def rare_probabilities(effects: Sequence[StatedEffect]) -> FloatArray:
    """Return the probability of every other effect with the present constants."""
    evidence = probability.by_evidence(np.array([e.log_bayes_factor for e in effects]))
    return evidence * probability.by_size(np.array([e.size for e in effects]))


def log_loss(stated: FloatArray, right: BoolArray) -> float:
    """Return the mean log loss of probabilities [nat]."""
    p = np.clip(stated, LIMIT, 1.0 - LIMIT)
    return float(-np.mean(np.where(right, np.log(p), np.log(1.0 - p))))


def calibrate(
    title: str,
    effects: Sequence[StatedEffect],
    names: Sequence[str],
    grid: Sequence[Sequence[Any]],
    probabilities: Callable[[Sequence[StatedEffect]], FloatArray],
) -> None:
    """Print the constants with the least log loss, and the reliability with them."""
    if not effects:
        print(f"{title}: none stated")
        return
    right = np.array([e.right for e in effects])
    present = {name: getattr(probability, name) for name in names}

    def loss(constants: Sequence[Any]) -> float:
        for name, value in zip(names, constants, strict=True):
            setattr(probability, name, value)
        return log_loss(probabilities(effects), right)

    base = log_loss(np.full(len(right), right.mean()), right)
    print(
        f"{title}: {len(effects)}, {int(right.sum())} right; log loss of the base rate {base:.4f}"
    )
    print(f"  present {present}: log loss {loss(list(present.values())):.4f}")
    best = min(itertools.product(*grid), key=loss)
    print(f"  best {dict(zip(names, best, strict=True))}: log loss {loss(best):.4f}")
    for constants in (tuple(present.values()), best):
        loss(constants)
        stated = probabilities(effects)
        print(f"{'stated':>12}{'right':>8}{'effects':>9}")
        for low, high in itertools.pairwise(RELIABILITY_BINS.tolist()):
            inside = (stated >= low) & ((stated < high) | (high == 1.0))
            if inside.any():
                mean = float(stated[inside].mean())
                print(f"{mean:12.2f}{right[inside].mean():8.2f}{int(inside.sum()):9d}")
    loss(list(present.values()))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the script; return its exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder of an answered trial of tuning cases")
    parser.add_argument("--analyst", default="excite", help="name of the answers (default excite)")
    arguments = parser.parse_args(argv)
    effects = read_effects(TrialFolder(arguments.folder), arguments.analyst)
    dense = [e for e in effects if e.effect in posterior.DENSE_NAMES]
    rare = [e for e in effects if e.effect not in posterior.DENSE_NAMES]
    calibrate("frictions", dense, FRICTION_NAMES, FRICTION_GRID, friction_probabilities)
    calibrate("other effects", rare, RARE_NAMES, RARE_GRID, rare_probabilities)
    return 0


if __name__ == "__main__":
    sys.exit(main())
