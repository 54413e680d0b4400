"""The search itself: subproblems, resuming, many starts, back ends."""

from __future__ import annotations

import itertools
from dataclasses import replace

import joblib
import numpy as np
import pytest
import scipy.optimize
from conftest import QUICK

from excite.designer import cluster, multistart, qp_subproblem, sqp
from excite.designer import optimize as optimize_module
from excite.designer.criteria import Criterion
from excite.designer.evaluator import Evaluator
from excite.errors import UnusableInput
from excite.robot import limits
from excite.robot.robot import load


@pytest.fixture(scope="module")
def problem():
    robot = load("two_link")
    return optimize_module.set_up(robot, limits.resolve(robot), QUICK).problem


# -- one step ------------------------------------------------------------------------------------------------------


def program(seed: int, size: int = 12, rows: int = 90) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size))
    J = rng.normal(size=(rows, size))
    return (
        root @ root.T + 0.1 * np.eye(size),
        rng.normal(size=size),
        J,
        rng.uniform(0.0, 2.0, rows),
        np.full(size, -0.7),
        np.full(size, 0.7),
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_step_solves_its_quadratic_program(seed):
    B, g, J, room, lower, upper = program(seed)
    step, multipliers = qp_subproblem.solve(B, g, J, room, lower, upper)
    other = scipy.optimize.minimize(
        lambda d: g @ d + 0.5 * d @ B @ d,
        np.zeros(len(g)),
        jac=lambda d: g + B @ d,
        bounds=list(zip(lower, upper, strict=True)),
        constraints={"type": "ineq", "fun": lambda d: room - J @ d, "jac": lambda d: -J},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-14},
    )
    assert step == pytest.approx(other.x, abs=1e-5)
    assert (J @ step <= room + 1e-6).all() and (multipliers >= 0.0).all()
    # stationary but for the bounds, and only rows that bind have multipliers
    free = (step > lower + 1e-6) & (step < upper - 1e-6)
    assert (g + B @ step + J.T @ multipliers)[free] == pytest.approx(0.0, abs=1e-5)
    assert multipliers * (room - J @ step) == pytest.approx(0.0, abs=1e-5)


def test_rows_far_from_their_limit_join_when_a_step_would_break_them():
    J, room = np.eye(2), np.array([10.0 * qp_subproblem.WORKING_SET_SLACK, 5.0])
    step, multipliers = qp_subproblem.solve(
        np.eye(2), np.array([-3.0, -1.0]), J, room, np.full(2, -9.0), np.full(2, 9.0)
    )
    assert step == pytest.approx([room[0], 1.0])
    assert multipliers == pytest.approx([3.0 - room[0], 0.0], abs=1e-6)


def test_rows_that_no_step_can_mend_leave_a_step_within_the_region():
    J, room = np.array([[1.0], [-1.0]]), np.array([-0.5, -0.5])
    step, _ = qp_subproblem.solve(
        np.eye(1), np.array([1.0]), J, room, np.full(1, -0.1), np.full(1, 0.1)
    )
    assert abs(step[0]) <= 0.1 + 1e-6


# -- resuming ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("criterion", [Criterion.A, Criterion.COND_REGRESSOR])
def test_a_search_put_aside_and_resumed_ends_where_it_would_have(problem, criterion):
    built = replace(problem, options=replace(problem.options, criterion=criterion, iterations=80))
    x = np.full(built.size, 0.05)
    x[:: built.options.harmonics] = 0.1
    whole = sqp.advance(Evaluator(built), sqp.initial_state(x), sqp.History())
    state = sqp.initial_state(x)
    for _ in range(100):
        state = sqp.advance(Evaluator(built), state, sqp.History(), 7)
        if state.done:
            break
    assert state.done and whole.done
    assert state.iterations == whole.iterations
    assert np.array_equal(state.best, whole.best)


def test_the_budget_of_iterations_holds_over_all_stages(problem):
    built = replace(problem, options=replace(problem.options, criterion=Criterion.E, iterations=9))
    history = sqp.History()
    state = sqp.advance(Evaluator(built), sqp.initial_state(np.full(built.size, 0.05)), history)
    assert state.done and state.iterations == len(history.time) == 9


# -- many starts ---------------------------------------------------------------------------------------------------


@pytest.fixture
def quick_rounds(monkeypatch):
    monkeypatch.setattr(multistart, "ROUNDS", (4, 8))
    monkeypatch.setattr(multistart, "MANY", 6)


def test_the_worse_half_stops_early_and_says_so(problem, quick_rounds):
    told: list[str] = []
    built = replace(problem, options=replace(problem.options, starts=8, jobs=1, iterations=40))
    found = multistart.run_starts(built, 0.0, range(8), told.append)
    assert sorted(a.number for a in found) == list(range(8))
    assert [a.objective for a in found] == sorted(a.objective for a in found)
    used = sorted(a.state.iterations for a in found if a.stopped)
    assert used == [4] * 4 + [8] * 2
    finished = [a for a in found if not a.stopped]
    assert len(finished) == 2 and all(a.state.done and a.state.iterations > 8 for a in finished)
    assert len(told) == 8 + 4 + 2 and told[-1].startswith("round 3/3, start 2/2")
    assert all(len(a.time) == len(a.values) == a.state.iterations + 1 for a in found)


