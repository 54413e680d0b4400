"""Export formats: files read back as the exported motion, golden files, refusals."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import ruckig
import yaml
from conftest import document, joint, link
from slow_tests import slow

import excite
from excite import exporters
from excite.errors import UnusableInput
from excite.exporters import csv_json, ros2, urscript, vendor_table
from excite.exporters.goal_options import GoalOptions
from excite.robot.limits import Limits
from excite.robot.samples import Samples
from excite.trajectory.fourier import FourierSeries
from excite.trajectory.rest_to_rest import JerkProfile, Motion, MotionSegment
from excite.trajectory.trajectory_file import Trajectory

GOLDEN = Path(__file__).parent / "golden"
TOLERANCE = {"rtol": 0.0, "atol": 1e-9}
ACCURATE = {"csv", "json", "ros2-joint-trajectory", "ros2-follow-joint-trajectory", "urscript"}
LONG_FILES = ("vendor:kuka-fri", "franka-csv")
"""Formats with a row per millisecond, whose files of slow motions take seconds."""
JOINTS = {
    name: (profile.joints or (6,))[-1] for name, profile in vendor_table.profiles().items()
} | {"urscript": 6}


def ruckig_ramp(begin: np.ndarray, end: np.ndarray) -> tuple[JerkProfile, float]:
    """Return Ruckig's ramp between two states, shape (3, n), and its duration [s]."""
    n = begin.shape[1]
    request = ruckig.InputParameter(n)
    request.current_position, request.current_velocity, request.current_acceleration = begin
    request.target_position, request.target_velocity, request.target_acceleration = end
    request.max_velocity, request.max_acceleration, request.max_jerk = (
        [2.0] * n,
        [5.0] * n,
        [50.0] * n,
    )
    result = ruckig.Trajectory(n)
    assert ruckig.Ruckig(n).calculate(request, result) == ruckig.Result.Working
    rows = []
    for p in result.profiles[0]:
        pieces = [*zip(p.brake.t, p.brake.j, strict=True), *zip(p.t, p.j, strict=True)]
        rows.append(tuple((float(d), float(j)) for d, j in pieces if d > 0.0))
    return JerkProfile(*begin, tuple(rows)), result.duration


def trajectory_of(motion: Motion, forced: bool = False) -> Trajectory:
    n, every = len(motion.joints), np.ones(len(motion.joints))
    sources = {q: ("urdf",) * n for q in ("position", "velocity", "acceleration", "jerk", "torque")}
    limits = Limits(
        motion.joints,
        np.column_stack([-9.0 * every, 9.0 * every]),
        5.0 * every,
        50.0 * every,
        5e3 * every,
        90.0 * every,
        (None,) * n,
        sources,
    )
    robot = {
        "name": "tiny",
        "source": "tiny.urdf",
        "sha256": "0" * 64,
        "locked": {},
        "payload": None,
        "gravity": [0.0, 0.0, -9.81],
    }
    scores = {"a": 1.0, "d": 2.0, "e": 0.5, "cond": 4.0}
    part = {"geometric": scores, "plain": scores, "cond_regressor": 2.0}
    return Trajectory(
        robot,
        motion,
        100.0,
        limits,
        np.ones(n),
        {"criterion": "d"},
        {"optimum": part, "exported": part},
        [],
        "collision not checked",
        0,
        forced,
        {"excite": "0"},
    )


def complete_motion(n: int, forced: bool = False) -> Trajectory:
    """Return a motion of n joints with all segments and two periods of three harmonics."""
    rng = np.random.default_rng(n)
    fourier = FourierSeries(
        rng.normal(0.0, 0.3, (n, 3)), rng.normal(0.0, 0.3, (n, 3)), rng.normal(0.0, 0.5, n), 4.0
    )
    home, ready = np.zeros((3, n)), np.zeros((3, n))
    ready[0] = fourier.offset + 0.3
    border = np.vstack([fourier.at(np.zeros(1), order) for order in range(3)])
    segments: list[MotionSegment] = []
    legs = [
        ("approach", home, ready),
        ("ramp_in", ready, border),
        None,
        ("ramp_out", border, ready),
        ("return", ready, home),
    ]
    for leg in legs:
        now = segments[-1].end if segments else 0.0
        if leg is None:
            segments.append(MotionSegment("fourier", now, now + 8.0))
        else:
            profile, duration = ruckig_ramp(leg[1], leg[2])
            segments.append(MotionSegment(leg[0], now, now + duration, profile))
    return trajectory_of(
        Motion(tuple(f"joint_{i + 1}" for i in range(n)), fourier, 2, tuple(segments)), forced
    )


