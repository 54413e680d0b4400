"""Dry friction that builds up after a reversal: damped bristles, Stribeck friction as well."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from diagnosis_cases import (
    COULOMB,
    RATE,
    diagnosed_with_friction,
    findings_of,
    friction_sign,
    maxwell_slip_force,
    noise_ratios,
    parameters,
)
from slow_tests import slow

from excite._types import FloatArray
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.regression import Columns, JointRegression
from excite.effects import hysteresis, stribeck

HEIGHT, VELOCITY = 1.5, 0.3
BRISTLE_REACH = 0.002
"""Coulomb friction over the stiffness of a bristle [rad]."""
REACHES = np.array([0.004, 0.008, 0.016])
"""Deflections at which the presliding elements slip [rad]."""


def bristle_friction(v: FloatArray, seconds: float) -> FloatArray:
    """Return the friction of a bristle over Coulomb friction [1], z + (σ₁/σ₀) ż (LuGre).

    Args:
        v: Velocity, shape (M,) [rad/s].
        seconds: Damping over stiffness of the bristle, σ₁/σ₀ [s].
    """
    z, substeps = 0.0, 20
    out = np.empty(len(v))
    for k, speed in enumerate(v.tolist()):
        for _ in range(substeps if k else 0):
            rate = (speed - abs(speed) * z) / BRISTLE_REACH
            z += rate / (substeps * RATE)
        out[k] = z + seconds * (speed - abs(speed) * z) / BRISTLE_REACH
    return out


@cache
def of_bristle(seconds: float) -> Diagnosis:
    """Return the diagnosis of a joint whose dry friction is that of a bristle."""

    def friction(q: FloatArray, v: FloatArray) -> FloatArray:
        return COULOMB[0] * (bristle_friction(v, seconds) - friction_sign(v))

    return diagnosed_with_friction(friction)


@pytest.mark.slow
def test_a_bristle_is_presliding_alone():
    """With a first element of 1 mrad, Stribeck and viscous friction were found as well."""
    assert findings_of(of_bristle(0.0)) == [("hysteresis", 0)]


@pytest.mark.slow
def test_a_damped_bristle_is_predicted_better_than_without_damping():
    """Without damping, and with a first element of 1 mrad, 10 times the noise remain."""
    assert noise_ratios(of_bristle(0.01))[1].max() < 4.0


@cache
def diagnosed(builds_up: bool) -> Diagnosis:
    """Return the diagnosis of a joint with presliding, whose Stribeck friction builds up or not."""

    def friction(q: FloatArray, v: FloatArray) -> FloatArray:
        direction, sign = maxwell_slip_force(q, REACHES), friction_sign(v)
        curve = HEIGHT * np.exp(-np.abs(v) / VELOCITY)
        return COULOMB[0] * (direction - sign) + curve * (direction if builds_up else sign)

    return diagnosed_with_friction(friction)


@pytest.mark.parametrize("builds_up", [True, slow(False)])
def test_stribeck_friction_next_to_presliding_is_found(builds_up):
    assert set(findings_of(diagnosed(builds_up))) == {("stribeck", 0), ("hysteresis", 0)}


def test_friction_that_builds_up_is_predicted_to_the_noise():
    """With Stribeck friction that follows the sign of the speed, 12 times the noise remain."""
    result = diagnosed(True)
    assert noise_ratios(result)[1].max() < 1.3
    assert parameters(result, "stribeck", 0)["amplitude"][0] == pytest.approx(HEIGHT, rel=0.1)


@pytest.mark.parametrize("builds_up", [True, slow(False)])
def test_the_saved_friction_builds_up_only_where_the_recordings_say_so(builds_up):
    saved = [e.shape for e in diagnosed(builds_up).final.effects if e.shape.effect == "stribeck"]
    assert [("share_0" in shape.values) for shape in saved] == [builds_up]


@pytest.mark.slow
def test_an_element_that_never_slips_in_both_directions_is_no_friction():
    """In motions of 120 mrad the last one is a spring, which a larger motion would show not to be.

    Such elements and a spring of the opposite sign cancelled one another; in a larger motion, where
    elements slip, the spring remained, at 250 N m/rad.
    """
    reaches = np.array([*REACHES, 0.1])

    def friction(q: FloatArray, v: FloatArray) -> FloatArray:
        return COULOMB[0] * (maxwell_slip_force(q, reaches) - friction_sign(v))

    result = diagnosed_with_friction(friction, 0.05)
    (saved,) = (e for e in result.final.effects if e.shape.key == ("hysteresis", 0))
    travel = max(float(np.ptp(motion.samples.q[:, 0])) for motion in result.model.motions)
    strengths = saved.coefficients[: hysteresis.ELEMENTS]
    sticks = 2.0 * hysteresis.reaches(saved.shape.values) > travel
    assert 0 < sticks.sum() < len(sticks)
    assert strengths[sticks].max() < 1e-3 * strengths.sum()


def test_friction_that_builds_up_has_the_direction_of_its_elements():
    motions = diagnosed(True).model.motions
    bristles = hysteresis.HYSTERESIS.dense_model(motions, 0)
    c = np.zeros(len(bristles.nonnegative))
    c[[2, 4]] = 0.3, 0.1
    shape = stribeck.STRIBECK.dense_model(motions, 0).with_values(
        **hysteresis.build_up(bristles, c, 1.0)
    )
    q = motions[0].samples.q[:, 0]
    reaches = hysteresis.reaches(bristles.values)
    elements = [hysteresis.maxwell_slip(q, reaches[i]) for i in (2, 4)]
    expected = 0.3 * elements[0] + 0.1 * elements[1] + 0.6 * motions[0].sign(0)
    np.testing.assert_allclose(hysteresis.direction(motions[0], shape), expected, atol=1e-12)
    plain = stribeck.STRIBECK.dense_model(motions, 0)
    np.testing.assert_array_equal(hysteresis.direction(motions[0], plain), motions[0].sign(0))


def test_one_form_of_an_effect_stands_in_for_the_other():
    """Effect 1 needs effect 0; effect 2 is used only without effect 1."""
    rng = np.random.default_rng(1)
    base, torque = rng.normal(size=(50, 1, 1)), rng.normal(size=(50, 1))
    prior = np.zeros(1), np.eye(1)
    regression = JointRegression.of_base(
        torque, np.ones((50, 1), bool), base, prior, np.ones(1), 1.0
    )
    for _ in range(3):
        x = rng.normal(size=(50, 1))
        regression.add(Columns((0,), (x,), np.zeros(1, bool), np.ones(1)))
    regression.built_up = {1: (0, 2)}
    used = [regression.without(out).active.tolist() for out in ((), (0,), (1,), (1, 2))]
    assert used == [
        [True, True, True, False],
        [True, False, False, True],
        [True, True, False, True],
        [True, True, False, False],
    ]
