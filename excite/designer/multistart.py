"""Run many independent starts in parallel, with successive halving.

All starts run for a few iterations, the better half continues, and the better half of those runs
to its end. The schedule depends on iteration counts alone, so a seed gives the same result on one
core and on a cluster.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import joblib
import numpy as np

from .._system.blas_threads import single_blas_thread
from .._types import FloatArray
from ..errors import ExciteError
from ..trajectory.fourier import FourierSeries
from . import initial_guess, sqp
from .evaluator import Evaluator
from .problem import DesignProblem

Progress = Callable[[str], None]

HALVING_ITERATIONS = (60, 90)
"""Iterations after which the worse half of the starts stops [1].

Earlier the ranking says little about the final one: over 60 starts of two arms their rank
correlation is 0.3 after 40, 0.7 after 60 and 0.8 after 90 iterations.
"""

MAX_GUESSES = 4
"""Initial guesses that one start tries until its search ends with a feasible motion that excites
all base parameters."""

BLIND_ITERATIONS = 20
"""Iterations after which a search is given up that began without exciting all base parameters and
still does not."""

MIN_SPECTRUM_RATIO = 1e-24
"""Ratio of eigenvalues of the information below which a direction is rounding noise [1]."""

MIN_STARTS_FOR_HALVING = 8
"""Number of starts below which all of them run to their end [1]."""


@dataclass(frozen=True)
class Attempt:
    """Result of one start.

    Attributes:
        number: Number of the start.
        motion: Best motion.
        objective: Smooth objective of the motion.
        history: Record of all its iterates.
        state: State of its search.
        stopped: True if it was stopped early, because other starts were better.
        excites_all: True if the motion excites all base parameters.
    """

    number: int
    motion: FourierSeries
    objective: float
    history: sqp.History
    state: sqp.SearchState
    stopped: bool = False
    excites_all: bool = True

    @property
    def feasible(self) -> bool:
        """True if the motion keeps all limits at the samples."""
        return bool(np.isfinite(self.state.best_value))

    @property
    def usable(self) -> bool:
        """True if the motion keeps all limits and excites all base parameters."""
        return self.feasible and self.excites_all

    @property
    def rank(self) -> tuple[bool, float, float, int]:
        """Key that sorts attempts, the best first; infeasible ones last, by their excess."""
        excess = 0.0 if self.feasible else self.state.best_excess
        return not self.usable, excess, self.objective, self.number


def run_starts(
    problem: DesignProblem, numbers: Sequence[int], progress: Progress | None = None
) -> list[Attempt | ExciteError]:
    """Run starts and rank them.

    Args:
        problem: The design problem.
        numbers: Numbers of the starts; each has a random stream of its own.
        progress: Called with a line of text after each start.

    Returns:
        Results, the best first, then the errors of starts without a feasible pose.
    """
    end = problem.options.iterations
    limits = (
        (*(r for r in HALVING_ITERATIONS if r < end), end)
        if len(numbers) >= MIN_STARTS_FOR_HALVING
        else (end,)
    )
    errors: list[ExciteError] = []
    stopped: list[Attempt] = []
    alive: list[int | Attempt] = list(numbers)
    for index, until in enumerate(limits):
        report = (
            None if progress is None else _ProgressReport(progress, len(alive), index, len(limits))
        )
        ended = _run_round(problem, until, alive, report)
        errors += [e for e in ended if isinstance(e, ExciteError)]
        ranked = sorted((a for a in ended if isinstance(a, Attempt)), key=lambda a: a.rank)
        kept = len(ranked) if until == end else -(-len(ranked) // 2)
        stopped += [dataclasses.replace(a, stopped=not a.state.done) for a in ranked[kept:]]
        alive = list(ranked[:kept])
    finished = [a for a in alive if isinstance(a, Attempt)]
    # a start that was stopped may still be better than one that ran to its end
    return [*sorted([*finished, *stopped], key=lambda a: a.rank), *errors]


def _run_round(
    problem: DesignProblem,
    until: int,
    alive: Sequence[int | Attempt],
    report: Callable[[Attempt | ExciteError], None] | None,
) -> list[Attempt | ExciteError]:
    """Run one round of all starts that are still alive.

    Args:
        problem: The design problem.
        until: Iterations that a start may have spent in total after the round.
        alive: Numbers of new starts, or results of the round before.
        report: Called with each result.
    """
    ended: list[Attempt | ExciteError] = []
    for group in _run_groups(problem, until, alive):
        ended += group
        if report is not None:
            for result in group:
                report(result)
    return ended


def _run_groups(
    problem: DesignProblem, until: int, alive: Sequence[int | Attempt]
) -> Iterator[list[Attempt | ExciteError]]:
    """Run groups of starts in parallel, since sending the problem costs a few iterations."""
    if len(alive) == 1:
        yield _run_group(problem, until, alive)
        return
    workers = min(joblib.effective_n_jobs(problem.options.jobs), len(alive))
    size = max(1, len(alive) // (16 * workers))
    tasks = [
        joblib.delayed(_run_group)(problem, until, alive[i : i + size])
        for i in range(0, len(alive), size)
    ]
    with joblib.Parallel(n_jobs=workers) as pool:
        # batches make progress visible with back ends that cannot stream results
        for i in range(0, len(tasks), 4 * workers):
            yield from pool(tasks[i : i + 4 * workers])


@dataclass
class _ProgressReport:
    """Report how many starts of a round have ended, and the best objective.

    Attributes:
        progress: Called with a line of text.
        count: Number of starts in the round.
        index: Index of the round.
        rounds: Number of rounds.
        ended: Number of starts that have ended.
        best: Best objective.
    """

    progress: Progress
    count: int
    index: int
    rounds: int
    ended: int = 0
    best: float = np.inf

    def __call__(self, result: Attempt | ExciteError) -> None:
        """Count one result and report it."""
        self.ended += 1
        if isinstance(result, ExciteError):
            return
        self.best = min(self.best, result.objective)
        prefix = f"round {self.index + 1}/{self.rounds}, " if self.rounds > 1 else ""
        self.progress(
            f"{prefix}start {self.ended}/{self.count}: "
            f"objective {result.objective:.4f}, best {self.best:.4f}"
        )


def _run_group(
    problem: DesignProblem, until: int, starts: Sequence[int | Attempt]
) -> list[Attempt | ExciteError]:
    """Run the round of a few starts in this process."""
    with single_blas_thread():
        evaluator = Evaluator(problem)
        return [
            _begin(evaluator, until, start)
            if isinstance(start, int)
            else _resume(evaluator, until, start)
            for start in starts
        ]


def _begin(evaluator: Evaluator, until: int, number: int) -> Attempt | ExciteError:
    """Run a new start; errors are returned as values, so that they pass between processes.

    A search that ends infeasible, or without exciting all base parameters, is repeated from another
    initial guess.
    """
    problem, best = evaluator.problem, None
    if problem.warm_start is not None and number == 0:
        return optimize_from(evaluator, problem.variables(problem.warm_start), number, until)
    for guess in range(MAX_GUESSES):
        entropy = [problem.options.seed, number, *([guess] if guess else [])]
        rng = np.random.default_rng(entropy)
        try:
            poses = initial_guess.find_static_poses(evaluator, rng)
        except ExciteError as error:
            return error if best is None else best
        pose = poses[rng.integers(min(len(poses), 1 + len(poses) // 4))]
        x = initial_guess.scale_random_motion(evaluator, pose, rng)
        blind = evaluator.spectrum_ratio(x) <= MIN_SPECTRUM_RATIO
        attempt = optimize_from(
            evaluator, x, number, min(BLIND_ITERATIONS, until) if blind else until
        )
        if blind and attempt.usable:
            attempt = _resume(evaluator, until, attempt)
        if best is None or attempt.rank < best.rank:
            best = attempt
        if best.usable or (guess > 0 and len(poses) == 1):  # another guess finds the same pose
            break
    return best  # type: ignore[return-value]


def optimize_from(
    evaluator: Evaluator,
    x: FloatArray,
    number: int,
    until: int | None = None,
    state: sqp.SearchState | None = None,
) -> Attempt:
    """Optimise from given variables.

    Args:
        evaluator: Evaluator of the design problem.
        x: Variables to begin with. Shape (size,).
        number: Number of the start.
        until: Number of iterations; None: to the end.
        state: State to begin with, at `x`; None: that of a new search.
    """
    sharpness = sqp.sharpness_stages(evaluator.problem.options.criterion)
    history = sqp.History()
    history.add(
        evaluator.objective(x, sharpness[-1])[0],
        evaluator.max_constraint_value(x),
        0 if state is None else state.stage,
    )
    state = sqp.initial_state(x) if state is None else state
    return _attempt(evaluator, number, sqp.advance(evaluator, state, history, until), history)


def _resume(evaluator: Evaluator, until: int, before: Attempt) -> Attempt:
    """Continue a start after an earlier round; its history grows."""
    more = until - before.state.iterations
    state = sqp.advance(evaluator, before.state, before.history, more)
    return _attempt(evaluator, before.number, state, before.history)


def _attempt(
    evaluator: Evaluator, number: int, state: sqp.SearchState, history: sqp.History
) -> Attempt:
    """Return the result of a start at the present state of its search."""
    problem = evaluator.problem
    objective = evaluator.objective(
        state.best, sqp.sharpness_stages(problem.options.criterion)[-1]
    )[0]
    return Attempt(
        number,
        problem.fourier(state.best),
        objective,
        history,
        state,
        excites_all=problem.earlier_root is not None
        or evaluator.spectrum_ratio(state.best) > MIN_SPECTRUM_RATIO,
    )
