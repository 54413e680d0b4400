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
    step, multipliers, violation = qp_subproblem.solve(B, g, J, slack, lower, upper)
    assert violation == 0.0
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
    step, multipliers, _ = qp_subproblem.solve(
        np.eye(2), np.array([-3.0, -1.0]), J, slack, np.full(2, -9.0), np.full(2, 9.0)
    )
    assert step == pytest.approx([slack[0], 1.0])
    assert multipliers == pytest.approx([3.0 - slack[0], 0.0], abs=1e-6)


def test_inconsistent_constraints_are_relaxed_by_a_common_amount():
    J, slack = np.array([[1.0], [-1.0]]), np.array([-0.5, -0.3])
    step, multipliers, violation = qp_subproblem.solve(
        np.eye(1), np.array([1.0]), J, slack, np.full(1, -0.2), np.full(1, 0.2)
    )
    # d ≤ −0.5 + t and d ≥ 0.3 − t: t ≥ 0.4, of which 90 % of the way from 0.5 is asked for
    assert violation == pytest.approx(0.41, abs=1e-5)
    assert step == pytest.approx([-0.11], abs=1e-5)
    assert multipliers.max() < 10.0


def test_constraints_out_of_reach_are_approached_as_far_as_the_bounds_allow():
    J, slack = np.array([[1.0, 0.0]]), np.array([-1.0])
    step, _, violation = qp_subproblem.solve(
        np.eye(2), np.array([1.0, -0.05]), J, slack, np.full(2, -0.1), np.full(2, 0.1)
    )
    assert violation == pytest.approx(0.91, abs=1e-5)
    assert step == pytest.approx([-0.1, 0.05], abs=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_inconsistent_constraints_never_stop_the_solver_for_good(seed):
    B, g, J, slack, lower, upper = program(seed)
    first = qp_subproblem.solve(B, g, J, slack, lower, upper)
    for _ in range(20):
        relaxed = qp_subproblem.solve(
            B, g, np.vstack([J, -J]), np.append(slack, -slack - 1.0), lower, upper
        )
        assert relaxed.violation > 0.0
    again = qp_subproblem.solve(B, g, J, slack, lower, upper)
    assert np.array_equal(first.step, again.step)
