"""Recordings with columns named by `--columns`: a model of them predicts, is exported and replayed
without a second statement of the names. The next design needs `--columns` again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from synthetic_recordings import (
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    two_link_model,
    write_recording,
)

from excite.cli import main as main_module
from excite.robot import robot

NAMES = {"t": "clock", "q": "angle", "tau": "load"}
"""First words of the columns."""
QUICK = ("--harmonics", "2", "--starts", "1", "--iterations", "10", "--no-collision", "--force")


def run(*words: object) -> int:
    return main_module.main([str(word) for word in words])


def column_options() -> tuple[str, ...]:
    """`--columns` for the files of this module."""
    joints = robot.load("two_link").joints
    pairs = [f"{kind}.{joint}={NAMES[kind]} {joint}" for kind in ("q", "tau") for joint in joints]
    return ("--columns", ",".join(["t=clock", *pairs]))


@pytest.fixture(scope="module", name="folder")
def folder_of_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training and a validation recording with other names of columns, and their model."""
    folder = tmp_path_factory.mktemp("columns")
    subject = two_link_model()
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    for name, seed in (("train", 2), ("other", 5)):
        series = random_fourier(2, seed)
        path = write_recording(
            synthetic_recording(subject, psi, series, 3, 0.2), folder / f"{name}.csv"
        )
        header, rows = path.read_text().split("\n", 1)
        cells = [cell.partition(".") for cell in header.split(",")]
        names = [f"{NAMES[kind]} {joint}".strip() for kind, _, joint in cells]
        path.write_text(",".join(names) + "\n" + rows)
    words = ("identify", "two_link", folder / "train.csv", "--validate", folder / "other.csv")
    assert run(*words, *column_options(), "-o", folder / "out") == 0
    return folder


def test_a_model_states_the_columns_of_its_recordings(folder):
    document = json.loads((folder / "out" / "model.json").read_text())
    stated = document["recording_columns"]
    assert sorted(Path(name).name for name in stated) == ["other.csv", "train.csv"]
    assert stated[str(folder / "other.csv")]["q.joint_1"] == "angle joint_1"


@pytest.mark.parametrize("options", [(), ("--recording",)])
def test_a_model_is_exported_along_its_recordings(folder, options, tmp_path, capsys):
    words = ("export", folder / "out" / "model.json", "--format", "urdf", "--json")
    recording = (*options, folder / "train.csv") if options else ()
    capsys.readouterr()
    assert run(*words, *recording, "-o", tmp_path / "robot.urdf") == 0
    out = json.loads(capsys.readouterr().out)
    assert Path(out["along"]).name == ("train.csv" if options else "other.csv")


def test_a_recording_that_cannot_be_read_again_does_not_stop_an_export(folder, tmp_path, capsys):
    content = json.loads((folder / "out" / "model.json").read_text())
    (tmp_path / "other.csv").write_text("clock,angle\n0,1\n")
    content["validation"][0]["recording"] = "other.csv"
    (tmp_path / "model.json").write_text(json.dumps(content))
    words = ("export", tmp_path / "model.json", "--format", "urdf", "-o", tmp_path / "robot.urdf")
    assert run(*words, "--json") == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["along"] is None and (tmp_path / "robot.urdf").is_file()
    assert "other.csv" in err and "--recording" in err


def test_a_model_predicts_and_replays_its_recordings(folder, tmp_path):
    model = folder / "out" / "model.json"
    assert run("predict", model, folder / "train.csv", "-o", tmp_path / "torque.csv") == 0
    pytest.importorskip("mujoco")
    words = ("replay", model, folder / "train.csv")
    assert run(*words, "--command", "torque", "-o", tmp_path) == 0


def test_recordings_are_known_from_another_working_directory(folder, tmp_path, monkeypatch):
    """The model states the paths as they were typed where it was identified."""
    monkeypatch.chdir(folder)
    assert run("identify", "two_link", "train.csv", *column_options(), "-o", tmp_path / "out") == 0
    monkeypatch.chdir(tmp_path)
    words = ("predict", "out/model.json", folder / "train.csv", "-o", "torque.csv")
    assert run(*words) == 0


def test_another_recording_of_the_same_file_name_is_read_by_its_own_names(
    folder, tmp_path, monkeypatch
):
    header, rows = (folder / "train.csv").read_text().split("\n", 1)
    joints = robot.load("two_link").joints
    standard = {f"{NAMES[kind]} {joint}": f"{kind}.{joint}" for kind in NAMES for joint in joints}
    names = ["t" if cell == "clock" else standard.get(cell, cell) for cell in header.split(",")]
    (tmp_path / "train.csv").write_text(",".join(names) + "\n" + rows)
    monkeypatch.chdir(tmp_path)
    assert run("predict", folder / "out" / "model.json", "train.csv", "-o", "torque.csv") == 0


def test_the_next_design_reads_the_columns_of_given_recordings(folder, tmp_path, capsys):
    words = ("design", "two_link", "--given", folder / "train.csv", "-o", tmp_path)
    assert run(*words, *QUICK, *column_options()) == 0, capsys.readouterr().err
    assert run(*words, *QUICK) == 2


def test_a_payload_is_identified_next_to_the_recordings_of_a_model(folder, tmp_path, capsys):
    """The recording with the payload has standard names, those of the model their own."""
    subject = two_link_model()
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    psi[10] += 1.0  # mass of the last link
    carrying = write_recording(
        synthetic_recording(subject, psi, random_fourier(2, 7), 3, 0.2), tmp_path / "with.csv"
    )
    words = ("payload", "two_link", "--with", carrying, "--model", folder / "out" / "model.json")
    assert run(*words, "-o", tmp_path / "out") == 0, capsys.readouterr().err
    document = json.loads((tmp_path / "out" / "payload.json").read_text())
    assert [Path(name).name for name in document["without"]] == ["train.csv"]


def test_options_for_the_recording_with_the_payload_are_not_those_of_the_model(
    folder, tmp_path, capsys
):
    """The recording with the payload has other names, that of the model standard ones."""
    subject = two_link_model()
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    empty = write_recording(
        synthetic_recording(subject, psi, random_fourier(2, 2), 3, 0.2), tmp_path / "empty.csv"
    )
    assert run("identify", "two_link", empty, "-o", tmp_path / "model") == 0
    model = tmp_path / "model" / "model.json"
    words = ("payload", "two_link", "--with", folder / "other.csv", "--model", model)
    run(*words, *column_options(), "-o", tmp_path / "out")  # it has no payload to be found
    assert "has no column" not in capsys.readouterr().err


def test_the_report_names_the_options_to_repeat(folder):
    assert "--columns" in (folder / "out" / "report.html").read_text()
