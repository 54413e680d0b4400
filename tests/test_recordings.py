"""Recordings in: every format, every repair, every refusal."""

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
    Array,
    assert_refused,
    read_with_warnings,
    remark_kinds,
    two_joint_motion,
    write_columns,
)

from excite import recordings
from excite.errors import UnusableInput
from excite.recordings import Kind, csv_parse
from excite.robot.limits import resolve
from excite.robot.robot import load

REAL = Path(__file__).resolve().parents[2] / "shared" / "recordings"
# -- formats ---------------------------------------------------------------------------------------


@given(seed=st.integers(0, 10**6), separator=st.sampled_from([",", ";", "\t", " ", ", "]))
def test_a_csv_comes_back_whatever_its_separator_and_order(
    two_link, tmp_path_factory, seed, separator
):
    rng = np.random.default_rng(seed)
    columns = two_joint_motion() | {"flag.mode": np.ones(400)}
    path = write_columns(
        tmp_path_factory.mktemp("csv") / "r.csv",
        columns,
        separator,
        list(rng.permutation(list(columns))),
    )
    found = recordings.read(path, two_link)
    for name, values in (("q", found.q), ("dq", found.dq), ("tau", found.tau)):
        assert (values == np.column_stack([columns[f"{name}.{joint}"] for joint in JOINTS])).all()
    assert (found.t == columns["t"]).all() and (found.own_times == found.t).all()
    assert (
        found.current is None
        and found.qref is None
        and found.joints == JOINTS
        and not found.remarks
    )
    assert (
        found.rate == pytest.approx(100.0)
        and len(found) == 400
        and (found.torque == found.tau).all()
    )


def test_a_csv_of_a_spreadsheet(two_link, tmp_path):
    """Byte order mark, quoted names, CRLF, semicolons, decimal commas, no newline at the end, text
    in a column nobody reads."""
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
    seed=st.integers(0, 10**6), noise=st.binary(min_size=1, max_size=3), at=st.integers(0, 10**6)
)
def test_fast_and_tolerant_parsing_agree_or_refuse(seed, noise, at):
    rng = np.random.default_rng(seed)
    table = rng.normal(size=(20, 3)) * 10.0 ** rng.integers(-12, 12, (20, 3))
    text = "\n".join(",".join(repr(float(v)) for v in row) for row in table).encode() + b"\n"
    assert (
        csv_parse.plain(text, 3)
        and (csv_parse.rows(text, ",", 3, [2, 0]) == table[:, [2, 0]]).all()
    )
    at %= len(text)
    damaged = text[:at] + noise + text[at + 1 :]
    if csv_parse.plain(damaged, 3):
        slow = csv_parse._tolerant(damaged, 3, [0, 1, 2])
        assert np.array_equal(csv_parse.rows(damaged, ",", 3, [0, 1, 2]), slow)


@pytest.mark.parametrize("cell", ["2024-01-02", "1.2.3", "0x10", "1_0", "1e5.0", "2x", "1-2"])
def test_what_starts_like_a_number_is_not_taken_for_one(two_link, tmp_path, cell):
    path = write_columns(tmp_path / "r.csv", two_joint_motion())
    lines = path.read_text().splitlines()
    cells = lines[7].split(",")
    lines[7] = ",".join([*cells[:2], cell, *cells[3:]])
    path.write_text("\n".join(lines))
    assert_refused(path, two_link, "row 8", "each row should hold 7 numbers")


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize("form", ["columns", "matrices", "by column"])
def test_archives(two_link, tmp_path, compress, form):
    columns = two_joint_motion()
    arrays: dict[str, Array] = dict(columns)
    if form != "columns":
        order = JOINTS[::-1]
        arrays = {"t": columns["t"], "joints": np.array(["other", *order])}
        for name in ("q", "dq", "tau"):
            value = np.column_stack([np.zeros(400), *(columns[f"{name}.{j}"] for j in order)])
            arrays[name] = (
                np.asfortranarray(value) if form == "by column" else value.astype(np.float64)
            )
    (np.savez_compressed if compress else np.savez)(tmp_path / "r.npz", **arrays)
    found = recordings.read(tmp_path / "r.npz", two_link)
    assert (
        found.tau is not None
        and (found.q[:, 1] == columns["q.joint_2"]).all()
        and (found.tau[:, 0] == columns["tau.joint_1"]).all()
    )


