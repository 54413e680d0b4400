"""The trajectories that come with the repository still hold, recomputed from their files."""

from pathlib import Path

import pytest

from excite import artefact, robot, verify

FOLDER = Path(__file__).resolve().parent.parent / "trajectories"


def test_every_built_in_robot_has_one():
    assert {path.stem for path in FOLDER.glob("*.json")} == set(robot.builtin_names())


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.json")), ids=lambda p: p.stem)
def test_it_keeps_its_certificate(path):
    trajectory = artefact.read(path)
    certificate = verify.of_file(trajectory, trajectory.load_robot())
    assert certificate.ok, (certificate.worst(), certificate.faults)
    assert certificate.clearance is verify.Verdict.CERTIFIED
    assert not trajectory.forced
