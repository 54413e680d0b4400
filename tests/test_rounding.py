"""Positions that an encoder rounded: the smoothest within its steps are nearer to the truth, and
noise of another kind is left alone."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_recordings import true_parameters

from excite import recordings
from excite.diagnosis import noise
from excite.effects import recorded_motion
from excite.identification import segments
from excite.identification.lowpass import Grid, LowPassFilter
from excite.identification.regression import IdentificationModel
from excite.recordings import encoder, quantization
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.robot.robot import locate

RATE, SECONDS, STEP = 500.0, 12.0, 2.0 * np.pi / 2**16


def motion(seed: int, joints: int, rate: float = RATE) -> tuple[np.ndarray, np.ndarray]:
    """Smooth positions, and what friction that reverses adds: acceleration jumps where they turn
    back. Shapes (N,), (N, n)."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(SECONDS * rate)) / rate
    omega = 2.0 * np.pi * np.array([0.125, 0.25, 0.375, 0.5, 0.625])
    a, b = rng.normal(size=(2, len(omega), joints)) * np.array([1.0, 0.5, 0.4, 0.3, 0.2])[:, None]
    phase = np.outer(t, omega)
    speed = (np.cos(phase) * omega) @ a - (np.sin(phase) * omega) @ b
    jumps = 0.5 * np.sign(speed)
    added = np.cumsum(np.cumsum(jumps - jumps.mean(axis=0), axis=0), axis=0) / rate**2
    return t, np.sin(phase) @ a + np.cos(phase) @ b + 1e-2 * added


def read(q: np.ndarray, seed: int, step: float = STEP) -> np.ndarray:
    origin = np.random.default_rng(seed).uniform(size=q.shape[1]) * step
    return np.round((q + origin) / step) * step - origin


def derivative(q: np.ndarray, order: int, hertz: float, rate: float = RATE) -> np.ndarray:
    band = LowPassFilter(hertz, rate, len(q))
    return band.filter(q, Grid.RECORDED, order)[band.margin : -band.margin]


@pytest.mark.parametrize(
    ("order", "hertz", "most"), [(2, 20.0, 0.45), (2, 40.0, 0.2), (1, 60.0, 0.2)]
)
@given(
    seed=st.integers(0, 10**6),
    joints=st.integers(1, 7),
    rate=st.sampled_from([250.0, 500.0, 1000.0]),
    bits=st.integers(10, 16),
)
def test_what_is_smooth_within_the_steps_is_nearer_to_the_truth_than_a_low_pass(
    order, hertz, most, seed, joints, rate, bits
):
    t, q = motion(seed, joints, rate)
    step = 2.0 * np.pi / 2**bits
    told = read(q, seed, step)
    smooth, which = quantization.smoothest(t, told, np.full(joints, step))
    assert which.all()
    right = derivative(q, order, hertz, rate)
    before, after = (
        np.sqrt(np.mean((derivative(x, order, hertz, rate) - right) ** 2)) for x in (told, smooth)
    )
    assert after < most * before


def test_a_joint_that_stands_stands_and_a_fine_one_is_left():
    t, q = motion(0, 2)
    told = np.column_stack([np.full(len(t), 7.0 * STEP), q[:, 0], read(q, 0)[:, 1]])
    smooth, which = quantization.smoothest(t, told, np.array([STEP, 2e-6, STEP]))
    assert which.tolist() == [True, False, True]
    assert (
        np.ptp(smooth[:, 0]) < 1e-9
        and (smooth[:, 1] == told[:, 1]).all()
        and (smooth[:, 2] != told[:, 2]).any()
    )


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0])
@pytest.mark.parametrize("noise", [0.25, 1.0, 5.0])
def test_what_has_noise_besides_is_left(rate, noise):
    t, q = motion(1, 2, rate)
    rng = np.random.default_rng(2)
    told = read(q + np.array([0.0, noise * STEP]) * rng.normal(size=q.shape), 3)
    smooth, which = quantization.smoothest(t, told, np.full(2, STEP))
    assert which.tolist() == [True, False] and (smooth[:, 1] == told[:, 1]).all()


