"""Gear parameters from two encoders of a joint: stiffness, backlash and delay."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from diagnosis_cases import RATE, diagnose
from synthetic_recordings import perturbed_parameters, random_fourier, synthetic_recording

from excite._types import FloatArray
from excite.diagnosis.diagnosis_file import document
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording
from excite.report import diagnosis_page

STIFFNESS = (4e3, 9e3)
"""Stiffness of the gears [N m/rad]."""
BACKLASH = 4e-4
"""Backlash of the second gear [rad]."""
READ_DELAY = 2.5e-3
"""Time by which the link encoder is read after the motor encoder [s]."""
ECCENTRICITY = 3e-4
"""Amplitude of the error of an eccentric link encoder [rad]."""


def deflection(
    subject: IdentificationModel,
    psi: FloatArray,
    recording: Recording,
    dq: FloatArray,
    ddq: FloatArray,
) -> FloatArray:
    """Return motor position minus link position: elastic gears, the second with backlash.

    The load of joint 2 changes sign. Shape (N, n) [rad].
    """
    load = recording.torque - psi[subject.parameters.block("rotor_inertia")] * ddq
    out = (
        load / np.array(STIFFNESS)
        + READ_DELAY * dq
        + ECCENTRICITY * np.cos(recording.q + 0.4)
        + 0.02
    )
    out[:, 1] += 0.5 * BACKLASH * np.sign(load[:, 1])
    return np.asarray(out)


def two_encoder_recordings(
    subject: IdentificationModel, *, linked: bool = True, stiff: bool = False
) -> list[Recording]:
    psi, out = perturbed_parameters(subject.parameters, np.random.default_rng(4)), []
    for seed in (2, 5):
        fourier = random_fourier(2, seed)
        recording = synthetic_recording(subject, psi, fourier, 4, 0.1, RATE)
        s, rng = fourier.samples(recording.t), np.random.default_rng(seed)
        offset = (
            np.full(recording.q.shape, 0.02)
            if stiff
            else deflection(subject, psi, recording, s.dq, s.ddq)
        )
        noise = 2e-5 * rng.normal(size=recording.q.shape)
        link = recording.q - offset + noise if linked else None
        out.append(dataclasses.replace(recording, qlink=link, source=f"{seed}.csv"))
    return out


def test_gear_parameters_despite_delay_and_eccentric_encoder(subject):
    result = diagnose(two_encoder_recordings(subject))
    first, second = result.gears
    for gear, true in zip((first, second), STIFFNESS, strict=True):
        assert gear.stiffness is not None
        value, std = gear.stiffness
        assert abs(value - true) < max(3.0 * std, 0.03 * true) and std < 0.1 * true
        assert gear.read_delay[0] == pytest.approx(READ_DELAY, rel=0.05)
        assert gear.after < 0.15 * gear.before
        assert np.sqrt(np.mean((gear.deflection - gear.curve(gear.load)) ** 2)) < 0.3 * BACKLASH
    assert first.backlash is None  # its torque keeps its sign
    assert second.backlash is not None and second.backlash[0] == pytest.approx(BACKLASH, rel=0.2)


def test_rigid_gear_gets_no_finite_stiffness(subject):
    for gear in diagnose(two_encoder_recordings(subject, stiff=True)).gears:
        assert gear.stiffness is None or gear.stiffness[0] > 50.0 * max(STIFFNESS)
        assert abs(gear.read_delay[0]) < 5e-5


def test_no_gear_without_a_second_encoder(subject):
    pair = two_encoder_recordings(subject, linked=False)
    result = diagnose(pair)
    assert result.gears == () and document(result)["encoders"] == {}


def test_gears_are_reported_in_document_and_report(subject):
    pair = two_encoder_recordings(subject)
    # joint 2 has no second encoder in one recording: its gear cannot be validated
    pair[1].qlink[:, 1] = np.nan  # type: ignore[index]
    result = diagnose(pair)
    stated = document(result)
    (name,) = stated["encoders"]
    assert (
        name == subject.robot.joints[0]
        and stated["encoders"][name]["stiffness"]["unit"] == "N m/rad"
    )
    assert "two encoders" in diagnosis_page(result, stated)
