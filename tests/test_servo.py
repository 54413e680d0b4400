"""A servo on a pendulum, whose gear rubs as servos' gears were measured to: more under load, and less as it turns faster.

M. Duclusaud, G. Passault, V. Padois and O. Ly, Extended friction models for the physics simulation of servo actuators, ICRA 2025; the
parameters are those published with it for an MX-106, rounded; the encoder is finer. The joint sticks as long as friction can hold it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from excite import recordings
from excite.diagnosis import diagnosis, diagnosis_file
from excite.errors import ExciteWarning
from excite.robot import base_parameters, inertial_parameters, limits, robot

Array = np.ndarray
MASS, LENGTH, ARMATURE, GRAVITY = 1.0, 0.15, 0.026, 9.81
GAIN, FEEDBACK = 1.09, 2.4
"""Torque per volt, and what it loses to speed [N m s/rad]."""
STEP, RATE, SECONDS = 2.5e-4, 200.0, 6.0
ENCODER = 2.0 * np.pi / 2**19

URDF = f"""<robot name="servo"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 {-LENGTH}"/><mass value="{MASS}"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="servo" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 -1 0"/>
<limit lower="-6.3" upper="6.3" velocity="20" effort="20"/></joint></robot>"""


def rubs(motor: float, load: float, speed: float) -> float:
    """The most that friction can hold [N m]."""
    slow = np.exp(-((abs(speed) / 1.75) ** 1.14))
    return float(
        abs(0.198 * motor - 0.022 * load)
        + slow * (0.122 + abs(0.199 * motor - 0.087 * load))
        + 0.051 * abs(speed)
    )


def swung(goal: Array, gain: float) -> tuple[Array, Array]:
    """Position and motor torque of a servo that is told to be at `goal`."""
    inertia, q, speed = MASS * LENGTH**2 + ARMATURE, 0.0, 0.0
    out = np.empty((2, len(goal)))
    for k, wanted in enumerate(goal.tolist()):
        motor = GAIN * float(np.clip(gain * (wanted - q), -15.0, 15.0)) - FEEDBACK * speed
        load = -MASS * GRAVITY * LENGTH * np.sin(q)
        most = rubs(motor, load, speed)
        speed += (
            (motor + load + float(np.clip(-inertia / STEP * speed - motor - load, -most, most)))
            * STEP
            / inertia
        )
        q += speed * STEP
        out[:, k] = q, motor
    return out[0], out[1]


def recorded(folder: Path, name: str, goal: Array, gain: float, rng: np.random.Generator) -> Path:
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    q, motor = (np.interp(t, np.arange(len(goal)) * STEP, x) for x in swung(goal, gain))
    table = np.column_stack(
        [t, np.round(q / ENCODER) * ENCODER, motor + 0.02 * rng.normal(size=len(t))]
    )
    path = folder / f"{name}.csv"
    np.savetxt(path, table, delimiter=",", header="t,q.servo,tau.servo", comments="")
    return path


@pytest.mark.filterwarnings(f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}")
def test_a_gear_that_rubs_more_under_load_is_named_though_it_sticks(tmp_path: Path):
    t, rng = np.arange(0.0, SECONDS, STEP), np.random.default_rng(0)
    chirp, waves = np.sin(t**2), 1.6 * np.sin(t) + 0.5 * np.sin(5.0 * t) * np.sin(2.0 * t)
    ramp = np.interp(t, [0.0, 3.0, 6.0], [0.0, 1.9, 0.0])
    (tmp_path / "servo.urdf").write_text(URDF, encoding="utf-8")
    machine = robot.load(str(tmp_path / "servo.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    paths = [
        [
            recorded(tmp_path, f"{name}{gain:g}", goal, gain, rng)
            for (name, goal), gain in zip(group, (10.0, 20.0), strict=True)
        ]
        for group in ((("chirp", chirp), ("ramp", ramp)), (("waves", waves), ("back", -ramp)))
    ]
    train, held_out = ([recordings.read(path, machine, table) for path in group] for group in paths)
    found = diagnosis.diagnose(
        machine, standard, base_parameters.find(machine, standard, table), train, held_out
    )
    stated = diagnosis_file.document(found)
    assert (
        stated["findings"][0]["effect"] == "load_friction"
        and stated["findings"][0]["joint"] == "servo"
    )
    assert (
        0.15 < stated["findings"][0]["parameters"]["mu"]["value"] < 0.6
    )  # 0.22 in fast motion, half as much again in slow
    assert found.after[0] < 0.65 * found.before[0]
