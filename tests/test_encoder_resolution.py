"""What an encoder's steps hide of how a joint turns back, and what is not told for that."""

from __future__ import annotations

import types
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excite.effects import EFFECTS_BY_NAME
from excite.effects.effect import CandidateModel
from excite.effects.friction import RESOLVED_SPEED_RATIO
from excite.effects.recorded_motion import RecordedMotion

Array = np.ndarray


class Turning:
    """Joints that turn back at so many rad/s², a quarter of it, and never, behind encoders of one
    step."""

    def __init__(self, step: float, turns: float) -> None:
        t = np.arange(0.0, 20.0, 0.004)
        speed, most = (
            np.column_stack([np.sin(t), 0.25 * np.sin(t), np.ones_like(t)]),
            np.array([turns, turns, 0.0]),
        )
        hastens = np.column_stack([np.cos(t), 0.25 * np.cos(t), np.zeros_like(t)])
        self.n, self.steps, self.torque, self.widths = (
            3,
            np.full(3, step),
            np.ones((len(t), 3)),
            np.full(3, 0.004),
        )
        self.samples = types.SimpleNamespace(dq=turns * speed, ddq=most * hastens)
        self.fitted_robot = types.SimpleNamespace(actuator_parameter=lambda kind: np.ones(3))
        self.reversal_dwell: Array = vars(RecordedMotion)["reversal_dwell"].compute(self)


def shapes(effect: str, tracks: Sequence[Any]) -> list[CandidateModel]:
    return list(EFFECTS_BY_NAME[effect].candidates(tracks))


STEPS = {"bits": st.integers(10, 20), "turns": st.floats(0.5, 20.0)}


@given(**STEPS)
def test_a_joint_stays_within_a_step_for_as_long_as_it_takes_to_fall_through_it(bits, turns):
    step = 2.0 * np.pi / 2**bits
    long = np.sqrt(2.0 * step / turns)  # q = q̈ t²/2
    np.testing.assert_allclose(
        Turning(step, turns).reversal_dwell, [long, 2.0 * long, np.inf], rtol=1e-3
    )


@given(**STEPS)
def test_no_delay_is_told_that_an_encoder_hides(bits, turns):
    """By the joint that turns back the most sharply; torque that seems early, sooner."""
    track = Turning(2.0 * np.pi / 2**bits, turns)
    hidden = float(track.reversal_dwell[0])
    delays = [shape for shape in shapes("delay", [track, track]) if "measured" in shape.values]
    assert {shape.joint for shape in delays} == {None, 0, 1, 2}
    for shape in delays:
        told = {
            part: shape.is_plausible(np.array([part * hidden]))
            for part in (0.09, 0.11, 0.29, -0.11, -0.29, -0.31)
        }
        assert told == {
            0.09: False,
            0.11: True,
            0.29: True,
            -0.11: False,
            -0.29: False,
            -0.31: True,
        }


@pytest.mark.parametrize("effect", ["delay", "stribeck", "nonlinear_viscous"])
def test_fine_encoders_hide_nothing(effect):
    small = np.array([1e-5])
    assert all(
        s.is_plausible(small)
        for s in shapes(effect, [Turning(0.0, 3.0)])
        if "seconds" not in s.values
    )


@given(**STEPS)
def test_friction_that_changes_at_speeds_which_an_encoder_does_not_tell_has_no_name(bits, turns):
    """Stribeck's that fades there, and a power that has risen to half there."""
    track = Turning(2.0 * np.pi / 2**bits, turns)
    least, fastest = (
        RESOLVED_SPEED_RATIO * track.steps / track.reversal_dwell,
        np.abs(track.samples.dq).max(axis=0),
    )
    for factor in (0.9, 1.1):
        for shape in shapes("stribeck", [track]):
            assert shape.nonlinear is not None
            if least[shape.joint_index] > 0.0:  # the joint turns back
                assert shape.nonlinear.at(factor * least[shape.joint_index]).is_plausible(
                    np.array([0.1])
                ) == (factor > 1.0)
        for shape in shapes("nonlinear_viscous", [track]):
            assert shape.nonlinear is not None
            if 0.0 < factor * least[shape.joint_index] < fastest[shape.joint_index]:
                power = np.log(0.5) / np.log(
                    factor * least[shape.joint_index] / fastest[shape.joint_index]
                )
                assert shape.nonlinear.at(power).is_plausible(np.array([0.1])) == (factor > 1.0)
