"""Sequential quadratic programming: resuming, budgets, stages."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from conftest import QUICK

from excite.designer import optimize, sqp
from excite.designer.criteria import Criterion
from excite.designer.evaluator import Evaluator
from excite.robot import limits
from excite.robot.robot import load


@pytest.fixture(scope="module")
def problem():
    robot = load("two_link")
    return optimize.set_up(robot, limits.resolve(robot), QUICK).problem


@pytest.mark.parametrize("criterion", [Criterion.A, Criterion.COND_REGRESSOR])
def test_resumed_search_equals_an_uninterrupted_one(problem, criterion):
    built = replace(problem, options=replace(problem.options, criterion=criterion, iterations=80))
    x = np.full(built.size, 0.05)
    x[:: built.options.harmonics] = 0.1
    uninterrupted = sqp.advance(Evaluator(built), sqp.initial_state(x), sqp.History())
    state = sqp.initial_state(x)
    for _ in range(100):
        state = sqp.advance(Evaluator(built), state, sqp.History(), 7)
        if state.done:
            break
    assert state.done and uninterrupted.done
    assert state.iterations == uninterrupted.iterations
    assert np.array_equal(state.best, uninterrupted.best)


def test_iterations_are_limited_over_all_stages(problem):
    built = replace(problem, options=replace(problem.options, criterion=Criterion.E, iterations=9))
    history = sqp.History()
    state = sqp.advance(Evaluator(built), sqp.initial_state(np.full(built.size, 0.05)), history)
    assert state.done and state.iterations == len(history.time) == 9


def test_sharpness_never_decreases_from_stage_to_stage():
    for criterion in Criterion:
        sharpness = sqp.sharpness_stages(criterion)
        assert all(a <= b for a, b in itertools.pairwise(sharpness))


def test_search_from_an_infeasible_start_ends_feasible(problem):
    x = np.full(problem.size, 0.5)
    evaluator = Evaluator(problem)
    assert evaluator.max_constraint_value(x) > 1.5
    state = sqp.advance(evaluator, sqp.initial_state(x), sqp.History())
    assert np.isfinite(state.best_value) and state.best_excess == 0.0
    assert evaluator.max_constraint_value(state.best) <= sqp.MAX_FEASIBLE_ROW_VALUE


def test_least_infeasible_iterate_is_kept_where_none_is_feasible(problem):
    x = np.full(problem.size, 3.0)
    evaluator, history = Evaluator(problem), sqp.History()
    before = evaluator.max_constraint_value(x)
    state = sqp.advance(evaluator, sqp.initial_state(x), history, 2)
    assert not np.isfinite(state.best_value)
    assert 1.0 + state.best_excess == pytest.approx(evaluator.max_constraint_value(state.best))
    assert 1.0 + state.best_excess < before


def test_search_stuck_at_an_infeasible_iterate_returns_to_its_best(problem):
    """It continues at the best feasible iterate with shorter steps, a few times at most."""
    evaluator = Evaluator(problem)
    feasible = np.full(problem.size, 0.01)
    infeasible = np.full(problem.size, 0.6)
    assert (
        evaluator.max_constraint_value(feasible) <= 1.0 < evaluator.max_constraint_value(infeasible)
    )
    f = evaluator.objective(feasible, 1.0)[0]
    stuck = sqp.SearchState(infeasible, feasible, f, 0.0, radius=1e-9)
    ended = sqp.advance(evaluator, stuck, sqp.History())
    assert ended.returns >= 1
    assert ended.best_value < f - 1.0
    exhausted = replace(stuck, returns=sqp.MAX_RETURNS)
    assert sqp.advance(evaluator, exhausted, sqp.History()).returns == sqp.MAX_RETURNS
