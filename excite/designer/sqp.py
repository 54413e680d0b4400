"""Sequential quadratic programming with a trust region.

A problem has dozens of variables and thousands of constraints, nearly all of them inactive:
constraints enter a subproblem only near their limits. Every feasible iterate is kept, so that a
search that is stopped early still gives a motion.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field

import numpy as np

from .._types import BoolArray, FloatArray
from . import qp_subproblem
from .criteria import Criterion
from .evaluator import ConstrainedObjective, ConstraintRows
from .problem import LIMIT_RESERVE
from .qp_subproblem import SubproblemSolution

MAX_FEASIBLE_ROW_VALUE = 1.0 + 0.5 * LIMIT_RESERVE
"""Largest constraint value of an iterate that counts as feasible [1]."""

WORKING_SET_BAND = 0.25
"""Constraints within this share of their limit enter the first subproblem of an iteration [1]."""

MAX_TRIED_EXCESS = 0.1
"""Excess over a limit above which a step is rejected without evaluating the objective, unless it
lowers the excess of the iterate [1]."""

STEERING_SHARE = 0.3
"""Least share of the predicted decrease of the violation by which the merit must decrease [1]; the
penalty is raised until it does (Byrd, Nocedal and Waltz, Optim. Methods Softw. 23, 2008)."""

STEERED_DECREASE = 1e-4
"""Decrease of the excess below which the penalty is not raised for it [1]: a tenth of what counts
as feasible."""

STALL_ITERATIONS = 10
"""Iterations over which the gain is compared with the stopping gain [1]."""

INFEASIBLE_STALL_ITERATIONS = 40
"""The same while the iterate is infeasible [1]."""

MAX_RETURNS = 3
"""Times that a search which stalls at an infeasible iterate returns to its best feasible one."""

RETURN_RADIUS = 0.02
"""Trust-region radius after that, a tenth of the first one, in units of the variables."""

RETURN_PENALTY = 1e3
"""Least penalty after that [1]: infeasible iterates must gain a thousand times their excess."""

EARLY_STAGE_GAIN_FACTOR = 20.0
"""Factor on the stopping gain in all stages but the last one [1]."""

FIRST_RADIUS = 0.2
"""Trust-region radius at the beginning of a stage, in units of the variables."""

LEAST_RADIUS = 1e-6
"""Trust-region radius below which a stage ends, in units of the variables."""


@dataclass
class History:
    """Record of all iterates of a search.

    Attributes:
        time: `time.perf_counter()` at each iterate [s].
        objective: Smooth objective of each iterate.
        worst: Largest constraint value of each iterate.
        stage: Stage of the smoothing of each iterate.
    """

    time: list[float] = field(default_factory=list)
    objective: list[float] = field(default_factory=list)
    worst: list[float] = field(default_factory=list)
    stage: list[int] = field(default_factory=list)

    def add(self, objective: float, worst: float, stage: int) -> None:
        """Record one iterate with the present time."""
        self.time.append(time.perf_counter())
        self.objective.append(objective)
        self.worst.append(worst)
        self.stage.append(stage)


@dataclass(frozen=True)
class SearchState:
    """State of a search; it can be resumed later, in another process, with the same result.

    Attributes:
        x: Iterate. Shape (size,).
        best: Best feasible iterate of this stage; where there is none, the least infeasible one.
        best_value: Objective of `best`, infinite where it is infeasible.
        best_excess: Excess of `best` over its limits, 0 where it is feasible.
        stage: Stage of the smoothing.
        B: Approximate Hessian of the Lagrangian, None for the identity. Shape (size, size).
        radius: Trust-region radius.
        penalty: Weight of the constraint violation in the merit function.
        trail: Least merit after each iteration of this stage, from its first feasible iterate on.
        iterations: Number of iterations so far.
        returns: Times that the search returned to its best feasible iterate.
        done: True if the search has ended.
    """

    x: FloatArray
    best: FloatArray
    best_value: float = np.inf
    best_excess: float = np.inf
    stage: int = 0
    B: FloatArray | None = None
    radius: float | None = None
    penalty: float = 1.0
    trail: tuple[float, ...] = ()
    iterations: int = 0
    returns: int = 0
    done: bool = False


def sharpness_stages(criterion: Criterion) -> tuple[float, ...]:
    """Return the sharpness of the smooth criterion in each stage, not descending.

    A and D are exact. The condition number of the regressor has many local optima; starting near D
    leads to better ones (over 24 starts of two arms a median 2 % lower in the same time). The
    geometric E and condition number do not gain from it. The last stage of E is repeated with a new
    approximate Hessian, since where eigenvalues cross the old one may stop a search too early (one
    of 18 starts of three arms gains 0.09 in the logarithm; converged ones end after 11 iterations).
    """
    if criterion in (Criterion.A, Criterion.D):
        return (1.0,)
    if criterion is Criterion.COND_REGRESSOR:
        return (0.3, 4.0, 40.0)
    return (4.0, 25.0, 25.0) if criterion is Criterion.E else (4.0, 25.0)


def initial_state(x: FloatArray) -> SearchState:
    """Return the state of a search that begins at `x`. Shape of `x`: (size,)."""
    return SearchState(x, x)


def advance(
    evaluator: ConstrainedObjective,
    state: SearchState,
    history: History,
    iterations: int | None = None,
) -> SearchState:
    """Continue a search.

    Args:
        evaluator: ConstrainedObjective of the design problem.
        state: State to continue from.
        history: Record that the iterates are added to.
        iterations: Number of iterations; None: to the end.

    Returns:
        The state after the iterations, or when the objective stalls in the last stage.
    """
    options, min_gain = evaluator.problem.options, evaluator.problem.stopping_gain
    sharpnesses = sharpness_stages(options.criterion)
    until = (
        options.iterations
        if iterations is None
        else min(state.iterations + iterations, options.iterations)
    )
    while not state.done and state.iterations < until:
        last = state.stage == len(sharpnesses) - 1
        search = _Search(evaluator, state, sharpnesses[state.stage], history)
        stalled = search.run(
            until - state.iterations, min_gain if last else EARLY_STAGE_GAIN_FACTOR * min_gain
        )
        if stalled and search.is_stuck_infeasible():
            state = search.state_at_best()
            continue
        state = (
            search.state(done=last or search.iterations >= options.iterations)
            if stalled
            else search.state()
        )
        if stalled and not state.done:
            state = SearchState(
                state.best,
                state.best,
                stage=state.stage + 1,
                iterations=state.iterations,
                returns=state.returns,
            )
    return state if state.iterations < options.iterations else dataclasses.replace(state, done=True)


class _Search:
    """Iterations of one stage; B approximates the Hessian of the Lagrangian (damped BFGS)."""

    def __init__(
        self,
        evaluator: ConstrainedObjective,
        state: SearchState,
        sharpness: float,
        history: History,
    ) -> None:
        self.evaluator, self.sharpness, self.stage = evaluator, sharpness, state.stage
        self.history = history
        self.x, self.scaled = state.x, state.B is not None
        self.B = np.eye(len(self.x)) if state.B is None else state.B.copy()
        self.f, self.gradient = evaluator.objective(self.x, sharpness)
        self.excess = max(evaluator.max_constraint_value(self.x) - 1.0, 0.0)
        self.best, self.best_f = state.best, state.best_value
        self.best_excess = state.best_excess
        self.returns = state.returns
        self._keep_best()
        self.radius = FIRST_RADIUS if state.radius is None else state.radius
        self.penalty, self.trail, self.iterations = (
            state.penalty,
            list(state.trail),
            state.iterations,
        )
        self._bounds = self._variable_bounds()

    def state(self, done: bool = False) -> SearchState:
        """Return the state from which `advance` can continue."""
        B = self.B if self.scaled else None
        return SearchState(
            self.x,
            self.best,
            self.best_f,
            self.best_excess,
            self.stage,
            B,
            self.radius,
            self.penalty,
            tuple(self.trail),
            self.iterations,
            self.returns,
            done,
        )

    def is_stuck_infeasible(self) -> bool:
        """Return whether the search should return to its best feasible iterate."""
        feasible = 1.0 + self.excess <= MAX_FEASIBLE_ROW_VALUE
        return not feasible and np.isfinite(self.best_f) and self.returns < MAX_RETURNS

    def state_at_best(self) -> SearchState:
        """Return the state that continues at the best feasible iterate, with shorter steps."""
        return SearchState(
            self.best,
            self.best,
            self.best_f,
            self.best_excess,
            self.stage,
            radius=RETURN_RADIUS,
            penalty=max(self.penalty, RETURN_PENALTY),
            iterations=self.iterations,
            returns=self.returns + 1,
        )

    def _keep_best(self) -> None:
        """Keep the iterate if it is the best feasible one, or the least infeasible one so far."""
        if 1.0 + self.excess <= MAX_FEASIBLE_ROW_VALUE:
            if self.f < self.best_f:
                self.best, self.best_f, self.best_excess = self.x, self.f, 0.0
        elif self.excess < self.best_excess:
            self.best, self.best_excess = self.x, self.excess

    def _variable_bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper bounds of the variables; only a free period has any."""
        lower, upper = np.full(len(self.x), -np.inf), np.full(len(self.x), np.inf)
        options = self.evaluator.problem.options
        if options.free_period is not None:
            lower[-1], upper[-1] = (bound / options.period for bound in options.free_period)
        return lower, upper

    def run(self, budget: int, min_gain: float) -> bool:
        """Iterate until the objective stalls (True) or the budget is spent (False).

        Args:
            budget: Number of iterations.
            min_gain: Decrease of the merit over ten iterations below which it stalls.
        """
        trail = self.trail
        for _ in range(budget):
            self._iterate()
            self.iterations += 1
            self.history.add(self.f, 1.0 + self.excess, self.stage)
            if np.isfinite(self.best_f):
                merit = self.f + self.penalty * self.excess
                trail.append(min(merit, trail[-1] if trail else np.inf))
            if self.radius < LEAST_RADIUS or self._is_stalled(min_gain):
                return True
        return False

    def _is_stalled(self, min_gain: float) -> bool:
        """Return whether the merit has not decreased for a number of iterations.

        The merit of an infeasible iterate depends on the penalty, which changes; it counts after
        more iterations only.
        """
        feasible = 1.0 + self.excess <= MAX_FEASIBLE_ROW_VALUE
        count = STALL_ITERATIONS if feasible else INFEASIBLE_STALL_ITERATIONS
        trail = self.trail
        return len(trail) > count and trail[-1 - count] - trail[-1] < min_gain

    def _iterate(self) -> None:
        """Take one step, or shrink the trust region."""
        mask = self.evaluator.rows_above(self.x, 1.0 - WORKING_SET_BAND)
        rows, jacobian, values = self._linearise(mask)
        solution = self._subproblem(jacobian, 1.0 - values)
        for _ in range(3):  # add constraints that the step would violate
            violated = self.evaluator.rows_above(self.x + solution.step, 1.0 + 1e-3) & ~mask
            if not violated.any():
                break
            mask |= violated
            rows, jacobian, values = self._linearise(mask)
            solution = self._subproblem(jacobian, 1.0 - values)
        self._update_penalty(solution)
        if self._try(solution, rows, jacobian):
            return
        # second-order correction: the constraints as they are after the step
        step = solution.step
        values_after = self.evaluator.row_values(self.x + step, rows)
        corrected = self._subproblem(jacobian, 1.0 - (values_after - jacobian @ step) - 1e-9)
        if not self._try(corrected, rows, jacobian):
            self.radius = 0.4 * min(self.radius, float(np.abs(step).max()))

    def _model_change(self, step: FloatArray) -> float:
        """Return the change of the objective that its quadratic model predicts for a step."""
        return float(self.gradient @ step + 0.5 * step @ self.B @ step)

    def _violation_decrease(self, solution: SubproblemSolution) -> float:
        """Return the decrease of the excess that the linearised constraints predict."""
        return max(self.excess - solution.violation, 0.0)

    def _update_penalty(self, solution: SubproblemSolution) -> None:
        """Let the penalty exceed the multipliers, and outweigh an increase of the objective."""
        self.penalty = max(self.penalty * 0.9, 1.5 * float(solution.multipliers.sum()), 1e-3)
        decrease, change = self._violation_decrease(solution), self._model_change(solution.step)
        if decrease > STEERED_DECREASE and change > 0.0:
            self.penalty = max(self.penalty, change / ((1.0 - STEERING_SHARE) * decrease))

    def _linearise(self, mask: BoolArray) -> tuple[ConstraintRows, FloatArray, FloatArray]:
        """Return the constraints that a mask selects, their Jacobian and their values."""
        rows = self.evaluator.rows(self.x, mask)
        return (
            rows,
            self.evaluator.row_gradients(self.x, rows),
            self.evaluator.row_values(self.x, rows),
        )

    def _subproblem(self, jacobian: FloatArray, slack: FloatArray) -> SubproblemSolution:
        """Minimise gᵀd + ½dᵀBd subject to J d ≤ slack, |d| ≤ radius."""
        lower = np.maximum(-self.radius, self._bounds[0] - self.x)
        upper = np.minimum(self.radius, self._bounds[1] - self.x)
        return qp_subproblem.solve(self.B, self.gradient, jacobian, slack, lower, upper)

    def _try(
        self, solution: SubproblemSolution, rows: ConstraintRows, jacobian: FloatArray
    ) -> bool:
        """Take a step if the merit decreases as predicted; update the trust region and B."""
        step, multipliers = solution.step, solution.multipliers
        evaluator, x = self.evaluator, self.x + step
        excess = max(evaluator.max_constraint_value(x) - 1.0, 0.0)
        if excess > max(MAX_TRIED_EXCESS, self.excess):
            return False
        f, gradient = evaluator.objective(x, self.sharpness)
        predicted = self.penalty * self._violation_decrease(solution) - self._model_change(step)
        actual = self.f - f + self.penalty * (self.excess - excess)
        ratio = actual / predicted if predicted > 0.0 else -1.0
        if not ratio > 1e-3:
            return False
        active = np.flatnonzero(multipliers > 1e-9)
        change = gradient - self.gradient
        if len(active):
            later = evaluator.row_gradients(x, rows.subset(active))
            change = change + (later - jacobian[active]).T @ multipliers[active]
        self._update(step, change)
        length = float(np.abs(step).max())
        if ratio > 0.7 and length > 0.9 * self.radius:
            self.radius = min(2.0 * self.radius, 2.0)
        elif ratio < 0.2:
            self.radius = 0.5 * max(length, 1e-12)
        self.x, self.f, self.gradient, self.excess = x, f, gradient, excess
        self._keep_best()
        return True

    def _update(self, step: FloatArray, change: FloatArray) -> None:
        """Update B by Powell's damped BFGS; the first update sets its scale from the curvature."""
        curvature = float(step @ change)
        if not self.scaled:
            if curvature > 0.0:
                self.B *= curvature / float(step @ step)
            self.scaled = True
        Bs = self.B @ step
        sBs = float(step @ Bs)
        if sBs <= 1e-16:
            return
        if curvature < 0.2 * sBs:
            share = 0.8 * sBs / (sBs - curvature)
            change = share * change + (1.0 - share) * Bs
            curvature = float(step @ change)
        self.B += np.outer(change, change) / curvature - np.outer(Bs, Bs) / sBs
