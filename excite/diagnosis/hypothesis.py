"""Hypotheses: effects at joints in their best candidate model, their size and consistency."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..effects.effect import CandidateModel
from . import search
from .search import EffectRegression, Trial, trial

ALONE, SMALLEST = 0.24, 0.3
"""RMS torque of an effect over the scale, below which nothing is asserted, alone and beside others:
clocks, encoders and friction's step are never as the model has them. What predicts as much as a
name must, in 280 simulated robots with nothing missing, is 0.21 at the most."""
CANCELS = 5.0
"""Times what the base model leaves that an effect may be beside others."""
ABOVE = 2.0
"""Times the noise in its own columns that an effect must be."""
SEEN = 9.0
"""Log-likelihood, twice, from which a half sees an effect: three standard deviations."""
ACTS = 0.2
"""Of an effect's torque at the joint where it is largest, what another joint must feel of it to be
looked at too."""


@dataclass(frozen=True)
class Hypothesis:
    """An effect at a joint in its best candidate model.

    Attributes:
        effect: Name of the effect.
        joint: Index of the joint; None for no single joint.
        shape: Index of the candidate model.
        trial: Fit of the model, jointly with others.
        size: RMS of its torque over the scale, the base refit.
        shows: Whether that size counts.
    """

    effect: str
    joint: int | None
    shape: int
    trial: Trial
    size: float
    shows: bool


def who(shape: CandidateModel) -> tuple[str, int | None]:
    """Return effect and joint of a candidate model."""
    return shape.effect, shape.joint


def name(shape: CandidateModel) -> str:
    """Return the effect of a candidate model."""
    return shape.effect


def ranked(
    one: EffectRegression,
    beside: tuple[int, ...] = (),
    each: Callable[[CandidateModel], object] = who,
) -> Iterator[Hypothesis]:
    """Yield every effect at every joint in its best plausible model, the best first.

    Args:
        one: The effect regression.
        beside: Models with which each is fitted jointly.
        each: Key of which only the best is wanted, if not effect and joint.
    """
    (predicts, own), done = search.fits(one, beside), set[object]()
    there = {who(one.shapes[i]) for i in beside}
    for i in (int(k) for k in np.argsort(-predicts, kind="stable")):
        shape = one.shapes[i]
        if (
            i in beside
            or each(shape) in done
            or (not shape.allows_several and who(shape) in there)
            or meanwhile(one, i, beside)
        ):
            continue
        if not shape.is_plausible(own[i]):  # nor would it be in a trial, which takes longer
            continue
        found = trial(one, [*beside, i])
        if not found.is_plausible or not agrees(one, found):
            continue
        large = each_size(one, found)
        if not beside or max(large) <= CANCELS * one.largest_rms:
            done.add(each(shape))
            yield Hypothesis(
                shape.effect, shape.joint, i, found, large[-1], counts(one, found, large)
            )


def each_size(one: EffectRegression, found: Trial) -> list[float]:
    """Return the size of each fitted model; models that compensate each other are very large."""
    return [size(one, found, number) for number in range(len(found.shapes))]


def counts(one: EffectRegression, found: Trial, large: Sequence[float]) -> bool:
    """Return True if the last fitted model is large enough, also over the noise in its columns."""
    shape, noise = one.shapes[found.shapes[-1]], one.measured.noise
    own = shape.column_noise(one.split(found.shapes, found.coefficients)[-1])
    known = 1.0 if noise is None or shape.joint is None else float(np.sqrt(noise[shape.joint]))
    least = SMALLEST if len(found.shapes) > 1 else ALONE
    return bool(large[-1] > max(least, ABOVE * own * known))


def meanwhile(one: EffectRegression, i: int, beside: Sequence[int]) -> bool:
    """Return True if a transient model overlaps in time with one at another joint."""
    own = one.shapes[i]
    if own.interval is None:
        return False
    others = [
        one.shapes[k]
        for k in beside
        if one.shapes[k].source == own.source and one.shapes[k].joint != own.joint
    ]
    return any(
        o.interval is not None
        and o.interval[0] < own.interval[1]
        and own.interval[0] < o.interval[1]
        for o in others
    )


def sizes(one: EffectRegression, found: Trial, number: int) -> FloatArray:
    """Return the RMS torque of a fitted model on each joint, projected off the base, shape (n,)."""
    shape, c = found.shapes[number], one.split(found.shapes, found.coefficients)[number]
    return np.asarray(np.sqrt(np.maximum(np.einsum("i,jik,k->j", c, one.power[shape], c), 0.0)))


def size(one: EffectRegression, found: Trial, number: int) -> float:
    """Return that on the joint where it is largest."""
    return float(sizes(one, found, number).max())


def acting(one: EffectRegression, found: Trial, shape: int) -> FloatArray:
    """Return the joints on which a fitted model acts, shape (n,)."""
    where = sizes(one, found, found.shapes.index(shape))
    return np.asarray(where > ACTS * where.max())


def agrees(one: EffectRegression, found: Trial) -> bool:
    """Return True if both folds agree on the torque of the fitted models.

    A fold that does not observe the torque need not agree; a transient effect has no second fold.
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
