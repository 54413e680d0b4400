"""How often a finding like this one is right: a logistic curve over what distinguishes right from wrong, fitted to simulated robots.

`scripts/calibrate.py` fits the weights to answered cases of the concealed trial whose key is open (the tuning family: its effects have
other forms than those that are scored).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from . import search
from .judge import Verdict, sizes
from .search import Design

Array = np.ndarray
FEATURES = ("size", "share", "takes", "left", "later", "lead")
WEIGHTS = {"bias": -0.8, "size": 0.15, "share": 2.52, "takes": 0.0, "left": -2.13, "later": -1.16, "lead": 0.0}
ACTS = 0.2
"""Of an effect's torque at the joint where it is largest, what another joint must feel of it to be looked at too."""
LEAST, MOST = 0.02, 0.99
ASSERTED = 0.5
"""Probability from which a finding is asserted (the contract)."""


def features(one: Design, verdict: Verdict, number: int, noise: Array) -> dict[str, float]:
    """What a probability is made of.

    size: log of the gain over the least that counts. share: of the first gain at its joint. takes: of what the base and the others leave
    beyond noise where it acts, what it explains: a wrong name that mends another's form takes little. left: of what the base leaves there,
    what remains. later: whether others come first. lead: over the best rival that is no equivalent, of its gain. noise: mean square over
    the scale. Shape (n,).
    """
    finding, together = verdict.findings[number], verdict.together
    assert together is not None
    joint, own = finding.main.joint, [part.shape for part in finding.parts]
    where = sizes(one, together, together.shapes.index(own[0]))
    acts = where > ACTS * where.max()
    first = next(other.gain for other in verdict.findings if other.main.joint == joint)
    others = tuple(i for i in together.shapes if i not in own)
    bare, without, left = (_excess(one, shapes, noise, acts) for shapes in ((), others, together.shapes))
    rival = max((gain for name, gain in finding.rivals.items() if name not in finding.equivalents), default=0.0)
    return {
        "size": float(np.log(max(finding.gain / one.bar(finding.main.shape), 1.0))),
        "share": float(np.clip(finding.gain / max(first, 1e-9), 0.0, 1.0)),
        "takes": float(np.clip(1.0 - left / without, 0.0, 1.0)),
        "left": float(np.clip(left / bare, 0.0, 1.0)),
        "later": float(number > 0),
        "lead": float(np.clip(1.0 - rival / max(finding.gain, 1e-9), 0.0, 1.0)),
    }


def _excess(one: Design, shapes: Sequence[int], noise: Array, joints: Array) -> float:
    """Mean square beyond noise, over the noise, that base and shapes leave of all recordings at some joints, added."""
    square = np.mean(np.square(search.remaining(one, shapes)), axis=0) / noise - 1.0
    return float(max(square[joints].sum(), 0.1))


def probability(seen: dict[str, float]) -> float:
    """That the truth is the finding or an equivalent."""
    x = WEIGHTS["bias"] + sum(WEIGHTS[key] * seen[key] for key in FEATURES)
    return float(np.clip(1.0 / (1.0 + np.exp(-x)), LEAST, MOST))


def weighed(one: Design, verdict: Verdict, noise: Array) -> Verdict:
    """The verdict with probabilities. What is less likely right than wrong by name still predicts, and stays in the model beside what is
    asserted. noise: see `features`. Shape (n,)."""
    if not verdict.findings:
        return verdict
    findings = []
    for number, finding in enumerate(verdict.findings):
        seen = features(one, verdict, number, noise)
        findings.append(replace(finding, probability=probability(seen), evidence=seen))
    kept = tuple(f for f in findings if f.probability >= ASSERTED)
    doubted = tuple(f for f in findings if f.probability < ASSERTED)
    if not kept:  # nothing that can be said: nothing is added either
        considered = (*(f.main for f in doubted), *verdict.considered)
        return Verdict((), None, considered)
    return replace(verdict, findings=kept, doubted=doubted)
