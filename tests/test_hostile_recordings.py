"""Damaged, implausible and malicious recordings are read or refused in one line by column and
row."""

from __future__ import annotations

import bz2
import gzip
import io
import json
import lzma
import os
import pickle
import re
import struct
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recording_fixtures import assert_refused, two_joint_motion, write_columns
from shared_inputs import INPUTS, needs_inputs

from excite import recordings
from excite._types import FloatArray
from excite.cli import main as cli
from excite.errors import ExciteWarning, UnusableInput
from excite.identification import torque_check
from excite.recordings import RemarkKind
from excite.robot.limits import resolve
from excite.robot.robot import Robot, locate


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def csv(columns: dict[str, FloatArray] | None = None) -> bytes:
    columns = columns or two_joint_motion()
    lines = [",".join(columns)]
    lines += [
        ",".join(repr(float(values[k])) for values in columns.values())
        for k in range(len(columns["t"]))
    ]
    return ("\n".join(lines) + "\n").encode()


# -- the shared inputs -----------------------------------------------------------------------------


@needs_inputs
@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("r_tau_zero", ["torque of every joint is 0", "6221 rows"]),
        ("r_one_cell_1e308", ["row 1002", "tau.joint_1", "1e+308"]),
        ("r_cr_only", ["row 1", "carriage return"]),
        ("r_t_tiny", ["time step", "2e-12 s"]),
        ("r_tau_1e200", ["row 2", "tau.joint_1", "1e+200"]),
    ],
)
def test_faulty_recording_is_refused_with_its_fault(name, parts, tmp_path, capsys):
    assert (
        cli.main(["identify", "two_link", str(INPUTS / f"{name}.csv"), "-o", str(tmp_path / "out")])
        == 2
    )
    out, err = capsys.readouterr()
    lines = [line for line in err.splitlines() if line.startswith("excite:")]
    assert out == "" and len(lines) == 1 and all(part in lines[0] for part in (name, *parts)), err
    assert not (tmp_path / "out").exists()


@needs_inputs
@pytest.mark.parametrize(
    ("name", "parts"),
    [
        (
            "r_tau_million",
            ["joint_1", "7.808e+05 times its limit 60", "joint_2", "3.711e+05 times its limit 20"],
        ),
        ("r_tau1_zero", ["joint_1", "torque is 0 in all 6221 rows"]),
    ],
)
def test_doubtful_torque_is_warned_of_with_its_value(name, parts, tmp_path, capsys):
    assert (
        cli.main(["identify", "two_link", str(INPUTS / f"{name}.csv"), "-o", str(tmp_path / "out")])
        == 0
    )
    out, err = capsys.readouterr()
    warned = " ".join(line for line in err.splitlines() if line.startswith("warning:"))
    assert all(part in warned for part in parts), err
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert all(part.split("+")[0] in report for part in parts)
    for text in (out, report):
        assert (
            ">inf<" not in text
            and ">nan<" not in text
            and "inf%" not in text
            and "inf floors" not in text
        )


@needs_inputs
@pytest.mark.parametrize("name", ["good", "good2"])
def test_clean_recording_gets_no_remark(name, two_link):
    with warnings.catch_warnings():
        warnings.simplefilter("error", ExciteWarning)
        recording = recordings.read(INPUTS / f"{name}.csv", two_link)
        assert (
            torque_check.check_torque(recording, two_link, resolve(two_link)).remarks
            == recording.remarks
        )


# -- CSV -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("column", ["q.joint_1", "dq.joint_2", "tau.joint_1"])
@pytest.mark.parametrize("value", [1e13, -1e200, 1e308])
def test_implausible_number_is_named_by_column_and_row(column, value, two_link, tmp_path):
    columns = two_joint_motion()
    columns[column][[17, 30]] = value
    assert_refused(
        write_columns(tmp_path / "r.csv", columns),
        two_link,
        "row 19",
        f"column {column}",
        f"{value:g}",
    )


@pytest.mark.parametrize(("value", "part"), [(1e25, "row 9, column t"), (1e308, "row 9, column t")])
def test_implausible_time_is_named_by_row(value, part, two_link, tmp_path):
    columns = two_joint_motion()
    columns["t"][7] = value
    assert_refused(write_columns(tmp_path / "r.csv", columns), two_link, part)


