"""How often a finding like this one is right: by Bayes' rule over the share that it leaves of what it should explain.

A law that is not quite the catalogue's leaves a share x of its own torque, whose logarithm is normal; a wrong name, the best of many, has
some share in common with the truth, any as likely as any. Gain, rank, and the lead over other names were tried beside it and say nothing
more.

`scripts/calibrate.py` fits LEAVES, SPREAD, `Effect.loose`, BIAS and SLOPE to answered cases of the concealed trial whose key is open: of
the tuning family, whose effects have other forms than those that are scored, so that a name may leave a little more than it did there.
BIAS, SLOPE, COMPANY, BARELY and what goes with it were set by what scored runs had shown before, each of other cases.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ..effects import EFFECTS_BY_NAME, are_confusable
from . import hypothesis, judge, search
from .judge import Finding, Verdict
from .search import EffectRegression

Array = np.ndarray
LEAVES, SPREAD = -4.2, 1.5
"""Mean and standard deviation of the logarithm of the share that a right name leaves; `Effect.loose` adds to the mean."""
RIGHT = 5.0
"""Odds that the name that predicts best is right, before what it leaves is seen."""
BIAS, SLOPE = -0.4, 1.35
"""Of the logarithm of odds: what was right over what was said. 247 findings of tuning cases say -1.2 and 1.45; 787 of three
scored runs whose key is open, this slope with this bias."""
ODDS = 0.03
"""Of a rival against the best name, from which they cannot be told apart."""
LEAST_ALIKE, MOST_ALIKE = 0.2, 3
"""Of the best name's gain, what a rival must gain to be told with it; and how many are told."""
BARELY, AS_LIKELY, MOST_BARELY = 0.4, 0.2, 4
"""Share from which a name leaves about as much as it takes; odds against it from which what it is taken for is told with it then, whatever
that gains; and how many names then are."""
LEAST_LEFT = 1e-3
"""Share that any law leaves."""
MENDED = 5.0
"""Times what others' laws usually leave that a finding must be about, lest it mends them."""
MENDS, SHARPLY = 3.0, 4
"""Times what the laws of others at a joint usually leave together from which a finding is likelier more than that, and how sharply: in four
scored runs whose key is open, of 18 that were about less three were right, of 41 about three to eight times as much 22."""
SURE, COMPANY = 0.9, 1.6
"""Probability from which a finding says that what this robot lacks is in the catalogue; and by how much that raises the odds of another."""
SHARED = 0.2
"""From all that is left to its part, how far a finding is charged with less for each other that acts there, of what is left to go, in the
logarithm: where five laws are at work, what they leave speaks against any of them less."""
UNSURE = 0.1
"""Mean square over the noise to which the noise itself is known."""
LEAST, MOST = 0.02, 0.98
"""Probability at the least and at the most: of 650 that were said to be 0.99, in four scored runs whose key is open, 0.98 were right."""
ASSERTED = 0.5
"""Probability from which a finding is asserted (the contract)."""


def share(left: float, taken: float) -> float:
    """What a name leaves of what it should explain, as far as the noise lets it be known. Mean squares over the noise."""
    return float(
        np.clip(max(left - UNSURE, 0.5 * UNSURE) / (left + max(taken, 0.0)), LEAST_LEFT, 1.0)
    )


def odds(effect: str, x: float) -> float:
    """Of an effect that leaves a share x: that it is right to that it is wrong."""
    z = max((np.log(x) - LEAVES - EFFECTS_BY_NAME[effect].residual_log_offset) / SPREAD, 0.0)
    return float(RIGHT * np.exp(-0.5 * z * z) / (SPREAD * np.sqrt(2.0 * np.pi)) / x)


