"""Quantized positions are smoothed within the encoder's resolution, others are kept."""

from __future__ import annotations

import dataclasses
import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import diagnose, recordings_of
from hypothesis import given
from hypothesis import strategies as st
from synthetic_recordings import true_parameters, write_recording

import excite
from excite import recordings
from excite.diagnosis import noise
from excite.effects import recorded_motion
from excite.identification import segments
from excite.identification.lowpass import Grid, LowPassFilter
from excite.identification.regression import IdentificationModel
from excite.recordings import encoder_resolution, quantization
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.robot.robot import locate

RATE = 500.0
"""Sampling rate [Hz]."""
DURATION = 12.0
"""Length of a recording [s]."""
RESOLUTION = 2.0 * np.pi / 2**16
"""Resolution of the encoder [rad]."""


def motion(seed: int, joints: int, rate: float = RATE) -> tuple[np.ndarray, np.ndarray]:
    """Return times and positions whose acceleration jumps where friction reverses.

    Shapes (N,), (N, n).
    """
    rng = np.random.default_rng(seed)
    t = np.arange(int(DURATION * rate)) / rate
    omega = 2.0 * np.pi * np.array([0.125, 0.25, 0.375, 0.5, 0.625])
    a, b = rng.normal(size=(2, len(omega), joints)) * np.array([1.0, 0.5, 0.4, 0.3, 0.2])[:, None]
    phase = np.outer(t, omega)
    speed = (np.cos(phase) * omega) @ a - (np.sin(phase) * omega) @ b
    jumps = 0.5 * np.sign(speed)
    reversals = np.cumsum(np.cumsum(jumps - jumps.mean(axis=0), axis=0), axis=0) / rate**2
    return t, np.sin(phase) @ a + np.cos(phase) @ b + 1e-2 * reversals


def quantized(q: np.ndarray, seed: int, step: float = RESOLUTION) -> np.ndarray:
    """Round positions to multiples of a step, each joint with its own origin."""
    origin = np.random.default_rng(seed).uniform(size=q.shape[1]) * step
    return np.round((q + origin) / step) * step - origin


def derivative(q: np.ndarray, order: int, hertz: float, rate: float = RATE) -> np.ndarray:
    band = LowPassFilter(hertz, rate, len(q))
    return band.filter(q, Grid.RECORDED, order)[band.margin : -band.margin]


@pytest.mark.parametrize(
    ("order", "hertz", "largest_ratio"), [(2, 20.0, 0.45), (2, 40.0, 0.2), (1, 60.0, 0.2)]
)
@given(
    seed=st.integers(0, 10**6),
    joints=st.integers(1, 7),
    rate=st.sampled_from([250.0, 500.0, 1000.0]),
    bits=st.integers(10, 16),
)
def test_smoothed_positions_are_more_accurate_than_low_pass_filtered(
    order, hertz, largest_ratio, seed, joints, rate, bits
):
    t, q = motion(seed, joints, rate)
    step = 2.0 * np.pi / 2**bits
    read = quantized(q, seed, step)
    smooth, smoothed = quantization.smooth_positions(t, read, np.full(joints, step))
    assert smoothed.all()
    exact = derivative(q, order, hertz, rate)
    before, after = (
        np.sqrt(np.mean((derivative(x, order, hertz, rate) - exact) ** 2)) for x in (read, smooth)
    )
    assert after < largest_ratio * before


def test_joints_at_standstill_and_fine_encoders():
    t, q = motion(0, 2)
    read = np.column_stack([np.full(len(t), 7.0 * RESOLUTION), q[:, 0], quantized(q, 0)[:, 1]])
    smooth, smoothed = quantization.smooth_positions(
        t, read, np.array([RESOLUTION, 2e-6, RESOLUTION])
    )
    assert smoothed.tolist() == [True, False, True]
    assert (
        np.ptp(smooth[:, 0]) < 1e-9
        and (smooth[:, 1] == read[:, 1]).all()
        and (smooth[:, 2] != read[:, 2]).any()
    )


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0])
@pytest.mark.parametrize("noise", [0.25, 1.0, 5.0])
def test_positions_with_other_noise_are_kept(rate, noise):
    t, q = motion(1, 2, rate)
    rng = np.random.default_rng(2)
    read = quantized(q + np.array([0.0, noise * RESOLUTION]) * rng.normal(size=q.shape), 3)
    smooth, smoothed = quantization.smooth_positions(t, read, np.full(2, RESOLUTION))
    assert smoothed.tolist() == [True, False] and (smooth[:, 1] == read[:, 1]).all()


def test_positions_without_quantization_are_kept():
    t = np.arange(2000) / 100.0
    ramps = 0.5 * np.clip(
        t % 4.0 - 1.0, 0.0, 2.0
    )  # at constant speed, positions are multiples of the motion in a time step
    read = ramps[:, None]
    assert encoder_resolution.estimate_resolution(read)[0] == pytest.approx(5e-3)
    smooth, smoothed = quantization.smooth_positions(
        t, read, encoder_resolution.estimate_resolution(read)
    )
    assert not smoothed.any() and (smooth == read).all()


