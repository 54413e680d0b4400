"""Replay of recorded commands in MuJoCo: the identified robot follows the recording."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from identified_models import read_model, write_model
from synthetic_recordings import random_fourier

import excite
from excite.cli.main import main
from excite.errors import UnusableInput

pytest.importorskip("mujoco")

STIFFNESS, DAMPING = 400.0, 30.0
"""Gains of the position loop of the recordings [N m/rad, N m s/rad]."""


def write_replay_recording(path: Path, model: Path, with_qref: bool = True) -> Path:
    """Write a recording of the identified robot: q along a series, its torque, and the qref that a
    PD loop needs for that torque."""
    fitted, t = read_model(model), np.arange(4001) / 500.0
    motion = random_fourier(2, 7, period=4.0).samples(t)
    torque = fitted.torque(motion, motion.dq)
    # τ = K (q_ref − q) + D (q̇_ref − q̇): a first-order equation for q_ref − q
    error, rate = np.zeros_like(torque), 500.0
    for k in range(1, len(t)):
        decay = np.exp(-STIFFNESS / DAMPING / rate)
        error[k] = decay * error[k - 1] + (1.0 - decay) * torque[k - 1] / STIFFNESS
    joints = fitted.robot.joints
    parts = {"q": motion.q, "tau": torque} | ({"qref": motion.q + error} if with_qref else {})
    header = ["t", *(f"{kind}.{joint}" for kind in parts for joint in joints)]
    table = np.hstack([t[:, None], *parts.values()])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(header), comments="")
    return path


@pytest.fixture(name="model")
def model_file(tmp_path):
    return write_model(tmp_path, "two_link")


def test_the_identified_robot_follows_the_recording_better_than_its_description(model, tmp_path):
    recording = write_replay_recording(tmp_path / "run.csv", model)
    result = excite.replay(model, recording, gains=(STIFFNESS, DAMPING))
    before, after = result.errors
    assert [errors.name for errors in result.errors] == ["before", "after"]
    assert np.all(after.position < 0.3 * before.position) and after.lost is None
    assert np.all(after.torque < 0.3 * before.torque)
    assert result.document()["robots"][1]["position_rmse"]["joint_1"] == after.position[0]


def test_the_position_loop_is_fitted_to_the_recorded_torque(model, tmp_path):
    recording = write_replay_recording(tmp_path / "run.csv", model)
    result = excite.replay(model, recording)
    assert result.loop is not None and result.loop.explained is not None
    assert result.loop.explained.min() > 0.9
    assert result.errors[1].position.max() < 0.02


@pytest.mark.slow
def test_the_lag_of_the_loop_is_found_without_the_delay_of_the_recording(tmp_path):
    delay = {
        "effect": "delay",
        "joint": None,
        "from": None,
        "values": {"measured": 1.0},
        "coefficients": [0.003],
        "time": None,
        "recording": None,
    }
    model = write_model(tmp_path, "two_link", (delay,))
    path = write_replay_recording(tmp_path / "run.csv", model)
    measured = excite.read_recording(path, "two_link")
    # of 6 ms, 3 ms are the recording's delay, and 1 ms is half the row for which
    # `write_replay_recording` holds the torque
    later = [np.interp(measured.t - 0.006, measured.t, x) for x in measured.torque.T]
    noise = 0.05 * np.random.default_rng(2).standard_normal(measured.torque.shape)
    late = dataclasses.replace(measured, tau=np.column_stack(later) + noise)
    loop = excite.replay(model, late).loop
    assert loop is not None
    assert loop.lag == pytest.approx(0.002, abs=3e-4)
    assert loop.gains[0] == pytest.approx(STIFFNESS, rel=0.03)
    assert loop.gains[1] == pytest.approx(DAMPING, rel=0.03)


def test_replayed_torque_is_judged_over_short_horizons(model, tmp_path):
    recording = write_replay_recording(tmp_path / "run.csv", model, with_qref=False)
    result = excite.replay(model, recording)
    before, after = result.errors
    assert result.loop is None and np.isnan(after.torque).all()
    assert np.all(after.horizons[0] < 0.2 * before.horizons[0])
    with pytest.raises(UnusableInput, match="has no qref"):
        excite.replay(model, recording, command="qref")


def test_the_command_writes_the_errors_and_a_report(model, tmp_path, capsys):
    recording = write_replay_recording(tmp_path / "run.csv", model)
    arguments = ["replay", str(model), str(recording), "-o", str(tmp_path / "out"), "--json"]
    assert main([*arguments, "--gains", f"{STIFFNESS},{DAMPING}"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["command"] == "qref" and len(document["robots"]) == 2
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "How far does the simulated robot deviate in a free run?" in report
    assert json.loads((tmp_path / "out" / "replay.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--gains", "1,2,3"], "--gains: should hold KP,KD once or for each of the 2 joints"),
        (["--robot", "gone.urdf"], "state the robot before its identification with --robot"),
    ],
)
def test_options_that_do_not_fit_are_refused_in_one_line(options, problem, model, tmp_path, capsys):
    recording = write_replay_recording(tmp_path / "run.csv", model)
    arguments = ["replay", str(model), str(recording), *options, "-o", str(tmp_path / "out"), "-q"]
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert problem in error and error.count("\n") == 1


def test_a_recording_with_a_gap_is_replayed_over_its_longest_stretch(model, tmp_path):
    recording = write_replay_recording(tmp_path / "run.csv", model)
    measured = excite.read_recording(recording, "two_link")
    kept = (measured.t < 1.0) | (measured.t > 3.0)
    parts = {name: getattr(measured, name)[kept] for name in ("t", "q", "tau", "qref", "row_times")}
    gapped = dataclasses.replace(measured, **parts)
    result = excite.replay(model, gapped, gains=(STIFFNESS, DAMPING))
    assert result.data.t[-1] == pytest.approx(5.0, abs=0.01)
