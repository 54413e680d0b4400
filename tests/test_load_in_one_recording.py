"""A load that the robot carries in one of several recordings, found without a trusted prior."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from diagnosis_cases import HELD_OUT, PSI, RATE, SUBJECT, diagnose, findings_of, parameters
from synthetic_recordings import random_fourier, synthetic_recording

from excite._types import FloatArray
from excite.diagnosis import fitted_effects
from excite.diagnosis.diagnosis import Diagnosis
from excite.exporters.simulator_model import simulator_model
from excite.recordings import Recording

MASS, CENTRE = 1.5, np.array([0.05, 0.0, 0.1])
"""Mass of the load [kg], and its centre in the frame of the last link [m]."""
LOADED = "3.csv"
"""The recording with the load."""


def recorded(seed: int, psi: FloatArray) -> Recording:
    """Return a recording of the robot with some standard parameters, shape (P,)."""
    recording = synthetic_recording(SUBJECT, psi, random_fourier(2, seed), 4.0, 0.0, RATE)
    noise = 0.05 * np.random.default_rng(seed).normal(size=recording.torque.shape)
    return dataclasses.replace(recording, tau=recording.torque + noise, source=f"{seed}.csv")


@cache
def diagnosed(mass: float) -> Diagnosis:
    """Return the diagnosis of three recordings, the second of which has a load of some mass."""
    loaded = PSI.copy()
    last = loaded[10 * (SUBJECT.parameters.bodies - 1) :]
    x, y, z = CENTRE
    inertia = [y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y]
    last[:10] += mass * np.array([1.0, x, y, z, *inertia])
    parts = [recorded(2, PSI), recorded(3, loaded), recorded(4, PSI), recorded(HELD_OUT, PSI)]
    return diagnose(parts)


def test_a_load_is_found_in_its_recording():
    result = diagnosed(MASS)
    assert findings_of(result) == [("payload", 1)]
    load = parameters(result, "payload", 1)
    assert load["mass"][0] == pytest.approx(MASS, rel=0.1)
    assert load["com_x"][0] == pytest.approx(CENTRE[0], abs=0.02)
    (entry,) = result.document["effects"]
    assert entry["recording"] == LOADED


def test_the_robot_of_the_held_out_recording_has_no_load():
    """Base parameters of both would be between them."""
    result = diagnosed(MASS)
    assert (result.held_out.rmse_after < 0.1 * result.held_out.rmse_before).all()


def test_a_simulator_has_no_load():
    document = diagnosed(MASS).document
    saved = fitted_effects.read_back(document)
    np.testing.assert_array_equal(simulator_model(saved, document).psi, saved.psi)


@pytest.mark.slow
def test_recordings_without_a_load_have_none():
    assert not findings_of(diagnosed(0.0))
