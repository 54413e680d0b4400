"""Diagnosis of a sliding joint, whose periods, deflections and ratios to others are lengths."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from identified_models import write_model
from synthetic_recordings import sum_of_sines, write_joint_recording

import excite
from excite import recordings
from excite._types import FloatArray
from excite.cli.main import main
from excite.diagnosis.diagnosis import Diagnosis
from excite.errors import UnusableInput

URDF = """<robot name="slide"><link name="base"/>
<joint name="carriage" type="prismatic"><parent link="base"/><child link="load"/>
<axis xyz="1 0 0"/><limit lower="0" upper="0.3" velocity="0.5" effort="400"/></joint>
<link name="load"><inertial><mass value="80"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>"""
LEAD, RATE, DURATION, NOISE = 5e-3, 1000.0, 25.0, 0.5
"""Lead of the ball screw [m], rate [Hz], duration [s] and noise [N]."""
MASS, VISCOUS, COULOMB, WIDTH = 100.0, 200.0, 20.0, 1e-3
"""Parameters of the carriage: mass [kg], friction [N s/m, N] and its width [m/s]."""
Force = Callable[[FloatArray, FloatArray], FloatArray]
"""Force of an effect [N] by position and velocity, shape (N,)."""


def record(
    path: Path, seed: int, force: Force, misread: Callable[[FloatArray], FloatArray]
) -> Path:
    """Record a carriage of 100 kg.

    Args:
        path: The file.
        seed: Of the motion and the noise.
        force: What the carriage needs besides inertia, viscous and Coulomb friction.
        misread: Error of the recorded position [m].
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    omega = 2.0 * np.pi * np.arange(1, 6) / DURATION
    amplitude = 0.11 * np.array([0.5, 0.2, 0.15, 0.1, 0.05])
    offset, dq, ddq = sum_of_sines(t, omega, amplitude, rng)
    q = 0.15 + offset
    total = MASS * ddq + VISCOUS * dq + COULOMB * np.tanh(dq / WIDTH) + force(q, dq)
    return write_joint_recording(
        path, "carriage", t, q + misread(q), total + NOISE * rng.normal(size=len(t))
    )


def diagnosed(
    folder: Path,
    force: Force = lambda q, dq: np.zeros(len(q)),
    misread: Callable[[FloatArray], FloatArray] = np.zeros_like,
) -> Diagnosis:
    """Diagnose the carriage by one recording; another one is held out."""
    robot = folder / "slide.urdf"
    robot.write_text(URDF, encoding="utf-8")
    train, held_out = (record(folder / f"{seed}.csv", seed, force, misread) for seed in (1, 2))
    return excite.diagnose(robot, [train], [held_out]).diagnosis


def findings_of(result: Diagnosis) -> list[str]:
    """Return the names of the findings, the most probable first."""
    return [finding.effect for finding in result.findings]


def test_forces_and_positions_have_the_units_of_a_sliding_joint(tmp_path, capsys):
    pytest.importorskip("mujoco")
    robot = tmp_path / "slide.urdf"
    robot.write_text(URDF.replace('="1"', '="2"'), encoding="utf-8")  # no placeholder
    excite.design(robot, starts=1, harmonics=2, samples=24, period=2.0).save(tmp_path / "design")
    simulated = excite.simulate(robot, tmp_path / "design" / "trajectory.json")
    assert ">N<" in simulated.picture() and "N m" not in simulated.picture()
    run = simulated.save(tmp_path / "run.csv")[0]
    model = write_model(tmp_path, str(robot))
    assert main(["replay", str(model), str(run), "-o", str(tmp_path / "replay")]) == 0
    (line,) = [x for x in capsys.readouterr().out.splitlines() if x.startswith("carriage")]
    assert " m, " in line and " N " in line and "rad" not in line and "N m" not in line


@pytest.mark.slow
def test_the_wave_of_a_ball_screw_is_found(tmp_path):
    def wave(q: FloatArray, dq: FloatArray) -> FloatArray:
        return 3.0 * np.cos(2.0 * np.pi * q / LEAD + 0.7)

    result = diagnosed(tmp_path, wave)
    (ripple,) = (f for f in result.findings if f.effect == "torque_ripple")
    assert ripple.parameters["order"][0] == pytest.approx(2.0 * np.pi / LEAD, rel=1e-3)
    assert ripple.parameters["amplitude"][0] == pytest.approx(3.0, rel=0.1)
    assert result.held_out.rmse_after < 0.3 * result.held_out.rmse_before


@pytest.mark.slow
def test_the_friction_of_a_tight_spot_is_found(tmp_path):
    def spot(q: FloatArray, dq: FloatArray) -> FloatArray:
        return 6.0 * np.cos(2.0 * np.pi * q / 0.15) * np.tanh(dq / WIDTH)

    result = diagnosed(tmp_path, spot)
    assert findings_of(result) == ["position_friction"]
    assert result.held_out.rmse_after < 0.1 * result.held_out.rmse_before


@pytest.mark.slow
def test_presliding_over_a_fraction_of_a_millimetre_is_found(tmp_path):
    """Friction that builds up over 0.3 mm instead of with the speed."""

    def presliding(q: FloatArray, dq: FloatArray) -> FloatArray:
        z, out = 0.0, np.empty(len(q))
        for k, step in enumerate(np.diff(q, prepend=q[0])):
            z = min(max(z + step / 3e-4, -1.0), 1.0)
            out[k] = z
        return COULOMB * (out - np.tanh(dq / WIDTH))

    result = diagnosed(tmp_path, presliding)
    assert findings_of(result) == ["hysteresis"]
    assert result.held_out.rmse_after < 1.2 * result.noise.floor


