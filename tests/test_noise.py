"""What of a residual is noise: what a right model leaves, however the recording was made."""

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

from excite.diagnosis import noise
from excite.effects import recorded_motion
from excite.identification import identification, segments
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording
from excite.trajectory.fourier import FourierSeries

Array = np.ndarray


def measured(subject: IdentificationModel, change: float = 0.0, step: float = 0.0) -> tuple[Array, Array]:
    """Noise found and the RMS that the base model leaves, of a periodic recording whose torque noise is known to be 0.1 N m."""
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
    left = np.concatenate([t.torque - t.gamma @ theta for t in tracks])
    return noise.estimate_noise(done, (tracks, tracks), [recording]).floor, np.sqrt(
        np.mean(left**2, axis=0)
    )


@pytest.mark.parametrize(
    ("change", "step", "low", "high"),
    [(0.0, 0.0, 0.85, 1.15), (2e-5, 0.0, 0.85, 1.15), (0.0, 1e-4, 0.6, 1.7)],
)
def test_the_floor_is_what_a_right_model_leaves_whatever_is_noisy(subject, change, step, low, high):
    floor, left = measured(subject, change, step)
    assert (low < left / floor).all() and (left / floor < high).all(), left / floor


def test_a_period_is_found_where_nobody_states_it(subject):
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    stated = synthetic_recording(subject, psi, random_fourier(2, 1), 3.0, 0.1)
    assert stated.sidecar.period is not None
    silent = dataclasses.replace(
        stated, sidecar=dataclasses.replace(stated.sidecar, period=None, periodic=None)
    )
    found_period = noise._period(silent)
    assert found_period is not None and found_period[0] == pytest.approx(
        stated.sidecar.period, abs=2e-3
    )
    once = synthetic_recording(subject, psi, random_fourier(2, 1, 9.0), 1.0, 0.1, period=None, periodic=None)
    assert noise._period(once) is None


def wavering(subject: IdentificationModel, psi: Array, fourier: FourierSeries, periods: float, by: float) -> Recording:
    """Positions and torque both read a little earlier or later than the clock says, all joints at once. by: [s]."""
    one = synthetic_recording(subject, psi, fourier, periods, 0.0)
    rng = np.random.default_rng(len(one.t))
    s = fourier.samples(one.t + by * rng.normal(size=len(one.t)))
    noisy = rnea_torque(subject, psi, s.q, s.dq, s.ddq) + 0.02 * rng.normal(size=s.q.shape)
    return dataclasses.replace(one, q=s.q, tau=noisy, source=f"{periods:g}.csv")


@pytest.mark.parametrize(("by", "most"), [(1e-4, 5.0), (0.0, 1.8)])
def test_a_clock_that_wavers_is_louder_where_momentum_is_more(subject, by, most):
    """A recording that repeats, and a faster one that does not: what a right model leaves of both is foretold."""
    psi, other = perturbed_parameters(subject.parameters, np.random.default_rng(4)), random_fourier(2, 2)
    slow = wavering(subject, psi, random_fourier(2, 1), 4.0, by)
    fast = wavering(
        subject,
        psi,
        dataclasses.replace(other, sine=2.0 * other.sine, cosine=2.0 * other.cosine),
        3.0,
        by,
    )
    fast = dataclasses.replace(
        fast, sidecar=dataclasses.replace(fast.sidecar, periodic=(0.0, PERIOD))
    )  # hardly repeats
    options = identification.IdentificationOptions(band=20.0)
    done = identification.identify(
        subject.robot, subject.parameters, subject.base, [slow], [fast], options, lambda _: None
    )
    theta, body = subject.base.matrix @ psi, recorded_motion.fitted_robot(subject.robot, subject.parameters, psi)
    halves = [
        recorded_motion.recorded_motions(done.model, body, theta, list(segments.extract_segments([one], average=False)), 20.0)
        for one in (slow, fast)
    ]
    found = noise.estimate_noise(done, halves, [slow, fast])
    level = (
        np.mean(np.concatenate([t.residual for half in halves for t in half]) ** 2, axis=0)
        / found.floor**2
    )
    assert (level > 2.0).all() == (by > 0.0)  # the floor is the slow one's
    loud, (low, high) = 1.0 + found.clock / found.floor**2, found.bounds
    assert (0.85 * low < level).all() and (level < 1.2 * loud).all() and (loud < most).all(), (
        level,
        loud,
    )
    assert high == pytest.approx(np.minimum(loud, 1.0 + noise.DOUBTFUL), rel=1e-3)


def test_noise_lies_between_none_and_twice_of_what_encoders_make():
    told = noise.NoiseEstimate(
        np.array([1.0, 2.0]),
        "periods",
        np.array([0.0, 2.0]),
        np.array([0.6, 0.0]),
        (),
        (np.zeros((1, 2)),) * 2,
    )
    low, high = told.bounds
    assert low == pytest.approx([0.64, 1.0])
    assert high == pytest.approx([1.36, 1.5])
