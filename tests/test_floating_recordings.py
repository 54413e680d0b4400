"""Recordings of a floating base: columns, quaternions, and the motion on SE(3)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from floating_base_fixtures import biped_urdf, generalised_forces, motion_csv

from excite import recordings
from excite.api import read_floating_recording, simulate_floating
from excite.errors import UnusableInput
from excite.identification import floating_regression
from excite.identification.lowpass import Grid, LowPassFilter
from excite.recordings.floating_signals import COMPONENTS
from excite.robot import floating_base

HERTZ = 5.0
"""Cutoff frequency of the filters in these tests [Hz]; the motion ends at 1.5 Hz."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("biped")
    (out / "biped.urdf").write_text(biped_urdf(), encoding="utf-8")
    (out / "motion.csv").write_text(motion_csv(), encoding="utf-8")
    return out


@pytest.fixture(scope="module")
def biped(folder):
    return floating_base.load(folder / "biped.urdf")


@pytest.fixture(scope="module")
def motion(folder, biped):
    return read_floating_recording(folder / "motion.csv", biped)


def written(folder, name, table, header):
    path = folder / name
    lines = [",".join(header), *(",".join(f"{x:.12g}" for x in row) for row in table)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def table_of(folder):
    lines = (folder / "motion.csv").read_text(encoding="utf-8").splitlines()
    return np.array([[float(x) for x in line.split(",")] for line in lines[1:]]), lines[0].split(
        ","
    )


def filtered(recording, robot, hertz=HERTZ):
    band = LowPassFilter(hertz, recording.rate, len(recording))
    return floating_regression.filtered_motion(recording, robot, band, Grid.RECORDED, 1.0)


def inner(recording):
    return slice(len(recording) // 4, 3 * len(recording) // 4)


def test_the_motion_of_the_base_agrees_with_finite_differences(biped, motion):
    result = filtered(motion, biped)
    q = biped.configurations(result)
    dt = motion.step
    velocity = np.array(
        [
            pin.difference(biped.model, before, after) / (2.0 * dt)
            for before, after in zip(q[:-2], q[2:], strict=True)
        ]
    )
    acceleration = np.gradient(result.velocity, dt, axis=0)
    part = inner(motion)
    expected = result.velocity[1:-1][part]
    assert np.allclose(velocity[part], expected, atol=2e-3 * np.abs(expected).max())
    change = result.acceleration[part]
    assert np.allclose(acceleration[part], change, atol=2e-3 * np.abs(change).max())


def test_the_filter_returns_a_slow_motion_unchanged(biped, motion):
    result = filtered(motion, biped)
    part = inner(motion)
    assert np.allclose(result.pose[part], motion.base[part], atol=1e-4)


def test_quaternions_that_change_sign_are_made_continuous(folder, biped, motion):
    table, header = table_of(folder)
    first = header.index("base.qx")
    table[500:900, first : first + 4] *= -1.0
    flipped = read_floating_recording(written(folder, "flipped.csv", table, header), biped)
    assert np.allclose(flipped.base, motion.base, atol=1e-9)


def test_a_quaternion_without_unit_norm_is_refused(folder, biped):
    table, header = table_of(folder)
    table[100, header.index("base.qw")] += 0.5
    with pytest.raises(UnusableInput, match=r"norm.csv: base.qx … base.qw have the norm 1\.\d+"):
        read_floating_recording(written(folder, "norm.csv", table, header), biped)


@pytest.mark.parametrize(
    ("dropped", "message"),
    [
        ("base.qw", r"has no column 'base.qw'.*--columns base.qw=COLUMN"),
        ("wrench.world.my", r"has no column 'wrench.world.my'.*all six components"),
        ("imu.az", r"has no column 'imu.az'.*all three axes"),
    ],
)
def test_an_incomplete_signal_is_refused_by_its_missing_column(folder, biped, dropped, message):
    table, header = table_of(folder)
    further = [*(f"wrench.world.{c}" for c in COMPONENTS), "imu.ax", "imu.ay", "imu.az"]
    header = [*header, *further]
    table = np.column_stack([table, np.ones((len(table), len(further)))])
    kept = [i for i, name in enumerate(header) if name != dropped]
    path = written(folder, "incomplete.csv", table[:, kept], [header[i] for i in kept])
    with pytest.raises(UnusableInput, match=message):
        read_floating_recording(path, biped)


def test_bare_wrench_columns_are_about_the_origin_of_the_world(folder, biped):
    table, header = table_of(folder)
    table = np.column_stack([table, np.tile(np.arange(6.0), (len(table), 1))])
    path = written(folder, "bare.csv", table, [*header, *COMPONENTS])
    recording = read_floating_recording(path, biped)
    assert recording.contacts == ("world",)
    assert np.allclose(recording.wrench("world"), np.arange(6.0))
    names = {f"wrench.left_shank.{c}": c for c in COMPONENTS}
    assert read_floating_recording(path, biped, names).contacts == ("left_shank",)


def test_signals_of_a_floating_base_are_ignored_for_a_fixed_base(folder, biped):
    table, header = table_of(folder)
    path = written(folder, "fixed.csv", table, header)
    recording = recordings.read(path, biped.joint_robot)
    assert recording.base is None and not recording.signals


def test_a_wrench_of_an_unknown_frame_is_refused(folder, biped):
    table, header = table_of(folder)
    table = np.column_stack([table, np.ones((len(table), 6))])
    path = written(folder, "frame.csv", table, [*header, *(f"wrench.foot.{c}" for c in COMPONENTS)])
    with pytest.raises(UnusableInput, match=r"frame.csv: wrench.foot: .* has no frame 'foot'"):
        read_floating_recording(path, biped)


def test_short_gaps_in_a_wrench_are_interpolated_and_long_ones_split(folder, biped):
    table, header = table_of(folder)
    table = np.column_stack([table, np.ones((len(table), 6))])
    table[100:103, -1] = np.nan
    table[1000:1040, -2] = np.nan
    path = folder / "gaps.csv"
    lines = [",".join([*header, *(f"wrench.trunk.{c}" for c in COMPONENTS)])]
    lines += [",".join("" if np.isnan(x) else f"{x:.12g}" for x in row) for row in table]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.warns(UserWarning):
        recording = read_floating_recording(path, biped)
    assert [len(part) for part in recording.segments()] == [1000, 960]
    assert np.isfinite(recording.wrench("trunk")).all()
    texts = " ".join(remark.text for remark in recording.remarks)
    assert "missing values of wrench.trunk.mz" in texts


def test_an_imu_stands_in_place_of_the_differentiated_pose(biped, motion):
    exact = filtered(motion, biped)
    axes = floating_regression.rotations(exact.pose).transpose(0, 2, 1)
    linear = exact.acceleration[:, :3] + np.cross(exact.velocity[:, 3:6], exact.velocity[:, :3])
    force = linear - axes @ np.asarray(biped.model.gravity.linear)
    rng = np.random.default_rng(0)
    noisy = motion.base + 3e-3 * rng.normal(size=motion.base.shape)
    noisy[:, 3:] /= np.linalg.norm(noisy[:, 3:], axis=1)[:, None]
    recording = dataclasses.replace(motion, base=noisy)
    measured = dataclasses.replace(
        recording, signals={"gyroscope": exact.velocity[:, 3:6], "accelerometer": force}
    )
    part = inner(motion)

    def error(candidate):
        wrench = generalised_forces(biped, filtered(candidate, biped))[part, :6]
        expected = generalised_forces(biped, exact)[part, :6]
        return np.sqrt(np.mean((wrench - expected) ** 2))

    assert error(measured) < 0.1 * error(recording)


def test_contact_wrenches_balance_the_inverse_dynamics(folder, biped, motion):
    """Rows of two feet with noise-free wrenches and torques equal Pinocchio's RNEA."""
    simulated = simulate_floating(
        biped,
        motion,
        contacts=("left_shank", "right_shank"),
        wrench_noise=(1e-9, 1e-9),
        torque_noise=(1e-9,),
        model_error=0.0,
    )
    path = simulated.save(folder / "feet.csv")[0]
    recording = read_floating_recording(path, biped)
    state = filtered(recording, biped, 20.0)
    maps = floating_regression.contact_maps(
        biped, state, recording.contacts, floating_base.Rows.BOTH
    )
    wrenches = np.hstack([recording.wrench(frame) for frame in recording.contacts])
    rows = np.einsum("trk,tk->tr", maps, wrenches)
    rows[:, 6:] += recording.torque
    expected = generalised_forces(biped, state)
    expected[:, :6] = floating_regression.in_world_axes(expected[:, :6], state.pose)
    part = inner(recording)
    assert np.allclose(rows[part], expected[part], atol=2e-3 * np.abs(expected).max())


def test_moving_a_wrench_to_the_base_and_back_changes_nothing(motion):
    wrench = np.random.default_rng(0).normal(size=(len(motion), 6))
    there = floating_regression.about_base_origin(wrench, motion.base)
    assert np.allclose(floating_regression.about_world_origin(there, motion.base), wrench)
    pose = pin.SE3(np.eye(3), motion.base[0, :3])
    assert np.allclose(pose.toDualActionMatrix() @ there[0], wrench[0])