def test_the_error_of_a_linear_scale_is_found(tmp_path):
    result = diagnosed(tmp_path, misread=lambda q: 2e-4 * np.sin(2.0 * np.pi * q / 0.04))
    assert findings_of(result) == ["encoder_error"]
    (error,) = result.findings
    assert error.parameters["order"][0] == pytest.approx(2.0 * np.pi / 0.04, rel=0.01)
    assert error.parameters["amplitude"][0] == pytest.approx(2e-4, rel=0.2)


QUILL = """<robot name="quill"><link name="base"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="nut"/>
<axis xyz="0 0 1"/><limit lower="0" upper="0.2" velocity="1" effort="400"/></joint>
<link name="nut"><inertial><mass value="2"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<joint name="turn" type="continuous"><parent link="nut"/><child link="flange"/>
<axis xyz="0 0 1"/><limit velocity="10" effort="50"/></joint>
<link name="flange"><inertial><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.015"/></inertial></link></robot>"""
"""A ball-screw spline: its nut turns with both joints."""
SCREW_RATIO = 3e-3
"""Lift of the screw [m/rad]."""


def record_quill(path: Path, seed: int, travel: float = 0.09) -> Path:
    """Record a lift of 2 kg and a flange whose screw has viscous, Coulomb friction and inertia."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, DURATION, 1.0 / 250.0)
    omega = 2.0 * np.pi * np.arange(2, 7) / DURATION
    share = np.array([0.5, 0.2, 0.15, 0.1, 0.05])
    offset, lift, lift_rate = sum_of_sines(t, omega, travel * share, rng)
    angle, turn, turn_rate = sum_of_sines(t, omega, 3.0 * share, rng)
    speed, rate = lift + SCREW_RATIO * turn, lift_rate + SCREW_RATIO * turn_rate
    screw = 40.0 * speed + 6.0 * np.tanh(speed / WIDTH) + 2.0 * rate
    force = 2.0 * (lift_rate + 9.81) + 20.0 * lift + 5.0 * np.tanh(lift / WIDTH) + screw
    torque = 0.015 * turn_rate + 0.05 * turn + 0.1 * np.tanh(turn / 0.03) + SCREW_RATIO * screw
    table = np.column_stack(
        [
            t,
            0.1 + offset,
            angle,
            force + 0.2 * rng.normal(size=len(t)),
            torque + 1e-3 * rng.normal(size=len(t)),
        ]
    )
    header = "t,q.lift,q.turn,tau.lift,tau.turn"
    np.savetxt(path, table, delimiter=",", header=header, comments="")
    return path


@pytest.mark.slow
def test_a_screw_that_two_joints_turn_is_a_coupling(tmp_path):
    """Its ratio is a length, three millimetres, and no number near 1."""
    robot = tmp_path / "quill.urdf"
    robot.write_text(QUILL, encoding="utf-8")
    train, held_out = (record_quill(tmp_path / f"{seed}.csv", seed) for seed in (1, 2))
    result = excite.diagnose(robot, [train], [held_out]).diagnosis
    couplings = [f for f in result.findings if f.effect == "coupling"]
    assert {f.joint for f in couplings} == {0, 1}
    for entry in couplings:
        ratio, std = entry.parameters["ratio"]
        assert abs(ratio - (SCREW_RATIO if entry.joint == 0 else 1.0 / SCREW_RATIO)) < 2.0 * std
    assert (result.held_out.rmse_after < 0.2 * result.held_out.rmse_before).all()


@pytest.mark.slow
def test_a_sliding_joint_may_stand_still_in_the_fitted_recordings(tmp_path):
    """No shaft is tried that both joints turn, and its friction is said to be unknown."""
    robot = tmp_path / "quill.urdf"
    robot.write_text(QUILL, encoding="utf-8")
    train = record_quill(tmp_path / "held.csv", 1, travel=0.0)
    arguments = ["diagnose", str(robot), str(train), "-o", str(tmp_path)]
    held_out = record_quill(tmp_path / "moving.csv", 2)
    assert main([*arguments, "--validate", str(held_out)]) == 0
    document = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert document["joints"]["lift"]["speed_ratio"] is None
    assert 0.5 < document["joints"]["turn"]["speed_ratio"] < 2.0
    assert "it stands still in the fitted recordings" in (tmp_path / "report.html").read_text(
        encoding="utf-8"
    )


def test_millimetres_are_named_before_glitches(tmp_path):
    """Updates of a slow log in mm are above the velocity limit, as glitches are."""
    robot = tmp_path / "quill.urdf"
    robot.write_text(QUILL.replace('velocity="1"', 'velocity="0.05"'), encoding="utf-8")
    path = record_quill(tmp_path / "mm.csv", 1)
    header = path.read_text(encoding="utf-8").splitlines()[0]
    table = np.loadtxt(path, delimiter=",", skiprows=1)[:2750]
    lift = np.where(table[:, 0] < 2.0, 0.0, 4.0 - 4.0 * np.cos(table[:, 0] - 2.0))
    table[:, 1] = np.repeat(lift[::25], 25)
    np.savetxt(path, table[::12], delimiter=",", header=header, comments="")
    with pytest.raises(UnusableInput, match="if its positions are in mm"):
        recordings.read(path, excite.load_robot(robot))
