"""The default band follows from what the recorded positions carry."""

from __future__ import annotations

import dataclasses
import functools
import os
import warnings
from pathlib import Path

import numpy as np
import pytest
from recording_fixtures import two_joint_motion, write_columns

from excite import api
from excite.errors import UnusableInput
from excite.identification import position_bandwidth, regression, segments
from excite.identification.nominal_comparison import nominal_torque
from excite.identification.segments import RecordingSegment
from excite.robot.samples import Samples

RATE = 100.0
REAL = (
    Path(os.environ.get("EXCITE_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    / "recordings"
)


def segment(robot, jitter: float) -> RecordingSegment:
    """A motion with the torque that it needs, and positions that were read at jittered times."""
    t = np.arange(3000) / RATE
    frequencies = 2.0 * np.pi * np.array([[0.23, 0.61, 1.1], [0.31, 0.47, 1.3]])
    phases = frequencies[None] * t[:, None, None]
    q = 0.4 * np.sin(phases).sum(axis=2)
    dq = 0.4 * (frequencies * np.cos(phases)).sum(axis=2)
    ddq = -0.4 * (frequencies**2 * np.sin(phases)).sum(axis=2)
    torque = sum(nominal_torque(robot, Samples(q, dq, ddq)))
    generator = np.random.default_rng(0)
    torque = torque + 0.02 * generator.standard_normal(torque.shape)
    read_late = jitter * generator.standard_normal((len(t), 1))
    return RecordingSegment("r.csv", 0.0, RATE, q + dq * read_late, torque)


def test_even_stamps_carry_all(two_link):
    assert position_bandwidth.position_bandwidth(segment(two_link, 0.0), two_link) == np.inf


def test_jitter_limits_the_band(two_link):
    limits = [
        position_bandwidth.position_bandwidth(segment(two_link, jitter), two_link)
        for jitter in (1e-3, 5e-3)
    ]
    motion = segments.motion_bandwidth(segment(two_link, 0.0))
    assert np.inf > limits[0] >= limits[1] >= motion


def test_the_recording_with_the_most_jitter_limits_the_band(two_link):
    jittered = dataclasses.replace(segment(two_link, 5e-3).head(2500), source="other.csv")
    parts = [segment(two_link, 0.0), jittered]
    carried = functools.partial(position_bandwidth.position_bandwidth, robot=two_link)
    assert segments.torque_spectra(parts, None, carried).hertz == carried(jittered) < 20.0


def test_the_filter_leaves_half_of_a_short_recording(two_link):
    short = segment(two_link, 5e-3).head(800)
    carried = position_bandwidth.position_bandwidth(short, two_link)
    chosen = segments.torque_spectra([short], None, lambda _: carried).hertz
    assert chosen > carried
    assert 2 * short.band(chosen).margin <= 0.51 * len(short)
    assert segments.torque_spectra([short], 1.5, lambda _: carried).hertz == 1.5


@pytest.mark.filterwarnings("ignore::excite.errors.ExciteWarning")
@pytest.mark.parametrize("seconds", [0.1, 0.2, 0.3])
def test_the_band_that_a_short_recording_permits_is_named(seconds, tmp_path):
    motion = two_joint_motion(round(500.0 * seconds), 500.0)
    path = write_columns(tmp_path / "r.csv", motion)
    with pytest.raises(UnusableInput, match=r"higher --band: at least [0-9]+ Hz") as refusal:
        api.identify("two_link", path)
    band = float(str(refusal.value).split()[-2])
    assert api.identify("two_link", path, band=band).identification.spectra.hertz == band


@pytest.mark.filterwarnings("ignore::excite.errors.ExciteWarning")
@pytest.mark.parametrize("band", [1.55, 1.75, 1.9])
def test_a_band_that_leaves_too_few_rows_is_refused(band):
    folder = REAL / "double_pendulum"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {REAL}")
    with pytest.raises(UnusableInput, match="higher --band"):
        api.identify(folder / "double_pendulum.urdf", [folder / "trajectory_02.csv"], band=band)


@pytest.mark.parametrize(
    ("folder", "urdf", "train", "validate", "most"),
    [
        ("panda_unit2", "panda", ["train"], "validate", 0.028),
        (
            *("double_pendulum", "double_pendulum"),
            ["trajectory_00", "trajectory_01", "trajectory_02"],
            *("trajectory_03", 0.19),
        ),
        ("lwr4", "lwr4", ["slow_1", "slow_2"], "fast_3", 0.045),
    ],
)
def test_defaults_are_not_worse_than_least_squares(folder, urdf, train, validate, most):
    if not (REAL / folder).is_dir():
        pytest.skip(f"no real recordings at {REAL / folder}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = api.identify(
            REAL / folder / f"{urdf}.urdf",
            [REAL / folder / f"{name}.csv" for name in train],
            validate=[REAL / folder / f"{validate}.csv"],
        )
    (prediction,) = result.identification.validations
    equations = result.identification.equations
    columns = equations.regressor.shape[2]
    theta = np.linalg.lstsq(
        equations.regressor.reshape(-1, columns), equations.torque.ravel(), rcond=None
    )[0]
    parts = list(segments.extract_segments(result.validation, average=False))
    held_out = regression.build_equations(result.identification.model, parts, equations.hertz)
    ordinary = held_out.torque - held_out.predicted(theta)
    size = np.sum(held_out.torque**2)
    error = np.sqrt(np.sum((prediction.measured - prediction.fitted) ** 2) / size)
    assert error < most
    assert error < 1.05 * np.sqrt(np.sum(ordinary**2) / size)
