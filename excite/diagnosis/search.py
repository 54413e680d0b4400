"""Fitting every shape of the catalogue beside the base model, on each of two recording sets, judging it on the other.

Frisch & Waugh (1933): with the base refit, a shape's columns count by what the base cannot say of them. All Gram products
are formed once; any set of shapes is then a small least-squares problem. What is known from one set about the base and the effect
enters the other as a prior, so that a prediction is no better trusted than what it was learnt from: the gain is a difference of
log p(y₂ | y₁) + log p(y₁ | y₂), each the quotient of two marginal likelihoods of a linear model (e.g. Bishop 2006, 3.5).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..effects.effect import CandidateModel
from .columns import Columns
from .gram import AddedProducts, Gram, grown, powers
from .half import Half, facing, stacked
from .measured import Measured

Array = np.ndarray
Build = Callable[[CandidateModel], tuple[Columns, Columns] | None]
"""A shape's columns over the scale at the recorded rows of both halves; None where it says nothing."""
Built = tuple[CandidateModel, tuple[Columns, Columns]]
USUAL = 30.0
"""Standard deviation of an effect's torque over the noise, before anything is seen: what is looked for is 1 to 100."""
NATS = 25.0
"""Held-out log-likelihood that a name must gain: the most in 51 simulated robots with nothing missing and fine encoders is 16. More by the
root of how many times a shape is doubted: what gains most of these, a base's springs where a clock wavers, gains 43."""
STEPPED = 100.0
"""The same, beyond that, of noise that is all an encoder's steps: they are in a law's columns and the residual alike. What no steps drawn
anew feign gains 57 at the most, in 46 simulated robots with coarse encoders and nothing missing."""


@dataclass(frozen=True)
class EffectRegression:
    """Two halves with all shapes' columns, and the products that fits are made of.

    places: of each shape's columns. both: the halves stacked. columns: of each half, at its recorded rows. left: the residual of each half
    by its own base fit. across: torque of the second half less what the first half's base fit makes of it. facing: see `half.facing`.
    grams: of each half, the base fitted to it; whole: of both, the base fitted to both. power: of each shape, the mean products of its
    columns in `whole`, per joint, Shape (n, k, k). measured: how well. listed: all shapes that there were, before the best were picked.
    turned: a shape where it predicts best, by itself and those that it is beside: it is asked for again and again.
    """

    shapes: tuple[CandidateModel, ...]
    places: tuple[slice, ...]
    halves: tuple[Half, Half]
    both: Half
    columns: tuple[Columns, Columns]
    residual: tuple[Array, Array]
    across: Array
    facing: tuple[Array, Array]
    grams: tuple[Gram, Gram]
    whole: Gram
    power: tuple[Array, ...]
    prior: Array
    build: Build
    measured: Measured = field(default_factory=Measured)
    listed: tuple[CandidateModel, ...] = ()
    turned: dict[tuple[object, ...], CandidateModel] = field(default_factory=dict, compare=False)

    @cached_property
    def loudest(self) -> float:
        """RMS of what the base model leaves over the scale, on the joint where it is most."""
        return float(np.sqrt(level(self, ()).max()))

    def bar(self, i: int) -> float:
        """Gain from which a shape is believed: more where faults of the measurement look like it."""
        shape = self.shapes[i]
        return self.unfeigned_bar(i) + self.measured.feigns(shape.effect, shape.joint)

    def unfeigned_bar(self, i: int) -> float:
        """The same where nothing looks like it: more where steps blur its columns too."""
        shape = self.shapes[i]
        return float(np.sqrt(shape.threshold_factor) * NATS + shape.threshold_factor * STEPPED * self.measured.stepped)

    @cached_property
    def usual(self) -> Array:
        """Standard deviation of every coefficient before anything is seen. Shape (K,)."""
        return np.asarray(1.0 / np.sqrt(np.maximum(self.prior, 1e-300)))

    def products(self, a: Array, b: Array) -> Array:
        """Products of columns with columns, of either half and of both, in units of what is usual. Shapes (…), (…) -> (3, …)."""
        return np.stack([gram.matrix[a, b] for gram in (*self.grams, self.whole)]) * (
            self.usual[a] * self.usual[b]
        )

    def scores(self, a: Array) -> Array:
        """The same of columns with the residual. Shapes (…) -> (3, …)."""
        return np.stack([gram.score[a] for gram in (*self.grams, self.whole)]) * self.usual[a]

    def which(self, chosen: Sequence[int]) -> Array:
        """Columns of several shapes."""
        return np.array(
            [k for i in chosen for k in range(self.places[i].start, self.places[i].stop)], int
        )

    @cached_property
    def by_width(self) -> list[tuple[Array, Array]]:
        """Shapes of as many columns as each other, and these. Shapes (s,), (s, k) each."""
        widths, starts = (
            np.array(x, int)
            for x in ([p.stop - p.start for p in self.places], [p.start for p in self.places])
        )
        same = [(width, np.flatnonzero(widths == width)) for width in np.unique(widths)]
        return [(which, starts[which][:, None] + np.arange(width)) for width, which in same]

    def split(self, chosen: Sequence[int], coefficients: Array) -> list[Array]:
        """Coefficients of several shapes, shape by shape."""
        ends = np.cumsum([self.places[i].stop - self.places[i].start for i in chosen])
        return np.split(coefficients, ends[:-1])[: len(chosen)]

    def carried(self, which: Array) -> Array:
        """Columns of the second half less what the first half's base fit makes of them. Shape (m, k)."""
        first, second = self.halves
        part = first.inverse @ first.full(self.columns[0].picked(which).full())
        return np.asarray(self.columns[1].picked(which).full() - second.gamma[second.rows] @ part)