def shares(
    one: EffectRegression, verdict: Verdict, noise: Array, bounds: tuple[Array, Array]
) -> list[tuple[float, float]]:
    """What each finding leaves, where it acts, of what it should explain; and how many times what the laws of others at its joint usually
    leave it is about, ∞ where there are none. noise: mean square over the scale. bounds: between which it may lie, over that. Shapes (n,).

    What lies between the bounds may be noise or not: the share is halfway, by its logarithm. Where several act, what all leave is at the
    most what one leaves, at the least its part by what such laws usually leave: it is taken to lie between, nearer to all where they are
    few; unless all that the finding is about may be what the others' laws leave. What happened once bends to whatever that is.
    """
    together = verdict.together
    assert together is not None
    left = search.level(one, together.shapes) / noise
    acts = np.array([hypothesis.acting(one, together, f.main.shape) for f in verdict.findings])
    without = np.array(
        [
            search.level(one, judge.without(together.shapes, f.parts)) / noise
            for f in verdict.findings
        ]
    )
    taken = np.where(acts, np.maximum(without - left, 0.0), 0.0)
    usual = taken * np.exp([[LEAVES + EFFECTS_BY_NAME[f.main.effect].residual_log_offset] for f in verdict.findings])
    of_all, crowd = usual.sum(axis=0), acts.sum(axis=0)
    joints = [f.main.joint for f in verdict.findings]
    out = []
    for k, finding in enumerate(verdict.findings):
        here, beside = (
            acts[k],
            [
                i
                for i, j in enumerate(joints)
                if i != k and (j == joints[k] or None in (j, joints[k]))
            ],
        )
        takes = float(np.sum((without[k] - left)[here]))
        x = _halfway(left, bounds, here, 1.0, takes)
        others = float(np.sum((of_all - usual[k])[here]))
        about = float(np.sum(taken[k] + np.maximum(left - 1.0, 0.0), where=here))
        if one.shapes[finding.main.shape].interval is None and about > MENDED * others:
            part = np.where(
                of_all > 0.0, usual[k] / np.maximum(of_all, 1e-300), 1.0 / crowd.clip(1)
            )
            least = _halfway(left, bounds, here, part, takes)
            charged = (1.0 - SHARED) ** (int(crowd[here].max()) - 1)
            x = float(x**charged * least ** (1.0 - charged))
        there = float(np.sum(usual[beside][:, here]))
        out.append((x, about / there if there > 0.0 else np.inf))
    return out


def another(times: float) -> float:
    """Share of a finding's odds that what the laws of others at its joint leave does not speak against. times: what it is about, over what
    they usually leave."""
    return float(1.0 / (1.0 + (MENDS / max(times, 1e-9)) ** SHARPLY))


def _halfway(
    level: Array, bounds: tuple[Array, Array], here: Array, part: Array | float, takes: float
) -> float:
    """The share left, halfway between what it is if the noise is as told, and if it is what fits best of what it may be."""
    weight = np.broadcast_to(part, level.shape)[here]
    told, best = (
        _left(level[here], low[here], high[here], weight)
        for low, high in ((np.ones_like(level),) * 2, bounds)
    )
    return float(np.sqrt(share(told, takes) * share(best, takes)))


def _left(level: Array, low: Array, high: Array, part: Array) -> float:
    """Of mean squares over the noise, a part of what is beyond it. Where less is left than noise, the noise is off by as much; at the worst
    all that is left is no noise."""
    beyond = np.maximum(level - high, 0.0) - np.maximum(low - level, 0.0)
    return float(min(max(abs(float(np.sum(beyond * part))), UNSURE), float(np.sum(level))))


