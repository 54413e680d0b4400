"""Torque columns of one effect in a joint regression."""

from __future__ import annotations

from dataclasses import dataclass

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

    def after(self, first: int) -> Columns:
        """Return the columns from number `first` on."""
        values = tuple(x[:, first:] for x in self.values)
        return Columns(self.joints, values, self.nonnegative[first:], self.prior_std[first:])