@pytest.mark.parametrize(
    ("factor", "part"),
    [
        (1e-12, "more than a million rows a second"),
        (1e3, "is time in ms"),
        (50.0, "is time in ms"),  # of 2 kHz
        (0.0, "rows"),
        (-1.0, "rows"),
        (1e30, "column t"),
    ],
)
def test_clocks_in_other_units_are_detected(factor, part, two_link, tmp_path):
    columns = two_joint_motion()
    columns["t"] = columns["t"] * factor
    if factor == -1.0:  # backwards: rows are sorted
        with pytest.warns(ExciteWarning, match="out of order"):
            recording = recordings.read(write_columns(tmp_path / "r.csv", columns), two_link)
        assert len(recording) == 400
        return
    assert_refused(write_columns(tmp_path / "r.csv", columns), two_link, part)


HEADER = b"t,q.joint_1,q.joint_2\n"
ROWS = b"".join(b"%f,%f,%f\n" % (k / 100, k / 50, k / 70) for k in range(40))


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (csv().replace(b"\n", b"\r"), ["row 1", "carriage return"]),
        (csv().decode().encode("utf-16")[:-1], ["UTF-8"]),
        (b"\x00" + csv(), ["no column 't'"]),
        (HEADER + ROWS.replace(b"0.5", b"0.\x00"), ["row"]),
        (HEADER + ROWS.replace(b"0.5", b'"0.5'), ["row"]),
        (b'"t,q.joint_1,q.joint_2\n' + ROWS, ["column"]),
        (b"\xff" + HEADER + ROWS, ["UTF-8"]),
        (HEADER + ROWS + b"\xff\xfe\n", ["row"]),
        (HEADER, ["no rows"]),
        (HEADER + ROWS[:20], ["1 row "]),
        (HEADER + b"1,2\n" + ROWS, ["row 2", "2 cells instead of 3"]),
        (HEADER + ROWS + b"1,2,3,4\n", ["row 42", "4 cells instead of 3"]),
        (HEADER + ROWS + b"1,2,off\n", ["row 42"]),
        (HEADER + ROWS + b"1,2,1e\n", ["row 42"]),
        (HEADER + ROWS + b"1,2,0x1F\n", ["row 42"]),
        (HEADER.replace(b"joint_2", b"joint_1") + ROWS, ["q.joint_1", "twice"]),
        (b"," * 3000 + b"\n" + ROWS, ["no column 't'"]),
        (b"t" * (1 << 21), ["row 1 is longer"]),
        (HEADER + ROWS + b"1" * (1 << 24), ["longer than"]),
        (b"\n\n\n", ["no column 't'"]),
        (b"", ["no column 't'"]),
    ],
)
def test_text_that_is_no_table_is_refused(content, parts, two_link, tmp_path):
    assert_refused(written(tmp_path / "r.csv", content), two_link, *parts)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: b"\xef\xbb\xbf" + text,
        lambda text: text.replace(b"\n", b"\r\n"),
        lambda text: text.replace(b",", b";"),
        lambda text: text.replace(b",", b"\t"),
        lambda text: b"# " + text,
        lambda text: text + b"\n\n\n",
        lambda text: text[:-1],
        lambda text: text.decode().encode("utf-16"),
        lambda text: text.decode().encode("utf-32"),
        gzip.compress,
        bz2.compress,
        lzma.compress,
    ],
)
def test_tables_of_other_programs_are_read(change, two_link, tmp_path):
    plain = recordings.read(written(tmp_path / "a.csv", csv()), two_link)
    again = recordings.read(written(tmp_path / "b.csv", change(csv())), two_link)
    assert np.array_equal(plain.q, again.q) and np.array_equal(plain.tau, again.tau)


@pytest.mark.parametrize(
    "cell", ["-", "--", "?", "missing", "N/A", '""', "nan", "1.#QNAN", "-nan(ind)"]
)
def test_cells_without_a_measurement_are_missing_values(cell, two_link, tmp_path):
    lines = csv().decode().split("\n")
    cells = lines[50].split(",")
    lines[50] = ",".join([*cells[:-1], cell])
    path = written(tmp_path / "r.csv", "\n".join(lines).encode())
    with pytest.warns(ExciteWarning, match="1 missing value of tau, 1 interpolated"):
        assert len(recordings.read(path, two_link)) == 400