def short_trajectory(n: int) -> Trajectory:
    """Return a trajectory of 0.1 s with round numbers, for the golden files."""
    half = ((0.01, 100.0), (0.01, -100.0), (0.01, -100.0), (0.01, 100.0))
    joints = tuple(f"j{i + 1}" for i in range(n))
    start, still = np.linspace(0.0, 0.5, n), np.zeros(n)
    out = JerkProfile(start, still, still, (half,) * n)
    top = start + 2e-4
    back = JerkProfile(top, still, still, (tuple((d, -j) for d, j in half),) * n)
    fourier = FourierSeries(np.zeros((n, 1)), np.zeros((n, 1)), top, 0.02)
    parts = (
        MotionSegment("ramp_in", 0.0, 0.04, out),
        MotionSegment("fourier", 0.04, 0.06),
        MotionSegment("ramp_out", 0.06, 0.1, back),
    )
    return trajectory_of(Motion(joints, fourier, 1, parts))


def torque(samples: Samples) -> np.ndarray:
    return samples.ddq + 2.0 * samples.dq


def trajectory_for(name: str) -> Trajectory:
    return complete_motion(JOINTS.get(name, 2))


def test_the_motion_of_the_tests_is_continuous() -> None:
    motion = complete_motion(6).motion
    for before, after in zip(motion.segments[:-1], motion.segments[1:], strict=True):
        for order in range(3):
            sides = motion.at(np.array([before.end - 1e-9, after.start + 1e-9]), order)
            np.testing.assert_allclose(sides[0], sides[1], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "speed"),
    [
        slow(name, speed) if name in LONG_FILES and speed < 1.0 else (name, speed)
        for name in exporters.FORMATS
        for speed in (1.0, 0.1)
    ],
)
def test_round_trip(name: str, speed: float, tmp_path: Path) -> None:
    trajectory, path = trajectory_for(name), tmp_path / "file"
    if name == "json" and speed != 1.0:
        with pytest.raises(UnusableInput, match=r"--speed 0\.1 would void"):
            exporters.write(trajectory, name, path, speed=speed)
        return
    assert exporters.write(trajectory, name, path, speed=speed, tau=torque) == path
    t, q, *derivatives = exporters.read(name, path)
    motion = trajectory.motion.slowed(speed)
    assert t[0] == 0.0
    assert (np.diff(t) > 0.0).all()
    assert motion.duration <= t[-1] + 1e-9 < motion.duration + 0.021
    np.testing.assert_allclose(q, motion.at(t), **TOLERANCE)
    assert bool(derivatives) == (name in ACCURATE)
    for order, columns in enumerate(derivatives[:2], start=1):
        np.testing.assert_allclose(columns, motion.at(t, order), **TOLERANCE)
        assert (columns[[0, -1]] == 0.0).all()
    # the same path, later
    np.testing.assert_allclose(q, trajectory.motion.at(t * speed), **TOLERANCE)


@pytest.mark.parametrize("name", [name for name in exporters.FORMATS if name not in ACCURATE])
def test_position_tables_start_and_end_at_rest(name: str, tmp_path: Path) -> None:
    t, q = exporters.read(name, exporters.write(trajectory_for(name), name, tmp_path / "file"))
    dt = t[1]
    assert np.abs(np.diff(q, axis=0)[[0, -1]]).max() / dt < 50.0 * dt**2  # jerk 50 from rest
    assert np.abs(np.diff(q, 2, axis=0)).max() / dt**2 < 6.0


