"""Whitened equations of a set of recordings: the base model's columns, the torque they explain, and what was known before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .._linear_algebra import factors

Array = np.ndarray


@dataclass(frozen=True)
class Half:
    """Whitened equations of some recordings, and below them what was known before. gamma: base columns. Shape (m + k, p).

    torque: Shape (m + k,). joint: of each row, −1 of the k rows that no recording made. Shape (m + k,). counts: rows that are judged by;
    all else is zero in the others. Shape (m + k,).
    """

    gamma: Array
    torque: Array
    joint: Array
    counts: Array

    @property
    def rows(self) -> Array:
        """Rows that were recorded."""
        return self.joint >= 0

    @cached_property
    def _factors(self) -> tuple[Array, Array]:
        return factors(self.gamma)

    @property
    def basis(self) -> Array:
        """Orthonormal columns that span Γ's. Shape (m + k, r)."""
        return self._factors[0]

    @cached_property
    def recorded(self) -> tuple[Array, Array]:
        """The basis and the residual at the rows that were recorded. Shapes (m, r), (m,)."""
        return self.basis[self.rows], self.residual[self.rows]

    @cached_property
    def shares(self) -> Array:
        """QᵀQ of the basis's rows on each joint. Shape (n, r, r)."""
        own = self.recorded[0].reshape(-1, int(self.joint.max()) + 1, self.basis.shape[1])
        return np.stack([own[:, j].T @ own[:, j] for j in range(own.shape[1])])

    @cached_property
    def inverse(self) -> Array:
        """Γ⁺. Shape (p, m + k)."""
        return np.asarray(self._factors[1] @ self.basis.T)

    def full(self, columns: Array) -> Array:
        """Columns at the recorded rows, with the zeros that they have elsewhere. Shapes (m, k) -> (m + k, k)."""
        out = np.zeros((len(self.joint), columns.shape[1]))
        out[self.rows] = columns
        return out

    def free(self, columns: Array) -> Array:
        """What the base leaves of columns. Shapes (m, k) -> (m + k, k)."""
        full = self.full(columns)
        return np.asarray(full - self.basis @ (self.basis.T @ full))

    @cached_property
    def residual(self) -> Array:
        """Torque that the base leaves. Shape (m + k,)."""
        return np.asarray(self.torque - self.basis @ (self.basis.T @ self.torque))


def whitened(
    base: Sequence[Array],
    torque: Sequence[Array],
    counts: Sequence[Array],
    scale: Array,
    known: tuple[Array, Array],
) -> Half:
    """Rows of several stretches over a scale. base: base columns of each, (N, n, p); torque: what they explain, (N, n); counts: see `Half`.

    known: further rows and their right side, already over their uncertainty. Shapes (k, p), (k,).
    """
    n = len(scale)
    gamma = np.concatenate([b / scale[:, None] for b in base]).reshape(-1, base[0].shape[2])
    left = np.concatenate([t / scale for t in torque]).ravel()
    seen = np.concatenate([c.ravel() for c in counts])
    joint = np.concatenate([np.tile(np.arange(n), len(left) // n), np.full(len(known[1]), -1)])
    every = np.concatenate([seen, np.ones(len(known[1]), bool)])
    return Half(
        np.vstack([gamma * seen[:, None], known[0]]),
        np.concatenate([left * seen, known[1]]),
        joint,
        every,
    )


def stacked(halves: tuple[Half, Half]) -> Half:
    """Both halves, what was known before counted once."""
    first, second = halves
    seen = second.rows
    fields = ("gamma", "torque", "joint", "counts")
    return Half(
        *(np.concatenate([getattr(first, name), getattr(second, name)[seen]]) for name in fields)
    )


def facing(halves: tuple[Half, Half], both: Half) -> tuple[Array, Array]:
    """What a half's columns are multiplied with, at its recorded rows: the basis of its base fit, what that leaves, then those of both
    halves' fit. Shape (m, r + r′ + 2)."""
    basis, left = (np.split(x, [len(halves[0].recorded[1])]) for x in both.recorded)
    first, second = (
        np.column_stack([*half.recorded, *own])
        for half, own in zip(halves, zip(basis, left, strict=True), strict=True)
    )
    return first, second