def rtde(rows: int = 300) -> dict[str, Array]:
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
    found = recordings.read(path, robot)
    assert found.joints == robot.joints and found.tau is None
    for value, field in (
        (found.q, "actual_q"),
        (found.current, "actual_current"),
        (found.qref, "target_q"),
    ):
        assert value is not None and (value[:, 5] == columns[f"{field}_5"]).all()
    assert found.temperature is not None and found.dq is not None
    with pytest.raises(
        UnusableInput, match=f"joint '{robot.joints[0]}' has a current but no drive gain"
    ):
        _ = found.torque
    gains = {name: 10.0 + i for i, name in enumerate(robot.joints)}
    (tmp_path / "r.json").write_text(
        json.dumps({"schema": "excite.recording/1", "drive_gain": gains})
    )
    assert (recordings.read(path, robot).torque[:, 2] == 12.0 * columns["actual_current_2"]).all()


def test_rtde_repeats_a_state_where_the_recorder_is_faster_than_the_robot(tmp_path):
    columns = {name: np.repeat(values, 4) for name, values in rtde().items()}
    found, texts = read_with_warnings(write_columns(tmp_path / "r.csv", columns), load("ur5e"))
    assert remark_kinds(found) == [Kind.REPEATED] and "900 rows" in texts[0] and len(found) == 300


def test_rtde_has_no_names_to_leave_joints_out_by(tmp_path):
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
        '{"schema": "excite.recording/1", "drive_gain": {"joint_2": -2.5}, "period": 2, "motor_side": true}'  # noqa: E501
    )
    found = recordings.read(path, two_link)
    assert (
        found.torque == np.column_stack([columns["tau.joint_1"], -2.5 * columns["i.joint_2"]])
    ).all()
    assert (
        found.sidecar.period == 2.0 and found.sidecar.motor_side and found.sidecar.periodic is None
    )
    del columns["i.joint_2"]
    with pytest.raises(UnusableInput, match=r"joint 'joint_2' has no torque; record tau\.joint_2"):
        _ = recordings.read(write_columns(path, columns), two_link).torque


# -- refusals --------------------------------------------------------------------------------------


def test_files_that_are_no_recordings(two_link, tmp_path):
    assert_refused(tmp_path / "nowhere.csv", two_link, "no such file")
    for name, content, word in (
        ("empty.csv", b"", "no column 't' but nothing"),
        ("binary.csv", b"\xff\xfe\x00\x81", "is no UTF-8 text"),
        ("other.csv", b"time,angle\n0,1\n", "'time', 'angle'"),
        ("header.csv", b"t,q.joint_1,q.joint_2\n", "has no rows"),
        ("one.csv", b"t,q.joint_1,q.joint_2\n0,1,2\n", "has 1 rows"),
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


def test_a_missing_joint_comes_with_what_is_like_it(two_link, tmp_path):
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
    assert_refused(path, two_link, "'q.joint_1' stands twice")


def test_archives_that_do_not_fit(two_link, tmp_path):
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


def test_a_trajectory_beside_its_csv_is_no_sidecar_and_unknown_keys_are_told(two_link, tmp_path):
    path = write_columns(tmp_path / "r.csv", two_joint_motion())
    (tmp_path / "r.json").write_text('{"schema": "excite.trajectory/1", "period": 3}')
    assert recordings.read(path, two_link).sidecar == recordings.Sidecar()
    (tmp_path / "r.json").write_text('{"schema": "excite.recording/1", "gains": 3}')
    found = recordings.read(path, two_link)
    assert (
        remark_kinds(found) == [Kind.SKIPPED]
        and "'gains'" in found.remarks[0].text
        and not found.remarks[0].repaired
    )


# -- units -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("stated", [True, False])
def test_degrees(two_link, tmp_path, damage, stated):
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
        limits=resolve(two_link) if stated else None,
    )