@pytest.mark.parametrize(
    ("name", "head", "parts"),
    [
        ("r.parquet", b"PAR1", ["Parquet", "read_parquet", "to_csv"]),
        ("r.feather", b"ARROW1\x00\x00", ["Feather", "read_feather"]),
        ("r.xlsx", b"PK\x03\x04", ["spreadsheet", "CSV"]),
        ("r.mat", b"MATLAB 5.0 MAT-file", ["MAT-file", "writetable"]),
        ("r.h5", b"\x89HDF\r\n", ["HDF5", "CSV"]),
        ("r.npy", b"\x93NUMPY\x01\x00", ["savez"]),
        ("r.jsonl", b'{"t": 0.0, "q.joint_1": 0.1}\n', ["JSON", "CSV"]),
    ],
)
def test_files_of_other_formats_are_refused_by_their_name(name, head, parts, two_link, tmp_path):
    assert_refused(written(tmp_path / name, head + bytes(100)), two_link, *parts)


def test_two_rows_of_names_are_refused(two_link, tmp_path):
    text = csv().decode()
    first = text.partition("\n")[0]
    upper = ",".join(name.partition(".")[0] for name in first.split(","))
    lower = ",".join(name.partition(".")[2] for name in first.split(","))
    path = written(tmp_path / "r.csv", text.replace(first, f"{upper}\n{lower}").encode())
    assert_refused(path, two_link, "row 2", "names and no numbers", "join")


def test_decimal_commas_in_quotes_are_named(two_link, tmp_path):
    lines = csv().decode().split("\n")
    quoted = [",".join(f'"{c}"'.replace(".", ",") for c in line.split(",")) for line in lines[1:-1]]
    path = written(tmp_path / "r.csv", "\n".join([lines[0], *quoted]).encode())
    assert_refused(path, two_link, "row 2", "decimal point")


def test_an_archive_with_other_names_gets_a_remedy_for_archives(two_link, tmp_path):
    path = tmp_path / "r.npz"
    np.savez(path, time=np.arange(9.0), position=np.zeros((9, 2)))
    line = assert_refused(path, two_link, "'t'", "save t and q.<joint>")
    assert "--columns" not in line


def test_a_compressed_table_has_its_sidecar_and_must_be_complete(two_link, tmp_path):
    content = gzip.compress(csv())
    (tmp_path / "run.json").write_text('{"schema": "excite.recording/1", "notes": "warm"}')
    recording = recordings.read(written(tmp_path / "run.csv.gz", content), two_link)
    assert recording.sidecar.notes == "warm"
    for damaged in (content[:-100], content[:50] + bytes(20) + content[70:]):
        path = written(tmp_path / "cut.csv.gz", damaged)
        assert_refused(path, two_link, "cannot be decompressed")


@pytest.mark.parametrize("kind", ["folder", "fifo", "absent", "long name"])
def test_paths_without_a_file_are_refused(kind, two_link, tmp_path):
    path = tmp_path / ("r.csv" if kind != "long name" else "r" * 3000 + ".csv")
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    with pytest.raises(UnusableInput) as caught:
        recordings.read(path, two_link)
    assert "\n" not in str(caught.value)


# -- torque ----------------------------------------------------------------------------------------


def torque_warnings(
    columns: dict[str, FloatArray], robot, folder: Path
) -> tuple[list[str], list[RemarkKind]]:
    """Return the warnings and the kinds of remarks of the torque check."""
    recording = recordings.read(write_columns(folder / "r.csv", columns), robot)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        checked = torque_check.check_torque(recording, robot, resolve(robot))
    return [str(w.message) for w in caught], [
        remark.kind for remark in checked.remarks[len(recording.remarks) :]
    ]


@pytest.fixture
def torque_columns(two_link) -> dict[str, FloatArray]:
    """Columns of a motion with the torque that the two-link robot needs for it."""
    from excite.robot import dynamics, inertial_parameters
    from excite.robot.samples import Samples

    columns = two_joint_motion()
    q, dq = (
        np.column_stack([columns[f"{kind}.joint_{k}"] for k in (1, 2)]) for kind in ("q", "dq")
    )
    ddq = -np.array([4.0, 9.0]) * q
    torque = dynamics.torque(
        two_link,
        inertial_parameters.standard_parameters(two_link, resolve(two_link)),
        Samples(q, dq, ddq),
    )
    for k in (0, 1):
        columns[f"tau.joint_{k + 1}"] = torque[:, k]
    return columns


