"""Recordings whose positions or torques are refreshed more slowly than rows are written."""

from __future__ import annotations

import numpy as np
import pytest
from recording_fixtures import JOINTS, DamagedMotion, remark_kinds

from excite.errors import UnusableInput
from excite.recordings import RemarkKind

RATE = 500.0
"""Rows a second of the log [Hz]."""


def position(t: np.ndarray, speed: float = 1.0) -> np.ndarray:
    """Positions of two joints that rest in the middle of the motion. Shape (N, 2) [rad]."""
    moving = np.minimum(t, 2.0) + np.maximum(t - 3.0, 0.0)  # at rest from 2 to 3 s
    return 0.5 * np.cos(np.pi * moving[:, None] * np.array([1.0, 2.0]) * speed)


def torque(t: np.ndarray) -> np.ndarray:
    """Torques of two joints. Shape (N, 2) [N m]."""
    return 3.0 * np.cos(t[:, None] * np.array([2.0, 3.0]) + 0.3)


def motion_at(t: np.ndarray) -> np.ndarray:
    """Positions of two joints that do not rest together. Shape (N, 2) [rad]."""
    return 0.5 * np.sin(t[:, None] * np.array([2.0, 3.0]))


def held(values: np.ndarray, updates: np.ndarray) -> np.ndarray:
    """Values of the last update at every row."""
    rows = np.arange(len(values))
    return values[updates[np.searchsorted(updates, rows, side="right") - 1]]


