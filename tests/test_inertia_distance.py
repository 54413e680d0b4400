"""Distances of link inertias: derivatives, agreement near the nominal body, invariance."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from conftest import slope

from excite._types import FloatArray
from excite.identification import inertia_distance
from excite.identification.inertia_distance import Distance, NominalFrames
from excite.robot import inertial_parameters


def random_bodies(seed: int, count: int = 3) -> FloatArray:
    """Inertial parameters of clouds of point masses. Shape (count, 10)."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        points = rng.normal(size=(8, 3)) * rng.uniform(0.05, 0.5)
        masses = rng.uniform(0.2, 2.0, 8)
        second, first = (points * masses[:, None]).T @ points, masses @ points
        tensor = np.trace(second) * np.eye(3) - second
        out.append(
            [
                masses.sum(),
                *first,
                tensor[0, 0],
                tensor[0, 1],
                tensor[1, 1],
                tensor[0, 2],
                tensor[1, 2],
                tensor[2, 2],
            ]
        )
    return np.array(out)


@pytest.mark.parametrize("kind", list(Distance))
def test_gradients_of_distances_agree_with_finite_differences(kind):
    frames, phi = NominalFrames(random_bodies(1)), random_bodies(2)
    result = frames.squared_distance(kind, phi)
    for k in range(10):
        step = np.zeros(10)
        step[k] = 1.0
        numeric = slope(lambda h, s=step: frames.squared_distance(kind, phi + h * s).value, 1e-5)
        assert np.allclose(
            result.gradient[:, k], numeric, rtol=1e-5, atol=1e-6 * np.abs(result.gradient).max()
        )


@pytest.mark.parametrize("kind", [Distance.RIEMANNIAN, Distance.BREGMAN, Distance.PULLBACK])
def test_geometric_distances_agree_near_the_nominal_body(kind):
    nominal = random_bodies(3)
    tangent = 1e-4 * np.einsum(
        "bij,bj->bi",
        np.array([inertial_parameters.inverse_root(phi) for phi in nominal]),
        np.ones((3, 10)),
    )
    result = NominalFrames(nominal).squared_distance(kind, nominal + tangent)
    assert np.allclose(result.value, 10 * 1e-8, rtol=1e-2)
    assert np.allclose(
        result.hessian, 2 * inertia_distance.distance_metrics(kind, nominal), rtol=2e-2, atol=1e-2
    )


def test_the_riemannian_distance_is_independent_of_frame_and_units():
    nominal, phi = random_bodies(4), random_bodies(5)
    transform = np.eye(4)
    transform[:3, :3] = pin.exp3(np.array([0.3, -1.0, 0.4])) * 1000.0  # millimetres
    transform[:3, 3] = [200.0, -50.0, 20.0]

    def transformed(bodies: FloatArray) -> FloatArray:
        P = transform @ inertia_distance.pseudo_inertias(bodies) @ transform.T
        second, first = P[:, :3, :3], P[:, :3, 3]
        tensor = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
        order = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
        return np.column_stack([P[:, 3, 3], first, *(tensor[:, i, j] for i, j in order)])

    before, after = (
        [NominalFrames(b).squared_distance(kind, a).value for kind in Distance]
        for a, b in ((phi, nominal), (transformed(phi), transformed(nominal)))
    )
    index = {kind: k for k, kind in enumerate(Distance)}
    riemannian, euclidean = index[Distance.RIEMANNIAN], index[Distance.EUCLIDEAN]
    assert np.allclose(before[riemannian], after[riemannian], rtol=1e-8)
    assert not np.allclose(before[euclidean], after[euclidean], rtol=0.1)
