"""Long (tidy) tables: a row for each joint and time, or for each joint, quantity and time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from recording_fixtures import (
    JOINTS,
    assert_refused,
    read_with_warnings,
    remark_kinds,
    two_joint_motion,
)

from excite import recordings
from excite.recordings import RemarkKind
from excite.robot import robot

HEADER = "time,joint,position,velocity,effort"
PREFIXES = ("q", "dq", "tau")


def long_rows(
    joints: Sequence[object] = JOINTS, offset: Callable[[int, int], float] = lambda k, i: 0.0
) -> list[str]:
    """Return the rows of `two_joint_motion`, sample by sample.

    Args:
        joints: Texts for the joints.
        offset: Time of a joint in a sample after that of the sample, by their numbers [s].
    """
    columns = two_joint_motion()
    out = []
    for k, t in enumerate(columns["t"]):
        for i, joint in enumerate(JOINTS):
            values = [float(columns[f"{prefix}.{joint}"][k]) for prefix in PREFIXES]
            cells = [repr(float(t) + offset(k, i)), str(joints[i]), *map(repr, values)]
            out.append(",".join(cells))
    return out


def written(path: Path, rows: Sequence[str], header: str = HEADER) -> Path:
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8", newline="")
    return path


def assert_motion(recording: recordings.Recording) -> None:
    """Assert that a recording is `two_joint_motion`."""
    columns = two_joint_motion()
    assert recording.t - recording.t[0] == pytest.approx(columns["t"], abs=2e-6)
    for name, prefix in zip(("q", "dq", "tau"), PREFIXES, strict=True):
        for i, joint in enumerate(JOINTS):
            assert (getattr(recording, name)[:, i] == columns[f"{prefix}.{joint}"]).all()


def by_joint(rows: list[str]) -> list[str]:
    """Return rows ordered by the joint, then by time."""
    return sorted(rows, key=lambda row: row.split(",")[1])


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text,
        lambda text: text.replace(",", ";").replace(".", ","),
        lambda text: text.replace(",", "\t"),
        lambda text: text.replace(",", " "),
        lambda text: text.replace("joint_1", '"joint_1"').replace("joint_2", '"joint_2"'),
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("time,joint", "t,part").replace("effort", "torque_Nm"),
        lambda text: text.replace("position,velocity,effort", "q,dq,tau [Nm]"),
        lambda text: "".join(f"{k},{line}\n" for k, line in enumerate(text.split("\n")) if line),
    ],
    ids=["commas", "semicolons", "tabs", "blanks", "quotes", "Windows", "part", "units", "index"],
)
@pytest.mark.parametrize("order", [list, by_joint])
def test_long_tables_are_recordings(change, order, two_link, tmp_path):
    path = tmp_path / "long.csv"
    text = "\n".join([HEADER, *order(long_rows())]) + "\n"
    path.write_text(change(text), encoding="utf-8", newline="")
    recording, texts = read_with_warnings(path, two_link)
    assert_motion(recording)
    assert not texts


def melted(cells: Callable[[str, str], str]) -> list[str]:
    """Return a row for each time, quantity and joint; `cells` are those of the last two."""
    columns = two_joint_motion()
    return [
        f"{float(columns['t'][k])!r},{cells(prefix, joint)},"
        f"{float(columns[f'{prefix}.{joint}'][k])!r}"
        for prefix in PREFIXES
        for joint in JOINTS
        for k in range(len(columns["t"]))
    ]


WORDS = {"q": "position", "dq": "velocity", "tau": "torque"}


@pytest.mark.parametrize(
    ("header", "cells"),
    [
        ("time,variable,value", lambda prefix, joint: f"{prefix}.{joint}"),
        ("time,variable,value", lambda prefix, joint: f"{joint}_{WORDS[prefix]}"),
        ("time,joint,signal,value", lambda prefix, joint: f"{joint},{WORDS[prefix]}"),
        ("time,quantity,joint,value", lambda prefix, joint: f"{prefix},{joint}"),
    ],
)
def test_a_value_in_each_row(header, cells, two_link, tmp_path):
    path = written(tmp_path / "long.csv", melted(cells), header)
    recording, texts = read_with_warnings(path, two_link)
    assert_motion(recording)
    assert not texts


@pytest.mark.parametrize("joints", [(1, 2), (0, 1), ("J1", "J2"), ("axis 1", "axis 2")])
def test_numbers_of_joints_are_those_of_the_robot(joints, two_link, tmp_path):
    path = written(tmp_path / "long.csv", long_rows(joints))
    recording, texts = read_with_warnings(path, two_link)
    assert_motion(recording)
    assert len(texts) == 1 and f"{joints[0]} = joint_1, {joints[1]} = joint_2" in texts[0]


@pytest.mark.parametrize("order", [list, by_joint])
def test_times_of_one_sample_may_differ_slightly(order, two_link, tmp_path):
    """A loop that asks the clock for each joint writes times that differ by microseconds."""
    rng = np.random.default_rng(0)
    rows = order(long_rows(offset=lambda k, i: i * 1e-5 + 1e-6 * rng.random()))
    recording, texts = read_with_warnings(written(tmp_path / "long.csv", rows), two_link)
    assert_motion(recording)
    assert not texts


@pytest.mark.parametrize("order", [list, by_joint])
def test_joints_that_are_polled_in_turn_are_interpolated(order, two_link, tmp_path):
    """The second joint is read 4 ms after the first."""
    columns = two_joint_motion()
    path = written(tmp_path / "long.csv", order(long_rows(offset=lambda k, i: 0.004 * i)))
    recording, texts = read_with_warnings(path, two_link)
    assert len(texts) == 1 and "at different times" in texts[0] and "interpolated" in texts[0]
    assert len(recording) == 399
    assert (recording.q[:, 0] == columns["q.joint_1"][1:]).all()
    delayed = 0.5 * np.sin(3.0 * (recording.t - 0.004))
    assert np.abs(recording.q[:, 1] - delayed).max() < 1e-4


@pytest.mark.parametrize("order", [list, by_joint])
def test_a_missing_joint_of_a_sample_is_a_missing_value(order, two_link, tmp_path):
    rows = long_rows()
    kept = [row for k, row in enumerate(rows) if k not in (100, 241)]  # a row of either joint
    path = written(tmp_path / "long.csv", order(kept))
    recording, texts = read_with_warnings(path, two_link)
    assert len(recording) == 400 and len(texts) == 6
    for joint in JOINTS:
        assert any(f"joint '{joint}': 1 missing value of q, 1 interpolated" in t for t in texts)


def test_rows_of_other_joints_are_not_read(two_link, tmp_path):
    others = [row.replace("joint_1", "finger").replace("joint_2", "thumb") for row in long_rows()]
    rows = [row for pair in zip(others, long_rows(), strict=True) for row in pair]
    recording, texts = read_with_warnings(written(tmp_path / "long.csv", rows), two_link)
    assert_motion(recording)
    assert not texts


def test_rows_of_a_locked_joint_do_not_mix_with_those_of_a_single_joint(tmp_path):
    single = robot.load("two_link", joints="joint_1", lock={"joint_2": 0.0})
    rows = [
        f"{0.01 * k!r},{joint},{0.3 * np.sin(0.03 * k) if joint == 'joint_1' else 0.0:.9f}"
        for k in range(400)
        for joint in JOINTS
    ]
    path = written(tmp_path / "long.csv", rows, "time,joint,position")
    recording, texts = read_with_warnings(path, single)
    assert len(recording) == 400 and not texts
    assert recording.q[:, 0] == pytest.approx(0.3 * np.sin(0.03 * np.arange(400)), abs=1e-9)
    other = written(tmp_path / "other.csv", rows[1::2], "time,joint,position")
    assert_refused(other, single, "no rows of joint 'joint_1'", "'joint_2'", "--joints")


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (lambda rows: rows[::-1], RemarkKind.ORDER),
        (lambda rows: rows[:100] + rows[98:], RemarkKind.REPEATED),
        (lambda rows: [*rows[:40], "# restarted", *rows[40:]], RemarkKind.SKIPPED),
    ],
    ids=["reversed", "repeated", "comment"],
)
def test_rows_are_repaired_like_those_of_wide_tables(change, kind, two_link, tmp_path):
    path = written(tmp_path / "long.csv", change(long_rows()))
    recording, _ = read_with_warnings(path, two_link)
    assert_motion(recording)
    assert remark_kinds(recording) == [kind]


def test_times_of_long_tables_may_be_dates_or_milliseconds(two_link, tmp_path):
    for clock in (
        lambda t: f"2025-03-30T10:00:{float(t):09.6f}",
        lambda t: str(1_700_000_000_000 + round(1000 * float(t))),
    ):
        rows = [row.split(",", 1) for row in long_rows()]
        path = written(tmp_path / "long.csv", [f"{clock(t)},{cells}" for t, cells in rows])
        recording, texts = read_with_warnings(path, two_link)
        assert_motion(recording)
        assert len(texts) == 1 and "its times" in texts[0]


def test_a_last_row_that_is_cut_short_is_left_out(two_link, tmp_path):
    path = written(tmp_path / "long.csv", long_rows())
    path.write_text(path.read_text()[:-25])
    recording, texts = read_with_warnings(path, two_link)
    assert len(recording) == 399
    assert "row 801, the last one, is cut short" in texts[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace("joint_2", "elbow"), ("no rows of joint 'joint_2'", "--joints")),
        (lambda text: text.replace("joint_", "1"), ("numbers 11, 12", "names of the joints")),
        (lambda text: text.replace("position", "position [deg]"), ("deg", "convert")),
        (lambda text: text.replace("time,", "clock,"), ("no column of time", "--columns t=COLUMN")),
        (lambda text: text + "4.0,joint_1\n", ("row 802", "2 cells instead of 5")),
        (lambda text: text + "4.0,joint_1,off,0,0\n", ("row 802", "off")),
        (lambda text: text + "4.0,joint_1,1e300,0,0\n", ("row 802", "1e+300")),
        (lambda text: text + text.partition("\n")[2], ("time goes back", "own file")),
        (lambda text: text.partition("\n")[0] + "\n", ("no",)),
    ],
)
def test_faulty_long_tables_are_refused(change, words, two_link, tmp_path):
    path = written(tmp_path / "long.csv", long_rows())
    path.write_text(change(path.read_text()))
    assert_refused(path, two_link, *words)


@pytest.mark.parametrize(
    "names",
    [
        ("value", "signal"),
        ("data", "key"),
        ("joint", "position"),
        ("motor", "pos"),
        ("q1", "q2"),
        ("joint_1_pos", "joint_2_pos"),
        ("present_position_1", "present_position_2"),
        ("position.joint_1", "position.joint_2"),
    ],
)
@pytest.mark.parametrize("header", ["{}.{}", "{}_{}"])
def test_a_table_with_all_positions_is_not_long(names, header, two_link, tmp_path):
    """Other columns are kept and ignored, whatever their names."""
    if header != "{}.{}" and names[0] not in ("value", "data", "joint", "motor"):
        pytest.skip("two columns of the same quantity by names of scripts")
    columns = two_joint_motion()
    named = {
        name if name == "t" else header.format(*name.split(".")): column
        for name, column in columns.items()
    }
    other = 7.0 + np.arange(400.0)
    path = tmp_path / "r.csv"
    table = np.column_stack([*named.values(), other, -other])
    lines = [",".join([*named, *names]), *(",".join(map(repr, row)) for row in table.tolist())]
    path.write_text("\n".join(lines))
    assert_motion(read_with_warnings(path, two_link)[0])


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("effort\n", "effort\n\n", 1),
        lambda text: text.replace("effort\n", "effort\n# recorded on Monday\n", 1),
        lambda text: text.replace("effort\n", "effort,note\n", 1).replace("\n", ",\n"),
    ],
)
def test_the_first_row_may_be_empty_or_incomplete(change, two_link, tmp_path):
    path = written(tmp_path / "long.csv", long_rows())
    path.write_text(change(path.read_text()))
    assert_motion(read_with_warnings(path, two_link)[0])


def test_other_units_in_a_column_are_refused(two_link, tmp_path):
    header, angle = "time,joint,signal,value,unit", "{0},{1},position,{2},"
    rows = [row.split(",")[:3] for row in long_rows()]
    for unit, is_refused in (("rad", False), ("deg", True)):
        lines = [angle.format(*row) + unit for row in rows]
        path = written(tmp_path / "long.csv", lines, header)
        if is_refused:
            assert_refused(path, two_link, "column 'unit' states deg", "convert")
        else:
            assert len(read_with_warnings(path, two_link)[0]) == 400


def test_joints_without_any_position_are_refused(two_link, tmp_path):
    rows = [f"{0.01 * k},joint_{1 + k % 2},nan,0,0" for k in range(800)]
    assert_refused(written(tmp_path / "long.csv", rows), two_link, "q.joint_1", "no number")


def test_the_column_of_time_can_be_named(two_link, tmp_path):
    path = written(tmp_path / "long.csv", long_rows(), HEADER.replace("time", "clock"))
    recording, _ = read_with_warnings(path, two_link, columns={"t": "clock"})
    assert_motion(recording)