def test_correct_torque_gets_no_remark(torque_columns, two_link, tmp_path):
    assert torque_warnings(torque_columns, two_link, tmp_path) == ([], [])


@pytest.mark.parametrize("joint", ["joint_1", "joint_2"])
@pytest.mark.parametrize(
    ("factor", "kinds", "part"),
    [
        (-1.0, [RemarkKind.TORQUE_SIGN], "correlation of -1.00"),
        (1e3, [RemarkKind.UNIT, RemarkKind.TORQUE_SCALE], "times"),
        (0.0, [RemarkKind.FROZEN], "torque is 0 in all"),
        (0.5, [], ""),
        (2.0, [], ""),
    ],
)
def test_wrong_torque_of_a_joint_is_remarked_there(
    joint, factor, kinds, part, torque_columns, two_link, tmp_path
):
    torque_columns[f"tau.{joint}"] = torque_columns[f"tau.{joint}"] * factor
    texts, found_kinds = torque_warnings(torque_columns, two_link, tmp_path)
    assert found_kinds == kinds
    assert all(joint in text and part in text for text in texts)


def test_a_torque_limit_that_cannot_hold_the_robot_is_no_doubt_about_its_torque(
    torque_columns, two_link, tmp_path, capsys
):
    robot, limits = tmp_path / "robot.urdf", tmp_path / "limits.toml"
    robot.write_text(re.sub('effort="[^"]*"', 'effort="0.1"', locate("two_link").read_text()))
    path = write_columns(tmp_path / "r.csv", torque_columns)
    arguments = ["identify", str(robot), str(path), "-o", str(tmp_path / "out")]
    assert cli.main(arguments) == 0
    out, err = capsys.readouterr()
    shown = [line for line in err.splitlines() if "torque limit" in line]
    assert len(shown) == 1 and "do not use this model" not in out
    parts = ["'joint_1', 'joint_2'", "limit of 0.1", "gravity needs", f"correct it in {robot}"]
    assert all(part in shown[0] for part in (*parts, "--limits FILE"))
    limits.write_text("[joints.joint_1]\ntorque = 60\n[joints.joint_2]\ntorque = 0.2\n")
    assert cli.main([*arguments, "--limits", str(limits)]) == 0
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "torque limit" in line]
    assert f"correct it in {limits}" in line and "'joint_1'" not in line
    for joint in ("joint_1", "joint_2"):  # beyond what any robot of that size needs
        torque_columns[f"tau.{joint}"] *= 1e3
    write_columns(path, torque_columns)
    assert cli.main(arguments) == 0
    out, err = capsys.readouterr()
    assert "times its limit 0.1; check its unit" in err and "do not use this model" in out


@pytest.mark.parametrize("flicker", [0.0, 1e-3])
def test_a_joint_at_rest_may_have_no_torque(flicker, torque_columns, two_link, tmp_path):
    torque_columns["q.joint_2"] = np.full(len(torque_columns["t"]), 0.3)
    torque_columns["q.joint_2"][100:110] += flicker
    torque_columns["dq.joint_2"] = torque_columns["tau.joint_2"] = 0.0 * torque_columns["t"]
    recording = recordings.read(write_columns(tmp_path / "r.csv", torque_columns), two_link)
    with pytest.warns(ExciteWarning, match="torque is 0 in all .*; the joint is at rest"):
        checked = torque_check.check_torque(recording, two_link, resolve(two_link))
    assert RemarkKind.FROZEN not in [remark.kind for remark in checked.doubts]


@pytest.mark.parametrize("value", [0.0, 1.234])
@pytest.mark.parametrize("rows", [slice(0, 200), slice(150, 400)])
def test_torque_that_is_frozen_while_the_joint_reverses_is_doubted(
    value, rows, torque_columns, two_link, tmp_path, capsys
):
    torque_columns["tau.joint_2"][rows] = value
    path = write_columns(tmp_path / "r.csv", torque_columns)
    doubts = recordings.read(path, two_link).doubts
    assert [(doubt.kind, doubt.joint) for doubt in doubts] == [(RemarkKind.FROZEN, "joint_2")]
    cli.main(["identify", "two_link", str(path), "-o", str(tmp_path / "out")])
    assert "joint 'joint_2': tau is constant from" in capsys.readouterr().err


