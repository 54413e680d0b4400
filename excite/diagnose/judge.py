"""From fitted shapes to what is asserted: sizes, names, equivalents, probabilities, or nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, takewhile

import numpy as np

from . import search
from .catalogue import BY_NAME
from .effect import Shape
from .search import Design, Measured, Trial, trial

Array = np.ndarray
SHARE, SAME, LIKE, MOSTLY, NOTHING = 0.04, 0.02, 0.005, 0.5, 0.1
"""Of the gain so far, what a further effect must add, a further shape of one that is there, and one of a kind that a joint may have several
of, such as a gear's orders: forms are never quite the catalogue's. Of the mean square that others leave, what a further effect may explain
instead. And of what others explain, what may be where it acts, if it is to add less."""
BEYOND, CLEARLY = 0.8, 0.2
"""Of what others leave beyond noise, what a further effect may explain instead too: all but a little, which no law does that only mends
another's form; and over the noise, how much that must be."""
SMALLEST = 0.3
"""RMS torque of an effect over the scale, below which nothing is asserted: clocks, encoders and friction's step are never as the
model has them."""
CANCELS = 5.0
"""Times what the base model leaves that an effect may be beside others."""
FEIGNED = 12.0
"""Further gain that an effect needs, over what it gains, at the joint where that is most, from what an encoder's steps drawn anew would
leave: friction reverses more sharply than the smooth motion that is rounded for it, and a few draws don't show the worst (nine times in 13
simulated robots)."""
SEEN = 9.0
"""Log-likelihood, twice, from which a half sees an effect: three standard deviations."""
MOST, BENT = 6, 2
"""Shapes, at the most; and those beside which each is tried in other shapes for one more."""
CLOSE, CONTENDERS = 0.6, 2
"""Of a name's gain, what another must have to be tuned in its place; and how many are."""
ACTS = 0.2
"""Of an effect's torque at the joint where it is largest, what another joint must feel of it to be looked at too."""
FRONT, CONSIDERED = 24, 8
"""Effects that are tried in pairs; and those told beside the findings."""


@dataclass(frozen=True)
class Hypothesis:
    """An effect at a joint in its best shape. size: RMS of its torque over the noise floor, the base refit. shows: whether that counts."""

    effect: str
    joint: int | None
    shape: int
    trial: Trial
    size: float
    shows: bool


@dataclass(frozen=True)
class Finding:
    """What is asserted. parts: its shapes at one joint, the largest first. gain: that it adds to the others. rivals: what other
    names would add in its place. equivalents: those of them that it cannot be told from. probability: that the truth is it or one of these.
    evidence: what that is made of."""

    parts: tuple[Hypothesis, ...]
    gain: float
    rivals: Mapping[str, float]
    equivalents: tuple[str, ...] = ()
    probability: float = 1.0
    evidence: Mapping[str, float] = field(default_factory=dict)

    @property
    def main(self) -> Hypothesis:
        return self.parts[0]


@dataclass(frozen=True)
class Verdict:
    """findings: the largest gain first. doubted: under a name that is likelier wrong than right. together: the parts of both that predict
    better, fitted at once. considered: the best alternatives."""

    findings: tuple[Finding, ...]
    together: Trial | None
    considered: tuple[Hypothesis, ...]
    doubted: tuple[Finding, ...] = ()

    @property
    def named(self) -> tuple[int, ...]:
        """Shapes of what is asserted."""
        return tuple(part.shape for finding in self.findings for part in finding.parts)

    @property
    def chosen(self) -> tuple[Hypothesis, ...]:
        """The main part of each finding."""
        return tuple(finding.main for finding in self.findings)


def _who(shape: Shape) -> tuple[str, int | None]:
    return shape.effect, shape.joint


def _name(shape: Shape) -> str:
    return shape.effect


def ranked(one: Design, beside: tuple[int, ...] = (), each: Callable[[Shape], object] = _who) -> Iterator[Hypothesis]:
    """Every effect at every joint in its best plausible shape, alone or beside shapes that are there already, the best first.

    each: what only the best is wanted of, if not an effect at a joint.
    """
    predicts, done = search.gains(one, beside), set[object]()
    there = {_who(one.shapes[i]) for i in beside}
    for i in (int(k) for k in np.argsort(-predicts, kind="stable")):
        shape = one.shapes[i]
        if i in beside or each(shape) in done or (not shape.several and _who(shape) in there) or _meanwhile(one, i, beside):
            continue
        found = trial(one, [*beside, i])
        if not found.plausible or not agrees(one, found):
            continue
        large = _each(one, found)
        if not beside or max(large) <= CANCELS * one.loudest:
            done.add(each(shape))
            yield Hypothesis(shape.effect, shape.joint, i, found, large[-1], large[-1] > SMALLEST)


