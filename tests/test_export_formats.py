"""CSV files that other programs write: PlotJuggler, ROS, spreadsheets, Universal Robots."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from conftest import pendulum
from recording_fixtures import assert_refused, read_with_warnings, two_joint_motion

from excite import recordings
from excite.cli import main as cli
from excite.errors import ExciteWarning, UnusableInput
from excite.recordings import RemarkKind
from excite.robot.robot import load, locate

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


@pytest.mark.parametrize(
    ("time", "spelling"),
    [
        ("time", "{quantity}_{joint}"),
        ("timestamp", "{joint}/{word}"),
        ("t [s]", "{word}[{joint}]"),
        ("time_s", "{joint}.{quantity} [{unit}]"),
        ("time", "{joint}_{word}_{si}"),
        ("stamp", "{quantity}_{joint}"),
        ("Elapsed Time [s]", "{joint}.{word}"),
    ],
)
def test_names_of_joints_as_scripts_spell_them(two_link, tmp_path, time, spelling):
    columns = {"stamp": 1e9 * COLUMNS["t"]} if time == "time" else {}
    columns |= {time: COLUMNS["t"]}
    for word, quantity, unit in (
        *(("position", "q", "rad"), ("velocity", "dq", "rad/s"), ("torque", "tau", "N m")),
    ):
        for joint in ("joint_2", "joint_1"):
            si = unit.replace("/", "_").replace(" ", "")
            name = spelling.format(quantity=quantity, word=word, joint=joint, unit=unit, si=si)
            columns[name] = COLUMNS[f"{quantity}.{joint}"]
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    assert_same_motion(recordings.read(path, two_link))


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("spelling", ["{}{}", "{}_{}", "{}[{}]", "{}_joint{}"])
def test_numbered_joints_are_in_the_order_of_the_robot(two_link, tmp_path, spelling, first):
    columns = {"t_ms": 1e3 * COLUMNS["t"]}
    for k in (1, 0):
        for quantity in ("q", "dq", "tau"):
            name = spelling.format(quantity, k + first)
            columns[name] = COLUMNS[f"{quantity}.joint_{k + 1}"]
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    recording, warned = read_with_warnings(path, two_link)
    assert_same_motion(recording)
    second = spelling.format("q", first + 1)
    is_named = spelling == "{}_joint{}" and first == 1
    assert any(f"{second} = joint_2" in text for text in warned) is not is_named


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("spelling", ["{}_{}", "{}{}", "{}[{}]", "field.{}{}"])
@pytest.mark.parametrize("time", ["time", "timestamp"])
def test_elements_with_numbers_alone_count_from_0_or_1(two_link, tmp_path, time, spelling, first):
    columns = {time: COLUMNS["t"]}
    for word, quantity in (("position", "q"), ("velocity", "dq"), ("effort", "tau")):
        for k in range(2):
            columns[spelling.format(word, k + first)] = COLUMNS[f"{quantity}.joint_{k + 1}"]
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    recording, warned = read_with_warnings(path, two_link)
    assert_same_motion(recording)
    assert any(f"{spelling.format('position', first + 1)} = joint_2" in text for text in warned)


@pytest.mark.parametrize("names", [("q1", "q2"), ("joint_1_pos", "q.joint_2"), ("q_1", "q_2")])
def test_positions_without_a_time_are_answered_by_the_way_to_add_it(two_link, tmp_path, names):
    columns = dict(zip(names, (COLUMNS["q.joint_1"], COLUMNS["q.joint_2"]), strict=True))
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    text = assert_refused(path, two_link, "no column 't' of time", "add a column t [s]")
    assert "row" in text and "--columns t=COLUMN" in text


@pytest.mark.parametrize("time", ["time", "Timestamp [ms]"])
@pytest.mark.parametrize(("torque", "missing"), [("load", "and no torque"), ("tau_joint_1", "of")])
def test_what_is_missing_is_named_not_the_time(two_link, tmp_path, time, torque, missing):
    columns = {time: COLUMNS["t"], "angle": COLUMNS["q.joint_1"], torque: COLUMNS["tau.joint_1"]}
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    text = assert_refused(path, two_link, f"no position {missing}", "--columns q.joint_1=COLUMN")
    assert "column 't'" not in text and "'angle'" in text


def test_elements_with_other_numbers_need_names(two_link, tmp_path):
    columns = {"time": COLUMNS["t"], "position_3": COLUMNS["q.joint_1"]}
    columns |= {"position_4": COLUMNS["q.joint_2"], "effort_3": COLUMNS["tau.joint_1"]}
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    assert_refused(path, two_link, "the numbers 3, 4", "--columns q.joint_1=COLUMN")


@pytest.mark.parametrize("first", ["q1", "Q_1", "q[1]", "q1 [rad]"])
def test_numbers_that_are_names_of_joints_are_not_warned_of(tmp_path, first):
    path = tmp_path / "robot.urdf"
    path.write_text(locate("two_link").read_text().replace('"joint_', '"q'))
    robot = load(str(path))
    for names, is_warned in (((first, "q2"), False), (("q0", "q1"), True)):
        values = [COLUMNS["t"], *(COLUMNS[f"q.joint_{k}"] for k in (1, 2))]
        file = write(tmp_path / "r.csv", ["t", *names], rows(*values))
        recording, warned = read_with_warnings(file, robot)
        np.testing.assert_allclose(recording.q[:, 1], values[2])
        assert bool(warned) is is_warned


@pytest.mark.parametrize(
    "names",
    [("position", "torque"), ("q_rad", "tau_Nm"), ("q1", "tau1"), ("q1", "torque"), ("q", "tau0")],
)
def test_columns_of_a_robot_with_a_single_joint_need_no_name(two_link, tmp_path, names):
    robot = load("two_link", lock={"joint_2": 0.0})
    values = [COLUMNS[f"{quantity}.joint_1"] for quantity in ("q", "tau")]
    path = write(tmp_path / "r.csv", ["time", *names], rows(COLUMNS["t"], *values))
    recording, warned = read_with_warnings(path, robot)
    np.testing.assert_allclose(recording.q[:, 0], values[0])
    np.testing.assert_allclose(recording.torque[:, 0], values[1])
    assert not any("joint_1" in text for text in warned)
    for name in ("position_deg", "position_rad_s", "q [Nm]"):
        wrong = write(tmp_path / "r.csv", ["time", name], rows(COLUMNS["t"], values[0]))
        assert_refused(wrong, robot, "is in", "SI units, rad or m, and name it q.joint_1")


def test_a_counter_of_rows_is_no_current(two_link, tmp_path):
    robot = load("two_link", lock={"joint_2": 0.0})
    values = [COLUMNS[f"{quantity}.joint_1"] for quantity in ("q", "tau")]
    counter = np.arange(len(values[0]))
    names = ["i", "time", "position", "torque"]
    path = write(tmp_path / "r.csv", names, rows(counter, COLUMNS["t"], *values))
    recording = recordings.read(path, robot)
    assert recording.current is None and np.allclose(recording.torque[:, 0], values[1])


@pytest.mark.parametrize("joint", ["lift_mm", "arm_deg", "j_a", "arm_rad"])
def test_a_joint_whose_name_ends_like_a_unit(tmp_path, joint):
    path = tmp_path / "robot.urdf"
    path.write_text(pendulum().replace('"swing"', f'"{joint}"'))
    robot = load(str(path))
    values = [COLUMNS[f"{quantity}.joint_1"] for quantity in ("q", "tau")]
    for spelling in ("{}.{}", "{}_{}", "{}_{}_unit"):
        units = {"q": "rad", "tau": "Nm"}
        names = [
            spelling.format(quantity, joint).replace("unit", units[quantity]) for quantity in units
        ]
        file = write(tmp_path / "r.csv", ["time", *names], rows(COLUMNS["t"], *values))
        np.testing.assert_allclose(recordings.read(file, robot).torque[:, 0], values[1])


def test_names_that_scripts_spell_are_read_only_if_they_are_clear(two_link, tmp_path):
    t, q = COLUMNS["t"], COLUMNS["q.joint_1"]

    def named(*names: str) -> Path:
        columns = rows(t, *(q for _ in names))
        return write(tmp_path / "r.csv", ["time", *names], columns)

    both = assert_refused(named("q_joint_1", "joint_1_pos", "q_joint_2"), two_link, "both")
    assert "--columns q.joint_1=" in both
    assert_refused(named("q_joint_1 (deg)", "q_joint_2 (deg)"), two_link, "is in deg", "SI units")
    # a joint less or more than the robot has: numbers say nothing
    remedy = "--columns q.joint_1=COLUMN,tau.joint_1=COLUMN,…"
    assert_refused(named("q1"), two_link, "positions of 1 joint ", "2 joints", remedy)
    three = ("q1", "q2", "q3", "tau1", "tau2", "tau3")
    assert_refused(named(*three), two_link, "positions of 3 joints", "2 joints", "move", remedy)
    assert_refused(named("q2", "q3"), two_link, "the numbers 2, 3, neither 0 to 1", remedy)


@pytest.mark.parametrize("word", ["eff", "effort"])
@pytest.mark.parametrize("names", [("{}_1", "{}_2"), ("joint_1_{}", "joint_2/{}")])
def test_efforts_next_to_positions_with_short_names_are_read(two_link, tmp_path, word, names):
    columns = {"time": COLUMNS["t"]}
    for quantity, first in (("q", "q"), ("dq", "vel"), ("tau", word)):
        for name, joint in zip(names, ("joint_1", "joint_2"), strict=True):
            columns[name.format(first)] = COLUMNS[f"{quantity}.{joint}"]
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    assert_same_motion(read_with_warnings(path, two_link)[0])


@pytest.mark.parametrize("word", ["eff", "effort"])
def test_an_effort_next_to_a_torque_is_chosen_by_columns(two_link, tmp_path, word):
    columns = {"time": COLUMNS["t"]}
    for k in (1, 2):
        columns |= {f"q_{k}": COLUMNS[f"q.joint_{k}"], f"dq_{k}": COLUMNS[f"dq.joint_{k}"]}
        columns |= {f"tau_{k}": COLUMNS[f"tau.joint_{k}"], f"{word}_{k}": COLUMNS["t"]}
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    assert_refused(path, two_link, "'tau_1'", f"'{word}_1'", "--columns tau.joint_1=COLUMN")
    chosen = {f"tau.joint_{k}": f"tau_{k}" for k in (1, 2)}
    assert_same_motion(read_with_warnings(path, two_link, columns=chosen)[0])


@pytest.mark.parametrize(("position", "effort"), [(1, 0), (0, 1)])
def test_each_quantity_is_numbered_for_itself(two_link, tmp_path, position, effort):
    columns = {"time": COLUMNS["t"]}
    for k in (1, 2):
        for quantity in ("q", "dq"):
            columns[f"{quantity}_{k - 1 + position}"] = COLUMNS[f"{quantity}.joint_{k}"]
        columns[f"effort_{k - 1 + effort}"] = COLUMNS[f"tau.joint_{k}"]
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    assert_same_motion(read_with_warnings(path, two_link)[0])


@pytest.mark.parametrize("word", ["q", "position"])
@pytest.mark.parametrize(
    ("first", "numbers", "surplus"),
    [
        (1, (0, 1, 2), ["effort_0"]),
        (1, (1, 2, 3), ["effort_3"]),
        (0, (0, 1, 2), ["effort_2"]),
        (0, (1, 2, 3), ["effort_2", "effort_3"]),
        (1, (3, 4), ["effort_3", "effort_4"]),
        (1, (2, 3), ["effort_3"]),
    ],
)
def test_columns_of_more_joints_than_there_are_positions_are_named(
    two_link, tmp_path, word, first, numbers, surplus
):
    """With a gripper, or with its base, as the first one: nobody can tell."""
    columns = {"time": COLUMNS["t"]}
    columns |= {f"{word}_{k - 1 + first}": COLUMNS[f"q.joint_{k}"] for k in (1, 2)}
    columns |= {f"effort_{k}": COLUMNS["tau.joint_1"] for k in numbers}
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    span = f"{len(numbers)} columns 'effort_{numbers[0]}' to 'effort_{numbers[-1]}'"
    names = ", ".join(map(repr, surplus))
    remedy = "remove columns that are of no joint of the robot, or name all with --columns t="
    assert_refused(path, two_link, span, f"no position has the number of {names};", remedy)
    named = {"t": "time", **{f"q.joint_{k}": f"{word}_{k - 1 + first}" for k in (1, 2)}}
    named |= {f"tau.joint_{k}": f"effort_{numbers[k - 1]}" for k in (1, 2)}
    recording = recordings.read(path, two_link, columns=named)
    np.testing.assert_allclose(recording.tau[:, 1], COLUMNS["tau.joint_1"])


def test_more_temperatures_than_joints_and_fewer_torques_are_no_fault(two_link, tmp_path):
    columns = {"time": COLUMNS["t"], "q_1": COLUMNS["q.joint_1"], "q_2": COLUMNS["q.joint_2"]}
    columns |= {"tau_2": COLUMNS["tau.joint_2"]}
    columns |= {f"temp_{k}": np.full(400, 30.0 + k) for k in (1, 2, 3)}
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    recording, _ = read_with_warnings(path, two_link)
    np.testing.assert_allclose(recording.tau[:, 1], COLUMNS["tau.joint_2"])
    assert np.isnan(recording.tau[:, 0]).all()


@pytest.mark.parametrize(
    "spelling",
    [
        "/joint_states/{joint}/{quantity}",
        "joint_states.{quantity}.{joint}",
        "/robot/joint_states.{quantity}[{number}]",
    ],
)
@pytest.mark.parametrize("time", ["time", "/joint_states/header/stamp", "timestamp [ms]"])
@pytest.mark.parametrize("command", [False, True])
def test_names_behind_a_topic(two_link, tmp_path, spelling, time, command):
    """Another topic that lacks the positions is not read."""
    if time.startswith("/") and not spelling.startswith(time[:13]):
        pytest.skip("the stamp of another topic")
    columns = {time: COLUMNS["t"] * (1e3 if "ms" in time else 1.0)}
    for quantity, prefix in QUANTITIES.items():
        for k in (1, 2):
            name = spelling.format(quantity=quantity, joint=f"joint_{k}", number=k - 1)
            columns[name] = COLUMNS[f"{prefix}.joint_{k}"]
    if command:
        columns |= {f"/command/joint_{k}/effort": 7.0 + COLUMNS["t"] for k in (1, 2)}
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    recording, warned = read_with_warnings(path, two_link)
    assert_same_motion(recording)
    assert all("have numbers and no names" in text for text in warned)


def test_of_two_topics_with_positions_one_is_chosen_in_the_sidecar(two_link, tmp_path):
    columns = {"time": COLUMNS["t"]}
    for k in (1, 2):
        columns[f"/command/joint_{k}/position"] = COLUMNS[f"q.joint_{k}"] + 0.1
        for quantity, prefix in QUANTITIES.items():
            columns[f"/joint_states/joint_{k}/{quantity}"] = COLUMNS[f"{prefix}.joint_{k}"]
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    assert_refused(path, two_link, "'/command' and '/joint_states' both hold", '"topic"')
    path.with_suffix(".json").write_text(
        '{"schema": "excite.recording/1", "topic": "/joint_states"}', encoding="utf-8"
    )
    assert_same_motion(read_with_warnings(path, two_link)[0])


@pytest.mark.parametrize("name", ["{}", "{number}"])
def test_units_behind_a_quantity(two_link, tmp_path, name):
    columns = {"time": COLUMNS["t"]}
    for word, prefix in (("pos_rad", "q"), ("vel_rad_s", "dq"), ("torque_Nm", "tau")):
        for k in (1, 2):
            columns[f"{word}_{name.format(f'joint_{k}', number=k)}"] = COLUMNS[
                f"{prefix}.joint_{k}"
            ]
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    assert_same_motion(read_with_warnings(path, two_link)[0])
    degrees = path.read_text(encoding="utf-8").replace("vel_rad_s", "vel_deg_s")
    path.write_text(degrees, encoding="utf-8")
    assert_refused(path, two_link, "vel_deg_s_", "is in deg_s", "convert it to SI units")


@pytest.mark.parametrize("name", ["current_A_{}", "{}_current_A", "current_A_{number}"])
def test_currents_with_their_unit_need_a_drive_gain(two_link, tmp_path, name):
    columns = {"time": COLUMNS["t"]}
    for k in (1, 2):
        columns[f"q_{k}" if "number" in name else f"q_joint_{k}"] = COLUMNS[f"q.joint_{k}"]
        columns[name.format(f"joint_{k}", number=k)] = COLUMNS[f"tau.joint_{k}"]
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    recording, _ = read_with_warnings(path, two_link)
    assert recording.tau is None
    np.testing.assert_allclose(recording.current[:, 0], COLUMNS["tau.joint_1"])
    with pytest.raises(UnusableInput, match="has a current but no drive gain"):
        _ = recording.torque


@pytest.mark.parametrize("time", ["t", "time"])
def test_columns_that_are_not_read_are_named_where_the_torque_is_missing(two_link, tmp_path, time):
    columns = {time: COLUMNS["t"]}
    for k in (1, 2):
        columns[f"q.joint_{k}"] = COLUMNS[f"q.joint_{k}"]
        columns[f"joint_{k} load"] = COLUMNS[f"tau.joint_{k}"]
    path = write(tmp_path / "r.csv", list(columns), rows(*columns.values()))
    recording, _ = read_with_warnings(path, two_link)
    words = r"--columns tau\.joint_1=COLUMN \(not read: 'joint_1 load', 'joint_2 load'\)"
    with pytest.raises(UnusableInput, match=words):
        _ = recording.torque
    named = {"tau.joint_1": "joint_1 load"}
    with pytest.raises(UnusableInput, match=r"\(not read: 'joint_2 load'\)"):
        _ = recordings.read(path, two_link, columns=named).torque


def test_words_that_end_like_an_effort_are_none(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(locate("two_link").read_text().replace('"joint_1"', '"eff"'))
    robot, t = load(str(path)), COLUMNS["t"]
    values = [COLUMNS["q.joint_1"], COLUMNS["q.joint_2"], COLUMNS["tau.joint_1"], t, t]
    names = ["time", "eff_pos", "joint_2_pos", "eff_eff", "coeff_joint_2", "joint_2_coeff"]
    recording = recordings.read(write(tmp_path / "r.csv", names, rows(t, *values)), robot)
    assert recording.tau is not None and not np.isfinite(recording.tau[:, 1]).any()
    np.testing.assert_allclose(recording.tau[:, 0], values[2])


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
        **{f"{p}.joint_{k}": f"channel {p} {k}" for p in ("q", "dq", "tau") for k in (1, 2)},
    }
    path = write(tmp_path / "r.csv", [renamed[name] for name in COLUMNS], rows(*COLUMNS.values()))
    assert_refused(path, two_link, "no position", "'Time'", "--columns q.joint_1=COLUMN")
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


# -- files of loggers that nobody has announced ----------------------------------------------------


def lists(order: tuple[int, ...] = (1, 2), quantities=QUANTITIES) -> list[list[str]]:
    """A JointState message per row, with lists in the cells."""
    return [
        [
            f"{EPOCH + COLUMNS['t'][k]:.6f}",
            '"[' + ", ".join(f"'joint_{j}'" for j in order) + ']"',
            *(
                '"[' + ", ".join(f"{COLUMNS[f'{p}.joint_{j}'][k]:.17g}" for j in order) + ']"'
                for p in quantities.values()
            ),
        ]
        for k in range(400)
    ]


@pytest.mark.parametrize("order", [(1, 2), (2, 1)])
def test_lists_in_cells(two_link, tmp_path, order):
    header = ["time", "name", *QUANTITIES]
    assert_same_motion(recordings.read(write(tmp_path / "r.csv", header, lists(order)), two_link))


def test_lists_in_cells_of_another_length_are_refused(two_link, tmp_path):
    cells = lists()
    cells[200][2] = '"[0.1]"'
    path = write(tmp_path / "r.csv", ["time", "name", *QUANTITIES], cells)
    assert_refused(path, two_link, "1 values of q for 2 joints", "joint_1, joint_2")
    cells = [row[1:] for row in lists()]
    path = write(tmp_path / "r.csv", ["name", *QUANTITIES], cells)
    assert_refused(path, two_link, "no column of time", "--columns t=COLUMN")


def elements(change: bool) -> list[list[str]]:
    """A JointState message per row, an element per cell; every seventh row in another order."""
    out = []
    for k in range(400):
        order = (2, 1) if change and k % 7 == 3 else (1, 2)
        values = [COLUMNS[f"{p}.joint_{j}"][k] for p in QUANTITIES.values() for j in order]
        names = [f"joint_{j}" for j in order]
        stamp = str(EPOCH * 10**9 + round(COLUMNS["t"][k] * 1e9))
        out.append([stamp, *names, *(f"{value:.17g}" for value in values)])
    return out


@pytest.mark.parametrize("change", [False, True])
def test_names_that_change_their_order_from_row_to_row(two_link, tmp_path, change):
    header = ["%time", *(f"field.{f}{k}" for f in ("name", *QUANTITIES) for k in (0, 1))]
    path = write(tmp_path / "r.csv", header, elements(change))
    assert_same_motion(recordings.read(path, two_link))
    echoed = [
        [row[0][:-9], row[0][-9:].lstrip("0") or "0", "", *row[1:]] for row in elements(change)
    ]
    assert_same_motion(recordings.read(write(tmp_path / "e.csv", None, echoed), two_link))


def test_rows_of_other_joints_are_left_out(two_link, tmp_path):
    header = ["%time", *(f"field.{f}{k}" for f in ("name", *QUANTITIES) for k in (0, 1))]
    cells = elements(False)
    cells[100][1:3] = ["finger_1", "finger_2"]
    recording, texts = read_with_warnings(write(tmp_path / "r.csv", header, cells), two_link)
    assert "1 rows that lack some of the robot's joints" in texts[0]
    assert len(recording) == 400  # a single missing row is filled


def test_rows_of_other_topics_are_left_out(two_link, tmp_path):
    """PlotJuggler merges the time stamps of all topics."""
    header = ["__time", "/imu/x"]
    header += [f"/joint_states/joint_{k}/{f}" for f in QUANTITIES for k in (1, 2)]
    cells = []
    for k in range(400):
        values = [COLUMNS[f"{p}.joint_{j}"][k] for p in QUANTITIES.values() for j in (1, 2)]
        cells.append([f"{EPOCH + COLUMNS['t'][k]:.6f}", "", *(f"{v:.17g}" for v in values)])
        cells.append([f"{EPOCH + COLUMNS['t'][k] + 0.003:.6f}", "0.5", *[""] * 6])
    recording, texts = read_with_warnings(write(tmp_path / "r.csv", header, cells), two_link)
    assert_same_motion(recording)
    assert texts[0].endswith("as of other topics, are left out") and len(texts) == 1


def test_the_topic_is_chosen_in_the_sidecar(two_link, tmp_path):
    header, columns = ["__time"], [EPOCH + COLUMNS["t"]]
    for topic, factor in (("/joint_states", 1.0), ("/dynamic_joint_states", 2.0)):
        for field, prefix in QUANTITIES.items():
            for k in (1, 2):
                header.append(f"{topic}/joint_{k}/{field}")
                columns.append(factor * COLUMNS[f"{prefix}.joint_{k}"])
    path = write(tmp_path / "r.csv", header, rows(*columns))
    assert_refused(path, two_link, '"topic": "/joint_states" or "/dynamic_joint_states"')
    path.with_suffix(".json").write_text(
        '{"schema": "excite.recording/1", "topic": "/joint_states"}'
    )
    assert_same_motion(recordings.read(path, two_link))


@pytest.mark.parametrize(
    "comment", ["# robot: two_link\n# one, two\n", "// logged on Monday, cell 3\n", "# "]
)
def test_comments_above_the_header(two_link, tmp_path, comment):
    path = write(tmp_path / "r.csv", list(COLUMNS), rows(*COLUMNS.values()))
    path.write_text(comment + path.read_text(encoding="utf-8"), encoding="utf-8")
    assert_same_motion(recordings.read(path, two_link))


def test_row_of_units(two_link, tmp_path):
    cells = rows(*COLUMNS.values())
    units = ["s", "rad", "rad", "rad/s", "rad/s", "[Nm]", "N m"]
    path = write(tmp_path / "r.csv", list(COLUMNS), [units, *cells])
    assert_same_motion(recordings.read(path, two_link))
    path = write(tmp_path / "r.csv", list(COLUMNS), [["s", "deg", *units[2:]], *cells])
    assert_refused(path, two_link, "row 2", "column 'q.joint_1' is in deg", "convert it")


def test_a_log_that_was_cut_short_or_continued(two_link, tmp_path):
    path = write(tmp_path / "r.csv", list(COLUMNS), rows(*COLUMNS.values()))
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join([*lines[:200], lines[0], *lines[200:], lines[-1][:30]]))
    recording, texts = read_with_warnings(path, two_link)
    assert_same_motion(recording)
    assert "1 rows that repeat the header are left out" in texts[0]
    assert "the last one, is cut short" in texts[1]


@pytest.mark.parametrize("word", ["N/A", "null", "None", '"NA"'])
def test_words_for_a_missing_value(two_link, tmp_path, word):
    cells = rows(*COLUMNS.values())
    cells[100][5] = word
    recording, texts = read_with_warnings(write(tmp_path / "r.csv", list(COLUMNS), cells), two_link)
    assert "1 missing value of tau, 1 interpolated" in texts[0] and len(recording) == 400


@pytest.mark.parametrize("stamp", ["01.05.2024 10:00:{:09.6f}", "10:00:{:09.6f}"])
def test_times_of_day_and_dates_in_another_order_are_refused(two_link, tmp_path, stamp):
    cells = rows(*COLUMNS.values())
    cells = [[stamp.format(float(row[0])), *row[1:]] for row in cells]
    path = write(tmp_path / "r.csv", list(COLUMNS), cells)
    assert_refused(path, two_link, "row 2", "a date or a time of day", "in seconds")


def date_cells(zone: str, separator: str = "T") -> list[list[str]]:
    """Rows of COLUMNS whose times are dates around a midnight in UTC."""
    start = datetime(2024, 5, 1, 23, 59, 58, tzinfo=UTC)
    hours = timezone(timedelta(hours=2)) if zone.startswith("+") else UTC
    cells = rows(*COLUMNS.values())
    for row, t in zip(cells, COLUMNS["t"], strict=True):
        date = (start + timedelta(seconds=float(t))).astimezone(hours)
        row[0] = date.strftime(f"%Y-%m-%d{separator}%H:%M:%S.%f") + zone
    return cells


@pytest.mark.parametrize("zone", ["Z", "+02:00", "+0200", ""])
@pytest.mark.parametrize("separator", ["T", " "])
@pytest.mark.parametrize("name", ["t", "timestamp"])
def test_dates_count_from_the_first(two_link, tmp_path, zone, separator, name):
    header = [name, *list(COLUMNS)[1:]]
    path = write(tmp_path / "r.csv", header, date_cells(zone, separator))
    recording, warned = read_with_warnings(path, two_link)
    assert_same_motion(recording)
    assert recording.t[0] == 0.0
    (text,) = warned
    moment = "2024-05-01 23:59:58"
    assert f"seconds from the first, {moment}{' UTC' if zone else ''}" in text


def test_dates_in_quotes_behind_other_columns_and_between_semicolons(two_link, tmp_path):
    cells = [[f'"a;b, {k}"', *row[1:], f'"{row[0]}"'] for k, row in enumerate(date_cells("Z"))]
    cells = [[cell.replace(".", ",") for cell in row] for row in cells]
    header = ["note", *list(COLUMNS)[1:], "t"]
    path = write(tmp_path / "r.csv", header, cells, ";")
    with pytest.warns(ExciteWarning, match="its times are dates"):
        assert_same_motion(recordings.read(path, two_link))


def test_dates_are_all_written_in_the_same_way(two_link, tmp_path):
    cells = date_cells("Z")
    cells[7][0] = cells[7][0].removesuffix("Z")
    path = write(tmp_path / "r.csv", list(COLUMNS), cells)
    assert_refused(path, two_link, "row 9", "time zone", "in the same way")
    cells[7][0] = "2024-13-01T00:00:00Z"
    path = write(tmp_path / "r.csv", list(COLUMNS), cells)
    assert_refused(path, two_link, "row 9", "'2024-13-01T00:00:00Z' is no date", "in seconds")


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "µs"), (1e9, "ns")])
@pytest.mark.parametrize("name", ["t", "time", "header/stamp"])
@pytest.mark.parametrize("missing", [False, True])
def test_counts_since_1970_are_known_by_their_size(two_link, tmp_path, factor, unit, name, missing):
    columns = dict(COLUMNS)
    cells = rows(*columns.values())
    for row, t in zip(cells, COLUMNS["t"], strict=True):
        row[0] = str(round(factor * float(t)) + round(factor) * EPOCH)
    if missing:
        cells.insert(0, ["", *cells[0][1:]])
    header = [name, *list(COLUMNS)[1:]]
    recording, warned = read_with_warnings(write(tmp_path / "r.csv", header, cells), two_link)
    assert_same_motion(recording)
    assert any(f"its times count {unit} since 1970" in text for text in warned)


@pytest.mark.parametrize("value", [1e13, 1e16])
def test_a_single_time_of_another_size_changes_no_unit(two_link, tmp_path, value):
    columns = dict(COLUMNS) | {"t": COLUMNS["t"].copy()}
    columns["t"][0] = value
    path = write(tmp_path / "r.csv", list(COLUMNS), rows(*columns.values()))
    assert_refused(path, two_link, "time goes back from")


@pytest.mark.parametrize("unit", ["ms", "µs", "ns"])
def test_other_times_in_other_units_are_refused(two_link, tmp_path, unit):
    factor = {"ms": 1e3, "µs": 1e6, "ns": 1e9}[unit]
    columns = [factor * COLUMNS["t"], *list(COLUMNS.values())[1:]]
    path = write(tmp_path / "r.csv", list(COLUMNS), rows(*columns))
    assert_refused(path, two_link, f"is time in {unit}? Divide it by")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_a_table_in_another_encoding_is_read(two_link, tmp_path, encoding):
    path = write(tmp_path / "r.csv", list(COLUMNS), rows(*COLUMNS.values()))
    path.write_text(path.read_text(encoding="utf-8"), encoding=encoding)
    assert_same_motion(read_with_warnings(path, two_link)[0])


@pytest.mark.parametrize("form", ["PlotJuggler", "lists", "elements", "echo"])
def test_efforts_of_messages_may_be_currents(two_link, tmp_path, form):
    header: list[str] | None
    if form == "PlotJuggler":
        header = ["__time", *(f"/joint_states/joint_{k}/{f}" for f in QUANTITIES for k in (1, 2))]
        names = [f"{p}.joint_{k}" for p in QUANTITIES.values() for k in (1, 2)]
        cells = rows(EPOCH + COLUMNS["t"], *(COLUMNS[name] for name in names))
    elif form == "lists":
        header, cells = ["time", "name", *QUANTITIES], lists()
    else:
        header = ["%time", *(f"field.{f}{k}" for f in ("name", *QUANTITIES) for k in (0, 1))]
        cells = elements(True)
    if form == "echo":
        header = None
        cells = [[row[0][:-9], str(int(row[0][-9:])), "", *row[1:]] for row in cells]
    path = write(tmp_path / "r.csv", header, cells)
    gains = '"drive_gain": {"joint_1": 2.0, "joint_2": 3.0}'
    sidecar = path.with_suffix(".json")
    sidecar.write_text('{"schema": "excite.recording/1", "effort": "current", ' + gains + "}")
    recording = recordings.read(path, two_link)
    currents = np.column_stack([COLUMNS["tau.joint_1"], COLUMNS["tau.joint_2"]])
    assert recording.tau is None
    assert np.allclose(recording.torque, currents * [2.0, 3.0], atol=1e-9)


def test_torque_columns_are_no_currents(two_link, tmp_path):
    path = write(tmp_path / "r.csv", list(COLUMNS), rows(*COLUMNS.values()))
    path.with_suffix(".json").write_text('{"schema": "excite.recording/1", "effort": "current"}')
    with pytest.raises(UnusableInput, match=r"r\.json: \"effort\": \"current\" .*i\.<joint>"):
        recordings.read(path, two_link)
    named = [name.replace("tau.", "i.") for name in COLUMNS]
    write(path, named, rows(*COLUMNS.values()))
    assert recordings.read(path, two_link).tau is None


@pytest.mark.parametrize("line", [b"sep=;\r\n", b"SEP=;\n"])
def test_line_of_spreadsheets_that_states_the_separator(two_link, tmp_path, line):
    path = write(tmp_path / "r.csv", list(COLUMNS), rows(*COLUMNS.values()), ";")
    path.write_bytes(line + path.read_bytes())
    assert_same_motion(recordings.read(path, two_link))


def test_comment_behind_a_byte_order_mark(two_link, tmp_path):
    path = write(tmp_path / "r.csv", list(COLUMNS), rows(*COLUMNS.values()))
    path.write_bytes(b"\xef\xbb\xbf# recorded on Monday\n" + path.read_bytes())
    assert_same_motion(recordings.read(path, two_link))


def test_row_of_units_with_missing_and_unknown_ones(two_link, tmp_path):
    cells = rows(*COLUMNS.values())
    units = ["s", "rad", "rad", "rad/s", "rad/s", "N-m", "-"]
    path = write(tmp_path / "r.csv", list(COLUMNS), [units, *cells])
    assert_same_motion(recordings.read(path, two_link))
    path = write(tmp_path / "r.csv", list(COLUMNS), [[*units[:6], "kp cm"], *cells])
    assert_refused(path, two_link, "row 2", "unit 'kp cm' of column 'tau.joint_2' is unknown")


def test_elements_without_names_must_be_as_many_as_joints(two_link, tmp_path):
    header = ["time", "position_0", "position_1", "position_2"]
    columns = [COLUMNS[name] for name in ("t", "q.joint_1", "q.joint_2", "q.joint_2")]
    path = write(tmp_path / "r.csv", header, rows(*columns))
    assert_refused(path, two_link, "positions of 3 joints", "2 joints of the robot", "--columns")
    named = {"t": "time", "q.joint_1": "position_1", "q.joint_2": "position_2"}
    recording = recordings.read(path, two_link, columns=named)
    assert (recording.q[:, 0] == COLUMNS["q.joint_2"]).all()


def test_row_of_an_implausible_number_counts_comments(two_link, tmp_path):
    cells = rows(*COLUMNS.values())
    cells[10][1] = "1e20"
    path = write(tmp_path / "r.csv", list(COLUMNS), cells)
    path.write_text("# one\n# two\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    assert_refused(path, two_link, "row 14, column q.joint_1")


def test_echo_may_begin_with_a_message_of_other_joints(two_link, tmp_path):
    cells = [[row[0][:-9], str(int(row[0][-9:])), "", *row[1:]] for row in elements(False)]
    finger = [[row[0], row[1], "", "finger", "0.01", "0.0", "0.0"] for row in cells]
    mixed = [row for pair in zip(finger, cells, strict=True) for row in pair]
    path = write(tmp_path / "r.csv", None, mixed)
    recording, texts = read_with_warnings(path, two_link)
    assert_same_motion(recording)
    assert "400 rows that lack some of the robot's joints" in texts[0]


def test_pipes_are_no_recordings(two_link):
    with pytest.raises(UnusableInput, match="/dev/null: is a pipe or a device; write"):
        recordings.read(Path("/dev/null"), two_link)
