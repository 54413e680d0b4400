"""Torque outside the catalogue: flexible models find it and say what it depends on."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from diagnosis_cases import (
    NOISE,
    added_torque,
    at_joint,
    diagnose,
    findings_of,
    recordings_of,
)
from scipy import signal
from slow_tests import slow

from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.flexible_models import EXPERIMENTS, flexible_models
from excite.diagnosis.unmodelled import UnmodelledTorque, repeated_share
from excite.recordings import Recording

SIZE = 1.0
"""RMS of the torque outside the catalogue [N m]: ten times the noise."""
RESONANCE, DAMPING = 1.4, 0.03
"""Frequency [Hz] and damping ratio of the oscillator."""
INERTIA = 0.3
"""Its moment of inertia [kg m²]."""
PLACE = 0.4
"""Position of the dent [rad]."""


def of_size(x: np.ndarray) -> np.ndarray:
    return SIZE * (x - x.mean()) / x.std()


def oscillator_torque(recording: Recording) -> np.ndarray:
    """Return the reaction of a mass on a spring that the second link carries."""
    t = recording.t
    omega = 2.0 * np.pi * RESONANCE
    acceleration = np.gradient(np.gradient(recording.q[:, 1], t), t)
    system = signal.lti([omega**2], [1.0, 2.0 * DAMPING * omega, omega**2])
    # below the resonance it is the torque of an inertia, which the base model takes
    return INERTIA * np.asarray(signal.lsim(system, acceleration, t)[1])


def dent_torque(recording: Recording) -> np.ndarray:
    """Return the torque of a dent in a bearing race."""
    return of_size(np.exp(-np.square((recording.q[:, 1] - PLACE) / 0.05)))


def snag_torque(recording: Recording) -> np.ndarray:
    """Return the torque of a cable that snags at one angle and releases at another."""
    low, high = np.quantile(recording.q[:, 1], (0.3, 0.7))
    state, out = 0.0, np.zeros(len(recording.t))
    for k, q in enumerate(recording.q[:, 1]):
        state = 1.0 if q > high else 0.0 if q < low else state
        out[k] = state
    return of_size(out)


TORQUES = {"resonance": oscillator_torque, "dent": dent_torque, "snag": snag_torque}
RESONANT = slow("resonance")
SNAG = pytest.param(
    "snag",
    marks=[
        pytest.mark.slow,
        pytest.mark.xfail(strict=True, reason="a spring is named, and the rest unknown"),
    ],
)


@cache
def result_of(name: str) -> Diagnosis:
    recordings = [
        added_torque(recording, at_joint(1, TORQUES[name](recording)))
        for recording in recordings_of(None, (2, 8, 5))
    ]
    return diagnose(recordings)


def entry_of(name: str) -> UnmodelledTorque:
    (entry,) = result_of(name).unmodelled
    return entry


@pytest.mark.parametrize("name", [RESONANT, "dent", SNAG])
def test_torque_outside_the_catalogue_is_unknown_and_not_named(name):
    assert entry_of(name).joint == 1 and entry_of(name).probability > 0.9
    assert not [effect for effect, joint in findings_of(result_of(name)) if joint == 1]


@pytest.mark.parametrize("name", ["dent", SNAG])
def test_its_size_is_that_of_the_torque(name):
    """The base model takes a part of it."""
    assert 0.5 * SIZE < entry_of(name).size < 1.1 * SIZE


@pytest.mark.slow
def test_a_resonance_is_found_with_its_frequency():
    entry = entry_of("resonance")
    assert entry.regime.startswith("past") and entry.response.relative
    assert entry.frequency == pytest.approx(RESONANCE, rel=0.03)


def test_a_resonance_repeats_within_the_longest_stretch():
    """One period in a stretch is a slow function of the motion, not an oscillation."""
    short = [r.between(r.t[0], r.t[0] + 5.0) for r in recordings_of(None)]
    motions = diagnose(short).final.motions
    longest = max(float(motion.time[-1] - motion.time[0]) for motion in motions)
    frequencies = [
        model.values["frequency"]
        for model in flexible_models(motions, np.ones(2))
        if "frequency" in model.values
    ]
    assert longest < 5.0 and min(frequencies) * longest >= 3.0


def test_a_dent_is_found_at_its_place():
    entry = entry_of("dent")
    assert entry.regime in ("place", "position") and entry.response.over == "position [rad]"
    assert entry.response.x[np.argmax(entry.response.y)] == pytest.approx(PLACE, abs=0.06)


@pytest.mark.parametrize("name", [RESONANT, "dent", SNAG])
def test_the_report_says_which_experiment_shows_it(name):
    assert entry_of(name).experiment == EXPERIMENTS[entry_of(name).regime]


def test_the_saved_model_does_not_contain_it():
    result = result_of("dent")
    assert {effect["effect"] for effect in result.document["effects"]} <= {
        effect.effect for effect in result.effects
    }


@pytest.mark.parametrize("seed", [slow(0), slow(1), 2])
def test_coloured_noise_is_not_unknown_torque(seed):
    rng = np.random.default_rng(seed)
    recordings = []
    for recording in recordings_of(None, (2, 8, 5)):
        white = rng.normal(size=recording.torque.shape)
        coloured = signal.lfilter([1.0], [1.0, -0.9], white, axis=0)
        recordings.append(added_torque(recording, 2.0 * NOISE * coloured / coloured.std()))
    assert not diagnose(recordings).unmodelled


def test_what_repeats_is_a_share_of_the_power():
    rng = np.random.default_rng(0)
    common = rng.normal(size=4000)
    first, second = (common + rng.normal(size=4000) for _ in range(2))
    none = np.zeros(4000)
    share, sure = repeated_share(first * second, 2.0, none)
    assert share == pytest.approx(0.5, abs=0.05) and sure > 10.0
    share, sure = repeated_share(first * rng.permutation(second), 2.0, none)
    assert abs(sure) < 4.0 and abs(share) < 0.1
