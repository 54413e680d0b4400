"""How often a finding like this one is right: a logistic curve over what distinguishes right from wrong, fitted to simulated robots.

Gain, rank, and the lead over other names were tried: beside what a finding takes of what is left to explain they say nothing.

`scripts/calibrate.py` fits the weights to answered cases of the concealed trial whose key is open (the tuning family: its effects have
other forms than those that are scored).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from . import search
from .judge import Finding, Verdict, sizes
from .search import Design

Array = np.ndarray
FEATURES = ("takes",)
WEIGHTS = {"bias": 0.3, "takes": 1.0}
FORM = (-4.2, 1.8)
"""Mean and standard deviation of the logarithm of the share that a right name leaves."""
ODDS = 0.02
"""Of a rival against the best name, from which they cannot be told apart."""
LEAST_ALIKE, MOST_ALIKE = 0.5, 3
"""Of the best name's gain, what a rival must gain to be told with it; and how many are told."""
LEAST_LEFT = 1e-3
"""Share that any law leaves."""
SLIGHT, CLEAR = 0.01, 4.0
"""Mean square over the noise that is as good as none; logarithm of odds beyond which all is the same."""
UNSURE = 0.1
"""Mean square over the noise to which the noise itself is known."""
ACTS = 0.2
"""Of an effect's torque at the joint where it is largest, what another joint must feel of it to be looked at too."""
LEAST, MOST = 0.02, 0.99
ASSERTED = 0.5
"""Probability from which a finding is asserted (the contract)."""


def features(left: tuple[float, float]) -> dict[str, float]:
    """What a probability is made of.

    takes: of what the base and the others leave beyond noise where it acts, what it explains over what it leaves, as a logarithm: a wrong
    name that mends another's form takes little. left: see `unexplained`.
    """
    without, both = left
    return {"takes": float(np.clip(np.log(max(without - both, SLIGHT) / both), -CLEAR, CLEAR))}


def unexplained(one: Design, verdict: Verdict, number: int, noise: Array) -> tuple[float, float]:
    """What is left where a finding acts by all but it, and by all: mean squares beyond noise, over the noise. noise: mean square over the
    scale. Shape (n,)."""
    together, own = verdict.together, [part.shape for part in verdict.findings[number].parts]
    assert together is not None
    where = sizes(one, together, together.shapes.index(own[0]))
    acts = where > ACTS * where.max()
    others = tuple(i for i in together.shapes if i not in own)
    without, both = (_excess(one, shapes, noise, acts) for shapes in (others, together.shapes))
    return without, both


def alike(finding: Finding, left: tuple[float, float]) -> tuple[str, ...]:
    """Names that a recording cannot tell from a finding's, the best first.

    A law that is not quite the catalogue's leaves a share x of what it explains, whose logarithm is normal (`FORM`, over tuning cases named
    rightly); a wrong name leaves any share as likely as any other. The best name leaves some, a rival more, by how much less it gains: the
    odds that they are the wrong way round.
    """
    without, both = left
    best = np.clip(both / max(without, both), LEAST_LEFT, 1.0)

    def right(x: float) -> float:
        """Odds of a right name to a wrong one, by the share that it leaves, to a factor."""
        return float(np.exp(-0.5 * max((np.log(x) - FORM[0]) / FORM[1], 0.0) ** 2) / x)

    out = []
    for name, gain in sorted(finding.rivals.items(), key=lambda entry: -entry[1]):
        share = np.clip(1.0 - (1.0 - best) * gain / max(finding.gain, 1e-9), best, 1.0)
        if gain > LEAST_ALIKE * finding.gain and right(float(share)) > ODDS * right(float(best)):
            out.append(name)
    return tuple(out[:MOST_ALIKE])


def _excess(one: Design, shapes: Sequence[int], noise: Array, joints: Array) -> float:
    """Mean square beyond noise, over the noise, that base and shapes leave of all recordings at some joints, added."""
    square = np.mean(np.square(search.remaining(one, shapes)), axis=0) / noise - 1.0
    return float(max(square[joints].sum(), UNSURE))


def probability(seen: dict[str, float]) -> float:
    """That the truth is the finding or an equivalent."""
    x = WEIGHTS["bias"] + sum(WEIGHTS[key] * seen[key] for key in FEATURES)
    return float(np.clip(1.0 / (1.0 + np.exp(-x)), LEAST, MOST))


def weighed(one: Design, verdict: Verdict, noise: Array) -> Verdict:
    """The verdict with probabilities. What is less likely right than wrong by name still predicts, and stays in the model beside what is
    asserted. noise: see `unexplained`. Shape (n,)."""
    if not verdict.findings:
        return verdict
    findings = []
    for number, finding in enumerate(verdict.findings):
        left = unexplained(one, verdict, number, noise)
        seen = features(left)
        findings.append(replace(finding, equivalents=alike(finding, left), probability=probability(seen), evidence=seen))
    kept = tuple(f for f in findings if f.probability >= ASSERTED)
    doubted = tuple(f for f in findings if f.probability < ASSERTED)
    if not kept:  # nothing that can be said: nothing is added either
        considered = (*(f.main for f in doubted), *verdict.considered)
        return Verdict((), None, considered)
    return replace(verdict, findings=kept, doubted=doubted)
