"""Torque columns stored joint by joint, without the zeros on joints that they do not affect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray, IntArray


@dataclass(frozen=True)
class Columns:
    """Torque columns over the rows of a recording set, sample by sample, joint by joint.

    Attributes:
        which: Indices of the columns that affect each joint, rising, shapes (k_j,).
        values: Values of these columns on each joint, shapes (N, k_j).
        count: Number of all columns, K.
    """

    which: tuple[IntArray, ...]
    values: tuple[FloatArray, ...]
    count: int

    @classmethod
    def none(cls, samples: int, joints: int) -> Columns:
        """Return an empty set of columns."""
        return cls((np.zeros(0, int),) * joints, (np.zeros((samples, 0)),) * joints, 0)

    @classmethod
    def of(cls, torque: FloatArray) -> Columns:
        """Return the columns of a full array, shape (N, n, k)."""
        _, n, k = torque.shape
        felt = [np.arange(k if torque[:, j].any() else 0) for j in range(n)]
        return cls(
            tuple(felt),
            tuple(np.ascontiguousarray(torque[:, j, own]) for j, own in enumerate(felt)),
            k,
        )

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.which)

    @property
    def nbytes(self) -> int:
        """Memory in use [bytes]."""
        return sum(x.nbytes for x in self.values)

    def jointly_with(self, others: Sequence[Columns]) -> Columns:
        """Return these columns, then those of others."""
        every = (self, *others)
        starts = np.cumsum([0, *(one.count for one in every)])
        which = tuple(
            np.concatenate([one.which[j] + s for one, s in zip(every, starts, strict=False)])
            for j in range(self.joints)
        )
        values = tuple(np.hstack([one.values[j] for one in every]) for j in range(self.joints))
        return Columns(which, values, int(starts[-1]))

    def picked(self, places: IntArray) -> Columns:
        """Return some columns in the given order, shape (k,)."""
        to = np.full(self.count, -1)
        to[places] = np.arange(len(places))
        which, values = list[IntArray](), list[FloatArray]()
        for own, x in zip(self.which, self.values, strict=True):
            there = np.flatnonzero(to[own] >= 0)
            there = there[np.argsort(to[own[there]])]
            which.append(to[own[there]])
            values.append(x[:, there])
        return Columns(tuple(which), tuple(values), len(places))

    def scaled(self, factor: FloatArray) -> Columns:
        """Return the columns times a factor of each joint, shape (n,)."""
        return Columns(
            self.which,
            tuple(x * f for x, f in zip(self.values, factor.tolist(), strict=True)),
            self.count,
        )

    def full(self) -> FloatArray:
        """Return the full array with zeros, shape (N n, K)."""
        out = np.zeros((len(self.values[0]), self.joints, self.count))
        for j, (own, x) in enumerate(zip(self.which, self.values, strict=True)):
            out[:, j, own] = x
        return out.reshape(len(out) * self.joints, self.count)

    def along(self, x: FloatArray) -> FloatArray:
        """Return Cᵀ x: (N n, k) -> (K, k)."""
        out, rows = np.zeros((self.count, x.shape[1])), x.reshape(-1, self.joints, x.shape[1])
        for j, (own, values) in enumerate(zip(self.which, self.values, strict=True)):
            if len(own):
                out[own] += values.T @ rows[:, j]
        return out

    def squares(self) -> FloatArray:
        """Return the sum of squares of each column, shape (K,)."""
        out = np.zeros(self.count)
        for own, values in zip(self.which, self.values, strict=True):
            out[own] += np.einsum("nk,nk->k", values, values)
        return out

    def products(self, other: Columns) -> FloatArray:
        """Return Cᵀ D, shape (K, K′)."""
        out = np.zeros((self.count, other.count))
        for own, x, its, y in zip(self.which, self.values, other.which, other.values, strict=True):
            if len(own) and len(its):
                out[np.ix_(own, its)] += x.T @ y
        return out
