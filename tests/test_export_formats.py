"""CSV files that other programs write: PlotJuggler, ROS, spreadsheets, Universal Robots."""

from __future__ import annotations

import numpy as np
import pytest
from recording_fixtures import assert_refused, read_with_warnings, two_joint_motion

from excite import recordings
from excite.cli import main as cli
from excite.recordings import RemarkKind
from excite.robot.robot import load

COLUMNS = two_joint_motion()
EPOCH = 1_700_000_000
QUANTITIES = {"position": "q", "velocity": "dq", "effort": "tau"}


def assert_same_motion(recording: recordings.Recording) -> None:
    """Assert that a recording holds the two-joint motion, within the digits of a clock of 1970."""
    assert np.allclose(recording.t - recording.t[0], COLUMNS["t"], atol=1e-6)
    for quantity in ("q", "dq", "tau"):
        expected = np.column_stack([COLUMNS[f"{quantity}.joint_{k}"] for k in (1, 2)])
        assert np.allclose(getattr(recording, quantity), expected, atol=1e-9)


def rows(*columns: np.ndarray) -> list[list[str]]:
    return [[f"{value:.17g}" for value in row] for row in np.column_stack(columns)]


def write(path, header, cells, separator=","):
    lines = [] if header is None else [separator.join(header)]
    path.write_text(
        "\n".join([*lines, *(separator.join(row) for row in cells)]) + "\n", encoding="utf-8"
    )
    return path


def test_plotjuggler(two_link, tmp_path):
    header, columns = ["__time"], [EPOCH + COLUMNS["t"]]
    for joint in ("joint_2", "joint_1"):
        for field, prefix in QUANTITIES.items():
            header.append(f"/joint_states/{joint}/{field}")
            columns.append(COLUMNS[f"{prefix}.{joint}"])
    header += ["/joint_states/header/stamp", "/gripper/finger/position"]
    columns += [EPOCH + COLUMNS["t"], np.zeros(400)]
    path = write(tmp_path / "r.csv", header, rows(*columns))
    assert_same_motion(recordings.read(path, two_link))
    header[-1] = "/other/joint_1/position"
    refused = assert_refused(
        write(path, header, rows(*columns)), two_link, "both the position", "joint_1"
    )
    assert "--columns q.joint_1=" in refused


def test_ros2_topic_echo_csv(two_link, tmp_path):
    seconds = np.floor(COLUMNS["t"]).astype(int)
    nanoseconds = np.round((COLUMNS["t"] - seconds) * 1e9).astype(int)
    cells = [
        [
            *(str(EPOCH + seconds[k]), str(nanoseconds[k]), "", "joint_2", "joint_1"),
            *(f"{COLUMNS[f'{p}.joint_{j}'][k]:.17g}" for p in ("q", "dq", "tau") for j in (2, 1)),
        ]
        for k in range(400)
    ]
    recording = recordings.read(write(tmp_path / "r.csv", None, cells), two_link)
    assert_same_motion(recording)
    assert len(recording) == 400


@pytest.mark.parametrize(
    ("time", "element"),
    [
        (["%time"], "field.{}{}"),
        (["header.stamp.sec", "header.stamp.nanosec"], "{}[{}]"),
        (["time"], ".{}_{}"),
    ],
)
def test_flattened_joint_states(two_link, tmp_path, time, element):
    header = [*time, "header.frame_id", *(element.format("name", k) for k in (0, 1))]
    header += [element.format(field, k) for field in QUANTITIES for k in (0, 1)]
    stamps = np.round(COLUMNS["t"] * 1e9).astype(np.int64) + EPOCH * 10**9
    cells = []
    for k in range(400):
        clock = {
            "%time": [str(stamps[k])],
            "header.stamp.sec": [str(stamps[k] // 10**9), str(stamps[k] % 10**9)],
            "time": [f"{stamps[k] * 1e-9:.9f}"],
        }[time[0]]
        values = [COLUMNS[f"{p}.joint_{j}"][k] for p in QUANTITIES.values() for j in (2, 1)]
        cells.append([*clock, "base", "joint_2", "joint_1", *(f"{v:.17g}" for v in values)])
    assert_same_motion(recordings.read(write(tmp_path / "r.csv", header, cells), two_link))


@pytest.mark.parametrize("separator", [";", "\t"])
def test_comma_decimals_and_byte_order_mark(two_link, tmp_path, separator):
    cells = [[cell.replace(".", ",") for cell in row] for row in rows(*COLUMNS.values())]
    path = write(tmp_path / "r.csv", list(COLUMNS), cells, separator)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert_same_motion(recordings.read(path, two_link))


def test_ur_rtde_with_targets_and_currents(tmp_path):
    robot = load("ur5e")
    t = np.arange(400) / 125.0
    q = np.sin(np.outer(t, np.arange(1.0, 7.0)))
    columns = {"timestamp": t}
    for name, values in (
        *(("target_q", q), ("actual_q", q), ("actual_qd", np.gradient(q, t, axis=0))),
        *(("actual_current", np.cos(q)), ("target_moment", q)),
    ):
        columns |= {f"{name}_{i}": values[:, i] for i in range(6)}
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    gains = ", ".join(f'"{joint}": 10.0' for joint in robot.joints)
    path.with_suffix(".json").write_text(
        '{"schema": "excite.recording/1", "drive_gain": {' + gains + "}}"
    )
    recording = recordings.read(path, robot)
    assert np.allclose(recording.q, q) and np.allclose(recording.torque, 10.0 * np.cos(q))
    assert np.allclose(recording.qref, q)


def test_columns_are_named_by_the_user(two_link, tmp_path, capsys):
    renamed = {
        "t": "Time",
        **{f"{p}.joint_{k}": f"{p}{k} (SI)" for p in ("q", "dq", "tau") for k in (1, 2)},
    }
    path = write(tmp_path / "r.csv", [renamed[name] for name in COLUMNS], rows(*COLUMNS.values()))
    assert_refused(path, two_link, "--columns t=COLUMN")
    assert_same_motion(recordings.read(path, two_link, columns=renamed))
    stated = ",".join(f"{name}={column}" for name, column in renamed.items())
    arguments = ["identifiability", "two_link", str(path), "-o", str(tmp_path / "out")]
    assert cli.main([*arguments, "--columns", stated]) == 0
    assert cli.main([*arguments, "--columns", "t=Zeit"]) == 2
    assert "no column 'Zeit'" in capsys.readouterr().err
    assert cli.main([*arguments, "--columns", "speed=Time"]) == 2
    assert "NAME=COLUMN" in capsys.readouterr().err


def test_the_planned_motion_is_remarked(two_link, tmp_path):
    quantities = ("q", "dq", "ddq", "tau")
    header = ["t", *(f"{p}.joint_{k}" for p in quantities for k in (1, 2))]
    columns = [COLUMNS.get(name, np.zeros(400)) for name in header]
    recording, _ = read_with_warnings(
        write(tmp_path / "trajectory.csv", header, rows(*columns)), two_link
    )
    assert [r.kind for r in recording.doubts] == [RemarkKind.PLANNED]
    assert "planned motion" in recording.doubts[0].text