FEW, SEVERAL, BESIDE = 4, 6, 3
"""Shapes of an effect at a joint that are searched, of one that a joint can have several of, and of those looked for beside others; and the
best of each law, if it is not among them."""


def design(halves: tuple[Half, Half], shapes: Sequence[CandidateModel], build: Build) -> EffectRegression:
    """All products that the search needs, of the shapes that say something, the best of each effect at each joint."""
    return filled(bare(halves, build), shapes)


def bare(halves: tuple[Half, Half], build: Build) -> EffectRegression:
    """A design without shapes."""
    (first, second), both = halves, stacked(halves)
    n, carried = int(both.joint.max()) + 1, second.gamma @ (first.inverse @ first.torque)
    columns = (
        Columns.none(int(first.rows.sum()) // n, n),
        Columns.none(int(second.rows.sum()) // n, n),
    )
    a, b, whole = (Gram.none(half.basis.shape[1]) for half in (first, second, both))
    sides = (first.residual, second.residual), (second.torque - carried)[second.rows], facing(halves, both)
    return EffectRegression((), (), halves, both, columns, *sides, (a, b), whole, (), np.zeros(0), build)


def filled(one: EffectRegression, shapes: Sequence[CandidateModel]) -> EffectRegression:
    """A bare design with shapes."""
    return dataclasses.replace(_extended(one, _picked(one, shapes)), listed=tuple(shapes))


def relisted(one: EffectRegression, chosen: Sequence[int], joints: Collection[int | None]) -> EffectRegression:
    """The design with the shapes at some joints that predict best beside those chosen: behind others a shape alone was not the best."""
    if not joints:
        return one
    there = {key(shape) for shape in one.shapes}
    spare = [shape for shape in one.listed if shape.joint in joints and key(shape) not in there]
    return _extended(one, _picked(only(one, chosen), spare, BESIDE))


def relaid(
    one: EffectRegression,
    kept: Sequence[int],
    shapes: Sequence[CandidateModel],
    further: Sequence[CandidateModel],
    listed: Sequence[CandidateModel],
) -> EffectRegression:
    """A design of some of the shapes that there are, then the best of other shapes, and what else is wanted, at its end. listed: all."""
    made = _picked(only(one, ()), shapes)
    return dataclasses.replace(
        appended(_extended(only(one, kept), made), further), listed=tuple(listed)
    )


def rescaled(one: EffectRegression, factor: Array) -> EffectRegression:
    """The same with torque over another scale: what it was, over a factor of each joint. Shape (n,)."""
    weights = [
        np.where(h.rows, factor[h.joint], 1.0) for h in one.halves
    ]  # what was known before has no scale
    first, second = (
        dataclasses.replace(h, gamma=h.gamma * w[:, None], torque=h.torque * w)
        for h, w in zip(one.halves, weights, strict=True)
    )

    def build(shape: CandidateModel) -> tuple[Columns, Columns] | None:
        made = one.build(shape)
        return None if made is None else (made[0].scaled(factor), made[1].scaled(factor))

    columns = one.columns[0].scaled(factor), one.columns[1].scaled(factor)
    return dataclasses.replace(
        _widened(bare((first, second), build), one.shapes, one.places, columns), listed=one.listed
    )


def key(shape: CandidateModel) -> tuple[object, ...]:
    """All that a shape's columns hang on."""
    return (
        shape.effect,
        shape.joint,
        shape.other,
        shape.interval,
        shape.source,
        tuple(sorted(shape.values.items())),
    )


def _picked(one: EffectRegression, shapes: Sequence[CandidateModel], most: int | None = None) -> list[Built]:
    """Of every effect the shapes that predict best beside those that there are, with their columns. most: see `_shortlist`."""
    made, first = list[Built](), len(one.shapes)
    for effect in dict.fromkeys(shape.effect for shape in shapes):
        made += _shortlist(
            appended(one, [shape for shape in shapes if shape.effect == effect]), first, most
        )
    return made


def _shortlist(one: EffectRegression, first: int, most: int | None) -> list[Built]:
    """The shapes of one effect that predict best at each joint, with their columns: their neighbours on the grid say the same.

    They are those from the `first` on, each beside all before it; `most` of a joint.
    """
    predicts = gains(one, range(first))
    taken: dict[int | None, int] = {}
    laws = set[tuple[int | None, frozenset[str]]]()
    kept = []
    for i in (int(k) for k in np.argsort(-predicts, kind="stable") if k >= first):
        shape = one.shapes[i]
        taken[shape.joint] = taken.get(shape.joint, 0) + 1
        law = (
            shape.joint,
            frozenset(shape.values),
        )  # the best of each law at least: turned, it may be better than others' neighbours
        if taken[shape.joint] <= (most or (SEVERAL if shape.allows_several else FEW)) or law not in laws:
            kept.append(_built(one, i))
            laws.add(law)
    return kept


def appended(one: EffectRegression, shapes: Sequence[CandidateModel]) -> EffectRegression:
    """The design with more shapes, at its end; those that say nothing are left out."""
    return _extended(
        one, [(shape, found) for shape in shapes if (found := one.build(shape)) is not None]
    )


def _built(one: EffectRegression, i: int) -> Built:
    """One of the shapes with its columns."""
    which = np.arange(one.places[i].start, one.places[i].stop)
    return one.shapes[i], (one.columns[0].picked(which), one.columns[1].picked(which))


def _extended(one: EffectRegression, built: Sequence[Built]) -> EffectRegression:
    """The same with columns that are there already."""
    if not built:
        return one
    shapes, columns = zip(*built, strict=True)
    ends = np.cumsum([0, *(first.count for first, _ in columns)]).tolist()
    first, second = (
        own[0].beside(own[1:]) if len(own) > 1 else own[0] for own in zip(*columns, strict=True)
    )
    return _widened(
        one, shapes, [slice(a, b) for a, b in itertools.pairwise(ends)], (first, second)
    )


def _widened(
    one: EffectRegression, shapes: Sequence[CandidateModel], places: Sequence[slice], new: tuple[Columns, Columns]
) -> EffectRegression:
    """The same with more shapes, whose columns stand at `places` among the new ones."""
    first, second = (old.beside([own]) for old, own in zip(one.columns, new, strict=True))
    start, wider = one.columns[0].count, _foreseen(one, shapes, places, new)
    basis = np.split(one.both.recorded[0], [len(one.halves[0].recorded[0])])
    power = powers(new, basis, one.both.shares, wider.whole.shadow[:, start:], places)
    return dataclasses.replace(wider, columns=(first, second), power=(*one.power, *power))


def _foreseen(
    one: EffectRegression, shapes: Sequence[CandidateModel], places: Sequence[slice], new: tuple[Columns, Columns]
) -> EffectRegression:
    """The same with all that a trial of more shapes asks for, and no more: not their columns, nor how large they are."""
    alone, together = list[AddedProducts](), list[AddedProducts]()
    for old, own, half, against in zip(one.columns, new, one.halves, one.facing, strict=True):
        products = np.vstack(
            [old.products(own), own.products(own)]
        )  # whichever base they are freed of
        taken, r = own.along(against), half.basis.shape[1]
        alone.append(AddedProducts(products, taken[:, :r].T, taken[:, r]))
        together.append(AddedProducts(products, taken[:, r + 1 : -1].T, taken[:, -1]))
    start, rms = (
        one.columns[0].count,
        np.sqrt((new[0].squares() + new[1].squares()) / len(one.both.joint)),
    )
    return dataclasses.replace(
        one,
        shapes=(*one.shapes, *shapes),
        places=(*one.places, *(slice(start + place.start, start + place.stop) for place in places)),
        grams=(grown(one.grams[0], alone[0]), grown(one.grams[1], alone[1])),
        whole=grown(one.whole, together[0] + together[1]),
        prior=np.concatenate([one.prior, (rms / USUAL) ** 2]),
    )


def pretended(one: EffectRegression, residual: tuple[Array, Array]) -> EffectRegression:
    """The design of recordings whose base fit leaves something else. residual: of each half, over the scale. Shape (m,), recorded rows."""

    def freed(half: Half, own: Array) -> Array:
        return half.free(own[:, None])[half.rows]

    grams = [
        dataclasses.replace(gram, score=columns.along(freed(half, own))[:, 0])
        for gram, half, columns, own in zip(
            one.grams, one.halves, one.columns, residual, strict=True
        )
    ]
    first, second = np.split(freed(one.both, np.concatenate(residual)), [len(residual[0])])
    score = one.columns[0].along(first)[:, 0] + one.columns[1].along(second)[:, 0]
    return dataclasses.replace(
        one, grams=(grams[0], grams[1]), whole=dataclasses.replace(one.whole, score=score)
    )


@dataclass(frozen=True)
class Trial:
    """A set of shapes, fitted. coefficients: on both halves together. halves: on each. gain: log-likelihood of each half given
    the other, both added, beyond the base model's. plausible: whether every part passes its gates. seen: what either half shows of them
    by itself: both marginal likelihoods' logarithms, added, beyond the base model's."""

    shapes: tuple[int, ...]
    coefficients: Array
    halves: tuple[Array, Array]
    gain: float
    is_plausible: bool
    seen: float = 0.0


def trial(one: EffectRegression, chosen: Sequence[int]) -> Trial:
    """Fit the shapes on each half, judge on the other, and once more on both together; no shapes: the base model."""
    which = one.which(chosen)
    told, evidence = _evidence(one.products(which[:, None], which), one.scores(which))
    first, second, c = one.usual[which] * told
    plausible = all(
        bool(one.shapes[i].is_plausible(own))
        for i, own in zip(chosen, one.split(chosen, c), strict=True)
    )
    return Trial(
        tuple(chosen),
        c,
        (first, second),
        float(_predictive(evidence)),
        plausible,
        float(evidence[0] + evidence[1]),
    )


def _evidence(products: Array, scores: Array) -> tuple[Array, Array]:
    """Coefficients (G + I)⁻¹ s, and the logarithm of a marginal likelihood. Shapes (…, k, k), (…, k) -> (…, k), (…)."""
    products = products + np.eye(products.shape[-1])
    told = np.linalg.solve(products, scores[..., None])[..., 0]
    diagonal = np.diagonal(np.linalg.cholesky(products), axis1=-2, axis2=-1)
    return told, 0.5 * np.sum(told * scores, axis=-1) - np.log(diagonal).sum(axis=-1)


def _predictive(evidence: Array) -> Array:
    """log p(y₂ | y₁) + log p(y₁ | y₂) of the evidence of either half and of both. Shape (3, …) -> (…)."""
    return np.asarray(2.0 * evidence[2] - evidence[0] - evidence[1])


def gains(one: EffectRegression, beside: Sequence[int] = ()) -> Array:
    """`Trial.gain` of each shape beside some, all at once. Shape (shapes,)."""
    return fits(one, beside)[0]


def fits(one: EffectRegression, beside: Sequence[int] = ()) -> tuple[Array, list[Array]]:
    """`Trial.gain` of each shape beside some, and its own coefficients on both halves together; all at once: what is beside is eliminated
    once (Schur complement). Shape (shapes,), and (k,) each."""
    which, every = one.which(beside), np.arange(len(one.prior))
    there, own_scores = one.products(which[:, None], which), one.scores(which)
    first = _evidence(there, own_scores)[1]
    factor = np.linalg.cholesky(there + np.eye(len(which)))
    cross, half = (
        np.linalg.solve(factor, one.products(which[:, None], every)),
        np.linalg.solve(factor, own_scores[:, :, None]),
    )
    left = one.scores(every) - np.einsum("hbk,hb->hk", cross, half[:, :, 0])
    out, own = np.zeros(len(one.places)), [np.zeros(0)] * len(one.places)
    for same, columns in one.by_width:
        taken = np.einsum("hbni,hbnj->hnij", cross[:, :, columns], cross[:, :, columns])
        told, evidence = _evidence(
            one.products(columns[:, :, None], columns[:, None, :]) - taken, left[:, columns]
        )
        out[same] = _predictive(first[:, None] + evidence)
        for i, c in zip(same.tolist(), one.usual[columns] * told[2], strict=True):
            own[i] = c
    return out, own


def remaining(one: EffectRegression, chosen: Sequence[int]) -> Array:
    """What is left of both halves' torque when base and shapes are fitted to both, over the scale. Shape (N, n)."""
    which = one.which(chosen)
    columns = np.concatenate([part.picked(which).full() for part in one.columns])
    left = one.both.residual - one.both.free(columns) @ trial(one, chosen).coefficients
    return np.asarray(left[one.both.rows].reshape(-1, int(one.both.joint.max()) + 1))


def level(one: EffectRegression, chosen: Sequence[int]) -> Array:
    """Mean square of what remains on each joint, of the rows that count. Shape (n,)."""
    counts = one.both.counts[one.both.rows].reshape(-1, int(one.both.joint.max()) + 1)
    return mean_square(remaining(one, chosen), counts)


def mean_square(x: Array, counts: Array) -> Array:
    """Of the rows that count. Shapes (N, n) -> (n,)."""
    return np.asarray(np.sum(np.square(x * counts), axis=0) / counts.sum(axis=0))


def refined(one: EffectRegression, chosen: Sequence[int], sweeps: int = 2) -> tuple[EffectRegression, list[int]]:
    """The chosen shapes with the values that a grid had fixed moved to where they predict best, one after the other."""
    return joined(one, chosen, turned(one, chosen, sweeps))


def turned(one: EffectRegression, chosen: Sequence[int], sweeps: int, since: int = 0) -> list[Built]:
    """The same shapes with their columns, of no design yet. since: the first that is moved."""
    now = [_built(one, i) for i in chosen]
    for _ in range(sweeps):
        for place, (shape, _) in enumerate(now):
            if place < since or shape.nonlinear is None:
                continue
            others = now[:place] + now[place + 1 :]
            asked = key(shape), *(key(other) for other, _ in others)
            if asked not in one.turned:
                small = afresh(one, others)
                one.turned[asked] = shape.nonlinear.optimised(
                    lambda other, small=small: _beside(small, other)  # type: ignore[misc]
                )
            best = one.turned[asked]
            columns = None if best.values == shape.values else one.build(best)
            now[place] = now[place] if columns is None else (best, columns)
    return now


def joined(one: EffectRegression, chosen: Sequence[int], now: Sequence[Built]) -> tuple[EffectRegression, list[int]]:
    """The design with shapes that stand for some of its own, those that are others at its end; and where they are then."""
    new = [
        k
        for k, (i, (shape, _)) in enumerate(zip(chosen, now, strict=True))
        if shape is not one.shapes[i]
    ]
    ends = dict(zip(new, itertools.count(len(one.shapes))))
    return _extended(one, [now[k] for k in new]), [ends.get(k, i) for k, i in enumerate(chosen)]


def only(one: EffectRegression, chosen: Sequence[int]) -> EffectRegression:
    """The design with some of its shapes; its halves are not inverted again."""
    return afresh(one, [_built(one, i) for i in chosen])


def afresh(one: EffectRegression, built: Sequence[Built]) -> EffectRegression:
    """A design of the same halves with these shapes."""
    a, b, whole = (Gram.none(half.basis.shape[1]) for half in (*one.halves, one.both))
    first, second = (columns.picked(np.zeros(0, int)) for columns in one.columns)
    nothing = dataclasses.replace(
        one,
        shapes=(),
        places=(),
        columns=(first, second),
        grams=(a, b),
        whole=whole,
        power=(),
        prior=np.zeros(0),
        listed=(),
        turned={},
    )
    return _extended(nothing, built)


def _beside(small: EffectRegression, shape: CandidateModel) -> float:
    """Gain of a shape beside all of a small design's."""
    made = small.build(shape)
    if made is None:
        return -np.inf
    wider = _foreseen(small, [shape], [slice(0, made[0].count)], made)
    found = trial(wider, range(len(wider.shapes)))
    return found.gain if found.is_plausible else -np.inf