def test_torque_that_may_be_constant_is_not_doubted(torque_columns, two_link, tmp_path):
    """That of a short time, of a motion in one direction, of a coarse resolution, of no drive."""
    torque = torque_columns["tau.joint_2"].copy()
    for rows, step in ((slice(100, 130), 0.0), (slice(60, 100), 0.0), (slice(0, 400), 4.0)):
        changed = np.round(torque / step) * step if step else torque.copy()
        changed[rows] = changed[rows] if step else 0.5
        path = write_columns(tmp_path / "r.csv", {**torque_columns, "tau.joint_2": changed})
        assert not recordings.read(path, two_link).doubts
    columns = {**torque_columns, "tau.joint_2": torque, "qref.joint_2": torque_columns["q.joint_2"]}
    path = tmp_path / "r.csv"
    torque[200:] = 0.0
    assert recordings.read(write_columns(path, columns), two_link).doubts
    columns["qref.joint_2"] = np.where(np.arange(400) < 200, columns["qref.joint_2"], 0.0)
    assert not recordings.read(write_columns(path, columns), two_link).doubts


@pytest.mark.parametrize("value", [0.0, 3.3])
def test_torque_of_one_repeated_value_is_warned_of(
    value, torque_columns, two_link, tmp_path, capsys
):
    """Five stretches of 6 rows; also of 0 where all other torque is positive."""
    assert torque_columns["tau.joint_2"].min() > 0.0
    for start in range(30, 330, 60):
        torque_columns["tau.joint_2"][start : start + 6] = value
    path = write_columns(tmp_path / "r.csv", torque_columns)
    cli.main(["identify", "two_link", str(path), "-o", str(tmp_path / "out")])
    text = f"joint 'joint_2': tau is {value:g} N m in 30 rows of its motion"
    err = capsys.readouterr().err
    assert text in err and "no other value in more than 1;" in err
    assert not recordings.read(path, two_link).doubts
    for name, values in torque_columns.items():  # at rest, any torque is constant
        torque_columns[name] = np.concatenate([values, np.full(400, values[-1])])
    torque_columns["t"] = 0.01 * np.arange(800)
    torque_columns["tau.joint_1"][400:] = 0.5
    path = write_columns(tmp_path / "r.csv", torque_columns)
    remarks = recordings.read(path, two_link).remarks
    repeated = [r for r in remarks if r.kind is RemarkKind.REPEATED_TORQUE]
    assert [r.joint for r in repeated] == ["joint_2"] and "30 rows" in repeated[0].text


def repeated_torque(columns, robot: Robot, path: Path) -> list[str | None]:
    """Return the joints whose torque is remarked for one repeated value."""
    remarks = recordings.read(write_columns(path, columns), robot).remarks
    return [r.joint for r in remarks if r.kind is RemarkKind.REPEATED_TORQUE]


def test_torque_that_is_off_every_other_row_is_warned_of(torque_columns, two_link, tmp_path):
    torque_columns["tau.joint_2"][::2] = 0.0
    assert repeated_torque(torque_columns, two_link, tmp_path / "r.csv") == ["joint_2"]
    for joint in ("joint_1", "joint_2"):  # commanded to move as it does
        torque_columns[f"qref.{joint}"] = torque_columns[f"q.{joint}"] + 1e-4
    assert repeated_torque(torque_columns, two_link, tmp_path / "r.csv") == ["joint_2"]
    torque_columns["qref.joint_2"][:] = 0.3  # commanded to stand: the drive may be off
    assert repeated_torque(torque_columns, two_link, tmp_path / "r.csv") == []


def test_repeated_torque_of_a_joint_at_rest_is_not_remarked(torque_columns, two_link, tmp_path):
    rng = np.random.default_rng(0)
    torque_columns["q.joint_2"] = 0.3 + 2e-5 * rng.normal(size=400)
    torque_columns["tau.joint_2"][:40] = 0.5
    assert repeated_torque(torque_columns, two_link, tmp_path / "r.csv") == []


