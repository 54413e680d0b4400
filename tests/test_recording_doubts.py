"""Recordings with the faults that real ones have: each is named, repaired where that is safe, and
otherwise doubted; clean recordings raise no doubt."""

from __future__ import annotations

import dataclasses
import json
import os
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from conftest import BUILTIN, document, link
from conftest import joint as joint_element
from diagnosis_cases import PSI, SUBJECT, recordings_of
from recording_fixtures import (
    read_with_warnings,
    remark_kinds,
    two_joint_motion,
    write_columns,
)
from shared_inputs import INPUTS, needs_inputs
from slow_tests import slow
from synthetic_recordings import random_fourier, synthetic_recording, write_recording

from excite import api, recordings
from excite.api.identification_result import read_both
from excite.cli.main import main
from excite.errors import UnusableInput
from excite.identification import nominal_comparison, torque_check
from excite.identification.exchanged_torque import find_exchange
from excite.recordings import Recording, RemarkKind
from excite.robot.dynamics import inverse_dynamics
from excite.robot.limits import resolve
from excite.robot.robot import Robot, load
from excite.robot.samples import Samples

REPORTS = Path() if INPUTS is None else INPUTS / "reports"
CLEAN_ERROR = {"two_link": (0.0051, 0.0110)}
"""Relative errors at the joints on `two_link_heldout.csv` after a fit to clean data [1]."""
REAL = (
    Path(os.environ.get("EXCITE_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    / "recordings"
)
UR5E_ERROR = 0.05
"""Largest relative error at a joint of the UR5e after a fit to clean data [1]."""


def identified(robot: str, *paths: Path, validate: Path):
    """Return the identification and the texts of its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = api.identify(robot, list(paths), validate=[validate])
    return result, [str(entry.message) for entry in caught]


def checked_with_warnings(path: Path, name: str) -> tuple[Recording, list[str]]:
    """Return a recording after the check stage, and the texts of its warnings."""
    robot = load(name)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_both(robot, resolve(robot), [path], [])[0][0]
    return recording, [str(entry.message) for entry in caught]


def checked(path: Path, name: str) -> Recording:
    """Return a recording after the check stage, without its warnings."""
    return checked_with_warnings(path, name)[0]


# -- faults that are repaired ---------------------------------------------------------------------


@needs_inputs
@pytest.mark.parametrize(
    ("name", "kind", "parts"),
    [
        ("04-wrap_zero_twopi.csv", RemarkKind.WRAPPED, ["joint_1", "whole turn", "unwrapped"]),
        ("04-wrap_turn.csv", RemarkKind.WRAPPED, ["joint_1", "shifted by -1 turn"]),
        ("03-clockstep_step_-0.100.csv", RemarkKind.CLOCK_STEP, ["back by 0.1 s", "10.396"]),
        ("03-clockstep_step_-0.020.csv", RemarkKind.CLOCK_STEP, ["back by 0.02 s", "10.396"]),
        ("21-glitch_pos_zero.csv", RemarkKind.GLITCH, ["joint_1", "10 readings", "velocity limit"]),
        ("bag_jsp_zero", RemarkKind.PUBLISHER, ["1079 messages", "second publisher"]),
        ("bag_eff_late1", RemarkKind.PUBLISHER, ["1 messages", "without effort"]),
        ("bag_arm_late", RemarkKind.SKIPPED, ["200 messages"]),
        ("bag_split", RemarkKind.PUBLISHER, ["merged in time"]),
    ],
)
def test_repaired_faults_cost_no_accuracy(name, kind, parts):
    if name.startswith("bag"):
        pytest.importorskip("rosbags", reason="bags need pip install 'excite[bags]'")
    result, texts = identified(
        "two_link", REPORTS / name, validate=REPORTS / "two_link_heldout.csv"
    )
    remark = next(r for r in result.recordings[0].remarks if r.kind is kind)
    assert remark.repaired and all(part in remark.text for part in parts)
    assert any(remark.text in text for text in texts)
    assert not result.recordings[0].doubts
    assert not any("off their stamps" in text or "timing error" in text for text in texts)
    error = result.identification.validations[0].relative()
    # of four periods, the one that a clock step interrupts is lost
    assert (error < 1.35 * np.array(CLEAN_ERROR["two_link"])).all()


@needs_inputs
def test_positions_wrapped_to_half_turns_are_unwrapped():
    result, texts = identified(
        "ur5e", REPORTS / "04-wrap_ur_mon.csv", validate=REPORTS / "04-wrap_ur_tue.csv"
    )
    assert sum("whole turn" in text for text in texts) == 5
    assert (result.identification.validations[0].relative() < UR5E_ERROR).all()


def test_unix_times_are_legible_in_remarks(two_link, tmp_path):
    columns = two_joint_motion()
    columns["t"] += 1_765_000_000.0
    columns["q.joint_1"][250] = 2.5
    _, texts = read_with_warnings(write_columns(tmp_path / "r.csv", columns), two_link)
    assert "at 1765000002.5 s) is removed as glitch" in texts[0]


def test_a_single_wrong_reading_of_a_joint_at_rest_is_a_glitch(two_link, tmp_path):
    columns = two_joint_motion()
    columns["q.joint_2"][:] = 0.25
    columns["q.joint_2"][250] = -3.0
    recording, texts = read_with_warnings(write_columns(tmp_path / "r.csv", columns), two_link)
    assert "joint_2" in texts[0] and "removed as glitch" in texts[0]
    assert np.ptp(recording.q[:, 1]) == 0.0


def test_steps_of_a_coarse_encoder_are_no_glitches(two_link, tmp_path):
    """Alternate between two values at rest: a step every third row, faster than any motion."""
    columns = two_joint_motion()
    columns["q.joint_2"] = 0.25 + 0.5 * (np.arange(400) % 3 == 0)
    recording, _ = read_with_warnings(write_columns(tmp_path / "r.csv", columns), two_link)
    assert RemarkKind.GLITCH not in remark_kinds(recording)


@pytest.mark.parametrize("directions", [(1,), (1, -1)])
@pytest.mark.parametrize("count", [4, 8])
def test_flickers_by_one_step_of_an_encoder_are_no_glitches(count, directions, two_link, tmp_path):
    """A joint at rest between two steps of 9 bits a turn, at 1 kHz: 12 rad/s from row to row."""
    columns = two_joint_motion(4000, 1000.0)
    step = 2.0 * np.pi / 512
    columns["q.joint_2"][:] = 40 * step
    columns["dq.joint_2"][:] = 0.0
    rows = np.random.default_rng(count).choice(np.arange(10, 3990, 3), count, replace=False)
    columns["q.joint_2"][rows] += step * np.resize(directions, count)
    recording, _ = read_with_warnings(write_columns(tmp_path / "r.csv", columns), two_link)
    assert RemarkKind.GLITCH not in remark_kinds(recording)
    columns["q.joint_2"][rows[0]] = -1.0  # a wrong reading among them
    _, texts = read_with_warnings(write_columns(tmp_path / "r.csv", columns), two_link)
    assert any("joint 'joint_2': 1 reading of q (the first -1" in text for text in texts)


@pytest.mark.parametrize(("position", "wrong"), [(0.01, 0.0), (0.25, 0.75)])
def test_wrong_readings_of_one_value_are_glitches(position, wrong, two_link, tmp_path):
    columns = two_joint_motion(4000, 1000.0)
    columns["q.joint_2"][:] = position
    columns["dq.joint_2"][:] = 0.0
    columns["q.joint_2"][[500, 1500, 2500, 3500]] = wrong
    _, texts = read_with_warnings(write_columns(tmp_path / "r.csv", columns), two_link)
    assert any("4 readings" in text and "glitches" in text for text in texts)


def test_a_row_in_which_all_positions_are_wrong_is_removed(two_link, tmp_path):
    """Write the zeros of a failed reading into one row, as drivers of servos do."""
    columns = two_joint_motion()
    whole, _ = read_with_warnings(write_columns(tmp_path / "whole.csv", columns), two_link)
    for name, values in columns.items():
        if name != "t":
            values[250] = -np.pi if name.startswith("q.") else 0.0
    recording, texts = read_with_warnings(write_columns(tmp_path / "r.csv", columns), two_link)
    assert "1 row (the first at 2.5 s) is removed as failed" in texts[0]
    assert sum("removed" in text for text in texts) == 1
    assert len(recording.t) == len(whole.t)
    assert np.abs(recording.tau[250] - whole.tau[250]).max() < 0.05


def test_degrees_are_neither_unwrapped_nor_glitches(two_link, tmp_path):
    t = np.arange(500) / 30.0
    q = np.degrees(np.column_stack([2.5 * np.sin(t), np.cos(t)]))
    path = tmp_path / "r.csv"
    rows = np.column_stack([t, q])
    path.write_text(
        "t,q.joint_1,q.joint_2\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in rows)
    )
    with pytest.raises(UnusableInput, match="in degrees"):
        recordings.read(path, two_link)


# -- faults that are doubted or refused -----------------------------------------------------------


@needs_inputs
@pytest.mark.parametrize(
    ("name", "robot", "kind", "joints", "parts"),
    [
        ("05-units_i_mA.csv", "two_link", RemarkKind.TORQUE_SCALE, 2, ["1e+3", "mA"]),
        ("05-units_tau2_flipped.csv", "two_link", RemarkKind.TORQUE_SIGN, 1, ["joint_2", "-1.1"]),
        ("11-sign_all_tau_mon.csv", "ur5e", RemarkKind.TORQUE_SIGN, 5, ["inverted"]),
        ("07-gravcomp_mon.csv", "ur5e", RemarkKind.GRAVITY, 1, ["missing", "without gravity"]),
        ("07-gravcomp_tue.csv", "ur5e", RemarkKind.GRAVITY, 1, ["missing", "without gravity"]),
        ("../r_tau_million.csv", "two_link", RemarkKind.TORQUE_SCALE, 2, ["1e+6"]),
        ("../r_tau_flipped.csv", "two_link", RemarkKind.TORQUE_SIGN, 2, ["-1."]),
        ("../r_tau1_zero.csv", "two_link", RemarkKind.FROZEN, 1, ["joint_1", "torque is 0"]),
    ],
)
def test_doubts_are_named_with_their_figure(name, robot, kind, joints, parts):
    doubts = [r for r in checked(REPORTS / name, robot).doubts if r.kind is kind]
    assert len(doubts) == joints
    assert all(part in doubts[-1].text for part in parts)


@needs_inputs
@pytest.mark.parametrize("day", ["mon", "tue"])
def test_inverted_torque_that_the_nominal_model_shows_in_part_is_refused(day):
    with (
        pytest.warns(match="its sign is inverted"),
        pytest.raises(
            UnusableInput, match=r"joint 'wrist_\d_joint': .* friction feeds in .* turn it"
        ),
    ):
        api.identify("ur5e", [REPORTS / f"11-sign_all_tau_{day}.csv"])


@needs_inputs
def test_inverted_torque_that_the_nominal_model_shows_at_every_joint_is_warned_of(capsys, tmp_path):
    path = REPORTS / "../r_tau_flipped.csv"
    assert main(["identify", "two_link", str(path), "-o", str(tmp_path / "out")]) == 0
    out, err = capsys.readouterr()
    for joint in ("joint_1", "joint_2"):
        assert f"joint '{joint}': measured torque is -1." in err
    assert "do not use this model" in out and "torque sign" in out
    model = json.loads((tmp_path / "out" / "model.json").read_text())
    assert [doubt["joint"] for doubt in model["doubts"]] == ["joint_1", "joint_2"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.index("the recordings are doubted") < page.index("Does it predict")
    predicted = tmp_path / "torque.csv"
    model_path = str(tmp_path / "out" / "model.json")
    assert (
        main(["predict", model_path, str(REPORTS / "two_link_heldout.csv"), "-o", str(predicted)])
        == 0
    )


@needs_inputs
@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("r_tau_zero", ["torque of every joint is 0"]),
        ("r_one_cell_1e308", ["row 1002", "tau.joint_1"]),
        ("r_cr_only", ["carriage return"]),
        ("r_t_tiny", ["2e-12 s"]),
        ("r_tau_1e200", ["row 2", "tau.joint_1"]),
        ("r_side_window_1ns", ["periodic", "1e-09"]),
        ("r_side_gain_nobody", ["drive_gain", "nobody"]),
        ("r_side_period_1e308", ["period", "1e+308"]),
    ],
)
def test_recordings_that_hold_no_measurement_are_refused(capsys, tmp_path, name, parts):
    path = REPORTS / ".." / f"{name}.csv"
    assert main(["identify", "two_link", str(path), "-o", str(tmp_path / "out")]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("excite: ")]
    assert all(part in line for part in parts)
    assert not (tmp_path / "out").exists()


@needs_inputs
def test_the_period_of_a_plan_that_ran_slower_is_corrected(capsys, tmp_path):
    """The sidecar states 85 % of the period with which the motion repeats."""
    path = tmp_path / "run.csv"
    path.write_bytes((REPORTS / "two_link_heldout.csv").read_bytes())
    path.with_suffix(".json").write_text('{"schema": "excite.recording/1", "period": 4.42}')
    result, texts = identified("two_link", path, validate=REPORTS / "04-wrap_turn.csv")
    assert any("repeats after 5.2 s" in text and "85 %" in text for text in texts)
    assert (result.identification.validations[0].relative() < 0.02).all()


@needs_inputs
def test_torque_without_gravity_is_identified_if_stated(tmp_path):
    paths = []
    for day in ("mon", "tue"):
        path = tmp_path / f"{day}.csv"
        path.write_bytes((REPORTS / f"07-gravcomp_{day}.csv").read_bytes())
        stated = json.loads((REPORTS / f"07-gravcomp_{day}.json").read_text(encoding="utf-8"))
        path.with_suffix(".json").write_text(json.dumps({**stated, "effort": "without gravity"}))
        paths.append(path)
    result, texts = identified("ur5e", paths[0], validate=paths[1])
    assert not texts and not result.recordings[0].doubts
    identification = result.identification
    assert (identification.validations[0].relative() < 0.07).all()
    assert identification.analysis.identifiable_count > 30
    complete = REPORTS / "04-wrap_ur_tue.csv"
    with (
        pytest.warns(match="whole turn"),
        pytest.raises(UnusableInput, match="identify them apart"),
    ):
        api.identify("ur5e", [paths[0]], validate=[complete])


# -- comparison with the nominal model ------------------------------------------------------------


@pytest.fixture(scope="module")
def simulated() -> tuple[Recording, Robot]:
    """A clean recording of a UR5e whose bodies differ from the nominal ones, and its robot."""
    if INPUTS is None:
        pytest.skip("the shared inputs are absent")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        robot = load("ur5e")
        return recordings.read(REPORTS / "04-wrap_ur_mon.csv", robot), robot


def exchanged(recording: Recording, first: int, second: int, *quantities: str) -> Recording:
    """Return the recording with the columns of two joints exchanged."""
    order = list(range(len(recording.joints)))
    order[first], order[second] = second, first
    return dataclasses.replace(
        recording, **{name: getattr(recording, name)[:, order] for name in quantities}
    )


@pytest.mark.parametrize(("first", "second"), [(0, 1), (1, 2), (2, 3)])
@pytest.mark.parametrize("quantities", [("tau",), ("q", "tau")])
def test_exchanged_joints_are_named(simulated, first, second, quantities):
    recording, robot = simulated
    doubts = nominal_comparison.compare_with_nominal(
        exchanged(recording, first, second, *quantities), robot
    )
    assert [d.kind for d in doubts] == [RemarkKind.EXCHANGED]
    assert robot.joints[first] in doubts[0].text and robot.joints[second] in doubts[0].text


def test_exchanged_torques_are_named_where_the_robot_description_is_poor():
    """The centres of mass of both links are turned by 40° in the robot description."""
    model = SUBJECT.robot.model.copy()
    turn = pin.exp3(np.array([0.0, np.radians(40.0), 0.0]))
    for i in (1, 2):
        body = model.inertias[i]
        model.inertias[i] = pin.Inertia(body.mass, turn @ body.lever, body.inertia)
    robot = dataclasses.replace(SUBJECT.robot, model=model)
    recording = recordings_of(None)[0]
    assert not torque_check.check_torque(recording, robot, resolve(robot)).remarks
    with pytest.warns(match="if their torques are exchanged"):
        changed = exchanged(recording, 0, 1, "tau")
        (doubt,) = torque_check.check_torque(changed, robot, resolve(robot)).doubts
    assert doubt.kind is RemarkKind.EXCHANGED and "'joint_1' and 'joint_2'" in doubt.text


def test_a_torque_that_is_recorded_twice_is_no_exchange():
    """The copy belongs to the other joint, but the noisy original does not belong to its joint."""
    fourier = random_fourier(2, 5)
    moving = np.array([[1.0], [0.0]])
    fourier = dataclasses.replace(
        fourier, sine=moving * fourier.sine, cosine=moving * fourier.cosine
    )
    recording = synthetic_recording(SUBJECT, PSI, fourier, 4.0, 0.02, 200.0)
    motion, first = fourier.samples(recording.t), recording.torque[:, 0]
    noise = 0.3 * first.std() * np.random.default_rng(5).normal(size=len(first))
    torque = np.column_stack([first + noise, first])
    assert find_exchange(SUBJECT.robot, motion, torque, 1.0) is None
    recorded = np.column_stack([first + noise, recording.torque[:, 1]])
    exchange = find_exchange(SUBJECT.robot, motion, recorded[:, ::-1], 1.0)
    assert exchange is not None and (exchange.first, exchange.second) == (0, 1)


@pytest.mark.parametrize(("first", "second"), [(4, 5), (1, 2)])
def test_exchanged_torques_of_a_real_robot_are_named(first, second):
    if not (REAL / "tx40").is_dir():
        pytest.skip(f"no real recordings at {REAL / 'tx40'}")
    robot = load(str(REAL / "tx40" / "tx40.urdf"))
    recording = recordings.read(REAL / "tx40" / "train.csv", robot)
    with pytest.warns(match="if their torques are exchanged"):
        changed = exchanged(recording, first, second, "tau")
        (doubt,) = torque_check.check_torque(changed, robot, resolve(robot)).doubts
    assert doubt.kind is RemarkKind.EXCHANGED
    assert robot.joints[first] in doubt.text and robot.joints[second] in doubt.text


def test_gravity_is_not_missed_at_joints_whose_torque_is_zero(simulated):
    """Their drives stand still within their friction, or nobody measured them."""
    recording, _ = simulated
    tau = recording.tau.copy()
    tau[:, [2, 3]] = 0.0
    still = dataclasses.replace(recording, tau=tau)
    remarks = nominal_comparison.compare_with_nominal(still, load("ur5e"))
    assert RemarkKind.GRAVITY not in {remark.kind for remark in remarks}


def test_torque_without_its_sign_is_warned_of(simulated):
    """Servos state the magnitude of their current; a load holds one joint, but not all."""
    recording, robot = simulated
    limits, magnitude = resolve(robot), np.abs(recording.torque)
    without_sign = dataclasses.replace(recording, tau=magnitude)
    held = recording.torque.copy()
    held[:, 1] = magnitude[:, 1]
    loaded = magnitude.copy()
    loaded[:, 1] += 50.0
    others = [dataclasses.replace(recording, tau=tau) for tau in (loaded, held)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kinds = [
            {r.kind for r in torque_check.check_torque(r, robot, limits).remarks}
            for r in (without_sign, *others, recording)
        ]
    assert [RemarkKind.MAGNITUDE in kind for kind in kinds] == [True, True, False, False]


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 9.81), (9.81, 0.0, 0.0), (0.0, -9.81, 0.0)])
def test_another_mounting_is_named_with_the_gravity_that_is_measured(simulated, gravity):
    recording, _ = simulated
    doubts = nominal_comparison.compare_with_nominal(recording, load("ur5e", gravity=gravity))
    assert [d.kind for d in doubts] == [RemarkKind.GRAVITY]
    assert "(0.1, -0.1, -9.6) m/s²" in doubts[0].text


def test_a_tilted_base_and_other_masses_are_no_doubt(simulated):
    recording, robot = simulated
    assert not nominal_comparison.compare_with_nominal(recording, robot)
    tilted = load("ur5e", gravity=(1.7, 0.0, -9.66))
    assert not nominal_comparison.compare_with_nominal(recording, tilted)
    for factor in (0.5, 2.0):
        other = dataclasses.replace(recording, tau=factor * recording.tau)
        assert not nominal_comparison.compare_with_nominal(other, robot)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_friction_tells_whether_the_torque_or_the_robot_description_is_the_wrong_way(sign):
    """The centres of mass of both links are on the other side in the robot description."""
    model = SUBJECT.robot.model.copy()
    for i, factor in ((1, -3.0), (2, -1.0)):
        body = model.inertias[i]
        model.inertias[i] = pin.Inertia(body.mass, factor * body.lever, body.inertia)
    robot = dataclasses.replace(SUBJECT.robot, model=model)
    measured = recordings_of(None)[0]
    recording = dataclasses.replace(measured, tau=sign * measured.tau)
    compared = robot if sign > 0.0 else SUBJECT.robot
    remarks = nominal_comparison.compare_with_nominal(recording, compared)
    assert {r.kind for r in remarks} == {RemarkKind.TORQUE_SIGN}
    assert all(r.doubt is (sign < 0.0) for r in remarks)
    cause = "its sign is inverted" if sign < 0.0 else "wrong in the robot description"
    assert all(cause in r.text for r in remarks)


def slow_recording(
    robot: Robot,
    seed: int,
    lever_error: float,
    folder: Path,
    hertz: float = 0.01,
    noise: float = 0.05,
) -> Recording:
    """A part of a slow motion in which the joints hardly turn back; links differ from nominal."""
    rng = np.random.default_rng(seed)
    t = np.arange(800) / 100.0
    phase = np.outer(2.0 * np.pi * hertz * t + rng.uniform(0.0, 2.0 * np.pi), np.arange(1, 6))
    speed = 2.0 * np.pi * hertz * np.arange(1, 6)
    sine, cosine = rng.normal(size=(2, 5, robot.n)) * 0.6 / np.arange(1, 6)[:, None]
    motion = Samples(
        np.sin(phase) @ sine + np.cos(phase) @ cosine + rng.uniform(-1.0, 1.0, robot.n),
        (np.cos(phase) * speed) @ sine - (np.sin(phase) * speed) @ cosine,
        -(np.sin(phase) * speed**2) @ sine - (np.cos(phase) * speed**2) @ cosine,
    )
    model = robot.model.copy()
    for i in range(1, model.njoints):
        body = model.inertias[i]
        mass, lever = body.mass * rng.uniform(0.6, 1.4), rng.normal(0.0, lever_error, 3)
        model.inertias[i] = pin.Inertia(mass, body.lever + lever, body.inertia)
    torque = inverse_dynamics(robot, model, motion)
    coulomb = 0.2 + 0.02 * np.abs(torque).max(axis=0)
    torque += coulomb * np.tanh(motion.dq / 0.01) + rng.normal(0.0, noise, torque.shape)
    columns = {"t": t}
    for j, joint in enumerate(robot.joints):
        columns |= {f"q.{joint}": motion.q[:, j], f"tau.{joint}": torque[:, j]}
    return recordings.read(write_columns(folder / "slow.csv", columns), robot)


@pytest.mark.parametrize("name", ["iiwa14", "panda", "ur5e"])
@pytest.mark.parametrize(("hertz", "noise"), [(0.01, 0.05), (0.01, 1e-3), (0.05, 0.05)])
def test_inverted_torque_of_a_slow_motion_is_not_taken_for_wrong_links(
    name, hertz, noise, tmp_path
):
    """Friction of joints that hardly turn back cannot be told from errors of the links."""
    robot = load(name)
    for seed in range(4):
        recording = slow_recording(robot, seed, 0.02, tmp_path, hertz, noise)
        right = nominal_comparison.compare_with_nominal(recording, robot)
        assert RemarkKind.TORQUE_SIGN not in {r.kind for r in right}
        inverted = dataclasses.replace(recording, tau=-recording.tau)
        remarks = nominal_comparison.compare_with_nominal(inverted, robot)
        assert {r.kind for r in remarks} == {RemarkKind.TORQUE_SIGN}
        assert all(r.doubt and "its sign is inverted" in r.text for r in remarks)


def test_torque_that_is_inverted_at_all_joints_is_said_to_be(simulated):
    recording, robot = simulated
    inverted = dataclasses.replace(recording, tau=-recording.tau)
    doubts = nominal_comparison.compare_with_nominal(inverted, robot)
    assert len(doubts) > 1 and all("as probably that of all joints" in d.text for d in doubts)


def test_joints_of_the_right_sign_are_not_said_to_be_inverted(simulated):
    """Two joints are inverted; the torque of the others is noisy."""
    recording, robot = simulated
    rng = np.random.default_rng(0)
    tau = recording.tau.copy()
    tau[:, 1:3] *= -1.0
    others = tau[:, [0, 3, 4, 5]]
    tau[:, [0, 3, 4, 5]] = others + 1.5 * others.std(axis=0) * rng.normal(size=others.shape)
    changed = dataclasses.replace(recording, tau=tau)
    doubts = [d for d in nominal_comparison.compare_with_nominal(changed, robot) if d.doubt]
    assert {d.joint for d in doubts} == set(robot.joints[1:3])
    assert not any("all joints" in d.text for d in doubts)


@pytest.mark.parametrize(
    ("name", "seeds"),
    [("iiwa14", (5, 23, 35, 38, 39)), ("panda", (13, 16, 19, 39)), ("ur5e", (24, 32, 34))],
)
def test_joints_of_a_slow_motion_are_not_exchanged_by_chance(name, seeds, tmp_path):
    """Links are poorly known; of 40 seeds, these explain the torque of exchanged joints better."""
    robot = load(name)
    for seed in seeds:
        recording = slow_recording(robot, seed, 0.08, tmp_path)
        kinds = {d.kind for d in nominal_comparison.compare_with_nominal(recording, robot)}
        assert RemarkKind.EXCHANGED not in kinds


@pytest.mark.parametrize(
    ("factor", "word"),
    [
        (1e3, "mN m"),
        (1e-3, "kN m"),
        (0.02, "motor current"),
        (80.0, "80 times too large: is it in counts or another unit?"),
        (500.0, "500 times too large: is it in counts or another unit?"),
        (2e3, "2000 times too large: is it in counts or another unit?"),
        (0.002, "motor current"),
    ],
)
def test_the_scale_of_torque_is_named(simulated, factor, word):
    recording, robot = simulated
    scaled = dataclasses.replace(recording, tau=factor * recording.tau)
    doubts = nominal_comparison.compare_with_nominal(scaled, robot)
    assert {d.kind for d in doubts} == {RemarkKind.TORQUE_SCALE} and len(doubts) >= 4
    assert any(word in d.text for d in doubts)
    assert factor in (1e3, 1e-3) or not any("off by" in d.text for d in doubts)


@pytest.mark.parametrize(
    ("mass", "factor", "is_doubt"), [(2.0, 1.0, False), (2.0, 1e3, True), (0.0, 40.0, True)]
)
def test_a_load_at_a_last_joint_with_a_light_link_is_no_doubt(tmp_path, mass, factor, is_doubt):
    """It has 40 times the nominal torque there, and the joints before it show it.

    In mN m it is more than these carry; without the load they do not show it.
    """
    robot = load("panda")
    recording = slow_recording(robot, 3, 0.0, tmp_path, hertz=0.05, noise=1e-3)
    with_load, last = robot.model.copy(), robot.n
    lever = np.array([15.0, 15.0, 1.0]) * robot.model.inertias[last].lever
    with_load.inertias[last] += pin.Inertia(mass, lever, 1e-3 * mass * np.eye(3))
    motion = recording.samples()
    load_torque = inverse_dynamics(robot, with_load, motion) - inverse_dynamics(
        robot, robot.model, motion
    )
    assert recording.tau is not None
    tau = recording.tau + load_torque
    tau[:, -1] *= factor
    remarks = {
        remark.joint: remark
        for remark in nominal_comparison.compare_with_nominal(
            dataclasses.replace(recording, tau=tau), robot
        )
        if remark.kind is RemarkKind.TORQUE_SCALE
    }
    assert [joint for joint, r in remarks.items() if r.doubt] == ["panda_joint7"] * is_doubt
    assert ("a load is missing" in remarks["panda_joint7"].text) is not is_doubt


@pytest.mark.parametrize(("factor", "cause"), [(5.0, "a load is missing"), (0.2, "too heavy")])
@pytest.mark.parametrize("is_current", [True, False])
def test_a_scale_that_masses_may_explain_is_remarked(tmp_path, factor, cause, is_current):
    """Torque constants that are off by a factor of five cannot be told from wrong masses."""
    recording = recordings_of(None)[0]
    path = write_recording(recording, tmp_path / "run.csv")
    if is_current:
        path.write_text(path.read_text().replace("tau.", "i."))
        gains = dict.fromkeys(recording.joints, factor)
        stated = {"schema": "excite.recording/1", "drive_gain": gains}
        path.with_suffix(".json").write_text(json.dumps(stated))
    else:
        assert recording.tau is not None
        write_recording(dataclasses.replace(recording, tau=factor * recording.tau), path)
    checked_recording, texts = checked_with_warnings(path, "two_link")
    assert not checked_recording.doubts
    remarks = [r for r in checked_recording.remarks if r.kind is RemarkKind.TORQUE_SCALE]
    assert [remark.joint for remark in remarks] == list(recording.joints)
    for remark in remarks:
        ratio = float(remark.text.split("measured torque is ")[1].split()[0])
        assert ratio == pytest.approx(factor, rel=0.4)
        assert f"check the {'drive_gain' if is_current else 'scale of the torque'}" in remark.text
        assert cause in remark.text
        assert f"{path}: {remark.text}" in texts


@pytest.mark.parametrize(
    ("weight", "scale", "parts"),
    [
        (1.0, 1.0, ()),
        (0.3, 1.0, ()),  # a counterbalance that carries most of the weight
        (0.0, 1.0, ("does a counterbalance", "another unit (convert it, or name it i.lift")),
        (1.0, 1 / 170, ("does a counterbalance", "another unit (convert it, or name it i.lift")),
    ],
)
def test_a_constant_weight_that_is_not_measured_is_remarked(tmp_path, weight, scale, parts):
    """A vertical slide, whose weight has no slope that a comparison could show."""
    urdf = tmp_path / "slide.urdf"
    urdf.write_text(
        document(
            link("base"),
            link("load", 30.0),
            joint_element(
                *("lift", "base", "load", "prismatic"),
                inside='<limit lower="0" upper="0.35" velocity="0.5" effort="9000"/>',
            ),
        )
    )
    t = np.arange(0.0, 8.0, 0.01)
    q = 0.17 + 0.1 * np.sin(2.0 * t)
    dq, ddq = 0.2 * np.cos(2.0 * t), -0.4 * np.sin(2.0 * t)
    force = scale * (30.0 * (9.81 * weight + ddq) + 10.0 * np.tanh(dq / 0.01))
    columns = {"t": t, "q.lift": q, "tau.lift": force}
    path = write_columns(tmp_path / "r.csv", columns)
    recording, texts = checked_with_warnings(path, str(urdf))
    remarks = [r.text for r in recording.remarks if r.kind is RemarkKind.WEIGHT]
    assert not recording.doubts and bool(remarks) is bool(parts)
    for text in remarks:
        assert "the nominal weight needs 294 N" in text and f"{path}: {text}" in texts
        assert all(part in text for part in parts)


@pytest.mark.parametrize("joint", [0, 1, 2, 3])
def test_a_position_of_inverted_sign_is_named(simulated, joint):
    recording, robot = simulated
    q = recording.q.copy()
    q[:, joint] *= -1.0
    doubts = nominal_comparison.compare_with_nominal(dataclasses.replace(recording, q=q), robot)
    if joint == 2:  # the elbow's sign turns the wrist, whose torque then seems to be out of scale
        assert doubts
        return
    assert [(d.kind, d.joint) for d in doubts] == [(RemarkKind.POSITION, robot.joints[joint])]
    assert "with the opposite sign; turn its sign" in doubts[0].text


@pytest.mark.parametrize("joint", [1, 2, 3])
@pytest.mark.parametrize("offset", [90, -90])
def test_another_zero_of_a_position_is_named(simulated, joint, offset):
    recording, robot = simulated
    q = recording.q.copy()
    q[:, joint] -= np.radians(offset)
    doubts = nominal_comparison.compare_with_nominal(dataclasses.replace(recording, q=q), robot)
    assert [(d.kind, d.joint) for d in doubts] == [(RemarkKind.POSITION, robot.joints[joint])]
    assert f"shifted by {offset:+d}°; correct its zero" in doubts[0].text


def test_clipped_torque_is_named_with_its_file(tmp_path):
    recording = recordings_of(None)[0]
    assert recording.tau is not None
    torque = recording.tau.copy()
    limit = float(np.quantile(torque[:, 1], 0.9))
    torque[:, 1] = np.minimum(torque[:, 1], limit)
    path = write_recording(dataclasses.replace(recording, tau=torque), tmp_path / "run.csv")
    _, texts = checked_with_warnings(path, "two_link")
    (text,) = [text for text in texts if "clipped" in text]
    assert text.startswith(f"{path}: joint 'joint_2': tau is clipped at {limit:.5g} N m, in 10 %")


# -- clean recordings -----------------------------------------------------------------------------


@needs_inputs
def test_a_clean_simulated_recording_raises_no_doubt():
    recording = checked(REPORTS / "two_link_heldout.csv", "two_link")
    assert not recording.doubts and not recording.remarks


@pytest.mark.parametrize(
    ("setting", "name"),
    [
        pytest.param(setting, name, marks=[] if name in quick else pytest.mark.slow)
        for setting, quick in (({}, ("two_link", "tx40", "fr3")), ({"rate": 125.0}, ("ur5e",)))
        for name in BUILTIN
    ],
    ids=lambda value: value if isinstance(value, str) else f"{value.get('rate', 250.0):.0f} Hz",
)
def test_a_simulated_builtin_robot_raises_no_doubt(tmp_path, name, setting):
    pytest.importorskip("mujoco", reason="the simulated robot needs pip install 'excite[sim]'")
    trajectory = Path(__file__).resolve().parents[1] / "trajectories" / f"{name}.json"
    api.simulate(name, trajectory, periods=2, seed=1, **setting).save(tmp_path / "run.csv")
    recording = checked(tmp_path / "run.csv", name)
    assert not recording.doubts and not recording.remarks


def test_timestamp_jitter_of_fast_joints_is_no_glitch(tmp_path):
    """Readings are 1 ms (rms) off their stamps, 4 ms apart, at nearly the velocity limit."""
    pytest.importorskip("mujoco", reason="the simulated robot needs pip install 'excite[sim]'")
    trajectory = Path(__file__).resolve().parents[1] / "trajectories" / "fr3.json"
    api.simulate("fr3", trajectory, periods=2, seed=2, jitter=1e-3).save(tmp_path / "run.csv")
    recording = checked(tmp_path / "run.csv", "fr3")
    assert [remark.kind for remark in recording.remarks] == [RemarkKind.TIMESTAMP_JITTER]
    assert not recording.doubts


@pytest.mark.parametrize(
    ("folder", "urdf"),
    [
        ("emps", "emps"),
        ("tx40", "tx40"),
        slow("kuka_kr300", "kuka_kr300"),
        slow("lwr4", "lwr4"),
        slow("so101", "so101"),
        ("panda_unit2", "panda"),
        ("double_pendulum", "double_pendulum"),
        ("laas_cogging", "motor"),
        ("xl330", "xl330_pendulum"),
        ("human_wrench", "human"),
    ],
)
def test_real_recordings_raise_no_doubt(folder, urdf):
    if not (REAL / folder).is_dir():
        pytest.skip(f"no real recordings at {REAL / folder}")
    source = str(REAL / folder / f"{urdf}.urdf")
    robot = load(source)
    for path in sorted((REAL / folder).glob("*.csv")):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            recording = recordings.read(path, robot)
            repaired = {r.kind for r in recording.remarks if r.repaired}
            assert RemarkKind.CLIPPED not in {r.kind for r in recording.remarks}, path
            assert not repaired & {
                *(RemarkKind.GLITCH, RemarkKind.WRAPPED, RemarkKind.CLOCK_STEP, RemarkKind.PERIOD)
            }, path
            assert not recording.doubts, path
            try:
                _ = recording.torque
            except UnusableInput:
                continue  # two files of the SO-101 serve replay only; the human has no joint torque
            remarks = nominal_comparison.compare_with_nominal(recording, robot)
            assert not any(remark.doubt for remark in remarks), path
            # a payload of 150 kg that is not in the description, and servos of unknown torque
            expected = folder == "kuka_kr300" or path.name == "hold_under_gravity.csv"
            assert not remarks or expected, path
            doubts = torque_check.check_torque(recording, robot, resolve(robot)).doubts
            assert RemarkKind.EXCHANGED not in {doubt.kind for doubt in doubts}, path


def test_velocities_that_are_not_the_slope_of_the_positions_are_warned_of(tmp_path):
    """Record the velocity behind a gear of 1 : 10, and the position before it."""
    columns = two_joint_motion()
    columns["dq.joint_2"] /= 10.0
    recording, texts = checked_with_warnings(write_columns(tmp_path / "r.csv", columns), "two_link")
    (text,) = [text for text in texts if "slope of q" in text]
    assert "joint_2" in text and "10 times dq" in text and "from q alone" in text
    assert not any(doubt.kind is RemarkKind.INCONSISTENT for doubt in recording.doubts)


# -- diagnosis ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_doubted_recording_names_no_joint(tmp_path):
    """Torque without gravity."""
    model, data = SUBJECT.robot.model, SUBJECT.robot.model.createData()

    def without_gravity(t, q, dq, tau):
        return -np.array([pin.computeGeneralizedGravity(model, data, row) for row in q])

    train, held_out = (
        write_recording(recording, tmp_path / recording.source)
        for recording in recordings_of(without_gravity)
    )
    with pytest.warns(match="gravity is missing"):
        result = api.diagnose("two_link", [train], [held_out], with_report=False)
    document = result.document()
    assert {doubt["kind"] for doubt in document["doubts"]} == {"gravity"}
    assert all(entry["joint"] is None for entry in document["findings"])
    assert document["verdict"] == "unexplained" and document["unknown"] == []
    assert result.model()["effects"] == []


@needs_inputs
def test_positions_in_turns_are_a_possible_cause_of_a_useless_model(tmp_path, capsys):
    assert INPUTS is not None
    training, held_out = (INPUTS / f"{name}.csv" for name in ("good", "good2"))
    header, *rows = training.read_text(encoding="utf-8").splitlines()
    table = np.array([row.split(",") for row in rows], float)
    is_position = [name.startswith(("q.", "qref.")) for name in header.split(",")]
    table[:, is_position] /= 2.0 * np.pi
    lines = [header, *(",".join(f"{value:.9g}" for value in row) for row in table)]
    path = tmp_path / "turns.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    main(["identify", "two_link", str(path), f"--validate={held_out}", f"-o{tmp_path}/m"])
    assert "positions in rad, not in turns" in capsys.readouterr().out
