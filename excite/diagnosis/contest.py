"""Selection of the set of candidate models that predicts best.

Each effect is optimised before it is accepted, replaced or dropped.
"""

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

SHARE, SAME, LIKE, MOSTLY, ELSEWHERE = 0.04, 0.02, 0.005, 0.5, 0.5
"""Of the gain so far, what a further effect must add, a further shape of one that is there, and one
of a kind that a joint may have several of, such as a gear's orders: forms are never quite the
catalogue's. Of the mean square that others leave, what a further effect may explain instead. And of
what others explain, what may be where it acts, lest all of it has a form there to mend."""
BEYOND, CLEARLY = 0.8, 0.2
"""Of what others leave beyond noise, what a further effect may explain instead too: all but a
little, which no law does that only mends another's form; and over the noise, how much that must be.
"""
MOST, BENT = 6, 2
"""Shapes, at the most; and those beside which each is tried in other shapes for one more."""
CLOSE, CLOSER, CONTENDERS = 0.6, 0.9, 2
"""Of a name's gain, what another must have to be tuned in its place, and then for all to be tuned
with it, which added a tenth of it in one of 60 trials; and how many are."""
FRONT = 24
"""Effects that are tried in pairs."""


def searched(one: EffectRegression, chosen: list[int]) -> tuple[EffectRegression, list[int]]:
    """Extend and improve a set of candidate models until nothing predicts better."""
    looked, seen = set[int | None](), set[frozenset[int]]()
    for _ in range(2 * MOST):  # one more, or another, each time
        chosen = _replaced(one, chosen)
        if not chosen:
            break
        finer, turned = search.refined(one, chosen, sweeps=1)
        if max(each_size(finer, trial(finer, turned))) <= CANCELS * one.largest_rms:
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


def _optimised(one: EffectRegression, shapes: Sequence[int]) -> tuple[list[Built], Trial | None]:
    """Candidate models optimised jointly, and their trial; None if implausible or too small."""
    built = search.optimised(one, shapes, 1)
    small = search.afresh(one, built)
    found = trial(small, range(len(built)))
    large = each_size(small, found)
    good = (
        found.is_plausible
        and agrees(small, found)
        and counts(small, found, large)
        and max(large) <= CANCELS * one.largest_rms
    )
    return built, found if good else None


def _contested(one: EffectRegression, chosen: list[int]) -> tuple[EffectRegression, list[int]]:
    """Replace an effect by a rival that predicts better when it is optimised as well."""
    now = trial(one, chosen).gain
    for i in chosen:
        others, told = [k for k in chosen if k != i], one.shapes[i].effect
        rest = trial(one, others).gain
        least = rest + CLOSE * (now - rest)
        rivals = (h for h in ranked(one, tuple(others), name) if h.effect != told)
        best = takewhile(lambda h, least=least: h.trial.gain > least, rivals)  # type: ignore[misc]
        for h in islice(best, CONTENDERS):
            nearly = search.afresh(one, search.optimised(one, [*others, h.shape], 1, len(others)))
            if trial(nearly, range(len(chosen))).gain < rest + CLOSER * (now - rest):
                continue
            built, found = _optimised(one, [*others, h.shape])
            lead = -search.NATS if _plainer(h.effect, told) else search.NATS
            if found is None or found.gain < now + lead:
                continue
            finer, instead = search.joined(one, [*others, h.shape], built)
            if not _stays(finer, trial(finer, instead)):
                continue
            again = _optimised(one, chosen)[1]  # the one that is there may get better too
            if again is None or found.gain > again.gain + lead:
                return finer, instead
    return one, chosen


def _plainer(effect: str, other: str) -> bool:
    """Tell whether an effect is one that a trusted prior may have wrong, and the other is not."""
    return EFFECTS_BY_NAME[effect].prior_only and not EFFECTS_BY_NAME[other].prior_only


def _stays(one: EffectRegression, found: Trial) -> bool:
    """Tell whether the last of some candidate models is accepted jointly with the others."""
    others = found.shapes[:-1]
    return _earns(one, others, found, trial(one, others).gain)