@pytest.mark.parametrize("distinct", [8, 30, 300])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_torque_that_resolution_repeats_is_not_remarked(
    distinct, noise, torque_columns, two_link, tmp_path
):
    torque = torque_columns["tau.joint_2"]
    step = np.ptp(torque) / distinct
    noisy = torque + noise * np.ptp(torque) * np.random.default_rng(0).normal(size=400)
    torque_columns["tau.joint_2"] = np.round(noisy / step) * step
    path = write_columns(tmp_path / "r.csv", torque_columns)
    kinds = {remark.kind for remark in recordings.read(path, two_link).remarks}
    assert RemarkKind.REPEATED_TORQUE not in kinds


@pytest.mark.parametrize(("value", "word"), [(0.0, "0"), (3.5, "constant")])
def test_recording_without_torque_is_refused(value, word, torque_columns, two_link, tmp_path):
    for joint in ("joint_1", "joint_2"):
        torque_columns[f"tau.{joint}"] = np.full(400, value)
    recording = recordings.read(write_columns(tmp_path / "r.csv", torque_columns), two_link)
    with pytest.raises(UnusableInput, match=f"every joint is {word} in all 400 rows"):
        torque_check.check_torque(recording, two_link, resolve(two_link))


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--period", "0.05"], "fewer than 16 rows"),
        (["--period", "1000"], "shorter than the recording"),
        (["--period", "1", "--window", "50,60"], "no row"),
        (["--window", "0,1"], "needs --period"),
    ],
)
def test_period_must_fit_the_recording(options, part, torque_columns, tmp_path, capsys):
    path = write_columns(tmp_path / "r.csv", torque_columns)
    assert cli.main(["identify", "two_link", str(path), "-o", str(tmp_path / "out"), *options]) == 2
    err = capsys.readouterr().err
    assert part in err and not (tmp_path / "out").exists()


@pytest.mark.parametrize("period", [0.02, 1e-3])
def test_period_of_a_sidecar_must_have_rows(period, torque_columns, two_link, tmp_path):
    path = write_columns(tmp_path / "r.csv", torque_columns)
    path.with_suffix(".json").write_text(
        json.dumps({"schema": "excite.recording/1", "period": period})
    )
    with pytest.raises(UnusableInput, match=r"r\.json"):
        recordings.read(path, two_link)


# -- archives --------------------------------------------------------------------------------------


class FileCreator:
    """An object whose pickle creates a file when it is torque_columns."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str, str]]:
        return open, (str(self.path), "w")


def archive(**arrays: FloatArray) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def valid_arrays() -> dict[str, FloatArray]:
    columns = two_joint_motion()
    q = np.column_stack([columns["q.joint_1"], columns["q.joint_2"]])
    return {"t": columns["t"], "joints": np.array(["joint_1", "joint_2"]), "q": q, "tau": 0.1 * q}


def archive_with_member(name: str, header: bytes, data: bytes = b"") -> bytes:
    """Return a valid archive, except for the header and the data of one array."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        for key, value in valid_arrays().items():
            plain = io.BytesIO()
            np.lib.format.write_array(plain, value)
            content = plain.getvalue()
            if key == name:
                padded = header.ljust(117) + b"\n"
                content = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(padded)) + padded + data
            file.writestr(f"{key}.npy", content)
    return stream.getvalue()


def npy_header(shape: str, kind: str = "<f8") -> bytes:
    return f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()


@pytest.mark.parametrize("name", ["t", "q", "tau", "joints"])
def test_pickled_objects_are_not_loaded(name, two_link, tmp_path):
    created = tmp_path / "loaded"
    content = archive_with_member(
        name,
        npy_header("(400,)" if name == "t" else "(400, 2)", "|O"),
        pickle.dumps(FileCreator(created)),
    )
    assert_refused(written(tmp_path / "r.npz", content), two_link, f"'{name}'", "Python objects")
    assert not created.exists()


