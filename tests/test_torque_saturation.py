"""Torque saturation: the loss of torque that its candidate models permit."""

from __future__ import annotations

import types

import numpy as np
import pytest
from diagnosis_cases import motions

from excite.effects import EFFECTS_BY_NAME, torque_saturation


@pytest.mark.parametrize("bend", [1.0, 2.0])
@pytest.mark.parametrize("rests", [False, True])
def test_the_loss_at_usual_torque_is_bounded(bend, rests):
    """Otherwise all torque, with its noise, could be explained as a loss.

    rests: the joint is at rest without load for most of the time.
    """
    motion = motions()[0]
    torque, speed = motion.measured_torque.copy(), motion.samples.dq.copy()
    resting = 2 * len(torque) // 3 if rests else 0
    torque[:resting], speed[:resting] = 1e-3, 0.0
    track = types.SimpleNamespace(
        n=2, measured_torque=torque, motor_torque=torque, samples=types.SimpleNamespace(dq=speed)
    )
    shapes = [
        s
        for s in EFFECTS_BY_NAME["torque_saturation"].candidates([track])
        if s.joint == 0 and s.values.get("bend") == bend
    ]
    usual = float(np.median(np.abs(torque[resting:, 0])))
    assert len(shapes) == 6
    for shape in shapes:
        largest = max(c for c in np.linspace(0.01, 1.2, 120) if shape.is_plausible(np.array([c])))
        lost = torque_saturation.lost_torque(shape.values, np.array([usual]))[0]
        assert largest * lost < 0.31 * usual