def _each(one: Design, found: Trial) -> list[float]:
    """The size of each of the fitted shapes. Far larger than what the base model leaves, they can only take each other off."""
    return [size(one, found, number) for number in range(len(found.shapes))]


def _meanwhile(one: Design, i: int, beside: Sequence[int]) -> bool:
    """Whether a shape lasts for some of the time, and another at another joint is there meanwhile: one touch, not two that fight."""
    own = one.shapes[i]
    if own.interval is None:
        return False
    others = [one.shapes[k] for k in beside if one.shapes[k].source == own.source and one.shapes[k].joint != own.joint]
    return any(o.interval is not None and o.interval[0] < own.interval[1] and own.interval[0] < o.interval[1] for o in others)


def sizes(one: Design, found: Trial, number: int) -> Array:
    """RMS torque of one of the fitted shapes beyond the base, over the floor, on each joint. Shape (n,)."""
    shape, c = found.shapes[number], one.split(found.shapes, found.coefficients)[number]
    return np.asarray(np.sqrt(np.maximum(np.einsum("i,jik,k->j", c, one.power[shape], c), 0.0)))


def size(one: Design, found: Trial, number: int) -> float:
    """The same on the joint where it is largest."""
    return float(sizes(one, found, number).max())


def acting(one: Design, found: Trial, shape: int) -> Array:
    """Joints that feel one of the fitted shapes. Shape (n,)."""
    where = sizes(one, found, found.shapes.index(shape))
    return np.asarray(where > ACTS * where.max())


def agrees(one: Design, found: Trial) -> bool:
    """Whether the two halves say the same of the torque: what both say together, and what each says, explain most of the same in it.

    What a half does not see, it need not know. What happens only then has no second time to be compared with.
    """
    if any(one.shapes[i].interval is not None for i in found.shapes):
        return True
    which = one.which(found.shapes)
    c = found.coefficients
    for gram, own in zip(one.grams, found.halves, strict=True):
        G = gram.matrix[np.ix_(which, which)]
        power = float(c @ G @ c)
        if power > SEEN and float(c @ G @ own) <= 0.5 * np.sqrt(power * float(own @ G @ own)):
            return False
    return True


def warned(
    one: Design, steps: Sequence[tuple[Array, Array]], sharpened: tuple[Array, Array], stepped: float, noise: Array | None
) -> Design:
    """The design that knows what each effect gains from residuals that an encoder alone, drawn anew, or rare samples may leave
    (`search.pretended`); the encoder's share of the noise; and the noise, if it is known from a motion made again."""
    most: dict[str, float] = {}
    for residual, times in (*((own, FEIGNED) for own in steps), (sharpened, 1.0)):
        for h in ranked(search.pretended(one, residual), each=_name):
            most[h.effect] = max(most.get(h.effect, 0.0), times * h.trial.gain)
    return replace(one, measured=Measured(most, stepped, noise))


def judged(one: Design, chosen: Sequence[int] = ()) -> tuple[Design, Verdict]:
    """Names at joints, or none; and the design with the shapes that were found. chosen: shapes to begin with, else the best."""
    if not chosen:
        alone = list(ranked(one))
        counts = [h for h in alone if h.shows and h.trial.gain > one.bar(h.shape)]
        if not counts:
            return one, Verdict((), None, tuple(alone[:CONSIDERED]))
        chosen = _best_pair(one, counts) or [counts[0].shape]
    one, chosen = _searched(one, list(chosen))
    verdict = said(one, chosen)
    named = {(f.main.effect, f.main.joint) for f in verdict.findings}
    others = (h for h in ranked(one) if (h.effect, h.joint) not in named)
    return one, replace(verdict, considered=tuple(islice(others, CONSIDERED)))


def said(one: Design, chosen: Sequence[int]) -> Verdict:
    """What some shapes say together: the findings that they are parts of."""
    if not chosen:
        return Verdict((), None, ())
    together = trial(one, chosen)
    groups: dict[tuple[str, int | None], list[Hypothesis]] = {}
    for number, i in enumerate(chosen):
        shape = one.shapes[i]
        own = Hypothesis(shape.effect, shape.joint, i, trial(one, [i]), size(one, together, number), True)
        groups.setdefault(_who(shape), []).append(own)
    findings = [_finding(one, together, tuple(sorted(parts, key=lambda h: -h.size))) for parts in groups.values()]
    return Verdict(tuple(sorted(findings, key=lambda f: -f.gain)), together, ())


