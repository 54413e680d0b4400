"""Which shapes predict best together: each name as good as it gets before it is told, replaced or left out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice, takewhile

import numpy as np

from ..effects import EFFECTS_BY_NAME, are_confusable
from . import search
from .hypothesis import (
    CANCELS,
    SMALLEST,
    Hypothesis,
    agrees,
    counts,
    each_size,
    meanwhile,
    name,
    ranked,
    sizes,
    who,
)
from .search import Built, EffectRegression, Trial, trial

Array = np.ndarray
SHARE, SAME, LIKE, MOSTLY, ELSEWHERE = 0.04, 0.02, 0.005, 0.5, 0.5
"""Of the gain so far, what a further effect must add, a further shape of one that is there, and one of a kind that a joint may have several
of, such as a gear's orders: forms are never quite the catalogue's. Of the mean square that others leave, what a further effect may explain
instead. And of what others explain, what may be where it acts, lest all of it has a form there to mend."""
BEYOND, CLEARLY = 0.8, 0.2
"""Of what others leave beyond noise, what a further effect may explain instead too: all but a little, which no law does that only mends
another's form; and over the noise, how much that must be."""
MOST, BENT = 6, 2
"""Shapes, at the most; and those beside which each is tried in other shapes for one more."""
CLOSE, CLOSER, CONTENDERS = 0.6, 0.9, 2
"""Of a name's gain, what another must have to be tuned in its place, and then for all to be tuned with it, which added a tenth of it in
one of 60 trials; and how many are."""
FRONT = 24
"""Effects that are tried in pairs."""


def searched(one: EffectRegression, chosen: list[int]) -> tuple[EffectRegression, list[int]]:
    """Shapes that predict best together: those chosen, then more while each is worth it, all tuned and looked at again."""
    looked, seen = set[int | None](), set[frozenset[int]]()
    for _ in range(2 * MOST):  # one more, or another, each time
        chosen = _replaced(one, chosen)
        if not chosen:
            break
        finer, turned = search.refined(one, chosen, sweeps=1)
        if max(each_size(finer, trial(finer, turned))) <= CANCELS * one.loudest:
            one, chosen = finer, turned
        joints = {one.shapes[i].joint for i in chosen} - {None} - looked
        one = search.relisted(one, chosen, joints)
        looked |= joints
        more = None
        if (
            len(chosen) < MOST and frozenset(chosen) not in seen
        ):  # what was added to these did not stay
            seen.add(frozenset(chosen))
            one, more = _further(one, chosen)
        wider = (
            _replaced(one, chosen) if more is None else more
        )  # what one tuned well needs beside it may be less than before
        if wider == chosen:
            one, wider = _contested(one, chosen)
        if wider == chosen:
            break
        chosen = wider
    return one, chosen


def _tuned(one: EffectRegression, shapes: Sequence[int]) -> tuple[list[Built], Trial | None]:
    """Shapes where they predict best together, and what they do then; None where that is no physics, or the last is none that counts."""
    built = search.turned(one, shapes, 1)
    small = search.afresh(one, built)
    found = trial(small, range(len(built)))
    large = each_size(small, found)
    good = (
        found.is_plausible
        and agrees(small, found)
        and counts(small, found, large)
        and max(large) <= CANCELS * one.loudest
    )
    return built, found if good else None


def _contested(one: EffectRegression, chosen: list[int]) -> tuple[EffectRegression, list[int]]:
    """One of the names that were tuned replaced by another that predicts better when it is tuned as well: a grid has it not at its best."""
    now = trial(one, chosen).gain
    for i in chosen:
        others, told = [k for k in chosen if k != i], one.shapes[i].effect
        rest = trial(one, others).gain
        least = rest + CLOSE * (now - rest)
        rivals = (h for h in ranked(one, tuple(others), name) if h.effect != told)
        for h in islice(takewhile(lambda h, least=least: h.trial.gain > least, rivals), CONTENDERS):  # type: ignore[misc]
            nearly = search.afresh(one, search.turned(one, [*others, h.shape], 1, len(others)))
            if trial(nearly, range(len(chosen))).gain < rest + CLOSER * (now - rest):
                continue
            built, found = _tuned(one, [*others, h.shape])
            lead = -search.NATS if _plainer(h.effect, told) else search.NATS
            if found is None or found.gain < now + lead:
                continue
            finer, instead = search.joined(one, [*others, h.shape], built)
            if not _stays(finer, trial(finer, instead)):
                continue
            again = _tuned(one, chosen)[1]  # the one that is there may get better too
            if again is None or found.gain > again.gain + lead:
                return finer, instead
    return one, chosen


