"""Stribeck friction of a joint that moves slowly around reversals."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from diagnosis_cases import (
    PSI,
    RATE,
    SUBJECT,
    added_torque,
    at_joint,
    diagnose,
    findings_of,
    friction_sign,
    known_failures,
    noise_ratios,
    parameters,
)
from scipy.interpolate import CubicSpline
from synthetic_recordings import random_fourier, synthetic_recording

from excite._types import FloatArray
from excite.diagnosis.diagnosis import Diagnosis
from excite.robot.samples import Samples
from excite.trajectory.fourier import FourierSeries

HEIGHT, VELOCITY, CREEP = 1.5, 0.12, 0.15
FORMS = {
    "exponential": lambda x: np.exp(-x),
    "gaussian": lambda x: np.exp(-(x**2)),
    "rational": lambda x: 1.0 / (1.0 + (np.e - 1.0) * x**2),
}

SLOW = ("gaussian", "rational")
"""Forms whose tests are slow."""


class SlowReversals(FourierSeries):
    """A motion with slow reversals: a speed v becomes v³/(v² + c²)."""

    def samples(self, t: FloatArray) -> Samples:
        pace = np.linspace(0.0, self.period, 20001)
        speed = super().samples(pace).dq
        speed[-1] = speed[0]
        slowed = CubicSpline(pace, speed**3 / (speed**2 + CREEP**2), bc_type="periodic")
        gone, within = slowed.antiderivative(), np.mod(t, self.period)
        drift = gone(self.period) / self.period
        return Samples(
            gone(within) - within[:, None] * drift, slowed(within) - drift, slowed(within, 1)
        )


@cache
def diagnosed_form(form: str) -> Diagnosis:
    """Return the diagnosis of Stribeck friction of a form along motions with slow reversals."""
    recordings = []
    for seed in (2, 5):
        plain = random_fourier(2, seed)
        slow = SlowReversals(plain.sine, plain.cosine, plain.offset, plain.period)
        recording = synthetic_recording(SUBJECT, PSI, slow, 4, 0.02, RATE)
        v = slow.samples(recording.t).dq[:, 0]
        friction = HEIGHT * friction_sign(v) * FORMS[form](np.abs(v) / VELOCITY)
        named = dataclasses.replace(recording, source=f"{seed}.csv")
        recordings.append(added_torque(named, at_joint(0, friction)))
    return diagnose(recordings)


@pytest.mark.parametrize(
    "form",
    known_failures(FORMS, {"gaussian": "nonlinear viscous friction is found too"}, SLOW),
)
def test_stribeck_friction_of_any_form_is_the_only_finding(form):
    assert findings_of(diagnosed_form(form)) == [("stribeck", 0)]


@pytest.mark.parametrize(
    "form",
    known_failures(FORMS, {"gaussian": "amplitude 4.8 N m, true 1.5 N m"}, SLOW),
)
def test_slow_reversals_determine_the_size_of_stribeck_friction(form):
    estimates = parameters(diagnosed_form(form), "stribeck", 0)
    assert estimates["amplitude"][0] == pytest.approx(HEIGHT, rel=0.05)
    assert estimates["velocity"][0] == pytest.approx(VELOCITY, rel=0.05)


@pytest.mark.parametrize("form", known_failures(FORMS, {}, SLOW))
def test_slow_motion_is_predicted_to_the_noise(form):
    assert (noise_ratios(diagnosed_form(form))[1] < 1.4).all()