def moved(one: Design, verdict: Verdict, better: Verdict, start: int) -> Verdict:
    """The verdict with the parts of another about the same names, whose shapes stand in a design from `start`."""
    assert better.together is not None
    place = {shape: start + k for k, shape in enumerate(better.together.shapes)}
    parts = {(f.main.effect, f.main.joint): tuple(replace(p, shape=place[p.shape]) for p in f.parts) for f in better.findings}
    findings = tuple(replace(f, parts=parts[f.main.effect, f.main.joint]) for f in verdict.findings)
    return replace(verdict, findings=findings, together=trial(one, [place[shape] for shape in better.together.shapes]))


def without(shapes: Sequence[int], parts: Sequence[Hypothesis]) -> list[int]:
    return [i for i in shapes if all(i != part.shape for part in parts)]


def _searched(one: Design, chosen: list[int]) -> tuple[Design, list[int]]:
    """Shapes that predict best together: those chosen, then more while each is worth it, all tuned and looked at again."""
    looked = set[int | None]()
    for _ in range(MOST):
        chosen = _replaced(one, chosen)
        if not chosen:
            break
        finer, turned = search.refined(one, chosen, sweeps=1)
        if max(_each(finer, trial(finer, turned))) <= CANCELS * one.loudest:
            one, chosen = finer, turned
        joints = {one.shapes[i].joint for i in chosen} - {None} - looked
        one = search.relisted(one, chosen, joints)
        looked |= joints
        more = None
        if len(chosen) < MOST:
            one, more = _further(one, chosen)
        wider = _replaced(one, chosen) if more is None else more  # what one tuned well needs beside it may be less than before
        if wider == chosen:
            one, wider = _contested(one, chosen)
        if wider == chosen:
            break
        chosen = wider
    return one, chosen


def _tuned(one: Design, shapes: Sequence[int]) -> tuple[Design, Trial | None]:
    """Shapes where they predict best together, and what they do then; None where that is no physics, or the last is none that counts."""
    finer, turned = search.refined(one, shapes, sweeps=1)
    found = trial(finer, turned)
    large = _each(finer, found)
    good = found.plausible and agrees(finer, found) and large[-1] > SMALLEST and max(large) <= CANCELS * one.loudest
    return (finer, found) if good else (one, None)


def _contested(one: Design, chosen: list[int]) -> tuple[Design, list[int]]:
    """One of the names that were tuned replaced by another that predicts better when it is tuned as well: a grid has it not at its best.
    As good is good enough for what only a trusted prior can have wrong: no law need be bent to say that a joint has friction."""
    now = trial(one, chosen).gain
    for i in chosen:
        others, name = [k for k in chosen if k != i], one.shapes[i].effect
        least = now - (1.0 - CLOSE) * (now - trial(one, others).gain)
        rivals = (h for h in ranked(one, tuple(others), _name) if h.effect != name)
        for h in islice(takewhile(lambda h, least=least: h.trial.gain > least, rivals), CONTENDERS):  # type: ignore[misc]
            finer, found = _tuned(one, [*others, h.shape])
            plain = BY_NAME[h.effect].prior_only and not BY_NAME[name].prior_only
            if found is not None and found.gain > now + (-search.NATS if plain else search.NATS):
                return finer, list(found.shapes)
    return one, chosen


def _further(one: Design, chosen: list[int]) -> tuple[Design, list[int] | None]:
    """Those chosen and what predicts best beside them, if it is worth it; or beside one of them in another of its shapes: what is told
    alone bends to take what is another's. What is not worth it as a grid has it may be, where both are tuned together."""
    now = trial(one, chosen).gain
    beside, bent = _beside(one, chosen, now), _bent(one, chosen)
    if (found := next((found for found in (*beside, *bent) if _earns(one, chosen, found, now)), None)) is not None:
        return one, list(found.shapes)
    for found in (*beside[:1], *bent):
        finer, tuned = _tuned(one, found.shapes)
        if tuned is not None and _earns(finer, chosen, tuned, now):
            return finer, list(tuned.shapes)
    return one, None


def _beside(one: Design, chosen: list[int], now: float) -> list[Trial]:
    """Those chosen beside one more at the end, the best first. now: their gain."""
    return [h.trial for h in takewhile(lambda h: h.trial.gain > now + search.NATS, ranked(one, tuple(chosen))) if h.shows]


def _bent(one: Design, chosen: list[int]) -> list[Trial]:
    """The best of those chosen with one of them in another shape, beside one more at the end."""
    if len(chosen) > BENT:
        return []
    found = list[Trial]()
    for i in chosen:
        others = [k for k in chosen if k != i]
        for turned in _siblings(one, i, chosen):
            besides = (h for h in ranked(one, (*others, turned)) if h.shows and (h.effect, h.joint) != _who(one.shapes[i]))
            found += [h.trial for h in islice(besides, 1)]
    return [max(found, key=lambda one: one.gain)] if found else []


