"""Fits of candidate models jointly with the base model, on each of two folds, judged on the other.

With the base refit, a model's columns count by their projection off the base (Frisch & Waugh 1933).
All Gram products are formed once; any set of models is then a small least-squares problem. The
posterior of one fold is the prior of the other, so that the gain is a difference of
log p(y₂ | y₁) + log p(y₁ | y₂), each the ratio of two marginal likelihoods of a linear model (e.g.
Bishop 2006, sec. 3.5).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .._types import BoolArray, FloatArray, IntArray
from ..effects.effect import CandidateModel
from .columns import Columns
from .gram import AddedProducts, Gram, grown, powers
from .half import Half, facing, stacked
from .measured import Measured

Scalar = TypeVar("Scalar", bound=np.generic)

Build = Callable[[CandidateModel], tuple[Columns, Columns] | None]
"""A shape's columns over the scale at the recorded rows of both halves; None where it says nothing.
"""
Built = tuple[CandidateModel, tuple[Columns, Columns]]
USUAL = 30.0
"""Standard deviation of an effect's torque over the noise, before anything is seen: what is looked
for is 1 to 100."""
NATS = 25.0
"""Held-out log-likelihood that a name must gain: the most in 51 simulated robots with nothing
missing and fine encoders is 16. More by the root of how many times a shape is doubted: what gains
most of these, a base's springs where a clock wavers, gains 43."""
STEPPED = 100.0
"""The same, beyond that, of noise that is all an encoder's steps: they are in a law's columns and
the residual alike. What no steps drawn anew feign gains 57 at the most, in 46 simulated robots with
coarse encoders and nothing missing."""


@dataclass(frozen=True)
class EffectRegression:
    """Two folds with the columns of all candidate models, and the products that fits are made of.

    Attributes:
        shapes: Candidate models.
        places: Columns of each model.
        halves: Equations of both folds.
        both: Equations of both folds stacked.
        columns: Columns of each fold at its recorded rows.
        residual: Residual of each fold's own base fit.
        across: Torque of the second fold minus the prediction of the first fold's base fit.
        facing: See `half.facing`.
        grams: Products of each fold, projected off its base fit.
        whole: Products of both folds, projected off the joint base fit.
        power: Mean products of each model's columns in `whole` on each joint, shapes (n, k, k).
        prior: Inverse prior variance of each coefficient.
        build: Builds the columns of a model.
        measured: Quality of the measurements.
        listed: All models before the best were picked.
        optimised: Cache of optimised models.
    """

    shapes: tuple[CandidateModel, ...]
    places: tuple[slice, ...]
    halves: tuple[Half, Half]
    both: Half
    columns: tuple[Columns, Columns]
    residual: tuple[FloatArray, FloatArray]
    across: FloatArray
    facing: tuple[FloatArray, FloatArray]
    grams: tuple[Gram, Gram]
    whole: Gram
    power: tuple[FloatArray, ...]
    prior: FloatArray
    build: Build
    measured: Measured = field(default_factory=Measured)
    listed: tuple[CandidateModel, ...] = ()
    optimised: dict[tuple[object, ...], CandidateModel] = field(default_factory=dict, compare=False)

    @cached_property
    def largest_rms(self) -> float:
        """RMS residual of the base model over the scale, on the joint where it is largest."""
        return float(np.sqrt(level(self, ()).max()))

    def bar(self, i: int) -> float:
        """Return the gain from which a model is accepted, with what artefacts mimic."""
        shape = self.shapes[i]
        return self.bar_without_artefacts(i) + self.measured.artefact_gain(
            shape.effect, shape.joint
        )

    def bar_without_artefacts(self, i: int) -> float:
        """Return the same without artefacts; it grows with encoder quantisation."""
        shape = self.shapes[i]
        return float(
            np.sqrt(shape.threshold_factor) * NATS
            + shape.threshold_factor * STEPPED * self.measured.stepped
        )

    @cached_property
    def usual(self) -> FloatArray:
        """Prior standard deviation of every coefficient, shape (K,)."""
        return np.asarray(1.0 / np.sqrt(np.maximum(self.prior, 1e-300)))

    def products(self, a: IntArray, b: IntArray) -> FloatArray:
        """Return products of columns, normalised, of either fold and both: (…), (…) -> (3, …)."""
        return np.stack([gram.matrix[a, b] for gram in (*self.grams, self.whole)]) * (
            self.usual[a] * self.usual[b]
        )

    def scores(self, a: IntArray) -> FloatArray:
        """Return normalised products of columns with the residual: (…) -> (3, …)."""
        return np.stack([gram.score[a] for gram in (*self.grams, self.whole)]) * self.usual[a]

    def which(self, chosen: Sequence[int]) -> IntArray:
        """Return the columns of several models."""
        return np.array(
            [k for i in chosen for k in range(self.places[i].start, self.places[i].stop)], int
        )

    @cached_property
    def by_width(self) -> list[tuple[IntArray, IntArray]]:
        """Models grouped by their number of columns, and these, shapes (s,), (s, k)."""
        widths, starts = (
            np.array(x, int)
            for x in ([p.stop - p.start for p in self.places], [p.start for p in self.places])
        )
        same = [(width, np.flatnonzero(widths == width)) for width in np.unique(widths)]
        return [(which, starts[which][:, None] + np.arange(width)) for width, which in same]

    def split(self, chosen: Sequence[int], coefficients: NDArray[Scalar]) -> list[NDArray[Scalar]]:
        """Return coefficients of several models, model by model."""
        ends = np.cumsum([self.places[i].stop - self.places[i].start for i in chosen])
        return np.split(coefficients, ends[:-1])[: len(chosen)]

    def carried(self, which: IntArray) -> FloatArray:
        """Return the second fold's columns minus the prediction of the first's base fit, shape (m,
        k).
        """
        first, second = self.halves
        part = first.inverse @ first.full(self.columns[0].picked(which).full())
        return np.asarray(self.columns[1].picked(which).full() - second.gamma[second.rows] @ part)