def test_what_finishes_is_what_it_would_have_been_alone(problem, quick_rounds):
    built = replace(problem, options=replace(problem.options, starts=8, jobs=1, iterations=40))
    best = next(a for a in multistart.run_starts(built, 0.0, range(8)) if not a.stopped)
    (alone,) = multistart.run_starts(built, 0.0, [best.number])
    assert np.array_equal(alone.motion.sine, best.motion.sine) and alone.objective == best.objective


def test_few_starts_all_run_to_their_end(problem):
    built = replace(problem, options=replace(problem.options, jobs=1, iterations=40))
    assert not any(a.stopped for a in multistart.run_starts(built, 0.0, range(multistart.MIN_STARTS_FOR_HALVING - 1)))


def same(one: list, other: list) -> bool:
    return [a.number for a in one] == [a.number for a in other] and all(
        np.array_equal(a.motion.sine, b.motion.sine) and a.state.iterations == b.state.iterations
        for a, b in zip(one, other, strict=True)
    )


@pytest.mark.parametrize("name", ["multiprocessing", "loky"])
def test_the_back_end_changes_no_bit(problem, quick_rounds, name):
    built = replace(problem, options=replace(problem.options, jobs=2, iterations=12))
    with cluster.backend(name):
        spread = multistart.run_starts(built, 0.0, range(6))
    with joblib.parallel_config(n_jobs=1):
        alone = multistart.run_starts(
            replace(built, options=replace(built.options, jobs=1)), 0.0, range(6)
        )
    assert same(spread, alone)


@pytest.mark.filterwarnings("ignore")  # Dask's own
def test_a_local_dask_cluster_changes_no_bit(problem):
    pytest.importorskip("distributed", reason="Dask is not installed (excite[dask])")
    from dask.distributed import Client, LocalCluster

    built = replace(problem, options=replace(problem.options, jobs=-1, iterations=6))
    with (
        LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
        ) as local,
        Client(local),
        cluster.backend("dask", local.scheduler_address),
    ):
        spread = multistart.run_starts(built, 0.0, range(4))
    assert same(
        spread,
        multistart.run_starts(replace(built, options=replace(built.options, jobs=1)), 0.0, range(4)),
    )


@pytest.mark.parametrize(
    ("name", "address", "words"),
    [("loky", "tcp://x:1", "no cluster"), ("ray", "ray://nowhere:1", "Ray")],
)
def test_a_cluster_that_is_not_there_is_one_line(name, address, words):
    with pytest.raises(UnusableInput, match=words) as caught, cluster.backend(name, address):
        pass
    assert "\n" not in str(caught.value)


# -- sparsity ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["two_link", "panda"])
def test_support_and_blocks_change_nothing_but_the_cost(name):
    robot = load(name)
    built = optimize_module.set_up(robot, limits.resolve(robot), QUICK).problem
    evaluator, x = Evaluator(built), np.random.default_rng(0).normal(size=built.size)
    Y = evaluator._regressor_at(evaluator._at(x)).copy()
    sparse, dense = built.weighting, replace(built.weighting, support=None)
    assert sparse.support is not None
    slope = np.eye(sparse.columns.shape[1])
    assert np.allclose(
        sparse.rows(Y), dense.rows(Y), rtol=1e-12, atol=1e-12 * np.abs(dense.rows(Y)).max()
    )
    seen = np.zeros(Y.shape, bool)
    for j, columns in enumerate(sparse.support):
        seen[:, j, columns] = True
    assert not Y[~seen].any()
    assert np.allclose(
        sparse.regressor_gradient(Y, slope)[seen], dense.regressor_gradient(Y, slope)[seen], rtol=1e-9, atol=1e-12
    )
    flat = Y.reshape(-1, Y.shape[2])
    whole = np.einsum("rp,pq,rq->r", flat, built.parameters.scale @ built.parameters.scale.T, flat)
    assert np.allclose(built.parameters.norms(flat), whole, rtol=1e-9)


def test_both_ways_to_the_spectrum_agree(monkeypatch):
    from excite.designer import criteria

    rng = np.random.default_rng(0)
    rows = rng.normal(size=(80, 6)) * np.geomspace(1.0, 30.0, 6)
    found = {}
    for narrow in (1e-6, 1.0):  # squared; from the rows themselves
        monkeypatch.setattr(criteria, "NARROW", narrow)
        found[narrow] = [criteria.smooth_objective(c, rows, 4.0) for c in Criterion]
    for (value, slope), (other, its_slope) in zip(*found.values(), strict=True):
        assert value == pytest.approx(other, rel=1e-10)
        assert np.allclose(slope, its_slope, rtol=1e-8, atol=1e-12 * np.abs(slope).max())


def test_every_criterion_has_stages_that_sharpen():
    for criterion in Criterion:
        sharpness = sqp.sharpness_stages(criterion)
        assert all(a < b for a, b in itertools.pairwise(sharpness))
