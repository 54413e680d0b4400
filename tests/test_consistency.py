"""Physically consistent estimates: consistency for any data, optimality, bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import loaded, random_urdf, states
from hypothesis import given, settings
from hypothesis import strategies as st

from excite._types import FloatArray
from excite.errors import UnusableInput
from excite.identification import consistency
from excite.identification.consistency import Bounds, Prior
from excite.identification.inertia_distance import Distance
from excite.robot import base_parameters, dynamics, inertial_parameters, limits, robot
from excite.robot.inertial_parameters import Parameters, of_pseudo_inertia, pseudo_inertia


@pytest.fixture(scope="module")
def standard() -> Parameters:
    machine = robot.load("two_link")
    return inertial_parameters.standard_parameters(machine, limits.resolve(machine))


def prior_of(standard: Parameters, kind: Distance = Distance.BREGMAN) -> Prior:
    edge = 10 * standard.bodies
    return Prior(
        consistency.consistent_nominal(standard),
        kind,
        1.0,
        np.ones(standard.count - edge),
        np.diag(standard.scale)[edge:],
    )


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), kind=st.sampled_from(list(Distance)), size=st.floats(0.1, 100.0))
def test_estimates_are_physically_consistent_for_any_data(seed: int, kind: Distance, size: float):
    rng = np.random.default_rng(seed)
    machine = loaded(random_urdf(rng, 3)) if seed % 2 else robot.load("two_link")
    standard = inertial_parameters.standard_parameters(machine, limits.resolve(machine))
    root = rng.normal(size=(12, standard.count))
    estimate = consistency.maximum_a_posteriori(
        standard, root, size * rng.normal(size=12), prior_of(standard, kind)
    )
    assert consistency.is_consistent(standard, estimate.psi) and estimate.misfit >= 0.0


def sheared(body: FloatArray, transformation: FloatArray) -> FloatArray:
    """Return the inertial parameters of a body whose points are mapped affinely, A P Aᵀ."""
    return of_pseudo_inertia(transformation @ pseudo_inertia(body) @ transformation.T)


def shrunk(body: FloatArray, size: float) -> FloatArray:
    """Return the inertial parameters of a body whose points are nearer to its centre of mass."""
    towards_centre = np.eye(4) * [size, size, size, 1.0]
    towards_centre[:3, 3] = (1.0 - size) * body[1:4] / body[0]
    return sheared(body, towards_centre)


@pytest.mark.parametrize("size", [1.0, 0.1])
@pytest.mark.parametrize("noise", [1e-1, 1e-3, 1e-5])
@pytest.mark.parametrize("seed", range(4))
def test_exact_data_of_a_consistent_robot_are_met_however_wrong_the_nominal_one_is(
    seed, noise, size
):
    """Precise data far from the start must not drive the search to the boundary, and leave it.

    Nominal bodies may be much smaller, so that their parameters differ by many orders.
    """
    machine = robot.load("two_link")
    known = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, known)
    base = base_parameters.find(machine, standard, known)
    rng = np.random.default_rng(seed)
    truth = consistency.consistent_nominal(standard)
    for body in (slice(0, 10), slice(10, 20)):
        shear = 0.5 * (rng.normal(size=(4, 4)) + np.eye(4))
        truth[body] = sheared(truth[body], shear)
    columns = dynamics.regressor(machine, standard, states(machine.n, 200, seed)) @ base.selection
    root = np.linalg.qr(columns.reshape(-1, base.count) / noise, mode="r") @ base.matrix
    prior = replace(prior_of(standard, Distance.PULLBACK), inertial_weight=1e-3)
    for body in (slice(0, 10), slice(10, 20)):
        prior.nominal[body] = shrunk(prior.nominal[body], size)
    estimate = consistency.maximum_a_posteriori(standard, root, root @ truth, prior)
    assert consistency.is_consistent(standard, truth) and estimate.gap < 1e-6
    # no more is lost than what the truth would cost
    cost = consistency.map_objective(standard, root, root @ truth, prior, estimate.psi)
    assert cost < consistency.map_objective(standard, root, root @ truth, prior, truth) + 0.01


@pytest.mark.parametrize("kind", list(Distance))
def test_no_consistent_neighbour_has_a_smaller_objective(standard, kind):
    rng = np.random.default_rng(3)
    root, target = rng.normal(size=(10, standard.count)), rng.normal(size=10)
    prior = prior_of(standard, kind)
    estimate = consistency.maximum_a_posteriori(standard, root, target, prior)

    def objective(psi: np.ndarray) -> float:
        return consistency.map_objective(standard, root, target, prior, psi)

    for _ in range(200):
        neighbour = estimate.psi + 1e-3 * standard.scale @ rng.normal(size=standard.count)
        if consistency.is_consistent(standard, neighbour):
            assert objective(neighbour) >= objective(estimate.psi) - 1e-4


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("step", [1e-2, 1.0, 100.0])
def test_an_estimate_does_not_depend_on_where_the_search_starts(standard, seed, step):
    """Neither on an estimate of similar data, nor on a point outside the consistent set."""
    rng = np.random.default_rng(seed)
    root, target = 10.0 * rng.normal(size=(15, standard.count)), 10.0 * rng.normal(size=15)
    prior = prior_of(standard)
    expected = consistency.maximum_a_posteriori(standard, root, target, prior)
    similar = consistency.maximum_a_posteriori(
        standard, root, target + step * rng.normal(size=15), prior
    )
    outside = similar.psi - step * standard.scale @ rng.uniform(size=standard.count)
    for start in (similar.psi, outside, expected.psi):
        estimate = consistency.maximum_a_posteriori(standard, root, target, prior, start=start)
        cost, least = (
            consistency.map_objective(standard, root, target, prior, psi)
            for psi in (estimate.psi, expected.psi)
        )
        assert abs(cost - least) < 1e-5 and estimate.gap < 1e-6


def test_bounds_of_mass_and_centre_are_respected(standard):
    mass = standard.nominal[0]
    box = np.array([[-0.01, -0.01, -0.01], [0.01, 0.01, 0.01]])
    bounds = Bounds({standard.links[0]: (1.2 * mass, 1.3 * mass)}, {standard.links[1]: box})
    row = np.zeros((1, standard.count))
    row[0, 0] = 1e4
    estimate = consistency.maximum_a_posteriori(
        standard, row, np.array([1e4 * mass]), prior_of(standard), bounds
    )
    assert 1.2 * mass <= estimate.psi[0] < 1.21 * mass
    assert np.all(np.abs(estimate.psi[11:14] / estimate.psi[10]) <= 0.01 + 1e-9)


def test_bounds_of_an_unknown_link_are_refused(standard):
    row = np.zeros((1, standard.count))
    with pytest.raises(UnusableInput, match="no moving link 'nobody'"):
        consistency.maximum_a_posteriori(
            standard, row, np.array([1.0]), prior_of(standard), Bounds({"nobody": (0.0, 1.0)})
        )
