"""Encoder error: a position error that is periodic in the angle, as by an eccentric disc."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import Grid
from .effect import (
    HARMONIC_KEYS,
    CandidateModel,
    Effect,
    NonlinearParameter,
    grid_candidates,
    harmonic_columns,
    pair_amplitude,
    variants_within,
)
from .recorded_motion import RecordedMotion, radian

MAX_AMPLITUDE = 0.1
"""Largest plausible error of an encoder [rad], see `recorded_motion.radian`."""
ORDERS = (0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0)
"""Orders of single waves of the grid [1/rad], a factor of √2 apart; the order is optimised between
two. An eccentric disc errs once a turn, its pattern a few times; higher orders are sought in the
residual."""
ORDERS_WITH_MULTIPLES = (1.0, 1.6, 2.5, 4.0)
"""Orders of the grid of waves with multiples [1/rad], which have no gaps between them."""
MULTIPLES = dict.fromkeys(HARMONIC_KEYS.values(), 1.0)
"""Values of a wave with its multiples."""
ALIAS_ORDER_RATIO = 1.5
"""Order of a wave with multiples over that of another for which it may be mistaken: two of its
three waves lie close to two of the other's."""
ALIAS_ORDER_FACTOR = 1.25
"""Factor within which the order is optimised there."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Torque by an error δ of the recorded position: −(∂τ/∂q δ + ∂τ/∂q̇ δ̇ + (M + I_a) δ̈)."""
    joint, robot = model.joint_index, motion.fitted_robot
    by_q, by_v, mass = (matrix[:, :, joint, None] for matrix in motion.derivatives)
    error = harmonic_columns(model.values, motion.coarse_samples.q[:, joint])
    spectrum = motion.band.transform(error, Grid.COARSE)
    first, second = spectrum.filter(Grid.COARSE, 1, 2.0), spectrum.filter(Grid.COARSE, 2, 2.0)
    torque = by_q * error[:, None] + by_v * first[:, None] + mass * second[:, None]
    torque[:, joint] += (
        robot.actuator_parameter("rotor_inertia")[joint] * second
        + robot.actuator_parameter("viscous")[joint] * first
    )
    return -motion.lowpass(torque, Grid.COARSE)


def _family(
    joint: int, unit: float, multiples: Mapping[str, float]
) -> Callable[[float], CandidateModel]:
    """Return the models of a joint by their order, a single wave or one with its multiples.

    Args:
        joint: Index of the joint.
        unit: What `recorded_motion.radian` returns.
        multiples: Multiples of the order that are fitted jointly.
    """

    def model(order: float) -> CandidateModel:
        def variants() -> list[NonlinearParameter]:
            families = [_family(joint, unit, multiples)] if multiples else []
            return variants_within(ALIAS_ORDER_RATIO * order, ALIAS_ORDER_FACTOR, families)

        return CandidateModel(
            "encoder_error",
            joint,
            _columns,
            {"order": order, **multiples},
            parameters=pair_amplitude(order=order),
            is_plausible=lambda c: bool(np.hypot(c[::2], c[1::2]).max() < MAX_AMPLITUDE * unit),
            variants=variants,
        )

    return model


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Single waves, and waves with their multiples.

    The torque of a wave grows with the square of its order, so that the multiples of an eccentric
    disc's error matter. Orders above those of the grid are sought in the residual.
    """
    for j in range(motions[0].n):
        unit = radian(motions, j)
        for orders, multiples in ((ORDERS, {}), (ORDERS_WITH_MULTIPLES, MULTIPLES)):
            yield from grid_candidates(
                (np.array(orders) / unit).tolist(), _family(j, unit, multiples)
            )


def high_order(
    joint: int, unit: float, order: float, width: float, alternatives: float
) -> CandidateModel:
    """Return a wave of an order above those of the grid, as of the encoder of a geared motor.

    Args:
        joint: Index of the joint.
        unit: What `recorded_motion.radian` returns.
        order: Order of a peak in the spectrum of the residual [1/rad or 1/m].
        width: Distance within which the order may be optimised [1/rad or 1/m].
        alternatives: Number of orders that were searched.
    """

    def model(order: float) -> CandidateModel:
        return replace(_family(joint, unit, {})(order), alternatives=alternatives)

    return NonlinearParameter(order, order - width, order + width, model).at(order)


ENCODER_ERROR = Effect(
    "encoder_error",
    "q + ε cos(kq + φ), with its multiples",
    _columns,
    _candidates,
    {"amplitude": "rad", "order": "1/turn"},
    "once or a few times a turn, growing with the square of speed",
    "constant speeds, slow and fast, over a turn",
    form_std={"amplitude": 0.4, "order": 0.4},
)
"""Periodic encoder error; users call it encoder eccentricity or sensor ripple."""
