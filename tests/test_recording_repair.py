"""Repair of recordings: time axis, gaps and missing values."""

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
from excite.recordings import RemarkKind

# -- time ------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 10**6))
def test_shuffled_and_repeated_rows_are_sorted(two_link, tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    which = rng.permutation(np.concatenate([np.arange(400), rng.integers(0, 400, 30)]))
    recording, _ = (
        DamagedMotion(two_joint_motion()).rows(which).read(tmp_path_factory.mktemp("r"), two_link)
    )
    assert (recording.t == two_joint_motion()["t"]).all() and (
        recording.q[:, 1] == two_joint_motion()["q.joint_2"]
    ).all()
    assert remark_kinds(recording) == [RemarkKind.ORDER, RemarkKind.REPEATED]


def test_jitter_is_resampled(two_link, tmp_path, damage):
    t = damage.columns["t"] + np.random.default_rng(1).uniform(-3e-3, 3e-3, 400)
    for name, amplitude, rate in (("joint_1", 0.5, 2.0), ("joint_2", 0.5, 3.0)):
        damage.columns[f"q.{name}"] = amplitude * np.sin(rate * t)
    del damage.columns["dq.joint_1"], damage.columns["dq.joint_2"]
    damage.columns["t"] = t
    recording, texts = damage.read(tmp_path, two_link)
    assert remark_kinds(recording) == [RemarkKind.JITTER] and "even grid" in texts[0]
    assert np.ptp(np.diff(recording.t)) < 1e-9 and (recording.row_times == t).all()
    assert np.abs(recording.q[:, 1] - 0.5 * np.sin(3.0 * recording.t)).max() < 1e-6


def test_encoder_resolution_is_known_after_resampling(two_link, tmp_path, damage):
    t, step = damage.columns["t"] + np.random.default_rng(1).uniform(-3e-3, 3e-3, 400), 2e-3
    for name, rate in (("joint_1", 2.0), ("joint_2", 3.0)):
        damage.columns[f"q.{name}"] = 0.5 * np.sin(rate * t)
    damage.columns["q.joint_2"] = np.round(damage.columns["q.joint_2"] / step) * step
    del damage.columns["dq.joint_1"], damage.columns["dq.joint_2"]
    damage.columns["t"] = t
    recording, _ = damage.read(tmp_path, two_link)
    assert (
        np.abs(recording.q[:, 1] / step - np.round(recording.q[:, 1] / step)).max() > 0.2
    )  # interpolated: no steps are visible
    assert recording.quantization_noise == pytest.approx([0.0, step / np.sqrt(12.0)])
    assert next(segments_module.extract_segments([recording])).band(5.0).encoder == pytest.approx(
        step / np.sqrt(12.0)
    )


def test_few_missing_rows_are_filled_and_more_are_a_gap(two_link, tmp_path, damage):
    lost = np.r_[50:54, 200:230]
    recording, texts = damage.rows(np.setdiff1d(np.arange(400), lost)).read(tmp_path, two_link)
    assert (
        remark_kinds(recording) == [RemarkKind.GAP, RemarkKind.JITTER]
        and "4 missing rows are filled" in texts[1]
    )
    assert "longest 0.31 s" in texts[0] and recording.remarks[0].start == pytest.approx(1.99)
    parts = list(recording.segments())
    assert [len(part) for part in parts] == [200, 170] and parts[1].t[0] == pytest.approx(2.3)
    assert np.abs(recording.q[50:54, 0] - damage.columns["q.joint_1"][50:54]).max() < 1e-6
    assert len(recording.samples()) == 370 and [
        len(part) for part in recording.segments(min_rows=180)
    ] == [200]


def test_rows_with_a_gap_in_every_sixteen_are_refused(two_link, tmp_path, damage):
    which = np.concatenate([np.arange(12) + 32 * k for k in range(4)])
    path = write_columns(tmp_path / "r.csv", damage.rows(which).columns)
    assert_refused(path, two_link, "no 16 rows without a gap; record again")


def test_rows_without_a_time_are_dropped(two_link, tmp_path, damage):
    damage.columns["t"][[100, 101]] = np.nan
    recording, texts = damage.read(tmp_path, two_link)
    assert (
        "2 rows without a time" in texts[0]
        and RemarkKind.CLOCK in remark_kinds(recording)
        and len(recording) == 400
    )
    damage.columns["t"][:100] = np.nan
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.columns), two_link, "102 of 400 rows have no time"
    )


def test_clock_that_starts_again_is_refused(two_link, tmp_path, damage):
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.rows(np.r_[0:400, 0:400]).columns),
        two_link,
        "time goes back from 3.99 to 0 s",
        "its own file",
    )


def test_clock_that_is_too_coarse_is_refused(two_link, tmp_path, damage):
    damage.columns["t"] = np.floor(damage.columns["t"] * 20.0) / 20.0
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.columns),
        two_link,
        "320 of 400 rows repeat the time",
        "more digits",
    )


