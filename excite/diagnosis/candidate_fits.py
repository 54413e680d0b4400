"""Columns of many candidates, fitted one by one on top of a joint regression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from .columns import Columns


@dataclass(frozen=True)
class CandidateFit:
    """Coefficients of additional columns.

    Attributes:
        coefficients: Shape (k,).
        gain: Decrease of the objective, a log-likelihood by the weights of the regression.
        log_gain: Gain of log-likelihood with the variance that remains at each joint, less the cost
            of the prior.
        information: Their information after elimination of all other coefficients, shape (k, k).
        prior: Prior precision of each, shape (k,).
    """

    coefficients: FloatArray
    gain: float
    log_gain: float
    information: FloatArray
    prior: FloatArray

    @property
    def log_occam_factor(self) -> float:
        """Logarithm of the prior volume over what the data leave of it."""
        std = self.prior**-0.5
        return 0.5 * float(np.linalg.slogdet(self.information * np.outer(std, std))[1])


@dataclass(frozen=True)
class CandidateGroup:
    """Candidates with the same number of columns k.

    Attributes:
        members: Numbers of the candidates, shape (m,).
        places: Places of their columns among those of all candidates, shape (m, k).
        squares: Products of the columns of each candidate over the rows of each joint, without
            weights, shape (n, m, k, k).
        prior: Prior precision of each coefficient, shape (m, k).
    """

    members: IntArray
    places: IntArray
    squares: FloatArray
    prior: FloatArray

    def solved(
        self, weights: FloatArray, cross: FloatArray, change: FloatArray, score: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Fit every candidate jointly with the active coefficients of a regression.

        Args:
            weights: Weight of the rows of each joint, shape (n,).
            cross: Information shared by the active coefficients and all columns, shape (a, S).
            change: Change of the active coefficients per unit of each column, shape (a, S).
            score: Gradient of the log-likelihood by the coefficient of each column, shape (S,).

        Returns:
            Coefficients, shape (m, k), and their information after elimination of all other
            coefficients, shape (m, k, k).
        """
        k = self.places.shape[1]
        square = np.tensordot(weights, self.squares, 1)
        square[:, range(k), range(k)] += self.prior
        shared = cross[:, self.places].transpose(1, 2, 0) @ change[:, self.places].swapaxes(0, 1)
        schur = square - shared
        schur = 0.5 * (schur + schur.swapaxes(1, 2))
        values, vectors = np.linalg.eigh(schur)
        largest = np.maximum(np.diagonal(square, 0, 1, 2).max(axis=1), 1e-300)
        kept = values > 1e-9 * largest[:, None]
        along = np.einsum("mkv,mk->mv", vectors, score[self.places])
        along = np.where(kept, along / np.where(kept, values, 1.0), 0.0)
        return np.einsum("mkv,mv->mk", vectors, along), schur


@dataclass(frozen=True)
class JointProducts:
    """Products of the rows of one joint, over its active coefficients and all candidates' columns.

    Attributes:
        active: Places of the coefficients that act on the joint among all active ones, shape (b,).
        matrix: AᵀA of their columns A, shape (b, b).
        score: Aᵀr with the residual r, shape (b,).
        power: rᵀr.
        shared: AᵀX with the columns X of the candidates, shape (b, S).
        target: Xᵀr, shape (S,).
    """

    active: IntArray
    matrix: FloatArray
    score: FloatArray
    power: float
    shared: FloatArray
    target: FloatArray

    def remaining(
        self, group: CandidateGroup, squares: FloatArray, c: FloatArray, moved: FloatArray
    ) -> FloatArray:
        """Return the squared error next to each candidate of a group, shape (m,).

        Args:
            group: The candidates.
            squares: Products XᵀX of each on this joint, shape (m, k, k).
            c: Their coefficients, shape (m, k).
            moved: By how much the active coefficients fall next to each, shape (a, m).
        """
        u = moved[self.active]
        candidates = np.einsum("mk,mkl,ml->m", c, squares, c) - 2.0 * np.sum(
            c * self.target[group.places], axis=1
        )
        along = np.einsum("bmk,mk->bm", self.shared[:, group.places], c)
        others = np.sum(u * (self.matrix @ u - 2.0 * along), axis=0) + 2.0 * self.score @ u
        return np.asarray(self.power + candidates + others)


@dataclass(frozen=True)
class CandidateBatch:
    """Columns of many candidates over the same rows.

    Attributes:
        count: Number of candidates.
        values: Columns that act on each joint, rows at standstill zero, shapes (N, S_j).
        places: Places of these columns among the S columns of all candidates, shapes (S_j,).
        groups: The candidates by number of columns.
    """

    count: int
    values: tuple[FloatArray, ...]
    places: tuple[IntArray, ...]
    groups: tuple[CandidateGroup, ...]

    @classmethod
    def of(cls, candidates: Sequence[Columns], moving: BoolArray) -> CandidateBatch:
        """Return the batch of some candidates.

        Args:
            candidates: Their columns.
            moving: Rows that count for each joint, shape (N, n).
        """
        n = moving.shape[1]
        counts = np.array([c.count for c in candidates], int)
        starts = np.cumsum(counts) - counts
        groups = []
        for k in np.unique(counts).tolist():
            members = np.flatnonzero(counts == k)
            prior = np.array([candidates[i].prior_std ** -2.0 for i in members.tolist()])
            squares = np.zeros((n, len(members), k, k))
            places = starts[members][:, None] + np.arange(k)
            groups.append(CandidateGroup(members, places, squares, prior))
        position = np.empty(len(candidates), int)
        group_of = {}
        for group in groups:
            position[group.members] = np.arange(len(group.members))
            group_of[group.places.shape[1]] = group
        values, of_joint = [], []
        for j in range(n):
            acting = [i for i, c in enumerate(candidates) if j in c.joints]
            places = [np.arange(starts[i], starts[i] + counts[i]) for i in acting]
            of_joint.append(np.concatenate(places) if places else np.zeros(0, int))
            x = np.empty((len(moving), len(of_joint[-1])))
            start = 0
            for i in acting:
                candidate = candidates[i]
                part = x[:, start : start + candidate.count]
                part[:] = candidate.values[candidate.joints.index(j)] * moving[:, j, None]
                group_of[candidate.count].squares[j, position[i]] = part.T @ part
                start += candidate.count
            values.append(x)
        return cls(len(candidates), tuple(values), tuple(of_joint), tuple(groups))
