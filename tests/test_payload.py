"""Payload identification: mass, centre and inertia of a known body, with load friction hidden."""

from __future__ import annotations

import dataclasses
import json
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio as pin
import pytest
from identified_models import write_model
from synthetic_recordings import perturbed_parameters, random_fourier, write_recording

import excite
from excite.cli.main import main
from excite.designer.payload_weighting import payload_deviation
from excite.errors import UnusableInput
from excite.payload.estimate import CENTRE_DEVIATION, PayloadData, physical_payload
from excite.payload.shape import parse_shape
from excite.payload.snippets import snippets
from excite.recordings import Recording, Sidecar
from excite.robot import dynamics, inertial_parameters, limits, robot
from excite.robot.inertial_parameters import frame_map
from excite.robot.samples import Samples

WIDTH = 0.005
"""Width of friction of the recordings [rad/s]."""
PERIOD, RATE, PERIODS = 5.0, 250.0, 3
LOAD_FRICTION = 0.1
NOISE = 0.05
"""Standard deviation of the white torque noise [N m]."""
BODY = pin.Inertia(
    1.2,
    np.array([0.03, -0.05, 0.06]),
    np.diag([0.004, 0.003, 0.002]) + 2e-4 * (np.ones((3, 3)) - np.eye(3)),
)
"""The payload, in the frame of the last link."""
ROBOT = "ur5e"


def recording_with(
    body: pin.Inertia | None,
    seed: int,
    motion: int = 3,
    effort: str | None = None,
    held: int | None = None,
) -> Recording:
    """Return a recording of a robot with a payload, load friction and noise.

    The joint `held` stands still, held by most of its Coulomb friction.
    """
    machine = robot.load(ROBOT)
    table = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, table)
    psi = perturbed_parameters(standard, np.random.default_rng(4))
    if body is not None:
        psi[10 * (standard.bodies - 1) : 10 * standard.bodies] += body.toDynamicParameters()
    t = np.arange(round(PERIODS * PERIOD * RATE) + 1) / RATE
    s = random_fourier(machine.n, motion, period=PERIOD).samples(t)
    if held is not None:
        s.q[:, held], s.dq[:, held], s.ddq[:, held] = 0.3, 0.0, 0.0
    copy = machine.model.copy()
    if effort == "without gravity":
        copy.gravity.linear = np.zeros(3)
    for i in range(standard.bodies):
        copy.inertias[i + 1] = pin.Inertia.FromDynamicParameters(psi[10 * i : 10 * i + 10])
    data = copy.createData()
    rigid = np.array([pin.rnea(copy, data, *x) for x in zip(s.q, s.dq, s.ddq, strict=True)])
    sign = np.tanh(s.dq / WIDTH)
    drive = {kind: psi[standard.block(kind)] for kind in standard.drive}
    torque = rigid + drive["rotor_inertia"] * s.ddq + drive["viscous"] * s.dq
    torque += drive["coulomb"] * sign + drive["offset"] + LOAD_FRICTION * sign * np.abs(rigid)
    if held is not None:
        torque[:, held] += 0.9 * drive["coulomb"][held]
    torque += NOISE * np.random.default_rng(seed).normal(size=torque.shape)
    sidecar = Sidecar(period=PERIOD, periodic=(0.0, float(t[-1])), effort=effort)
    return Recording(
        f"{seed}.csv", machine.joints, t, s.q, tau=torque, sidecar=sidecar, row_times=t
    )


@pytest.fixture(name="empty", scope="module")
def empty_recording():
    return recording_with(None, 1)


@pytest.fixture(name="result", scope="module")
def payload_result(empty):
    return excite.identify_payload(ROBOT, [recording_with(BODY, 2)], empty=[empty])


