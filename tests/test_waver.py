"""A clock that wavers: seen where joints agree, taken out of positions, and never where they
don't."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excite import recordings
from excite.identification.lowpass import Grid, LowPassFilter
from excite.recordings import Kind, timestamp_jitter

RATE, SECONDS, LATE = 500.0, 12.0, 5e-5


def motion(seed: int, joints: int):
    """Smooth positions and their exact speeds, harmonics as of an excitation, with a little that
    reversals add. Shapes (N,), (N, n)."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(SECONDS * RATE)) / RATE
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
def test_what_all_joints_share_is_found_and_taken_out(seed, joints):
    t, q, speed = motion(seed, joints)
    late = LATE * np.random.default_rng(seed + 1).normal(size=len(t))
    read = q + speed * late[:, None] + 1e-7 * np.random.default_rng(seed + 2).normal(size=q.shape)
    found = timestamp_jitter.found(t, read, 1.0 / RATE)
    assert found is not None and found.rms == pytest.approx(LATE, rel=0.1)
    right = accelerations(q)
    before, after = (
        np.sqrt(np.mean((accelerations(x) - right) ** 2)) for x in (read, found.taken(read))
    )
    assert after < 0.8 * before  # of two joints the most, of seven far more
    again = timestamp_jitter.found(t, found.taken(read), 1.0 / RATE)
    assert again is None or again.rms < 0.3 * LATE


@given(seed=st.integers(0, 10**6), joints=st.integers(1, 7))
def test_noise_of_their_own_is_none(seed, joints):
    t, q, _ = motion(seed, joints)
    assert (
        timestamp_jitter.found(
            t, q + 5e-5 * np.random.default_rng(seed).normal(size=q.shape), 1.0 / RATE
        )
        is None
    )


def test_one_joint_that_wavers_says_nothing_of_a_clock():
    t, q, speed = motion(0, 4)
    q[:, 2] += speed[:, 2] * LATE * np.random.default_rng(0).normal(size=len(t))
    assert (
        timestamp_jitter.found(
            t, q + 1e-6 * np.random.default_rng(1).normal(size=q.shape), 1.0 / RATE
        )
        is None
    )


def test_joints_that_stand_neither_hide_a_waver_nor_make_one():
    t, q, speed = motion(7, 3)
    still = np.tile([0.7, -0.3, 0.0, 1.1], (len(t), 1))
    assert (
        timestamp_jitter.found(t, still, 1.0 / RATE) is None
        and timestamp_jitter.found(t, np.hstack([q, still]), 1.0 / RATE) is None
    )
    read = q + speed * (LATE * np.random.default_rng(0).normal(size=len(t)))[:, None]
    found = timestamp_jitter.found(t, np.hstack([read, still]), 1.0 / RATE)
    assert found is not None and found.rms == pytest.approx(LATE, rel=0.1)


@pytest.mark.parametrize("rate", [50.0, 100.0])
def test_rows_too_rare_to_show_it_are_left(rate):
    every = int(RATE / rate)
    t, q, speed = (x[::every] for x in motion(0, 4))
    late = 10.0 * LATE * np.random.default_rng(0).normal(size=len(t))
    assert timestamp_jitter.found(t, q + speed * late[:, None], 1.0 / rate) is None


def test_gaps_and_long_recordings_come_in_parts(monkeypatch):
    t, q, speed = motion(3, 3)
    read = q + speed * (LATE * np.random.default_rng(0).normal(size=len(t)))[:, None]
    kept = (t < 5.0) | (t > 6.0)
    found = timestamp_jitter.found(t[kept], read[kept], 1.0 / RATE)
    assert (
        found is not None
        and len(found.late) == kept.sum()
        and found.rms == pytest.approx(LATE, rel=0.1)
    )
    monkeypatch.setattr(timestamp_jitter, "LONGEST", 4.0)
    parts = timestamp_jitter.found(t, read, 1.0 / RATE)
    assert parts is not None and parts.rms == pytest.approx(LATE, rel=0.1)
    assert np.isfinite(parts.late).all() and np.std(parts.late) == pytest.approx(
        LATE, rel=0.2
    )  # little is told at ends


def test_a_recording_is_repaired_and_says_so(two_link, tmp_path):
    t, q, speed = motion(5, 2)
    late = LATE * np.random.default_rng(0).normal(size=len(t))
    columns = {"t": t}
    for j, name in enumerate(two_link.joints):
        columns |= {
            f"q.{name}": q[:, j] + speed[:, j] * late,
            f"tau.{name}": np.cos(t),
            f"qlink.{name}": q[:, j] + speed[:, j] * late,
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
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = recordings.read(path, two_link)
    remark = next(r for r in found.remarks if r.kind is Kind.WAVER)
    assert (
        remark.repaired
        and "ms (rms)" in remark.text
        and any(remark.text in str(w.message) for w in told)
    )
    read = dataclasses.replace(
        found, q=np.column_stack([columns[f"q.{name}"] for name in two_link.joints])
    )
    before, after = (
        np.sqrt(np.mean((accelerations(x) - accelerations(q)) ** 2)) for x in (read.q, found.q)
    )
    assert after < 0.9 * before
    assert (
        found.qlink is not None and np.abs(found.q - found.qlink).max() < 1e-9
    )  # both encoders were read at once
    assert np.array_equal(found.torque[:, 0], np.cos(t))
