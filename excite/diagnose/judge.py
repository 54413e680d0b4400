"""From fitted shapes to what is asserted: sizes, names, equivalents, probabilities, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .search import Design, Trial, trial

Array = np.ndarray
SMALLEST = 0.45
"""RMS torque of an effect over the noise floor, below which nothing is asserted: clocks, encoders and friction's step are never as the
model has them, and what they leave is about a quarter of the noise."""
NATS = 12.0
"""Held-out log-likelihood that a name must gain."""
ALIKE = 0.04
"""Names whose gain is within this share of the best one's cannot be told apart: forms are never quite the catalogue's."""
ALIKE_NATS = 4.0
SECOND = 0.12
"""Share of the single's gain that a second effect must add."""
THIRD = 0.12
MOST = 6
"""Findings, at the most."""
FRONT = 24
"""Effects that are tried in pairs."""


@dataclass(frozen=True)
class Hypothesis:
    """An effect at a joint in its best shape. size: RMS of its torque over the noise floor, the base refit."""

    effect: str
    joint: int | None
    shape: int
    trial: Trial
    size: float


@dataclass(frozen=True)
class Verdict:
    """chosen: one or two effects fitted together, or none. probability, equivalents: of each. considered: the best alternatives."""

    chosen: tuple[Hypothesis, ...]
    together: Trial | None
    probability: tuple[float, ...]
    equivalents: tuple[tuple[str, ...], ...]
    considered: tuple[Hypothesis, ...]


def singles(one: Design, beside: tuple[int, ...] = ()) -> list[Hypothesis]:
    """Every effect at every joint in its best plausible shape, alone or beside shapes that are there already, the best first."""
    best: dict[tuple[str, int | None], Hypothesis] = {}
    for i, shape in enumerate(one.shapes):
        if i in beside:
            continue
        found = trial(one, [*beside, i])
        key = (shape.effect, shape.joint)
        if (key in best and found.gain <= best[key].trial.gain) or not found.plausible or not agrees(one, found):
            continue
        best[key] = Hypothesis(shape.effect, shape.joint, i, found, size(one, found, slice(-_width(one, i), None)))
    return sorted(best.values(), key=lambda h: -h.trial.gain)


def _width(one: Design, shape: int) -> int:
    return one.places[shape].stop - one.places[shape].start


def size(one: Design, found: Trial, part: slice | None = None) -> float:
    """RMS torque of fitted shapes beyond the base, over the floor, on the joint where it is largest."""
    which, c = one.which(found.shapes), found.coefficients
    if part is not None:
        which, c = which[part], c[part]
    largest = 0.0
    torque = [one.free[k][:, which] @ c for k in (0, 1)]
    for joint in np.unique(one.halves[0].joint[one.halves[0].rows]):
        own = np.concatenate([torque[k][one.halves[k].joint == joint] for k in (0, 1)])
        largest = max(largest, float(np.sqrt(np.mean(own**2))))
    return largest


def agrees(one: Design, found: Trial) -> bool:
    """Whether the two halves say the same of the torque: each half's coefficients explain most of what the other's explain."""
    which = one.which(found.shapes)
    G = sum(one.gram[k][np.ix_(which, which)] for k in (0, 1))
    a, b = found.halves
    power = float(a @ G @ a) * float(b @ G @ b)
    return power > 0.0 and float(a @ G @ b) > 0.5 * np.sqrt(power)


def judged(one: Design) -> Verdict:
    """One name, two, or none."""
    ranked = singles(one)
    if not ranked or not _counts(ranked[0].trial.gain, ranked[0].size):
        return Verdict((), None, (), (), tuple(ranked[:8]))
    best = ranked[0]
    pair = _best_pair(one, ranked)
    if pair is None:
        alike, probability = _equivalents(best, ranked)
        others = tuple(h for h in ranked[1:9] if h.effect not in alike)
        return Verdict((best,), best.trial, (probability,), (alike,), others)
    parts, together = _more(one, *pair)
    notes = [_equivalents_beside(one, parts, k, ranked, together) for k in range(len(parts))]
    order = sorted(range(len(parts)), key=lambda k: -parts[k].trial.gain)
    return Verdict(
        tuple(parts[k] for k in order),
        trial(one, [parts[k].shape for k in order]),
        tuple(notes[k][1] for k in order),
        tuple(notes[k][0] for k in order),
        tuple(ranked[:8]),
    )


