"""Many starts: successive halving, processes, clusters."""

from __future__ import annotations

from dataclasses import replace

import joblib
import numpy as np
import pytest
from conftest import QUICK

from excite.designer import cluster, multistart, optimize
from excite.errors import UnusableInput
from excite.robot import limits
from excite.robot.robot import load


@pytest.fixture(scope="module")
def problem():
    robot = load("two_link")
    return optimize.set_up(robot, limits.resolve(robot), QUICK).problem


@pytest.fixture
def quick_rounds(monkeypatch):
    monkeypatch.setattr(multistart, "HALVING_ITERATIONS", (4, 8))
    monkeypatch.setattr(multistart, "MIN_STARTS_FOR_HALVING", 6)


def test_worse_half_of_the_starts_stops_early(problem, quick_rounds):
    messages: list[str] = []
    built = replace(problem, options=replace(problem.options, starts=8, jobs=1, iterations=40))
    results = multistart.run_starts(built, range(8), messages.append)
    assert sorted(a.number for a in results) == list(range(8))
    assert [a.objective for a in results] == sorted(a.objective for a in results)
    used = sorted(a.state.iterations for a in results if a.stopped)
    assert used == [4] * 4 + [8] * 2
    finished = [a for a in results if not a.stopped]
    assert len(finished) == 2 and all(a.state.done and a.state.iterations > 8 for a in finished)
    assert len(messages) == 8 + 4 + 2 and messages[-1].startswith("round 3/3, start 2/2")
    assert all(len(a.history.time) == a.state.iterations + 1 for a in results)


def test_finished_start_equals_the_same_start_alone(problem, quick_rounds):
    built = replace(problem, options=replace(problem.options, starts=8, jobs=1, iterations=40))
    best = next(a for a in multistart.run_starts(built, range(8)) if not a.stopped)
    (alone,) = multistart.run_starts(built, [best.number])
    assert np.array_equal(alone.motion.sine, best.motion.sine) and alone.objective == best.objective


def test_few_starts_all_run_to_their_end(problem):
    built = replace(problem, options=replace(problem.options, jobs=1, iterations=40))
    assert not any(
        a.stopped
        for a in multistart.run_starts(built, range(multistart.MIN_STARTS_FOR_HALVING - 1))
    )


def are_equal(first: list, second: list) -> bool:
    return [a.number for a in first] == [a.number for a in second] and all(
        np.array_equal(a.motion.sine, b.motion.sine) and a.state.iterations == b.state.iterations
        for a, b in zip(first, second, strict=True)
    )


@pytest.mark.parametrize("name", ["multiprocessing", "loky"])
def test_back_end_does_not_change_the_result(problem, quick_rounds, name):
    built = replace(problem, options=replace(problem.options, jobs=2, iterations=12))
    with cluster.backend(name):
        spread = multistart.run_starts(built, range(6))
    with joblib.parallel_config(n_jobs=1):
        alone = multistart.run_starts(
            replace(built, options=replace(built.options, jobs=1)), range(6)
        )
    assert are_equal(spread, alone)


@pytest.mark.filterwarnings("ignore")  # warnings of Dask
def test_dask_cluster_does_not_change_the_result(problem):
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
        spread = multistart.run_starts(built, range(4))
    assert are_equal(
        spread,
        multistart.run_starts(replace(built, options=replace(built.options, jobs=1)), range(4)),
    )


@pytest.mark.parametrize(
    ("name", "address", "words"),
    [("loky", "tcp://x:1", "no cluster"), ("ray", "ray://nowhere:1", "Ray")],
)
def test_missing_cluster_is_a_one_line_error(name, address, words):
    with pytest.raises(UnusableInput, match=words) as caught, cluster.backend(name, address):
        pass
    assert "\n" not in str(caught.value)
