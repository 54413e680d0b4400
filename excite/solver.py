"""Sequential quadratic programming on a design problem, with a trust region; CasADi's DAQP solves the subproblems.

A few dozen variables and thousands of rows, nearly all of them far from their limits: rows enter a subproblem only
where they come close, and every feasible iterate is kept, so that stopping early still gives a motion.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from . import subproblem
from .criteria import Criterion
from .evaluate import Evaluator, Rows
from .problem import RESERVE

Array = np.ndarray
FEASIBLE = 1.0 + 0.5 * RESERVE
NEAR = 0.25
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
    """gain: stop when ten iterations improve the objective (a logarithm) by less. radius: stop below this step."""

    gain: float = 4e-3
    radius: float = 1e-6
    first_radius: float = 0.2


def stages(criterion: Criterion) -> tuple[float, ...]:
    """Sharpness of the smooth criterion, rising: A and D are exact at once."""
    return (1.0,) if criterion in (Criterion.A, Criterion.D) else (4.0, 25.0)


def solve(evaluator: Evaluator, x: Array, history: History, tolerances: Tolerances | None = None) -> Array:
    """Minimise the smooth criterion from x; returns the best feasible variables met, or x where none were."""
    budget = evaluator.problem.options.iterations
    tolerances = tolerances or Tolerances()
    sharpnesses = stages(evaluator.problem.options.criterion)
    for stage, sharpness in enumerate(sharpnesses):
        search = _Search(evaluator, x, sharpness, stage, history, tolerances)
        last = stage == len(sharpnesses) - 1
        x, used = search.run(budget, tolerances.gain if last else 20.0 * tolerances.gain)
        budget -= used
    return x


class _Search:
    """One run at one sharpness. B approximates the Lagrangian's Hessian by damped BFGS updates."""

    def __init__(self, evaluator: Evaluator, x: Array, sharpness: float, stage: int, history: History, tolerances: Tolerances) -> None:
        self.evaluator, self.sharpness, self.stage = evaluator, sharpness, stage
        self.history, self.tolerances = history, tolerances
        self.x, self.B = x, np.eye(len(x))
        self.f, self.gradient = evaluator.objective(x, sharpness)
        self.excess = max(evaluator.worst(x) - 1.0, 0.0)
        self.best, self.best_f = x, self.f if 1.0 + self.excess <= FEASIBLE else np.inf
        self.radius, self.penalty = tolerances.first_radius, 1.0
        self.scaled = False
        self._bounds = self._variable_bounds()

    def _variable_bounds(self) -> tuple[Array, Array]:
        lower, upper = np.full(len(self.x), -np.inf), np.full(len(self.x), np.inf)
        options = self.evaluator.problem.options
        if options.free_period is not None:
            lower[-1], upper[-1] = (bound / options.period for bound in options.free_period)
        return lower, upper

    def run(self, budget: int, gain: float) -> tuple[Array, int]:
        """Iterate until ten iterations gain less; returns the best feasible variables and the iterations used."""
        trail: list[float] = []
        for iteration in range(budget):
            self._iterate()
            self.history.add(self.f, 1.0 + self.excess, self.stage)
            trail.append(min(self.f + self.penalty * self.excess, trail[-1] if trail else np.inf))
            stalled = len(trail) > 10 and trail[-11] - trail[-1] < gain
            if self.radius < self.tolerances.radius or stalled:
                return self.best, iteration + 1
        return self.best, budget

    def _iterate(self) -> None:
        mask = self.evaluator.select(self.x, 1.0 - NEAR)
        rows, jacobian, values = self._linearise(mask)
        step, multipliers = self._subproblem(jacobian, 1.0 - values)
        for _ in range(3):  # rows that the step would break, though they looked far
            broken = self.evaluator.select(self.x + step, 1.0 + 1e-3) & ~mask
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

    def _linearise(self, mask: Array) -> tuple[Rows, Array, Array]:
        rows = self.evaluator.rows(mask)
        return rows, self.evaluator.row_gradients(self.x, rows), self.evaluator.row_values(self.x, rows)

    def _subproblem(self, jacobian: Array, room: Array) -> tuple[Array, Array]:
        """min gᵀd + ½dᵀBd subject to J d ≤ room, |d| ≤ radius. Returns d and the rows' multipliers."""
        lower = np.maximum(-self.radius, self._bounds[0] - self.x)
        upper = np.minimum(self.radius, self._bounds[1] - self.x)
        return subproblem.solve(self.B, self.gradient, jacobian, room, lower, upper)

    def _try(self, step: Array, rows: Rows, jacobian: Array, multipliers: Array) -> bool:
        """Take the step if the exact penalty function falls as the model says; update radius and B."""
        evaluator, x = self.evaluator, self.x + step
        excess = max(evaluator.worst(x) - 1.0, 0.0)
        if excess > 0.1:
            return False
        f, gradient = evaluator.objective(x, self.sharpness)
        predicted = -float(self.gradient @ step + 0.5 * step @ self.B @ step) + self.penalty * self.excess
        actual = self.f - f + self.penalty * (self.excess - excess)
        ratio = actual / predicted if predicted > 0.0 else -1.0
        if not ratio > 1e-3:
            return False
        active = np.flatnonzero(multipliers > 1e-9)
        change = gradient - self.gradient
        if len(active):
            kept = Rows(*(getattr(rows, name)[active] for name in ("kind", "sample", "joint", "sign")))
            change = change + (evaluator.row_gradients(x, kept) - jacobian[active]).T @ multipliers[active]
        self._update(step, change)
        length = float(np.abs(step).max())
        if ratio > 0.7 and length > 0.9 * self.radius:
            self.radius = min(2.0 * self.radius, 2.0)
        elif ratio < 0.2:
            self.radius = 0.5 * max(length, 1e-12)
        self.x, self.f, self.gradient, self.excess = x, f, gradient, excess
        if 1.0 + excess <= FEASIBLE and f < self.best_f:
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
