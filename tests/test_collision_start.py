"""Designs among things: begun within sight of a given pose, refused at once where it touches, mended where samples are too coarse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import QUICK

from excite.collision import clearance_builder, scene_file
from excite.designer import optimize, pipeline, ramps
from excite.designer.initial_guess import reachable_along_lines
from excite.designer.options import DesignOptions
from excite.designer.time_budget import MotionRequest
from excite.errors import Infeasible, UnusableInput
from excite.robot import limits
from excite.robot.robot import load

FOLDED = np.array(
    [1.0, 1.0, 4.7, 4.0, -4.8, -1.5]
)  # its elbow is beyond half a turn: the arm folded parts it from the middle


@pytest.fixture(scope="module")
def placed():
    robot = load("ur5e")
    table = limits.resolve(robot)
    return robot, table, scene_file.cell(robot, table, scene_file.Scene(floor=-0.7))


def test_poses_within_sight_are_reached_straight(placed):
    _, table, cell = placed
    clearance = clearance_builder.clearance(cell)
    rng = np.random.default_rng(0)
    poses = reachable_along_lines(clearance, FOLDED, rng.uniform(*table.position.T, (50, 6)), rng)
    lines = FOLDED + np.linspace(0.0, 1.0, 41)[:, None, None] * (poses - FOLDED)
    # between the poses that were looked at, as little may be lost as the planner finds out later
    assert (clearance.least(lines.reshape(-1, 6))[0] > -0.02).all()
    assert np.ptp(poses, axis=0).min() > 0.5
    assert (poses[:, 2] > np.pi - 0.5).all()


def test_a_motion_is_found_from_a_pose_that_folds_part_from_the_others(placed):
    robot, table, cell = placed
    options = replace(MotionRequest().complete(DesignOptions(starts=1, jobs=1), table), iterations=20)
    delivery = pipeline.design_trajectory(robot, table, options, start=FOLDED, cell=cell)
    motion = delivery.trajectory.motion
    assert (
        delivery.certificate.ok
        and motion.segments[0].kind == "approach"
        and motion.segments[-1].kind == "return"
    )
    assert motion.at(np.zeros(1))[0] == pytest.approx(FOLDED)


def test_a_start_pose_that_touches_is_refused_before_the_design(placed, monkeypatch):
    robot, table, cell = placed
    monkeypatch.setattr(pipeline.optimize, "solve", lambda *_: pytest.fail("designed first"))
    into_floor = np.array([0.0, 1.5, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(UnusableInput, match=r"start pose: .*floor"):
        pipeline.design_trajectory(robot, table, MotionRequest().complete(DesignOptions(), table), start=into_floor, cell=cell)
    with pytest.raises(UnusableInput, match="6 finite positions"):
        pipeline.design_trajectory(robot, table, MotionRequest().complete(DesignOptions(), table), start=np.zeros(5), cell=cell)


@pytest.mark.parametrize("without", [1, 2])
def test_where_the_best_start_has_no_ramps_the_next_is_taken(monkeypatch, without):
    robot = load("two_link")
    calls, real = [], ramps.plan_rest_to_rest

    def choosy(subject, fourier, *rest):
        calls.append(fourier)
        if len(calls) <= without:
            raise Infeasible(f"no way {len(calls)}")
        return real(subject, fourier, *rest)

    monkeypatch.setattr(ramps, "rest_to_rest", choosy)
    options = replace(QUICK, starts=2, jobs=1)
    if without == 2:
        with pytest.raises(Infeasible, match="no way 1"):
            pipeline.design_trajectory(robot, limits.resolve(robot), options)
        return
    delivery = pipeline.design_trajectory(robot, limits.resolve(robot), options)
    assert delivery.certificate.ok and len(delivery.design.attempts) == 2
    assert delivery.design.attempts[0].objective >= delivery.design.attempts[1].objective


def test_only_the_pairs_that_came_too_near_keep_further_away(placed):
    robot, table, cell = placed
    setting = optimize.set_up(
        robot, table, MotionRequest().complete(DesignOptions(), table), clearance=clearance_builder.clearance(cell)
    )
    before, name = setting.problem.clearance, setting.problem.clearance.names[0]
    twice = setting
    for _ in range(2):
        twice = optimize.tighten(twice, table, 2e-3, {name: 3e-3}, finer=True)
    after = twice.problem.clearance
    assert twice.problem.options.samples == 4 * setting.problem.options.samples
    pose = FOLDED[None]
    changed = (after.at(pose).values() - before.at(pose).values())[0] * before.unit
    assert changed == pytest.approx([6e-3 if one == name else 0.0 for one in before.names])
    assert after.least(pose)[0] == before.least(pose)[0]  # ramps keep the margin alone