@pytest.mark.parametrize("name", list(exporters.FORMATS))
def test_files_equal_the_golden_files(name: str, tmp_path: Path) -> None:
    """Byte by byte. To write a golden file: delete it, run this test once, check the file, run it
    again."""
    path = exporters.write(
        short_trajectory(JOINTS.get(name, 2)),
        name,
        tmp_path / "file",
        rate=None,
        tau=lambda s: np.round(s.ddq, 9),
    )
    golden = GOLDEN / f"export-{name.replace(':', '-')}.txt"
    if not golden.exists():
        golden.write_bytes(path.read_bytes())
        pytest.fail(f"{golden} was missing and is written now; check it")
    assert path.read_bytes() == golden.read_bytes()


def test_csv_has_the_columns_of_the_contract(tmp_path: Path) -> None:
    trajectory = complete_motion(2)
    lines = (
        exporters.write(trajectory, "csv", tmp_path / "a.csv", tau=torque).read_text().splitlines()
    )
    assert lines[0] == ",".join(
        ["t", *(f"{q}.joint_{i}" for q in ("q", "dq", "ddq", "tau") for i in (1, 2))]
    )
    for line in (lines[1], lines[-1]):
        assert line.split(",")[3:7] == ["0"] * 4
    t, *_, tau = exporters.read("csv", tmp_path / "a.csv")
    np.testing.assert_array_equal(
        t, [float(f"{v:.12g}") for v in np.arange(len(t)) / trajectory.rate]
    )
    np.testing.assert_allclose(tau, torque(trajectory.motion.samples(t)), atol=1e-8)
    assert (
        csv_json.text(trajectory, torque(trajectory.motion.samples(t)))
        == (tmp_path / "a.csv").read_text()
    )
    bare = exporters.write(trajectory, "csv", tmp_path / "b.csv", rate=30.0).read_text()
    assert "tau" not in bare.splitlines()[0]


def test_csv_ends_at_rest_despite_rounding_of_the_grid(tmp_path: Path) -> None:
    profile = JerkProfile(
        np.zeros(1), np.zeros(1), np.zeros(1), (((1.0, 1.0), (2.0, -1.0), (1.0 + 4e-9, 1.0)),)
    )
    fourier = FourierSeries(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros(1), 1.0)
    trajectory = trajectory_of(
        Motion(("j",), fourier, 0, (MotionSegment("approach", 0.0, 4.0 + 4e-9, profile),))
    )
    _, q, dq, ddq = exporters.read(
        "csv", exporters.write(trajectory, "csv", tmp_path / "a.csv", rate=10.0)
    )
    assert len(q) == 41
    assert dq[-1] == 0.0
    assert ddq[-1] == 0.0


@pytest.mark.parametrize("name", ["ros2-joint-trajectory", "ros2-follow-joint-trajectory"])
def test_ros2_message(name: str, tmp_path: Path) -> None:
    text = exporters.write(complete_motion(6), name, tmp_path / "m.yaml").read_text()
    document = yaml.safe_load(text)
    assert document == json.loads(text)
    if name == "ros2-follow-joint-trajectory":
        assert document["goal_time_tolerance"] == {"sec": 2, "nanosec": 0}
        document = document["trajectory"]
    assert document["joint_names"] == [f"joint_{i}" for i in range(1, 7)]
    points = document["points"]
    stamps = [p["time_from_start"] for p in points]
    times = [s["sec"] * 10**9 + s["nanosec"] for s in stamps]
    assert times[0] == 5 * 10**9
    assert all(0 <= s["nanosec"] < 10**9 for s in stamps)
    assert set(np.diff(times)) == {20_000_000}
    for point in points:
        assert point["effort"] == []
        for key in ("positions", "velocities", "accelerations"):
            assert [type(v) for v in point[key]] == [float] * 6
    assert points[-1]["velocities"] == [0.0] * 6


