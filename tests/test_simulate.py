"""`excite simulate` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from excite import recordings
from excite.cli.main import main
from excite.robot.robot import load
from excite.simulator.effects import EFFECT_TYPES
from excite.simulator.experiment import ExperimentSettings

TRAJECTORY = Path(__file__).parents[1] / "trajectories" / "two_link.json"


def simulate_arguments(*arguments: str) -> list[str]:
    return ["simulate", "two_link", str(TRAJECTORY), "--periods", "1", *arguments]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated")
    assert (
        main(
            simulate_arguments(
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


def test_command_writes_recording_sidecar_truth_and_plot(folder):
    assert {p.name for p in folder.iterdir()} == {
        "rec.csv",
        "rec.json",
        "rec.truth.json",
        "rec.svg",
    }
    header = (folder / "rec.csv").read_text().split("\n", 1)[0]
    assert header == "t," + ",".join(
        f"{quantity}.joint_{i}" for quantity in ("q", "tau", "qref") for i in (1, 2)
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


def test_recording_is_readable(folder):
    recording = recordings.read(folder / "rec.csv", load("two_link"))
    assert len(recording.t) > 1000 and np.isfinite(recording.q).all()


def test_json_lists_the_written_files(tmp_path, capsys):
    assert (
        main(simulate_arguments("--rate", "250", "--json", "-o", str(tmp_path / "plain.csv"))) == 0
    )
    document = json.loads(capsys.readouterr().out)
    assert document["effects"] == [] and len(document["files"]) == 4
    rows = (tmp_path / "plain.csv").read_text().splitlines()
    assert len(rows) - 1 == document["rows"] and float(rows[2].split(",")[0]) == 0.004


def test_effect_is_scaled_to_the_severity(tmp_path, capsys):
    arguments = (
        "--effect",
        "torque_ripple:joint_1",
        "--severity",
        "10",
        "--json",
        "-o",
        str(tmp_path / "rec.csv"),
    )
    assert main(simulate_arguments(*arguments)) == 0
    assert json.loads(capsys.readouterr().out)["severity"]["joint_1"] == pytest.approx(
        10.0, rel=0.2
    )


def test_like_simulates_the_same_robot_on_another_motion(tmp_path, capsys):
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
    assert main(simulate_arguments(*asked, "-o", str(tmp_path / "one.csv"))) == 0
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
    first, second = (
        json.loads((tmp_path / f"{name}.truth.json").read_text()) for name in ("one", "two")
    )
    assert (
        first["effects"] == second["effects"]
        and first["bodies"] == second["bodies"]
        and first["drive"] == second["drive"]
    )
    assert second["setting"] == {**first["setting"], "noise": 0.01}
    assert first["severity"] != second["severity"]
    for more, words in (
        (("--seed", "6"), "--seed"),
        (("--effect", "drag:joint_1"), "--effect"),
        (("--severity", "3"), "--severity"),
    ):
        assert main([*again, *more, "-o", str(tmp_path / "no.csv")]) == 2
        assert f"{words}: is stated by" in capsys.readouterr().err
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
    bodies = json.loads(json.dumps(first["bodies"]))
    next(iter(bodies.values()))[0] += 0.1
    for change, words in (
        ({"setting": {}}, "setting: has no 'seed'"),
        ({"effects": [{**first["effects"][0], "family": "mine"}]}, "no coupling of this form"),
        ({"effects": [{**first["effects"][0], "joint": "elbow"}]}, "coupling in joint elbow"),
        ({"bodies": bodies}, "its links are not those of"),
    ):
        (tmp_path / "one.truth.json").write_text(json.dumps({**first, **change}))
        assert main([*again, "-o", str(tmp_path / "no.csv")]) == 2
        assert words in capsys.readouterr().err
    assert not list(tmp_path.glob("no.*"))


def test_help_states_the_defaults(capsys):
    assert main(["simulate", "--help"]) == 0
    message = " ".join(capsys.readouterr().out.split())
    for value in (
        ExperimentSettings().seed,
        ExperimentSettings().rate,
        ExperimentSettings().noise,
        ExperimentSettings().encoder,
        ExperimentSettings().model_error,
    ):
        assert f"(default {value:g})" in message.replace("2e-6", "2e-06")


def test_misspelt_effect_is_answered_with_a_suggestion(tmp_path, capsys):
    assert (
        main(simulate_arguments("--effect", "stribek:joint_1", "-o", str(tmp_path / "rec.csv")))
        == 2
    )
    message = capsys.readouterr().err
    assert (
        len(message.strip().splitlines()) == 1
        and "did you mean stribeck(amplitude [N m], velocity [rad/s]" in message
    )
    assert "backlash" not in message and not list(tmp_path.iterdir())


def test_unknown_effect_lists_all_effects_with_parameters(tmp_path, capsys):
    assert main(simulate_arguments("--effect", "list", "-o", str(tmp_path / "rec.csv"))) == 2
    message = capsys.readouterr().err
    assert len(message.strip().splitlines()) == 1
    for name, effect_type in EFFECT_TYPES.items():
        parameters = ", ".join(f"{q.name} [{q.unit}]" for q in effect_type.parameters)
        assert f"{name}({parameters})" in message
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
        (("--severity", "3"), "--severity: scales hidden effects; name one with --effect"),
        (("--effect", "drag:joint_1", "--trusted"), "--trusted: goes with --severity"),
        (("--jitter", "1"), "--jitter 1: should be at most the time between two rows, 0.002 s"),
    ],
)
def test_wrong_use_prints_one_line_with_the_remedy(tmp_path, capsys, arguments, words):
    assert main(simulate_arguments(*arguments, "-o", str(tmp_path / "rec.csv"))) == 2
    message = capsys.readouterr().err
    assert words in message and len(message.strip().splitlines()) == 1


def test_wrong_files_and_names_are_refused(tmp_path, capsys):
    assert main(simulate_arguments("-o", str(tmp_path / "rec.txt"))) == 2
    assert main(["simulate", "no_robot", str(TRAJECTORY), "-o", str(tmp_path / "rec.csv")]) == 2
    assert (
        main(["simulate", "two_link", str(tmp_path / "none.json"), "-o", str(tmp_path / "rec.csv")])
        == 2
    )
    assert main(["simulate", "ur10e", str(TRAJECTORY), "-o", str(tmp_path / "rec.csv")]) == 2
    message = capsys.readouterr().err.strip().splitlines()
    assert len(message) == 4 and "joint_1" in message[3]
