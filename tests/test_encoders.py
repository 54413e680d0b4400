"""Gears between two encoders: what was put between motor and link comes out, and nothing where
nothing was."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from synthetic_recordings import perturbed_parameters, random_fourier, synthetic_recording

from excite.cli.diagnose import _text
from excite.diagnosis import diagnosis, gear_encoders, residual_atlas
from excite.diagnosis.diagnosis import DiagnosisOptions
from excite.diagnosis.diagnosis_file import document
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording
from excite.report import diagnosis_page

Array = np.ndarray
STIFFNESS, PLAY, APART, OFF = (4e3, 9e3), 4e-4, 2.5e-3, 3e-4


def lag(
    subject: IdentificationModel, psi: Array, recording: Recording, dq: Array, ddq: Array
) -> Array:
    """How far the link reads behind its motor: both are sprung, joint 2, whose load changes sign,
    is loose too."""
    load = recording.torque - psi[subject.parameters.block("rotor_inertia")] * ddq
    out = load / np.array(STIFFNESS) + APART * dq + OFF * np.cos(recording.q + 0.4) + 0.02
    out[:, 1] += 0.5 * PLAY * np.sign(load[:, 1])
    return np.asarray(out)


def both(
    subject: IdentificationModel, *, linked: bool = True, stiff: bool = False
) -> list[Recording]:
    psi, out = perturbed_parameters(subject.parameters, np.random.default_rng(4)), []
    for seed in (2, 5):
        fourier = random_fourier(2, seed)
        one = synthetic_recording(subject, psi, fourier, 4, 0.1)
        s, rng = fourier.samples(one.t), np.random.default_rng(seed)
        behind = np.full(one.q.shape, 0.02) if stiff else lag(subject, psi, one, s.dq, s.ddq)
        link = one.q - behind + 2e-5 * rng.normal(size=one.q.shape) if linked else None
        out.append(dataclasses.replace(one, qlink=link, source=f"{seed}.csv"))
    return out


def found(subject: IdentificationModel, pair: list[Recording]) -> diagnosis.Diagnosis:
    options = DiagnosisOptions(names=("stribeck",))
    return diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [pair[0]], [pair[1]], options
    )


def test_a_gear_is_told_from_a_clock_and_an_encoder_off_its_centre(subject):
    result = found(subject, both(subject))
    first, second = result.gears
    for gear, true in zip((first, second), STIFFNESS, strict=True):
        assert gear.stiffness is not None
        value, std = gear.stiffness
        assert abs(value - true) < max(3.0 * std, 0.03 * true) and std < 0.1 * true
        assert gear.read_delay[0] == pytest.approx(APART, rel=0.05)
        assert gear.after < 0.15 * gear.before
        assert np.sqrt(np.mean((gear.deflection - gear.curve(gear.load)) ** 2)) < 0.3 * PLAY
    assert first.backlash is None  # its torque keeps its sign
    assert second.backlash is not None and second.backlash[0] == pytest.approx(PLAY, rel=0.2)


def test_a_rigid_gear_is_none(subject):
    for gear in found(subject, both(subject, stiff=True)).gears:
        assert gear.stiffness is None or gear.stiffness[0] > 50.0 * max(STIFFNESS)
        assert abs(gear.read_delay[0]) < 5e-5


def test_without_a_second_encoder_nothing_is_said(subject):
    pair = both(subject, linked=False)
    result = found(subject, pair)
    assert result.gears == () and document(result)["encoders"] == {}
    assert gear_encoders.gears(result.motions, ([pair[0]], [pair[1]])) == ()


def test_it_is_told_in_every_place(subject):
    pair = both(subject)
    # not in every recording: nothing to judge it by
    pair[1].qlink[:, 1] = np.nan  # type: ignore[index]
    result = found(subject, pair)
    stated = document(result)
    (name,) = stated["encoders"]
    assert (
        name == subject.robot.joints[0]
        and stated["encoders"][name]["stiffness"]["unit"] == "N m/rad"
    )
    assert f"two encoders at {name}: stiffness" in _text(stated, [])
    assert "What do the two encoders say?" in diagnosis_page(
        result, stated, residual_atlas.compute_atlas(result)
    )
