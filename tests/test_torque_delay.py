"""Delays and filters of the recorded torque."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from diagnosis_cases import (
    HIDDEN,
    RATE,
    Effect,
    at_joint,
    diagnose,
    diagnosed,
    findings_of,
    known_failures,
    maxwell_slip_force,
    noise_ratios,
    parameters,
    recordings_of,
)
from scipy import signal
from slow_tests import slow

from excite.diagnosis.diagnosis import Diagnosis
from excite.identification.lowpass import Grid, LowPassFilter


@pytest.mark.parametrize("periodic", [True, False])
def test_a_signal_below_the_cutoff_passes_a_first_order_filter(periodic):
    t, lag = np.arange(4000) / 500.0, 0.0137
    lowpass = LowPassFilter(20.0, 500.0, len(t), periodic)
    wave = lambda f, phase: np.sin(2.0 * np.pi * f * t - phase)  # noqa: E731
    waves = lowpass.transform(wave(3.0, 0.0) + 0.3 * wave(11.25, 0.0))
    passed = waves.filter(Grid.RECORDED, time_constant=lag)
    angles = [2.0 * np.pi * f * lag for f in (3.0, 11.25)]
    expected = sum(
        size * wave(f, np.arctan(a)) / np.hypot(1.0, a)
        for size, f, a in zip((1.0, 0.3), (3.0, 11.25), angles, strict=True)
    )
    kept = slice(lowpass.margin, len(t) - lowpass.margin)
    np.testing.assert_allclose(passed[kept], expected[kept], atol=1e-9 if periodic else 3e-3)


def test_the_delay_of_the_clock_moves_into_the_time_stamps():
    np.testing.assert_allclose(diagnosed("delay").model.chain.delay, 6e-3, rtol=0.03)


LAG = 0.015
"""Time constant of the filter below [s]."""


@cache
def diagnosed_filtered(effect: str | None) -> Diagnosis:
    """Return the diagnosis of torque that has passed a first-order filter of the controller."""
    keep = np.exp(-1.0 / (RATE * LAG))
    recordings = recordings_of(None if effect is None else HIDDEN[effect].torque)
    filtered = [
        signal.lfilter([1.0 - keep], [1.0, -keep], r.torque, axis=0, zi=keep * r.torque[:1])[0]
        for r in recordings
    ]
    return diagnose(
        [dataclasses.replace(r, tau=tau) for r, tau in zip(recordings, filtered, strict=True)]
    )


@pytest.mark.parametrize("effect", [slow(None), "stribeck"])
def test_filtered_torque_is_reported_as_a_delay_and_hides_no_effect(effect):
    result = diagnosed_filtered(effect)
    expected = {("delay", None), *([(effect, HIDDEN[effect].joint)] if effect else [])}
    assert set(findings_of(result)) == expected and not result.unmodelled
    value, std = parameters(result, "delay", None)["seconds"]
    keep = np.exp(-1.0 / (RATE * LAG))
    assert abs(value - keep / (1.0 - keep) / RATE) < max(2.0 * std, 1e-3)  # of the discrete filter


@pytest.mark.parametrize("effect", [slow(None), "stribeck"])
def test_filtered_torque_is_predicted(effect):
    assert (noise_ratios(diagnosed_filtered(effect))[1] < 1.6).all()


DELAYED: dict[str, tuple[float, Effect]] = {
    "torque_ripple": (
        0.02,
        lambda t, q, dq, tau: at_joint(1, 2.5 * np.cos(17.0 * q[:, 1] + 0.4)),
    ),
    "hysteresis": (
        0.015,
        lambda t, q, dq, tau: at_joint(1, 4.0 * maxwell_slip_force(q[:, 1], np.array([0.02]))),
    ),
}
"""Delay of the second joint's torque [s], and the torque of its effect, by effect."""


@pytest.mark.parametrize(
    "effect",
    known_failures(
        DELAYED,
        {
            "torque_ripple": "a delay of all joints, and nonlinear viscous friction of joint 1",
            "hysteresis": "a delay of all joints is found too",
        },
        DELAYED,
    ),
)
def test_an_effect_is_reported_jointly_with_the_delay_of_its_joint(effect):
    (seconds, torque), recordings = DELAYED[effect], []
    for recording in recordings_of(torque):
        tau = recording.torque.copy()
        tau[:, 1] = np.interp(recording.t - seconds, recording.t, tau[:, 1])
        recordings.append(dataclasses.replace(recording, tau=tau))
    result = diagnose(recordings)
    assert set(findings_of(result)) == {(effect, 1), ("delay", 1)} and not result.unmodelled
    value, std = parameters(result, "delay", 1)["seconds"]
    assert abs(value - seconds) < 2.0 * std < 0.3 * seconds
    assert (noise_ratios(result)[1] < 1.6).all()
