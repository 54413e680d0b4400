"""Whitened equations of a set of recordings: the base model's columns, the torque they explain, and what was known before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

Array = np.ndarray
RANK = 1e-8


def inverse(columns: Array) -> Array:
    """Γ⁺ with relative tolerance, columns at unit length. Shapes (m, p) -> (p, m)."""
    size = np.linalg.norm(columns, axis=0)
    size[size <= 1e-9 * size.max(initial=0.0)] = np.inf
    return np.asarray(np.linalg.pinv(columns / size, rcond=RANK) / size[:, None])


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
    def inverse(self) -> Array:
        """Γ⁺. Shape (p, m + k)."""
        return inverse(self.gamma)

    def full(self, columns: Array) -> Array:
        """Columns at the recorded rows, with the zeros that they have elsewhere. Shapes (m, k) -> (m + k, k)."""
        out = np.zeros((len(self.joint), columns.shape[1]))
        out[self.rows] = columns
        return out

    def free(self, columns: Array) -> Array:
        """What the base leaves of columns. Shapes (m, k) -> (m + k, k)."""
        full = self.full(columns)
        return np.asarray(full - self.gamma @ (self.inverse @ full))

    @cached_property
    def left(self) -> Array:
        """Torque that the base leaves. Shape (m + k,)."""
        return np.asarray(self.torque - self.gamma @ (self.inverse @ self.torque))


def whitened(base: Sequence[Array], torque: Sequence[Array], counts: Sequence[Array], scale: Array, known: tuple[Array, Array]) -> Half:
    """Rows of several stretches over a scale. base: base columns of each, (N, n, p); torque: what they explain, (N, n); counts: see `Half`.

    known: further rows and their right side, already over their uncertainty. Shapes (k, p), (k,).
    """
    n = len(scale)
    gamma = np.concatenate([b / scale[:, None] for b in base]).reshape(-1, base[0].shape[2])
    left = np.concatenate([t / scale for t in torque]).ravel()
    seen = np.concatenate([c.ravel() for c in counts])
    joint = np.concatenate([np.tile(np.arange(n), len(left) // n), np.full(len(known[1]), -1)])
    every = np.concatenate([seen, np.ones(len(known[1]), bool)])
    return Half(np.vstack([gamma * seen[:, None], known[0]]), np.concatenate([left * seen, known[1]]), joint, every)


def stacked(halves: tuple[Half, Half]) -> Half:
    """Both halves, what was known before counted once."""
    first, second = halves
    seen = second.rows
    fields = ("gamma", "torque", "joint", "counts")
    return Half(*(np.concatenate([getattr(first, name), getattr(second, name)[seen]]) for name in fields))
