"""Quadratic subproblem of one step, against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize

from excite.designer import qp_subproblem


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
def test_solution_equals_that_of_slsqp(seed):
    B, g, J, slack, lower, upper = program(seed)
    step, multipliers = qp_subproblem.solve(B, g, J, slack, lower, upper)
    reference = scipy.optimize.minimize(
        lambda d: g @ d + 0.5 * d @ B @ d,
        np.zeros(len(g)),
        jac=lambda d: g + B @ d,
        bounds=list(zip(lower, upper, strict=True)),
        constraints={"type": "ineq", "fun": lambda d: slack - J @ d, "jac": lambda d: -J},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-14},
    )
    assert step == pytest.approx(reference.x, abs=1e-5)
    assert (J @ step <= slack + 1e-6).all() and (multipliers >= 0.0).all()
    # stationary except at bounds, and only active constraints have multipliers
    free = (step > lower + 1e-6) & (step < upper - 1e-6)
    assert (g + B @ step + J.T @ multipliers)[free] == pytest.approx(0.0, abs=1e-5)
    assert multipliers * (slack - J @ step) == pytest.approx(0.0, abs=1e-5)


def test_constraints_are_added_when_a_step_violates_them():
    J, slack = np.eye(2), np.array([10.0 * qp_subproblem.WORKING_SET_SLACK, 5.0])
    step, multipliers = qp_subproblem.solve(
        np.eye(2), np.array([-3.0, -1.0]), J, slack, np.full(2, -9.0), np.full(2, 9.0)
    )
    assert step == pytest.approx([slack[0], 1.0])
    assert multipliers == pytest.approx([3.0 - slack[0], 0.0], abs=1e-6)


def test_infeasible_constraints_leave_a_step_within_its_bounds():
    J, slack = np.array([[1.0], [-1.0]]), np.array([-0.5, -0.5])
    step, _ = qp_subproblem.solve(
        np.eye(1), np.array([1.0]), J, slack, np.full(1, -0.1), np.full(1, 0.1)
    )
    assert abs(step[0]) <= 0.1 + 1e-6