def _siblings(one: Design, i: int, chosen: Sequence[int]) -> list[int]:
    """Other shapes of the same effect at the same joint, not chosen themselves."""
    own = one.shapes[i]
    if own.interval is not None:
        return []
    return [k for k, shape in enumerate(one.shapes) if k not in chosen and _who(shape) == _who(own) and shape.other == own.other]


def _earns(one: Design, others: Sequence[int], wider: Trial, rest: float) -> bool:
    """Whether the last of some shapes adds enough to the gain of others, `rest`: a share of it, lest it mend their form, or most of what
    they leave.

    Where they explain next to nothing, a share of that is enough, if the noise is known: else what is left there may be anything. What
    explains nearly all that is left beyond known noise needs no share. A name that is there earns one more shape sooner, and by its share.
    """
    shape, adds = wider.shapes[-1], wider.gain - rest
    there = any(_who(one.shapes[i]) == _who(one.shapes[shape]) for i in others)
    if adds < one.bar(shape):
        return False
    share = (LIKE if there and one.shapes[shape].several else SAME if there else SHARE) * rest
    if adds > share:
        return True
    before, rested, after = (search.level(one, shapes) for shapes in ((), others, wider.shapes))
    acts = np.square(sizes(one, wider, len(others)))
    acts /= max(float(acts.max()), 1e-300)
    taken = np.maximum(before - rested, 0.0)
    # others that explain next to nothing where it acts have no form there to mend
    here = float(taken @ acts / max(taken.sum(), 1e-300))
    noise, joint = one.measured.noise, int(np.argmax(acts))
    if noise is not None and here < NOTHING and adds > here * share:
        return True
    if there:
        return False
    if noise is not None and not _mends(one, others, shape):
        beyond = rested[joint] / noise[joint] - 1.0
        if beyond > CLEARLY and after[joint] / noise[joint] - 1.0 < (1.0 - BEYOND) * beyond:
            return True
    return bool(1.0 - after[joint] / rested[joint] > MOSTLY)


def _mends(one: Design, others: Sequence[int], shape: int) -> bool:
    """Whether a shape's effect is taken for one that is at its joint already: it could mend that one's form whatever it leaves."""
    own = one.shapes[shape]
    there = {one.shapes[i].effect for i in others if one.shapes[i].joint == own.joint}
    return any(own.effect in BY_NAME[name].confused or name in BY_NAME[own.effect].confused for name in there)


def _replaced(one: Design, chosen: list[int]) -> list[int]:
    """Each shape in turn replaced by what predicts best beside the others, or left out where it is not worth it, until none is."""
    for _ in range(3):
        before = list(chosen)
        for i in before:
            others = [k for k in chosen if k != i]
            now = trial(one, [*others, i])
            if not others:  # what stayed when the others went must be believed by itself
                chosen = chosen if now.gain > one.bar(i) else []
                continue
            if not _earns(one, others, now, trial(one, others).gain):
                chosen = others
                continue
            best = next(ranked(one, tuple(others)), None)
            if best is not None and best.trial.gain > now.gain + 1e-9 and best.shows:
                chosen = [*others, best.shape]
        if chosen == before:
            break
    return chosen


def _best_pair(one: Design, alone: Sequence[Hypothesis]) -> list[int] | None:
    """The pair that predicts best, if it predicts enough better than the best single and both parts are of a size that counts."""
    single = alone[0].trial.gain
    beside = islice(ranked(one, (alone[0].shape,)), FRONT // 2)
    front = list({h.shape: h for h in (*alone[: FRONT // 2], *beside)}.values())
    best: tuple[float, list[int]] | None = None
    for i, a in enumerate(front):
        for b in front[i + 1 :]:
            if _meanwhile(one, b.shape, (a.shape,)):
                continue
            found = trial(one, [a.shape, b.shape])
            if not found.plausible or (best is not None and found.gain <= best[0]):
                continue
            large = _each(one, found)
            if min(large) > SMALLEST and max(large) <= CANCELS * one.loudest:
                best = (found.gain, [a.shape, b.shape])
    return None if best is None or best[0] - single < max(search.NATS, SHARE * single) else best[1]


def _finding(one: Design, together: Trial, parts: tuple[Hypothesis, ...]) -> Finding:
    """With what other names would gain in its place."""
    others = without(together.shapes, parts)
    effect, rest = parts[0].effect, trial(one, others).gain
    gain = together.gain - rest
    best = {h.effect: h.trial.gain - rest for h in ranked(one, tuple(others), _name) if h.effect != effect}
    return Finding(parts, gain, best)