def test_mass_centre_and_inertia_are_within_their_intervals(result):
    tensor = BODY.inertia
    truth = {
        "mass": BODY.mass,
        **dict(zip(("centre_x", "centre_y", "centre_z"), BODY.lever, strict=True)),
        "ixx": tensor[0, 0],
        "iyy": tensor[1, 1],
        "izz": tensor[2, 2],
    }
    for name, value in truth.items():
        quantity = result.estimate[name]
        assert abs(quantity.value - value) < 4.0 * quantity.std, name
    assert result.estimate["mass"].value == pytest.approx(BODY.mass, rel=0.01)
    assert result.estimate["mass"].shown and result.estimate["centre_z"].shown
    assert np.linalg.norm(result.estimate.body.lever - BODY.lever) < 3e-3
    # the wrist joints carry little: only the loaded joints show their friction
    np.testing.assert_allclose(result.estimate.load_friction[1:3], LOAD_FRICTION, atol=0.02)


def test_joint_that_stands_still_throughout_a_recording_does_not_count_there(empty):
    carrying = [recording_with(BODY, 2), recording_with(BODY, 5, 4, held=1)]
    estimate = excite.identify_payload(ROBOT, carrying, empty=[empty]).estimate
    assert (estimate.residual < NOISE).all()
    mass = estimate["mass"]
    assert abs(mass.value - BODY.mass) < 4.0 * mass.std


def test_values_are_in_the_frame_of_the_link(empty):
    there = excite.identify_payload(ROBOT, [recording_with(BODY, 2)], empty=[empty], link="tool0")
    machine = robot.load(ROBOT)
    placement = machine.model.frames[machine.frame("tool0")].placement
    expected = placement.actInv(BODY)
    assert np.linalg.norm(there.estimate.body.lever - expected.lever) < 3e-3


def test_a_frame_change_is_that_of_a_rigid_body():
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.8, 1.1), np.array([0.2, -0.1, 0.4]))
    np.testing.assert_allclose(
        frame_map(placement.homogeneous) @ BODY.toDynamicParameters(),
        placement.act(BODY).toDynamicParameters(),
        atol=1e-12,
    )


def test_moments_of_inertia_of_a_light_payload_are_not_shown(empty):
    small = pin.Inertia(0.02, np.zeros(3), 1e-6 * np.eye(3))
    result = excite.identify_payload(ROBOT, [recording_with(small, 5)], empty=[empty])
    assert not result.estimate["ixx"].shown
    assert "ixx" in result.document()["not_shown"]


@pytest.mark.slow
def test_a_payload_that_was_mounted_differently_is_reported(empty):
    turned = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi), np.zeros(3)).act(BODY)
    first = recording_with(BODY, 2)
    again = excite.identify_payload(ROBOT, [first, recording_with(BODY, 6, 4)], empty=[empty])
    other = excite.identify_payload(ROBOT, [first, recording_with(turned, 6, 4)], empty=[empty])
    assert again.mounting == "same" and other.mounting == "different"
    assert excite.identify_payload(ROBOT, [first], empty=[empty]).mounting is None


def test_a_stated_mass_and_shape_are_used(empty):
    carrying = recording_with(BODY, 2)
    free = excite.identify_payload(ROBOT, [carrying], empty=[empty])
    stated = excite.identify_payload(
        ROBOT, [carrying], empty=[empty], mass=1.2, shape="box:0.12,0.15,0.18"
    )
    assert stated.estimate["mass"].std < free.estimate["mass"].std
    assert stated.estimate["ixx"].std < free.estimate["ixx"].std
    assert stated.document()["shape"] == "box:0.12,0.15,0.18"


def test_a_stated_mass_that_the_torque_contradicts_is_said(empty, tmp_path):
    carrying = recording_with(BODY, 2)
    stated = BODY.mass / 1.1
    result = excite.identify_payload(ROBOT, [carrying], empty=[empty], mass=stated)
    by_torque = result.document()["mass_by_torque"]
    assert abs(by_torque["value"] - BODY.mass) < 4.0 * by_torque["std"]
    page = result.html()
    assert "not the stated" in page and "% too large" in page
    right = excite.identify_payload(ROBOT, [carrying], empty=[empty], mass=BODY.mass)
    assert right.other_mass is None and "not the stated" not in right.html()


