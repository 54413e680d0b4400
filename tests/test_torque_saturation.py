"""Drives that make less than they say."""

from __future__ import annotations

import dataclasses
import types

import numpy as np
import pytest
from synthetic_recordings import (
    NO_KNOWN_COLUMNS,
    single_joint_columns,
    single_joint_fold,
    unexpected_columns,
)
from test_diagnosis import on, recordings_of
from test_fitted_effects import fitted_with, stated

from excite.diagnosis import diagnosis, equations, fitted_effects, hypothesis, search
from excite.diagnosis.measured import Measured
from excite.effects import EFFECTS_BY_NAME, torque_saturation
from excite.effects.effect import CandidateModel
from excite.effects.recorded_motion import RecordedMotion
from excite.identification.regression import IdentificationModel

Array = np.ndarray


@pytest.fixture(scope="module")
def calm(subject: IdentificationModel) -> RecordedMotion:
    """Of a robot with nothing missing."""
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


def drawn(made: Array, loss: float) -> Array:
    """What a drive is recorded with that makes some torque at a loss of its square, by
    bisection."""
    low, high = np.zeros_like(made), np.full_like(made, 55.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        short = middle * (1.0 - loss * (middle / LOSS["largest"]) ** 2) < np.abs(made)
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.sign(made) * low


def saturated(t: Array, q: Array, dq: Array, tau: Array) -> Array:
    return on(0, drawn(tau[:, 0], 0.15) - tau[:, 0])


def test_a_drive_that_loses_torque_is_told_by_what_was_measured(subject):
    train, validate = recordings_of(subject, saturated)
    done = diagnosis.diagnose(subject.robot, subject.parameters, subject.base, [train], [validate])
    (finding,) = done.verdict.findings
    assert (finding.main.effect, finding.main.joint) == (
        "torque_saturation",
        0,
    ) and not done.unknown
    shape = done.design.shapes[finding.main.shape]
    assert done.verdict.together is not None
    loss = shape.parameters(done.verdict.together.coefficients)["loss"]
    largest = float(np.abs(train.torque[:, 0]).max())
    assert loss == pytest.approx(0.15 * (largest / LOSS["largest"]) ** 2, rel=0.15)
    noisy = equations.shapes(done.motions, False, np.full(2, 0.1 * largest), ["torque_saturation"])
    calm = equations.shapes(done.motions, False, np.full(2, 1e-4 * largest), ["torque_saturation"])
    assert any("measured" in s.values for s in calm) and not any(
        "measured" in s.values for s in noisy
    )


def test_a_measured_loss_is_predicted_from_what_is_predicted(subject):
    _, along = recordings_of(subject, None)
    lossy = stated("torque_saturation", "joint_1", LOSS | {"measured": 1.0}, 0.15)
    t, torque = fitted_effects.predict(fitted_with(subject, ()), along)
    assert np.allclose(t, fitted_effects.predict(fitted_with(subject, (lossy,)), along)[0])
    recorded_as = fitted_effects.predict(fitted_with(subject, (lossy,)), along)[1]
    expected = drawn(torque[:, 0], 0.15)
    inner = slice(100, -100)
    assert (
        np.abs(recorded_as[inner, 0] - expected[inner]).max()
        < 0.05 * np.abs(expected - torque[:, 0]).max()
    )
    assert np.array_equal(recorded_as[:, 1], torque[:, 1])
    most = torque_saturation.recorded_torque(
        0.9, LOSS, np.array([-1e3, 0.0, 1e3])
    )  # more than it can make
    assert np.isfinite(most).all() and most[2] == -most[0] and most[1] == 0.0
    assert most[2] >= 1e3  # what is recorded is never less than what is made


LEVEL = 30.0
"""What the drive below can make, at the most [N m]."""


def levelled(t: Array, q: Array, dq: Array, tau: Array) -> Array:
    """Recorded of a drive that makes x/√(1 + (x/L)²) where x is asked for."""
    made = np.clip(tau[:, 0], -0.98 * LEVEL, 0.98 * LEVEL)
    return on(0, made / np.sqrt(1.0 - (made / LEVEL) ** 2) - tau[:, 0])


def test_a_drive_whose_torque_levels_off_is_told(subject):
    train, validate = recordings_of(subject, levelled)
    done = diagnosis.diagnose(subject.robot, subject.parameters, subject.base, [train], [validate])
    (finding,) = done.verdict.findings
    assert (finding.main.effect, finding.main.joint) == (
        "torque_saturation",
        0,
    ) and not done.unknown
    shape, together = done.design.shapes[finding.main.shape], done.verdict.together
    assert "level" in shape.values and together is not None
    largest = max(float(np.abs(one.torque[:, 0]).max()) for one in (train, validate))
    loss = 1.0 - 1.0 / np.sqrt(1.0 + (largest / LEVEL) ** 2)
    assert shape.parameters(together.coefficients)["loss"] == pytest.approx(loss, rel=0.1)
    x = np.linspace(-largest, largest, 101)
    made = x - together.coefficients[0] * torque_saturation._lost_torque(shape.values, x)
    np.testing.assert_allclose(
        torque_saturation.recorded_torque(float(together.coefficients[0]), shape.values, made),
        x,
        atol=0.02 * largest,
    )


@pytest.mark.parametrize("bend", [1.0, 2.0])
@pytest.mark.parametrize("rests", [False, True])
def test_of_its_usual_torque_a_drive_loses_little(calm, bend, rests):
    """Else all of the torque could be taken for lost, and its noise with it. rests: for most of the
    time, bearing nothing."""
    drawn, speed = calm.measured_torque.copy(), calm.samples.dq.copy()
    if rests:
        drawn[: 2 * len(drawn) // 3], speed[: 2 * len(speed) // 3] = 1e-3, 0.0
    track = types.SimpleNamespace(
        n=2, measured_torque=drawn, motor_torque=drawn, samples=types.SimpleNamespace(dq=speed)
    )
    shapes = [
        s
        for s in EFFECTS_BY_NAME["torque_saturation"].candidates([track])
        if s.joint == 0 and s.values.get("bend") == bend
    ]
    usual = float(np.median(np.abs(drawn[len(drawn) * 2 // 3 if rests else 0 :, 0])))
    assert len(shapes) == 6
    for shape in shapes:
        most = max(c for c in np.linspace(0.01, 1.2, 120) if shape.is_plausible(np.array([c])))
        assert (
            most * torque_saturation._lost_torque(shape.values, np.array([usual]))[0] < 0.31 * usual
        )


def test_noise_in_a_column_of_measured_torque_is_no_saturation():
    """Where friction is nearly all of a torque, powers of what was measured have nothing but noise
    that the base model does not take."""
    rng, way = np.random.default_rng(2), np.sign(np.sin(np.linspace(0.0, 40.0, 600)))
    measured = [1.7 * way + 0.018 * rng.normal(size=600) for _ in range(2)]
    halves = [
        single_joint_fold(way[:, None], x[:, None], NO_KNOWN_COLUMNS, 0.018) for x in measured
    ]

    def found(slope: float) -> list[bool]:
        shape = CandidateModel(
            "torque_saturation",
            0,
            unexpected_columns,
            column_noise=lambda c: abs(float(c[0])) * slope,
        )
        one = search.design(
            (halves[0], halves[1]),
            [shape],
            lambda _: single_joint_columns(*((x**3 / 2.7**2 / 0.018)[:, None] for x in measured)),
        )
        return [
            h.shows
            for h in hypothesis.ranked(
                dataclasses.replace(one, measured=Measured(noise=np.ones(1)))
            )
        ]

    assert found(0.0) == [True] and found(3.0 * (1.7 / 2.7) ** 2) == [False]
