"""Diagnosis of a slow recording and a fast one, neither of which predicts the other well."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from diagnosis_cases import (
    COULOMB,
    NOISE,
    PERIODS,
    PSI,
    RATE,
    SUBJECT,
    VISCOUS,
    diagnose,
    findings_of,
    friction_sign,
)
from synthetic_recordings import random_fourier, synthetic_recording

from excite.recordings import Recording
from excite.trajectory.fourier import FourierSeries

DRAG, WARM_FRICTION, WARMING_TIME = 10.0, 0.5, 5.0


def slow_wave(seed: int) -> FourierSeries:
    """Return a motion of one slow wave."""
    sine, cosine = np.zeros((2, 2, 4))
    sine[:, 0] = np.random.default_rng(seed).normal(0.0, 0.08, 2)
    return FourierSeries(sine, cosine, np.zeros(2), 5.0)


def recording(fourier: FourierSeries, seed: int) -> Recording:
    """Return a recording with drag at the shoulder and friction that falls as the elbow warms."""
    plain = synthetic_recording(SUBJECT, PSI, fourier, PERIODS, 0.0, RATE)
    speed, cold = fourier.samples(plain.t).dq, np.exp(-plain.t / WARMING_TIME)
    friction = COULOMB[1] * friction_sign(speed[:, 1]) + VISCOUS[1] * speed[:, 1]
    hidden = np.column_stack(
        [
            DRAG * speed[:, 0] * np.abs(speed[:, 0]),
            -(1.0 - WARM_FRICTION) * friction * (1.0 - cold),
        ]
    )
    noise = NOISE * np.random.default_rng(seed).normal(size=hidden.shape)
    return dataclasses.replace(plain, tau=plain.torque + hidden + noise, source=f"{seed}.csv")


@pytest.mark.slow
def test_what_one_joint_cannot_predict_hides_no_effect_of_another():
    motions = {7: slow_wave(7), 3: random_fourier(2, 3), 5: random_fourier(2, 5)}
    result = diagnose([recording(fourier, seed) for seed, fourier in motions.items()])
    findings = findings_of(result)
    assert ("thermal_drift", 1) in findings
    # one thing at a joint
    assert {("drag", 0), ("nonlinear_viscous", 0)} & set(findings)


def test_cutoff_frequency_is_one_that_the_slowest_recording_permits():
    whole = recording(random_fourier(2, 3), 3)
    coarse = dataclasses.replace(
        whole, t=whole.t[::8], q=whole.q[::8], tau=whole.torque[::8], row_times=whole.t[::8]
    )
    assert diagnose([whole, coarse]).hertz <= 0.4 * coarse.rate
