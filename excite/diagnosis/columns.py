"""Torque columns of one effect in a joint regression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray


@dataclass(frozen=True)
class Columns:
    """Torque columns of one effect on the joints that they affect.

    Attributes:
        joints: Indices of these joints, shape (J,).
        values: Torque per unit of each coefficient, one array of shape (N, k) for each joint.
        nonnegative: Coefficients that physics requires to be ≥ 0, shape (k,).
        prior_std: Prior standard deviation of each coefficient, shape (k,).
    """

    joints: tuple[int, ...]
    values: tuple[FloatArray, ...]
    nonnegative: BoolArray
    prior_std: FloatArray

    @property
    def count(self) -> int:
        """Number of columns k."""
        return len(self.nonnegative)

    def last(self, count: int) -> Columns:
        """Return the last columns alone.

        Args:
            count: Their number.
        """
        values = tuple(x[:, -count:] for x in self.values)
        return Columns(self.joints, values, self.nonnegative[-count:], self.prior_std[-count:])

    @classmethod
    def of(
        cls,
        torque: FloatArray,
        nonnegative: BoolArray | None = None,
        prior_std: FloatArray | None = None,
    ) -> Columns:
        """Return the columns of a full array, shape (N, n, k), without joints that are all zero."""
        k = torque.shape[2]
        joints = tuple(int(j) for j in np.flatnonzero(np.abs(torque).max(axis=(0, 2)) > 0.0))
        return cls(
            joints,
            tuple(np.ascontiguousarray(torque[:, j]) for j in joints),
            np.zeros(k, bool) if nonnegative is None else nonnegative,
            np.full(k, np.inf) if prior_std is None else prior_std,
        )
