"""Large robots, grids and recordings: computed, or refused with an estimate before."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from large_robots import tree_urdf

from excite._system.resources import MAX_TIME, Cost, duration, machine_memory
from excite.cli import main as cli
from excite.designer import criteria, design_cost
from excite.designer.options import DesignOptions
from excite.errors import UnusableInput
from excite.recordings import recording_cost
from excite.robot import base_parameters, dynamics, inertial_parameters
from excite.robot.limits import resolve
from excite.robot.robot import Robot, load
from excite.robot.samples import Samples


def tree(folder: Path, joints: int, limbs: int) -> Path:
    path = folder / f"tree_{joints}.urdf"
    path.write_text(tree_urdf(joints, limbs), encoding="utf-8")
    return path


def states(robot: Robot, count: int) -> Samples:
    rng = np.random.default_rng(3)
    return Samples(*(rng.normal(size=(count, robot.n)) for _ in range(3)))


# -- estimates -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [
        {"samples": 200},
        {"harmonics": 10},
        {"starts": 40},
        {"iterations": 50},
        {"periods": 4},
    ],
)
def test_the_estimate_increases_with_all_sizes(change, two_link):
    options = DesignOptions(starts=4, iterations=20)
    before = design_cost.estimated(two_link, options)
    after = design_cost.estimated(two_link, dataclasses.replace(options, **change))
    assert after.seconds > before.seconds or after.memory > before.memory
    assert after.seconds >= before.seconds and after.memory >= before.memory


def test_the_estimate_increases_more_than_linearly_with_the_joints(tmp_path):
    few, many = (load(str(tree(tmp_path, n, 5))) for n in (20, 60))
    costs = [design_cost.estimated(robot, DesignOptions()) for robot in (few, many)]
    assert costs[1].seconds > 5.0 * costs[0].seconds
    assert costs[1].memory > 2.0 * costs[0].memory


def test_sixty_joints_are_accepted(tmp_path):
    lines: list[str] = []
    design_cost.require(load(str(tree(tmp_path, 60, 5))), DesignOptions(), say=lines.append)
    assert len(lines) == 1 and "60 joints" in lines[0] and "min and" in lines[0]


def test_a_small_design_is_not_announced(two_link):
    lines: list[str] = []
    design_cost.require(two_link, DesignOptions(), say=lines.append)
    assert not lines


def test_a_computation_of_more_than_a_day_is_refused_with_the_estimate(tmp_path):
    robot = load(str(tree(tmp_path, 60, 5)))
    with pytest.raises(
        UnusableInput,
        match=r"60 joints, 5 harmonics, 100 samples, 100000 starts: needs about .* days .*--joints",
    ):
        design_cost.require(robot, DesignOptions(starts=100_000))


@pytest.mark.parametrize(
    ("cost", "part"),
    [
        (Cost(1.0, 1e15), "GB"),
        (Cost(2.0 * MAX_TIME, 1e6), "days"),
        (Cost(float("inf"), 1e6), "longer"),
    ],
)
def test_a_computation_beyond_the_memory_is_refused(cost, part):
    with pytest.raises(UnusableInput, match=part):
        cost.require("work", "do less")


def test_the_memory_of_the_machine_is_known():
    memory = machine_memory()
    assert memory is None or 1e8 < memory < 1e14


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.53, "0.53 s"),
        (42.0, "42 s"),
        (200.0, "3.3 min"),
        (7200.0, "2 h"),
        (3e5, "3.5 days"),
    ],
)
def test_durations_in_words(seconds, words):
    assert duration(seconds) == words


# -- commands --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--periods", "100000"], "rows"),
        (["--rate", "100000", "--period", "100"], "rows"),
        (["--starts", "1000000", "--harmonics", "100", "--samples", "20000"], "--starts"),
    ],
)
def test_a_design_that_is_too_large_is_refused_at_once(options, part, tmp_path, capsys):
    assert cli.main(["design", "two_link", "-o", str(tmp_path / "out"), *options]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and part in line
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_twelve_joints_are_designed(tmp_path, capsys):
    words = [
        "--no-collision",
        "--starts",
        "1",
        "--iterations",
        "2",
        "--harmonics",
        "2",
        "--samples",
        "24",
        "--jobs",
        "1",
    ]
    code = cli.main(["design", str(tree(tmp_path, 12, 3)), "-o", str(tmp_path / "out"), *words])
    assert code == 0, capsys.readouterr().err
    assert (tmp_path / "out" / "trajectory.json").is_file()


@pytest.mark.parametrize(("rows", "fits"), [(10**6, True), (10**11, False)])
def test_a_recording_that_exceeds_the_memory_is_refused(rows, fits):
    if fits:
        recording_cost.require_readable("run.csv", rows, 5 * rows)
        return
    with pytest.raises(UnusableInput, match=r"run\.csv: 100000000000 rows and more: needs .* GB"):
        recording_cost.require_readable("run.csv", rows, 5 * rows)


# -- long motions in blocks ----------------------------------------------------------------------


def test_torque_of_a_long_motion_equals_that_of_its_parts(tmp_path):
    robot = load(str(tree(tmp_path, 30, 3)))
    standard = inertial_parameters.standard_parameters(robot, resolve(robot))
    motion = states(robot, 350)
    assert len(list(dynamics.regressor_blocks(robot, standard, motion))) > 1
    nominal, width = dynamics.torque_band(robot, standard, motion, 0.1)
    complete = dynamics.band(dynamics.regressor(robot, standard, motion), standard, 0.1)
    assert np.allclose(nominal, complete[0], rtol=1e-12, atol=1e-9) and np.allclose(
        width, complete[1], rtol=1e-10
    )
    assert np.array_equal(dynamics.torque(robot, standard, motion), nominal)


def test_criteria_of_a_long_motion_equal_those_of_its_parts(two_link):
    table = resolve(two_link)
    standard = inertial_parameters.standard_parameters(two_link, table)
    base = base_parameters.find(two_link, standard, table)
    Y = dynamics.regressor(two_link, standard, states(two_link, 300))
    noise = np.array([0.3, 0.1])
    together = criteria.evaluate_criteria(Y, base, noise)
    parts = criteria.evaluate_criteria(iter([Y[:7], Y[7:180], Y[180:]]), base, noise)
    for name in ("geometric", "plain"):
        assert parts[name] == pytest.approx(together[name], rel=1e-9)
    assert parts["cond_regressor"] == pytest.approx(together["cond_regressor"], rel=1e-9)


def test_a_motion_without_samples_has_no_torque(two_link):
    standard = inertial_parameters.standard_parameters(two_link, resolve(two_link))
    assert dynamics.torque(two_link, standard, states(two_link, 0)).shape == (0, 2)