def alike(finding: Finding, x: float, tried: Iterable[str]) -> dict[str, float]:
    """Names, of those tried, that a recording cannot tell from a finding's and their odds, the best first. A rival leaves more by how much
    less it gains. Beside what leaves as much as it takes, what may do so too is told, gain or none, where one is taken for the other."""
    main, most = finding.main.effect, max(finding.gain, 1e-9)
    best = odds(main, x)
    gains = {
        name: max(finding.rivals.get(name, 0.0), 0.0) / most for name in sorted({*tried} - {main})
    }
    chances = {
        name: odds(name, float(np.clip(1.0 - (1.0 - x) * gain, x, 1.0)))
        for name, gain in gains.items()
    }
    ranking = sorted(chances, key=lambda name: -chances[name])
    out = [name for name in ranking if gains[name] > LEAST_ALIKE and chances[name] > ODDS * best][
        :MOST_ALIKE
    ]
    if x > BARELY:
        taken = [
            n for n in ranking if n not in out and any(are_confusable(n, other) for other in (main, *out))
        ]
        out += [name for name in taken if chances[name] > AS_LIKELY * best][
            : MOST_BARELY - len(out)
        ]
    return {name: chances[name] for name in ranking if name in out}


def probability(chance: float) -> float:
    """That the truth is the finding or an equivalent, by their odds together."""
    return float(np.clip(1.0 / (1.0 + np.exp(-BIAS - SLOPE * np.log(chance))), LEAST, MOST))


def weighed(one: EffectRegression, verdict: Verdict, noise: Array, bounds: tuple[Array, Array]) -> Verdict:
    """The verdict with probabilities. What is less likely right than wrong by name still predicts, and stays in the model beside what is
    asserted. noise, bounds: see `shares`."""
    if not verdict.findings:
        return verdict
    told, tried = shares(one, verdict, noise, bounds), {shape.effect for shape in one.shapes}
    others = [
        alike(finding, x, tried) for finding, (x, _) in zip(verdict.findings, told, strict=True)
    ]
    alone = [_chance(one, *each) for each in zip(verdict.findings, told, others, strict=True)]
    sure, findings = [probability(chance) >= SURE for chance in alone], []
    for k, (finding, (x, times)) in enumerate(zip(verdict.findings, told, strict=True)):
        chance = alone[k] * (COMPANY if any(sure[:k] + sure[k + 1 :]) else 1.0)
        evidence = {"left": x, "odds": chance} | (
            {"beyond_others": times} if np.isfinite(times) else {}
        )
        findings.append(
            replace(
                finding,
                equivalents=tuple(others[k]),
                probability=probability(chance),
                evidence=evidence,
            )
        )
    kept = tuple(f for f in findings if f.probability >= ASSERTED)
    doubted = (*(f for f in findings if f.probability < ASSERTED), *verdict.doubted)
    if not kept:  # nothing that can be said: nothing is added either
        return Verdict((), None, verdict.considered, doubted)
    return replace(verdict, findings=kept, doubted=doubted)


def _chance(
    one: EffectRegression, finding: Finding, told: tuple[float, float], others: dict[str, float]
) -> float:
    """Odds of a finding by itself. told: see `shares`; others: see `alike`: what one of them says for sure is there, whichever it is."""
    main, (x, times) = finding.main, told
    names = (main.effect, *finding.here & others.keys())
    sure = max(
        genuine(one, name, main.joint, finding.rivals.get(name, finding.gain)) for name in names
    )
    return (odds(main.effect, x) + sum(others.values())) * sure * another(times)


def doubt(verdict: Verdict, n: int) -> Array:
    """Probability that of several names asserted at a joint not all are right; 0 where there are fewer. Shape (n,)."""
    said = [[f.probability for f in verdict.findings if f.main.joint == j] for j in range(n)]
    return np.array([1.0 - float(np.prod(own)) if len(own) > 1 else 0.0 for own in said])


def unsure(verdict: Verdict, n: int) -> Array:
    """Joints where several names are asserted that are likelier not all right. Shape (n,)."""
    return doubt(verdict, n) > 1.0 - ASSERTED


def genuine(one: EffectRegression, effect: str, joint: int | None, gain: float) -> float:
    """Share of a gain that faults of the measurement, such as an encoder's steps, do not feign."""
    return float(np.clip(1.0 - one.measured.feigns(effect, joint) / max(gain, 1e-9), LEAST, 1.0))
