"""Where a recording repeats, whether the stated period is right, and the executed trajectory."""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path

import numpy as np
import pytest

from excite import api
from excite.errors import UnusableInput
from excite.identification import segments
from excite.recordings import Recording, RemarkKind, Sidecar, executed_motion, periodicity
from excite.trajectory.trajectory_file import Trajectory, read_trajectory

FILE = Path(__file__).resolve().parents[1] / "trajectories" / "two_link.json"
RATE = 250.0
NOISE = 2e-5
"""Standard deviation of the tracking error [rad]."""


@pytest.fixture(scope="module")
def planned() -> Trajectory:
    return read_trajectory(FILE)


def executed(planned: Trajectory, speed: float = 1.0, idle: float = 5.0, periods: int = 4):
    """Return a recording of a trajectory with idle time before it, and 3 s behind it."""
    motion = executed_motion.with_periods(planned.motion, periods)
    t = np.arange(0.0, idle + motion.duration / speed + 3.0, 1.0 / RATE)
    q = motion.at(speed * (t - idle))
    q = q + NOISE * np.random.default_rng(0).standard_normal(q.shape)
    return Recording("r.csv", planned.joints, t, q)


def stated(recording: Recording, period: float, window: tuple[float, float] | None = None):
    return dataclasses.replace(recording, sidecar=Sidecar(period=period, periodic=window))


def true_window(planned: Trajectory, speed: float = 1.0, idle: float = 5.0, periods: int = 4):
    part = executed_motion.with_periods(planned.motion, periods).segment("fourier")
    return idle + part.start / speed, idle + part.end / speed


def test_the_window_is_found_between_idle_time_and_ramps(planned):
    period = planned.motion.fourier.period
    checked = periodicity.check_repetition(stated(executed(planned), period))
    assert checked.sidecar.period == period and not checked.remarks
    assert checked.sidecar.periodic == pytest.approx(true_window(planned), abs=0.2)


@pytest.mark.parametrize("speed", [0.85, 0.5])
@pytest.mark.parametrize("window", [None, (6.0, 20.0)])
def test_reduced_speed_contradicts_the_period_of_the_plan(planned, speed, window):
    period = planned.motion.fourier.period
    recording = stated(executed(planned, speed), period, window)
    checked = periodicity.check_repetition(recording)
    assert checked.sidecar.period == pytest.approx(period / speed, rel=1e-5)
    (remark,) = checked.remarks
    assert remark.kind is RemarkKind.PERIOD and f"ran at {100 * speed:g} %" in remark.text


def test_a_period_that_is_slightly_wrong_is_refined(planned):
    period = planned.motion.fourier.period
    checked = periodicity.check_repetition(stated(executed(planned), 1.004 * period))
    assert checked.sidecar.period == pytest.approx(period, rel=1e-4)


def test_nothing_is_averaged_where_nothing_repeats(planned):
    recording = executed(planned)
    t = recording.t
    q = np.column_stack([np.sin(0.05 * t**2), np.cos(0.03 * t**2)])
    checked = periodicity.check_repetition(
        stated(dataclasses.replace(recording, q=q), planned.motion.fourier.period)
    )
    assert checked.repetition is None
    (remark,) = checked.remarks
    assert "does not repeat" in remark.text and "no periods are averaged" in remark.text
    assert "joint 'joint_" in remark.text
    assert periodicity.with_detected_period(checked) is checked


def test_a_motion_without_a_stated_period_shows_its_own(planned):
    periodic = periodicity.with_detected_period(executed(planned))
    assert periodic.sidecar.period == pytest.approx(planned.motion.fourier.period, rel=1e-5)
    assert periodic.sidecar.periodic == pytest.approx(true_window(planned), abs=0.3)


@pytest.mark.parametrize("speed", [1.0, 0.85])
@pytest.mark.parametrize("periods", [2, 4])
def test_the_executed_motion_is_aligned(planned, speed, periods):
    recording = executed(planned, speed, periods=periods)
    aligned = executed_motion.apply_trajectory(recording, planned, str(FILE))
    assert aligned is not None and aligned.qref is not None
    assert aligned.sidecar.period == pytest.approx(planned.motion.fourier.period / speed, rel=1e-5)
    assert aligned.sidecar.periodic == pytest.approx(
        true_window(planned, speed, periods=periods), abs=1.1 / RATE
    )
    assert np.abs(aligned.qref - recording.q).max() < 10.0 * NOISE
    text = aligned.remarks[-1].text
    assert "begins 5 s after" in text and ("85 % of the planned speed" in text) is (speed < 1.0)


