"""The stored trajectories keep all limits, recomputed from their files."""

from pathlib import Path

import pytest
from conftest import verified

from excite.designer import certificate as certificate_module
from excite.robot import robot
from excite.trajectory import trajectory_file

FOLDER = Path(__file__).resolve().parent.parent / "trajectories"


def test_every_built_in_robot_has_a_trajectory():
    assert {path.stem for path in FOLDER.glob("*.json")} == set(robot.builtin_names())


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.json")), ids=lambda p: p.stem)
def test_stored_trajectory_is_certified(path):
    trajectory = trajectory_file.read_trajectory(path)
    certificate = verified(trajectory)
    assert certificate.ok, (certificate.worst(), certificate.faults)
    assert certificate.clearance is certificate_module.CertificateVerdict.CERTIFIED
    assert not trajectory.forced
