"""Formats of recordings, sidecars, units, and checks of signals."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import document, joint, link, loaded, pendulum
from hypothesis import given
from hypothesis import strategies as st
from recording_fixtures import (
    JOINTS,
    assert_refused,
    read_with_warnings,
    remark_kinds,
    two_joint_motion,
    write_columns,
)

from excite import recordings
from excite._types import FloatArray
from excite.errors import UnusableInput
from excite.recordings import RemarkKind, csv_reader
from excite.robot.limits import resolve
from excite.robot.robot import load

REAL = Path(__file__).resolve().parents[2] / "shared" / "recordings"
# -- formats ---------------------------------------------------------------------------------------


@given(seed=st.integers(0, 10**6), separator=st.sampled_from([",", ";", "\t", "|", " ", ", "]))
def test_csv_round_trip_in_any_separator_and_order(two_link, tmp_path_factory, seed, separator):
    rng = np.random.default_rng(seed)
    columns = two_joint_motion() | {"flag.mode": np.ones(400)}
    path = write_columns(
        tmp_path_factory.mktemp("csv") / "r.csv",
        columns,
        separator,
        list(rng.permutation(list(columns))),
    )
    recording = recordings.read(path, two_link)
    for name, values in (("q", recording.q), ("dq", recording.dq), ("tau", recording.tau)):
        assert (values == np.column_stack([columns[f"{name}.{joint}"] for joint in JOINTS])).all()
    assert (recording.t == columns["t"]).all() and (recording.row_times == recording.t).all()
    assert (
        recording.current is None
        and recording.qref is None
        and recording.joints == JOINTS
        and not recording.remarks
    )
    assert (
        recording.rate == pytest.approx(100.0)
        and len(recording) == 400
        and (recording.torque == recording.tau).all()
    )


def test_csv_of_a_spreadsheet(two_link, tmp_path):
    """Byte order mark, quoted names, CRLF, semicolons, decimal commas, no final newline, and text
    in a column that is not read."""
    columns = two_joint_motion()
    rows = ["\ufeff" + ";".join(f'"{name}"' for name in [*columns, "state"])]
    rows += [
        ";".join([*(repr(float(v[k])).replace(".", ",") for v in columns.values()), "run"])
        for k in range(400)
    ]
    path = tmp_path / "r.csv"
    path.write_bytes("\r\n".join(rows).encode())
    assert (recordings.read(path, two_link).q[:, 0] == columns["q.joint_1"]).all()


@given(
    seed=st.integers(0, 10**6), noise=st.binary(min_size=1, max_size=3), place=st.integers(0, 10**6)
)
def test_plain_and_tolerant_parser_agree(seed, noise, place):
    rng = np.random.default_rng(seed)
    table = rng.normal(size=(20, 3)) * 10.0 ** rng.integers(-12, 12, (20, 3))
    text = "\n".join(",".join(repr(float(v)) for v in row) for row in table).encode() + b"\n"
    assert (
        csv_reader.is_plain(text, 3)
        and (csv_reader.parse_numbers(text, ",", 3, [2, 0]) == table[:, [2, 0]]).all()
    )
    place %= len(text)
    damaged = text[:place] + noise + text[place + 1 :]
    if csv_reader.is_plain(damaged, 3):
        spaced = damaged.replace(b",", b" ,")  # which the tolerant parser reads
        assert not csv_reader.is_plain(spaced, 3)
        plain, tolerant = (
            csv_reader.parse_numbers(t, ",", 3, [0, 1, 2]) for t in (damaged, spaced)
        )
        assert np.array_equal(plain, tolerant)


@pytest.mark.parametrize("separator", [",", ";", "\t", "|", " "])
def test_numbers_with_plus_signs_are_plain(separator):
    table = np.random.default_rng(0).normal(size=(20, 3))
    lines = (",".join(f"{value:+.17e}" for value in row) for row in table)
    text = "\n".join(lines).encode() + b"\n"
    assert csv_reader.is_plain(text, 3)
    text = text.replace(b",", separator.encode())
    assert (csv_reader.parse_numbers(text, separator, 3, [0, 1, 2]) == table).all()


@pytest.mark.parametrize(
    "text", [b"1,+\n", b"+,1\n", b"+-1,1\n", b"++1,1\n", b"1,+e5\n", b"1,2+\n"]
)
def test_plus_signs_without_a_number_are_refused(text):
    assert not csv_reader.is_plain(text, 2)
    with pytest.raises(ValueError, match="at row 0"):
        csv_reader.parse_numbers(text, ",", 2, [0, 1])


@pytest.mark.parametrize("cell", ["2024-01-02", "1.2.3", "0x10", "1_0", "1e5.0", "2x", "1-2"])
def test_cells_that_begin_like_numbers_are_refused(two_link, tmp_path, cell):
    path = write_columns(tmp_path / "r.csv", two_joint_motion())
    lines = path.read_text().splitlines()
    cells = lines[7].split(",")
    lines[7] = ",".join([*cells[:2], cell, *cells[3:]])
    path.write_text("\n".join(lines))
    assert_refused(path, two_link, "row 8", "each row should hold 7 numbers")


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize("form", ["columns", "matrices", "by column", "names as bytes"])
def test_archives_are_read(two_link, tmp_path, compress, form):
    columns = two_joint_motion()
    arrays: dict[str, FloatArray] = dict(columns)
    if form != "columns":
        order = JOINTS[::-1]
        names = np.array(["other", *order], "S" if form == "names as bytes" else "U")
        arrays = {"t": columns["t"], "joints": names}
        for name in ("q", "dq", "tau"):
            value = np.column_stack([np.zeros(400), *(columns[f"{name}.{j}"] for j in order)])
            arrays[name] = (
                np.asfortranarray(value) if form == "by column" else value.astype(np.float64)
            )
    (np.savez_compressed if compress else np.savez)(tmp_path / "r.npz", **arrays)
    recording = recordings.read(tmp_path / "r.npz", two_link)
    assert (
        recording.tau is not None
        and (recording.q[:, 1] == columns["q.joint_2"]).all()
        and (recording.tau[:, 0] == columns["tau.joint_1"]).all()
    )


def rtde(rows: int = 300) -> dict[str, FloatArray]:
    t = 1000.0 + np.arange(rows) / 500.0
    fields = (
        "target_q",
        "actual_q",
        "actual_qd",
        "actual_current",
        "target_moment",
        "joint_temperatures",
    )
    phase = np.outer(t, np.linspace(1.0, 2.0, 6))
    values = {"actual_q": np.sin(phase), "actual_qd": np.linspace(1.0, 2.0, 6) * np.cos(phase)}
    columns = {"timestamp": t}
    for field in fields:
        table = values.get(field, np.cos(phase))
        columns |= {f"{field}_{i}": table[:, i] for i in range(6)}
    return columns | {"robot_mode": np.full(rows, 7.0)}


@pytest.mark.parametrize("separator", [",", " "])
def test_recordings_of_ur_rtde(tmp_path, separator):
    robot = load("ur5e")
    columns = rtde()
    path = write_columns(tmp_path / "r.csv", columns, separator)
    recording = recordings.read(path, robot)
    assert recording.joints == robot.joints and recording.tau is None
    for value, field in (
        (recording.q, "actual_q"),
        (recording.current, "actual_current"),
        (recording.qref, "target_q"),
    ):
        assert value is not None and (value[:, 5] == columns[f"{field}_5"]).all()
    assert recording.temperature is not None and recording.dq is not None
    with pytest.raises(
        UnusableInput, match=f"joint '{robot.joints[0]}' has a current but no drive gain"
    ) as caught:
        _ = recording.torque
    assert all(f'"{name}": N m/A' in str(caught.value) for name in robot.joints)
    assert "into r.json" in str(caught.value)
    gains = {name: 10.0 + i for i, name in enumerate(robot.joints)}
    (tmp_path / "r.json").write_text(
        json.dumps({"schema": "excite.recording/1", "drive_gain": gains})
    )
    assert (recordings.read(path, robot).torque[:, 2] == 12.0 * columns["actual_current_2"]).all()


def test_columns_of_rtde_that_the_user_names_come_first(tmp_path):
    robot = load("ur5e")
    columns = rtde()
    phase = np.outer(columns["timestamp"], np.ones(6))
    for name, values in (("actual_current_as_torque", phase), ("joint_torque", np.sin(phase))):
        columns |= {f"{name}_{i}": values[:, i] for i in range(6)}
    path = write_columns(tmp_path / "r.csv", columns)
    stated = {f"tau.{joint}": f"joint_torque_{i}" for i, joint in enumerate(robot.joints)}
    stated |= {"t": "timestamp", f"q.{robot.joints[1]}": "target_q_1"}
    for named in (stated, {name: stated[name] for name in stated if name.startswith("tau")}):
        recording = recordings.read(path, robot, columns=named)
        assert (recording.tau[:, 4] == columns["joint_torque_4"]).all()
        assert (recording.q[:, 0] == columns["actual_q_0"]).all()
        assert (recording.current[:, 5] == columns["actual_current_5"]).all()
    assert (recordings.read(path, robot, columns=stated).t == columns["timestamp"]).all()


def test_moving_joints_of_rtde_can_be_named(tmp_path):
    robot = load("ur5e", joints=("elbow_joint", "wrist_1_joint"))
    path = write_columns(tmp_path / "r.csv", rtde())
    stated = {"t": "timestamp", "q.elbow_joint": "actual_q_2", "q.wrist_1_joint": "actual_q_3"}
    recording = recordings.read(path, robot, columns=stated)
    assert (recording.q[:, 1] == rtde()["actual_q_3"]).all()


def test_repeated_states_of_rtde_are_dropped(tmp_path):
    columns = {name: np.repeat(values, 4) for name, values in rtde().items()}
    recording, texts = read_with_warnings(write_columns(tmp_path / "r.csv", columns), load("ur5e"))
    assert (
        remark_kinds(recording) == [RemarkKind.REPEATED]
        and "900 rows" in texts[0]
        and len(recording) == 300
    )


def test_rtde_must_record_the_moving_joints(tmp_path):
    robot = load("ur5e", joints=("elbow_joint", "wrist_1_joint"))
    assert_refused(
        write_columns(tmp_path / "r.csv", rtde()),
        robot,
        "6 joints",
        "2 of the robot move",
        "rename the columns",
    )
    columns = rtde()
    del columns["actual_q_4"]
    columns["actual_q_6"] = columns["actual_q_5"]
    assert_refused(
        write_columns(tmp_path / "r.csv", columns), load("ur5e"), "'actual_q_4'", "wrist_2_joint"
    )


def test_torque_of_some_joints_and_current_of_others(two_link, tmp_path):
    columns = two_joint_motion()
    columns["i.joint_2"] = columns.pop("tau.joint_2")
    path = write_columns(tmp_path / "r.csv", columns)
    (tmp_path / "r.json").write_text(
        '{"schema": "excite.recording/1", "drive_gain": {"joint_2": -2.5}, "period": 3, '
        '"motor_side": true}'
    )
    recording = recordings.read(path, two_link)
    assert (
        recording.torque == np.column_stack([columns["tau.joint_1"], -2.5 * columns["i.joint_2"]])
    ).all()
    assert (
        recording.sidecar.period == 3.0
        and recording.sidecar.motor_side
        and recording.sidecar.periodic is None
    )
    del columns["i.joint_2"]
    with pytest.raises(UnusableInput, match=r"joint 'joint_2' has no torque; record tau\.joint_2"):
        _ = recordings.read(write_columns(path, columns), two_link).torque


# -- refusals --------------------------------------------------------------------------------------


def test_files_that_are_no_recordings_are_refused(two_link, tmp_path):
    assert_refused(tmp_path / "nowhere.csv", two_link, "no such file")
    for name, content, word in (
        ("empty.csv", b"", "no column 't' but nothing"),
        ("binary.csv", b"\xff\xfe\x00\x81", "is no UTF-8 text"),
        ("other.csv", b"time,angle\n0,1\n", "'time', 'angle'"),
        ("header.csv", b"t,q.joint_1,q.joint_2\n", "has no rows"),
        ("one.csv", b"t,q.joint_1,q.joint_2\n0,1,2\n", "has 1 row "),
        (
            "short.csv",
            b"t,q.joint_1,q.joint_2\n"
            + b"".join(b"%f,0,%f\n" % (k / 100, k / 100) for k in range(9)),
            "9 usable rows",
        ),
        ("ragged.csv", b"t,q.joint_1,q.joint_2\n0,1,2\n1,2\n", "row 3: 2 cells instead of 3"),
        ("word.csv", b"t,q.joint_1,q.joint_2\n0,1,2\n1,2,off\n", "row 3"),
        ("broken.npz", b"PK no", "no readable .npz"),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        assert_refused(path, two_link, word)
    with pytest.raises(UnusableInput, match="has no rows"):
        list(recordings.stream(tmp_path / "header.csv", two_link))


def test_missing_joint_is_reported_with_similar_names(two_link, tmp_path):
    columns = two_joint_motion()
    columns["q.joint2"] = columns.pop("q.joint_2")
    assert_refused(
        write_columns(tmp_path / "r.csv", columns),
        two_link,
        "no column 'q.joint_2'",
        "(similar:",
        "'q.joint2'",
        "--joints",
    )
    path = tmp_path / "s.csv"
    path.write_text("t,q.joint_1,q.joint_1\n0,0,0\n")
    assert_refused(path, two_link, "'q.joint_1' occurs twice")


@pytest.mark.parametrize(
    ("row", "separator", "word"),
    [
        ("0,0,0", ",", "commas"),
        (" 0.01\t1.8\t-2e-3", "\t", "tabs"),
        ("0.01  1.8  -2e-3", " ", "blanks"),
        ("1;2;nan", ";", "semicolons"),
        ("0,0,N/A", ",", "commas"),
        ("0,0,", ",", "commas"),
    ],
)
def test_a_file_without_names_is_refused_with_the_names_to_write(
    two_link, tmp_path, row, separator, word
):
    path = tmp_path / "r.csv"
    path.write_text(f"{row}\n{row}\n{row}\n")
    example = separator.join(("t", "q.joint_1", "…", "tau.joint_1", "…"))
    parts = ("names of its 3 columns", example, f"separated by {word}")
    assert_refused(path, two_link, *parts)


@pytest.mark.parametrize(("separator", "word"), [(" ", "blanks"), ("\t", "tabs"), (";", "semicol")])
def test_names_that_are_separated_otherwise_than_the_rows_are_refused(
    two_link, tmp_path, separator, word
):
    path = write_columns(tmp_path / "r.csv", two_joint_motion(), separator)
    names, rows = path.read_text().split("\n", 1)
    path.write_text(f"{names.replace(separator, ',')}\n{rows}")
    parts = ("row 2", f"7 cells are separated by {word}", "the names above by commas")
    assert_refused(path, two_link, *parts)


@pytest.mark.parametrize(
    ("separator", "remedy"),
    [
        (";", "separate the names by semicolons"),
        ("\t", "separate the names by tabs"),
        (" ", "separate names and cells by semicolons"),
    ],
)
def test_decimal_commas_below_names_between_commas_are_refused(
    two_link, tmp_path, separator, remedy
):
    path = write_columns(tmp_path / "r.csv", two_joint_motion(), separator)
    names, rows = path.read_text().split("\n", 1)
    path.write_text(f"{names.replace(separator, ',')}\n{rows.replace('.', ',')}")
    assert_refused(path, two_link, "row 2", "7 cells are separated by", remedy)


def test_decimal_commas_between_commas_are_refused(two_link, tmp_path):
    path = write_columns(tmp_path / "r.csv", two_joint_motion())
    names = path.read_text().split("\n", 1)[0]
    path.write_text("\n".join([names, *(f"{k},0,1,0,2,0,3,0" for k in range(20))]) + "\n")
    parts = ("8 cells instead of 7", "if commas are decimal points", "by semicolons")
    assert_refused(path, two_link, *parts)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize(("names_end", "rows_end"), [(1, 1), (0, 1), (1, 0), (2, 1), (0, 3)])
@pytest.mark.parametrize("newline", ["\n", "\r\n", " \n"])
@pytest.mark.parametrize("missing", [False, True])
def test_separators_at_the_end_of_lines(
    two_link, tmp_path, separator, names_end, rows_end, newline, missing
):
    """The last cells are empty and have no name: there is no such column."""
    columns = two_joint_motion()
    lines = write_columns(tmp_path / "r.csv", columns, separator).read_text().splitlines()
    if separator != ",":
        lines = [lines[0], *(line.replace(".", ",") for line in lines[1:])]
    if missing:  # the value of a column with a name
        lines[5] = lines[5].rpartition(separator)[0] + separator
    ends = [names_end, *[rows_end] * (len(lines) - 1)]
    text = "".join(line + k * separator + newline for line, k in zip(lines, ends, strict=True))
    (tmp_path / "r.csv").write_bytes(text.encode())
    recording, warned = read_with_warnings(tmp_path / "r.csv", two_link)
    assert (recording.q[:, 1] == columns["q.joint_2"]).all()
    assert (np.delete(recording.tau[:, 1], 4) == np.delete(columns["tau.joint_2"], 4)).all()
    assert len(warned) == missing


def test_a_last_column_without_a_name_may_hold_anything(two_link, tmp_path):
    columns = two_joint_motion()
    lines = write_columns(tmp_path / "r.csv", columns).read_text().splitlines()
    for ends in (["1"] * 401, ["run"] * 401, ["", "1"] * 201):
        text = [lines[0] + ",", *(f"{a},{b}" for a, b in zip(lines[1:], ends, strict=False))]
        (tmp_path / "r.csv").write_text("\n".join(text) + "\n")
        assert (
            recordings.read(tmp_path / "r.csv", two_link).tau[:, 0] == columns["tau.joint_1"]
        ).all()
    (tmp_path / "r.csv").write_text("\n".join([lines[0], *(f"{a},1" for a in lines[1:])]) + "\n")
    assert_refused(tmp_path / "r.csv", two_link, "row 2", "8 cells instead of 7")


@pytest.mark.parametrize("sign", ["#", "%", "//", "% "])
def test_comments_and_empty_lines_anywhere(two_link, tmp_path, sign):
    columns = two_joint_motion()
    lines = write_columns(tmp_path / "r.csv", columns).read_text().splitlines()
    above = ["", f"{sign} logged on Monday", "", f"{sign} cell 3, arm 2", ""]
    text = [
        *above,
        lines[0],
        *lines[1:50],
        f"{sign} here, the tool",
        "",
        *lines[50:],
        f"{sign} end",
    ]
    (tmp_path / "r.csv").write_text("\n".join(text))
    recording, warned = read_with_warnings(tmp_path / "r.csv", two_link)
    assert (recording.tau[:, 1] == columns["tau.joint_2"]).all()
    (text_of_warning,) = warned
    assert text_of_warning.endswith("comments below the names of the columns are left out")
    (tmp_path / "r.csv").write_text("\n".join([*text[:70], "1,2,off,0,0,0,0", *text[70:]]))
    assert_refused(tmp_path / "r.csv", two_link, "row 71", "'off'")


def test_signs_of_comments_within_names_belong_to_them(two_link, tmp_path):
    columns = two_joint_motion()
    path = write_columns(tmp_path / "r.csv", columns)
    path.write_text(path.read_text().replace("tau.joint_", "tau.% joint_", 1))
    assert not np.isfinite(recordings.read(path, two_link).tau[:, 0]).any()
    path.write_text(path.read_text().replace("tau.% joint_", "#tau.joint_", 1))
    assert not np.isfinite(recordings.read(path, two_link).tau[:, 0]).any()


def test_names_in_a_comment(two_link, tmp_path):
    columns = two_joint_motion()
    path = write_columns(tmp_path / "r.csv", columns)
    text = path.read_text()
    for names in ("% ", "# ", "#"):
        for end in (",\n", "\n"):
            path.write_text(names + text.replace("\n", end, 1))
            assert (recordings.read(path, two_link).q[:, 0] == columns["q.joint_1"]).all()


@pytest.mark.parametrize(
    ("separator", "cell"),
    [(",", '"1,234.5"'), (";", "1,234.5"), (";", "1.234,5"), (";", "1'234.5"), (",", '"1\'234.5"')],
)
def test_separators_of_thousands_are_named(two_link, tmp_path, separator, cell):
    path = write_columns(tmp_path / "r.csv", two_joint_motion(), separator)
    names, first, rows = path.read_text().split("\n", 2)
    first = separator.join([*first.split(separator)[:-1], cell])
    path.write_text(f"{names}\n{first}\n{rows}")
    assert_refused(path, two_link, "row 2", "thousands", "remove them")


def test_thousands_next_to_decimal_points_are_no_decimals(two_link, tmp_path):
    path = write_columns(tmp_path / "r.csv", two_joint_motion(), ";")
    lines = path.read_text().splitlines()
    lines[3] = ";".join([*lines[3].split(";")[:-1], "-1,234"])
    path.write_text("\n".join(lines) + "\n")
    assert_refused(path, two_link, "row 4", "commas stand between thousands")
    lines[3] = ";".join([*lines[3].split(";")[:-1], "0,234"])  # a decimal comma
    path.write_text("\n".join(lines) + "\n")
    assert recordings.read(path, two_link).tau[2, 1] == 0.234


def test_inconsistent_archives_are_refused(two_link, tmp_path):
    columns = two_joint_motion()
    t, q = columns["t"], np.column_stack([columns["q.joint_1"], columns["q.joint_2"]])
    names = np.array(JOINTS)
    for arrays, word in (
        ({"t": t, "q": q}, "no array 'joints'"),
        ({"q": q, "joints": names}, "no array 't'"),
        ({"t": t, "q": q[:, :1], "joints": names}, "1 columns for 2 joints"),
        ({"t": t[:-1], "q": q, "joints": names}, "'q' has 400 rows and 't' 399"),
        ({"t": t, "q": q.astype(complex), "joints": names}, "complex128"),
        ({"t": t, "q.joint_1": q[:, 0]}, "no column 'q.joint_2'"),
    ):
        np.savez(tmp_path / "r.npz", **arrays)
        assert_refused(tmp_path / "r.npz", two_link, word)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("{", "cannot be read as the sidecar of a recording (line 1, column 2"),
        ("{}", '"schema": "excite.recording/1"'),
        ('{"schema": "excite.recording/2"}', "excite.recording/1"),
        ('{"schema": "excite.recording/1", "drive_gain": 3}', "drive_gain"),
        (
            '{"schema": "excite.recording/1", "drive_gain": {"joint_1": 0}}',
            "drive_gain.joint_1: 0 should be",
        ),
        (
            '{"schema": "excite.recording/1", "drive_gain": {"nobody": 1}}',
            "drive_gain: 'nobody' is no joint of two_link",
        ),
        (
            '{"schema": "excite.recording/1", "period": 4, "periodic": [0, 1]}',
            "periodic: a window of 1 s is much shorter",
        ),
        ('{"schema": "excite.recording/1", "period": -1}', "period"),
        ('{"schema": "excite.recording/1", "periodic": [3, 1]}', "start < end"),
        ('{"schema": "excite.recording/1", "motor_side": 1}', "motor_side"),
        ('{"schema": "excite.recording/1", "effort": "volts"}', "effort"),
        ('{"schema": "excite.recording/1", "topic": 1}', "topic"),
    ],
)
def test_sidecars_are_checked(two_link, tmp_path, text, word):
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(UnusableInput, match=re.escape(word)) as caught:
        recordings.read(write_columns(tmp_path / "r.csv", two_joint_motion()), two_link)
    assert str(caught.value).startswith(str(tmp_path / "r.json"))


def test_trajectory_is_no_sidecar_and_unknown_keys_are_remarked(two_link, tmp_path):
    path = write_columns(tmp_path / "r.csv", two_joint_motion())
    (tmp_path / "r.json").write_text('{"schema": "excite.trajectory/1", "period": 3}')
    assert recordings.read(path, two_link).sidecar == recordings.Sidecar()
    (tmp_path / "r.json").write_text('{"schema": "excite.recording/1", "gains": 3}')
    recording = recordings.read(path, two_link)
    assert (
        remark_kinds(recording) == [RemarkKind.SKIPPED]
        and "'gains'" in recording.remarks[0].text
        and not recording.remarks[0].repaired
    )


# -- units -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("stated", [True, False])
def test_degrees_are_refused(two_link, tmp_path, damage, stated):
    for name in JOINTS:
        damage.columns[f"q.{name}"] = np.rad2deg(damage.columns[f"q.{name}"])
        damage.columns[f"dq.{name}"] = np.rad2deg(damage.columns[f"dq.{name}"])
    path = write_columns(tmp_path / "r.csv", damage.columns)
    assert_refused(
        path,
        two_link,
        "joint 'joint_1'",
        "degrees",
        "convert them to rad",
        "correct the limits",
        limits=resolve(two_link) if stated else None,
    )


def test_tightened_limits_do_not_suggest_other_units(two_link, tmp_path, damage):
    table = resolve(two_link)
    tight = replace(table, position=0.02 * table.position)
    recording = recordings.read(write_columns(tmp_path / "r.csv", damage.columns), two_link, tight)
    assert remark_kinds(recording) == [RemarkKind.OUTSIDE, RemarkKind.OUTSIDE]


def test_mixed_units_and_encoder_counts(two_link, tmp_path, damage):
    columns = dict(damage.columns)
    for name in JOINTS:
        columns[f"dq.{name}"] = np.rad2deg(columns[f"dq.{name}"])
    assert_refused(write_columns(tmp_path / "r.csv", columns), two_link, "dq is in degrees/s")
    columns = damage.columns | {"q.joint_1": damage.columns["q.joint_1"] * 1e5}
    assert_refused(
        write_columns(tmp_path / "r.csv", columns),
        two_link,
        "joint 'joint_1' reaches 5e+04",
        "encoder",
    )
    columns = damage.columns | {"dq.joint_2": -2.0 * damage.columns["dq.joint_2"]}
    recording = recordings.read(write_columns(tmp_path / "r.csv", columns), two_link)
    assert (
        remark_kinds(recording) == [RemarkKind.INCONSISTENT]
        and "-0.5 times dq" in recording.remarks[0].text
    )


def test_reach_of_prismatic_joints_and_of_joints_without_limits(tmp_path):
    columns = {"t": np.arange(100) / 100.0, "q.swing": np.linspace(0.0, 100.0, 100)}
    path = write_columns(tmp_path / "r.csv", columns)
    assert not recordings.read(path, loaded(pendulum(kind="continuous"))).remarks
    assert_refused(
        path,
        loaded(pendulum(inside='<limit velocity="3" effort="40"/>')),
        "beyond 12.57 rad",
        "degrees",
    )
    slide = loaded(
        document(link("base"), link("arm", 2.0), joint("swing", "base", "arm", "prismatic"))
    )
    assert_refused(path, slide, "beyond 2.5 m", "in mm", "correct the limits")


# -- signals ---------------------------------------------------------------------------------------


def test_suspicious_signals_are_remarked_and_kept(two_link, tmp_path):
    columns = two_joint_motion(1000)
    columns["tau.joint_1"] = np.clip(columns["tau.joint_1"], -2.0, 2.0)
    columns["tau.joint_2"][300:340] = columns["tau.joint_2"][300]  # 4 %
    columns["q.joint_2"] = np.round(columns["q.joint_2"] / 2e-3) * 2e-3
    recording = recordings.read(write_columns(tmp_path / "r.csv", columns), two_link)
    assert remark_kinds(recording) == [
        RemarkKind.CLIPPED,
        RemarkKind.COARSE,
        RemarkKind.REPEATED_TORQUE,
        RemarkKind.ROUNDED,
    ]
    clipped, coarse, frozen, rounded = recording.remarks
    assert rounded.repaired and not any(r.repaired for r in (clipped, coarse, frozen))
    assert "'joint_2'" in rounded.text and "'joint_1'" not in rounded.text
    assert "clipped at -2 and 2 N m" in clipped.text and clipped.joint == "joint_1"
    assert "multiples of 0.002 rad" in coarse.text and coarse.joint == "joint_2"
    assert (frozen.start, frozen.end) == pytest.approx((3.0, 3.39)) and frozen.document()[
        "time"
    ] == [frozen.start, frozen.end]
    assert recording.tau is not None and (recording.tau[:, 1] == columns["tau.joint_2"]).all()


def clipping_remarks(robot, path, torque, rows=slice(None)):
    """Return remarks on clipping where a recording has another torque of joint_1, row by row, and
    then some of its rows."""
    columns = two_joint_motion(len(torque)) | {"tau.joint_1": torque}
    columns = {name: values[rows] for name, values in columns.items()}
    columns["t"] = 0.01 * np.arange(len(columns["t"]))
    recording = recordings.read(write_columns(path, columns), robot)
    return [remark for remark in recording.remarks if remark.kind is RemarkKind.CLIPPED]


def test_noisy_torque_that_is_clipped_for_single_rows_is_remarked(two_link, tmp_path):
    """Noise of the size of the motion: hardly two rows in a row are at the limit."""
    rng = np.random.default_rng(1)
    torque = two_joint_motion(1000)["tau.joint_1"]
    torque = torque + np.std(torque) * rng.normal(size=1000)
    low, high = np.quantile(torque, (0.03, 0.98))
    (remark,) = clipping_remarks(two_link, tmp_path / "r.csv", np.clip(torque, low, high))
    assert remark.joint == "joint_1" and not remark.doubt
    assert f"tau is clipped at {low:.5g} and {high:.5g} N m, in 5 % of the rows" in remark.text
    assert not clipping_remarks(two_link, tmp_path / "r.csv", torque)


@pytest.mark.parametrize("steps", [30, 300, 3000])
@pytest.mark.parametrize("held", [False, True])
def test_coarse_held_and_resting_torque_is_not_clipped(two_link, tmp_path, steps, held):
    """A noise-free torque in steps, some values of which are written several times, and one that
    is largest where the robot rests."""
    rng, torque = np.random.default_rng(steps), two_joint_motion(1000)["tau.joint_1"]
    step = np.ptp(torque) / steps
    torque = np.round(torque / step) * step
    if held:
        updated = np.where(rng.random(1000) < 0.4, np.arange(1000), 0)
        torque = torque[np.maximum.accumulate(updated)]
    assert not clipping_remarks(two_link, tmp_path / "r.csv", torque)
    rows = np.sort(np.concatenate([np.arange(1000), np.full(200, np.argmax(torque))]))
    assert not clipping_remarks(two_link, tmp_path / "r.csv", torque, rows)


def test_still_frozen_and_outside_positions_are_remarked(two_link, tmp_path):
    columns = two_joint_motion()
    columns["q.joint_1"] = np.full(400, 0.3)
    columns["q.joint_2"][100:150] = columns["q.joint_2"][100]
    columns["q.joint_2"] += 3.0
    recording = recordings.read(write_columns(tmp_path / "r.csv", columns), two_link)
    assert {(r.kind, r.joint) for r in recording.remarks} >= {
        (RemarkKind.STILL, "joint_1"),
        (RemarkKind.FROZEN, "joint_2"),
        (RemarkKind.OUTSIDE, "joint_2"),
    }


# -- real recordings ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("folder", "urdf", "rate", "expected"),
    [
        ("emps", "emps", 1000.0, set()),
        ("tx40", "tx40", 1000.0, set()),
        ("kuka_kr300", "kuka_kr300", 250.0, set()),
        ("laas_cogging", "motor", 1000.0, {RemarkKind.JITTER}),
    ],
)
def test_real_recordings(folder, urdf, rate, expected):
    if not (REAL / folder).is_dir():
        pytest.skip(
            f"no real recordings at {REAL / folder}; see its README in the project's shared folder"
        )
    robot = load(str(REAL / folder / f"{urdf}.urdf"))
    for path in sorted((REAL / folder).glob("*.csv")):
        recording, _ = read_with_warnings(path, robot)
        assert recording.rate == pytest.approx(rate, rel=1e-3) and expected <= set(
            remark_kinds(recording)
        ) <= expected | {RemarkKind.GAP}
        assert np.isfinite(recording.torque).all() and len(recording.samples()) > 0.99 * len(
            recording
        )
        assert (recording.qlink is not None) == (folder == "kuka_kr300")
        if recording.qlink is not None:
            assert not recording.has("qlink", "axis_6") and recording.has("qlink", "axis_1")


def renamed_motion(path: Path, names: dict[str, str], **further: FloatArray) -> Path:
    """Write the motion of both joints under other names, with further columns."""
    columns = {names.get(name, name): values for name, values in two_joint_motion().items()}
    return write_columns(path, {**further, **columns})


def spelled(pattern: str, quantity: str) -> dict[str, str]:
    """Return names of a quantity of both joints by a pattern of the joint."""
    return {f"{quantity}.joint_{k}": pattern.format(f"joint_{k}") for k in (1, 2)}


def test_commanded_positions_behind_a_topic_are_not_those_of_the_joints(two_link, tmp_path):
    names = {"t": "time"} | spelled("command.{}.position", "q") | spelled("tau_{}", "tau")
    path = renamed_motion(tmp_path / "r.csv", names)
    assert_refused(path, two_link, "commanded", "--columns q.joint_1=COLUMN")


@pytest.mark.parametrize("name", ["q_a_{}", "pos_deg_{}"])
def test_a_column_in_another_unit_next_to_the_same_in_si_units_is_left_out(
    two_link, tmp_path, name
):
    names = {"t": "time"} | spelled("q_{}", "q") | spelled("tau_{}", "tau")
    degrees = {name.format(f"joint_{k}"): np.full(400, 45.0) for k in (1, 2)}
    path = renamed_motion(tmp_path / "r.csv", names, **degrees)
    expected = two_joint_motion()["q.joint_1"]
    np.testing.assert_allclose(recordings.read(path, two_link).q[:, 0], expected, atol=1e-6)


def test_dates_have_no_unit_of_time(two_link, tmp_path):
    path = renamed_motion(tmp_path / "r.csv", {})
    lines = path.read_text().splitlines()
    for k in range(1, len(lines)):
        values = lines[k].partition(",")[2]
        lines[k] = f"2025-03-30T01:{(k - 1) // 6000:02d}:{(k - 1) / 100.0 % 60.0:05.2f},{values}"
    lines[0] = ",".join(spelled_header(lines[0]))
    path.write_text("\n".join(lines))
    with pytest.warns(match="dates"):
        recording = recordings.read(path, two_link)
    assert recording.t[-1] - recording.t[0] == pytest.approx(3.99)


def spelled_header(line: str) -> list[str]:
    """Return the standard names of a header as scripts write them, with time in ms."""
    return ["time [ms]" if name == "t" else name.replace(".", "_") for name in line.split(",")]


def test_a_text_that_begins_like_a_comment_is_a_cell(two_link, tmp_path):
    path = renamed_motion(tmp_path / "r.csv", {})
    lines = path.read_text().splitlines()
    numbered = [f"#{k},{line}" for k, line in enumerate(lines[1:])]
    path.write_text("\n".join([f"id,{lines[0]}", *numbered]))
    assert len(recordings.read(path, two_link)) == 400


def test_words_of_motor_drivers_are_read_where_no_other_column_holds_their_quantity(tmp_path):
    robot = loaded(pendulum())
    t = np.arange(200) / 100.0
    rows = np.column_stack([1000.0 * t, np.sin(3.0 * t), np.cos(2.0 * t), np.cos(5.0 * t)])

    def read(header: str) -> recordings.Recording:
        lines = [header, *(",".join(map(repr, map(float, row))) for row in rows)]
        path = tmp_path / "r.csv"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return recordings.read(path, robot)

    recording = read("time (millisec),angle,q_current,d_current")
    np.testing.assert_allclose(recording.q[:, 0], rows[:, 1])
    assert recording.current is not None and recording.rate == pytest.approx(100.0)
    np.testing.assert_allclose(recording.current[:, 0], rows[:, 2])
    recording = read("time_ms,angle,position,current")  # that of another sensor
    np.testing.assert_allclose(recording.q[:, 0], rows[:, 2])
    recording = read("time_ms,feedback_angle,present_current,command_angle")
    assert recording.current is not None and recording.qref is not None
    np.testing.assert_allclose(recording.current[:, 0], rows[:, 2])
    np.testing.assert_allclose(recording.qref[:, 0], rows[:, 3])
    recording = read("time_ms,position,torque,iq_mA")  # a torque needs no current
    np.testing.assert_allclose(recording.torque[:, 0], rows[:, 2])
    recording = read("time_ms,i,position,iq")  # `i` counts rows
    assert recording.current is not None
    np.testing.assert_allclose(recording.current[:, 0], rows[:, 3])


@pytest.mark.parametrize(
    ("position", "command"),
    [
        ("present_position_{joint}", "goal_position_{joint}"),
        ("q_{number}", "q_ref_{number}"),
        ("{joint}/position", "{joint}/targetPosition"),
        ("pos[{number}]", "cmd_pos[{number}] [rad]"),
    ],
)
def test_commanded_positions_are_read(position, command, two_link, tmp_path):
    motion = two_joint_motion()
    columns = {"time": motion["t"]}
    for pattern, shift in ((position, 0.0), (command, 0.01)):
        for number, name in enumerate(JOINTS, start=1):
            columns[pattern.format(joint=name, number=number)] = motion[f"q.{name}"] + shift
    path = write_columns(tmp_path / "r.csv", columns)
    recording, texts = read_with_warnings(path, two_link)
    assert recording.qref is not None and not any("not read" in text for text in texts)
    np.testing.assert_allclose(recording.qref - recording.q, 0.01)
    write_columns(path, columns | {"goal_q_3": motion["t"], "desired_angle_1": motion["t"]})
    recording, _ = read_with_warnings(path, two_link)
    assert recording.qref is None  # which of them is tracked is not known


def test_units_of_columns_that_the_user_names(tmp_path):
    robot, path = loaded(pendulum()), tmp_path / "r.csv"
    t = np.arange(200) / 100.0
    columns = {"clock ms": 1000.0 * t, "time_ms": 1000.0 * t, "angle [rad]": np.sin(3.0 * t)}
    write_columns(path, columns | {"drive_mA": np.cos(2.0 * t)})
    given = {"t": "time_ms", "q.swing": "angle [rad]"}
    recording = recordings.read(path, robot, columns=given)
    assert recording.rate == pytest.approx(100.0)
    np.testing.assert_array_equal(recording.q[:, 0], columns["angle [rad]"])
    write_columns(path, {"t": t, "angle (enc)": columns["angle [rad]"]})
    encoder = recordings.read(path, robot, columns={"q.swing": "angle (enc)"})
    np.testing.assert_array_equal(encoder.q, recording.q)
    write_columns(path, columns | {"drive_mA": np.cos(2.0 * t)})
    with pytest.raises(UnusableInput, match="'drive_mA' is in mA; convert it to SI units, A"):
        recordings.read(path, robot, columns={**given, "i.swing": "drive_mA"})


def test_second_words_of_a_joint_whose_name_ends_like_a_unit(tmp_path):
    """`arm_nm` is the joint, and no joint `arm` in N m: its angle gives way to its position."""
    robot = loaded(pendulum().replace("swing", "arm_nm"))
    t = np.arange(200) / 100.0
    columns = {"t": t, "angle_arm_nm": np.cos(t), "q_arm_nm [rad]": np.sin(3.0 * t)}
    recording = recordings.read(write_columns(tmp_path / "r.csv", columns), robot)
    np.testing.assert_array_equal(recording.q[:, 0], columns["q_arm_nm [rad]"])


@pytest.mark.parametrize("pattern", ["{}|{}", "|{}.{}|", "{}_{}[rad,rad/s,Nm]"])
def test_names_may_contain_separators_that_the_rows_do_not_have(pattern, two_link, tmp_path):
    """Blanks separate the cells, and one name holds a vertical bar or a comma."""
    columns = two_joint_motion()
    columns["error"] = columns["t"]
    path = write_columns(tmp_path / "r.csv", columns, " ")
    names = list(columns)
    if pattern == "{}|{}":
        names = [name.replace(".", "|") for name in names]
    names[-1] = pattern.format("position", "error")
    path.write_text(" ".join(names) + "\n" + path.read_text().partition("\n")[2])
    recording, texts = read_with_warnings(path, two_link)
    assert not texts
    np.testing.assert_array_equal(recording.q[:, 1], columns["q.joint_2"])
