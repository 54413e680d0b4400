"""Timestamp jitter is estimated and corrected where the joints agree on it, and only there."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excite import recordings
from excite.identification.lowpass import Grid, LowPassFilter
from excite.recordings import RemarkKind, timestamp_jitter

RATE = 500.0
"""Sampling rate [Hz]."""
DURATION = 12.0
"""Length of a recording [s]."""
JITTER = 5e-5
"""Standard deviation of the timing error [s]."""


def motion(seed: int, joints: int):
    """Return times, positions and exact velocities of an excitation with weak higher harmonics.

    Shapes (N,), (N, n), (N, n).
    """
    rng = np.random.default_rng(seed)
    t = np.arange(int(DURATION * RATE)) / RATE
    omega = 2.0 * np.pi * np.array([0.125, 0.25, 0.375, 0.5, 0.625, 4.0, 9.0, 14.0])
    size = np.array([1.0, 0.5, 0.4, 0.3, 0.2, 2e-4, 5e-5, 2e-5])
    a, b = rng.normal(size=(2, len(omega), joints)) * size[:, None]
    phase = np.outer(t, omega)
    return (
        t,
        np.sin(phase) @ a + np.cos(phase) @ b,
        (np.cos(phase) * omega) @ a - (np.sin(phase) * omega) @ b,
    )


def accelerations(q: np.ndarray) -> np.ndarray:
    band = LowPassFilter(20.0, RATE, len(q))
    return band.filter(q, Grid.RECORDED, 2)[band.margin : -band.margin]


@given(seed=st.integers(0, 10**6), joints=st.integers(2, 7))
def test_common_timing_error_is_estimated_and_corrected(seed, joints):
    t, q, velocity = motion(seed, joints)
    delay = JITTER * np.random.default_rng(seed + 1).normal(size=len(t))
    read = (
        q + velocity * delay[:, None] + 1e-7 * np.random.default_rng(seed + 2).normal(size=q.shape)
    )
    jitter = timestamp_jitter.estimate_jitter(t, read, 1.0 / RATE)
    assert jitter is not None and jitter.rms == pytest.approx(JITTER, rel=0.1)
    exact = accelerations(q)
    before, after = (
        np.sqrt(np.mean((accelerations(x) - exact) ** 2)) for x in (read, jitter.corrected(read))
    )
    assert after < 0.8 * before  # of two joints the most, of seven far more
    remaining = timestamp_jitter.estimate_jitter(t, jitter.corrected(read), 1.0 / RATE)
    assert remaining is None or remaining.rms < 0.3 * JITTER


@given(seed=st.integers(0, 10**6), joints=st.integers(1, 7))
def test_independent_noise_is_no_jitter(seed, joints):
    t, q, _ = motion(seed, joints)
    assert (
        timestamp_jitter.estimate_jitter(
            t, q + 5e-5 * np.random.default_rng(seed).normal(size=q.shape), 1.0 / RATE
        )
        is None
    )


def test_jitter_of_a_single_joint_is_ignored():
    t, q, velocity = motion(0, 4)
    q[:, 2] += velocity[:, 2] * JITTER * np.random.default_rng(0).normal(size=len(t))
    assert (
        timestamp_jitter.estimate_jitter(
            t, q + 1e-6 * np.random.default_rng(1).normal(size=q.shape), 1.0 / RATE
        )
        is None
    )


def test_joints_at_standstill_neither_hide_nor_mimic_jitter():
    t, q, velocity = motion(7, 3)
    still = np.tile([0.7, -0.3, 0.0, 1.1], (len(t), 1))
    assert (
        timestamp_jitter.estimate_jitter(t, still, 1.0 / RATE) is None
        and timestamp_jitter.estimate_jitter(t, np.hstack([q, still]), 1.0 / RATE) is None
    )
    read = q + velocity * (JITTER * np.random.default_rng(0).normal(size=len(t)))[:, None]
    jitter = timestamp_jitter.estimate_jitter(t, np.hstack([read, still]), 1.0 / RATE)
    assert jitter is not None and jitter.rms == pytest.approx(JITTER, rel=0.1)


@pytest.mark.parametrize("rate", [50.0, 100.0])
def test_low_sampling_rates_are_not_corrected(rate):
    every = int(RATE / rate)
    t, q, velocity = (x[::every] for x in motion(0, 4))
    delay = 10.0 * JITTER * np.random.default_rng(0).normal(size=len(t))
    assert timestamp_jitter.estimate_jitter(t, q + velocity * delay[:, None], 1.0 / rate) is None


def test_gaps_and_long_recordings_are_processed_in_parts(monkeypatch):
    t, q, velocity = motion(3, 3)
    read = q + velocity * (JITTER * np.random.default_rng(0).normal(size=len(t)))[:, None]
    kept = (t < 5.0) | (t > 6.0)
    jitter = timestamp_jitter.estimate_jitter(t[kept], read[kept], 1.0 / RATE)
    assert (
        jitter is not None
        and len(jitter.delay) == kept.sum()
        and jitter.rms == pytest.approx(JITTER, rel=0.1)
    )
    monkeypatch.setattr(timestamp_jitter, "MAX_STRETCH_TIME", 4.0)
    parts = timestamp_jitter.estimate_jitter(t, read, 1.0 / RATE)
    assert parts is not None and parts.rms == pytest.approx(JITTER, rel=0.1)
    assert np.isfinite(parts.delay).all() and np.std(parts.delay) == pytest.approx(
        JITTER, rel=0.2
    )  # little is caught at ends


def test_recording_is_corrected_with_a_remark(two_link, tmp_path):
    t, q, velocity = motion(5, 2)
    delay = JITTER * np.random.default_rng(0).normal(size=len(t))
    columns = {"t": t}
    for j, name in enumerate(two_link.joints):
        columns |= {
            f"q.{name}": q[:, j] + velocity[:, j] * delay,
            f"tau.{name}": np.cos(t),
            f"qlink.{name}": q[:, j] + velocity[:, j] * delay,
        }
    path = tmp_path / "run.csv"
    np.savetxt(
        path,
        np.column_stack(list(columns.values())),
        fmt="%.17g",
        delimiter=",",
        header=",".join(columns),
        comments="",
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = recordings.read(path, two_link)
    remark = next(r for r in recording.remarks if r.kind is RemarkKind.TIMESTAMP_JITTER)
    assert (
        remark.repaired
        and "ms (rms)" in remark.text
        and any(remark.text in str(w.message) for w in caught)
    )
    read = dataclasses.replace(
        recording, q=np.column_stack([columns[f"q.{name}"] for name in two_link.joints])
    )
    before, after = (
        np.sqrt(np.mean((accelerations(x) - accelerations(q)) ** 2)) for x in (read.q, recording.q)
    )
    assert after < 0.9 * before
    assert (
        recording.qlink is not None and np.abs(recording.q - recording.qlink).max() < 1e-9
    )  # both encoders were read at once
    assert np.array_equal(recording.torque[:, 0], np.cos(t))
