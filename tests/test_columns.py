"""Columns kept joint by joint say what a dense matrix says."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from excite.diagnosis import search
from excite.diagnosis.columns import Columns
from excite.diagnosis.half import Half, whitened
from excite.effects.effect import CandidateModel

Array = np.ndarray


def drawn(
    rng: np.random.Generator, samples: int, joints: int, felt: list[tuple[int, ...]]
) -> tuple[Columns, Array]:
    """A column a tuple of joints that feel it: kept by joint, and dense. Shape (N n, K)."""
    torque = np.zeros((samples, joints, len(felt)))
    for k, own in enumerate(felt):
        for j in own:
            torque[:, j, k] = rng.normal(size=samples)
    parts = [Columns.of(torque[:, :, k : k + 1]) for k in range(len(felt))]
    return Columns.none(samples, joints).jointly_with(parts), torque.reshape(-1, len(felt))


FELT = st.lists(
    st.lists(st.integers(0, 2), max_size=3, unique=True).map(tuple), min_size=1, max_size=6
)


@given(FELT, FELT)
def test_they_multiply_as_dense_ones_do(felt: list[tuple[int, ...]], others: list[tuple[int, ...]]):
    rng = np.random.default_rng(len(felt) + 7 * len(others))
    (a, dense), (b, other) = drawn(rng, 9, 3, felt), drawn(rng, 9, 3, others)
    x, factor = rng.normal(size=(27, 2)), np.array([1.0, 2.0, -3.0])
    places = rng.permutation(len(felt))[: 1 + len(felt) // 2]
    np.testing.assert_array_equal(a.full(), dense)
    np.testing.assert_allclose(a.products(b), dense.T @ other, atol=1e-12)
    np.testing.assert_allclose(a.along(x), dense.T @ x, atol=1e-12)
    np.testing.assert_allclose(a.squares(), np.sum(dense**2, axis=0), atol=1e-12)
    np.testing.assert_array_equal(a.picked(places).full(), dense[:, places])
    np.testing.assert_array_equal(a.jointly_with([b]).full(), np.hstack([dense, other]))
    np.testing.assert_array_equal(a.scaled(factor).full(), dense * np.tile(factor, 9)[:, None])


def halved(rng: np.random.Generator, samples: int) -> Half:
    """Of a robot with three joints, something known of its two base parameters before."""
    gamma, torque = rng.normal(size=(samples, 3, 2)), rng.normal(size=(samples, 3))
    known = (1e-1 * np.eye(2), np.array([1.0, -1.0]))
    return whitened([gamma], [torque], [np.ones(torque.shape, bool)], np.full(3, 0.5), known)


def test_products_are_those_of_columns_less_what_the_base_takes():
    """Gram matrices, scores and the power on each joint, of shapes on one joint and on several,
    against plain least squares."""
    rng = np.random.default_rng(0)
    halves = halved(rng, 30), halved(rng, 40)
    felt = [(0,), (1,), (0, 2), (0, 1, 2)]
    made = [[drawn(rng, samples, 3, [own, own]) for samples in (30, 40)] for own in felt]
    shapes = [CandidateModel("drag", k, lambda t, s: np.zeros(0)) for k in range(len(felt))]
    one = search.design(
        halves, shapes, lambda shape: (made[shape.joint_index][0][0], made[shape.joint_index][1][0])
    )
    assert len(one.shapes) == len(felt)
    dense = [
        np.hstack([made[shape.joint_index][half][1] for shape in one.shapes]) for half in (0, 1)
    ]
    for half, gram, own in zip(halves, one.grams, dense, strict=True):
        free = half.free(own)
        np.testing.assert_allclose(gram.matrix, free.T @ free, atol=1e-10)
        np.testing.assert_allclose(gram.score, free.T @ half.torque, atol=1e-10)
    free = one.both.free(np.concatenate(dense))
    np.testing.assert_allclose(one.whole.matrix, free.T @ free, atol=1e-10)
    np.testing.assert_allclose(one.whole.score, free.T @ one.both.torque, atol=1e-10)
    rows = free[one.both.rows].reshape(70, 3, -1)
    for power, place in zip(one.power, one.places, strict=True):
        np.testing.assert_allclose(
            power,
            np.einsum("tjk,tjl->jkl", rows[:, :, place], rows[:, :, place]) / 70.0,
            atol=1e-12,
        )