def test_limits_tightened_for_a_design_say_nothing_of_units(two_link, tmp_path, damage):
    table = resolve(two_link)
    tight = replace(table, position=0.02 * table.position)
    found = recordings.read(write_columns(tmp_path / "r.csv", damage.columns), two_link, tight)
    assert remark_kinds(found) == [Kind.OUTSIDE, Kind.OUTSIDE]


def test_mixed_units_and_counts(two_link, tmp_path, damage):
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
    found = recordings.read(write_columns(tmp_path / "r.csv", columns), two_link)
    assert remark_kinds(found) == [Kind.INCONSISTENT] and "-0.5 times dq" in found.remarks[0].text


def test_reach_of_joints_without_limits_and_of_sliding_ones(tmp_path):
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
    assert_refused(path, slide, "beyond 2.5 m", "in mm")


# -- signs -----------------------------------------------------------------------------------------


def test_channels_that_look_wrong_are_remarked_and_left(two_link, tmp_path):
    columns = two_joint_motion(1000)
    columns["tau.joint_1"] = np.clip(columns["tau.joint_1"], -2.0, 2.0)
    columns["tau.joint_2"][300:340] = columns["tau.joint_2"][300]
    columns["q.joint_2"] = np.round(columns["q.joint_2"] / 2e-3) * 2e-3
    found = recordings.read(write_columns(tmp_path / "r.csv", columns), two_link)
    assert remark_kinds(found) == [Kind.CLIPPED, Kind.COARSE, Kind.FROZEN, Kind.ROUNDED]
    clipped, coarse, frozen, rounded = found.remarks
    assert rounded.repaired and not any(r.repaired for r in (clipped, coarse, frozen))
    assert "'joint_2'" in rounded.text and "'joint_1'" not in rounded.text
    assert "clipped at 2" in clipped.text and clipped.joint == "joint_1"
    assert "multiples of 0.002 rad" in coarse.text and coarse.joint == "joint_2"
    assert (frozen.start, frozen.end) == pytest.approx((3.0, 3.39)) and frozen.document()[
        "time"
    ] == [frozen.start, frozen.end]
    assert found.tau is not None and (found.tau[:, 1] == columns["tau.joint_2"]).all()


def test_joints_that_stand_still_freeze_or_leave_their_limits(two_link, tmp_path):
    columns = two_joint_motion()
    columns["q.joint_1"] = np.full(400, 0.3)
    columns["q.joint_2"][100:150] = columns["q.joint_2"][100]
    columns["q.joint_2"] += 3.0
    found = recordings.read(write_columns(tmp_path / "r.csv", columns), two_link)
    assert {(r.kind, r.joint) for r in found.remarks} >= {
        (Kind.STILL, "joint_1"),
        (Kind.FROZEN, "joint_2"),
        (Kind.OUTSIDE, "joint_2"),
    }


# -- real ones -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("folder", "urdf", "rate", "expected"),
    [
        ("emps", "emps", 1000.0, set()),
        ("tx40", "tx40", 1000.0, set()),
        ("kuka_kr300", "kuka_kr300", 250.0, set()),
        ("laas_cogging", "motor", 1000.0, {Kind.JITTER}),
    ],
)
def test_real_recordings(folder, urdf, rate, expected):
    if not (REAL / folder).is_dir():
        pytest.skip(
            f"no real recordings at {REAL / folder}; see its README in the project's shared folder"
        )
    robot = load(str(REAL / folder / f"{urdf}.urdf"))
    for path in sorted((REAL / folder).glob("*.csv")):
        found, _ = read_with_warnings(path, robot)
        assert found.rate == pytest.approx(rate, rel=1e-3) and expected <= set(
            remark_kinds(found)
        ) <= expected | {Kind.GAP}
        assert np.isfinite(found.torque).all() and len(found.samples()) > 0.99 * len(found)
        assert (found.qlink is not None) == (folder == "kuka_kr300")
        if found.qlink is not None:
            assert not found.has("qlink", "axis_6") and found.has("qlink", "axis_1")