@pytest.mark.parametrize(
    ("shape", "kind"),
    [
        ("(10000000000000,)", "<f8"),
        ("(-400,)", "<f8"),
        ("(400, 2, 9999999)", "<f8"),
        ("(99999999999999999999999,)", "<f8"),
        ("()", "<f8"),
        ("(400,)", "<U1000000000"),
        ("(True,)", "<f8"),
        ("400", "<f8"),
        ("(400,)", "what"),
    ],
)
@pytest.mark.parametrize("name", ["t", "joints"])
def test_headers_that_claim_more_than_the_file_are_refused(name, shape, kind, two_link, tmp_path):
    assert_refused(
        written(
            tmp_path / "r.npz", archive_with_member(name, npy_header(shape, kind), b"\x00" * 800)
        ),
        two_link,
        "r.npz",
    )


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"PK\x03\x04",
        archive(**valid_arrays())[:500],
        archive(**valid_arrays())[:-30],
        archive(**valid_arrays())[30:],
        archive(**valid_arrays()).replace(b"NUMPY", b"NUMPX"),
        archive(**{**valid_arrays(), "t": np.array([])}),
        archive(**{key: value for key, value in valid_arrays().items() if key != "joints"}),
        archive(x=np.zeros(3)),
        archive(**{**valid_arrays(), "q": valid_arrays()["q"].astype("U8")}),
        archive(**{**valid_arrays(), "joints": np.array([1, 2])}),
    ],
)
def test_damaged_archives_are_refused(content, two_link, tmp_path):
    with pytest.raises(UnusableInput) as caught:
        recordings.read(written(tmp_path / "r.npz", content), two_link)
    assert "r.npz" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("damage", range(60))
def test_archives_with_other_bytes_are_read_or_refused(damage, two_link, tmp_path):
    rng, content = np.random.default_rng(damage), bytearray(archive(**valid_arrays()))
    for place in rng.integers(0, len(content), 1 + damage // 10):
        content[place] = rng.integers(256)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExciteWarning)
            recording = recordings.read(written(tmp_path / "r.npz", bytes(content)), two_link)
    except UnusableInput as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(recording.q).all()


# -- bags ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["mcap", "sqlite3"])
def bag(request, tmp_path_factory) -> dict[str, bytes]:
    """Files of a rosbag2 folder, by name."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    plugin = StoragePlugin.MCAP if request.param == "mcap" else StoragePlugin.SQLITE3
    folder = tmp_path_factory.mktemp("bag") / "run"
    columns = two_joint_motion(rows=100)
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        topic = writer.add_connection(
            "/joint_states", "sensor_msgs/msg/JointState", typestore=store
        )
        for k, t in enumerate(columns["t"]):
            stamp = types["builtin_interfaces/msg/Time"](sec=1, nanosec=int(1e9 * t) % 10**9)
            message = types["sensor_msgs/msg/JointState"](
                header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
                name=["joint_1", "joint_2"],
                position=np.array([columns["q.joint_1"][k], columns["q.joint_2"][k]]),
                velocity=np.array([]),
                effort=np.array([columns["tau.joint_1"][k], columns["tau.joint_2"][k]]),
            )
            writer.write(
                topic, int(1e9 * (1.0 + t)), store.serialize_cdr(message, message.__msgtype__)
            )
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("damage", range(40))
def test_damaged_bags_are_read_or_refused(damage, bag, two_link, tmp_path):
    rng, folder = np.random.default_rng(damage), tmp_path / "run"
    folder.mkdir()
    damaged_file = sorted(bag)[damage % len(bag)]
    for name, content in bag.items():
        data = bytearray(content)
        if name == damaged_file:
            if damage % 4 == 0:
                data = data[: rng.integers(len(data))]
            else:
                for place in rng.integers(0, len(data), int(rng.choice([1, 5, 200]))):
                    data[place] = rng.integers(256)
        (folder / name).write_bytes(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExciteWarning)
            recording = recordings.read(folder, two_link)
    except UnusableInput as error:
        assert "\n" not in str(error) and "run" in str(error)
    else:
        assert np.isfinite(recording.q).all()


@pytest.mark.parametrize("name", ["r.mcap", "r.db3", "r.bag"])
@pytest.mark.parametrize(
    "content", [b"", b"\x89MCAP0\r\n", b"SQLite format 3\x00", b"#ROSBAG V2.0\n", b"\x00" * 4096]
)
def test_files_that_only_begin_like_bags_are_refused(name, content, two_link, tmp_path):
    pytest.importorskip("rosbags")
    with pytest.raises(UnusableInput) as caught:
        recordings.read(written(tmp_path / name, content), two_link)
    assert "\n" not in str(caught.value)
