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


@dataclass(frozen=True)
class Beside:
    """New columns of a recording set. products: of all columns, these at the end, with them. Shape (K, k). basis: of the base fit, at the
    recorded rows; left: its residual. Shapes (m, r), (m,)."""

    new: Columns
    products: Array
    basis: Array
    left: Array


def grown(gram: Gram, parts: Sequence[Beside]) -> Gram:
    """Products with further columns, free of the base: CᵀC less what the base takes of either."""
    shadow = np.hstack([gram.shadow, sum((part.new.along(part.basis) for part in parts), start=np.zeros(())).T])
    old, own = len(gram.matrix), shadow[:, len(gram.matrix) :]
    cross = sum((part.products for part in parts), start=np.zeros(())) - shadow.T @ own
    matrix = np.empty((len(cross), len(cross)))
    matrix[:old, :old] = gram.matrix
    matrix[:, old:], matrix[old:, :old] = cross, cross[:old].T
    matrix[old:, old:] = 0.5 * (cross[old:] + cross[old:].T)
    score = sum((part.new.along(part.left[:, None])[:, 0] for part in parts), start=np.zeros(()))
    return Gram(matrix, np.concatenate([gram.score, score]), shadow)


def powers(parts: Sequence[Beside], shares: Array, shadow: Array, places: Sequence[slice]) -> list[Array]:
    """Mean products of each new shape's columns, free of the base, on every joint: the base's share of them is `shadow`, and `shares`
    what that is worth on a joint. Shapes (n, k, k)."""
    joints, samples = parts[0].new.joints, sum(len(part.new.values[0]) for part in parts)
    out = [np.zeros((joints, place.stop - place.start, place.stop - place.start)) for place in places]
    for j in range(joints):
        taken = shares[j] @ shadow
        for power, place in zip(out, places, strict=True):
            power[j] = shadow[:, place].T @ taken[:, place]
        for part in parts:
            which, values = part.new.which[j], part.new.values[j]
            shared = values.T @ part.basis.reshape(-1, joints, len(shadow))[:, j]
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
