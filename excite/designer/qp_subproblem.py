"""Quadratic subproblem of one step: min gᵀd + ½dᵀBd subject to J d ≤ slack, lower ≤ d ≤ upper.

DAQP solves it, a dual active-set method (Arnström, Bemporad and Axehill, IEEE TAC 2022). Few
constraints are ever active, so they are added as a step violates them. Constraints that no step
within the bounds can satisfy are relaxed by a common amount, little more than needed.
"""

from __future__ import annotations

from typing import NamedTuple

import daqp
import numpy as np

from .._types import FloatArray

WORKING_SET_SLACK = 0.04
"""Constraints with less slack than this take part from the beginning [1]."""

FEASIBILITY_TOLERANCE = 1e-6
"""Violation of a constraint that a solution may have [1]."""

SOLVER_TOLERANCE = 0.1 * FEASIBILITY_TOLERANCE
"""Violation of a constraint that DAQP may leave [1]: less than is tolerated, so that the outer loop
never adds a constraint that DAQP regards as satisfied."""

MAX_SOLVER_ITERATIONS = 5000
"""Changes of the active set in one call of DAQP; 566 subproblems of four robots took 142 at most.
A number of iterations, not a time, so that a search is reproducible."""

OPTIMAL_FLAG = 1
"""Exit flag of DAQP for an optimal solution."""

RELAXATION_CURVATURE = 1e-6
"""Curvature of the linear program that finds the least relaxation, relative to its slope, as DAQP
solves strictly convex programs only [1]."""


RELAXATION_SHARE = 0.1
"""Share of the possible decrease of the violation that is not asked for [1]: the least relaxation
would leave a single point, with multipliers beyond all bounds."""


class SubproblemSolution(NamedTuple):
    """Solution of one subproblem.

    Attributes:
        step: Step d. Shape (n,).
        multipliers: Multipliers of the constraints, not negative. Shape (m,).
        violation: Amount by which the constraints had to be relaxed, 0 where they are consistent.
    """

    step: FloatArray
    multipliers: FloatArray
    violation: float


def solve(
    B: FloatArray,
    g: FloatArray,
    J: FloatArray,
    slack: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> SubproblemSolution:
    """Solve one subproblem.

    Args:
        B: Approximate Hessian of the Lagrangian, positive definite. Shape (n, n).
        g: Gradient of the objective. Shape (n,).
        J: Jacobian of the constraints. Shape (m, n).
        slack: Slack of the constraints, negative where they are violated. Shape (m,).
        lower: Lower bounds of the step, at most 0. Shape (n,).
        upper: Upper bounds of the step, at least 0. Shape (n,).

    Returns:
        The step, its multipliers and the relaxation of inconsistent constraints.
    """
    working = slack < WORKING_SET_SLACK
    violation = 0.0
    while True:
        solution = _solve(B, g, J[working], slack[working] + violation, lower, upper)
        if solution is None and violation == 0.0:
            violation = _relaxation(J, slack, lower, upper)
            continue
        if solution is None:  # numerical failure; the caller shrinks the trust region
            return SubproblemSolution(np.zeros_like(g), np.zeros(len(slack)), violation)
        step, working_multipliers = solution
        violated = (J @ step > slack + violation + FEASIBILITY_TOLERANCE) & ~working
        if not violated.any():
            multipliers = np.zeros(len(slack))
            multipliers[working] = working_multipliers
            return SubproblemSolution(step, multipliers, violation)
        working |= violated


def _solve(
    H: FloatArray,
    f: FloatArray,
    A: FloatArray,
    bound: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> tuple[FloatArray, FloatArray] | None:
    """Minimise fᵀx + ½xᵀHx subject to A x ≤ bound, lower ≤ x ≤ upper.

    Returns:
        The solution and the multipliers of A x ≤ bound; None where DAQP finds none.
    """
    solution, _, flag, info = daqp.solve(
        np.ascontiguousarray(H),
        np.ascontiguousarray(f),
        np.ascontiguousarray(A),
        np.concatenate([upper, bound]),
        np.concatenate([lower, np.full(len(bound), -np.inf)]),
        primal_tol=SOLVER_TOLERANCE,
        iter_limit=MAX_SOLVER_ITERATIONS,
    )
    if flag != OPTIMAL_FLAG or not np.isfinite(solution).all():
        return None
    return np.clip(solution, lower, upper), np.maximum(info["lam"][len(f) :], 0.0)


def _relaxation(J: FloatArray, slack: FloatArray, lower: FloatArray, upper: FloatArray) -> float:
    """Return t ≥ 0 for which J d ≤ slack + t has solutions within the bounds, nearly the least."""
    size, largest = J.shape[1], max(float(-slack.min(initial=0.0)), 0.0)
    scale = max(largest, FEASIBILITY_TOLERANCE)
    solution = _solve(
        RELAXATION_CURVATURE * np.diag(np.append(np.ones(size), 1.0 / scale)),
        np.append(np.zeros(size), 1.0),
        np.column_stack([J, -np.ones(len(J))]),
        slack,
        np.append(lower, 0.0),
        np.append(upper, largest + scale),
    )
    least = largest if solution is None else min(max(float(solution[0][-1]), 0.0), largest)
    return least + RELAXATION_SHARE * (largest - least) + FEASIBILITY_TOLERANCE