def columns(t: np.ndarray, q: np.ndarray, tau: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of a file."""
    named = {"t": t}
    for prefix, values in (("q", q), ("tau", tau)):
        named |= {f"{prefix}.{joint}": values[:, i] for i, joint in enumerate(JOINTS)}
    return named


@pytest.mark.parametrize("speed", [1.0, 2.0])
@pytest.mark.parametrize("step", [0.0, 2e-5])
def test_one_row_of_each_update_is_used(two_link, tmp_path, speed, step):
    """Positions and torques are held for 4 rows; at high speed the steps exceed velocity limits."""
    t = np.arange(3000) / RATE
    q = position(t, speed)
    q = np.round(q / step) * step if step else q
    updates = np.arange(0, len(t), 4)
    motion = DamagedMotion(columns(t, held(q, updates), held(torque(t), updates)))
    recording, texts = motion.read(tmp_path, two_link)
    remark = next(r for r in recording.remarks if r.kind is RemarkKind.HELD)
    assert not texts and "positions are refreshed every 4 rows (125 Hz)" in remark.text
    assert recording.rate == pytest.approx(125.0) and len(recording) >= 748
    assert np.abs(recording.q - position(recording.t, speed)).max() < 1e-9 + step
    assert np.abs(recording.torque - torque(recording.t)).max() < 1e-9
    assert (recording.row_times == t).all()


@pytest.mark.parametrize("seed", [0, 1])
def test_updates_after_three_to_five_rows_are_even(two_link, tmp_path, seed):
    """Positions of every 8 ms arrive up to 2 ms early or late."""
    t, generator = np.arange(3000) / RATE, np.random.default_rng(seed)
    updates = 4 * np.arange(749) + np.pad(generator.choice([-1, 0, 0, 0, 0, 1], 748), (1, 0))
    rows = np.searchsorted(updates, np.arange(3000), side="right") - 1
    recording, _ = DamagedMotion(columns(t, position(0.008 * rows), torque(0.008 * rows))).read(
        tmp_path, two_link
    )
    assert set(remark_kinds(recording)) == {RemarkKind.HELD, RemarkKind.TIMESTAMP_JITTER}
    assert recording.rate == pytest.approx(125.0, rel=1e-3)
    error = recording.q - position(recording.t)
    assert np.abs(np.diff(error, 2, axis=0))[5:-5].max() < 1e-3


def test_quantities_with_other_rates_and_phases_are_taken_at_their_updates(two_link, tmp_path):
    """Positions are held for 4 rows, torques for 2, one row later."""
    t = np.arange(3000) / RATE
    late = np.concatenate([[0], np.arange(1, len(t), 2)])
    motion = DamagedMotion(
        columns(t, held(position(t), np.arange(0, len(t), 4)), held(torque(t), late))
    )
    recording, texts = motion.read(tmp_path, two_link)
    text = recording.remarks[0].text
    assert not texts and "every 4 rows (125 Hz), torques every 2 rows (250 Hz)" in text
    assert recording.rate == pytest.approx(125.0)
    assert np.abs(recording.q - position(recording.t)).max() < 1e-9
    assert np.abs(recording.torque - torque(recording.t))[2:-2].max() < 1e-5


def test_torques_of_every_row_are_kept_as_measured(two_link, tmp_path):
    t = np.arange(3000) / RATE
    motion = DamagedMotion(columns(t, held(position(t), np.arange(0, len(t), 3)), torque(t)))
    recording, texts = motion.read(tmp_path, two_link)
    assert not texts and "torques" not in recording.remarks[0].text
    assert recording.rate == pytest.approx(RATE / 3.0)
    assert np.abs(recording.torque - torque(recording.t)).max() < 1e-9


@pytest.mark.parametrize("rate", [100.0, 500.0])
@pytest.mark.parametrize("speed", [0.02, 0.2, 1.0])
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_coarse_encoders_and_slow_motions_are_not_held(two_link, tmp_path, rate, speed, noise):
    """12 bits per turn: at low speed a position repeats for many rows."""
    t, step = np.arange(int(6.0 * rate)) / rate, 2.0 * np.pi / 4096
    q = position(t, speed) + noise * step * np.random.default_rng(0).normal(size=(len(t), 2))
    motion = DamagedMotion(columns(t, np.round(q / step) * step, torque(t)))
    recording, _ = motion.read(tmp_path, two_link)
    assert RemarkKind.HELD not in remark_kinds(recording)
    assert len(recording) == len(t)


HOLDS = {1.1: [1] * 9 + [2], 1.83: [1] * 20 + [2] * 77 + [3] * 3, 3.0: [1, 2, 3, 4, 5]}
"""Numbers of rows from update to update, by their mean."""


def hold_at_random(rows: int, mean: float) -> np.ndarray:
    """Rows of updates that come irregularly, every `mean` rows on average."""
    updates = np.cumsum(np.random.default_rng(0).choice(HOLDS[mean], rows))
    return np.union1d([0], updates[updates < rows])


def is_remarked(recording) -> bool:
    """Return True for a remark on repeated rows or on a freeze of all joints."""
    return any("complete rows" in r.text or "all signals" in r.text for r in recording.remarks)


@pytest.mark.parametrize("mean", [1.1, 1.83, 3.0])
def test_complete_rows_that_repeat_at_any_ratio_are_not_used(two_link, tmp_path, mean):
    t = np.arange(600) / 100.0
    updates = hold_at_random(len(t), mean)
    motion = DamagedMotion(columns(t, held(position(t), updates), held(torque(t), updates)))
    recording, texts = motion.read(tmp_path, two_link)
    remark = next(r for r in recording.remarks if r.kind is RemarkKind.REPEATED)
    assert remark.repaired and "repeat the one before" in texts[0]
    frequency = float(remark.text.split("(")[1].split()[0])
    assert frequency == pytest.approx(100.0 / mean, rel=0.15)
    # rows that were lost leave the others on their grid
    rate = 100.0 if mean == 1.1 else len(updates) / t[-1]
    assert recording.rate == pytest.approx(rate, rel=0.01)
    assert np.abs(recording.q - position(recording.t)).max() < 0.02


@pytest.mark.parametrize("lost", [0.06, 0.2])
def test_lost_rows_that_repeat_the_last_one_leave_the_grid_as_it_is(two_link, tmp_path, lost):
    """Stamps that err by a tenth of a row are corrected, as without a lost row."""
    rng = np.random.default_rng(0)
    even = np.arange(1500) / 200.0
    t = even + rng.uniform(-5e-4, 5e-4, len(even))
    updates = np.union1d([0], np.flatnonzero(rng.uniform(size=len(t)) > lost))
    q, tau = (held(x(even), updates) for x in (position, torque))
    recording, _ = DamagedMotion(columns(t, q, tau)).read(tmp_path, two_link)
    assert recording.rate == pytest.approx(200.0, rel=1e-3)
    error = np.sqrt(np.mean((recording.q - position(recording.t)) ** 2))
    assert error < 1e-4


def test_positions_alone_that_repeat_at_random_are_no_repeated_rows(two_link, tmp_path):
    t = np.arange(600) / 100.0
    updates = hold_at_random(len(t), 1.83)
    recording, _ = DamagedMotion(columns(t, held(position(t), updates), torque(t))).read(
        tmp_path, two_link
    )
    assert not is_remarked(recording)


def test_positions_without_torques_are_not_judged(two_link, tmp_path):
    """As of a tracker of human motion, whose solver repeats poses."""
    t = np.arange(600) / 100.0
    q = held(position(t), hold_at_random(len(t), 1.83))
    named = {name: value for name, value in columns(t, q, q).items() if "tau" not in name}
    recording, _ = DamagedMotion(named).read(tmp_path, two_link)
    assert not is_remarked(recording)


@pytest.mark.parametrize("every", [1, 4])
def test_a_freeze_of_all_joints_in_motion_is_named(two_link, tmp_path, every):
    t = np.arange(600 * every) / (100.0 * every)
    updates = np.arange(0, len(t), every)
    freeze = (updates > 120 * every) & (updates < 134 * every)
    updates = updates[~freeze]
    motion = DamagedMotion(columns(t, held(position(t), updates), held(torque(t), updates)))
    recording, texts = motion.read(tmp_path, two_link)
    remark = next(r for r in recording.remarks if r.kind is RemarkKind.FROZEN)
    assert remark.start == pytest.approx(1.2) and remark.end == pytest.approx(1.33, abs=0.01)
    assert any("all signals of all joints are frozen" in text for text in texts)
    inside = (recording.t > 1.21) & (recording.t < 1.33)
    assert not inside.any()


@pytest.mark.parametrize("every", [1, 4])
def test_many_freezes_are_no_uneven_stamps(two_link, tmp_path, every):
    """1.4 % of the remaining time steps are freezes."""
    t = np.arange(1500 * every) / (100.0 * every)
    updates = np.arange(0, len(t), every)
    updates = updates[~((updates // every % 75 >= 60) & (updates // every % 75 < 68))]
    motion = DamagedMotion(columns(t, held(motion_at(t), updates), held(torque(t), updates)))
    recording, texts = motion.read(tmp_path, two_link)
    assert any("frozen" in text and "and 19 more times" in text for text in texts)
    assert recording.rate == pytest.approx(100.0) and len(recording) == 1500 - 20 * 8
    assert np.abs(recording.q - motion_at(recording.t)).max() < 1e-9


def test_a_recording_that_is_mostly_frozen_is_refused_for_that(two_link, tmp_path):
    """Four updates, then the last one for 11 rows, again and again."""
    t = np.arange(2000) / 100.0
    updates = np.flatnonzero(np.arange(2000) % 15 < 4)
    motion = DamagedMotion(columns(t, held(motion_at(t), updates), held(torque(t), updates)))
    with pytest.raises(UnusableInput, match=r"without a gap, since all signals .* are frozen"):
        motion.read(tmp_path, two_link)


def test_a_robot_that_stops_abruptly_between_motions_is_not_frozen(two_link, tmp_path):
    """Constant speed, a stop for 20 rows without noise, the same speed again."""
    t = np.arange(800) / 100.0
    moving = np.minimum(t, 4.0) + np.maximum(t - 4.2, 0.0)
    q = moving[:, None] * np.array([0.3, 0.2])
    recording, _ = DamagedMotion(columns(t, q, np.sign(np.gradient(q, axis=0)))).read(
        tmp_path, two_link
    )
    assert not is_remarked(recording)


def test_slow_motion_of_one_joint_with_a_coarse_encoder_repeats_no_rows(two_link, tmp_path):
    t = np.arange(2000) / 100.0
    q = np.column_stack([np.round(0.2 * np.sin(0.5 * t) / 2e-3) * 2e-3, np.zeros_like(t)])
    tau = np.round(3.0 * np.cos(0.5 * t[:, None] + np.array([0.0, 0.4])) / 0.1) * 0.1
    recording, _ = DamagedMotion(columns(t, q, tau)).read(tmp_path, two_link)
    assert not is_remarked(recording)
