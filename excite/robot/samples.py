"""Sampled joint motion: the input of everything that evaluates the dynamics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Samples:
    """Positions, velocities, accelerations at N times. Shapes (N, n) [rad, rad/s, rad/s²; m for
    prismatic joints]."""

    q: Array
    dq: Array
    ddq: Array

    def __len__(self) -> int:
        return len(self.q)

    def rows(self, which: Array | slice) -> Samples:
        """The samples that `which` selects."""
        return Samples(self.q[which], self.dq[which], self.ddq[which])
