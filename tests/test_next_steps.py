"""After an export the user reads the start pose, the commands that run and record, and the next
one."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

from excite.cli import main as cli

FOLDER = Path(__file__).resolve().parents[1] / "trajectories"


def exported(robot: str, format: str, path: Path, *options: str) -> list[str]:
    """Return the next steps of an export of a stored trajectory."""
    source = str(FOLDER / f"{robot}.json")
    arguments = ["export", source, "--format", format, "-o", str(path), *options]
    assert cli.main([*arguments, "--json"]) == 0
    return arguments


@pytest.mark.parametrize(
    ("robot", "format", "words"),
    [
        ("ur5e", "ros2-follow-joint-trajectory", ["ros2 action send_goal", "ros2 bag record"]),
        ("ur5e", "ros2-joint-trajectory", ["ros2 topic pub", "ros2 bag record /joint_states"]),
        ("ur5e", "urscript", ["30002", "actual_q"]),
        ("fr3", "franka-csv", ["libfranka", "tau_J", "qref.<joint>"]),
    ],
)
def test_the_way_to_a_model_is_printed(robot, format, words, tmp_path, capsys):
    path = tmp_path / "motion"
    exported(robot, format, path)
    steps = json.loads(capsys.readouterr().out)["next_steps"]
    text = "\n".join(steps)
    assert steps[0].startswith("start pose [rad or m]: ")
    assert [step[0] for step in steps[1:]] == ["1", "2", "3", "4"]
    assert all(word in text for word in [*words, str(path), "--trajectory", "excite identify"])
    joint = json.loads((FOLDER / f"{robot}.json").read_text(encoding="utf-8"))["joints"][0]
    assert joint in steps[0]
    assert "partial" not in text  # no joint of these is locked


def test_the_identification_runs_as_printed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text("[joints.joint_1]\nvelocity = 2.0\n", encoding="utf-8")
    robot = ["--lock", "joint_2=-0.3", "--payload", "link_2:0.5,0.1,0,0.02", "--gravity=0,-9.81,0"]
    search = ["--starts", "1", "--iterations", "20", "--harmonics", "3", "--no-collision"]
    design = ["design", "two_link", *robot, "--limits", "mine.toml", *search, "-o", "out"]
    assert cli.main(design) == 0
    trajectory = "out/trajectory.json"
    assert cli.main(["simulate", "two_link", trajectory, "-o", "run1.csv"]) == 0
    capsys.readouterr()
    export = ["export", trajectory, "--format", "ros2-joint-trajectory", "-o", "motion.json"]
    assert cli.main([*export, "--json"]) == 0
    steps = json.loads(capsys.readouterr().out)["next_steps"]
    assert steps[0].endswith("; locked: joint_2 -0.3000")
    assert "the locked joint_2" in steps[3] and "allow_partial_joints_goal is true" in steps[3]
    words = shlex.split(steps[-1].partition("excite ")[2])
    for beginning in ("--lock=joint_2=-0.3", "--payload=link_2:0.5,0.1,0.0,0.02,", "--limits=/"):
        assert any(word.startswith(beginning) for word in words)
    assert cli.main(["run1.csv" if word == "run1" else word for word in words]) == 0
    stated = json.loads(Path(trajectory).read_text(encoding="utf-8"))["robot"]
    model = json.loads(Path("model/model.json").read_text(encoding="utf-8"))
    assert model["robot"]["gravity"] == stated["gravity"]


def test_formats_that_store_the_motion_need_no_steps(tmp_path, capsys):
    exported("ur5e", "csv", tmp_path / "motion.csv")
    assert json.loads(capsys.readouterr().out)["next_steps"] == []


def test_lead_and_tolerances_stand_in_the_goal(tmp_path, capsys):
    path = tmp_path / "goal.json"
    options = ["--lead", "8", "--path-tolerance", "0.2", "--goal-tolerance", "0.05"]
    exported("ur5e", "ros2-follow-joint-trajectory", path, *options)
    assert "within 8 s" in capsys.readouterr().out
    goal = json.loads(path.read_text(encoding="utf-8"))
    assert goal["trajectory"]["points"][0]["time_from_start"] == {"sec": 8, "nanosec": 0}
    assert [entry["name"] for entry in goal["path_tolerance"]] == goal["trajectory"]["joint_names"]
    assert goal["path_tolerance"][0]["position"] == 0.2
    assert goal["goal_tolerance"][-1] == {
        **{"name": goal["trajectory"]["joint_names"][-1], "position": 0.05},
        **{"velocity": 0.0, "acceleration": 0.0},
    }
