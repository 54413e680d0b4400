"""Gram matrices of columns projected off the base model, without forming the projected columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from .columns import Columns


@dataclass(frozen=True)
class Gram:
    """Products of projected columns with each other and with the residual.

    Attributes:
        matrix: CᵀC of the projected columns, shape (K, K).
        score: Their products with the residual, shape (K,).
        shadow: Their components along the basis of the base fit, shape (r, K).
    """

    matrix: FloatArray
    score: FloatArray
    shadow: FloatArray

    @classmethod
    def none(cls, rank: int) -> Gram:
        """Return the products of no columns, for a base fit of a given rank."""
        return cls(np.zeros((0, 0)), np.zeros(0), np.zeros((rank, 0)))


@dataclass(frozen=True)
class AddedProducts:
    """Products of new columns of a recording set.

    Attributes:
        products: With all columns, the new ones last, shape (K, k).
        shadow: Components along the basis of the base fit, shape (r, k).
        score: Products with the residual, shape (k,).
    """

    products: FloatArray
    shadow: FloatArray
    score: FloatArray

    def __add__(self, other: AddedProducts) -> AddedProducts:
        """Return the products over two recording sets that share a base fit."""
        return AddedProducts(
            self.products + other.products, self.shadow + other.shadow, self.score + other.score
        )


def grown(gram: Gram, new: AddedProducts) -> Gram:
    """Return the products with further columns, projected off the base."""
    shadow, old = np.hstack([gram.shadow, new.shadow]), len(gram.matrix)
    cross = new.products - shadow.T @ new.shadow
    matrix = np.empty((len(cross), len(cross)))
    matrix[:old, :old] = gram.matrix
    matrix[:, old:], matrix[old:, :old] = cross, cross[:old].T
    matrix[old:, old:] = 0.5 * (cross[old:] + cross[old:].T)
    return Gram(matrix, np.concatenate([gram.score, new.score]), shadow)


def powers(
    new: Sequence[Columns],
    basis: Sequence[FloatArray],
    shares: FloatArray,
    shadow: FloatArray,
    places: Sequence[slice],
) -> list[FloatArray]:
    """Return the mean products of each new model's projected columns on every joint, (n, k, k).

    Args:
        new: New columns of each recording set.
        basis: Basis of the base fit at the recorded rows of each set, shapes (m, r).
        shares: Products of the basis on each joint, shape (n, r, r).
        shadow: Components of the columns along the basis, shape (r, k).
        places: Columns of each model.
    """
    joints, samples = new[0].joints, sum(len(own.values[0]) for own in new)
    out = [
        np.zeros((joints, place.stop - place.start, place.stop - place.start)) for place in places
    ]
    for j in range(joints):
        taken = shares[j] @ shadow
        for power, place in zip(out, places, strict=True):
            power[j] = shadow[:, place].T @ taken[:, place]
        for columns, q in zip(new, basis, strict=True):
            which, values = columns.which[j], columns.values[j]
            shared = values.T @ q.reshape(-1, joints, len(shadow))[:, j]
            for power, place in zip(out, places, strict=True):
                a, b = np.searchsorted(which, (place.start, place.stop))
                if a == b:
                    continue
                own = which[a:b] - place.start
                cross = shared[a:b] @ shadow[:, place]
                power[j][own] -= cross
                power[j][:, own] -= cross.T
                power[j][np.ix_(own, own)] += values[:, a:b].T @ values[:, a:b]
    return [power / max(samples, 1) for power in out]
