"""The consistent estimate against a conic solver's, where cvxpy and Clarabel are installed."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from conftest import states

from excite._types import FloatArray
from excite.errors import UnusableInput
from excite.identification import consistency, lmi_check
from excite.identification.consistency import BARRIER_WEIGHTS, Bounds, Prior
from excite.identification.inertia_distance import Distance, pseudo_inertias
from excite.robot import base_parameters, dynamics, inertial_parameters, limits, robot
from excite.robot.inertial_parameters import Parameters

CONVEX_DISTANCES = (Distance.BREGMAN, Distance.PULLBACK, Distance.EUCLIDEAN)
SMALL_BARRIER = (*BARRIER_WEIGHTS, 1e-5, 1e-6)
"""Barrier weights that end so low that the barrier's cost is below the compared tolerance."""


def random_problem(
    name: str, noise: float, seed: int = 0, count: int = 60
) -> tuple[Parameters, FloatArray, FloatArray, FloatArray]:
    """Standard parameters, R B, R θ̂ and ψ₀ of a robot whose parameters are 10 % off nominal."""
    arm = robot.load(name)
    standard = inertial_parameters.standard_parameters(arm, limits.resolve(arm))
    base = base_parameters.find(arm, standard, limits.resolve(arm))
    rng = np.random.default_rng(seed)
    nominal = consistency.consistent_nominal(standard)
    truth = nominal * (1.0 + 0.1 * rng.normal(size=standard.count))
    for kind in ("viscous", "coulomb"):
        truth[standard.block(kind)] = 0.5
    Y = dynamics.regressor(arm, standard, states(arm.n, count, seed))
    torque = Y @ truth + noise * rng.normal(size=Y.shape[:2])
    gamma = (Y @ base.selection).reshape(-1, base.count) / noise
    theta = np.linalg.lstsq(gamma, torque.ravel() / noise, rcond=None)[0]
    root = np.linalg.qr(gamma, mode="r")
    return standard, root @ base.matrix, root @ theta, nominal


def prior_of(
    standard: Parameters, nominal: FloatArray, distance: Distance, weight: float = 1.0
) -> Prior:
    return Prior(
        nominal,
        distance,
        weight,
        0.1 * np.ones(standard.count - 10 * standard.bodies),
        np.diag(standard.scale)[10 * standard.bodies :],
    )


@pytest.mark.parametrize("distance", CONVEX_DISTANCES, ids=lambda d: d.value)
@pytest.mark.parametrize("name", ["two_link", "panda"])
def test_both_solvers_find_the_same_estimate(name, distance):
    pytest.importorskip("cvxpy")
    standard, root, target, nominal = random_problem(name, 0.5)
    prior = prior_of(standard, nominal, distance)
    estimate = consistency.maximum_a_posteriori(
        standard, root, target, prior, barrier_weights=SMALL_BARRIER
    )
    check = lmi_check.check_estimate(standard, root, target, prior, estimate)
    assert check.agrees and abs(check.gap) < 1e-4
    assert check.objective <= check.checked_objective + 1e-6 * abs(check.checked_objective)


@pytest.mark.parametrize("distance", CONVEX_DISTANCES, ids=lambda d: d.value)
@pytest.mark.parametrize("name", ["two_link", "panda"])
def test_both_solvers_agree_where_bounds_are_active(name, distance):
    pytest.importorskip("cvxpy")
    standard, root, target, nominal = random_problem(name, 0.5, seed=3)
    prior = prior_of(standard, nominal, distance)
    unbounded = consistency.maximum_a_posteriori(
        standard, root, target, prior, barrier_weights=SMALL_BARRIER
    )
    place = 10 * standard.bodies - 10
    mass, first_moment = float(unbounded.psi[place]), unbounded.psi[place + 1 : place + 4]
    box = np.stack([first_moment / mass + 0.01, first_moment / mass + 0.05])
    link = standard.links[-1]
    bounds = Bounds(mass={link: (1.05 * mass, 2.0 * mass)}, centre={link: box})
    estimate = consistency.maximum_a_posteriori(
        standard, root, target, prior, bounds, barrier_weights=SMALL_BARRIER
    )
    check = lmi_check.check_estimate(standard, root, target, prior, estimate, bounds)
    assert check.agrees and abs(check.gap) < 1e-4
    unbounded_objective = consistency.map_objective(standard, root, target, prior, unbounded.psi)
    assert check.objective > unbounded_objective + 1e-3
    assert check.psi[place] >= 1.05 * mass * (1 - 1e-6)


def test_the_solvers_agree_to_within_the_cost_of_the_barrier():
    pytest.importorskip("cvxpy")
    standard, root, target, nominal = random_problem("panda", 0.5)
    prior = prior_of(standard, nominal, Distance.BREGMAN)
    estimate = consistency.maximum_a_posteriori(standard, root, target, prior)
    assert lmi_check.check_estimate(standard, root, target, prior, estimate).agrees


def test_the_solvers_agree_on_a_body_at_the_boundary_of_consistency():
    pytest.importorskip("cvxpy")
    standard, root, target, nominal = random_problem("two_link", 5.0, seed=1, count=8)
    prior = prior_of(standard, nominal, Distance.EUCLIDEAN, 1e-6)
    estimate = consistency.maximum_a_posteriori(
        standard, root, target, prior, barrier_weights=SMALL_BARRIER
    )
    check = lmi_check.check_estimate(standard, root, target, prior, estimate)
    assert check.agrees and abs(check.gap) < 1e-4
    bodies = check.psi[: 10 * standard.bodies].reshape(-1, 10)
    values = np.linalg.eigvalsh(pseudo_inertias(bodies))
    assert values.min() < 1e-6 * values.max()


def test_without_the_solver_the_error_states_the_install_command(monkeypatch):
    standard, root, target, nominal = random_problem("two_link", 0.5)
    prior = prior_of(standard, nominal, Distance.PULLBACK)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UnusableInput, match=r"pip install 'excite\[lmi\]'"):
        lmi_check.solve_lmi(standard, root, target, prior)


def test_the_riemannian_distance_is_refused():
    standard, root, target, nominal = random_problem("two_link", 0.5)
    with pytest.raises(UnusableInput, match="not convex"):
        lmi_check.solve_lmi(
            standard, root, target, prior_of(standard, nominal, Distance.RIEMANNIAN)
        )


def test_contradictory_bounds_are_refused():
    pytest.importorskip("cvxpy")
    standard, root, target, nominal = random_problem("two_link", 0.5)
    prior = prior_of(standard, nominal, Distance.PULLBACK)
    bounds = Bounds(mass={standard.links[0]: (2.0, 1.0)})
    with pytest.raises(UnusableInput, match="widen"):
        lmi_check.solve_lmi(standard, root, target, prior, bounds)
