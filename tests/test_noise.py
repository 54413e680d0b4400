"""Noise floor of a diagnosis: it agrees with the residual of a correct model."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from synthetic_recordings import (
    PERIOD,
    perturbed_parameters,
    random_fourier,
    rnea_torque,
    synthetic_recording,
)

from excite._types import FloatArray
from excite.diagnosis import noise
from excite.effects import recorded_motion
from excite.identification import identification, segments
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording
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
    done = identification.identify(
        subject.robot,
        subject.parameters,
        subject.base,
        [recording],
        [recording],
        identification.IdentificationOptions(band=20.0),
        lambda _: None,
    )
    theta = subject.base.matrix @ done.psi
    body = recorded_motion.fitted_robot(subject.robot, subject.parameters, done.psi)
    tracks = recorded_motion.recorded_motions(
        done.model, body, theta, list(segments.extract_segments([recording], average=False)), 20.0
    )
    residual = np.concatenate([t.torque - t.gamma @ theta for t in tracks])
    return noise.estimate_noise(done, (tracks, tracks), [recording]).floor, np.sqrt(
        np.mean(residual**2, axis=0)
    )


@pytest.mark.parametrize(
    ("change", "step", "low", "high"),
    [(0.0, 0.0, 0.85, 1.15), (2e-5, 0.0, 0.85, 1.15), (0.0, 1e-4, 0.6, 1.7)],
)
def test_the_noise_floor_agrees_with_the_residual_of_a_correct_model(
    subject, change, step, low, high
):
    floor, residual = noise_and_residual(subject, change, step)
    assert (low < residual / floor).all() and (residual / floor < high).all()


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


def recording_with_jitter(
    subject: IdentificationModel, psi: FloatArray, fourier: FourierSeries, periods: float, by: float
) -> Recording:
    """A recording with timestamp jitter of a standard deviation `by` [s], equal for all joints."""
    clean = synthetic_recording(subject, psi, fourier, periods, 0.0)
    rng = np.random.default_rng(len(clean.t))
    s = fourier.samples(clean.t + by * rng.normal(size=len(clean.t)))
    noisy = rnea_torque(subject, psi, s.q, s.dq, s.ddq) + 0.02 * rng.normal(size=s.q.shape)
    return dataclasses.replace(clean, q=s.q, tau=noisy, source=f"{periods:g}.csv")


@pytest.mark.parametrize(("by", "limit"), [(1e-4, 5.0), (0.0, 1.8)])
def test_the_residual_due_to_timestamp_jitter_grows_with_the_motion(subject, by, limit):
    """Bounds of a correct model's residual in a slow periodic and a fast aperiodic recording."""
    psi, other = (
        perturbed_parameters(subject.parameters, np.random.default_rng(4)),
        random_fourier(2, 2),
    )
    slow = recording_with_jitter(subject, psi, random_fourier(2, 1), 4.0, by)
    fast = recording_with_jitter(
        subject,
        psi,
        dataclasses.replace(other, sine=2.0 * other.sine, cosine=2.0 * other.cosine),
        3.0,
        by,
    )
    fast = dataclasses.replace(
        fast, sidecar=dataclasses.replace(fast.sidecar, periodic=(0.0, PERIOD))
    )  # too short to repeat
    options = identification.IdentificationOptions(band=20.0)
    done = identification.identify(
        subject.robot, subject.parameters, subject.base, [slow], [fast], options, lambda _: None
    )
    theta, body = (
        subject.base.matrix @ psi,
        recorded_motion.fitted_robot(subject.robot, subject.parameters, psi),
    )
    folds = [
        recorded_motion.recorded_motions(
            done.model,
            body,
            theta,
            list(segments.extract_segments([recording], average=False)),
            20.0,
        )
        for recording in (slow, fast)
    ]
    estimate = noise.estimate_noise(done, folds, [slow, fast])
    level = (
        np.mean(np.concatenate([t.residual for fold in folds for t in fold]) ** 2, axis=0)
        / estimate.floor**2
    )
    assert (level > 2.0).all() == (by > 0.0)  # the floor is that of the slow recording
    largest, (low, high) = 1.0 + estimate.clock / estimate.floor**2, estimate.bounds
    assert (
        (0.85 * low < level).all() and (level < 1.2 * largest).all() and (largest < limit).all()
    ), (
        level,
        largest,
    )
    assert high == pytest.approx(np.minimum(largest, 1.0 + noise.MAX_DOUBTFUL_NOISE), rel=1e-3)


def test_noise_bounds_follow_the_noise_of_the_encoders():
    estimate = noise.NoiseEstimate(
        np.array([1.0, 2.0]),
        "periods",
        np.array([0.0, 2.0]),
        np.array([0.6, 0.0]),
        (),
        (np.zeros((1, 2)),) * 2,
    )
    low, high = estimate.bounds
    assert low == pytest.approx([0.64, 1.0])
    assert high == pytest.approx([1.36, 1.5])
