"""Friction beyond the speeds of the recordings: a motion faster than those that were fitted."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from diagnosis_cases import diagnosed_with_friction, motions, noise_ratios, parameters
from hypothesis import given
from hypothesis import strategies as st

from excite._types import FloatArray
from excite.diagnosis.diagnosis import Diagnosis
from excite.effects import nonlinear_viscous
from excite.effects.friction_runtime import JointMotion, columns

SHARE = 1.0 / 3.0
"""Speed of the fitted motions over that of the held-out one."""


@cache
def shear_thinning() -> Diagnosis:
    """Return the diagnosis of a joint whose lubricant thins by shear (Eyring), fitted slowly."""

    def friction(q: FloatArray, v: FloatArray) -> FloatArray:
        return 2.0 * np.arcsinh(v / 0.1)

    return diagnosed_with_friction(friction, SHARE)


@pytest.mark.slow
def test_friction_of_slow_motions_holds_at_three_times_their_speed():
    """Along the line through its end, friction was wrong by 100 times the noise there."""
    before, after = noise_ratios(shear_thinning())
    assert parameters(shear_thinning(), "nonlinear_viscous", 0)
    assert before[0] > 50.0
    assert after[0] < 3.0


@given(st.lists(st.floats(0.0, 5.0), min_size=8, max_size=8), st.floats(0.0, 5.0))
def test_friction_does_not_fall_beyond_the_fitted_speeds(curves, viscous):
    c = np.array(curves)
    plain = nonlinear_viscous.NONLINEAR_VISCOUS.dense_model(motions(), 0)
    model = nonlinear_viscous.without_falling(plain, c, viscous)
    top = model.values["top_speed"]
    for speeds in (np.linspace(top, 6.0 * top, 50), np.linspace(-0.1 * top, top, 50)):
        motion = JointMotion(dq=speeds)
        torque = [
            sum(
                a * part.smooth
                for a, part in zip(c, columns(shape.effect, shape.values, motion), strict=True)
            )
            for shape in (plain, model)
        ]
        if speeds[-1] <= top:
            np.testing.assert_array_equal(*torque)  # the fit itself is not changed
        else:
            assert (np.diff(viscous * speeds + torque[1]) > -1e-9 * (1.0 + c.sum())).all()