def test_stamps_of_arrival_are_refused(two_link, tmp_path, damage):
    damage.columns["t"] = np.floor(np.arange(400) / 10) * 0.1 + (np.arange(400) % 10) * 1e-4
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.columns),
        two_link,
        "39 of 399 time steps",
        "time of measurement",
    )


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "µs"), (1e9, "ns")])
def test_time_in_other_units_is_refused(two_link, tmp_path, damage, factor, unit):
    damage.columns["t"] = damage.columns["t"] * factor
    assert_refused(
        write_columns(tmp_path / "r.csv", damage.columns),
        two_link,
        f"is time in {unit}",
        f"{factor:g}",
    )


def test_short_steps_in_milliseconds_are_detected_by_velocities(two_link, tmp_path):
    columns = two_joint_motion(4000, 4000.0)
    columns["t"] = columns["t"] * 1e3
    assert_refused(
        write_columns(tmp_path / "r.csv", columns), two_link, "joint 'joint_1'", "time is in ms"
    )


# -- values ----------------------------------------------------------------------------------------


def test_few_missing_values_are_interpolated_and_more_dropped(two_link, tmp_path, damage):
    damage.columns["q.joint_1"][100:105] = np.nan
    damage.columns["tau.joint_2"][200:220] = np.inf
    damage.columns["dq.joint_1"][300:320] = np.nan
    recording, texts = damage.read(tmp_path, two_link)
    assert remark_kinds(recording) == [RemarkKind.MISSING] * 3 + [RemarkKind.GAP]
    assert (
        "5 missing values of q, 5 interpolated" in texts[0]
        and "20 in longer runs left out" in texts[1]
        and "dropped" in texts[2]
    )
    assert (
        len(recording) == 380
        and np.isfinite(recording.q).all()
        and np.isfinite(recording.torque).all()
    )
    assert (
        recording.dq is not None
        and np.isnan(recording.dq[:, 0]).sum() == 20
        and np.isfinite(recording.dq[:, 1]).all()
    )
    assert np.abs(recording.q[100:105, 0] - two_joint_motion()["q.joint_1"][100:105]).max() < 2e-3


def test_temperatures_are_interpolated_across_gaps(two_link, tmp_path, damage):
    """The sensor is read twice a second; a segment between two gaps has no sample."""
    warm = np.full(400, np.nan)
    warm[::50] = 30.0 + 0.02 * np.arange(0, 400, 50)
    damage.columns["temp.joint_1"] = warm
    kept = np.setdiff1d(np.arange(400), np.r_[70:95, 130:160])
    recording, texts = damage.rows(kept).read(tmp_path, two_link)
    assert set(remark_kinds(recording)) == {RemarkKind.GAP} and not any(
        "values of temperature" in text for text in texts
    )
    assert recording.temperature is not None and np.isnan(recording.temperature[:, 1]).all()
    np.testing.assert_allclose(
        recording.temperature[:, 0],
        np.interp(recording.t, damage.columns["t"][::50], warm[::50]),
        atol=0.02,
    )
    assert [np.isfinite(part.temperature[:, 0]).all() for part in recording.segments()] == [
        True
    ] * 3


def test_empty_cells_are_missing_values(two_link, tmp_path):
    path = write_columns(tmp_path / "r.csv", two_joint_motion())
    lines = path.read_text().splitlines()
    for k in (50, 51):
        cells = lines[k].split(",")
        lines[k] = ",".join([*cells[:2], "", "", "", "", ""])
    path.write_text("\n".join(lines))
    recording, _ = read_with_warnings(path, two_link)
    assert set(remark_kinds(recording)) == {RemarkKind.MISSING} and len(recording) == 400


def test_mostly_missing_values_are_refused(two_link, tmp_path, damage):
    damage.columns["tau.joint_1"][:] = np.nan
    recording, _ = damage.read(tmp_path, two_link)
    assert (
        not recording.has("tau", "joint_1")
        and recording.has("tau", "joint_2")
        and len(recording) == 400
    )
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


# -- stamps that are written after the measurement -------------------------------------------------


@pytest.mark.parametrize("lost", [(), (120, 121, 300)])
def test_uneven_stamps_of_even_rows_are_evened(two_link, tmp_path, damage, lost):
    """Rows were measured every 10 ms; their stamps are up to 3 ms off."""
    t = np.delete(np.arange(400) / 100.0, lost)
    phases = np.outer(t, [2.0, 3.0])
    columns = {"t": t + np.random.default_rng(1).uniform(-3e-3, 3e-3, len(t))}
    columns |= {f"q.joint_{i + 1}": 0.5 * np.sin(phases[:, i]) for i in range(2)}
    recording, texts = DamagedMotion(columns).read(tmp_path, two_link)
    assert remark_kinds(recording)[0] is RemarkKind.TIMESTAMP_JITTER
    assert "deviate by 1.7 ms (rms)" in texts[0] and "measured at even times" in texts[0]
    shift = np.median(columns["t"] - t)
    error = recording.q - 0.5 * np.sin(np.outer(recording.t - shift, [2.0, 3.0]))
    roughness = np.diff(error, 3, axis=0)
    assert len(recording) == 400 and np.abs(roughness[5:-5]).max() < 1e-5
    assert np.abs(error).max() < 1e-3  # a common offset of the clock