def _more(one: Design, parts: tuple[Hypothesis, ...], together: Trial) -> tuple[tuple[Hypothesis, ...], Trial]:
    """Further effects, one at a time, while each predicts enough better and is of a size that counts."""
    while len(parts) < MOST:
        beside = singles(one, tuple(part.shape for part in parts))
        if not beside or beside[0].trial.gain - together.gain < max(NATS, THIRD * together.gain) or beside[0].size < SMALLEST:
            break
        parts, together = (*parts, beside[0]), beside[0].trial
    return parts, together


def _counts(gain: float, size: float) -> bool:
    return gain > NATS and size > SMALLEST


def _best_pair(one: Design, ranked: Sequence[Hypothesis]) -> tuple[tuple[Hypothesis, Hypothesis], Trial] | None:
    """The pair that predicts best, if it predicts enough better than the best single and both parts are of a size that counts."""
    single = ranked[0].trial.gain
    beside = singles(one, (ranked[0].shape,))
    front = list({h.shape: h for h in (*ranked[: FRONT // 2], *beside[: FRONT // 2])}.values())
    best: tuple[float, tuple[Hypothesis, Hypothesis], Trial] | None = None
    for i, a in enumerate(front):
        for b in front[i + 1 :]:
            found = trial(one, [a.shape, b.shape])
            if best is None or found.gain > best[0]:
                width = _width(one, a.shape)
                sizes = size(one, found, slice(0, width)), size(one, found, slice(width, None))
                if found.plausible and min(sizes) > SMALLEST:
                    best = (found.gain, (a, b), found)
    if best is None or best[0] - single < max(NATS, SECOND * single):
        return None
    return best[1], best[2]


def _equivalents(best: Hypothesis, ranked: Sequence[Hypothesis]) -> tuple[tuple[str, ...], float]:
    """Other names that this recording cannot tell from the best, and the probability that the truth is among all of them."""
    margin = max(ALIKE_NATS, ALIKE * best.trial.gain)
    names = [h for h in _per_name(best, ranked) if h.effect != best.effect]
    alike = tuple(h.effect for h in names if h.trial.gain > best.trial.gain - margin)
    return alike, _probability(best.trial.gain, [h.trial.gain for h in names if h.effect not in alike], 1 + len(alike))


def _equivalents_beside(
    one: Design, parts: Sequence[Hypothesis], number: int, ranked: Sequence[Hypothesis], together: Trial
) -> tuple[tuple[str, ...], float]:
    """The same for one of several, the others kept."""
    part, others = parts[number], [p.shape for k, p in enumerate(parts) if k != number]
    rest = [h for h in ranked[:60] if h.shape != part.shape and h.shape not in others]
    again = [Hypothesis(h.effect, h.joint, h.shape, trial(one, [h.shape, *others]), h.size) for h in rest]
    margin = max(ALIKE_NATS, ALIKE * (together.gain - trial(one, others).gain))
    names = [h for h in _per_name(part, again) if h.effect != part.effect and h.trial.plausible]
    alike = tuple(h.effect for h in names if h.trial.gain > together.gain - margin)
    return alike, _probability(together.gain, [h.trial.gain for h in names if h.effect not in alike], 1 + len(alike))


def _per_name(best: Hypothesis, ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
    found: dict[str, Hypothesis] = {}
    for h in ranked:
        if h.effect not in found or h.trial.gain > found[h.effect].trial.gain:
            found[h.effect] = h
    return list(found.values())


def _probability(gain: float, others: Sequence[float], alike: int) -> float:
    """Softmax of held-out gains, as hot as forms differ from the catalogue's."""
    heat = max(2.0, 0.5 * ALIKE * gain)
    weights = np.exp(np.clip((np.array([gain, *others]) - gain) / heat, -60.0, 0.0))
    return float(np.clip(alike * weights[0] / (alike * weights[0] + weights[1:].sum()), 0.5, 0.99))