def test_a_single_period_at_reduced_speed_is_aligned(planned):
    recording = executed(planned, 0.7, periods=2)
    start, _ = true_window(planned, 0.7)
    part = recording.between(0.0, start + 1.2 * planned.motion.fourier.period / 0.7)
    aligned = executed_motion.find_motion(part, planned.motion)
    assert aligned is not None
    assert aligned.speed == pytest.approx(0.7, rel=1e-3)
    assert aligned.start == pytest.approx(5.0, abs=0.01)


def test_another_motion_is_refused(planned):
    recording = executed(planned)
    other = dataclasses.replace(recording, q=recording.q[:, ::-1])
    assert executed_motion.apply_trajectory(other, planned, str(FILE)) is None
    with pytest.raises(UnusableInput, match="does not hold the motion of"):
        api.identification_result.with_trajectory(other, FILE)
    single = dataclasses.replace(recording, joints=("a", "b"))
    with pytest.raises(UnusableInput, match="choose them with --joints"):
        executed_motion.apply_trajectory(single, planned, str(FILE))


@pytest.fixture(scope="module")
def logged(tmp_path_factory) -> tuple[Path, float, tuple[float, float]]:
    """A log at 100 Hz with jittered stamps and 5 s of idle time, its period and its window."""
    pytest.importorskip("mujoco", reason="the simulated robot needs pip install 'excite[sim]'")
    folder = tmp_path_factory.mktemp("logged")
    trajectory = FILE.with_name("ur5e.json")
    api.simulate("ur5e", trajectory, periods=4, seed=3).save(folder / "clean.csv")
    clean = api.read_recording(folder / "clean.csv", "ur5e")
    assert clean.tau is not None and clean.repetition is not None
    generator = np.random.default_rng(0)
    even = np.arange(0.0, clean.t[-1] + 7.0, 0.01)
    stamps = even + generator.uniform(-0.002, 0.002, len(even))
    inner = np.clip(stamps - 5.0, 0.0, clean.t[-1])
    columns = [stamps]
    for values in (clean.q, clean.tau):
        columns += [np.interp(inner, clean.t, column) for column in values.T]
    names = ["t", *(f"{kind}.{joint}" for kind in ("q", "tau") for joint in clean.joints)]
    path = folder / "logged.csv"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=",".join(names), comments="")
    period, (start, end) = clean.repetition
    return path, period, (start + 5.0, end + 5.0)


def test_identified_directions_do_not_depend_on_what_is_stated(logged):
    path, period, window = logged
    trajectory = FILE.with_name("ur5e.json")
    choices = [
        {"period": period, "window": window},
        {"period": period},
        {},
        {"trajectory": trajectory},
    ]
    counts = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for choice in choices:
            result = api.identify("ur5e", [path], **choice)
            counts.append(result.identification.analysis.identifiable_count)
    assert max(counts) - min(counts) <= 3
    assert min(counts) > 35


def test_few_rows_refine_the_period_of_a_long_recording(planned, monkeypatch):
    recording = executed(planned, periods=12)
    complete = periodicity.with_detected_period(recording)
    monkeypatch.setattr(periodicity, "REFINEMENT_ROWS", len(recording) // 8)
    thinned = periodicity.with_detected_period(recording)
    assert thinned.sidecar.period == pytest.approx(complete.sidecar.period, rel=1e-6)
    assert thinned.sidecar.periodic == pytest.approx(complete.sidecar.periodic, abs=0.01)


@pytest.mark.parametrize("stated_period", [True, False])
def test_no_whole_period_is_lost_to_rounding(planned, stated_period):
    recording = executed(planned, idle=5.0033)
    period = planned.motion.fourier.period
    if stated_period:
        periodic = periodicity.check_repetition(stated(recording, period))
    else:
        periodic = periodicity.with_detected_period(recording)
    torque = dataclasses.replace(periodic, tau=np.zeros_like(periodic.q))
    mean = segments.average_periods(torque, *torque.repetition)
    assert mean is not None and mean.periods == 4


@pytest.mark.parametrize("stated_period", [True, False])
@pytest.mark.parametrize("periods", [2, 3, 10])
def test_rows_of_whole_periods_and_nothing_else_are_all_averaged(stated_period, periods):
    """Their last row is one step before the end of the last period."""
    t = np.arange(round(4.0 * periods * RATE)) / RATE
    phase = np.pi / 2.0 * t
    q = np.column_stack([np.sin(phase) + 0.4 * np.cos(3.0 * phase), np.cos(2.0 * phase)])
    q += 1e-6 * np.random.default_rng(0).standard_normal(q.shape)
    recording = Recording("r.csv", ("joint_1", "joint_2"), t, q, tau=np.zeros_like(q))
    if stated_period:
        periodic = periodicity.check_repetition(stated(recording, 4.0))
    else:
        periodic = periodicity.with_detected_period(recording)
    mean = segments.average_periods(periodic, *periodic.repetition)
    assert mean is not None and mean.periods == periods
