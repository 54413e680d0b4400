"""Overlap of two motions: gradients and invariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import QUICK, seeds, slope
from hypothesis import given

from excite.designer import motion_overlap, optimize
from excite.designer.evaluator import Evaluator
from excite.designer.motion_overlap import MAX_COMPARED_SAMPLES, StateScaling, penalise_overlap
from excite.robot.limits import resolve
from excite.robot.robot import load
from excite.trajectory.fourier import FourierSeries

SCALING = StateScaling(
    np.array([True, False, True]), np.array([np.pi, 0.4, 1.2]), np.array([2.0, 0.5, 3.0])
)


def motion(rng: np.random.Generator, n: int = 3, harmonics: int = 3) -> FourierSeries:
    size = SCALING.velocity_scale[:n, None] / 2.0
    return FourierSeries(
        size * rng.normal(size=(n, harmonics)),
        size * rng.normal(size=(n, harmonics)),
        0.5 * rng.normal(size=n),
        4.0,
    )


def overlap_of(
    first: FourierSeries, second: FourierSeries, count: int = MAX_COMPARED_SAMPLES
) -> float:
    t = second.grid(count)
    return penalise_overlap(SCALING, first).overlap(second.at(t), second.at(t, 1))[0]


@given(seeds)
def test_overlap_is_a_symmetric_correlation(rng):
    first, second = motion(rng), motion(rng)
    assert overlap_of(first, first) == pytest.approx(1.0, abs=1e-12)
    assert 0.0 <= overlap_of(first, second) <= 1.0
    assert overlap_of(first, second) == pytest.approx(overlap_of(second, first), rel=1e-9)


@given(seeds)
def test_gradients_equal_finite_differences(rng):
    first = penalise_overlap(SCALING, motion(rng))
    for count in (20, 3 * MAX_COMPARED_SAMPLES):  # all samples, and a subset
        q, dq, by_q, by_dq = rng.normal(size=(4, count, 3))
        _, slope_q, slope_dq = first.overlap(q, dq)
        measured = slope(
            lambda h, q=q, dq=dq, v=by_q, w=by_dq: np.array(
                first.overlap(q + h * v, dq + h * w)[0]
            ),
            1e-3,
        )
        assert np.sum(slope_q * by_q) + np.sum(slope_dq * by_dq) == pytest.approx(
            float(measured), rel=1e-6, abs=1e-9
        )


@given(seeds)
def test_overlap_does_not_depend_on_phase_period_and_sampling(rng):
    first, second = motion(rng), motion(rng)
    value = overlap_of(first, second)
    # tolerances: the largest difference of 3,000 random pairs is 0.003 with 60 samples per period
    # and 0.021 with 30
    assert overlap_of(first, second.shifted(1.3)) == pytest.approx(value, abs=5e-3)
    assert overlap_of(first, second, 7 * MAX_COMPARED_SAMPLES) == pytest.approx(value, abs=2e-3)
    zero = np.zeros_like(second.sine)  # the same motion with two periods in one
    twice = [np.stack([zero, c], axis=2).reshape(len(c), -1) for c in (second.sine, second.cosine)]
    assert overlap_of(
        first, FourierSeries(*twice, second.offset, 2.0 * second.period)
    ) == pytest.approx(value, abs=3e-2)


@given(seeds)
def test_overlap_does_not_depend_on_the_direction_of_time(rng):
    first, second = motion(rng), motion(rng)
    backwards = FourierSeries(-second.sine, second.cosine, second.offset, second.period)
    assert np.allclose(backwards.at(np.array([1.0])), second.at(np.array([-1.0])))
    assert overlap_of(first, backwards) == pytest.approx(overlap_of(first, second), abs=1e-9)


def test_full_turn_is_the_same_pose_only_for_revolute_joints():
    first = motion(np.random.default_rng(0))
    turned, displaced = (
        replace(first, offset=first.offset + 2.0 * np.pi * np.eye(3)[j]) for j in (0, 1)
    )
    assert overlap_of(first, turned) == pytest.approx(1.0, abs=1e-9)
    assert overlap_of(first, displaced) < 0.9


def test_overlap_does_not_depend_on_units():
    rng = np.random.default_rng(1)
    first, second = motion(rng), motion(rng)
    unit = np.array([1.0, 1000.0, 1.0])
    other = StateScaling(
        SCALING.is_revolute, SCALING.position_scale * unit, SCALING.velocity_scale * unit
    )
    scaled = [
        FourierSeries(m.sine * unit[:, None], m.cosine * unit[:, None], m.offset * unit, m.period)
        for m in (first, second)
    ]
    assert motion_overlap.compute_overlap(other, *scaled) == pytest.approx(
        motion_overlap.compute_overlap(SCALING, first, second), abs=1e-9
    )


def test_distant_motions_do_not_overlap():
    small = FourierSeries(np.full((3, 1), 0.01), np.zeros((3, 1)), np.zeros(3), 4.0)
    assert overlap_of(small, replace(small, offset=np.array([3.0, 1.0, 3.0]))) < 0.05
    partial = overlap_of(small, replace(small, offset=np.array([3.0, 0.0, 0.0])))
    assert partial == pytest.approx(2 / 3, abs=0.02)  # only one joint of three moves elsewhere


@pytest.mark.parametrize("free", [None, (1.0, 4.0)])
def test_objective_includes_the_penalty_and_its_gradient(free):
    robot = load("two_link")
    limits = resolve(robot)
    options = replace(QUICK, samples=24, free_period=free)
    first = FourierSeries(np.full((2, 3), 0.5), np.full((2, 3), -0.3), np.array([-0.5, 0.2]), 2.0)
    penalty = penalise_overlap(StateScaling.for_robot(robot, limits), first)
    plain, penalised = (
        Evaluator(optimize.set_up(robot, limits, options, overlap_penalty=a).problem)
        for a in (None, penalty)
    )
    rng = np.random.default_rng(0)
    x, d = 0.4 * rng.normal(size=plain.problem.size), rng.normal(size=plain.problem.size)
    if free is not None:
        x[-1] = 1.15
    motion = plain.problem.fourier(x)
    t = motion.grid(24)
    expected = penalty.weight * penalty.overlap(motion.at(t), motion.at(t, 1))[0]
    assert penalised.objective(x, 1.0)[0] == pytest.approx(
        plain.objective(x, 1.0)[0] + expected, rel=1e-9
    )
    gradient = penalised.objective(x, 1.0)[1]
    measured = slope(lambda h: np.array(penalised.objective(x + h * d, 1.0)[0]), 2e-5)
    assert abs(gradient @ d - measured) < 1e-6 * np.linalg.norm(gradient) * np.linalg.norm(d)
