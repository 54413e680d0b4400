"""Tables that merge messages of several topics: positions and torques in different rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_fixtures import read_with_warnings

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
    names = [f"{quantity}.joint_{k}" for quantity in ("q", "tau") for k in (1, 2)]
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
    np.testing.assert_allclose(recording.torque, torque(recording.t), atol=1e-4)


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