def _plainer(effect: str, other: str) -> bool:
    """Whether an effect is what a trusted prior may simply have wrong, and another is not: no law need be bent to say that a joint has
    friction."""
    return EFFECTS_BY_NAME[effect].prior_only and not EFFECTS_BY_NAME[other].prior_only


def _stays(one: EffectRegression, found: Trial) -> bool:
    """Whether the last of some shapes is believed beside the others, or by itself."""
    others = found.shapes[:-1]
    return _earns(one, others, found, trial(one, others).gain)


def _further(one: EffectRegression, chosen: list[int]) -> tuple[EffectRegression, list[int] | None]:
    """Those chosen and what predicts best beside them, if it is worth it; or beside one of them in another of its shapes: what is told
    alone bends to take what is another's. What is not worth it as a grid has it may be, where all are tuned together."""
    now = trial(one, chosen).gain
    best = list[Trial]()
    for way in (_beside(one, chosen, now), _bent(one, chosen)):
        for number, found in enumerate(way):
            if _earns(one, chosen, found, now):
                return one, list(found.shapes)
            best += [found] if number == 0 else []
    for found in best:
        built, tuned = _tuned(one, found.shapes)
        if tuned is None or tuned.gain < now:
            continue
        finer, wider = search.joined(one, found.shapes, built)
        if _earns(finer, chosen, trial(finer, wider), max(now, trial(finer, wider[:-1]).gain)):
            return finer, wider
    return one, None


def _beside(one: EffectRegression, chosen: list[int], now: float) -> Iterator[Trial]:
    """Those chosen beside one more at the end, the best first. now: their gain."""
    yield from (
        h.trial
        for h in takewhile(lambda h: h.trial.gain > now + search.NATS, ranked(one, tuple(chosen)))
        if h.shows
    )


def _bent(one: EffectRegression, chosen: list[int]) -> Iterator[Trial]:
    """The best of those chosen with one of them in another shape, beside one more at the end."""
    if len(chosen) > BENT:
        return
    found = list[Trial]()
    for i in chosen:
        others = [k for k in chosen if k != i]
        for turned in _siblings(one, i, chosen):
            besides = (
                h
                for h in ranked(one, (*others, turned))
                if h.shows and (h.effect, h.joint) != who(one.shapes[i])
            )
            found += [h.trial for h in islice(besides, 1)]
    if found:
        yield max(found, key=lambda one: one.gain)


def _siblings(one: EffectRegression, i: int, chosen: Sequence[int]) -> list[int]:
    """Other shapes of the same effect at the same joint, not chosen themselves."""
    own = one.shapes[i]
    if own.interval is not None:
        return []
    return [
        k
        for k, shape in enumerate(one.shapes)
        if k not in chosen and who(shape) == who(own) and shape.other == own.other
    ]


def _earns(one: EffectRegression, others: Sequence[int], wider: Trial, rest: float) -> bool:
    """Whether the last of some shapes adds enough to the gain of others, `rest`: a share of it, lest it mend their form, or most of what
    they leave.

    Where they explain the lesser part, a share of that is enough, if the noise is known: else what is left there may be anything. What
    explains nearly all that is left beyond known noise needs no share. A name that is there earns one more shape sooner, and by its share.
    """
    shape, adds = wider.shapes[-1], wider.gain - rest
    there = any(who(one.shapes[i]) == who(one.shapes[shape]) for i in others)
    if not _believed(one, wider, rest):
        return False
    share = (LIKE if there and one.shapes[shape].allows_several else SAME if there else SHARE) * rest
    if adds > share:
        return True
    before, rested, after = (search.level(one, shapes) for shapes in ((), others, wider.shapes))
    acts = np.square(sizes(one, wider, len(others)))
    acts /= max(float(acts.max()), 1e-300)
    taken = np.maximum(before - rested, 0.0)
    # what others explain elsewhere has no form here to mend
    here = float(taken @ acts / max(taken.sum(), 1e-300))
    noise, joint = one.measured.noise, int(np.argmax(acts))
    if noise is not None and here < ELSEWHERE and adds > here * share:
        return True
    if there:
        return False
    if noise is not None and not _mends(one, others, shape):
        beyond = rested[joint] / noise[joint] - 1.0
        if beyond > CLEARLY and after[joint] / noise[joint] - 1.0 < (1.0 - BEYOND) * beyond:
            return True
    return bool(1.0 - after[joint] / rested[joint] > MOSTLY)


