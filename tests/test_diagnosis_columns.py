"""Columns stored by joint are equivalent to dense matrices."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from excite._types import FloatArray
from excite.diagnosis import search
from excite.diagnosis.columns import Columns
from excite.diagnosis.half import Half, whitened
from excite.effects.effect import CandidateModel


def random_columns(
    rng: np.random.Generator, samples: int, n: int, affected: list[tuple[int, ...]]
) -> tuple[Columns, FloatArray]:
    """Return a random column for each tuple of joints that it acts on, by joint and dense.

    Shape (N n, K).
    """
    torque = np.zeros((samples, n, len(affected)))
    for k, joints in enumerate(affected):
        for j in joints:
            torque[:, j, k] = rng.normal(size=samples)
    parts = [Columns.of(torque[:, :, k : k + 1]) for k in range(len(affected))]
    return Columns.none(samples, n).jointly_with(parts), torque.reshape(-1, len(affected))


JOINT_TUPLES = st.lists(
    st.lists(st.integers(0, 2), max_size=3, unique=True).map(tuple), min_size=1, max_size=6
)


@given(JOINT_TUPLES, JOINT_TUPLES)
def test_products_equal_those_of_dense_matrices(
    first: list[tuple[int, ...]], second: list[tuple[int, ...]]
):
    rng = np.random.default_rng(len(first) + 7 * len(second))
    (a, dense), (b, other) = (random_columns(rng, 9, 3, joints) for joints in (first, second))
    x, factor = rng.normal(size=(27, 2)), np.array([1.0, 2.0, -3.0])
    places = rng.permutation(len(first))[: 1 + len(first) // 2]
    np.testing.assert_array_equal(a.full(), dense)
    np.testing.assert_allclose(a.products(b), dense.T @ other, atol=1e-12)
    np.testing.assert_allclose(a.along(x), dense.T @ x, atol=1e-12)
    np.testing.assert_allclose(a.squares(), np.sum(dense**2, axis=0), atol=1e-12)
    np.testing.assert_array_equal(a.picked(places).full(), dense[:, places])
    np.testing.assert_array_equal(a.jointly_with([b]).full(), np.hstack([dense, other]))
    np.testing.assert_array_equal(a.scaled(factor).full(), dense * np.tile(factor, 9)[:, None])


def random_fold(rng: np.random.Generator, samples: int) -> Half:
    """Return a fold of a robot with three joints and prior knowledge of two base parameters."""
    gamma, torque = rng.normal(size=(samples, 3, 2)), rng.normal(size=(samples, 3))
    known = (1e-1 * np.eye(2), np.array([1.0, -1.0]))
    return whitened([gamma], [torque], [np.ones(torque.shape, bool)], np.full(3, 0.5), known)


def test_gram_matrices_equal_least_squares_projections():
    """Candidates act on one joint or on several."""
    rng = np.random.default_rng(0)
    folds = random_fold(rng, 30), random_fold(rng, 40)
    affected = [(0,), (1,), (0, 2), (0, 1, 2)]
    columns = [
        [random_columns(rng, samples, 3, [joints, joints]) for samples in (30, 40)]
        for joints in affected
    ]
    shapes = [CandidateModel("drag", k, lambda t, s: np.zeros(0)) for k in range(len(affected))]
    design = search.design(
        folds,
        shapes,
        lambda shape: (columns[shape.joint_index][0][0], columns[shape.joint_index][1][0]),
    )
    assert len(design.shapes) == len(affected)
    dense = [
        np.hstack([columns[shape.joint_index][k][1] for shape in design.shapes]) for k in (0, 1)
    ]
    for fold, gram, matrix in zip(folds, design.grams, dense, strict=True):
        free = fold.free(matrix)
        np.testing.assert_allclose(gram.matrix, free.T @ free, atol=1e-10)
        np.testing.assert_allclose(gram.score, free.T @ fold.torque, atol=1e-10)
    free = design.both.free(np.concatenate(dense))
    np.testing.assert_allclose(design.whole.matrix, free.T @ free, atol=1e-10)
    np.testing.assert_allclose(design.whole.score, free.T @ design.both.torque, atol=1e-10)
    rows = free[design.both.rows].reshape(70, 3, -1)
    for power, place in zip(design.power, design.places, strict=True):
        np.testing.assert_allclose(
            power,
            np.einsum("tjk,tjl->jkl", rows[:, :, place], rows[:, :, place]) / 70.0,
            atol=1e-12,
        )
