"""Whitened equations of a fold: base columns, the torque they explain, and the prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .._linear_algebra import factors
from .._types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Half:
    """Whitened equations of some recordings, followed by k rows of the prior.

    Attributes:
        gamma: Base columns, shape (m + k, p).
        torque: Right side, shape (m + k,).
        joint: Joint of each row, −1 for rows of the prior, shape (m + k,).
        counts: Rows that are judged; all others are zero, shape (m + k,).
    """

    gamma: FloatArray
    torque: FloatArray
    joint: IntArray
    counts: BoolArray

    @property
    def rows(self) -> BoolArray:
        """Rows that were recorded."""
        return self.joint >= 0

    @cached_property
    def _factors(self) -> tuple[FloatArray, FloatArray]:
        """Factors of the base columns."""
        return factors(self.gamma)

    @property
    def basis(self) -> FloatArray:
        """Orthonormal basis of the base columns, shape (m + k, r)."""
        return self._factors[0]

    @cached_property
    def recorded(self) -> tuple[FloatArray, FloatArray]:
        """Basis and residual at the recorded rows, shapes (m, r), (m,)."""
        return self.basis[self.rows], self.residual[self.rows]

    @cached_property
    def shares(self) -> FloatArray:
        """Products of the basis's rows on each joint, shape (n, r, r)."""
        own = self.recorded[0].reshape(-1, int(self.joint.max()) + 1, self.basis.shape[1])
        return np.stack([own[:, j].T @ own[:, j] for j in range(own.shape[1])])

    @cached_property
    def inverse(self) -> FloatArray:
        """Pseudo-inverse of the base columns, shape (p, m + k)."""
        return np.asarray(self._factors[1] @ self.basis.T)

    def full(self, columns: FloatArray) -> FloatArray:
        """Return columns with zeros at the rows of the prior: (m, k) -> (m + k, k)."""
        out = np.zeros((len(self.joint), columns.shape[1]))
        out[self.rows] = columns
        return out

    def free(self, columns: FloatArray) -> FloatArray:
        """Return columns projected off the base: (m, k) -> (m + k, k)."""
        full = self.full(columns)
        return np.asarray(full - self.basis @ (self.basis.T @ full))

    @cached_property
    def residual(self) -> FloatArray:
        """Residual of the base fit, shape (m + k,)."""
        return np.asarray(self.torque - self.basis @ (self.basis.T @ self.torque))


def whitened(
    base: Sequence[FloatArray],
    torque: Sequence[FloatArray],
    counts: Sequence[BoolArray],
    scale: FloatArray,
    known: tuple[FloatArray, FloatArray],
) -> Half:
    """Return the equations of several motions over a scale.

    Args:
        base: Base columns of each motion, shapes (N, n, p).
        torque: Their right sides, shapes (N, n).
        counts: Rows that are judged, shapes (N, n).
        scale: Scale of each joint, shape (n,).
        known: Rows of the prior and their right side, shapes (k, p), (k,).
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
    """Return the equations of both folds, with the prior once."""
    first, second = halves
    seen = second.rows
    fields = ("gamma", "torque", "joint", "counts")
    return Half(
        *(np.concatenate([getattr(first, name), getattr(second, name)[seen]]) for name in fields)
    )


def facing(halves: tuple[Half, Half], both: Half) -> tuple[FloatArray, FloatArray]:
    """Return what a fold's columns are multiplied with, shape (m, r + r′ + 2).

    The basis and the residual of its own base fit, then those of the joint fit.
    """
    basis, left = (np.split(x, [len(halves[0].recorded[1])]) for x in both.recorded)
    first, second = (
        np.column_stack([*half.recorded, *own])
        for half, own in zip(halves, zip(basis, left, strict=True), strict=True)
    )
    return first, second
