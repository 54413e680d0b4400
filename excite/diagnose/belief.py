"""How often a finding like this one is right: by Bayes' rule over the share that it leaves of what it should explain.

A law that is not quite the catalogue's leaves a share x of its own torque, whose logarithm is normal; a wrong name, the best of many, has
some share in common with the truth, any as likely as any. Gain, rank, and the lead over other names were tried beside it and say nothing
more.

`scripts/calibrate.py` fits LEAVES, SPREAD, `Effect.loose`, BIAS and SLOPE to answered cases of the concealed trial whose key is open (the
tuning family: its effects have other forms than those that are scored, which is why a name is allowed to leave a little more than they do).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from . import judge, search
from .catalogue import BY_NAME
from .judge import Finding, Verdict
from .search import Design

Array = np.ndarray
LEAVES, SPREAD = -4.2, 1.5
"""Mean and standard deviation of the logarithm of the share that a right name leaves; `Effect.loose` adds to the mean."""
RIGHT = 5.0
"""Odds that the name that predicts best is right, before what it leaves is seen."""
BIAS, SLOPE = 0.0, 1.0
"""Of the logarithm of odds: what was right over what was said."""
ODDS = 0.03
"""Of a rival against the best name, from which they cannot be told apart."""
LEAST_ALIKE, MOST_ALIKE = 0.2, 3
"""Of the best name's gain, what a rival must gain to be told with it; and how many are told."""
LEAST_LEFT = 1e-3
"""Share that any law leaves."""
UNSURE = 0.1
"""Mean square over the noise to which the noise itself is known."""
LEAST, MOST = 0.02, 0.99
ASSERTED = 0.5
"""Probability from which a finding is asserted (the contract)."""


def share(left: tuple[float, float]) -> float:
    """What a name leaves of what it should explain, as far as the noise lets it be known. left: see `unexplained`."""
    without, both = left
    return float(np.clip(max(both - UNSURE, 0.5 * UNSURE) / max(without, both), LEAST_LEFT, 1.0))


def odds(effect: str, x: float) -> float:
    """Of an effect that leaves a share x: that it is right to that it is wrong."""
    z = max((np.log(x) - LEAVES - BY_NAME[effect].loose) / SPREAD, 0.0)
    return float(RIGHT * np.exp(-0.5 * z * z) / (SPREAD * np.sqrt(2.0 * np.pi)) / x)


def unexplained(one: Design, verdict: Verdict, number: int, noise: Array) -> tuple[float, float]:
    """What is left where a finding acts by all but it, and by all: mean squares beyond noise, over the noise. noise: mean square over the
    scale. Shape (n,). Where less is left than noise, the noise is off by as much; at the worst all that is left is no noise."""
    together, parts = verdict.together, verdict.findings[number].parts
    assert together is not None
    acts = judge.acting(one, together, parts[0].shape)
    others = judge.without(together.shapes, parts)
    without, both = ((search.level(one, shapes) / noise)[acts] for shapes in (others, together.shapes))
    left = min(max(abs(float(np.sum(both - 1.0))), UNSURE), float(np.sum(both)))
    return left + max(float(np.sum(without - both)), 0.0), left


def alike(finding: Finding, x: float) -> dict[str, float]:
    """Names that a recording cannot tell from a finding's and their odds, the best first. A rival leaves more by how much less it gains."""
    best, out = odds(finding.main.effect, x), {}
    for name, gain in finding.rivals.items():
        left = float(np.clip(1.0 - (1.0 - x) * gain / max(finding.gain, 1e-9), x, 1.0))
        if gain > LEAST_ALIKE * finding.gain and (chance := odds(name, left)) > ODDS * best:
            out[name] = chance
    return dict(sorted(out.items(), key=lambda entry: -entry[1])[:MOST_ALIKE])


def probability(chance: float) -> float:
    """That the truth is the finding or an equivalent, by their odds together."""
    return float(np.clip(1.0 / (1.0 + np.exp(-BIAS - SLOPE * np.log(chance))), LEAST, MOST))


def weighed(one: Design, verdict: Verdict, noise: Array) -> Verdict:
    """The verdict with probabilities. What is less likely right than wrong by name still predicts, and stays in the model beside what is
    asserted. noise: see `unexplained`. Shape (n,)."""
    if not verdict.findings:
        return verdict
    findings = []
    for number, finding in enumerate(verdict.findings):
        x = share(unexplained(one, verdict, number, noise))
        others = {name: chance * genuine(one, name, finding.rivals[name]) for name, chance in alike(finding, x).items()}
        chance = odds(finding.main.effect, x) * genuine(one, finding.main.effect, finding.gain) + sum(others.values())
        evidence = {"left": x, "odds": chance}
        findings.append(replace(finding, equivalents=tuple(others), probability=probability(chance), evidence=evidence))
    kept = tuple(f for f in findings if f.probability >= ASSERTED)
    doubted = (*(f for f in findings if f.probability < ASSERTED), *verdict.doubted)
    if not kept:  # nothing that can be said: nothing is added either
        return Verdict((), None, verdict.considered, doubted)
    return replace(verdict, findings=kept, doubted=doubted)


def genuine(one: Design, effect: str, gain: float) -> float:
    """Share of a gain that faults of the measurement, such as an encoder's steps, do not feign."""
    return float(np.clip(1.0 - one.measured.feigned.get(effect, 0.0) / max(gain, 1e-9), LEAST, 1.0))