def test_stretches_between_gaps_are_smoothed_separately():
    t, q = motion(4, 2)
    read = quantized(q, 4)
    rows = np.r_[0:2500, 3200:6000]
    smooth, smoothed = quantization.smooth_positions(t[rows], read[rows], np.full(2, RESOLUTION))
    alone = quantization.smooth_positions(t[:2500], read[:2500], np.full(2, RESOLUTION))[0]
    assert smoothed.all() and (smooth[:2500] == alone).all()
    short, smoothed = quantization.smooth_positions(t[:10], read[:10], np.full(2, RESOLUTION))
    assert (short == read[:10]).all() and not smoothed.any()


@given(seed=st.integers(0, 10**6), digits=st.sampled_from([7, 9]))
def test_resolution_is_the_common_step_of_positions(seed, digits):
    _, q = motion(seed, 2)
    read = np.column_stack(
        [quantized(q, seed)[:, 0], q[:, 1] + 1e-6 * np.random.default_rng(seed).normal(size=len(q))]
    )
    resolution = encoder_resolution.estimate_resolution(np.round(read, digits))
    assert (
        resolution[0] == pytest.approx(RESOLUTION, rel=1e-3)
        and resolution[1] < quantization.MIN_RESOLUTION
    )
    assert (encoder_resolution.estimate_resolution(np.full((100, 2), 0.3)) == 0.0).all()


def test_recording_is_smoothed_with_a_remark(tmp_path, two_link):
    t, q = motion(5, 2)
    read = quantized(q, 5)
    table = np.column_stack([t, read, np.zeros_like(read)])
    header = "t,q.joint_1,q.joint_2,tau.joint_1,tau.joint_2"
    np.savetxt(tmp_path / "r.csv", table, delimiter=",", header=header, comments="", fmt="%.9f")
    (tmp_path / "r.json").write_text(json.dumps({"schema": "excite.recording/1"}))
    recording = recordings.read(tmp_path / "r.csv", two_link)
    exact = derivative(q, 2, 20.0)
    before, after = (
        np.sqrt(np.mean((derivative(x, 2, 20.0) - exact) ** 2)) for x in (read, recording.q)
    )
    assert after < 0.8 * before and recording.quantization_noise == pytest.approx(
        RESOLUTION / np.sqrt(12.0), rel=1e-3
    )
    (piece,) = segments.extract_segments([recording])
    assert piece.smoothed.all() and any(
        r.kind is recordings.RemarkKind.ROUNDED and r.repaired for r in recording.remarks
    )


def test_simulated_quantization_residual_has_the_size_of_the_actual_one(tmp_path):
    pytest.importorskip("mujoco")
    from excite.simulator import experiment

    machine = robot.load("two_link")
    table = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, table)
    setting = experiment.ExperimentSettings(seed=3)
    fine = experiment.simulate(
        locate("two_link"),
        Path(__file__).parents[1] / "trajectories/two_link.json",
        setting,
        periods=1,
    )
    true = true_parameters(fine.robot, standard, table)
    model = IdentificationModel(
        machine,
        standard,
        base_parameters.find(machine, standard, table),
        fine.robot.actuators.width,
    )

    def tracked(resolution: float) -> list[recorded_motion.RecordedMotion]:
        chain = dataclasses.replace(fine.chain, encoder=resolution)
        read = dataclasses.replace(
            fine.recording, q=chain.quantise_positions(fine.motion.measured(fine.recording.t)[0])
        )
        path = tmp_path / "r.csv"
        path.write_text(read.to_csv())
        return recorded_motion.recorded_motions(
            model,
            true,
            list(segments.extract_segments([recordings.read(path, machine)])),
            20.0,
        )

    exact, coarse = tracked(1e-9), tracked(RESOLUTION)
    assert coarse[0].segment.smoothed.all() and not exact[0].segment.smoothed.any()
    actual = np.concatenate([a.residual - b.residual for a, b in zip(coarse, exact, strict=True)])
    simulated = np.concatenate(noise.quantization_residuals(model, coarse))
    ratio = np.sqrt(np.mean(simulated**2, axis=0) / np.mean(actual**2, axis=0))
    assert (ratio > 0.45).all() and (ratio < 1.8).all()  # less: smoothing is assumed for both


@pytest.mark.slow
def test_rounded_positions_are_no_effect(tmp_path):
    files = []
    for recording in recordings_of(None, (2, 8, 5)):
        rounded = dataclasses.replace(recording, q=quantized(recording.q, 1, 2e-4))
        files.append(write_recording(rounded, tmp_path / recording.source))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = excite.diagnose("two_link", files[:2], files[2:], with_report=False)
    assert not result.findings and result.document()["verdict"] == "no-mismatch"


def test_rounded_torque_is_no_effect():
    rounded = [
        dataclasses.replace(r, tau=np.round(r.torque)) for r in recordings_of(None, (2, 8, 5))
    ]
    result = diagnose(rounded)
    assert result.verdict == "no-mismatch"
    np.testing.assert_allclose(result.residual, result.noise.floor, rtol=0.3)
