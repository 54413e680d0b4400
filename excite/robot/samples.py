"""Sampled joint motion: the input of everything that evaluates the dynamics."""

from __future__ import annotations

from dataclasses import dataclass

from .._types import BoolArray, FloatArray, IntArray

MIN_TRAVEL = 1e-6
"""Range of positions from which a joint moves, above the rounding errors of filters [rad or m]."""


@dataclass(frozen=True)
class Samples:
    """Positions, velocities and accelerations at N times.

    Attributes:
        q: Shape (N, n) [rad; m for prismatic joints].
        dq: Shape (N, n) [rad/s or m/s].
        ddq: Shape (N, n) [rad/s² or m/s²].
    """

    q: FloatArray
    dq: FloatArray
    ddq: FloatArray

    def __len__(self) -> int:
        return len(self.q)

    def rows(self, which: BoolArray | IntArray | slice) -> Samples:
        """The samples that `which` selects."""
        return Samples(self.q[which], self.dq[which], self.ddq[which])