@pytest.mark.parametrize("lost", [(), (250, 700, 701, 702)])
@pytest.mark.parametrize("jitter", [1.5e-3, 2e-3])
def test_jitter_is_no_missing_row(two_link, tmp_path, jitter, lost):
    """Some steps are longer than 1.5 usual ones or shorter than 0.5, though no row is missing."""
    t = np.delete(np.arange(1200) / 100.0, lost)
    phases = np.outer(t, [2.0, 3.0])
    stamps = np.sort(t + jitter * np.random.default_rng(3).normal(size=len(t)))
    assert (np.diff(stamps) > 1.55e-2).any() and (np.diff(stamps) < 4.5e-3).any()
    columns = {f"q.joint_{i + 1}": 0.5 * np.sin(phases[:, i]) for i in range(2)}
    recording, texts = DamagedMotion({"t": stamps} | columns).read(tmp_path, two_link)
    assert "measured at even times" in texts[0] and len(recording) == 1200
    assert recording.rate == pytest.approx(100.0, rel=1e-4)
    filled = [text for text in texts if "missing rows are filled" in text]
    assert len(filled) == bool(lost) and all("; 4 missing" in text for text in filled)
    error = recording.q - 0.5 * np.sin(np.outer(recording.t, [2.0, 3.0]))
    assert np.abs(np.diff(error, axis=0)).max() < 1e-4


def test_bunched_stamps_are_no_missing_rows(two_link, tmp_path, damage):
    """Every 50th row is written 25 ms late, with those behind it until the logger has caught up."""
    stamps = damage.columns["t"].copy()
    for row in range(50, 400, 50):
        stamps[row : row + 3] = stamps[row] + 0.025 + 5e-4 * np.arange(3)
    motion = DamagedMotion(damage.columns | {"t": stamps})
    recording, texts = motion.read(tmp_path, two_link)
    assert "measured at even times" in texts[0] and len(texts) == 1
    assert len(recording) == 400 and recording.rate == pytest.approx(100.0, rel=1e-3)


def test_rate_of_unix_time_stamps_is_exact(two_link, tmp_path, damage):
    """Neighbouring stamps differ by multiples of 0.24 µs."""
    damage.columns["t"] = 1.7e9 + 1e-3 * np.arange(400)
    recording, _ = damage.read(tmp_path, two_link)
    assert recording.rate == pytest.approx(1000.0, rel=1e-5)


def test_noise_of_positions_does_not_even_stamps(two_link, tmp_path, damage):
    """Positions do not tell which times are right; the stamps are kept."""
    generator = np.random.default_rng(1)
    columns = {"t": damage.columns["t"] + generator.uniform(-1e-3, 1e-3, 400)}
    for i, rate in enumerate((0.2, 0.3)):
        columns[f"q.joint_{i + 1}"] = np.sin(rate * columns["t"]) + 0.01 * generator.normal(
            size=400
        )
    recording, _ = DamagedMotion(columns).read(tmp_path, two_link)
    assert remark_kinds(recording) == [RemarkKind.JITTER]


@pytest.mark.parametrize("name", ["qref", "qlink"])
@pytest.mark.parametrize("turns", [0, 1])
def test_further_positions_have_the_turn_of_the_measured_ones(two_link, tmp_path, name, turns):
    """Also where the measured position is neither wrapped nor shifted."""
    columns = two_joint_motion()
    columns["q.joint_1"] = 2.5 * columns["q.joint_1"] + 2.0  # crosses half a turn upwards
    error = 0.05 * np.cos(3.0 * columns["t"])
    further = columns["q.joint_1"] + error
    wrapped = (further + 2.0 * np.pi * turns + np.pi) % (2.0 * np.pi) - np.pi
    columns[f"{name}.joint_1"] = further + 2.0 * np.pi if turns else wrapped
    columns[f"{name}.joint_2"] = columns["q.joint_2"]
    recording, texts = read_with_warnings(write_columns(tmp_path / "r.csv", columns), two_link)
    assert np.allclose(getattr(recording, name)[:, 0], further, atol=1e-9)
    assert (recording.q[:, 0] == columns["q.joint_1"]).all()
    assert [name in text and "whole turns" in text for text in texts] == [True]


@pytest.mark.parametrize("name", ["qref", "qlink"])
def test_further_positions_in_degrees_are_refused(two_link, tmp_path, name):
    columns = two_joint_motion()
    for joint in ("joint_1", "joint_2"):
        columns[f"{name}.{joint}"] = np.rad2deg(columns[f"q.{joint}"] + 0.01)
    path = write_columns(tmp_path / "r.csv", columns)
    assert_refused(path, two_link, f"{name} moves 57.3 times as far as q", "degrees")
