"""Designs in a cell: start poses, infeasible ramps, and clearance between samples."""

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

FOLDED = np.array([1.0, 1.0, 4.7, 4.0, -4.8, -1.5])
"""Pose whose elbow is beyond half a turn; the folded arm separates it from the middle [rad]."""


@pytest.fixture(scope="module")
def ur5e_cell():
    robot = load("ur5e")
    table = limits.resolve(robot)
    return robot, table, scene_file.build_cell(robot, table, scene_file.Scene(floor=-0.7))


def test_poses_are_reachable_along_straight_lines(ur5e_cell):
    _, table, cell = ur5e_cell
    clearance = clearance_builder.build_constraint(cell)
    rng = np.random.default_rng(0)
    poses = reachable_along_lines(clearance, FOLDED, rng.uniform(*table.position.T, (50, 6)), rng)
    lines = FOLDED + np.linspace(0.0, 1.0, 41)[:, None, None] * (poses - FOLDED)
    # a small violation is allowed between the checked poses; the planner detects it
    assert (clearance.least_excess(lines.reshape(-1, 6))[0] > -0.02).all()
    assert np.ptp(poses, axis=0).min() > 0.5
    assert (poses[:, 2] > np.pi - 0.5).all()


def test_design_from_a_folded_start_pose(ur5e_cell):
    robot, table, cell = ur5e_cell
    options = replace(
        MotionRequest().complete(DesignOptions(starts=1, jobs=1), table), iterations=20
    )
    delivery = pipeline.design_trajectory(robot, table, options, start=FOLDED, cell=cell)
    motion = delivery.trajectory.motion
    assert (
        delivery.certificate.ok
        and motion.segments[0].kind == "approach"
        and motion.segments[-1].kind == "return"
    )
    assert motion.at(np.zeros(1))[0] == pytest.approx(FOLDED)


def test_start_pose_in_collision_is_refused_before_the_design(ur5e_cell, monkeypatch):
    robot, table, cell = ur5e_cell
    monkeypatch.setattr(pipeline.optimize, "solve", lambda *_: pytest.fail("the search has begun"))
    into_floor = np.array([0.0, 1.5, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(UnusableInput, match=r"start pose: .*floor"):
        pipeline.design_trajectory(
            robot,
            table,
            MotionRequest().complete(DesignOptions(), table),
            start=into_floor,
            cell=cell,
        )
    with pytest.raises(UnusableInput, match="6 finite positions"):
        pipeline.design_trajectory(
            robot,
            table,
            MotionRequest().complete(DesignOptions(), table),
            start=np.zeros(5),
            cell=cell,
        )


@pytest.mark.parametrize("failures", [1, 2, 3, 99])
def test_next_best_start_is_used_where_the_best_has_no_ramps(monkeypatch, failures):
    """After all starts the search begins again; an error is that of the best start."""
    robot = load("two_link")
    calls, original = [], ramps.plan_rest_to_rest

    def failing_first(constraints, fourier, *arguments):
        calls.append(fourier)
        if len(calls) <= failures:
            raise Infeasible(f"no ramp {len(calls)}")
        return original(constraints, fourier, *arguments)

    monkeypatch.setattr(ramps, "plan_rest_to_rest", failing_first)
    options = replace(QUICK, starts=2, jobs=1)
    if failures == 99:
        with pytest.raises(Infeasible, match="no ramp 1"):
            pipeline.design_trajectory(robot, limits.resolve(robot), options)
        return
    delivery = pipeline.design_trajectory(robot, limits.resolve(robot), options)
    assert delivery.certificate.ok and len(delivery.design.attempts) == 2
    if failures == 1:
        assert delivery.design.attempts[0].objective >= delivery.design.attempts[1].objective


def test_clearance_is_added_only_for_violating_pairs(ur5e_cell):
    robot, table, cell = ur5e_cell
    setup = optimize.set_up(
        robot,
        table,
        MotionRequest().complete(DesignOptions(), table),
        clearance=clearance_builder.build_constraint(cell),
    )
    before, name = setup.problem.clearance, setup.problem.clearance.names[0]
    tightened = setup
    for _ in range(2):
        tightened = optimize.tighten(tightened, 2e-3, {name: 3e-3}, finer=True)
    after = tightened.problem.clearance
    assert tightened.problem.options.samples == 4 * setup.problem.options.samples
    pose = FOLDED[None]
    values = (c.evaluate(pose).constraint_values() for c in (after, before))
    changed = np.subtract(*values)[0] * before.scale
    assert changed == pytest.approx([6e-3 if pair == name else 0.0 for pair in before.names])
    # ramps keep the required clearance only
    assert after.least_excess(pose)[0] == before.least_excess(pose)[0]
