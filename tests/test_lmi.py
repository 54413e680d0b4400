from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from conftest import states

from excite.errors import UnusableInput
from excite.identification import consistency, lmi_check
from excite.identification.consistency import Bounds, Prior
from excite.identification.inertia_distance import Distance, pseudo_inertias
from excite.robot import base_parameters, dynamics, inertial_parameters, limits, robot

CONVEX = (Distance.BREGMAN, Distance.PULLBACK, Distance.EUCLIDEAN)


@pytest.fixture(autouse=True)
def fine(monkeypatch):
    """The barrier's cost below what is compared."""
    monkeypatch.setattr(consistency, "WEIGHTS", (*consistency.BARRIER_WEIGHTS, 1e-5, 1e-6))


def problem(name: str, noise: float, seed: int = 0, count: int = 60):
    """Rows of equations of a robot whose parameters are 10 % off, and of its base parameters the triangle."""
    arm = robot.load(name)
    own = inertial_parameters.standard(arm, limits.resolve(arm))
    basis = base_parameters.find(arm, own, limits.resolve(arm))
    rng = np.random.default_rng(seed)
    nominal = consistency.consistent_nominal(own)
    truth = nominal * (1.0 + 0.1 * rng.normal(size=own.count))
    for kind in ("viscous", "coulomb"):
        truth[own.block(kind)] = 0.5
    Y = dynamics.regressor(arm, own, states(arm.n, count, seed))
    torque = Y @ truth + noise * rng.normal(size=Y.shape[:2])
    gamma = (Y @ basis.selection).reshape(-1, basis.count) / noise
    theta = np.linalg.lstsq(gamma, torque.ravel() / noise, rcond=None)[0]
    root = np.linalg.qr(gamma, mode="r") @ basis.matrix
    return own, root, np.linalg.qr(gamma, mode="r") @ theta, nominal


def prior(own, nominal, distance, weight=1.0):
    return Prior(
        nominal,
        distance,
        weight,
        0.1 * np.ones(own.count - 10 * own.bodies),
        np.diag(own.scale)[10 * own.bodies :],
    )


@pytest.mark.parametrize("distance", CONVEX, ids=lambda d: d.value)
@pytest.mark.parametrize("name", ["two_link", "panda"])
def test_both_solvers_find_the_same_estimate(name, distance):
    pytest.importorskip("cvxpy")
    own, root, target, nominal = problem(name, 0.5)
    wanted = prior(own, nominal, distance)
    found = consistency.maximum_a_posteriori(own, root, target, wanted)
    check = lmi_check.check_estimate(own, root, target, wanted, found)
    assert (
        check.agrees
        and abs(check.gap) < 1e-4
        and check.objective <= check.own + 1e-6 * abs(check.own)
    )


@pytest.mark.parametrize("distance", CONVEX, ids=lambda d: d.value)
@pytest.mark.parametrize("name", ["two_link", "panda"])
def test_also_where_bounds_bind(name, distance):
    pytest.importorskip("cvxpy")
    own, root, target, nominal = problem(name, 0.5, seed=3)
    wanted = prior(own, nominal, distance)
    free = consistency.maximum_a_posteriori(own, root, target, wanted)
    link, mass, centre = (
        own.links[-1],
        float(free.psi[10 * own.bodies - 10]),
        free.psi[10 * own.bodies - 9 : 10 * own.bodies - 6],
    )
    box = np.stack([centre / mass + 0.01, centre / mass + 0.05])
    bounds = Bounds(mass={link: (1.05 * mass, 2.0 * mass)}, centre={link: box})
    found = consistency.maximum_a_posteriori(own, root, target, wanted, bounds)
    check = lmi_check.check_estimate(own, root, target, wanted, found, bounds)
    assert check.agrees and abs(check.gap) < 1e-4
    assert check.objective > consistency.map_objective(own, root, target, wanted, free.psi) + 1e-3
    assert check.psi[10 * own.bodies - 10] >= 1.05 * mass * (1 - 1e-6)


def test_the_barrier_costs_no_more_than_it_may(monkeypatch):
    pytest.importorskip("cvxpy")
    monkeypatch.setattr(consistency, "WEIGHTS", consistency.BARRIER_WEIGHTS[:-2])
    own, root, target, nominal = problem("panda", 0.5)
    wanted = prior(own, nominal, Distance.BREGMAN)
    assert lmi_check.check_estimate(
        own, root, target, wanted, consistency.maximum_a_posteriori(own, root, target, wanted)
    ).agrees


def test_a_body_on_the_edge_of_what_bodies_are():
    pytest.importorskip("cvxpy")
    own, root, target, nominal = problem("two_link", 5.0, seed=1, count=8)
    wanted = prior(own, nominal, Distance.EUCLIDEAN, 1e-6)
    found = consistency.maximum_a_posteriori(own, root, target, wanted)
    check = lmi_check.check_estimate(own, root, target, wanted, found)
    assert check.agrees and abs(check.gap) < 1e-4
    values = np.linalg.eigvalsh(pseudo_inertias(check.psi[: 10 * own.bodies].reshape(-1, 10)))
    assert values.min() < 1e-6 * values.max()


def test_one_line_says_what_to_install(monkeypatch):
    own, root, target, nominal = problem("two_link", 0.5)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UnusableInput, match=r"pip install 'excite\[lmi\]'"):
        lmi_check.solve_lmi(own, root, target, prior(own, nominal, Distance.PULLBACK))


def test_no_inequalities_for_the_riemannian_distance():
    own, root, target, nominal = problem("two_link", 0.5)
    with pytest.raises(UnusableInput, match="not convex"):
        lmi_check.solve_lmi(own, root, target, prior(own, nominal, Distance.RIEMANNIAN))


def test_bounds_that_leave_nothing():
    pytest.importorskip("cvxpy")
    own, root, target, nominal = problem("two_link", 0.5)
    with pytest.raises(UnusableInput, match="widen"):
        lmi_check.solve_lmi(
            own,
            root,
            target,
            prior(own, nominal, Distance.PULLBACK),
            Bounds(mass={own.links[0]: (2.0, 1.0)}),
        )
