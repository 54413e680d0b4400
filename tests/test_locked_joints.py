"""Recordings with positions of joints that are locked."""

from __future__ import annotations

import numpy as np
import pytest
from recording_fixtures import assert_refused, two_joint_motion, write_columns

from excite import recordings
from excite.cli.main import main
from excite.errors import UnusableInput
from excite.recordings import RemarkKind
from excite.robot.robot import load


def with_locked_joint(path, positions):
    """Write a recording of both joints in which the first has given positions."""
    columns = two_joint_motion()
    columns["q.joint_1"] = np.broadcast_to(positions, len(columns["t"])).astype(float)
    return write_columns(path, columns)


@pytest.mark.parametrize("form", ["csv", "npz", "PlotJuggler", "lists"])
def test_locked_joint_that_stands_elsewhere_is_refused_with_its_position(form, tmp_path):
    robot = load("two_link", joints=("joint_2",), lock={"joint_1": 0.25})
    path = with_locked_joint(tmp_path / "r.csv", 1.0)
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    names = path.read_text().splitlines()[0].split(",")
    if form == "npz":
        path = tmp_path / "r.npz"
        np.savez(path, **dict(zip(names, rows.T, strict=True)))
    elif form == "PlotJuggler":
        topic = {f"q.joint_{k}": f"/joint_states/joint_{k}/position" for k in (1, 2)}
        columns = {topic.get(name, name): rows[:, k] for k, name in enumerate(names)}
        write_columns(path, {"__time": columns.pop("t"), **columns})
    elif form == "lists":
        lines = [f'{t},"[joint_2, joint_1]","[{q}, {p}]"' for t, p, q in rows[:, :3]]
        path.write_text("\n".join(["time,name,position", *lines]))
    text = assert_refused(path, robot, "joint 'joint_1' is locked at 0.25 rad", "stands at 1 rad")
    assert text.endswith("--lock joint_1=1")
    with pytest.raises(UnusableInput, match="--lock joint_1=1"):
        list(recordings.stream(path, robot, rows=256))
    machine = load("two_link", joints=("joint_2",), lock={"joint_1": 1.0})
    assert not recordings.read(path, machine).doubts


def test_numbered_columns_of_all_joints_keep_their_numbers_where_joints_are_locked(tmp_path):
    columns = two_joint_motion()
    names = {f"{kind}.joint_{k}": f"{kind}{k}" for kind in ("q", "tau") for k in (1, 2)}
    columns["q.joint_1"] = np.full(len(columns["t"]), 1.0)
    path = write_columns(tmp_path / "r.csv", {names.get(n, n): x for n, x in columns.items()})
    robot = load("two_link", joints=("joint_2",), lock={"joint_1": 1.0})
    with pytest.warns(match="numbered"):
        recording = recordings.read(path, robot)
    np.testing.assert_allclose(recording.q[:, 0], columns["q.joint_2"], atol=1e-6)
    np.testing.assert_allclose(recording.torque[:, 0], columns["tau.joint_2"], atol=1e-6)


def test_whole_turns_of_a_locked_joint_are_no_difference(tmp_path):
    robot = load("two_link", joints=("joint_2",), lock={"joint_1": 1.0})
    path = with_locked_joint(tmp_path / "r.csv", 1.0 - 2.0 * np.pi)
    assert not recordings.read(path, robot).doubts


def test_finger_of_little_mass_may_stand_anywhere(tmp_path):
    urdf = tmp_path / "gripper.urdf"
    inertia = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
    urdf.write_text(
        '<robot name="gripper"><link name="base"/>'
        f'<link name="arm"><inertial><mass value="4"/>{inertia}</inertial></link>'
        f'<link name="tip"><inertial><mass value="0.02"/>{inertia}</inertial></link>'
        '<joint name="joint_2" type="revolute"><parent link="base"/><child link="arm"/>'
        '<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="3" effort="90"/></joint>'
        '<joint name="joint_1" type="prismatic"><parent link="arm"/><child link="tip"/>'
        '<axis xyz="0 1 0"/><limit lower="0" upper="1" velocity="1" effort="9"/></joint></robot>'
    )
    robot = load(str(urdf), joints=("joint_2",))
    assert not recordings.read(with_locked_joint(tmp_path / "open.csv", 0.04), robot).doubts
    assert_refused(with_locked_joint(tmp_path / "far.csv", 1.4), robot, "--lock joint_1=1.4")


def test_locked_joint_that_moves_is_a_doubt(tmp_path, capsys):
    path = with_locked_joint(tmp_path / "r.csv", two_joint_motion()["q.joint_1"])
    doubt = recordings.read(path, load("two_link", joints=("joint_2",))).doubts
    assert [remark.kind for remark in doubt] == [RemarkKind.LOCKED]
    assert "moves from -0.4994 to 0.4998 rad" in doubt[0].text and "--joints" in doubt[0].text
    assert main(["identify", "two_link", str(path), "--joints=joint_2", f"-o{tmp_path}/m"]) == 0
    assert "joint 'joint_1' is locked at 0 rad, but moves" in capsys.readouterr().err
    assert main(["predict", f"{tmp_path}/m/model.json", str(path), f"-o{tmp_path}/p.csv"]) == 0
    assert "joint 'joint_1' is locked at 0 rad, but moves" in capsys.readouterr().err


def test_model_predicts_no_recording_with_its_locked_joint_elsewhere(tmp_path, capsys):
    noise = 1e-4 * np.random.default_rng(0).normal(size=400)
    path = with_locked_joint(tmp_path / "r.csv", 1.0 + noise)
    folder = tmp_path / "m"
    options = ["--joints=joint_2", "--lock=joint_1=1", "-o", str(folder)]
    assert main(["identify", "two_link", str(path), *options]) == 0
    model = str(folder / "model.json")
    assert main(["predict", model, str(path), f"-o{tmp_path}/p.csv"]) == 0
    other = with_locked_joint(tmp_path / "other.csv", 0.0)
    capsys.readouterr()
    assert main(["predict", model, str(other), f"-o{tmp_path}/p.csv"]) == 2
    error = capsys.readouterr().err
    assert "other.csv: joint 'joint_1' is locked at 1 rad, but stands at 0 rad" in error
