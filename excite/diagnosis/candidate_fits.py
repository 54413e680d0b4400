"""Columns of many candidates, fitted one by one on top of a joint regression."""

from __future__ import annotations

import itertools
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
class CandidateBatch:
    """Columns of many candidates over the same rows.

    Attributes:
        parts: Columns of each candidate among the S columns of all.
        prior: Prior precision of the coefficient of each column, shape (S,).
        values: Columns that act on each joint, rows at standstill zero, shapes (N, S_j).
        places: Places of these columns among all, shapes (S_j,).
        squares: Products of the columns of each candidate over the rows of each joint, without
            weights, shapes (n, k, k).
    """

    parts: tuple[slice, ...]
    prior: FloatArray
    values: tuple[FloatArray, ...]
    places: tuple[IntArray, ...]
    squares: tuple[FloatArray, ...]

    @classmethod
    def of(cls, candidates: Sequence[Columns], moving: BoolArray) -> CandidateBatch:
        """Return the batch of some candidates.

        Args:
            candidates: Their columns.
            moving: Rows that count for each joint, shape (N, n).
        """
        ends = np.cumsum([0, *(c.count for c in candidates)]).tolist()
        parts = tuple(slice(first, last) for first, last in itertools.pairwise(ends))
        squares = tuple(np.zeros((moving.shape[1], c.count, c.count)) for c in candidates)
        values, places = [], []
        for j, rows in enumerate(moving.T):
            acting = [i for i, c in enumerate(candidates) if j in c.joints]
            of_joint = [candidates[i].values[candidates[i].joints.index(j)] for i in acting]
            values.append(np.hstack([np.zeros((len(rows), 0)), *of_joint]))
            values[-1] *= rows[:, None]
            places.append(np.concatenate([np.arange(0), *(np.r_[parts[i]] for i in acting)]))
            first = 0
            for i in acting:
                part = values[-1][:, first : first + candidates[i].count]
                squares[i][j] = part.T @ part
                first += candidates[i].count
        prior = np.concatenate([c.prior_std**-2.0 for c in candidates])
        return cls(parts, prior, tuple(values), tuple(places), squares)