def _believed(one: EffectRegression, wider: Trial, rest: float) -> bool:
    """Whether what the last of some shapes adds to a gain `rest` of the others is no noise. What a fault of the measurement may feign is
    believed too, of the usual gain, where another name at its joint is believed and adds less, and nothing beside it: something is there,
    and this says it better."""
    *others, shape = wider.shapes
    adds = wider.gain - rest
    if adds > one.bar(shape):
        return True
    if adds < one.unfeigned_bar(shape):
        return False
    own = one.shapes[shape]
    for h in takewhile(lambda h: h.trial.gain > rest + search.NATS, ranked(one, tuple(others))):
        here = h.joint == own.joint and h.effect != own.effect and h.shows
        if here and h.trial.gain - rest > one.bar(h.shape):
            better = h.trial.gain < wider.gain - search.NATS
            return better and trial(one, [*wider.shapes, h.shape]).gain < wider.gain + search.NATS
    return False


def _mends(one: EffectRegression, others: Sequence[int], shape: int) -> bool:
    """Whether a shape's effect is taken for one that is at its joint already: it could mend that one's form whatever it leaves."""
    own = one.shapes[shape]
    there = {one.shapes[i].effect for i in others if one.shapes[i].joint == own.joint}
    return any(are_confusable(own.effect, other) for other in there)


def _replaced(one: EffectRegression, chosen: list[int]) -> list[int]:
    """Each shape in turn replaced by what predicts best beside the others, or left out where it is not worth it, until none is."""
    for _ in range(3):
        before = list(chosen)
        for i in before:
            others = [k for k in chosen if k != i]
            now = trial(one, [*others, i])
            if not others:  # what stayed when the others went must be believed by itself
                chosen = chosen if _believed(one, now, 0.0) else []
                continue
            if not _earns(one, others, now, trial(one, others).gain):
                chosen = others
                continue
            best = next(ranked(one, tuple(others)), None)
            if best is None or not best.shows:
                continue
            if best.trial.gain > now.gain + (
                search.NATS if _plainer(one.shapes[i].effect, best.effect) else 1e-9
            ):
                chosen = [*others, best.shape]
        if chosen == before:
            break
    return chosen


def begun(one: EffectRegression, alone: Sequence[Hypothesis]) -> tuple[EffectRegression, list[int]]:
    """The single that predicts best, or the best pair where that predicts more than it does when it is tuned: two on a grid may say between
    them what one says off it. alone: singles, the best first."""
    single, pair = [alone[0].shape], _best_pair(one, alone)
    if pair is None:
        return one, single
    finer, tuned = search.refined(one, single, sweeps=1)
    return (finer, tuned) if trial(finer, tuned).gain > trial(one, pair).gain else (one, pair)


def _best_pair(one: EffectRegression, alone: Sequence[Hypothesis]) -> list[int] | None:
    """The pair that predicts best, if it predicts enough better than the best single and both parts are of a size that counts."""
    single = alone[0].trial.gain
    beside = islice(ranked(one, (alone[0].shape,)), FRONT // 2)
    front = list({h.shape: h for h in (*alone[: FRONT // 2], *beside)}.values())
    best: tuple[float, list[int]] | None = None
    for i, a in enumerate(front):
        for b in front[i + 1 :]:
            if meanwhile(one, b.shape, (a.shape,)):
                continue
            found = trial(one, [a.shape, b.shape])
            if not found.is_plausible or (best is not None and found.gain <= best[0]):
                continue
            large = each_size(one, found)
            if (
                large[0] > SMALLEST
                and counts(one, found, large)
                and max(large) <= CANCELS * one.loudest
            ):
                best = (found.gain, [a.shape, b.shape])
    return None if best is None or best[0] - single < max(search.NATS, SHARE * single) else best[1]
