"""Identification from commanded and measured positions, of simulated servo robots."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import excite
import excite.recordings
from excite._types import FloatArray
from excite.errors import ExciteWarning, UnusableInput
from excite.exporters import mujoco_replay
from excite.exporters.simulator_model import simulator_model
from excite.identification import servo_simulation
from excite.identification.forward_dynamics import build_dynamics
from excite.identification.identified_model import IdentifiedModel
from excite.identification.regression import IdentificationModel
from excite.identification.servo_simulation import ServoCommand, ServoLoop, ServoWindows
from excite.robot import base_parameters, inertial_parameters, limits
from excite.robot.inertial_parameters import DRIVE
from excite.robot.samples import Samples

pytestmark = pytest.mark.filterwarnings(
    f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}"
)

URDF = """<robot name="servo"><link name="base"/><link name="arm">
<inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="servo" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 -1 0"/>
<limit lower="-3.1" upper="3.1" velocity="20" effort="5"/></joint></robot>"""
"""A pendulum of m g l = 0.49 N m and 5.1e-3 kg m²."""
TRUTH = {"gain": 4.0, "coulomb": 0.12, "viscous": 0.05, "rotor_inertia": 0.01}
"""K_p [N m/rad] and joint parameters of the simulated servo."""
RATE = 100.0
"""Rate of the recordings [Hz]."""


def pendulum_motion(command: FloatArray, step: float, gain: float) -> FloatArray:
    """Position of the simulated servo: it sticks as long as friction can hold it."""
    inertia, q, v = 0.5 * 0.01 + 1e-4 + TRUTH["rotor_inertia"], 0.0, 0.0
    out = np.empty(len(command))
    for k, reference in enumerate(command.tolist()):
        force = gain * (reference - q) - 0.5 * 9.81 * 0.1 * np.sin(q) - TRUTH["viscous"] * v
        free = v + step * force / inertia
        v = float(np.sign(free) * max(abs(free) - step * TRUTH["coulomb"] / inertia, 0.0))
        q += step * v
        out[k] = q
    return out


def write_pendulum(folder: Path, name: str, seed: int, gain: float = 1.0) -> Path:
    """A recording of 15 s with an encoder of 12 bits; `gain`: of the loop, relative."""
    rng, step = np.random.default_rng(seed), 2.5e-4
    t = np.arange(0.0, 15.0, step)
    waves = [(0.5, 0.3), (0.3, 0.9), (0.15, 2.3)]
    command = sum(a * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.0)) for a, f in waves)
    q = pendulum_motion(command, step, gain * TRUTH["gain"])
    every = round(1.0 / RATE / step)
    encoder = 2.0 * np.pi / 4096.0
    table = np.column_stack([t, np.round(q / encoder) * encoder, command])[::every]
    path = folder / f"{name}.csv"
    np.savetxt(path, table, delimiter=",", header="t,q.servo,qref.servo", comments="")
    sidecar = {"schema": "excite.recording/1", "position_gain": {"servo": 100.0 * gain}}
    path.with_suffix(".json").write_text(json.dumps(sidecar), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pendulum")
    (folder / "servo.urdf").write_text(URDF, encoding="utf-8")
    write_pendulum(folder, "first", 1)
    write_pendulum(folder, "soft", 2, 0.5)
    write_pendulum(folder, "unseen", 3)
    return folder


def joint_values(result: excite.ServoIdentificationResult) -> dict[str, float]:
    """K_p and joint parameters of the first joint."""
    identification = result.identification
    values = {
        kind: float(identification.psi[identification.model.parameters.block(kind)][0])
        for kind in DRIVE
    }
    return {"gain": float(identification.loop.proportional[0]), **values}


@pytest.fixture(scope="module")
def identified(pendulum: Path) -> excite.ServoIdentificationResult:
    return excite.identify_servo(
        pendulum / "servo.urdf",
        [pendulum / "first.csv", pendulum / "soft.csv"],
        validate=[pendulum / "unseen.csv"],
    )


def test_a_servo_is_identified_with_the_masses_of_its_description(identified):
    values = joint_values(identified)
    assert values["gain"] == pytest.approx(TRUTH["gain"], rel=0.04)
    assert values["coulomb"] == pytest.approx(TRUTH["coulomb"], rel=0.06)
    assert values["viscous"] == pytest.approx(TRUTH["viscous"], rel=0.3)
    assert values["rotor_inertia"] == pytest.approx(TRUTH["rotor_inertia"], rel=0.3)
    assert identified.identification.loop.delay[0] < 0.01


def test_an_unseen_motion_is_replayed(identified):
    replay = identified.identification.validations[0]
    assert replay.error()[0] < 7e-3
    assert replay.error("command")[0] > 0.1


@pytest.mark.slow
def test_stated_gains_replace_the_scale_of_the_description(pendulum: Path):
    stated = excite.identify_servo(
        pendulum / "servo.urdf", [pendulum / "first.csv"], gains=(2.0 * TRUTH["gain"], 0.0)
    )
    values = joint_values(stated)
    assert values["gain"] == 2.0 * TRUTH["gain"]
    assert values["coulomb"] == pytest.approx(2.0 * TRUTH["coulomb"], rel=0.1)
    gravity = -stated.parameters["mcz1"] * 9.81
    assert gravity == pytest.approx(2.0 * 0.5 * 9.81 * 0.1, rel=0.1)
    assert not stated.identification.is_ratio


def test_the_model_is_predicted_replayed_and_exported(identified, pendulum: Path, tmp_path: Path):
    mujoco = pytest.importorskip("mujoco")
    identified.save(tmp_path)
    model = tmp_path / "model.json"
    document = json.loads(model.read_text(encoding="utf-8"))
    assert document["scale"]["fixed_by"] == "description"
    assert document["over_gain"]["servo"]["coulomb"] == pytest.approx(0.03, rel=0.06)
    spread = document["over_gain_std"]["servo"]["coulomb"]
    assert 0.0 < spread < 0.1 * 0.03  # a common factor of all torques leaves the ratio
    torque = excite.predict(model, pendulum / "unseen.csv").torque
    assert 0.2 < float(np.std(torque)) < 1.0
    replayed = excite.replay(model, pendulum / "unseen.csv")
    assert replayed.loop is not None and replayed.loop.origin == "model"
    assert replayed.errors[-1].position[0] < 8e-3 < replayed.errors[0].position[0]
    exported = excite.export_model(model, "mjcf").text
    compiled = mujoco.MjModel.from_xml_string(exported)
    assert compiled.actuator_gainprm[0, 0] == pytest.approx(
        document["position_loop"]["servo"]["proportional"]
    )
    assert compiled.actuator_biastype[0] == mujoco.mjtBias.mjBIAS_AFFINE
    assert "no torque was recorded" in exported


@pytest.mark.slow
def test_the_command_identifies_from_positions_where_no_torque_was_recorded(
    pendulum: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    from excite.cli import main

    out = tmp_path / "model"
    words = ["identify", str(pendulum / "servo.urdf"), str(pendulum / "first.csv")]
    assert main.main([*words, "--align", "-o", str(out)]) == 2
    assert "--align: needs recorded torque" in capsys.readouterr().err
    assert main.main([*words, "--gains", "4,0", "-o", str(out)]) == 0
    captured = capsys.readouterr()
    assert "no torque was recorded" in captured.err
    assert "the stated gains of the position loops fix the scale" in captured.out
    assert (out / "report.html").stat().st_size > 10_000


def test_recordings_without_commands_are_refused(pendulum: Path):
    recording = excite.read_recording(pendulum / "first.csv", pendulum / "servo.urdf")
    bare = dataclasses.replace(recording, qref=None)
    with pytest.raises(UnusableInput, match="neither torque nor qref"):
        excite.identify_servo(pendulum / "servo.urdf", [bare])


def two_link() -> tuple[IdentificationModel, FloatArray]:
    """The built-in arm with friction and rotor inertia."""
    arm = excite.load_robot("two_link")
    table = limits.resolve(arm)
    standard = inertial_parameters.standard_parameters(arm, table)
    base = base_parameters.find(arm, standard, table)
    psi = standard.nominal.copy()
    for kind, value in {
        "rotor_inertia": 0.05,
        "viscous": 0.8,
        "coulomb": 1.5,
        "offset": 0.3,
    }.items():
        psi[standard.block(kind)] = value
    return IdentificationModel(arm, standard, base, np.full(arm.n, 0.005)), psi


def test_sensitivities_are_those_of_the_discrete_map():
    model, psi = two_link()
    t = np.arange(0.0, 0.6, 0.02)
    command = np.column_stack([0.4 * np.sin(3.0 * t), 0.3 * np.cos(4.0 * t)])
    windows = ServoWindows(
        np.array([[0.05, 0.25, 0.4, 0.0]]),
        np.zeros((1, 21, 2)),
        np.array([0.1]),
        (ServoCommand(t, command),),
        0.02,
        np.ones((1, 2)),
        np.full((1, 2), 0.3),
    )
    loop = ServoLoop(np.array([300.0, 90.0]), np.array([4.0, 1.0]), np.array([0.011, 0.003]))
    run = servo_simulation.simulate_servo(
        build_dynamics(model, psi), loop, windows, sensitivities=True
    )
    assert run.slopes is not None
    free = np.array([0, 1, 2, 3, 4, 5])
    steps = np.full(6, 1e-6)
    for k in free:
        ends = []
        for sign in (1.0, -1.0):
            step = np.zeros(6)
            step[k] = sign * steps[k]
            ends.append(
                servo_simulation.simulate_servo(
                    build_dynamics(model, psi), loop.changed(step), windows
                ).q
            )
        slope = (ends[0] - ends[1]) / (2.0 * steps[k])
        assert np.allclose(run.slopes[..., k], slope, atol=1e-5 + 1e-3 * np.abs(slope).max())
    rng = np.random.default_rng(0)
    change = rng.normal(size=len(psi)) * np.maximum(np.abs(psi), 0.1)
    ends = [
        servo_simulation.simulate_servo(
            build_dynamics(model, psi + sign * 1e-7 * change), loop, windows
        ).q
        for sign in (1.0, -1.0)
    ]
    expected = (ends[0] - ends[1]) / 2e-7
    slope = run.slopes[..., 6:] @ (model.base.matrix @ change)
    assert np.allclose(slope, expected, atol=1e-5 + 2e-3 * np.abs(expected).max())


def test_speeds_balance_friction_of_any_size():
    rng = np.random.default_rng(1)
    A = np.eye(3) + 0.3 * np.ones((3, 3))
    matrices, r = np.tile(A, (500, 1, 1)), rng.normal(size=(500, 3))
    friction, widths = np.array([0.0, 0.5, 3.0]), np.full(3, 1e-3)
    v = servo_simulation.end_speed(matrices, r, friction, widths, rng.normal(size=(500, 3)))
    balance = np.einsum("wij,wj->wi", matrices, v) + friction * np.tanh(v / widths) - r
    assert np.abs(balance).max() < 1e-6


@pytest.mark.slow
def test_an_arm_is_identified_from_its_motion_in_mujoco():
    pytest.importorskip("mujoco")
    model, psi = two_link()
    arm, rng = model.robot, np.random.default_rng(4)
    truth = IdentifiedModel("", arm, DRIVE, psi, model.widths, 20.0)
    gains = np.array([400.0, 120.0])
    recordings = []
    for seed in range(2):
        t = np.arange(0.0, 16.0, 0.02)
        command = np.zeros((len(t), arm.n))
        for frequency in (0.15, 0.4, 0.9):
            phase = rng.uniform(0.0, 6.0, arm.n)
            command += 0.35 * np.sin(2.0 * np.pi * frequency * t[:, None] + phase)
        still = Samples(np.tile(command[0], (len(t), 1)), np.zeros_like(command), command * 0.0)
        reference = Samples(command, np.gradient(command, t, axis=0), command * 0.0)
        data = mujoco_replay.ReplayInput(
            t,
            still.q,
            still,
            reference,
            None,
            None,
            np.zeros_like(command),
            np.zeros(command.shape[1]),
        )
        loop = mujoco_replay.stated_loop(gains, np.zeros(arm.n))
        run = mujoco_replay.Replay(simulator_model(truth, {}), data, loop).run(0, len(t))
        q = run.q + 2e-4 * rng.normal(size=run.q.shape)
        recordings.append(
            excite.recordings.Recording(f"run{seed}", arm.joints, t, q, qref=command, row_times=t)
        )
    result = excite.identify_servo(arm, recordings[:1], validate=recordings[1:])
    identification = result.identification
    ratio = identification.psi[model.parameters.block("coulomb")] / identification.loop.proportional
    assert ratio == pytest.approx(1.5 / gains, rel=0.1)
    assert identification.loop.proportional == pytest.approx(gains, rel=0.1)
    assert identification.validations[0].error().max() < 5e-3
