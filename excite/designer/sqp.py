"""Sequential quadratic programming on a design problem, with a trust region; CasADi's DAQP solves the subproblems.

A few dozen variables and thousands of rows, nearly all of them far from their limits: rows enter a subproblem only
where they come close, and every feasible iterate is kept, so that stopping early still gives a motion.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field

import numpy as np

from . import qp_subproblem
from .criteria import Criterion
from .evaluator import ConstraintRows, Evaluator
from .problem import LIMIT_RESERVE

Array = np.ndarray
MAX_FEASIBLE_ROW_VALUE = 1.0 + 0.5 * LIMIT_RESERVE
WORKING_SET_BAND = 0.25
"""Rows within this share of their limit enter the first subproblem; others when a step would break them."""


@dataclass
class History:
    """The optimisation's own record: per iterate the time [s], smooth objective, worst row value and stage."""

    began: float = field(default_factory=time.perf_counter)
    time: list[float] = field(default_factory=list)
    objective: list[float] = field(default_factory=list)
    worst: list[float] = field(default_factory=list)
    stage: list[int] = field(default_factory=list)

    def add(self, objective: float, worst: float, stage: int) -> None:
        """Note one iterate, now."""
        self.time.append(time.perf_counter() - self.began)
        self.objective.append(objective)
        self.worst.append(worst)
        self.stage.append(stage)


@dataclass(frozen=True)
class Tolerances:
    """gain: stop when ten iterations improve the objective (a logarithm) by less; None: as the criterion needs.

    radius: stop below this step.
    """

    gain: float | None = None
    radius: float = 1e-6
    first_radius: float = 0.2


@dataclass(frozen=True)
class SearchState:
    """Where a search stands: it can be put aside and resumed, in another process too, without a change in its result.

    x: the iterate; best: the best feasible one at this stage, of objective best_value (x and ∞ where there is none).
    B: approximate Hessian of the Lagrangian, None for the identity, to be scaled. trail: merit after each iteration.
    """

    x: Array
    best: Array
    best_value: float = np.inf
    stage: int = 0
    B: Array | None = None
    radius: float | None = None
    penalty: float = 1.0
    trail: tuple[float, ...] = ()
    iterations: int = 0
    done: bool = False


def sharpness_stages(criterion: Criterion) -> tuple[float, ...]:
    """Sharpness of the smooth criterion, rising: A and D are exact at once.

    The regressor's condition number has many local optima; starting near D leads to better ones (measured over 24
    starts of two arms: a median 2 % lower in the same time). Geometric E and condition number gain nothing by it.
    """
    if criterion in (Criterion.A, Criterion.D):
        return (1.0,)
    return (0.3, 4.0, 40.0) if criterion is Criterion.COND_REGRESSOR else (4.0, 25.0)


def stopping_gain(criterion: Criterion) -> float:
    """Gain in the last stage over ten iterations below which a search ends; earlier stages end twenty times sooner."""
    return 2e-3 if criterion is Criterion.COND_REGRESSOR else 4e-3


def initial_state(x: Array) -> SearchState:
    """A search that starts at x."""
    return SearchState(x, x)


def advance(
    evaluator: Evaluator,
    state: SearchState,
    history: History,
    iterations: int | None = None,
    tolerances: Tolerances | None = None,
) -> SearchState:
    """Minimise the smooth criterion for some more iterations, or until ten of them gain next to nothing."""
    tolerances = tolerances or Tolerances()
    options = evaluator.problem.options
    sharpnesses = sharpness_stages(options.criterion)
    least = stopping_gain(options.criterion) if tolerances.gain is None else tolerances.gain
    until = (
        options.iterations
        if iterations is None
        else min(state.iterations + iterations, options.iterations)
    )
    while not state.done and state.iterations < until:
        last = state.stage == len(sharpnesses) - 1
        search = _Search(evaluator, state, sharpnesses[state.stage], history, tolerances)
        stalled = search.run(until - state.iterations, least if last else 20.0 * least)
        state = (
            search.state(done=last or search.iterations >= options.iterations)
            if stalled
            else search.state()
        )
        if stalled and not state.done:
            state = SearchState(
                state.best, state.best, stage=state.stage + 1, iterations=state.iterations
            )
    return state if state.iterations < options.iterations else dataclasses.replace(state, done=True)


