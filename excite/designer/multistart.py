"""Many starts: independent searches spread over processes, the hopeless ones put aside early.

The order of events is fixed by the numbers alone: all starts run a little, the better half goes on, then the better
half of those runs to its end. One seed therefore gives one result on one core or on a cluster.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import joblib
import numpy as np
import threadpoolctl

from ..errors import ExciteError
from ..trajectory.fourier import FourierSeries
from . import initial_guess, sqp
from .evaluator import Evaluator
from .problem import DesignProblem

Array = np.ndarray
Progress = Callable[[str], None]

HALVING_ITERATIONS = (60, 90)
"""Iterations after which the worse half stops: earlier, the order says little about the end (rank correlation 0.3 after
40, 0.7 after 60, 0.8 after 90 iterations over 60 starts of two arms)."""
MIN_STARTS_FOR_HALVING = 8
"""Fewer starts than this all run to their end."""


@dataclass(frozen=True)
class Attempt:
    """One start: its number, the motion it found, the smooth objective there, and its history (times since `built`).

    state: where its search stands. stopped: put aside before its end, because others were ahead.
    """

    number: int
    motion: FourierSeries
    objective: float
    time: tuple[float, ...]
    values: tuple[float, ...]
    worst: tuple[float, ...]
    stage: tuple[int, ...]
    state: sqp.SearchState
    stopped: bool = False


@dataclass(frozen=True)
class _Round:
    """What every task of one round needs: until how many iterations a start may go, and when the clock began [s]."""

    problem: DesignProblem
    built: float
    until: int


def run_starts(
    problem: DesignProblem, built: float, numbers: Sequence[int], progress: Progress | None = None
) -> list[Attempt | ExciteError]:
    """All starts, the best first; one that found no feasible pose comes back as its error, last.

    numbers: of the starts; each has a random stream of its own. built: time.perf_counter() when the problem was ready [s].
    """
    end = problem.options.iterations
    limits = (*(r for r in HALVING_ITERATIONS if r < end), end) if len(numbers) >= MIN_STARTS_FOR_HALVING else (end,)
    errors: list[ExciteError] = []
    aside: list[Attempt] = []
    alive: list[int | Attempt] = list(numbers)
    for turn, until in enumerate(limits):
        tell = None if progress is None else _Teller(progress, len(alive), turn, len(limits))
        ended = _spread(_Round(problem, built, until), alive, tell)
        errors += [e for e in ended if isinstance(e, ExciteError)]
        ranked = sorted(
            (a for a in ended if isinstance(a, Attempt)), key=lambda a: (a.objective, a.number)
        )
        kept = len(ranked) if until == end else -(-len(ranked) // 2)
        aside += [dataclasses.replace(a, stopped=not a.state.done) for a in ranked[kept:]]
        alive = list(ranked[:kept])
    finished = [a for a in alive if isinstance(a, Attempt)]
    # a start put aside in the lead of one that ran on to its end is a result all the same
    return [*sorted([*finished, *aside], key=lambda a: (a.objective, a.number)), *errors]


def _spread(
    task: _Round,
    alive: Sequence[int | Attempt],
    tell: Callable[[Attempt | ExciteError], None] | None,
) -> list[Attempt | ExciteError]:
    """Run one round, several starts a task: sending the problem costs as much as a few iterations."""
    ended: list[Attempt | ExciteError] = []
    for group in _groups(task, alive):
        ended += group
        if tell is not None:
            for one in group:
                tell(one)
    return ended


def _groups(task: _Round, alive: Sequence[int | Attempt]) -> Iterator[list[Attempt | ExciteError]]:
    if len(alive) == 1:
        yield _group(task, alive)
        return
    workers = min(joblib.effective_n_jobs(task.problem.options.jobs), len(alive))
    size = max(1, len(alive) // (16 * workers))
    tasks = [joblib.delayed(_group)(task, alive[i : i + size]) for i in range(0, len(alive), size)]
    with joblib.Parallel(n_jobs=workers) as pool:
        for i in range(
            0, len(tasks), 4 * workers
        ):  # not all at once, so that progress shows; not every back end can stream
            yield from pool(tasks[i : i + 4 * workers])


@dataclass
class _Teller:
    """Says how far a round is."""

    progress: Progress
    count: int
    turn: int
    turns: int
    told: int = 0
    best: float = np.inf

    def __call__(self, one: Attempt | ExciteError) -> None:
        self.told += 1
        if isinstance(one, ExciteError):
            return
        self.best = min(self.best, one.objective)
        which = f"round {self.turn + 1}/{self.turns}, " if self.turns > 1 else ""
        self.progress(
            f"{which}start {self.told}/{self.count}: objective {one.objective:.4f}, best {self.best:.4f}"
        )


def _group(task: _Round, some: Sequence[int | Attempt]) -> list[Attempt | ExciteError]:
    with threadpoolctl.threadpool_limits(
        1
    ):  # the same sums in the same order, whatever the number of processes
        evaluator = Evaluator(task.problem)
        return [
            _begin(evaluator, task, one) if isinstance(one, int) else _go_on(evaluator, task, one)
            for one in some
        ]


def _begin(evaluator: Evaluator, task: _Round, number: int) -> Attempt | ExciteError:
    """A start from its own random stream; an error that names limits comes back as a value, out of any process."""
    rng = np.random.default_rng([task.problem.options.seed, number])
    try:
        held = initial_guess.find_static_poses(evaluator, rng)
    except ExciteError as error:
        return error
    pose = held[rng.integers(min(len(held), 1 + len(held) // 4))]
    return optimize_from(
        evaluator, initial_guess.scale_random_motion(evaluator, pose, rng), task.built, number, task.until
    )


def optimize_from(
    evaluator: Evaluator, x: Array, built: float, number: int, until: int | None = None
) -> Attempt:
    """Optimise from the variables x on, to the end or to a number of iterations."""
    sharpness = sqp.sharpness_stages(evaluator.problem.options.criterion)
    history = sqp.History(began=built)
    history.add(
        evaluator.objective(x, sharpness[-1])[0],
        evaluator.max_constraint_value(x),
        len(sharpness) - 1 if len(sharpness) == 1 else 0,
    )
    return _attempt(
        evaluator, number, sqp.advance(evaluator, sqp.initial_state(x), history, until), history
    )


def _go_on(evaluator: Evaluator, task: _Round, before: Attempt) -> Attempt:
    history = sqp.History(
        task.built, list(before.time), list(before.values), list(before.worst), list(before.stage)
    )
    more = task.until - before.state.iterations
    return _attempt(
        evaluator, before.number, sqp.advance(evaluator, before.state, history, more), history
    )


def _attempt(evaluator: Evaluator, number: int, state: sqp.SearchState, history: sqp.History) -> Attempt:
    problem = evaluator.problem
    objective = evaluator.objective(state.best, sqp.sharpness_stages(problem.options.criterion)[-1])[0]
    h = history
    return Attempt(
        number,
        problem.fourier(state.best),
        objective,
        tuple(h.time),
        tuple(h.objective),
        tuple(h.worst),
        tuple(h.stage),
        state,
    )
