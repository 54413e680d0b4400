"""Recordings with faults: clocks, gaps, and numbers that are missing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_fixtures import (
    DamagedMotion,
    assert_refused,
    read_with_warnings,
    remark_kinds,
    two_joint_motion,
    write_columns,
)

from excite.identification import segments as segments_module
from excite.recordings import Kind

# -- time ------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 10**6))
def test_rows_in_any_order_and_repeated_come_back_in_order(two_link, tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    which = rng.permutation(np.concatenate([np.arange(400), rng.integers(0, 400, 30)]))
    found, _ = (
        DamagedMotion(two_joint_motion()).rows(which).read(tmp_path_factory.mktemp("r"), two_link)
    )
    assert (found.t == two_joint_motion()["t"]).all() and (
        found.q[:, 1] == two_joint_motion()["q.joint_2"]
    ).all()
    assert remark_kinds(found) == [Kind.ORDER, Kind.REPEATED]


def test_jitter_is_resampled(two_link, tmp_path, damage):
    t = damage.columns["t"] + np.random.default_rng(1).uniform(-3e-3, 3e-3, 400)
    for name, amplitude, rate in (("joint_1", 0.5, 2.0), ("joint_2", 0.5, 3.0)):
        damage.columns[f"q.{name}"] = amplitude * np.sin(rate * t)
    del damage.columns["dq.joint_1"], damage.columns["dq.joint_2"]
    damage.columns["t"] = t
    found, texts = damage.read(tmp_path, two_link)
    assert remark_kinds(found) == [Kind.JITTER] and "even grid" in texts[0]
    assert np.ptp(np.diff(found.t)) < 1e-9 and (found.own_times == t).all()
    assert np.abs(found.q[:, 1] - 0.5 * np.sin(3.0 * found.t)).max() < 1e-6


def test_how_coarse_an_encoder_is_outlives_another_grid(two_link, tmp_path, damage):
    t, step = damage.columns["t"] + np.random.default_rng(1).uniform(-3e-3, 3e-3, 400), 2e-3
    for name, rate in (("joint_1", 2.0), ("joint_2", 3.0)):
        damage.columns[f"q.{name}"] = 0.5 * np.sin(rate * t)
    damage.columns["q.joint_2"] = np.round(damage.columns["q.joint_2"] / step) * step
    del damage.columns["dq.joint_1"], damage.columns["dq.joint_2"]
    damage.columns["t"] = t
    found, _ = damage.read(tmp_path, two_link)
    assert (
        np.abs(found.q[:, 1] / step - np.round(found.q[:, 1] / step)).max() > 0.2
    )  # interpolated: no steps to be seen
    assert found.encoder == pytest.approx([0.0, step / np.sqrt(12.0)])
    assert next(segments_module.extract_segments([found])).band(5.0).encoder == pytest.approx(
        step / np.sqrt(12.0)
    )


def test_few_missing_rows_are_filled_and_more_split(two_link, tmp_path, damage):
    lost = np.r_[50:54, 200:230]
    found, texts = damage.rows(np.setdiff1d(np.arange(400), lost)).read(tmp_path, two_link)
    assert (
        remark_kinds(found) == [Kind.GAP, Kind.JITTER] and "4 missing rows are filled" in texts[1]
    )
    assert "longest 0.31 s" in texts[0] and found.remarks[0].start == pytest.approx(1.99)
    parts = list(found.segments())
    assert [len(part) for part in parts] == [200, 170] and parts[1].t[0] == pytest.approx(2.3)
    assert np.abs(found.q[50:54, 0] - damage.columns["q.joint_1"][50:54]).max() < 1e-6
    assert len(found.samples()) == 370 and [len(part) for part in found.segments(shortest=180)] == [
        200
    ]


def test_rows_without_a_time_are_dropped(two_link, tmp_path, damage):
    damage.columns["t"][[100, 101]] = np.nan
    found, texts = damage.read(tmp_path, two_link)
    assert (
        "2 rows without a time" in texts[0]
        and Kind.CLOCK in remark_kinds(found)
        and len(found) == 400
    )
    damage.columns["t"][:100] = np.nan
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.columns), two_link, "102 of 400 rows have no time"
    )


def test_a_clock_that_starts_again(two_link, tmp_path, damage):
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.rows(np.r_[0:400, 0:400]).columns),
        two_link,
        "time goes back from 3.99 to 0 s",
        "its own file",
    )


def test_a_clock_too_coarse(two_link, tmp_path, damage):
    damage.columns["t"] = np.floor(damage.columns["t"] * 20.0) / 20.0
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.columns),
        two_link,
        "320 of 400 rows repeat the time",
        "more digits",
    )


def test_stamps_in_bunches(two_link, tmp_path, damage):
    damage.columns["t"] = np.floor(np.arange(400) / 10) * 0.1 + (np.arange(400) % 10) * 1e-4
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.columns),
        two_link,
        "39 of 399 time steps",
        "time of measurement",
    )


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "µs"), (1e9, "ns")])
def test_time_in_other_units(two_link, tmp_path, damage, factor, unit):
    damage.columns["t"] = damage.columns["t"] * factor
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.columns),
        two_link,
        f"is time in {unit}",
        f"{factor:g}",
    )


def test_fast_milliseconds_are_betrayed_by_the_velocities(two_link, tmp_path):
    columns = two_joint_motion(4000, 4000.0)
    columns["t"] = columns["t"] * 1e3
    assert_refused(
        write_columns(tmp_path / "r.csv", columns), two_link, "joint 'joint_1'", "time is in ms"
    )


# -- numbers ---------------------------------------------------------------------------------------


def test_few_missing_numbers_are_interpolated_and_more_dropped(two_link, tmp_path, damage):
    damage.columns["q.joint_1"][100:105] = np.nan
    damage.columns["tau.joint_2"][200:220] = np.inf
    damage.columns["dq.joint_1"][300:320] = np.nan
    found, texts = damage.read(tmp_path, two_link)
    assert remark_kinds(found) == [Kind.MISSING] * 3 + [Kind.GAP]
    assert (
        "5 missing values of q, 5 interpolated" in texts[0]
        and "20 in longer runs left out" in texts[1]
        and "dropped" in texts[2]
    )
    assert len(found) == 380 and np.isfinite(found.q).all() and np.isfinite(found.torque).all()
    assert (
        found.dq is not None
        and np.isnan(found.dq[:, 0]).sum() == 20
        and np.isfinite(found.dq[:, 1]).all()
    )
    assert np.abs(found.q[100:105, 0] - two_joint_motion()["q.joint_1"][100:105]).max() < 2e-3


def test_temperatures_are_known_between_their_samples_whatever_is_missing_there(
    two_link, tmp_path, damage
):
    """A sensor is read twice a second; a gap splits the recording, and one piece has no sample of
    its own."""
    warm = np.full(400, np.nan)
    warm[::50] = 30.0 + 0.02 * np.arange(0, 400, 50)
    damage.columns["temp.joint_1"] = warm
    kept = np.setdiff1d(np.arange(400), np.r_[70:95, 130:160])
    found, texts = damage.rows(kept).read(tmp_path, two_link)
    assert set(remark_kinds(found)) == {Kind.GAP} and not any(
        "values of temperature" in text for text in texts
    )
    assert found.temperature is not None and np.isnan(found.temperature[:, 1]).all()
    np.testing.assert_allclose(
        found.temperature[:, 0],
        np.interp(found.t, damage.columns["t"][::50], warm[::50]),
        atol=0.02,
    )
    assert [np.isfinite(part.temperature[:, 0]).all() for part in found.segments()] == [True] * 3


def test_empty_cells_are_missing_numbers(two_link, tmp_path):
    path = write_columns(tmp_path / "r.csv", two_joint_motion())
    lines = path.read_text().splitlines()
    for k in (50, 51):
        cells = lines[k].split(",")
        lines[k] = ",".join([*cells[:2], "", "", "", "", ""])
    path.write_text("\n".join(lines))
    found, _ = read_with_warnings(path, two_link)
    assert set(remark_kinds(found)) == {Kind.MISSING} and len(found) == 400


def test_mostly_missing_numbers(two_link, tmp_path, damage):
    damage.columns["tau.joint_1"][:] = np.nan
    found, _ = damage.read(tmp_path, two_link)
    assert not found.has("tau", "joint_1") and found.has("tau", "joint_2") and len(found) == 400
    damage.columns["tau.joint_1"][:100] = 1.0
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.columns), two_link, "joint 'joint_1': 75 % of tau"
    )
    damage.columns["q.joint_2"][:] = np.nan
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.columns),
        two_link,
        "joint 'joint_2': 100 % of q",
        "--joints",
    )
