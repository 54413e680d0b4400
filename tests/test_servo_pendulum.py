"""Diagnosis of a servo that drives a pendulum and has load-dependent Stribeck friction in its gear.

M. Duclusaud, G. Passault, V. Padois and O. Ly, "Extended friction models for the physics simulation
of servo actuators", ICRA 2025. The parameters are those published for an MX-106, rounded; the
encoder is finer than the servo's. The joint sticks as long as static friction can hold it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from excite import recordings
from excite._types import FloatArray
from excite.diagnosis import diagnosis, diagnosis_file
from excite.errors import ExciteWarning
from excite.identification import nominal_comparison
from excite.robot import base_parameters, inertial_parameters, limits, robot

MASS = 1.0
"""Mass of the pendulum [kg]."""
LENGTH = 0.15
"""Distance of its centre of mass from the axis [m]."""
ARMATURE = 0.026
"""Inertia of the rotor on the link side [kg m²]."""
GRAVITY = 9.81
"""[m/s²]"""
TORQUE_PER_VOLT = 1.09
"""[N m/V]"""
BACK_EMF = 2.4
"""Torque lost per speed [N m s/rad]."""
MAX_VOLTAGE = 15.0
"""[V]"""
STEP = 2.5e-4
"""Step of the simulation [s]."""
RATE = 200.0
"""Rate of the recording [Hz]."""
DURATION = 6.0
"""Length of a recording [s]."""
ENCODER_STEP = 2.0 * np.pi / 2**19
"""Resolution of the encoder [rad]."""

URDF = f"""<robot name="servo"><link name="base"/><link name="arm">
<inertial><origin xyz="0 0 {-LENGTH}"/><mass value="{MASS}"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="servo" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 -1 0"/>
<limit lower="-6.3" upper="6.3" velocity="20" effort="20"/></joint></robot>"""


def max_friction(motor: float, load: float, speed: float) -> float:
    """Largest friction torque [N m]."""
    stribeck = np.exp(-((abs(speed) / 1.75) ** 1.14))
    return float(
        abs(0.198 * motor - 0.022 * load)
        + stribeck * (0.122 + abs(0.199 * motor - 0.087 * load))
        + 0.051 * abs(speed)
    )


def simulated(goal: FloatArray, gain: float) -> tuple[FloatArray, FloatArray]:
    """Position and motor torque of the servo with proportional control to `goal`."""
    inertia, q, speed = MASS * LENGTH**2 + ARMATURE, 0.0, 0.0
    out = np.empty((2, len(goal)))
    for k, reference in enumerate(goal.tolist()):
        motor = (
            TORQUE_PER_VOLT * float(np.clip(gain * (reference - q), -MAX_VOLTAGE, MAX_VOLTAGE))
            - BACK_EMF * speed
        )
        load = -MASS * GRAVITY * LENGTH * np.sin(q)
        limit = max_friction(motor, load, speed)
        speed += (
            (motor + load + float(np.clip(-inertia / STEP * speed - motor - load, -limit, limit)))
            * STEP
            / inertia
        )
        q += speed * STEP
        out[:, k] = q, motor
    return out[0], out[1]


def write_recording(
    folder: Path, name: str, goal: FloatArray, gain: float, rng: np.random.Generator
) -> Path:
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    q, motor = (np.interp(t, np.arange(len(goal)) * STEP, x) for x in simulated(goal, gain))
    table = np.column_stack(
        [t, np.round(q / ENCODER_STEP) * ENCODER_STEP, motor + 0.02 * rng.normal(size=len(t))]
    )
    path = folder / f"{name}.csv"
    np.savetxt(path, table, delimiter=",", header="t,q.servo,tau.servo", comments="")
    return path


@pytest.mark.filterwarnings(f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}")
def test_load_friction_is_reported_with_static_friction(tmp_path: Path):
    t, rng = np.arange(0.0, DURATION, STEP), np.random.default_rng(0)
    chirp, waves = np.sin(t**2), 1.6 * np.sin(t) + 0.5 * np.sin(5.0 * t) * np.sin(2.0 * t)
    ramp = np.interp(t, [0.0, 3.0, 6.0], [0.0, 1.9, 0.0])
    (tmp_path / "servo.urdf").write_text(URDF, encoding="utf-8")
    machine = robot.load(str(tmp_path / "servo.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, table)
    paths = [
        [
            write_recording(tmp_path, f"{name}{gain:g}", goal, gain, rng)
            for (name, goal), gain in zip(group, (10.0, 20.0), strict=True)
        ]
        for group in ((("chirp", chirp), ("ramp", ramp)), (("waves", waves), ("back", -ramp)))
    ]
    train, validate = ([recordings.read(path, machine, table) for path in group] for group in paths)
    result = diagnosis.diagnose(
        machine, standard, base_parameters.find(machine, standard, table), train, validate
    )
    stated = diagnosis_file.document(result)
    finding = stated["findings"][0]
    assert (finding["effect"], finding["joint"]) == ("load_friction", "servo")
    # 0.22 in fast motion, 0.33 in slow motion
    assert 0.15 < finding["parameters"]["mu"]["value"] < 0.6
    assert result.held_out.rmse_after[0] < 0.65 * result.held_out.rmse_before[0]


def test_the_sign_of_a_single_joint_may_be_the_zero_of_its_position(tmp_path):
    """A motor that only carries the pendulum shows no inertia or friction to tell them apart."""
    (tmp_path / "servo.urdf").write_text(URDF)
    t = np.arange(0.0, 10.0, 1.0 / RATE)
    q = np.sin(2.0 * np.pi * 0.3 * t)
    weight = -MASS * GRAVITY * LENGTH * np.sin(q)
    noise = 0.02 * np.random.default_rng(3).normal(size=len(t))
    np.savetxt(
        tmp_path / "held.csv",
        np.column_stack([t, q, weight + noise]),
        delimiter=",",
        header="t,q.servo,tau.servo",
        comments="",
    )
    pendulum = robot.load(str(tmp_path / "servo.urdf"))
    recording = recordings.read(tmp_path / "held.csv", pendulum)
    remark = nominal_comparison.compare_with_nominal(recording, pendulum)[0]
    assert "half a turn" in remark.text and remark.doubt
