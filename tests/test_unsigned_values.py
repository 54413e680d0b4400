"""Negative numbers that were stored as unsigned integers are named, not taken for a unit."""

from __future__ import annotations

import numpy as np
import pytest
from recording_fixtures import assert_refused, read_with_warnings, two_joint_motion, write_columns

from excite import recordings
from excite.robot.robot import load


@pytest.mark.parametrize("bits", [16, 32])
@pytest.mark.parametrize(("column", "size"), [("tau.joint_2", 40.0), ("q.joint_1", 900.0)])
def test_negative_numbers_stored_unsigned_are_named(tmp_path, column, size, bits):
    columns = two_joint_motion()
    signed = np.round(size * columns[column] / np.abs(columns[column]).max())
    columns[column] = np.where(signed < 0.0, signed + 2.0**bits, signed)
    path = write_columns(tmp_path / "run.csv", columns)
    words = (column, "stored unsigned", f"subtract {2**bits}", str(2 ** (bits - 1) - 1))
    assert_refused(path, load("two_link"), *words)


def test_a_scaled_number_stored_unsigned_is_named(tmp_path):
    columns = two_joint_motion()
    counts = np.round(300.0 * columns["tau.joint_1"])
    columns["tau.joint_1"] = 0.01 * np.where(counts < 0.0, counts + 65536.0, counts)
    path = write_columns(tmp_path / "run.csv", columns)
    assert_refused(path, load("two_link"), "stored unsigned", "655.36", "327.67")


def test_positions_of_an_encoder_of_16_bits_that_wrap_are_unwrapped(tmp_path):
    step = 2.0 * np.pi / 65536.0
    columns = two_joint_motion()
    turned = np.round(columns["q.joint_1"] / step) * step
    path = write_columns(
        tmp_path / "run.csv", {**columns, "q.joint_1": np.mod(turned, 2.0 * np.pi)}
    )
    recording, texts = read_with_warnings(path, load("two_link"))
    assert np.ptp(recording.q) < 1.5 and "unwrapped" in texts[0]


def test_whole_numbers_that_are_positive_are_accepted(tmp_path):
    columns = two_joint_motion()
    columns["tau.joint_1"] = np.round(1e4 + 1e4 * np.sin(columns["t"])) + 0.0
    path = write_columns(tmp_path / "run.csv", columns)
    assert np.nanmax(recordings.read(path, load("two_link")).tau) > 1.9e4


@pytest.mark.parametrize(
    ("digits", "offset", "amplitude", "rows", "jump"),
    [
        (2, 8.0, 3.0, [100, 101], [392.0, 492.25]),
        (3, 0.0, 2.0, [100, 101, 102, 103], [40.0, 41.0, 42.0, 43.0]),
        (3, 1.0, 0.5, list(range(200, 400)), [34.0] * 200),
    ],
    ids=["glitches", "impact", "load"],
)
def test_torque_that_jumps_is_not_taken_for_unsigned(
    tmp_path, digits, offset, amplitude, rows, jump
):
    """Rounded torques above zero that jump into the upper half of 16 bits."""
    columns = two_joint_motion()
    torque = offset + amplitude * np.abs(np.sin(columns["t"]))
    torque[rows] += jump
    columns["tau.joint_1"] = np.round(torque, digits)
    path = write_columns(tmp_path / "run.csv", columns)
    recording, texts = read_with_warnings(path, load("two_link"))
    assert len(recording) and not any("unsigned" in text for text in texts)
