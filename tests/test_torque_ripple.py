"""Torque ripple of a joint that passes few periods of two waves, as of the two stages of a gear."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from slow_tests import slow
from synthetic_recordings import sum_of_sines, write_joint_recording

import excite
from excite.diagnosis.diagnosis import Diagnosis

URDF = """<robot name="turntable"><link name="base"/>
<joint name="table" type="revolute"><parent link="base"/><child link="load"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="3" effort="28"/></joint>
<link name="load"><inertial><mass value="2"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link></robot>"""
RATE, DURATION, NOISE = 500.0, 24.0, 0.14
WAVES = {16.7: 0.27, 16.7 * 1.37: 0.16}
"""Orders [1/rad] and amplitudes [N m]; they are 1.9 widths of a peak apart."""


def record(path: Path, seed: int) -> Path:
    """Record the table, whose load is that of its own small inertia."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    omega = 2.0 * np.pi * np.arange(1, 6) / 8.0
    amplitude = np.array([0.6, 0.25, 0.15, 0.1, 0.05])
    motion = sum_of_sines(t, omega, amplitude, rng)
    scale = 0.97 / np.abs(motion[0]).max()
    q, dq, ddq = (scale * signal for signal in motion)
    torque = 0.1 * ddq + 0.3 * dq + 0.8 * np.tanh(dq / 4e-3) + NOISE * rng.normal(size=len(t))
    torque += sum(size * np.cos(order * q + order) for order, size in WAVES.items())
    return write_joint_recording(path, "table", t, q, torque)


@pytest.fixture(scope="module", params=[slow(1), 3])
def result(request, tmp_path_factory) -> excite.DiagnosisResult:
    folder = tmp_path_factory.mktemp("ripple")
    robot = folder / "turntable.urdf"
    robot.write_text(URDF, encoding="utf-8")
    files = [record(folder / f"{request.param + k}.csv", request.param + k) for k in (0, 1)]
    return excite.diagnose(robot, files[:1], files[1:])


@pytest.fixture
def diagnosis(result) -> Diagnosis:
    return result.diagnosis


def test_two_waves_of_few_periods_have_the_right_orders(diagnosis):
    waves = [e for e in diagnosis.final.effects if e.shape.effect == "torque_ripple"]
    sizes = {e.shape.values["order"]: float(np.hypot(*e.coefficients[:2])) for e in waves}
    assert sorted(sizes) == pytest.approx(sorted(WAVES), rel=0.01)
    assert [sizes[order] for order in sorted(sizes)] == pytest.approx(
        [WAVES[order] for order in sorted(WAVES)], rel=0.2
    )
    assert diagnosis.held_out.rmse_after < 1.1 * diagnosis.noise.floor


def test_all_waves_are_reported(result, tmp_path):
    ripple = next(f for f in result.findings if f["effect"] == "torque_ripple")
    (weaker,) = ripple["weaker_waves"]
    order, amplitude = sorted(WAVES.items())[1]
    assert weaker["order"] == pytest.approx(order, rel=0.01)
    assert weaker["amplitude"] == pytest.approx(amplitude, rel=0.2)
    result.save(tmp_path)
    report = (tmp_path / "report.html").read_text(encoding="utf-8").replace("\u00a0", " ")
    assert "weaker waves of order (amplitude in N m) 22." in report


def test_order_is_as_exact_as_the_recording_tells(diagnosis):
    ripple = next(e for e in diagnosis.effects if e.effect == "torque_ripple")
    order, std = ripple.parameters["order"]
    assert abs(order - 16.7) < 3.0 * std
    assert std < 0.1, "16 and 17 teeth cannot be told apart"


def test_a_joint_that_carries_little_says_nothing_about_loads(diagnosis):
    waves = [e for e in diagnosis.final.effects if e.shape.effect == "torque_ripple"]
    assert waves
    for wave in waves:  # with a load as large as its torque, it may grow by its own size or so
        growth = np.hypot(*wave.coefficients[2:]) / wave.shape.values["load"]
        assert growth < 0.5 / np.abs(diagnosis.model.motions[0].torque).max()