def quintic(h: float, s: float, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the position at s of the quintic between two states, shape (3, n), over a time h."""
    powers = np.array(
        [
            [math.perm(k, d) * x ** (k - d) if k >= d else 0.0 for k in range(6)]
            for x in (0.0, h)
            for d in range(3)
        ]
    )
    return np.array([s**k for k in range(6)]) @ np.linalg.solve(powers, np.vstack([a, b]))


def test_quintic_interpolation_of_knots_follows_the_motion(tmp_path: Path) -> None:
    trajectory = complete_motion(2)
    t, *columns = ros2.read(
        exporters.write(trajectory, "ros2-joint-trajectory", tmp_path / "m.yaml")
    )
    part = trajectory.motion.segment("fourier")
    inside = np.flatnonzero((t > part.start) & (t < part.end - 0.03))
    for i in inside[::20]:
        a, b = (np.vstack([c[k] for c in columns]) for k in (i, i + 1))
        between = quintic(t[i + 1] - t[i], 0.01, a, b)
        np.testing.assert_allclose(between, trajectory.motion.at(t[[i]] + 0.01)[0], atol=1e-8)


def test_interpolation_between_points_keeps_the_limits_and_the_path(tmp_path: Path) -> None:
    """Ramps reach an acceleration of 5, which the quintic of 50 Hz exceeds between two points."""
    wide, path = complete_motion(2), tmp_path / "m.yaml"
    bound = float(np.abs(wide.motion.at(np.linspace(0.0, wide.motion.duration, 50001), 2)).max())
    narrow = dataclasses.replace(
        wide, limits=dataclasses.replace(wide.limits, acceleration=np.full(2, 1.003 * bound))
    )
    t, q, dq, ddq = ros2.read(exporters.write(narrow, "ros2-joint-trajectory", path))
    assert t[1] == pytest.approx(0.01)
    for i in range(len(t) - 1):
        a, b = (np.vstack([c[k] for c in (q, dq, ddq)]) for k in (i, i + 1))
        h = t[i + 1] - t[i]
        around = [quintic(h, s, a, b) for s in (0.49 * h, 0.5 * h, 0.51 * h)]
        assert np.abs(np.diff(around, 2, axis=0) / (0.01 * h) ** 2).max() <= 1.003 * bound
    slow = dataclasses.replace(
        wide, limits=dataclasses.replace(wide.limits, velocity=np.full(2, 2.5))
    )
    for trajectory, reason in (
        (wide, "interpolation of joint 'joint_1' leaves the path by"),
        (slow, "interpolated velocity of joint 'joint_1' is up to"),
    ):
        with pytest.raises(UnusableInput, match=f"--rate 1: the {reason}.*use --rate 50$"):
            exporters.write(trajectory, "ros2-follow-joint-trajectory", path, rate=1.0)
        exporters.write(trajectory, "ros2-follow-joint-trajectory", path, rate=50.0)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("ur-csv", 7), ("urscript", 2), ("franka-csv", 6), ("vendor:abb-egm", 7), ("vendor:xarm", 2)],
)
def test_a_wrong_number_of_joints_is_refused(name: str, wrong: int, tmp_path: Path) -> None:
    with pytest.raises(UnusableInput) as caught:
        exporters.write(complete_motion(wrong), name, tmp_path / "out")
    text = str(caught.value)
    assert "\n" not in text
    for part in (str(tmp_path / "out"), name, "joint_1, joint_2", "--joints"):
        assert part in text
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [*vendor_table.profiles(), "urscript"])
def test_a_sliding_joint_is_refused_where_numbers_are_angles(name: str, tmp_path: Path) -> None:
    with pytest.raises(UnusableInput, match="joint 'joint_2' slides; lock it"):
        exporters.write(trajectory_for(name), name, tmp_path / "out", sliding=["joint_2"])
    assert not list(tmp_path.iterdir())


def test_kinds_of_joints_are_those_of_the_urdf(tmp_path: Path) -> None:
    """An arm of five joints, of which the third slides, with a motion that breaks its limits."""
    urdf = tmp_path / "arm.urdf"
    bodies = [link(f"l{k}", 1.0, (0.1, 0.2, 0.3)) for k in range(6)]
    joints = [
        joint(f"joint_{k}", f"l{k - 1}", f"l{k}", "prismatic" if k == 3 else "revolute")
        for k in range(1, 6)
    ]
    urdf.write_text(document(*bodies, *joints), encoding="utf-8")
    robot = {
        **complete_motion(5).robot,
        "source": str(urdf),
        "sha256": hashlib.sha256(urdf.read_bytes()).hexdigest(),
    }
    trajectory = dataclasses.replace(complete_motion(5), robot=robot)
    stated = exporters.write(trajectory, "json", tmp_path / "trajectory.json")
    with pytest.raises(UnusableInput, match="joint 'joint_3' slides; lock it"):
        excite.export(stated, "vendor:xarm", tmp_path / "out", force=True)
    excite.export(stated, "csv", tmp_path / "out", force=True)


def test_unusable_options_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "out"
    with pytest.raises(
        UnusableInput, match=r"there are: csv, json, ros2-joint-trajectory.*vendor:xarm"
    ):
        exporters.write(complete_motion(2), "dxf", path)
    with pytest.raises(UnusableInput, match="there are: csv"):
        exporters.read("dxf", path)
    for speed in (0.0, -1.0, 1.5, math.nan):
        with pytest.raises(UnusableInput, match="--speed"):
            exporters.write(complete_motion(2), "csv", path, speed=speed)
    for rate in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(UnusableInput, match="--rate"):
            exporters.write(complete_motion(2), "csv", path, rate=rate)
    with pytest.raises(UnusableInput, match="is over 5,000,000 rows"):
        exporters.write(complete_motion(2), "csv", path, rate=1e9)
    for name in ("franka-csv", "ur-csv", "urscript"):
        with pytest.raises(UnusableInput, match=r"Hz.*--rate 333"):
            exporters.write(trajectory_for(name), name, path, rate=333.0)
    with pytest.raises(UnusableInput, match=r"'json' carries .* --rate 50 would void them"):
        exporters.write(complete_motion(2), "json", path, rate=50.0)
    for goal, name, words in (
        (GoalOptions(8.0), "csv", "--lead: goes with the format ros2-joint-trajectory or"),
        (GoalOptions(path_tolerance=0.1), "urscript", "--path-tolerance: goes with"),
        (GoalOptions(goal_tolerance=0.1), "ros2-joint-trajectory", "--goal-tolerance: goes with"),
    ):
        with pytest.raises(UnusableInput, match=words):
            exporters.write(trajectory_for(name), name, path, goal=goal)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"lead": 0.0}, "--lead 0 should be a number from 0.1 to 600 s"),
        ({"lead": -3.0}, "--lead -3 should be"),
        ({"lead": math.nan}, "--lead nan should be"),
        ({"path_tolerance": -0.1}, "--path-tolerance -0.1 should be a number from 1e-06 to 10"),
        ({"goal_tolerance": math.nan}, "--goal-tolerance nan should be"),
    ],
)
def test_goals_out_of_range_are_refused(options: dict[str, float], words: str) -> None:
    with pytest.raises(UnusableInput, match=words):
        GoalOptions(**options)


def test_formats_with_a_choice_of_rate(tmp_path: Path) -> None:
    rates = {
        "ur-csv": 125.0,
        "urscript": 125.0,
        "vendor:fanuc-j519": 250.0,
        "csv": 30.0,
        "ros2-joint-trajectory": 30.0,
    }
    for name, rate in rates.items():
        trajectory = trajectory_for(name)
        t, q, *_ = exporters.read(
            name, exporters.write(trajectory, name, tmp_path / "out", rate=rate)
        )
        np.testing.assert_allclose(t, np.arange(len(t)) / rate, atol=1e-9)
        np.testing.assert_allclose(q, trajectory.motion.at(t), atol=3e-9)


@pytest.mark.parametrize("name", ["csv", "ros2-joint-trajectory", "ur-csv", "urscript"])
def test_a_motion_that_does_not_rest_is_refused(name: str, tmp_path: Path) -> None:
    complete = trajectory_for(name).motion
    bare = Motion(complete.joints, complete.fourier, 2, (MotionSegment("fourier", 0.0, 8.0),))
    with pytest.raises(UnusableInput, match=r"joint 'joint_\d' .* at rest"):
        exporters.write(trajectory_of(bare), name, tmp_path / "out")


def test_a_refused_export_writes_nothing(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(UnusableInput, match="cannot be written"):
        exporters.write(complete_motion(7), "franka-csv", tmp_path / "out")
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_unreadable_files_are_refused(tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    for content in (b"", b"\xff\xfe", b"# a\n1,2\n3\n", b"{}", b"[1]", b"def f():\nend\n"):
        broken.write_bytes(content)
        for name in exporters.FORMATS:
            with pytest.raises(UnusableInput, match="broken"):
                exporters.read(name, broken)
    with pytest.raises(UnusableInput, match="absent"):
        exporters.read("csv", tmp_path / "absent")


@pytest.mark.parametrize("name", [name for name in exporters.FORMATS if name != "csv"])
def test_forced_and_untried_files_state_it(name: str, tmp_path: Path) -> None:
    for forced in (True, False):
        trajectory = complete_motion(JOINTS.get(name, 2), forced)
        path = exporters.write(trajectory, name, tmp_path / "out")
        text = "".join(file.read_text() for file in (path, tmp_path / "out.txt") if file.exists())
        if name == "json":
            assert json.loads(text)["forced"] is forced
        else:
            assert ("FORCED: breaks its limits" in text) is forced
        if name in vendor_table.profiles() or name == "urscript":
            assert "never tried on hardware" in text


def test_franka_has_seven_columns_without_header(tmp_path: Path) -> None:
    path = exporters.write(complete_motion(7), "franka-csv", tmp_path / "f.csv")
    assert np.loadtxt(path, delimiter=",").shape[1] == 7
    assert "start [rad]" in (tmp_path / "f.csv.txt").read_text()


# -- vendors ---------------------------------------------------------------------------------------


def test_no_profile_claims_tests_on_hardware() -> None:
    assert all(not profile.tried_on_hardware for profile in vendor_table.profiles().values())


def test_vendor_units_and_reference() -> None:
    q = np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [0.2, 0.3, 0.5, 0.4, 0.5, 0.7]])
    known = vendor_table.profiles()
    np.testing.assert_allclose(known["vendor:abb-egm"].encode(q), np.degrees(q))
    np.testing.assert_allclose(known["vendor:xarm"].encode(q), q)
    np.testing.assert_allclose(known["ur-csv"].encode(q), q)
    relative = known["vendor:kuka-rsi"].encode(q)
    assert (relative[0] == 0.0).all()
    np.testing.assert_allclose(relative[1], np.degrees([0.1, 0.1, 0.2, 0.0, 0.0, 0.1]))
    fanuc = known["vendor:fanuc-j519"].encode(q)
    np.testing.assert_allclose(fanuc[:, 2], np.degrees([0.1, 0.2]))
    np.testing.assert_allclose(np.delete(fanuc, 2, 1), np.degrees(np.delete(q, 2, 1)))


@pytest.mark.parametrize("relative", [False, True])
def test_vendor_sign_offset_and_inverse(relative: bool) -> None:
    profile = vendor_table.TableProfile(
        "x",
        "deg",
        (100.0,),
        False,
        sign=(1, -1),
        offset=(10, -90),
        coupling=((2, 1, 0.5),),
        relative=relative,
    )
    q = np.radians([[1.0, 2.0], [5.0, 7.0]])
    absolute = np.array([[11.0, -92.0 + 5.5], [15.0, -97.0 + 7.5]])
    np.testing.assert_allclose(profile.encode(q), absolute - absolute[0] * relative, atol=1e-12)
    np.testing.assert_allclose(profile.decode(profile.encode(q), q[0]), q, atol=1e-12)


# -- URScript --------------------------------------------------------------------------------------


def run(script: str, step: float) -> tuple[list[list[float]], list[object]]:
    """Run a program as Python with a given step; return the targets of servoj and other motions.

    Python and URScript agree on the statements of the program, except for `end`, `local`, `global`
    and lists, which URScript copies.
    """
    names = re.findall(r"global (\w+) =", script)
    lines: list[str] = []
    for line in script.splitlines():
        if line.strip() == "end":
            continue
        bare = re.sub(r"\b(?:local|global) (\w+) =", r"\1 =", line)
        lines.append(re.sub(r"^(\s*)(pos|vel|acc) = (\w+)$", r"\1\2 = list(\3)", bare))
        if line.strip().startswith("def "):
            lines.append(" " * (len(line) - len(line.lstrip()) + 2) + "global " + ", ".join(names))
    targets: list[list[float]] = []
    others: list[object] = []

    def servoj(q: list[float], t: float, lookahead_time: float, gain: int) -> None:
        assert (t, lookahead_time, gain) == (step, 0.1, 300)
        targets.append(list(q))

    scope = {
        "servoj": servoj,
        "movej": lambda q, a, v: others.append(q),
        "stopj": lambda a: others.append("stop"),
        "get_steptime": lambda: step,
        "sin": math.sin,
        "cos": math.cos,
    }
    exec("\n".join([*lines, "excite_motion()"]), scope)
    return targets, others


@pytest.mark.parametrize(
    ("step", "speed", "rate"), [(0.002, 1.0, None), (0.008, 1.0, None), (0.008, 0.1, 125.0)]
)
def test_urscript_program_reproduces_the_motion(
    step: float, speed: float, rate: float | None, tmp_path: Path
) -> None:
    trajectory = complete_motion(6)
    script = exporters.write(
        trajectory, "urscript", tmp_path / "p.script", speed=speed, rate=rate
    ).read_text()
    targets, others = run(script, step)
    motion = trajectory.motion.slowed(speed)
    np.testing.assert_allclose(others[0], motion.end_poses[0], **TOLERANCE)
    assert others[1:] == ["stop"]
    t = step * np.arange(1, len(targets) + 1)
    assert motion.duration + 0.4 < t[-1] < motion.duration + 0.6
    np.testing.assert_allclose(targets, motion.at(t), **TOLERANCE)


def test_urscript_is_short_ascii(tmp_path: Path) -> None:
    trajectory = complete_motion(6)
    script = exporters.write(trajectory, "urscript", tmp_path / "p.script").read_text()
    rows = exporters.write(trajectory, "ur-csv", tmp_path / "p.csv").read_text()
    assert len(script) < 40_000 < 5 * len(script) < len(rows)
    assert not re.search(r"\d[eE][-+]?\d", script)
    assert len(re.findall(r"^\s*(?:def|while)\b", script, re.MULTILINE)) == len(
        re.findall(r"^\s*end$", script, re.MULTILINE)
    )


def test_urscript_segments_are_rebuilt(tmp_path: Path) -> None:
    trajectory = complete_motion(6)
    motion = urscript.rebuilt_motion(
        exporters.write(trajectory, "urscript", tmp_path / "p.script").read_text()
    )
    assert [s.kind for s in motion.segments] == [s.kind for s in trajectory.motion.segments]
    np.testing.assert_allclose(
        motion.fourier.sine, trajectory.motion.fourier.sine, rtol=1e-14, atol=1e-15
    )


def test_special_joint_names_are_exported(tmp_path: Path) -> None:
    trajectory = complete_motion(6)
    names = ('a,"b"', "c\nmovej()", "# d", "é", "start [rad]: 1", "rate [Hz]: 1")
    odd = trajectory_of(Motion(names, trajectory.motion.fourier, 2, trajectory.motion.segments))
    for name in exporters.FORMATS:
        if JOINTS.get(name, 6) != 6:
            continue
        if name == "json":
            with pytest.raises(UnusableInput, match="control character"):
                exporters.read(name, exporters.write(odd, name, tmp_path / "out"))
            continue
        t, q, *_ = exporters.read(name, exporters.write(odd, name, tmp_path / "out"))
        np.testing.assert_allclose(q, trajectory.motion.at(t), **TOLERANCE)
