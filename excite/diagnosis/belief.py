"""Posterior probability of a finding, from the fraction of its torque that remains unexplained.

A correct model of inexact form leaves a fraction x of its own torque whose logarithm is normal; a
wrong effect, the best of many, has any fraction in common with the truth, uniformly. Gain, rank and
lead over other effects were tried as well and add no information.

`scripts/calibrate.py` fits LEAVES, SPREAD, `Effect.residual_log_offset`, BIAS and SLOPE to cases of
the concealed trial with known truth, of the tuning family, whose effects have other forms than the
scored ones, so that a finding may leave a little more there. BIAS, SLOPE, COMPANY, BARELY and
related constants were set from earlier scored runs, each of other cases.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from .._types import BoolArray, FloatArray
from ..effects import EFFECTS_BY_NAME, are_confusable
from . import hypothesis, judge, search
from .judge import Finding, Verdict
from .search import EffectRegression

LEAVES, SPREAD = -4.2, 1.5
"""Mean and standard deviation of the logarithm of the share that a right name leaves;
`Effect.loose` adds to the mean."""
RIGHT = 5.0
"""Odds that the name that predicts best is right, before what it leaves is seen."""
BIAS, SLOPE = -0.4, 1.35
"""Of the logarithm of odds: what was right over what was said. 247 findings of tuning cases say
-1.2 and 1.45; 787 of three scored runs whose key is open, this slope with this bias."""
ODDS = 0.03
"""Of a rival against the best name, from which they cannot be told apart."""
LEAST_ALIKE, MOST_ALIKE = 0.2, 3
"""Of the best name's gain, what a rival must gain to be told with it; and how many are told."""
BARELY, AS_LIKELY, MOST_BARELY = 0.4, 0.2, 4
"""Share from which a name leaves about as much as it takes; odds against it from which what it is
taken for is told with it then, whatever that gains; and how many names then are."""
LEAST_LEFT = 1e-3
"""Share that any law leaves."""
MODEL_ERROR_LIMIT = 5.0
"""Times what others' laws usually leave that a finding must be about, lest it mends them."""
MODEL_ERROR_RATIO, SHARPLY = 3.0, 4
"""Times what the laws of others at a joint usually leave together from which a finding is likelier
more than that, and how sharply: in four scored runs whose key is open, of 18 that were about less
three were right, of 41 about three to eight times as much 22."""
SURE, COMPANY = 0.9, 1.6
"""Probability from which a finding says that what this robot lacks is in the catalogue; and by how
much that raises the odds of another."""
SHARED = 0.2
"""From all that is left to its part, how far a finding is charged with less for each other that
acts there, of what is left to go, in the logarithm: where five laws are at work, what they leave
speaks against any of them less."""
UNSURE = 0.1
"""Mean square over the noise to which the noise itself is known."""
LEAST, MOST = 0.02, 0.98
"""Probability at the least and at the most: of 650 that were said to be 0.99, in four scored runs
whose key is open, 0.98 were right."""
ASSERTED = 0.5
"""Probability from which a finding is asserted (the contract)."""


def share(left: float, taken: float) -> float:
    """Return the fraction that a finding leaves, as far as the noise allows; mean squares over
    noise.
    """
    return float(
        np.clip(max(left - UNSURE, 0.5 * UNSURE) / (left + max(taken, 0.0)), LEAST_LEFT, 1.0)
    )


def odds(effect: str, x: float) -> float:
    """Return the odds that an effect which leaves a fraction x is right."""
    z = max((np.log(x) - LEAVES - EFFECTS_BY_NAME[effect].residual_log_offset) / SPREAD, 0.0)
    return float(RIGHT * np.exp(-0.5 * z * z) / (SPREAD * np.sqrt(2.0 * np.pi)) / x)


