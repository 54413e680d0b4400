"""Position-dependent friction: friction that varies with the joint angle."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from .._types import FloatArray
from .effect import (
    CandidateModel,
    Effect,
    grid_candidates,
    pair_amplitude,
    single_joint_columns,
)
from .recorded_motion import RecordedMotion, position_range, radian

ORDERS = (0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6)
"""Orders of single waves [1/rad], a factor of √2 apart: from half of a usual range to where torque
ripple begins; the order is optimised between two."""
ORDERS_OF_THREE = (0.5, 1.0, 2.0)
"""Orders of the first of three waves [1/rad]."""
CURVE_POINTS = 200
"""Positions at which a wave is evaluated to find its mean."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """sgn q̇ times the first waves of a periodic function of position.

    The waves have spatial frequencies "order", 2 "order", … up to "waves" of them. The mean of each
    over the joint's range is subtracted: friction that does not vary there is Coulomb friction.
    """
    values, j = model.values, model.joint_index
    q, sign = motion.samples.q[:, j], motion.sign(j)
    positions = np.linspace(values["low"], values["high"], CURVE_POINTS)
    waves = [
        (f, k * values["order"])
        for k in range(1, int(values["waves"]) + 1)
        for f in (np.cos, np.sin)
    ]
    return single_joint_columns(
        motion,
        j,
        np.array([sign * (f(order * q) - f(order * positions).mean()) for f, order in waves]).T,
    )


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Single waves, and the first three waves of a periodic function."""

    def family(j: int, waves: float) -> Callable[[float], CandidateModel]:
        low, high = position_range(motions, j)

        def model(order: float) -> CandidateModel:
            return CandidateModel(
                "position_friction",
                j,
                _columns,
                {"order": order, "waves": waves, "low": low, "high": high},
                parameters=pair_amplitude(),
            )

        return model

    for j in range(motions[0].n):
        for orders, waves in ((ORDERS, 1.0), (ORDERS_OF_THREE, 3.0)):
            yield from grid_candidates(
                (np.array(orders) / radian(motions, j)).tolist(), family(j, waves)
            )


POSITION_FRICTION = Effect(
    "position_friction",
    "sgn q̇ (a cos kq + b sin kq)",
    _columns,
    _candidates,
    {"amplitude": "N m"},
    "friction depends on where the joint is",
    "the same stroke at shifted positions",
    form_std={"amplitude": 0.5},
)
"""Friction that varies with joint position, as by a misaligned bearing or a tight spot."""
