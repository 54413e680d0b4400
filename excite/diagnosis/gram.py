"""Products of columns that a base fit leaves, without forming what it leaves: CᵀC less what the base takes of either."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .columns import Columns

Array = np.ndarray


@dataclass(frozen=True)
class Gram:
    """Products of the columns that a base fit leaves, with each other and with the residual. Shapes (K, K), (K,). shadow: what it takes of
    them, in its basis. Shape (r, K)."""

    matrix: Array
    score: Array
    shadow: Array

    @classmethod
    def none(cls, rank: int) -> Gram:
        """Of no column, beside a base fit of so many."""
        return cls(np.zeros((0, 0)), np.zeros(0), np.zeros((rank, 0)))


@dataclass(frozen=True)
class AddedProducts:
    """New columns of a recording set. products: of all columns, these at the end, with them. Shape (K, k). shadow: what the base takes of
    them, in its basis. Shape (r, k). score: of them with its residual. Shape (k,)."""

    products: Array
    shadow: Array
    score: Array

    def __add__(self, other: AddedProducts) -> AddedProducts:
        """The same of two sets that share a base fit."""
        return AddedProducts(
            self.products + other.products, self.shadow + other.shadow, self.score + other.score
        )


def grown(gram: Gram, new: AddedProducts) -> Gram:
    """Products with further columns, free of the base: CᵀC less what the base takes of either."""
    shadow, old = np.hstack([gram.shadow, new.shadow]), len(gram.matrix)
    cross = new.products - shadow.T @ new.shadow
    matrix = np.empty((len(cross), len(cross)))
    matrix[:old, :old] = gram.matrix
    matrix[:, old:], matrix[old:, :old] = cross, cross[:old].T
    matrix[old:, old:] = 0.5 * (cross[old:] + cross[old:].T)
    return Gram(matrix, np.concatenate([gram.score, new.score]), shadow)


def powers(
    new: Sequence[Columns],
    basis: Sequence[Array],
    shares: Array,
    shadow: Array,
    places: Sequence[slice],
) -> list[Array]:
    """Mean products of each new shape's columns, free of the base, on every joint: the base's share of them is `shadow`, and `shares`
    what that is worth on a joint. basis: of the base fit, at the recorded rows of each set, Shape (m, r). Shapes (n, k, k)."""
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