FEW, SEVERAL, BESIDE = 4, 6, 3
"""Shapes of an effect at a joint that are searched, of one that a joint can have several of, and of
those looked for beside others; and the best of each law, if it is not among them."""


def design(
    halves: tuple[Half, Half], shapes: Sequence[CandidateModel], build: Build
) -> EffectRegression:
    """Return the regression of the best models of each effect at each joint."""
    return filled(bare(halves, build), shapes)


def bare(halves: tuple[Half, Half], build: Build) -> EffectRegression:
    """Return a regression without candidate models."""
    (first, second), both = halves, stacked(halves)
    n, carried = int(both.joint.max()) + 1, second.gamma @ (first.inverse @ first.torque)
    columns = (
        Columns.none(int(first.rows.sum()) // n, n),
        Columns.none(int(second.rows.sum()) // n, n),
    )
    a, b, whole = (Gram.none(half.basis.shape[1]) for half in (first, second, both))
    sides = (
        (first.residual, second.residual),
        (second.torque - carried)[second.rows],
        facing(halves, both),
    )
    return EffectRegression(
        (), (), halves, both, columns, *sides, (a, b), whole, (), np.zeros(0), build
    )


def filled(one: EffectRegression, shapes: Sequence[CandidateModel]) -> EffectRegression:
    """Return an empty regression with the best of some models."""
    return dataclasses.replace(_extended(one, _picked(one, shapes)), listed=tuple(shapes))


def relisted(
    one: EffectRegression, chosen: Sequence[int], joints: Collection[int | None]
) -> EffectRegression:
    """Return the regression with further models at some joints, chosen jointly with others."""
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
    """Return a regression of some present models, the best of others, and further ones."""
    made = _picked(only(one, ()), shapes)
    return dataclasses.replace(
        appended(_extended(only(one, kept), made), further), listed=tuple(listed)
    )


def rescaled(one: EffectRegression, factor: FloatArray) -> EffectRegression:
    """Return the regression with torque multiplied by a factor of each joint, shape (n,)."""
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
    """Return all that a model's columns depend on."""
    return (
        shape.effect,
        shape.joint,
        shape.other,
        shape.interval,
        shape.source,
        tuple(sorted(shape.values.items())),
    )


def _picked(
    one: EffectRegression, shapes: Sequence[CandidateModel], most: int | None = None
) -> list[Built]:
    """The best models of every effect jointly with those present, with their columns."""
    made, first = list[Built](), len(one.shapes)
    for effect in dict.fromkeys(shape.effect for shape in shapes):
        made += _shortlist(
            appended(one, [shape for shape in shapes if shape.effect == effect]), first, most
        )
    return made


def _shortlist(one: EffectRegression, first: int, most: int | None) -> list[Built]:
    """The best models of one effect at each joint, from index `first` on, with their columns."""
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
        )  # the best of each law at least: optimised, it may be better than others' neighbours
        if (
            taken[shape.joint] <= (most or (SEVERAL if shape.allows_several else FEW))
            or law not in laws
        ):
            kept.append(_built(one, i))
            laws.add(law)
    return kept


def appended(one: EffectRegression, shapes: Sequence[CandidateModel]) -> EffectRegression:
    """Return the regression with more models at its end; those without torque are left out."""
    return _extended(
        one, [(shape, found) for shape in shapes if (found := one.build(shape)) is not None]
    )


def _built(one: EffectRegression, i: int) -> Built:
    """A model with its columns."""
    which = np.arange(one.places[i].start, one.places[i].stop)
    return one.shapes[i], (one.columns[0].picked(which), one.columns[1].picked(which))


def _extended(one: EffectRegression, built: Sequence[Built]) -> EffectRegression:
    """The regression with more models whose columns are built."""
    if not built:
        return one
    shapes, columns = zip(*built, strict=True)
    ends = np.cumsum([0, *(first.count for first, _ in columns)]).tolist()
    first, second = (
        own[0].jointly_with(own[1:]) if len(own) > 1 else own[0]
        for own in zip(*columns, strict=True)
    )
    return _widened(
        one, shapes, [slice(a, b) for a, b in itertools.pairwise(ends)], (first, second)
    )


def _widened(
    one: EffectRegression,
    shapes: Sequence[CandidateModel],
    places: Sequence[slice],
    new: tuple[Columns, Columns],
) -> EffectRegression:
    """The regression with more models, whose columns are at `places` of the new ones."""
    first, second = (old.jointly_with([own]) for old, own in zip(one.columns, new, strict=True))
    start, wider = one.columns[0].count, _with_products(one, shapes, places, new)
    basis = np.split(one.both.recorded[0], [len(one.halves[0].recorded[0])])
    power = powers(new, basis, one.both.shares, wider.whole.shadow[:, start:], places)
    return dataclasses.replace(wider, columns=(first, second), power=(*one.power, *power))


def _with_products(
    one: EffectRegression,
    shapes: Sequence[CandidateModel],
    places: Sequence[slice],
    new: tuple[Columns, Columns],
) -> EffectRegression:
    """The regression with all that a trial of more models needs, but without their columns."""
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


def pretended(one: EffectRegression, residual: tuple[FloatArray, FloatArray]) -> EffectRegression:
    """Return the regression as if the base fit had left another residual.

    Args:
        one: The effect regression.
        residual: Residual of each fold over the scale, shapes (m,).
    """

    def freed(half: Half, own: FloatArray) -> FloatArray:
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
    """Fit of a set of candidate models.

    Attributes:
        shapes: Indices of the models.
        coefficients: Coefficients fitted to both folds.
        halves: Coefficients fitted to each fold.
        gain: Log-likelihood gain of each fold given the other, summed, over the base model.
        is_plausible: Whether every model is physically possible.
        seen: Log marginal likelihood of both folds, summed, over the base model.
    """

    shapes: tuple[int, ...]
    coefficients: FloatArray
    halves: tuple[FloatArray, FloatArray]
    gain: float
    is_plausible: bool
    seen: float = 0.0


def trial(one: EffectRegression, chosen: Sequence[int]) -> Trial:
    """Fit models to each fold, judge them on the other, and fit them to both."""
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


def _evidence(products: FloatArray, scores: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients (G + I)⁻¹ s and log marginal likelihood: (…, k, k), (…, k) -> (…, k), (…)."""
    products = products + np.eye(products.shape[-1])
    told: FloatArray = np.asarray(np.linalg.solve(products, scores[..., None])[..., 0], np.float64)
    diagonal = np.diagonal(np.linalg.cholesky(products), axis1=-2, axis2=-1)
    return told, 0.5 * np.sum(told * scores, axis=-1) - np.log(diagonal).sum(axis=-1)


def _predictive(evidence: FloatArray) -> FloatArray:
    """log p(y₂ | y₁) + log p(y₁ | y₂) from the evidence of either fold and both: (3, …) -> (…)."""
    return np.asarray(2.0 * evidence[2] - evidence[0] - evidence[1])


def gains(one: EffectRegression, beside: Sequence[int] = ()) -> FloatArray:
    """Return the gain of each model jointly with some others, shape (models,)."""
    return fits(one, beside)[0]


def fits(one: EffectRegression, beside: Sequence[int] = ()) -> tuple[FloatArray, list[FloatArray]]:
    """Return gain and coefficients of each model jointly with some others.

    The others are eliminated once for all models (Schur complement).
    """
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


def remaining(one: EffectRegression, chosen: Sequence[int]) -> FloatArray:
    """Return the residual of both folds of a joint fit, over the scale, shape (N, n)."""
    which = one.which(chosen)
    columns = np.concatenate([part.picked(which).full() for part in one.columns])
    left = one.both.residual - one.both.free(columns) @ trial(one, chosen).coefficients
    return np.asarray(left[one.both.rows].reshape(-1, int(one.both.joint.max()) + 1))


def level(one: EffectRegression, chosen: Sequence[int]) -> FloatArray:
    """Return the mean square of that residual on each joint, shape (n,)."""
    counts = one.both.counts[one.both.rows].reshape(-1, int(one.both.joint.max()) + 1)
    return mean_square(remaining(one, chosen), counts)


def mean_square(x: FloatArray, counts: BoolArray) -> FloatArray:
    """Return the mean square over the rows that count: (N, n) -> (n,)."""
    return np.asarray(np.sum(np.square(x * counts), axis=0) / counts.sum(axis=0))


def refined(
    one: EffectRegression, chosen: Sequence[int], sweeps: int = 2
) -> tuple[EffectRegression, list[int]]:
    """Optimise the nonlinear parameters of chosen models, one after the other."""
    return joined(one, chosen, optimised(one, chosen, sweeps))


def optimised(
    one: EffectRegression, chosen: Sequence[int], sweeps: int, since: int = 0
) -> list[Built]:
    """Return the models so optimised with their columns, from position `since` on."""
    now = [_built(one, i) for i in chosen]
    for _ in range(sweeps):
        for place, (shape, _) in enumerate(now):
            if place < since or shape.nonlinear is None:
                continue
            others = now[:place] + now[place + 1 :]
            asked = key(shape), *(key(other) for other, _ in others)
            if asked not in one.optimised:
                small = afresh(one, others)
                one.optimised[asked] = shape.nonlinear.optimised(
                    lambda other, small=small: _joint_gain(small, other)  # type: ignore[misc]
                )
            best = one.optimised[asked]
            columns = None if best.values == shape.values else one.build(best)
            now[place] = now[place] if columns is None else (best, columns)
    return now


def joined(
    one: EffectRegression, chosen: Sequence[int], now: Sequence[Built]
) -> tuple[EffectRegression, list[int]]:
    """Return the regression with optimised models at its end, and their indices."""
    new = [
        k
        for k, (i, (shape, _)) in enumerate(zip(chosen, now, strict=True))
        if shape is not one.shapes[i]
    ]
    ends = dict(zip(new, itertools.count(len(one.shapes))))
    return _extended(one, [now[k] for k in new]), [ends.get(k, i) for k, i in enumerate(chosen)]


def only(one: EffectRegression, chosen: Sequence[int]) -> EffectRegression:
    """Return the regression with some of its models, without inverting its folds again."""
    return afresh(one, [_built(one, i) for i in chosen])


def afresh(one: EffectRegression, built: Sequence[Built]) -> EffectRegression:
    """Return a regression of the same folds with other models."""
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
        optimised={},
    )
    return _extended(nothing, built)


def _joint_gain(small: EffectRegression, shape: CandidateModel) -> float:
    """Gain of a model jointly with all of a small regression."""
    made = small.build(shape)
    if made is None:
        return -np.inf
    wider = _with_products(small, [shape], [slice(0, made[0].count)], made)
    found = trial(wider, range(len(wider.shapes)))
    return found.gain if found.is_plausible else -np.inf
