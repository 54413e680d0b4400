"""How often a finding like this one is right: a logistic curve over what distinguishes right from wrong, fitted to simulated robots.

`scripts/calibrate.py` fits the weights to answered cases of the concealed trial whose key is open (the tuning family: its effects have
other forms than those that are scored).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .judge import Verdict
from .search import Design

Array = np.ndarray
FEATURES = ("size", "share", "left", "later")
WEIGHTS = {"bias": -0.8, "size": 0.15, "share": 2.52, "left": -2.13, "later": -1.16}
LEAST, MOST = 0.02, 0.99
ASSERTED = 0.5
"""Probability from which a finding is asserted (the contract)."""


def features(one: Design, verdict: Verdict, number: int, left: Array) -> dict[str, float]:
    """What a probability is made of. size: log of the gain over the least that counts. share: of the first gain at its joint. left: of the
    excess over the noise, what remains there. later: whether others come first."""
    finding = verdict.findings[number]
    joint = finding.main.joint
    first = next(other.gain for other in verdict.findings if other.main.joint == joint)
    return {
        "size": float(np.log(max(finding.gain, one.nats) / one.nats)),
        "share": float(np.clip(finding.gain / max(first, 1e-9), 0.0, 1.0)),
        "left": float(np.clip(left.max() if joint is None else left[joint], 0.0, 1.0)),
        "later": float(number > 0),
    }


def probability(seen: dict[str, float]) -> float:
    """That the truth is the finding or an equivalent."""
    x = WEIGHTS["bias"] + sum(WEIGHTS[key] * seen[key] for key in FEATURES)
    return float(np.clip(1.0 / (1.0 + np.exp(-x)), LEAST, MOST))


def weighed(one: Design, verdict: Verdict, left: Array) -> Verdict:
    """The verdict with probabilities. What is less likely right than wrong by name still predicts, and stays in the model beside what is
    asserted. left: per joint, see `features`. Shape (n,)."""
    if not verdict.findings:
        return verdict
    findings = []
    for number, finding in enumerate(verdict.findings):
        seen = features(one, verdict, number, left)
        findings.append(replace(finding, probability=probability(seen), evidence=seen))
    kept = tuple(f for f in findings if f.probability >= ASSERTED)
    doubted = tuple(f for f in findings if f.probability < ASSERTED)
    if not kept:  # nothing that can be said: nothing is added either
        considered = (*(f.main for f in doubted), *verdict.considered)
        return Verdict((), None, considered)
    return replace(verdict, findings=kept, doubted=doubted)