def test_torque_without_gravity_shows_the_payload_by_its_inertia():
    carrying, bare = (
        recording_with(body, seed, effort="without gravity")
        for body, seed in ((BODY, 2), (None, 1))
    )
    mass = excite.identify_payload(ROBOT, [carrying], empty=[bare]).estimate["mass"]
    assert abs(mass.value - BODY.mass) < 4.0 * mass.std
    assert mass.shown and mass.std < 0.1


def test_torque_without_gravity_is_not_mixed_with_torque_with_it(empty):
    carrying = recording_with(BODY, 2, effort="without gravity")
    with pytest.raises(UnusableInput, match=r"2.csv: holds torque without gravity but 1.csv does"):
        excite.identify_payload(ROBOT, [carrying], empty=[empty])


def test_torque_in_another_unit_is_doubted(empty, tmp_path, capsys):
    files = []
    for recording in (recording_with(BODY, 2), empty):
        wrong = dataclasses.replace(recording, tau=1e3 * recording.torque)
        files.append(str(write_recording(wrong, tmp_path / recording.source)))
    arguments = ["payload", ROBOT, "--with", files[0], "--without", files[1]]
    assert main([*arguments, "-o", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr()
    assert shown.err.count("is it in mN m, not N m?") > 1
    assert "do not use this payload: the recordings are doubted" in shown.out
    document = json.loads((tmp_path / "out" / "payload.json").read_text(encoding="utf-8"))
    assert {doubt["recording"] for doubt in document["doubts"]} == set(files)
    assert "Do not use this payload" in (tmp_path / "out" / "report.html").read_text("utf-8")


def test_recordings_of_a_model_are_those_in_its_folder(empty, tmp_path, monkeypatch):
    carrying = recording_with(BODY, 2)
    (tmp_path / "model").mkdir()
    model = write_model(tmp_path / "model", ROBOT)  # of monday.csv
    write_recording(carrying, tmp_path / "monday.csv")  # another recording of this name
    there = write_recording(empty, tmp_path / "model" / "monday.csv")
    monkeypatch.chdir(tmp_path)
    result = excite.identify_payload(ROBOT, [carrying], model=model)
    assert result.document()["without"] == [str(there)]
    assert result.estimate["mass"].value == pytest.approx(BODY.mass, rel=0.01)


def test_a_recording_of_a_model_may_be_a_folder(tmp_path):
    model = write_model(tmp_path, ROBOT)
    (tmp_path / "monday.csv").mkdir()
    with pytest.raises(UnusableInput, match=r"monday.csv: is a folder without metadata.yaml"):
        excite.identify_payload(ROBOT, [recording_with(BODY, 2)], model=model)


def test_the_band_is_one_that_a_slow_recording_without_payload_permits(empty):
    slow = dataclasses.replace(empty.rows(slice(None, None, 10)), row_times=empty.t[::10])
    result = excite.identify_payload(ROBOT, [recording_with(BODY, 2)], empty=[slow])
    assert result.hertz <= 0.4 * slow.rate
    assert result.estimate["mass"].value == pytest.approx(BODY.mass, rel=0.02)


def test_a_recording_is_named_once(empty):
    carrying = recording_with(BODY, 2)
    again = dataclasses.replace(carrying, source="copy.csv")
    with pytest.raises(UnusableInput, match=r"copy.csv: is the same recording as 2.csv and"):
        excite.identify_payload(ROBOT, [carrying, again], empty=[empty])


def test_shapes_have_the_moments_of_uniform_bodies(tmp_path):
    box, cylinder = parse_shape("box:0.1,0.2,0.3"), parse_shape("cylinder:0.1,0.4@0,0,0.2")
    np.testing.assert_allclose(np.diag(box.second), np.array([0.1, 0.2, 0.3]) ** 2 / 12.0)
    np.testing.assert_allclose(np.diag(cylinder.second), [0.0025, 0.0025, 0.16 / 12.0])
    np.testing.assert_allclose(cylinder.centre, [0.0, 0.0, 0.2])
    corners = np.array([[x, y, z] for x in (0, 0.1) for y in (0, 0.2) for z in (0, 0.3)])
    faces = [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
    mesh = tmp_path / "box.obj"
    mesh.write_text("\n".join(lines), encoding="utf-8")
    shape = parse_shape(f"mesh:{mesh}")
    np.testing.assert_allclose(shape.second, box.second, atol=1e-9)
    np.testing.assert_allclose(shape.centre, [0.05, 0.1, 0.15], atol=1e-7)


@pytest.mark.parametrize("text", ["box:1,2", "cone:1", "box:1,2,-3", "sphere:x", "box:1,1,1@0,0"])
def test_a_shape_that_is_none_is_refused(text):
    with pytest.raises(UnusableInput, match=r"--shape .*: should be box:X,Y,Z"):
        parse_shape(text)


def test_snippets_hold_the_payload_in_the_units_of_each_controller():
    texts = snippets(BODY, "tool0")
    ur = re.search(r"set_target_payload\((.*)\)", texts["UR: set_target_payload"])
    numbers = [float(x) for x in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", ur[1])]
    np.testing.assert_allclose(numbers[:4], [1.2, 0.03, -0.05, 0.06])
    np.testing.assert_allclose(numbers[4:7], [0.004, 0.003, 0.002], rtol=1e-5)
    kuka = texts["KUKA: load data"]
    assert "X 30," in kuka and "Y -50," in kuka and "Z 60," in kuka
    axes = {k: float(re.search(rf"[ ,{{]{k} (-?[\d.e-]+)", kuka)[1]) for k in "ABC"}
    R = pin.rpy.rpyToMatrix(*np.deg2rad([axes["C"], axes["B"], axes["A"]]))
    moments = [float(x) for x in re.search(r"J \{X (.*),Y (.*),Z (.*)\}\}", kuka).groups()]
    np.testing.assert_allclose(R @ np.diag(moments) @ R.T, BODY.inertia, atol=1e-8)
    desk = json.loads(texts["Franka: setLoad and Desk"].splitlines()[-1])
    assert desk["mass"] == 1.2 and desk["centerOfMass"] == [0.03, -0.05, 0.06]
    link = ElementTree.fromstring(texts["URDF"].splitlines()[0])
    assert float(link.find("inertial/mass").get("value")) == 1.2
    body = ElementTree.fromstring(texts["MJCF"].splitlines()[1])
    assert body.find("inertial").get("pos") == "0.03 -0.05 0.06"


def test_the_command_writes_payload_json_and_a_report(empty, tmp_path, capsys):
    files = [
        str(write_recording(recording, tmp_path / name))
        for recording, name in ((recording_with(BODY, 2), "with.csv"), (empty, "without.csv"))
    ]
    out = tmp_path / "out"
    arguments = ["payload", ROBOT, "--with", files[0], "--without", files[1], "-o", str(out)]
    assert main([*arguments, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["payload"]["mass"]["value"] == pytest.approx(1.2, rel=0.01)
    stored = json.loads((out / "payload.json").read_text(encoding="utf-8"))
    assert stored["schema"] == "excite.payload/1"
    assert "set_target_payload" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ([], "--without: needs a recording without the payload"),
        (["--without", "gone.csv"], "gone.csv"),
        (["--without", "gone.csv", "--link", "nowhere"], "no frame 'nowhere'"),
        (["--without", "gone.csv", "--shape", "egg:1"], "--shape egg:1"),
        (["--model", "gone.json"], "gone.json"),
    ],
)
def test_options_that_cannot_be_used_are_refused_in_one_line(options, problem, tmp_path, capsys):
    arguments = ["payload", ROBOT, "--with", "also_gone.csv", *options]
    assert main([*arguments, "-o", str(tmp_path / "out"), "-q"]) == 2
    error = capsys.readouterr().err
    assert problem in error and error.count("\n") == 1


# -- design ----------------------------------------------------------------------------------------


def test_a_motion_for_a_payload_beats_a_wrist_wiggle():
    machine = robot.load(ROBOT)
    table = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, table)
    noise = 0.01 * table.torque
    result = excite.design(
        ROBOT, payload_link="tool0", period=5.0, harmonics=3, starts=1, jobs=1, iterations=60
    )
    designed = result.payload
    assert designed is not None and result.document()["payload"]["mass"] == designed.mass
    t = np.arange(0.0, result.trajectory.motion.duration, 0.01)
    amplitude = np.array([0.0, 0.0, 0.0, 0.5, 0.5, 0.5])
    rate = 2.0 * np.pi * np.array([0.0, 0.0, 0.0, 0.4, 0.6, 0.8])
    q = np.outer(np.ones_like(t), [0.0, -1.2, 1.2, -1.5, -1.5, 0.0]) + amplitude * np.sin(
        np.outer(t, rate)
    )
    wiggle = Samples(
        q,
        amplitude * rate * np.cos(np.outer(t, rate)),
        -amplitude * rate**2 * np.sin(np.outer(t, rate)),
    )
    other = payload_deviation(machine, standard, wiggle, noise, "tool0")
    assert designed.mass < other.mass / 3.0
    assert np.all(designed.centre < other.centre / 3.0)
    assert designed.metric < other.metric / 3.0


def test_predicted_deviations_are_those_of_least_squares():
    """The deviation of a coefficient is the noise over the length of its column without the part
    that the other columns explain (Frisch & Waugh 1933)."""
    machine = robot.load(ROBOT)
    table = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, table)
    motion = random_fourier(machine.n, 3).samples(np.arange(0.0, 5.0, 0.02))
    noise = 0.01 * table.torque
    link = machine.links[-1]
    predicted = payload_deviation(machine, standard, motion, noise, link)
    Y = dynamics.regressor(machine, standard, motion) / noise[:, None]
    edge = 10 * standard.bodies
    shown = [*range(edge - 10, edge), *range(edge + machine.n, standard.count)]
    columns = Y.reshape(-1, standard.count)[:, shown]
    std = np.empty(10)
    for k in range(10):
        others = np.delete(columns, k, axis=1)
        others = others / np.linalg.norm(others, axis=0)
        fit = np.linalg.lstsq(others, columns[:, k], rcond=None)[0]
        std[k] = 1.0 / np.linalg.norm(columns[:, k] - others @ fit)
    assert predicted.mass == pytest.approx(std[0], rel=1e-3)
    np.testing.assert_allclose(predicted.inertia, std[4:], rtol=1e-3)


def test_options_of_a_design_for_a_payload_are_checked(tmp_path, capsys):
    for options, problem in (
        (["--for-payload", "nowhere"], "no frame 'nowhere'"),
        (["--for-payload", "tool0", "--criterion", "d"], "--for-payload: has the A-criterion"),
        (["--for-payload", "base_link"], "does not move"),
        (["--for-payload", "tool0", "--for", "a.csv"], "--for and --for-payload are two criteria"),
        (
            ["--for-payload", "tool0", "--discriminate", "diagnosis.json"],
            "--discriminate and --for-payload are two criteria",
        ),
    ):
        assert main(["design", ROBOT, *options, "-o", str(tmp_path / "out"), "-q"]) == 2
        error = capsys.readouterr().err
        assert problem in error and error.count("\n") == 1


def test_a_stated_centre_is_known_to_its_deviation_and_says_nothing_of_the_mass():
    shape = parse_shape("box:0.3,0.3,0.3@0,0,0.1")
    rng = np.random.default_rng(0)
    spread = np.array([0.05, 0.1, 0.1, 0.1])  # of the data: mass [kg] and first moments [kg m]
    information = np.zeros((10, 10))
    information[range(4), range(4)] = spread**-2.0
    errors = []
    for _ in range(100):
        centre = shape.centre + CENTRE_DEVIATION * rng.normal(size=3)
        body = pin.Inertia(2.0, centre, 0.03 * np.eye(3))
        measured = body.toDynamicParameters()
        measured[:4] += spread * rng.normal(size=4)
        estimate = physical_payload(PayloadData(measured, information, 1e4), shape)
        assert estimate["mass"].std == pytest.approx(0.05, rel=0.02)
        centres = [estimate[f"centre_{axis}"] for axis in "xyz"]
        errors.append([(q.value - c) / q.std for q, c in zip(centres, centre, strict=True)])
    np.testing.assert_allclose(np.std(errors), 1.0, atol=0.15)