def _further(one: EffectRegression, chosen: list[int]) -> tuple[EffectRegression, list[int] | None]:
    """Add the best further candidate model, if it is worth it.

    One accepted model may also change its form, since alone it absorbs torque of other effects. A
    model that is not worth it as the grid has it may be when all are optimised jointly.
    """
    now = trial(one, chosen).gain
    best = list[Trial]()
    for way in (_jointly(one, chosen, now), _with_other_form(one, chosen)):
        for number, found in enumerate(way):
            if _earns(one, chosen, found, now):
                return one, list(found.shapes)
            best += [found] if number == 0 else []
    for found in best:
        built, tuned = _optimised(one, found.shapes)
        if tuned is None or tuned.gain < now:
            continue
        finer, wider = search.joined(one, found.shapes, built)
        if _earns(finer, chosen, trial(finer, wider), max(now, trial(finer, wider[:-1]).gain)):
            return finer, wider
    return one, None


def _jointly(one: EffectRegression, chosen: list[int], now: float) -> Iterator[Trial]:
    """Trials of the chosen models with one more, the best first, above the present gain."""
    yield from (
        h.trial
        for h in takewhile(lambda h: h.trial.gain > now + search.NATS, ranked(one, tuple(chosen)))
        if h.shows
    )


def _with_other_form(one: EffectRegression, chosen: list[int]) -> Iterator[Trial]:
    """The best trial with one of the chosen models in another form, and one model more."""
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
    """Other candidate models of the same effect at the same joint."""
    own = one.shapes[i]
    if own.interval is not None:
        return []
    return [
        k
        for k, shape in enumerate(one.shapes)
        if k not in chosen and who(shape) == who(own) and shape.other == own.other
    ]


def _earns(one: EffectRegression, others: Sequence[int], wider: Trial, rest: float) -> bool:
    """Tell whether the last model adds enough to the gain of the others.

    It must add a share of their gain, so that it does not fit the model error of another effect, or
    explain most of what they leave. Where they explain the smaller part, a share of that is enough,
    if the noise is known. A model that explains nearly all beyond known noise needs no share. A
    further model of an accepted effect needs a smaller share.
    """
    shape, adds = wider.shapes[-1], wider.gain - rest
    there = any(who(one.shapes[i]) == who(one.shapes[shape]) for i in others)
    if not _believed(one, wider, rest):
        return False
    share = (
        LIKE if there and one.shapes[shape].allows_several else SAME if there else SHARE
    ) * rest
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
    if noise is not None and not _fits_model_error(one, others, shape):
        beyond = rested[joint] / noise[joint] - 1.0
        if beyond > CLEARLY and after[joint] / noise[joint] - 1.0 < (1.0 - BEYOND) * beyond:
            return True
    return bool(1.0 - after[joint] / rested[joint] > MOSTLY)


def _believed(one: EffectRegression, wider: Trial, rest: float) -> bool:
    """Tell whether the gain of the last model is no noise.

    An effect that a measurement artefact may mimic is accepted too, if another effect at its joint
    is accepted that gains less, and nothing jointly with it.
    """
    *others, shape = wider.shapes
    adds = wider.gain - rest
    if adds > one.bar(shape):
        return True
    if adds < one.bar_without_artefacts(shape):
        return False
    own = one.shapes[shape]
    for h in takewhile(lambda h: h.trial.gain > rest + search.NATS, ranked(one, tuple(others))):
        here = h.joint == own.joint and h.effect != own.effect and h.shows
        if here and h.trial.gain - rest > one.bar(h.shape):
            better = h.trial.gain < wider.gain - search.NATS
            return better and trial(one, [*wider.shapes, h.shape]).gain < wider.gain + search.NATS
    return False


def _fits_model_error(one: EffectRegression, others: Sequence[int], shape: int) -> bool:
    """Tell whether a model's effect is confusable with one at its joint."""
    own = one.shapes[shape]
    there = {one.shapes[i].effect for i in others if one.shapes[i].joint == own.joint}
    return any(are_confusable(own.effect, other) for other in there)


def _replaced(one: EffectRegression, chosen: list[int]) -> list[int]:
    """Replace each model by a better one, or drop it, until nothing changes."""
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
    """Return the best model, or the best pair if it predicts more than the optimised model."""
    single, pair = [alone[0].shape], _best_pair(one, alone)
    if pair is None:
        return one, single
    finer, tuned = search.refined(one, single, sweeps=1)
    return (finer, tuned) if trial(finer, tuned).gain > trial(one, pair).gain else (one, pair)


def _best_pair(one: EffectRegression, alone: Sequence[Hypothesis]) -> list[int] | None:
    """The pair that predicts best, if it predicts enough better than the best single model."""
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
                and max(large) <= CANCELS * one.largest_rms
            ):
                best = (found.gain, [a.shape, b.shape])
    return None if best is None or best[0] - single < max(search.NATS, SHARE * single) else best[1]
