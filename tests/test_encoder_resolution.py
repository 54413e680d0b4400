"""Delays that a coarse encoder hides at reversals are not reported."""

from __future__ import annotations

import types
from collections.abc import Sequence
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from excite.effects import EFFECTS_BY_NAME
from excite.effects.effect import CandidateModel
from excite.effects.recorded_motion import RecordedMotion


class ReversingMotion:
    """Three joints with encoders of one resolution: with reversals at `turns` rad/s², at a quarter
    of it, and without reversals."""

    reversal_dwell = RecordedMotion.reversal_dwell

    def __init__(self, step: float, turns: float) -> None:
        t = np.arange(0.0, 20.0, 0.004)
        speed, most = (
            np.column_stack([np.sin(t), 0.25 * np.sin(t), np.ones_like(t)]),
            np.array([turns, turns, 0.0]),
        )
        accelerations = np.column_stack([np.cos(t), 0.25 * np.cos(t), np.zeros_like(t)])
        self.n, self.steps, self.torque, self.widths = (
            3,
            np.full(3, step),
            np.ones((len(t), 3)),
            np.full(3, 0.004),
        )
        self.samples = types.SimpleNamespace(dq=turns * speed, ddq=most * accelerations)
        self.fitted_robot = types.SimpleNamespace(actuator_parameter=lambda kind: np.ones(3))
        self.motion_cache: dict[object, object] = {}


def shapes(effect: str, tracks: Sequence[Any]) -> list[CandidateModel]:
    return list(EFFECTS_BY_NAME[effect].candidates(tracks))


def first_order_delays(tracks: Sequence[Any]) -> list[CandidateModel]:
    """Return the delays of either sign: those that are neither lags nor far from first order."""
    return [shape for shape in shapes("delay", tracks) if set(shape.values) == {"measured"}]


ENCODERS = {"bits": st.integers(10, 20), "turns": st.floats(0.5, 20.0)}


@given(**ENCODERS)
def test_dwell_time_at_a_reversal_follows_from_step_and_acceleration(bits, turns):
    step = 2.0 * np.pi / 2**bits
    dwell = np.sqrt(2.0 * step / turns)  # q = q̈ t²/2
    np.testing.assert_allclose(
        ReversingMotion(step, turns).reversal_dwell, [dwell, 2.0 * dwell, np.inf], rtol=1e-3
    )


@given(**ENCODERS)
def test_delays_below_the_dwell_time_are_implausible(bits, turns):
    """The sharpest reversal decides; negative delays need a larger size."""
    motion = ReversingMotion(2.0 * np.pi / 2**bits, turns)
    hidden = float(motion.reversal_dwell[0])
    delays = first_order_delays([motion, motion])
    assert {shape.joint for shape in delays} == {0, 1, 2}
    for shape in delays:
        plausible = {
            part: shape.is_plausible(np.array([part * hidden]))
            for part in (0.09, 0.11, 0.29, -0.11, -0.29, -0.31)
        }
        assert plausible == {
            0.09: False,
            0.11: True,
            0.29: True,
            -0.11: False,
            -0.29: False,
            -0.31: True,
        }


def test_a_fine_encoder_hides_no_delay():
    small = np.array([1e-5])
    assert all(
        shape.is_plausible(small) for shape in first_order_delays([ReversingMotion(0.0, 3.0)])
    )