def test_positions_that_nobody_rounded_are_left():
    t = np.arange(2000) / 100.0
    ramps = 0.5 * np.clip(
        t % 4.0 - 1.0, 0.0, 2.0
    )  # at rest, at one speed: multiples of what it goes in a row
    told = ramps[:, None]
    assert encoder.steps(told)[0] == pytest.approx(5e-3)
    smooth, which = quantization.smoothest(t, told, encoder.steps(told))
    assert not which.any() and (smooth == told).all()


def test_stretches_between_gaps_each_by_itself():
    t, q = motion(4, 2)
    told = read(q, 4)
    rows = np.r_[0:2500, 3200:6000]
    smooth, which = quantization.smoothest(t[rows], told[rows], np.full(2, STEP))
    alone = quantization.smoothest(t[:2500], told[:2500], np.full(2, STEP))[0]
    assert which.all() and (smooth[:2500] == alone).all()
    short, which = quantization.smoothest(t[:10], told[:10], np.full(2, STEP))
    assert (short == told[:10]).all() and not which.any()


@given(seed=st.integers(0, 10**6), digits=st.sampled_from([7, 9]))
def test_steps_are_what_positions_are_multiples_of(seed, digits):
    _, q = motion(seed, 2)
    told = np.column_stack(
        [read(q, seed)[:, 0], q[:, 1] + 1e-6 * np.random.default_rng(seed).normal(size=len(q))]
    )
    found = encoder.steps(np.round(told, digits))
    assert found[0] == pytest.approx(STEP, rel=1e-3) and found[1] < quantization.FINE
    assert (encoder.steps(np.full((100, 2), 0.3)) == 0.0).all()


def test_a_recording_has_the_smoothest_and_remembers_how_it_was_read(tmp_path, two_link):
    t, q = motion(5, 2)
    told = read(q, 5)
    table = np.column_stack([t, told, np.zeros_like(told)])
    header = "t,q.joint_1,q.joint_2,tau.joint_1,tau.joint_2"
    np.savetxt(tmp_path / "r.csv", table, delimiter=",", header=header, comments="", fmt="%.9f")
    (tmp_path / "r.json").write_text(json.dumps({"schema": "excite.recording/1"}))
    found = recordings.read(tmp_path / "r.csv", two_link)
    right = derivative(q, 2, 20.0)
    before, after = (
        np.sqrt(np.mean((derivative(x, 2, 20.0) - right) ** 2)) for x in (told, found.q)
    )
    assert after < 0.8 * before and found.encoder == pytest.approx(STEP / np.sqrt(12.0), rel=1e-3)
    (piece,) = segments.extract_segments([found])
    assert piece.smoothed.all() and any(
        r.kind is recordings.Kind.ROUNDED and r.repaired for r in found.remarks
    )


def test_what_steps_are_said_to_feign_is_of_the_size_of_what_they_do(tmp_path):
    pytest.importorskip("mujoco")
    from excite.simulator import experiment

    machine = robot.load("two_link")
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
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
    theta, body = model.base.matrix @ true, recorded_motion.fitted_robot(machine, standard, true)

    def tracked(resolution: float) -> list[recorded_motion.RecordedMotion]:
        chain = dataclasses.replace(fine.chain, encoder=resolution)
        told = dataclasses.replace(
            fine.recording, q=chain.quantise_positions(fine.motion.measured(fine.recording.t)[0])
        )
        path = tmp_path / "r.csv"
        path.write_text(told.to_csv())
        return recorded_motion.recorded_motions(
            model,
            body,
            theta,
            list(segments.extract_segments([recordings.read(path, machine)])),
            20.0,
        )

    right, coarse = tracked(1e-9), tracked(STEP)
    assert coarse[0].segment.smoothed.all() and not right[0].segment.smoothed.any()
    done = np.concatenate([a.residual - b.residual for a, b in zip(coarse, right, strict=True)])
    said = np.concatenate(
        [half for draw in noise.quantization_residuals(model, (coarse, coarse)) for half in draw]
    )
    ratio = np.sqrt(np.mean(said**2, axis=0) / np.mean(done**2, axis=0))
    assert (ratio > 0.45).all() and (
        ratio < 1.8
    ).all()  # a little less: that a motion is the smoothest is assumed both times
