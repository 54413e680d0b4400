"""Noise floor of a diagnosis: it agrees with the residual of a correct model."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from synthetic_recordings import (
    perturbed_parameters,
    random_fourier,
    rnea_torque,
    synthetic_recording,
)

from excite._types import FloatArray
from excite.diagnosis import noise
from excite.effects import recorded_motion
from excite.effects.recorded_motion import RecordedMotion
from excite.identification import identification, segments
from excite.identification.identification import Identification
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording, Sidecar
from excite.trajectory.fourier import FourierSeries


def noise_and_residual(
    subject: IdentificationModel, change: float = 0.0, step: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Estimated noise floor and RMS residual of a recording with torque noise of 0.1 N m.

    change: standard deviation of position noise. step: encoder step [rad].
    """
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    recording = synthetic_recording(subject, psi, random_fourier(2, 1), 3.0, 0.1)
    q = recording.q + change * np.random.default_rng(7).normal(size=recording.q.shape)
    recording = dataclasses.replace(recording, q=np.round(q / step) * step if step else q)
    done = identified(subject, recording)
    motions = motions_of(done.model, recording, done.psi)
    residuals = [motion.residual for motion in motions]
    estimate = noise.estimate_noise(done.model, motions, residuals, [recording])
    return estimate.floor, np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0))


def identified(subject: IdentificationModel, recording: Recording) -> Identification:
    """Identify the robot from a recording."""
    options = identification.IdentificationOptions(band=20.0)
    return identification.identify(
        subject.robot, subject.parameters, subject.base, [recording], (), options
    )


def motions_of(
    model: IdentificationModel, recording: Recording, psi: FloatArray
) -> list[RecordedMotion]:
    """Return the motions of a recording with the base model of given parameters."""
    pieces = list(segments.extract_segments([recording], average=False))
    return recorded_motion.recorded_motions(model, psi, pieces, 20.0)


@pytest.mark.parametrize(
    ("change", "step", "low", "high"),
    [(0.0, 0.0, 0.85, 1.15), (2e-5, 0.0, 0.85, 1.15), (0.0, 1e-4, 0.6, 1.7)],
)
def test_the_noise_floor_agrees_with_the_residual_of_a_correct_model(
    subject, change, step, low, high
):
    floor, residual = noise_and_residual(subject, change, step)
    assert (low < residual / floor).all() and (residual / floor < high).all()


@pytest.mark.parametrize("periods", [4, 1], ids=["repeated", "once"])
@pytest.mark.parametrize("share", [0.4, 0.25])
def test_the_noise_floor_is_that_of_the_rows_in_motion(subject, share, periods):
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    recording = with_rests(subject, psi, share, periods)
    done = identified(subject, recording)
    motions = motions_of(done.model, recording, done.psi)
    moving = np.concatenate([motion.moving for motion in motions])
    assert (moving.mean(axis=0) < 1.1 * share).all()
    residuals = [np.where(motion.moving, motion.residual, 0.0) for motion in motions]
    estimate = noise.estimate_noise(done.model, motions, residuals, [recording])
    assert (estimate.method == "periods") is (periods > 1)
    actual = np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0, where=moving))
    np.testing.assert_allclose(estimate.floor, actual, rtol=0.2)


def test_the_noise_floor_is_not_larger_than_the_residual(subject):
    """The power of what was recorded in steps may lie above the motion alone."""
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    waves = 0.02 * np.random.default_rng(6).normal(size=(2, 2, 80))
    quick = FourierSeries(*waves, np.zeros(2), period=8.0)
    recording = synthetic_recording(subject, psi, quick, 1.0, 0.1)
    done = identified(subject, recording)
    motions = motions_of(done.model, recording, done.psi)
    time = motions[0].time
    spectrum = np.fft.rfft(np.random.default_rng(5).normal(size=(len(time), 2)), axis=0)
    spectrum[np.fft.rfftfreq(len(time), time[1] - time[0]) < 13.0] = 0.0
    high = np.fft.irfft(spectrum, len(time), axis=0)
    residual = np.where(motions[0].moving, high, 0.0)
    estimate = noise.estimate_noise(done.model, motions, [residual], [recording])
    actual = np.sqrt(np.mean(residual**2, axis=0, where=motions[0].moving))
    np.testing.assert_allclose(estimate.floor, actual)


def with_rests(
    subject: IdentificationModel, psi: FloatArray, share: float, periods: int
) -> Recording:
    """Return a recording of 32 s whose joints stand still for most of the time, under friction."""
    rate, period = 200.0, 32.0 / periods
    t = np.arange(round(32.0 * rate)) / rate
    phase = np.minimum((t % period) / (share * period), 1.0)
    # waves of 0.5 Hz that begin and end at rest
    window, wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * phase), np.pi * share * period * phase
    q = window[:, None] * np.column_stack([np.sin(wave), np.cos(1.3 * wave)])
    dq = np.gradient(q, t, axis=0)
    held = 0.8 * (phase >= 1.0)[:, None] * psi[subject.parameters.block("coulomb")]
    tau = rnea_torque(subject, psi, q, dq, np.gradient(dq, t, axis=0)) + held
    tau += 0.1 * np.random.default_rng(1).normal(size=tau.shape)
    sidecar = Sidecar(period=period, periodic=(0.0, float(t[-1]))) if periods > 1 else Sidecar()
    return Recording("rests.csv", subject.robot.joints, t, q, tau=tau, sidecar=sidecar, row_times=t)


def test_an_unstated_period_is_estimated(subject):
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    stated = synthetic_recording(subject, psi, random_fourier(2, 1), 3.0, 0.1)
    assert stated.sidecar.period is not None
    silent = dataclasses.replace(
        stated, sidecar=dataclasses.replace(stated.sidecar, period=None, periodic=None)
    )
    period = noise.estimate_period(silent)
    assert period is not None and period[0] == pytest.approx(stated.sidecar.period, abs=2e-3)
    single = synthetic_recording(
        subject, psi, random_fourier(2, 1, 9.0), 1.0, 0.1, period=None, periodic=None
    )
    assert noise.estimate_period(single) is None
