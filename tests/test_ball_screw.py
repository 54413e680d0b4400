"""Torque ripple of a sliding joint, whose period is a length and not a part of a turn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from synthetic_recordings import sum_of_sines, write_joint_recording

import excite

URDF = """<robot name="slide"><link name="base"/>
<joint name="carriage" type="prismatic"><parent link="base"/><child link="load"/>
<axis xyz="1 0 0"/><limit lower="0" upper="0.3" velocity="0.5" effort="400"/></joint>
<link name="load"><inertial><mass value="80"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>"""
LEAD, RATE, DURATION, NOISE = 5e-3, 1000.0, 25.0, 0.5
AMPLITUDE = 3.0


def record(path: Path, seed: int) -> Path:
    """Record a carriage of 100 kg on a ball screw whose force has a wave per turn of the screw."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    omega = 2.0 * np.pi * np.arange(1, 6) / DURATION
    amplitude = 0.11 * np.array([0.5, 0.2, 0.15, 0.1, 0.05])
    offset, dq, ddq = sum_of_sines(t, omega, amplitude, rng)
    q = 0.15 + offset
    force = 100.0 * ddq + 200.0 * dq + 20.0 * np.tanh(dq / 1e-3)
    force += AMPLITUDE * np.cos(2.0 * np.pi * q / LEAD + 0.7) + NOISE * rng.normal(size=len(t))
    return write_joint_recording(path, "carriage", t, q, force)


def test_the_wave_of_a_ball_screw_is_found(tmp_path):
    robot = tmp_path / "slide.urdf"
    robot.write_text(URDF, encoding="utf-8")
    train, held_out = (record(tmp_path / f"{seed}.csv", seed) for seed in (1, 2))
    result = excite.diagnose(robot, [train], [held_out]).diagnosis
    (ripple,) = (f for f in result.findings if f.effect == "torque_ripple")
    order, _ = ripple.parameters["order"]
    assert order == pytest.approx(2.0 * np.pi / LEAD, rel=1e-3)
    assert ripple.parameters["amplitude"][0] == pytest.approx(AMPLITUDE, rel=0.1)
    assert result.held_out.rmse_after < 0.3 * result.held_out.rmse_before
