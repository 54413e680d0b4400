"""`excite simulate` as a person uses it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from excite import recordings
from excite.cli.main import main
from excite.robot.robot import load
from excite.simulator.effects import KINDS
from excite.simulator.experiment import Setting

TRAJECTORY = Path(__file__).parents[1] / "trajectories" / "two_link.json"


def simulate(*arguments: str) -> list[str]:
    return ["simulate", "two_link", str(TRAJECTORY), "--periods", "1", *arguments]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated")
    assert (
        main(
            simulate(
                "--effect",
                "load_friction:joint_2:mu=0.2",
                "--seed",
                "4",
                "-o",
                str(folder / "rec.csv"),
            )
        )
        == 0
    )
    return folder


def test_one_command_gives_a_recording_its_sidecar_its_truth_and_a_plot(folder):
    assert {p.name for p in folder.iterdir()} == {
        "rec.csv",
        "rec.json",
        "rec.truth.json",
        "rec.svg",
    }
    header = (folder / "rec.csv").read_text().split("\n", 1)[0]
    assert header == "t," + ",".join(
        f"{kind}.joint_{i}" for kind in ("q", "tau", "qref") for i in (1, 2)
    )
    sidecar = json.loads((folder / "rec.json").read_text())
    assert sidecar["schema"] == "excite.recording/1" and sidecar["motor_side"] is True
    assert sidecar["periodic"][1] - sidecar["periodic"][0] <= sidecar["period"]
    truth = json.loads((folder / "rec.truth.json").read_text())
    assert truth["schema"] == "excite.truth/1" and truth["seed"] == 4
    effect = truth["effects"][0]
    assert (effect["effect"], effect["joint"], effect["parameters"]["mu"]) == (
        "load_friction",
        "joint_2",
        {"value": 0.2, "unit": "1"},
    )
    assert truth["severity"]["joint_2"] > 5 * truth["severity"]["joint_1"]
    assert truth["severity_trusted"]["joint_2"] > truth["severity"]["joint_2"]
    assert (
        "load_friction" in (folder / "rec.svg").read_text()
        and 'xmlns="http://www.w3.org/2000/svg"' in (folder / "rec.svg").read_text()
    )


def test_the_rest_of_excite_reads_it(folder):
    recording = recordings.read(folder / "rec.csv", load("two_link"))
    assert len(recording.t) > 1000 and np.isfinite(recording.q).all()


def test_json_says_what_was_written(tmp_path, capsys):
    assert main(simulate("--rate", "250", "--json", "-o", str(tmp_path / "plain.csv"))) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["effects"] == [] and len(document["files"]) == 4
    rows = (tmp_path / "plain.csv").read_text().splitlines()
    assert len(rows) - 1 == document["rows"] and float(rows[2].split(",")[0]) == 0.004


def test_severity_is_reached(tmp_path, capsys):
    arguments = (
        "--effect",
        "torque_ripple:joint_1",
        "--severity",
        "10",
        "--json",
        "-o",
        str(tmp_path / "rec.csv"),
    )
    assert main(simulate(*arguments)) == 0
    assert json.loads(capsys.readouterr().out)["severity"]["joint_1"] == pytest.approx(
        10.0, rel=0.2
    )


def test_another_motion_of_the_same_robot_hides_the_same(tmp_path, capsys):
    asked = (
        "--effect",
        "coupling:joint_2",
        "--effect",
        "spring:joint_1",
        "--severity",
        "4",
        "--seed",
        "5",
        "--rate",
        "250",
    )
    assert main(simulate(*asked, "-o", str(tmp_path / "one.csv"))) == 0
    document = json.loads(TRAJECTORY.read_text())
    document["offset"] = [value + 0.3 for value in document["offset"]]
    (tmp_path / "other.json").write_text(json.dumps(document))
    again = [
        "simulate",
        "two_link",
        str(tmp_path / "other.json"),
        "--periods",
        "1",
        "--like",
        str(tmp_path / "one.truth.json"),
    ]
    assert main([*again, "--noise", "0.01", "-o", str(tmp_path / "two.csv")]) == 0
    assert f"--like {tmp_path / 'one.truth.json'}" in capsys.readouterr().out
    one, two = (
        json.loads((tmp_path / f"{name}.truth.json").read_text()) for name in ("one", "two")
    )
    assert (
        one["effects"] == two["effects"]
        and one["bodies"] == two["bodies"]
        and one["drive"] == two["drive"]
    )
    assert two["setting"] == {**one["setting"], "noise": 0.01}
    assert one["severity"] != two["severity"]
    for more, words in (
        (("--seed", "6"), "--seed"),
        (("--effect", "drag:joint_1"), "--effect"),
        (("--severity", "3"), "--severity"),
    ):
        assert main([*again, *more, "-o", str(tmp_path / "no.csv")]) == 2
        assert f"{words}: is as" in capsys.readouterr().err
    assert (
        main(
            [
                "simulate",
                "ur10e",
                str(TRAJECTORY.with_name("ur10e.json")),
                *again[3:],
                "-o",
                str(tmp_path / "no.csv"),
            ]
        )
        == 2
    )
    assert "has joints joint_1, joint_2" in capsys.readouterr().err
    bodies = json.loads(json.dumps(one["bodies"]))
    next(iter(bodies.values()))[0] += 0.1
    for change, words in (
        ({"setting": {}}, "setting: has no 'seed'"),
        ({"effects": [{**one["effects"][0], "family": "mine"}]}, "no coupling of this form"),
        ({"effects": [{**one["effects"][0], "joint": "elbow"}]}, "coupling in joint elbow"),
        ({"bodies": bodies}, "its bodies are not those of"),
    ):
        (tmp_path / "one.truth.json").write_text(json.dumps({**one, **change}))
        assert main([*again, "-o", str(tmp_path / "no.csv")]) == 2
        assert words in capsys.readouterr().err
    assert not list(tmp_path.glob("no.*"))


def test_what_help_says_is_the_default_is(capsys):
    assert main(["simulate", "--help"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    for value in (
        Setting().seed,
        Setting().rate,
        Setting().noise,
        Setting().encoder,
        Setting().model_error,
    ):
        assert f"(default {value:g})" in said.replace("2e-6", "2e-06")


def test_a_misspelt_effect_is_told_what_it_resembles_and_its_parameters(tmp_path, capsys):
    assert main(simulate("--effect", "stribek:joint_1", "-o", str(tmp_path / "rec.csv"))) == 2
    said = capsys.readouterr().err
    assert (
        len(said.strip().splitlines()) == 1
        and "did you mean stribeck(amplitude [N m], velocity [rad/s]" in said
    )
    assert "backlash" not in said and not list(tmp_path.iterdir())


def test_what_resembles_no_effect_lists_all_and_their_parameters(tmp_path, capsys):
    assert main(simulate("--effect", "list", "-o", str(tmp_path / "rec.csv"))) == 2
    said = capsys.readouterr().err
    assert len(said.strip().splitlines()) == 1
    for name, kind in KINDS.items():
        assert f"{name}({', '.join(f'{q.name} [{q.unit}]' for q in kind.quantities)})" in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--effect", "stribeck:joint_9"), "joint_1, joint_2"),
        (("--effect", "stribeck"), "joint_1, joint_2"),
        (("--effect", "stribeck:joint_1:vel=2"), "it has: amplitude [N m], velocity [rad/s]"),
        (("--effect", "stribeck:joint_1:velocity"), "PARAMETER=VALUE"),
        (("--effect", "stribeck:joint_1:velocity=fast"), "no number"),
        (("--effect", "stribeck:joint_1:velocity=nan"), "finite"),
        (("--effect", "backlash:joint_1:width=-1"), "not below 0"),
        (("--effect", "elasticity:joint_1:stiffness=0"), "above 0"),
        (("--effect", "gravity_tilt:joint_1"), "whole robot"),
        (("--effect", "coupling:joint_1:from=joint_1"), "another joint"),
        (("--effect", "stribeck:joint_1:form=mine"), "tuning, scored"),
        (
            ("--effect", "base_compliance", "--effect", "base_compliance"),
            "more than one effect moves the base",
        ),
        (("--effect", "elasticity:joint_1", "--effect", "backlash:joint_1"), "not both"),
        (("--rate", "5000"), "from 125 to 1000 Hz"),
        (("--noise", "-1"), "from 0 to 10"),
        (("--colour", "900"), "--colour 900"),
        (("--periods", "0"), "whole number from 1"),
        (("--severity", "0", "--effect", "drag:joint_1"), "from 0.001"),
    ],
)
def test_wrong_use_is_one_line_with_the_remedy(tmp_path, capsys, arguments, words):
    assert main(simulate(*arguments, "-o", str(tmp_path / "rec.csv"))) == 2
    said = capsys.readouterr().err
    assert words in said and len(said.strip().splitlines()) == 1


def test_other_files_and_names_are_refused(tmp_path, capsys):
    assert main(simulate("-o", str(tmp_path / "rec.txt"))) == 2
    assert main(["simulate", "no_robot", str(TRAJECTORY), "-o", str(tmp_path / "rec.csv")]) == 2
    assert (
        main(["simulate", "two_link", str(tmp_path / "none.json"), "-o", str(tmp_path / "rec.csv")])
        == 2
    )
    assert main(["simulate", "ur10e", str(TRAJECTORY), "-o", str(tmp_path / "rec.csv")]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 4 and "joint_1" in said[3]
