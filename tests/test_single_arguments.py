"""Python functions take a single path, name or recording in place of a list of one."""

from __future__ import annotations

import re
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

import excite
from excite.api import identify_payload
from excite.api.design_result import CellOptions
from excite.api.robot_check import check_robot
from excite.designer.support_design import SupportOptions
from excite.errors import UnusableInput

TRAJECTORY = Path(excite.__file__).parent.parent / "trajectories" / "two_link.json"
QUICK = {"harmonics": 2, "period": 4.0, "starts": 1, "iterations": 5, "force": True}


@pytest.fixture(scope="module", name="folder")
def folder_of_recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings of a robot with two joints."""
    folder = tmp_path_factory.mktemp("single")
    subject = two_link_model()
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    for name, seed in (("a", 2), ("b", 5), ("c", 7)):
        recording = synthetic_recording(subject, psi, random_fourier(2, seed), 3, 0.2)
        write_recording(recording, folder / f"{name}.csv")
    return folder


def estimate(result: excite.IdentificationResult) -> np.ndarray:
    """Return the identified parameters."""
    return result.identification.psi


@pytest.mark.parametrize("kind", [str, Path])
def test_identify_takes_a_single_path_or_recording(folder, kind):
    a, b = (kind(folder / f"{name}.csv") for name in "ab")
    listed = excite.identify("two_link", [a], validate=[b])
    single = excite.identify("two_link", a, validate=b)
    assert np.array_equal(estimate(single), estimate(listed))
    assert [recording.source for recording in single.validation] == [str(b)]
    robot = excite.load_robot("two_link")
    recording = excite.read_recording(a, robot)
    assert np.array_equal(estimate(excite.identify(robot, recording)), estimate(listed))
    drive = excite.identify("two_link", a, drive="viscous").identification.model.parameters.drive
    assert drive == ("viscous",)


def test_diagnose_takes_single_paths(folder):
    a, b, c = (str(folder / f"{name}.csv") for name in "abc")
    result = excite.diagnose("two_link", a, b, discriminating=c, with_report=False)
    assert [recording.source for recording in result.recordings] == [a, c]
    assert [recording.source for recording in result.validation] == [b]


def test_a_payload_is_identified_from_single_paths(folder):
    a, b = (str(folder / f"{name}.csv") for name in "ab")
    listed = identify_payload("two_link", [a], empty=[b])
    assert identify_payload("two_link", a, empty=b).html() == listed.html()


@pytest.mark.parametrize("kind", [str, Path])
def test_a_design_takes_a_single_given_path(folder, kind):
    given = kind(folder / "a.csv")
    cell = CellOptions(check=False)
    designs = [excite.design("two_link", given=g, cell=cell, **QUICK) for g in (given, [given])]
    first, second = (design.delivery.trajectory.design["given"] for design in designs)
    assert first == second == [str(given)]


def test_names_of_joints_effects_feet_and_folders_may_be_single(tmp_path):
    assert excite.load_robot("two_link", joints="joint_2").joints == ("joint_2",)
    assert check_robot("two_link", joints="joint_2").robot.joints == ("joint_2",)
    assert CellOptions(packages=tmp_path).package_folders == (str(tmp_path),)
    assert SupportOptions("left_foot", ()).frames == ("left_foot",)
    pytest.importorskip("mujoco")
    effect = "payload:joint_2:mass=0.2"
    simulated = [excite.simulate("two_link", TRAJECTORY, effects) for effects in (effect, [effect])]
    assert simulated[0].truth == simulated[1].truth


@pytest.mark.parametrize("recordings", [[], ()])
def test_a_missing_recording_is_stated(recordings):
    for fit in (excite.identify, excite.identify_servo):
        with pytest.raises(UnusableInput, match="recordings: none is given"):
            fit("two_link", recordings)
    with pytest.raises(UnusableInput, match=re.escape("recordings: none is given")):
        excite.diagnose("two_link", recordings, recordings)
