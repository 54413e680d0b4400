"""Tables that merge messages of several topics: positions and torques in different rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_fixtures import read_with_warnings

from excite.errors import UnusableInput
from excite.recordings import RemarkKind

T = np.arange(600) / 100.0


def position(t: np.ndarray) -> np.ndarray:
    """Positions of two joints. Shape (N, 2) [rad]."""
    return 0.5 * np.sin(np.outer(t, [2.0, 3.0]))


def torque(t: np.ndarray) -> np.ndarray:
    """Torques of two joints. Shape (N, 2) [N m]."""
    return 3.0 * np.cos(np.outer(t, [1.7, 2.3]))


def write_rows(path: Path, rows: list[tuple[float, dict[str, float]]]) -> Path:
    """Write rows in the order of time, with empty cells where a row has no value."""
    quantities = sorted({name.partition(".")[0] for _, values in rows for name in values})
    names = [f"{quantity}.joint_{k}" for quantity in quantities for k in (1, 2)]
    lines = [",".join(["t", *names])]
    for t, values in sorted(rows, key=lambda row: row[0]):
        cells = [repr(float(values[name])) if name in values else "" for name in names]
        lines.append(",".join([repr(float(t)), *cells]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def messages(name: str, t: np.ndarray, values: np.ndarray, joints=(1, 2)):
    """A row for each message of a topic."""
    return [
        (float(time), {f"{name}.joint_{k}": row[k - 1] for k in joints})
        for time, row in zip(t, values, strict=True)
    ]


@pytest.mark.parametrize("rate", [0.5, 1.0, 3.0])
def test_torques_in_other_rows_are_interpolated_at_the_positions(two_link, tmp_path, rate):
    other = np.arange(-0.5, 6.5, 0.01 / rate) + 3e-3
    rows = messages("q", T, position(T)) + messages("tau", other, torque(other))
    recording, texts = read_with_warnings(write_rows(tmp_path / "run.csv", rows), two_link)
    assert any("torques are in different rows" in text for text in texts)
    assert recording.rate == pytest.approx(100.0)
    np.testing.assert_allclose(recording.q, position(recording.t), atol=1e-6)
    np.testing.assert_allclose(recording.torque, torque(recording.t), atol=1e-3)


def test_a_topic_of_each_joint_is_joined(two_link, tmp_path):
    late = T + 2e-3
    rows = [
        *messages("q", T, position(T), (1,)),
        *messages("tau", T + 1e-3, torque(T + 1e-3), (1,)),
        *messages("q", late, position(late), (2,)),
        *messages("tau", late, torque(late), (2,)),
    ]
    recording, _ = read_with_warnings(write_rows(tmp_path / "run.csv", rows), two_link)
    np.testing.assert_allclose(recording.q, position(recording.t), atol=1e-4)
    np.testing.assert_allclose(recording.torque, torque(recording.t), atol=1e-3)


@pytest.mark.parametrize("lag", [2e-3, 5e-3, 8e-3])
def test_wrapped_positions_of_a_topic_of_each_joint_are_unwrapped(two_link, tmp_path, lag):
    """Both joints pass zero 13 times, where [0, 2π) wraps: no value lies between the two ends."""

    def turned(t):
        return np.sin(7.0 * t)[:, None] * np.array([0.9, 1.0])

    late = T + lag
    rows = [
        *messages("q", T, turned(T) % (2.0 * np.pi), (1,)),
        *messages("q", late, turned(late) % (2.0 * np.pi), (2,)),
        *messages("tau", T, torque(T)),
    ]
    recording, texts = read_with_warnings(write_rows(tmp_path / "run.csv", rows), two_link)
    np.testing.assert_allclose(recording.q, turned(recording.t), atol=1e-3)
    unwrapped = [text for text in texts if "13 steps of a whole turn" in text]
    assert len(unwrapped) == 2 and not any("glitch" in text for text in texts)


@pytest.mark.parametrize("pattern", ["pairs", "some"])
def test_messages_may_arrive_at_nearly_the_same_time(two_link, tmp_path, pattern):
    """The noise of two such messages is no slope, and their distance is not the usual step."""
    rng = np.random.default_rng(3)
    other = T + 3e-3
    is_late = np.arange(len(T)) % 2 == 0 if pattern == "pairs" else rng.random(len(T)) < 0.15
    other[:-1] = np.where(is_late[:-1], other[1:] - 1e-5, other[:-1])
    noisy = torque(other) + 0.02 * rng.normal(size=(len(T), 2))
    rows = messages("q", T, position(T)) + messages("tau", other, noisy)
    recording, _ = read_with_warnings(write_rows(tmp_path / "run.csv", rows), two_link)
    assert len(recording) > 590
    error = recording.torque - torque(recording.t)
    assert np.sqrt(np.mean(error**2)) < 0.04


def test_a_glitch_between_messages_stays_one(two_link, tmp_path):
    other = T + 3e-3
    spoiled = torque(other)
    spoiled[300, 0] = 3000.0
    rows = messages("q", T, position(T)) + messages("tau", other, spoiled)
    recording, _ = read_with_warnings(write_rows(tmp_path / "run.csv", rows), two_link)
    np.testing.assert_allclose(recording.torque, torque(recording.t), atol=0.05)


def test_unsigned_torques_in_other_rows_are_refused(two_link, tmp_path):
    counts = np.round(100.0 * torque(T)).astype(np.int64) % 2**16
    rows = messages("q", T, position(T)) + messages("tau", T + 3e-3, counts.astype(float))
    with pytest.raises(UnusableInput, match="stored unsigned"):
        read_with_warnings(write_rows(tmp_path / "run.csv", rows), two_link)


@pytest.mark.parametrize("rate", [0.5, 2.0])
def test_commands_in_other_rows_leave_the_measured_rows(two_link, tmp_path, rate):
    measured = [
        (t, {**q, **tau})
        for (t, q), (_, tau) in zip(
            messages("q", T, position(T)), messages("tau", T, torque(T)), strict=True
        )
    ]
    other = np.arange(-0.5, 6.5, 0.01 / rate) + 3e-3
    rows = measured + messages("qref", other, position(other))
    recording, texts = read_with_warnings(write_rows(tmp_path / "run.csv", rows), two_link)
    assert len(recording) == len(T) and not any("refreshed" in text for text in texts)
    np.testing.assert_allclose(recording.torque, torque(recording.t))


def test_a_gap_of_the_torques_is_not_bridged(two_link, tmp_path):
    other = T[(T < 2.0) | (T > 2.5)] + 3e-3
    rows = messages("q", T, position(T)) + messages("tau", other, torque(other))
    recording, _ = read_with_warnings(write_rows(tmp_path / "run.csv", rows), two_link)
    assert not ((recording.t > 2.05) & (recording.t < 2.45)).any()


def test_missing_torques_in_the_rows_of_positions_are_not_interleaved(two_link, tmp_path):
    rows = messages("q", T, position(T))
    for k, row in enumerate(torque(T)):
        if k % 4:
            rows[k][1].update({f"tau.joint_{j}": row[j - 1] for j in (1, 2)})
    recording, texts = read_with_warnings(write_rows(tmp_path / "run.csv", rows), two_link)
    assert not any("different rows" in text for text in texts)
    assert RemarkKind.MISSING in [remark.kind for remark in recording.remarks]
