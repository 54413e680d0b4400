"""Encoder error: a position error that is periodic in the angle, as by an eccentric disc."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import MOTION_BANDWIDTH_RATIO, Grid
from .effect import (
    CandidateModel,
    Effect,
    NonlinearParameter,
    grid_candidates,
    within,
)
from .recorded_motion import Motions, RecordedMotion, radian

MAX_AMPLITUDE = 0.1
"""Largest plausible error of an encoder [rad], see `recorded_motion.radian`."""
ORDERS = (0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0)
"""Orders of single waves of the grid [1/rad], a factor of √2 apart; the order is optimised between
two. An eccentric disc errs once a turn, its pattern a few times; higher orders are sought in the
residual."""
ORDERS_WITH_MULTIPLES = (1.0, 1.6, 2.5, 4.0)
"""Orders of the grid of waves with multiples [1/rad], which have no gaps between them."""
MULTIPLES = {"twice": 2, "thrice": 3}
"""Multiples of the order that may be fitted jointly, by their key in the values."""
ALIAS_ORDER_RATIO = 1.5
"""Order of a wave with multiples over that of another for which it may be mistaken: two of its
three waves lie close to two of the other's."""
ALIAS_ORDER_FACTOR = 1.25
"""Factor within which the order is optimised there."""


class _EncoderError(Effect):
    """Torque by a position error δ: −(∂τ/∂q δ + (∂τ/∂q̇ + F_v) δ̇ + (M + I_a) δ̈)."""

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        joint, robot = model.joint_index, motion.fitted_robot
        by_q, by_v, mass = (matrix[:, :, joint, None] for matrix in motion.derivatives)
        multiples = [1, *(k for key, k in MULTIPLES.items() if key in model.values)]
        orders = [k * model.values["order"] for k in multiples]
        q = motion.coarse_samples.q[:, joint]
        error = np.array([f(order * q) for order in orders for f in (np.cos, np.sin)]).T
        spectrum = motion.band.transform(error, Grid.COARSE)
        first, second = (
            spectrum.filter(Grid.COARSE, derivative, MOTION_BANDWIDTH_RATIO)
            for derivative in (1, 2)
        )
        torque = by_q * error[:, None] + by_v * first[:, None] + mass * second[:, None]
        torque[:, joint] += (
            robot.actuator_parameter("rotor_inertia")[joint] * second
            + robot.actuator_parameter("viscous")[joint] * first
        )
        return -motion.lowpass(torque, Grid.COARSE)

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        """Yield single waves, and waves with their multiples.

        The torque of a wave grows with the square of its order, so that the multiples of an
        eccentric disc's error matter. Orders above those of the grid are sought in the residual.
        """
        unit = radian(motions, joint)
        for grid, multiples in ((ORDERS, ()), (ORDERS_WITH_MULTIPLES, MULTIPLES)):
            orders = (np.array(grid) / unit).tolist()
            values = {"order": orders[0], **dict.fromkeys(multiples, 1.0)}
            model = CandidateModel(self, joint, values, facts={"unit": unit})
            yield from grid_candidates(model, "order", orders)

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        amplitudes = np.hypot(c[::2], c[1::2])
        return bool(amplitudes.max() < MAX_AMPLITUDE * model.facts["unit"])

    def variants(self, model: CandidateModel) -> list[NonlinearParameter]:
        if not MULTIPLES.keys() <= model.values.keys():
            return []
        alias = model.with_values(order=ALIAS_ORDER_RATIO * model.values["order"])
        return [within(alias, "order", ALIAS_ORDER_FACTOR)]


ENCODER_ERROR = _EncoderError(
    "encoder_error",
    "q + ε cos(kq + φ), with its multiples",
    {"amplitude": "rad", "order": "1/turn"},
    "once or a few times a turn, growing with the square of speed",
    "constant speeds, slow and fast, over a turn",
    regime="order",
    max_models=2,
    form_std={"amplitude": 0.4, "order": 0.4},
)
"""Periodic encoder error; users call it encoder eccentricity or sensor ripple."""


def high_order(
    joint: int, unit: float, order: float, width: float, alternatives: float
) -> CandidateModel:
    """Return a wave of an order above those of the grid, as of the encoder of a geared motor.

    Order and the width within which it may be optimised are those of a peak in the spectrum of the
    residual, of `alternatives` orders [1/rad or 1/m]; `unit` is `recorded_motion.radian`.
    """
    model = CandidateModel(
        ENCODER_ERROR, joint, {"order": order}, facts={"unit": unit}, alternatives=alternatives
    )
    return NonlinearParameter(model, "order", order, order - width, order + width).current
