"""Searches that begin again by themselves, and what they say where no motion exists."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import QUICK

from excite.collision import clearance_builder, scene_file
from excite.collision.geometry import Shape, ShapeKind
from excite.collision.scene_file import Scene
from excite.designer import initial_guess, multistart, optimize, pipeline, ramps, sqp
from excite.designer.evaluator import Evaluator
from excite.designer.multistart import Attempt
from excite.errors import CheckFailed, ExciteWarning, Infeasible


@pytest.fixture(scope="module")
def setup(two_link, table):
    return optimize.set_up(two_link, table, QUICK)


def test_start_at_rest_begins_again(setup, monkeypatch):
    """At rest the gradients of directions that a motion does not show vanish."""
    original, calls = initial_guess.scale_random_motion, []

    def at_rest_first(evaluator, pose, rng):
        calls.append(pose)
        if len(calls) == 1:
            return initial_guess.stationary_variables(evaluator.problem, pose)
        return original(evaluator, pose, rng)

    monkeypatch.setattr(initial_guess, "scale_random_motion", at_rest_first)
    monkeypatch.setattr(sqp, "STALL_ITERATIONS", 1)
    (attempt,) = multistart.run_starts(setup.problem, [0])
    assert isinstance(attempt, Attempt) and attempt.usable and len(calls) >= 2


def test_good_start_is_not_repeated(setup, monkeypatch):
    original, calls = initial_guess.find_static_poses, []

    def counted(*arguments):
        calls.append(arguments)
        return original(*arguments)

    monkeypatch.setattr(initial_guess, "find_static_poses", counted)
    (attempt,) = multistart.run_starts(setup.problem, [0])
    assert attempt.usable and len(calls) == 1


def test_infeasible_attempts_rank_last(setup):
    (good,) = multistart.run_starts(setup.problem, [0])
    infeasible = replace(
        good, objective=-99.0, state=replace(good.state, best_value=np.inf, best_excess=0.3)
    )
    worse = replace(infeasible, state=replace(infeasible.state, best_excess=0.5))
    blind = replace(good, objective=-98.0, excites_all=False)
    ranked = sorted([worse, infeasible, blind, good], key=lambda a: a.rank)
    assert ranked[0] is good and ranked[-1] is worse and not infeasible.usable


def test_constraint_that_no_pose_meets_with_ease_leaves_an_amplitude(two_link, table):
    """A rod next to the first joint, from which the first link keeps nearly one distance."""
    rod = Shape("rod", ShapeKind.SPHERE, (0.03,), (-0.095, 0.0, 0.0))
    cell = scene_file.build_cell(two_link, table, Scene((rod,), floor=False, clearance=0.02))
    constraint = clearance_builder.build_constraint(cell)
    built = optimize.set_up(two_link, table, QUICK, clearance=constraint)
    evaluator = Evaluator(built.problem)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        poses = initial_guess.find_static_poses(evaluator, rng)
        x = initial_guess.scale_random_motion(evaluator, poses[0], rng)
        assert evaluator.max_constraint_value(x) < 1.0
        assert np.abs(built.problem.fourier(x).sine).max() > 1e-2
        assert evaluator.spectrum_ratio(x) > multistart.MIN_SPECTRUM_RATIO


def test_initial_motion_uses_a_share_of_the_slack_of_its_pose(setup):
    """A pose at 0.997 of a position limit leaves less than `MAX_INITIAL_ROW_VALUE` asks for."""
    problem = setup.problem
    lower, upper = problem.limits.position.T
    pose = 0.5 * (lower + upper) + np.array([0.0, 0.997 * 0.5 * (upper - lower)[1]])
    evaluator = Evaluator(problem)
    x = initial_guess.scale_random_motion(evaluator, pose, np.random.default_rng(0))
    assert 0.997 < evaluator.max_constraint_value(x) < 1.0
    assert np.abs(problem.fourier(x).sine).max() > 1e-4


def test_parameters_that_no_motion_shows_are_named(two_link, table, monkeypatch):
    monkeypatch.setattr(multistart, "MIN_SPECTRUM_RATIO", 1.0)
    monkeypatch.setattr(multistart, "MAX_GUESSES", 1)
    with pytest.raises(
        Infeasible, match=r"2 searches excites all base parameters: .* stay unknown"
    ):
        pipeline.design_trajectory(two_link, table, replace(QUICK, iterations=3))


def test_certificate_that_keeps_failing_is_searched_again(two_link, table, monkeypatch):
    """After stalled tightenings the search begins again; the error names the limit."""
    original, verified = pipeline.certificate_module.certify, []

    def failing(trajectory, *arguments, **options):
        certificate = original(trajectory, *arguments, **options)
        verified.append(trajectory.motion.fourier.offset)
        worst = replace(certificate.margins[0], free_share=-0.01)
        return replace(certificate, margins=(worst, *certificate.margins[1:]))

    monkeypatch.setattr(pipeline.certificate_module, "certify", failing)
    lines: list[str] = []
    with pytest.raises(CheckFailed, match="no motion of 4 searches keeps all limits") as error:
        pipeline.design_trajectory(
            two_link, table, replace(QUICK, iterations=5), progress=lines.append
        )
    assert "--seed" not in str(error.value)
    assert sum("searching from other poses" in line for line in lines) == pipeline.MAX_RESTARTS
    assert len({offset.tobytes() for offset in verified}) > pipeline.MAX_RESTARTS


def test_loss_of_a_motion_without_ramps_is_stated(two_link, table, monkeypatch):
    """A worse attempt is not delivered in silence because ramps failed for the best one."""
    original, calls = ramps.plan_rest_to_rest, []

    def failing_first(*arguments):
        calls.append(arguments)
        if len(calls) == 1:
            raise Infeasible("two_link: no ramp keeps the torque limits")
        return original(*arguments)

    monkeypatch.setattr(ramps, "plan_rest_to_rest", failing_first)
    monkeypatch.setattr(pipeline, "NOTABLE_LOSS", -1.0)
    with pytest.warns(ExciteWarning, match=r"not certified \(no ramps \(no ramp keeps the torque"):
        pipeline.design_trajectory(two_link, table, replace(QUICK, starts=2))
