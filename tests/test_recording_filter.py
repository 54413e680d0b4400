"""Filters that the recorded torque has passed and the positions have not."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from diagnosis_cases import (
    HIDDEN,
    RATE,
    diagnose,
    diagnosed,
    findings_of,
    known_failures,
    motions,
    noise_ratios,
    recordings_of,
)
from scipy import signal
from slow_tests import slow

from excite._types import FloatArray
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.diagnosis_file import document
from excite.effects import delay
from excite.report.torque_budget import filter_words

CORNER = 20.0
"""Corner frequency of the filter below [Hz]."""
FREQUENCIES = np.array([5.0, 10.0, 15.0])


@cache
def stored(effect: str | None) -> Diagnosis:
    """Return the diagnosis of recordings whose torque was filtered without phase when stored."""
    sections = signal.butter(2, CORNER / (0.5 * RATE), output="sos")
    recordings = recordings_of(None if effect is None else HIDDEN[effect].torque)
    return diagnose(
        [
            dataclasses.replace(r, tau=signal.sosfiltfilt(sections, r.torque, axis=0))
            for r in recordings
        ]
    )


STORED = [slow(None), "stribeck", slow("torque_ripple"), slow("load_friction")]
"""Hidden effects of the recordings."""


@pytest.mark.parametrize("effect", STORED)
def test_filtered_torque_is_no_effect_and_hides_none(effect):
    assert findings_of(stored(effect)) == ([(effect, HIDDEN[effect].joint)] if effect else [])


@pytest.mark.parametrize("effect", STORED)
def test_gain_of_the_filter_is_found(effect):
    result = stored(effect)
    gain = result.final.chain.gain(FREQUENCIES)
    expected = 1.0 / (1.0 + (FREQUENCIES / CORNER) ** 4)
    np.testing.assert_allclose(gain, expected, atol=0.05)
    assert abs(result.final.chain.delay) < 1e-3


@pytest.mark.parametrize("effect", STORED)
def test_saved_model_predicts_filtered_torque(effect):
    assert (noise_ratios(stored(effect))[1] < 1.4).all()


def one_pole(hertz: float) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of a filter of one pole, as drives compute it."""
    k = np.exp(-2.0 * np.pi * hertz / RATE)
    return np.array([1.0 - k]), np.array([1.0, -k])


DRIVES = {
    "one pole, 8 Hz": one_pole(8.0),
    "one pole, 12 Hz": one_pole(12.0),
    "Butterworth, 15 Hz": signal.butter(2, 15.0 / (0.5 * RATE)),
    "Butterworth, 30 Hz": signal.butter(2, 30.0 / (0.5 * RATE)),
    "mean of 40 ms": (np.full(8, 0.125), np.ones(1)),
}
"""Filters of drives."""


@pytest.mark.parametrize(
    "name",
    known_failures(
        DRIVES, {}, ["one pole, 8 Hz", "one pole, 12 Hz", "Butterworth, 15 Hz", "mean of 40 ms"]
    ),
)
def test_filter_of_a_drive_is_no_effect(name):
    recordings = []
    for r in recordings_of(HIDDEN["stribeck"].torque):
        tau = signal.lfilter(*DRIVES[name], r.torque - r.torque[0], axis=0) + r.torque[0]
        recordings.append(dataclasses.replace(r, tau=tau))
    result = diagnose(recordings)
    expected = [("delay", None), ("stribeck", HIDDEN["stribeck"].joint)]
    assert sorted(findings_of(result)) == expected
    response = np.abs(signal.freqz(*DRIVES[name], FREQUENCIES, fs=RATE)[1])
    np.testing.assert_allclose(result.final.chain.gain(FREQUENCIES), response, atol=0.08)
    assert (noise_ratios(result)[1] < 1.4).all()


@pytest.mark.parametrize("hertz", [10.0, slow(15.0)])
def test_filter_of_one_joint_is_none_of_the_recording(hertz):
    """The saved model would filter the torque of the other joint as well.

    The held-out motion is twice as wide as the others: no joint is predicted worse than before.
    """
    sections = signal.butter(1, hertz / (0.5 * RATE), output="sos")
    recordings = []
    for recording in recordings_of(None):
        tau = recording.torque.copy()
        tau[:, 0] = signal.sosfiltfilt(sections, tau[:, 0])
        recordings.append(dataclasses.replace(recording, tau=tau))
    result = diagnose(recordings)
    assert result.final.chain.filter is None
    assert (result.held_out.rmse_after < 1.02 * result.held_out.rmse_before).all()


@pytest.mark.slow
def test_noise_after_a_filter_of_small_gain_is_not_amplified():
    """Torque that has passed a gain of 0.06 at the cutoff frequency, then noise of 0.1 N m."""
    sections = signal.butter(2, 0.5 * CORNER / (0.5 * RATE), output="sos")
    hidden, rng = HIDDEN["stribeck"], np.random.default_rng(0)
    recordings = []
    for recording in recordings_of(hidden.torque):
        passed = signal.sosfiltfilt(sections, recording.torque, axis=0)
        noise = 0.1 * rng.normal(size=passed.shape)
        recordings.append(dataclasses.replace(recording, tau=passed + noise))
    result = diagnose(recordings)
    assert findings_of(result) == [("stribeck", hidden.joint)]
    expected = 0.1 * np.sqrt(result.hertz / (0.5 * RATE))
    np.testing.assert_allclose(result.noise.floor, expected, rtol=0.2)
    assert (noise_ratios(result)[1] < 1.4).all()


@pytest.mark.parametrize("hertz", [3.0, 9.0, 14.0])
@pytest.mark.parametrize("poles", [1, 2, 3, 4])
@pytest.mark.parametrize("passes", [1, 2])
def test_wave_passes_the_filter_with_its_gain_and_phase(hertz, poles, passes):
    motion, low_pass = motions()[0], delay.LowPass(poles, passes, CORNER)
    angle = 2.0 * np.pi * hertz * motion.times
    torque = np.column_stack([np.sin(angle), 2.0 * np.cos(angle)])
    passed = low_pass.passed(motion, torque)
    b, a = signal.butter(poles, 2.0 * np.pi * CORNER, analog=True)
    response = signal.freqs(b, a, [2.0 * np.pi * hertz, 1e-3])[1]
    phase = -np.angle(response[0]) + np.angle(response[1]) / 1e-3 * 2.0 * np.pi * hertz
    gain, phase = np.abs(response[0]) ** passes, phase if passes == 1 else 0.0
    expected = gain * np.column_stack([np.sin(angle - phase), 2.0 * np.cos(angle - phase)])
    inside = slice(motion.band.margin, -motion.band.margin)
    np.testing.assert_allclose(passed[inside], expected[inside], atol=0.01)
    restored = low_pass.passed(motion, passed, inverse=True)
    np.testing.assert_allclose(restored[inside], torque[inside], atol=0.02)


def test_filter_is_stated():
    content = document(stored("stribeck"))
    entry = content["recording_filter"]
    assert entry["hertz"] == [5.0, 10.0, 15.0, 20.0]
    assert entry["gain"] == sorted(entry["gain"], reverse=True)
    words = filter_words(content)
    assert "low-pass filter" in words and f"{entry['gain'][2]:.2f} at 15 Hz" in words


@pytest.mark.parametrize("effect", [None, "hysteresis", slow("elasticity"), "delay"])
def test_unfiltered_torque_has_no_filter(effect):
    result = diagnosed(effect)
    assert result.final.chain.filter is None
    content = document(result)
    assert content["recording_filter"] is None and filter_words(content) == ""
