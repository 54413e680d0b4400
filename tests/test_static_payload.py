"""Static poses for a payload: their design, and the payload from recordings of them."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from identified_models import read_model, write_model
from synthetic_recordings import (
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    two_link_model,
    write_recording,
)

import excite
from excite._types import FloatArray
from excite.cli.main import main
from excite.designer.static_poses import REACH
from excite.errors import ExciteWarning, UnusableInput
from excite.identification.identified_model import BaseCovariance
from excite.identification.regression import IdentificationModel
from excite.payload.equations import payload_place
from excite.payload.static import Rests, estimate_static_payload, find_rests
from excite.recordings import Recording
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.robot.dynamics import regressor
from excite.robot.samples import Samples

ROBOT, LINK = "ur5e", "tool0"
PHI = np.array([1.2, 0.036, -0.06, 0.072])
"""Mass and first moments of the payload in the frame of the link."""
NAMES = ("mass", "centre_x", "centre_y", "centre_z")
TRUTH = np.append(PHI[0], PHI[1:] / PHI[0])
COULOMB = np.array([3.0, 4.0, 3.0, 0.8, 0.8, 0.6])
"""Coulomb friction [N m]."""
LOAD_FRICTION = 0.06


@pytest.fixture(name="result", scope="module")
def static_design():
    return excite.design_static(ROBOT, LINK, poses=5)


@pytest.fixture(name="problem", scope="module")
def identification_problem():
    machine = robot.load(ROBOT)
    table = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, table)
    base = base_parameters.find(machine, standard, table)
    model = IdentificationModel(machine, standard, base, np.full(machine.n, 0.005))
    return model, payload_place(machine, LINK)


def static_torque(problem, q: FloatArray, is_carrying: bool) -> FloatArray:
    """Torque of a robot of other links than the description at rest. Shape (N, n)."""
    model, place = problem
    psi = perturbed_parameters(model.parameters, np.random.default_rng(4))
    Y = regressor(model.robot, model.parameters, Samples(q, np.zeros_like(q), np.zeros_like(q)))
    torque = Y @ psi
    if is_carrying:
        start = 10 * place.body
        torque = torque + Y[:, :, start : start + 10] @ place.frame[:, :4] @ PHI
    return np.asarray(torque)


def rests_of(problem, poses: FloatArray, is_carrying: bool, rng, scatter: float) -> Rests:
    """Rests at poses that every joint reaches from both sides, with friction at rest."""
    q = np.repeat(poses, 2, axis=0)
    arrival = np.tile([[-1.0], [1.0]], (len(poses), poses.shape[1]))
    torque = static_torque(problem, q, is_carrying)
    friction = arrival * (COULOMB + LOAD_FRICTION * np.abs(torque))
    friction += scatter * COULOMB * rng.standard_normal(q.shape)
    offset = 0.3 * is_carrying  # the zero of the torques differs between the sessions
    return Rests("with" if is_carrying else "without", q, torque + friction + offset, arrival)


def recording_of(problem, result, is_carrying: bool, seed: int) -> Recording:
    """Recording of the designed motion with Coulomb friction that stays at rest."""
    motion = result.trajectory.motion
    t = motion.grid(250.0)
    q, dq = motion.at(t), motion.at(t, 1)
    last = np.zeros(q.shape[1])
    sign = np.empty_like(q)
    for k, speed in enumerate(dq):
        last = np.where(np.abs(speed) > 1e-6, np.sign(speed), last)
        sign[k] = last
    torque = static_torque(problem, q, is_carrying)
    torque += sign * (COULOMB + LOAD_FRICTION * np.abs(torque))
    torque += 0.1 * np.random.default_rng(seed).standard_normal(q.shape)
    return Recording(f"{seed}.csv", result.robot.joints, t, q, tau=torque, row_times=t)


# -- design ----------------------------------------------------------------------------------------


def test_the_motion_is_certified_and_rests_at_every_pose_after_arrivals_from_both_sides(result):
    assert result.ok
    motion, poses = result.trajectory.motion, result.design.poses
    t = motion.grid(100.0)
    still = np.abs(motion.at(t, 1)).max(axis=1) < 1e-9
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still, [0]])))
    rests = [(a, b) for a, b in edges.reshape(-1, 2) if t[b - 1] - t[a] > 0.9]
    assert len(rests) == 2 * len(poses)
    for k, (first, second) in enumerate(zip(rests[::2], rests[1::2], strict=True)):
        for (begin, end), sign in ((first, -1.0), (second, 1.0)):
            assert np.abs(motion.at(t[begin:end]) - poses[k]).max() < 1e-6
            before = motion.at(np.array([t[begin] - 0.1]))[0] - poses[k]
            assert np.all(-np.sign(before) == sign) and np.all(np.abs(before) < REACH)


def test_the_poses_are_better_than_random_ones_and_inertia_is_not_promised(result):
    assert result.design.efficiency > 1.3
    document = result.document()
    assert document["payload"]["inertia"] is None
    assert set(document["payload"]["not_shown"]) == {"ixx", "ixy", "iyy", "ixz", "iyz", "izz"}
    assert "not shown by static poses" in result.design.deviation.text


def test_predicted_deviations_are_those_of_any_friction_at_rest(result, problem):
    """Friction within ±F_c, evenly, in both recordings, offsets unknown: the spread of least
    squares over many draws."""
    model, place = problem
    poses, deviation = result.design.poses, result.design.deviation
    Y = regressor(
        model.robot, model.parameters, Samples(poses, np.zeros_like(poses), np.zeros_like(poses))
    )
    start = 10 * place.body
    columns = (Y[:, :, start : start + 10] @ place.frame)[:, :, :4]
    centred = (columns - columns.mean(axis=0)) / deviation.friction[:, None]
    flat = centred.reshape(-1, 4)
    rng = np.random.default_rng(2)
    # two rests in each of two recordings
    friction = rng.uniform(-1.0, 1.0, (2000, 2, 2, *poses.shape)).mean(axis=2)
    difference = (friction[:, 1] - friction[:, 0]).reshape(2000, -1)
    errors = difference @ np.linalg.pinv(flat).T
    std = errors.std(axis=0)
    # within the statistical error of the draws; the torque noise adds little
    assert deviation.mass == pytest.approx(std[0], rel=0.06)
    np.testing.assert_allclose(deviation.centre, std[1:], rtol=0.06)


def test_the_command_writes_the_files_of_a_design(tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["design", ROBOT, "--for-payload", LINK, "--static", "--poses", "4"]
    assert main([*arguments, "--no-collision", "-o", str(out), "--json", "-q"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert len(document["static"]["poses"]) == 4
    assert sorted(path.name for path in out.iterdir()) == [
        *("identifiability.json", "report.html", "trajectory.csv", "trajectory.json")
    ]
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "Moments of inertia are not shown by static poses" in report
    file = str(out / "trajectory.json")
    assert main(["verify", file]) == 0
    for name in ("ros2-joint-trajectory", "urscript", "ur-csv"):
        assert main(["export", file, "--format", name, "-o", str(tmp_path / name), "-q"]) == 0
    recording = tmp_path / "recording.csv"
    assert main(["simulate", ROBOT, file, "-o", str(recording), "-q"]) == 0
    sidecar = json.loads(recording.with_suffix(".json").read_text(encoding="utf-8"))
    assert "period" not in sidecar  # nothing repeats


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--poses", "5"], "--poses: is the number of static poses; add --static"),
        (["--static"], "--static: shows a payload; name its link with --for-payload LINK"),
        (["--static", "--for-payload", "tool0", "--time", "20"], "--time: is not available"),
        *(
            (["--static", "--for-payload", "tool0", option, value], f"{option}: is not available")
            for option, value in (
                *(("--iterations", "5"), ("--jobs", "1"), ("--parameters", "inertial")),
                *(("--threshold", "0.1"), ("--without", "offset")),
            )
        ),
        (["--static", "--for-payload", "tool0", "--criterion", "e"], "has the D-criterion"),
        (["--static", "--for-payload", "nowhere"], "no frame 'nowhere'"),
        (["--static", "--for-payload", "base_link"], "does not move"),
        (
            ["--static", "--for-payload", "tool0", "--box", "tool0:9,9.1,9,9.1,9,9.1"],
            "no 6 static poses can be reached",
        ),
    ],
)
def test_options_that_cannot_be_used_are_refused_in_one_line(options, problem, tmp_path, capsys):
    assert main(["design", ROBOT, *options, "-o", str(tmp_path / "out"), "-q"]) != 0
    error = capsys.readouterr().err
    assert problem in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


# -- estimate --------------------------------------------------------------------------------------


def test_rests_are_found_with_the_direction_of_the_arrival(result, problem):
    rests = find_rests(recording_of(problem, result, False, 1))
    np.testing.assert_allclose(rests.q, np.repeat(result.design.poses, 2, axis=0), atol=1e-4)
    assert np.all(rests.arrival[::2] == -1.0) and np.all(rests.arrival[1::2] == 1.0)


def test_mass_and_centre_are_found_and_the_inertia_is_not_shown(result, problem, tmp_path, capsys):
    files = [
        str(write_recording(recording_of(problem, result, carries, seed), tmp_path / name))
        for carries, seed, name in ((True, 1, "with.csv"), (False, 2, "without.csv"))
    ]
    arguments = ["payload", ROBOT, "--link", LINK, "--with", files[0], "--without", files[1]]
    assert main([*arguments, "--static", "-o", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    assert "10 rests with and 10 without the payload" in text
    assert "ixx       not shown by static poses" in text
    document = json.loads((tmp_path / "out" / "payload.json").read_text(encoding="utf-8"))
    for name, value in zip(NAMES, TRUTH, strict=True):
        low, high = document["payload"][name]["interval"]
        assert document["payload"][name]["shown"] and low < value < high
    assert document["payload"]["mass"]["value"] == pytest.approx(PHI[0], rel=0.01)
    assert {"ixx", "iyy", "izz"} <= set(document["not_shown"])
    friction = document["load_friction"]["shoulder_lift_joint"]
    assert friction == pytest.approx(LOAD_FRICTION, abs=0.01)


def test_intervals_cover_the_truth_with_scattered_friction(result, problem):
    model, place = problem
    covered = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        groups = [rests_of(problem, result.design.poses, c, rng, 0.1) for c in (True, False)]
        estimate = estimate_static_payload(model, place, groups[:1], groups[1:])
        covered += [
            estimate[name].interval[0] <= value <= estimate[name].interval[1]
            for name, value in zip(NAMES, TRUTH, strict=True)
        ]
    assert 0.9 < np.mean(covered) < 0.99


def test_a_model_stands_for_the_recording_without_payload(result, problem, tmp_path):
    model, place = problem
    fitted = read_model(write_model(tmp_path, ROBOT, seed=4))
    carrying = rests_of(problem, result.design.poses, True, np.random.default_rng(1), 0.02)
    estimate = estimate_static_payload(model, place, [carrying], [], identified=fitted)
    assert estimate["mass"].value == pytest.approx(PHI[0], rel=0.02)


def test_intervals_contain_the_uncertainty_of_the_model(result, problem, tmp_path):
    """Models whose base parameters differ from the truth as their covariance states."""
    model, place = problem
    exact = read_model(write_model(tmp_path, ROBOT, seed=4))
    columns = np.asarray(model.base.independent)
    rng = np.random.default_rng(8)
    root = 0.1 * rng.normal(size=(len(columns), len(columns))) / np.sqrt(len(columns))
    exact = dataclasses.replace(exact, base_covariance=BaseCovariance(columns, root @ root.T))
    covered, errors, deviations = [], [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        psi = exact.psi.copy()
        psi[columns] += root @ rng.normal(size=len(columns))
        carrying = rests_of(problem, result.design.poses, True, rng, 0.02)
        identified = dataclasses.replace(exact, psi=psi)
        estimate = estimate_static_payload(model, place, [carrying], [], identified=identified)
        errors.append([estimate[name].value - x for name, x in zip(NAMES, TRUTH, strict=True)])
        deviations.append([estimate[name].std for name in NAMES])
        covered += [
            estimate[name].interval[0] <= value <= estimate[name].interval[1]
            for name, value in zip(NAMES, TRUTH, strict=True)
        ]
    assert np.mean(covered) > 0.9
    # 60 draws show a standard deviation to 9 %
    actual = np.sqrt(np.mean(np.square(errors), axis=0))
    np.testing.assert_allclose(np.mean(deviations, axis=0), actual, rtol=0.3)


def test_the_model_file_states_the_covariance_of_its_base_parameters(tmp_path):
    subject = two_link_model()
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    recording = synthetic_recording(subject, psi, random_fourier(2, 1), 3.0, 0.1)
    identification = excite.identify("two_link", [recording])
    identification.save(tmp_path)
    read = read_model(tmp_path / "model.json").base_covariance
    identified = identification.identification
    base = identified.model.base
    expected = base.matrix @ identified.posterior.covariance @ base.matrix.T
    assert read is not None and read.columns.tolist() == list(base.independent)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs(read.matrix - expected).max() <= 1e-6 * size.max()
    np.testing.assert_allclose(read.root @ read.root.T / size, read.matrix / size, atol=1e-6)


@pytest.mark.parametrize(
    ("parameters", "matrix", "problem"),
    [
        (["m1", "nothing"], [[1.0, 0.0], [0.0, 1.0]], "name standard parameters, each once"),
        (["m1", "m1"], [[1.0, 0.0], [0.0, 1.0]], "name standard parameters, each once"),
        (["m1", "m2"], [[1.0, 0.0]], "should have 2 rows and columns"),
        (["m1", "m2"], [[1.0, 0.5], [0.4, 1.0]], "should be symmetric"),
        (["m1", "m2"], [[1.0, 2.0], [2.0, 1.0]], "correlation beyond"),
        (["m1", "m2"], [[1.0, 0.0], [0.0, -1.0]], "negative variance"),
    ],
)
def test_what_is_no_covariance_is_refused(parameters, matrix, problem, tmp_path):
    path = write_model(tmp_path, "two_link")
    content = json.loads(path.read_text(encoding="utf-8"))
    content["base_covariance"] = {"parameters": parameters, "matrix": matrix}
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(UnusableInput, match=problem):
        read_model(path)


def test_a_model_without_a_covariance_is_said_to_make_intervals_too_small(
    result, problem, tmp_path
):
    path = write_model(tmp_path, ROBOT, seed=4)
    carrying = recording_of(problem, result, True, 1)
    with pytest.warns(ExciteWarning, match="states no covariance of its parameters"):
        payload = excite.identify_payload(ROBOT, [carrying], link=LINK, model=path, static=True)
    assert payload.rests == (10, 0)
    assert payload.estimate["mass"].value == pytest.approx(PHI[0], rel=0.01)


def test_a_payload_that_was_mounted_differently_is_reported(result, problem):
    model, place = problem
    rng = np.random.default_rng(3)
    poses = result.design.poses
    first, again = (rests_of(problem, poses, True, rng, 0.05) for _ in range(2))
    empty = rests_of(problem, poses, False, rng, 0.05)
    same = estimate_static_payload(model, place, [first, again], [empty])
    start = 10 * place.body
    zero = np.zeros_like(again.q)
    Y = regressor(model.robot, model.parameters, Samples(again.q, zero, zero))
    shift = Y[:, :, start : start + 10] @ place.frame[:, :4] @ np.array([0.0, 0.06, 0.0, 0.0])
    moved = Rests("moved", again.q, again.torque + shift, again.arrival)
    other = estimate_static_payload(model, place, [first, moved], [empty])
    assert same.mounting > 0.01 > other.mounting


def test_a_recording_without_rests_is_refused(problem):
    model, place = problem
    few = Rests("moving.csv", np.zeros((1, 6)), np.zeros((1, 6)), np.zeros((1, 6)))
    with pytest.raises(UnusableInput, match=r"moving.csv: has fewer than 3 poses at rest with"):
        estimate_static_payload(model, place, [few], [few])