class _Search:
    """The iteration at one sharpness. B approximates the Lagrangian's Hessian by damped BFGS updates."""

    def __init__(
        self,
        evaluator: Evaluator,
        state: SearchState,
        sharpness: float,
        history: History,
        tolerances: Tolerances,
    ) -> None:
        self.evaluator, self.sharpness, self.stage = evaluator, sharpness, state.stage
        self.history, self.tolerances = history, tolerances
        self.x, self.scaled = state.x, state.B is not None
        self.B = np.eye(len(self.x)) if state.B is None else state.B.copy()
        self.f, self.gradient = evaluator.objective(self.x, sharpness)
        self.excess = max(evaluator.max_constraint_value(self.x) - 1.0, 0.0)
        self.best, self.best_f = state.best, state.best_value
        if 1.0 + self.excess <= MAX_FEASIBLE_ROW_VALUE and self.f < self.best_f:
            self.best, self.best_f = self.x, self.f
        self.radius = tolerances.first_radius if state.radius is None else state.radius
        self.penalty, self.trail, self.iterations = (
            state.penalty,
            list(state.trail),
            state.iterations,
        )
        self._bounds = self._variable_bounds()

    def state(self, done: bool = False) -> SearchState:
        """What `advance` needs to go on."""
        B = self.B if self.scaled else None
        return SearchState(
            self.x,
            self.best,
            self.best_f,
            self.stage,
            B,
            self.radius,
            self.penalty,
            tuple(self.trail),
            self.iterations,
            done,
        )

    def _variable_bounds(self) -> tuple[Array, Array]:
        lower, upper = np.full(len(self.x), -np.inf), np.full(len(self.x), np.inf)
        options = self.evaluator.problem.options
        if options.free_period is not None:
            lower[-1], upper[-1] = (bound / options.period for bound in options.free_period)
        return lower, upper

    def run(self, budget: int, least: float) -> bool:
        """Iterate until ten iterations gain less (True) or the budget is spent (False)."""
        trail = self.trail
        for _ in range(budget):
            self._iterate()
            self.iterations += 1
            self.history.add(self.f, 1.0 + self.excess, self.stage)
            trail.append(min(self.f + self.penalty * self.excess, trail[-1] if trail else np.inf))
            if self.radius < self.tolerances.radius or (
                len(trail) > 10 and trail[-11] - trail[-1] < least
            ):
                return True
        return False

    def _iterate(self) -> None:
        mask = self.evaluator.rows_above(self.x, 1.0 - WORKING_SET_BAND)
        rows, jacobian, values = self._linearise(mask)
        step, multipliers = self._subproblem(jacobian, 1.0 - values)
        for _ in range(3):  # rows that the step would break, though they looked far
            broken = self.evaluator.rows_above(self.x + step, 1.0 + 1e-3) & ~mask
            if not broken.any():
                break
            mask |= broken
            rows, jacobian, values = self._linearise(mask)
            step, multipliers = self._subproblem(jacobian, 1.0 - values)
        self.penalty = max(self.penalty * 0.9, 1.5 * float(multipliers.sum()), 1e-3)
        if self._try(step, rows, jacobian, multipliers):
            return
        # Second-order correction: aim at where the rows really were after the step.
        there = self.evaluator.row_values(self.x + step, rows)
        corrected, multipliers = self._subproblem(jacobian, 1.0 - (there - jacobian @ step) - 1e-9)
        if not self._try(corrected, rows, jacobian, multipliers):
            self.radius = 0.4 * min(self.radius, float(np.abs(step).max()))

    def _linearise(self, mask: Array) -> tuple[ConstraintRows, Array, Array]:
        rows = self.evaluator.rows(mask)
        return (
            rows,
            self.evaluator.row_gradients(self.x, rows),
            self.evaluator.row_values(self.x, rows),
        )

    def _subproblem(self, jacobian: Array, room: Array) -> tuple[Array, Array]:
        """min gᵀd + ½dᵀBd subject to J d ≤ room, |d| ≤ radius. Returns d and the rows' multipliers."""
        lower = np.maximum(-self.radius, self._bounds[0] - self.x)
        upper = np.minimum(self.radius, self._bounds[1] - self.x)
        return qp_subproblem.solve(self.B, self.gradient, jacobian, room, lower, upper)

    def _try(self, step: Array, rows: ConstraintRows, jacobian: Array, multipliers: Array) -> bool:
        """Take the step if the exact penalty function falls as the model says; update radius and B."""
        evaluator, x = self.evaluator, self.x + step
        excess = max(evaluator.max_constraint_value(x) - 1.0, 0.0)
        if excess > 0.1:
            return False
        f, gradient = evaluator.objective(x, self.sharpness)
        predicted = (
            -float(self.gradient @ step + 0.5 * step @ self.B @ step) + self.penalty * self.excess
        )
        actual = self.f - f + self.penalty * (self.excess - excess)
        ratio = actual / predicted if predicted > 0.0 else -1.0
        if not ratio > 1e-3:
            return False
        active = np.flatnonzero(multipliers > 1e-9)
        change = gradient - self.gradient
        if len(active):
            kept = ConstraintRows(
                *(getattr(rows, name)[active] for name in ("kind", "sample", "joint", "sign"))
            )
            change = (
                change
                + (evaluator.row_gradients(x, kept) - jacobian[active]).T @ multipliers[active]
            )
        self._update(step, change)
        length = float(np.abs(step).max())
        if ratio > 0.7 and length > 0.9 * self.radius:
            self.radius = min(2.0 * self.radius, 2.0)
        elif ratio < 0.2:
            self.radius = 0.5 * max(length, 1e-12)
        self.x, self.f, self.gradient, self.excess = x, f, gradient, excess
        if 1.0 + excess <= MAX_FEASIBLE_ROW_VALUE and f < self.best_f:
            self.best, self.best_f = x, f
        return True

    def _update(self, step: Array, change: Array) -> None:
        """Powell's damped BFGS update; the first one sets the scale (the curvature along it, not the largest)."""
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
