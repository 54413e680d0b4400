"""Position-dependent friction: friction that varies with the joint angle."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Values, grid_candidates
from .joint_torque import JointTorque
from .recorded_motion import FittedRobot, Motions, position_range, radian

ORDERS = (0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6)
"""Orders of single waves [1/rad], a factor of √2 apart: from half of a usual range to where torque
ripple begins; the order is optimised between two."""
ORDERS_OF_THREE = (0.5, 1.0, 2.0)
"""Orders of the first of three waves [1/rad]."""


class _PositionFriction(JointTorque):
    """sgn q̇ times the first waves of a periodic function of position.

    The waves have spatial frequencies "order", 2 "order", … up to "waves" of them. The mean of each
    over the joint's range is subtracted: friction that does not vary there is Coulomb friction.
    Beyond a range of less than a period, several waves have the value at its end.
    """

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        """Yield single waves, and the first three waves of a periodic function."""
        low, high = position_range(motions, joint)
        for grid, waves in ((ORDERS, 1.0), (ORDERS_OF_THREE, 3.0)):
            orders = (np.array(grid) / radian(motions, joint)).tolist()
            values = {"order": orders[0], "waves": waves, "low": low, "high": high}
            yield from grid_candidates(CandidateModel(self, joint, values), "order", orders)

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        return {"amplitude": float(np.hypot(c[0], c[1]))}


POSITION_FRICTION = _PositionFriction(
    "position_friction",
    "sgn q̇ (a cos kq + b sin kq)",
    {"amplitude": "N m"},
    "friction depends on where the joint is",
    "the same stroke at shifted positions",
    regime="position",
    max_models=2,
    form_std={"amplitude": 0.5},
)
"""Friction that varies with joint position, as by a misaligned bearing or a tight spot."""