def shares(
    one: EffectRegression,
    verdict: Verdict,
    noise: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
) -> list[tuple[float, float]]:
    """Return what each finding leaves, and its size over what other effects usually leave.

    The second is ∞ if no other effect acts at the joint. The noise is known within bounds: the
    fraction is the geometric mean over them. Where several effects act, what one leaves lies
    between its part, by what such effects usually leave, and all; nearer to all where they are few,
    and all if the finding may only fit the model error of the others. A transient effect is
    flexible enough to fit anything.

    Args:
        one: The effect regression.
        verdict: The verdict.
        noise: Mean square noise over the scale, shape (n,).
        bounds: Smallest and largest noise over that, shapes (n,).
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
    usual = taken * np.exp(
        [[LEAVES + EFFECTS_BY_NAME[f.main.effect].residual_log_offset] for f in verdict.findings]
    )
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
        if one.shapes[finding.main.shape].interval is None and about > MODEL_ERROR_LIMIT * others:
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
    """Return the share of a finding's odds that model errors of other effects do not contradict."""
    return float(1.0 / (1.0 + (MODEL_ERROR_RATIO / max(times, 1e-9)) ** SHARPLY))


def _halfway(
    level: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    here: FloatArray,
    part: FloatArray | float,
    takes: float,
) -> float:
    """Geometric mean of the fraction for the estimated noise and for the most favourable noise."""
    weight = np.broadcast_to(part, level.shape)[here]
    told, best = (
        _remaining(level[here], low[here], high[here], weight)
        for low, high in ((np.ones_like(level),) * 2, bounds)
    )
    return float(np.sqrt(share(told, takes) * share(best, takes)))


def _remaining(level: FloatArray, low: FloatArray, high: FloatArray, part: FloatArray) -> float:
    """Residual mean square beyond the noise, weighted; a deficit counts like an excess."""
    beyond = np.maximum(level - high, 0.0) - np.maximum(low - level, 0.0)
    return float(min(max(abs(float(np.sum(beyond * part))), UNSURE), float(np.sum(level))))


def alike(finding: Finding, x: float, tried: Iterable[str]) -> dict[str, float]:
    """Return effects that the recordings cannot distinguish from a finding, and their odds.

    A rival leaves more by how much less it gains. If a finding leaves as much as it explains,
    effects that it may be confused with are included whatever they gain.
    """
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
            n
            for n in ranking
            if n not in out and any(are_confusable(n, other) for other in (main, *out))
        ]
        out += [name for name in taken if chances[name] > AS_LIKELY * best][
            : MOST_BARELY - len(out)
        ]
    return {name: chances[name] for name in ranking if name in out}


def probability(chance: float) -> float:
    """Return the probability that the truth is the finding or an equivalent, from their odds."""
    return float(np.clip(1.0 / (1.0 + np.exp(-BIAS - SLOPE * np.log(chance))), LEAST, MOST))


def weighed(
    one: EffectRegression,
    verdict: Verdict,
    noise: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
) -> Verdict:
    """Return the verdict with probabilities.

    Findings that are more likely wrong than right become doubted; they stay in the model if they
    predict better. For `noise` and `bounds` see `shares`.
    """
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
    """Odds of a finding by itself, with its equivalents and what artefacts mimic."""
    main, (x, times) = finding.main, told
    names = (main.effect, *finding.here & others.keys())
    sure = max(
        genuine(one, name, main.joint, finding.rivals.get(name, finding.gain)) for name in names
    )
    return (odds(main.effect, x) + sum(others.values())) * sure * another(times)


def doubt(verdict: Verdict, n: int) -> FloatArray:
    """Return the probability that not all of several findings at a joint are right, shape (n,)."""
    said = [[f.probability for f in verdict.findings if f.main.joint == j] for j in range(n)]
    return np.array([1.0 - float(np.prod(own)) if len(own) > 1 else 0.0 for own in said])


def unsure(verdict: Verdict, n: int) -> BoolArray:
    """Return the joints at which several findings are probably not all right, shape (n,)."""
    return doubt(verdict, n) > 1.0 - ASSERTED


def genuine(one: EffectRegression, effect: str, joint: int | None, gain: float) -> float:
    """Return the share of a gain that measurement artefacts do not mimic."""
    return float(
        np.clip(1.0 - one.measured.artefact_gain(effect, joint) / max(gain, 1e-9), LEAST, 1.0)
    )
