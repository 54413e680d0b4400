"""Torque saturation: actuators that produce less torque than they report."""

from __future__ import annotations

import dataclasses
import types

import numpy as np
import pytest
from diagnosis_cases import at_joint, effect_entry, model_with_effects, recordings_of
from synthetic_recordings import (
    NO_KNOWN_COLUMNS,
    single_joint_columns,
    single_joint_fold,
    unexpected_columns,
)

from excite._types import FloatArray
from excite.diagnosis import diagnosis, equations, fitted_effects, hypothesis, search
from excite.diagnosis.measured import Measured
from excite.effects import EFFECTS_BY_NAME, torque_saturation
from excite.effects.effect import CandidateModel
from excite.effects.recorded_motion import RecordedMotion
from excite.identification.regression import IdentificationModel


@pytest.fixture(scope="module")
def motion(subject: IdentificationModel) -> RecordedMotion:
    """Return a motion of a robot without effects."""
    train, validate = recordings_of(subject, None)
    return diagnosis.diagnose(
        subject.robot,
        subject.parameters,
        subject.base,
        [train],
        [validate],
        diagnosis.DiagnosisOptions(names=("drag",)),
    ).motions[0][0]


LOSS: dict[str, float] = {"power": 3.0, "largest": 40.0}


def recorded_torque(produced: FloatArray, loss: float) -> FloatArray:
    """Return the recorded torque of an actuator with a quadratic loss, by bisection.

    Args:
        made: Torque at the joint [N m].
        loss: Loss at the largest torque [1].
    """
    low, high = np.zeros_like(produced), np.full_like(produced, 55.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        short = middle * (1.0 - loss * (middle / LOSS["largest"]) ** 2) < np.abs(produced)
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.sign(produced) * low


def saturated(t: FloatArray, q: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
    return at_joint(0, recorded_torque(tau[:, 0], 0.15) - tau[:, 0])


def test_a_torque_loss_is_estimated_from_the_measured_torque(subject):
    train, validate = recordings_of(subject, saturated)
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [validate]
    )
    (finding,) = result.verdict.findings
    assert (finding.main.effect, finding.main.joint) == (
        "torque_saturation",
        0,
    ) and not result.unknown
    shape = result.design.shapes[finding.main.shape]
    assert result.verdict.together is not None
    loss = shape.parameters(result.verdict.together.coefficients)["loss"]
    largest = float(np.abs(train.torque[:, 0]).max())
    assert loss == pytest.approx(0.15 * (largest / LOSS["largest"]) ** 2, rel=0.15)
    noisy = equations.shapes(
        result.motions, False, np.full(2, 0.1 * largest), ["torque_saturation"]
    )
    exact = equations.shapes(
        result.motions, False, np.full(2, 1e-4 * largest), ["torque_saturation"]
    )
    assert any("measured" in s.values for s in exact) and not any(
        "measured" in s.values for s in noisy
    )


def test_a_torque_loss_is_applied_to_the_predicted_torque(subject):
    _, along = recordings_of(subject, None)
    effect = effect_entry("torque_saturation", "joint_1", LOSS | {"measured": 1.0}, 0.15)
    t, torque = fitted_effects.predict(model_with_effects(subject, ()), along)
    assert np.allclose(t, fitted_effects.predict(model_with_effects(subject, (effect,)), along)[0])
    recorded = fitted_effects.predict(model_with_effects(subject, (effect,)), along)[1]
    expected = recorded_torque(torque[:, 0], 0.15)
    inner = slice(100, -100)
    assert (
        np.abs(recorded[inner, 0] - expected[inner]).max()
        < 0.05 * np.abs(expected - torque[:, 0]).max()
    )
    assert np.array_equal(recorded[:, 1], torque[:, 1])
    beyond_limit = torque_saturation.recorded_torque(
        0.9, LOSS, np.array([-1e3, 0.0, 1e3])
    )  # beyond the limit
    assert (
        np.isfinite(beyond_limit).all()
        and beyond_limit[2] == -beyond_limit[0]
        and beyond_limit[1] == 0.0
    )
    assert beyond_limit[2] >= 1e3  # the recorded torque is not below the produced one


LEVEL = 30.0
"""Largest torque of the actuator below [N m]."""


def levelled(t: FloatArray, q: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
    """Return the added recorded torque if x/√(1 + (x/L)²) is produced for a recorded x."""
    produced = np.clip(tau[:, 0], -0.98 * LEVEL, 0.98 * LEVEL)
    return at_joint(0, produced / np.sqrt(1.0 - (produced / LEVEL) ** 2) - tau[:, 0])


def test_a_torque_limit_is_reported_as_saturation(subject):
    train, validate = recordings_of(subject, levelled)
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [validate]
    )
    (finding,) = result.verdict.findings
    assert (finding.main.effect, finding.main.joint) == (
        "torque_saturation",
        0,
    ) and not result.unknown
    shape, together = result.design.shapes[finding.main.shape], result.verdict.together
    assert "level" in shape.values and together is not None
    largest = max(float(np.abs(recording.torque[:, 0]).max()) for recording in (train, validate))
    loss = 1.0 - 1.0 / np.sqrt(1.0 + (largest / LEVEL) ** 2)
    assert shape.parameters(together.coefficients)["loss"] == pytest.approx(loss, rel=0.1)
    x = np.linspace(-largest, largest, 101)
    produced = x - together.coefficients[0] * torque_saturation.lost_torque(shape.values, x)
    np.testing.assert_allclose(
        torque_saturation.recorded_torque(float(together.coefficients[0]), shape.values, produced),
        x,
        atol=0.02 * largest,
    )


@pytest.mark.parametrize("bend", [1.0, 2.0])
@pytest.mark.parametrize("rests", [False, True])
def test_the_loss_at_usual_torque_is_bounded(motion, bend, rests):
    """Otherwise all torque, with its noise, could be explained as a loss.

    rests: the joint is at rest without load for most of the time.
    """
    torque, speed = motion.measured_torque.copy(), motion.samples.dq.copy()
    if rests:
        torque[: 2 * len(torque) // 3], speed[: 2 * len(speed) // 3] = 1e-3, 0.0
    track = types.SimpleNamespace(
        n=2, measured_torque=torque, motor_torque=torque, samples=types.SimpleNamespace(dq=speed)
    )
    shapes = [
        s
        for s in EFFECTS_BY_NAME["torque_saturation"].candidates([track])
        if s.joint == 0 and s.values.get("bend") == bend
    ]
    usual = float(np.median(np.abs(torque[len(torque) * 2 // 3 if rests else 0 :, 0])))
    assert len(shapes) == 6
    for shape in shapes:
        largest = max(c for c in np.linspace(0.01, 1.2, 120) if shape.is_plausible(np.array([c])))
        assert (
            largest * torque_saturation.lost_torque(shape.values, np.array([usual]))[0]
            < 0.31 * usual
        )


def test_noise_of_the_measured_torque_is_no_saturation():
    """If friction dominates, powers of the measured torque differ from the base model by noise
    only."""
    rng, direction = np.random.default_rng(2), np.sign(np.sin(np.linspace(0.0, 40.0, 600)))
    measured = [1.7 * direction + 0.018 * rng.normal(size=600) for _ in range(2)]
    folds = [
        single_joint_fold(direction[:, None], x[:, None], NO_KNOWN_COLUMNS, 0.018) for x in measured
    ]

    def is_significant(slope: float) -> list[bool]:
        shape = CandidateModel(
            "torque_saturation",
            0,
            unexpected_columns,
            column_noise=lambda c: abs(float(c[0])) * slope,
        )
        regression = search.design(
            (folds[0], folds[1]),
            [shape],
            lambda _: single_joint_columns(*((x**3 / 2.7**2 / 0.018)[:, None] for x in measured)),
        )
        return [
            h.shows
            for h in hypothesis.ranked(
                dataclasses.replace(regression, measured=Measured(noise=np.ones(1)))
            )
        ]

    assert is_significant(0.0) == [True] and is_significant(3.0 * (1.7 / 2.7) ** 2) == [False]
