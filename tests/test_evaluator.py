"""Objective and constraints of a design problem against finite differences and Pinocchio."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import loaded, off, random_urdf, slope
from hypothesis import given
from hypothesis import strategies as st

from excite.designer import optimize
from excite.designer.criteria import Criterion
from excite.designer.evaluator import ConstraintRows, Evaluator
from excite.designer.initial_guess import stationary_variables
from excite.designer.options import DesignOptions, WorkspaceBox
from excite.robot import dynamics
from excite.robot.limits import resolve
from excite.robot.robot import load

BOX = WorkspaceBox("tip", (-0.5, -0.1, -0.7), (0.8, 0.1, 0.6))
STEP = 2e-5
"""Step of finite differences, in variables of size 1 [1]; Coulomb friction is wider."""
KINDS = ("position", "velocity", "acceleration", "jerk", "torque", "braking", "box")


@cache
def evaluator(name: str = "two_link", **changes: object) -> Evaluator:
    if name == "mimic":
        robot = loaded(
            random_urdf(
                np.random.default_rng(1),
                4,
                kinds=("revolute", "prismatic"),
                mimics={2: (0, -1.7, 0.3)},
            )
        )
    else:
        robot = load(
            name, joints=("fr3_joint1", "fr3_joint2", "fr3_joint4") if name == "fr3" else None
        )
    options = replace(DesignOptions(period=2.0, harmonics=3, samples=24), **changes)
    return Evaluator(optimize.set_up(robot, resolve(robot), options).problem)


def point(e: Evaluator, seed: int = 0, size: float = 0.4) -> np.ndarray:
    x = size * np.random.default_rng(seed).normal(size=e.problem.size)
    if e.problem.options.free_period is not None:
        x[-1] = 1.15
    return x


def direction(e: Evaluator, seed: int = 1) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=e.problem.size)
    return d / np.linalg.norm(d)


# objective


@pytest.mark.parametrize("free", [None, (1.0, 4.0)])
@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("criterion", list(Criterion))
@pytest.mark.parametrize("name", ["two_link", "mimic"])
def test_objective_gradient_equals_finite_differences(name, criterion, plain, free):
    e = evaluator(name, criterion=criterion, plain=plain, free_period=free)
    x = point(e)
    gradient = e.objective(x, 4.0)[1]
    for seed in (1, 2):
        d = direction(e, seed)
        measured = slope(lambda h, d=d: np.array(e.objective(x + h * d, 4.0)[0]), STEP)
        assert abs(gradient @ d - measured) < 1e-6 * np.linalg.norm(gradient)


def test_objective_gradient_by_the_period_equals_finite_differences():
    e = evaluator(free_period=(1.0, 4.0))
    x, unit = point(e), np.eye(e.problem.size)[-1]
    measured = slope(lambda h: np.array(e.objective(x + h * unit, 4.0)[0]), STEP)
    assert abs(e.objective(x, 4.0)[1][-1] / measured - 1) < 1e-6


def test_objective_gradient_with_earlier_information():
    robot = load("two_link")
    options = DesignOptions(period=2.0, harmonics=3, samples=24)
    root = np.random.default_rng(0).normal(size=(28, 28))
    e = Evaluator(optimize.set_up(robot, resolve(robot), options, 1e3 * root @ root.T).problem)
    x, d = point(e), direction(e)
    measured = slope(lambda h: np.array(e.objective(x + h * d, 4.0)[0]), STEP)
    gradient = e.objective(x, 4.0)[1]
    assert abs(gradient @ d - measured) < 1e-6 * np.linalg.norm(gradient)
    assert e.objective(x, 4.0)[0] < evaluator().objective(x, 4.0)[0]


def test_objective_is_reproducible_at_a_previous_point():
    e = evaluator()
    first, other = point(e, 0), point(e, 1)
    values = [e.objective(x, 4.0)[0] for x in (first, other, first)]
    assert values[0] == values[2] != values[1]


def test_returned_gradient_is_not_overwritten():
    e = evaluator()
    gradient = e.objective(point(e, 0), 4.0)[1]
    kept = gradient.copy()
    e.objective(point(e, 1), 4.0)
    assert np.array_equal(gradient, kept)


# constraints


def rows_of(e: Evaluator, kind: str, x: np.ndarray) -> ConstraintRows:
    """Select all finite constraints of one kind."""
    return e.rows(
        x,
        np.concatenate(
            [(np.isfinite(v) & (k == kind)).ravel() for k, v in e.constraint_values(x).items()]
        ),
    )


@pytest.mark.parametrize("free", [None, (1.0, 4.0)])
@pytest.mark.parametrize("uncertainty", [0.0, 0.1])
@pytest.mark.parametrize("kind", KINDS)
def test_constraint_gradients_equal_finite_differences(kind, uncertainty, free):
    frames = (BOX, WorkspaceBox("link_2", BOX.lower, BOX.upper))
    given_options = {"free_period": free, "uncertainty": uncertainty}
    e = (
        evaluator("fr3", **given_options)
        if kind == "braking"
        else evaluator("two_link", boxes=frames, **given_options)
    )
    x = point(e)
    rows = rows_of(e, kind, x)
    jacobian = e.row_gradients(x, rows)
    for d in (direction(e), np.eye(e.problem.size)[-1]):
        measured = slope(lambda h, d=d: e.row_values(x + h * d, rows), STEP)
        assert np.abs(jacobian @ d - measured).max() < 1e-6 * np.linalg.norm(jacobian, axis=1).max()


@pytest.mark.parametrize("kind", ["torque", "position"])
def test_constraint_gradients_with_mimic_joints(kind):
    e = evaluator("mimic")
    x, d = point(e), direction(e)
    rows = rows_of(e, kind, x)
    measured = slope(lambda h: e.row_values(x + h * d, rows), STEP)
    jacobian = e.row_gradients(x, rows)
    assert np.abs(jacobian @ d - measured).max() < 1e-6 * np.linalg.norm(jacobian, axis=1).max()


def test_constraint_kinds_follow_from_the_limits():
    assert evaluator("fr3").kinds == (
        "position",
        "velocity",
        "acceleration",
        "jerk",
        "torque",
        "braking",
    )


def test_kinematic_constraints_are_quantities_over_limits():
    e = evaluator()
    x, p = point(e), evaluator().problem
    motion, t = p.fourier(x), p.fourier(x).grid(p.options.samples)
    middle, half = p.limits.position.mean(axis=1), 0.5 * np.ptp(p.limits.position, axis=1)
    table = e.constraint_values(x)
    assert np.allclose(table["position"][0], (motion.at(t) - middle) / half)
    for order, kind in enumerate(("velocity", "acceleration", "jerk"), start=1):
        assert np.allclose(
            table[kind], [s * motion.at(t, order) / getattr(p.limits, kind) for s in (1, -1)]
        )


def test_braking_constraints_follow_their_definition():
    e = evaluator("fr3")
    x, limits = point(e), e.problem.limits
    motion = e.problem.fourier(x)
    t = motion.grid(e.problem.options.samples)
    values = e.constraint_values(x)["braking"]
    for j, brake in enumerate(limits.braking):
        q, dq = motion.at(t)[:, j], motion.at(t, 1)[:, j]
        middle, half = np.mean(brake.stop), 0.5 * np.ptp(brake.stop)
        for side, sign in enumerate((1.0, -1.0)):
            overlap = np.maximum(sign * dq + brake.offset, 0.0) ** 2 / brake.rate
            assert np.allclose(values[side, :, j], (overlap + sign * (q - middle)) / half)


def test_box_constraints_are_positions_over_half_widths():
    e = evaluator(boxes=(BOX,))
    x, box = point(e), e.problem.boxes[0]
    q = e.problem.fourier(x).at(e.problem.fourier(x).grid(24))
    reach = dynamics.positions(e.problem.robot, "tip", q)
    assert np.allclose(
        e.constraint_values(x)["box"][0],
        (reach - np.add(box.lower, box.upper) / 2) / (np.subtract(box.upper, box.lower) / 2),
    )


def test_static_constraints_equal_those_of_a_motion_at_rest():
    e = evaluator(boxes=(BOX,))
    pose = np.array([0.4, -0.9])
    static, resting = (
        e.static_constraint_values(np.tile(pose, (24, 1))),
        e.constraint_values(stationary_variables(e.problem, pose)),
    )
    assert all(np.allclose(static[kind], resting[kind], atol=1e-12) for kind in e.kinds)


def test_selected_constraints_are_above_the_threshold():
    e = evaluator()
    x = point(e)
    rows = e.rows(x, e.rows_above(x, 0.5))
    values = e.row_values(x, rows)
    assert (values > 0.5).all() and len(rows) == sum(
        int((v > 0.5).sum()) for v in e.constraint_values(x).values()
    )
    assert e.max_constraint_value(x) == values.max()


@given(st.integers(0, 100), st.sampled_from([None, (1.0, 4.0)]))
def test_variables_invert_fourier(seed, free):
    e = evaluator(free_period=free)
    x = point(e, seed)
    assert np.allclose(e.problem.variables(e.problem.fourier(x)), x, rtol=1e-13)


# uncertain robots


@pytest.mark.parametrize("name", ["two_link", "ur10e", "mimic"])
def test_torque_bound_holds_for_all_robots_in_the_ellipsoid(name):
    e = evaluator(name, uncertainty=0.3)
    p, x = e.problem, point(e)
    motion = p.fourier(x)
    Y = dynamics.regressor(p.robot, p.parameters, motion.samples(motion.grid(24)))
    bound = e.constraint_values(x)["torque"] * p.limits.torque  # for +τ and for −τ
    directions = np.random.default_rng(0).normal(size=(3000, p.parameters.count))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    torques = np.einsum(
        "tip,sp->tis", Y, p.parameters.nominal + 0.3 * directions @ p.parameters.scale.T
    )
    assert (torques.max(axis=2) <= bound[0] + 1e-9).all() and (
        -torques.min(axis=2) <= bound[1] + 1e-9
    ).all()


@pytest.mark.parametrize("name", ["two_link", "ur10e", "mimic"])
def test_torque_bound_is_attained_in_the_ellipsoid(name):
    e = evaluator(name, uncertainty=0.3)
    p, x = e.problem, point(e)
    motion = p.fourier(x)
    Y = dynamics.regressor(p.robot, p.parameters, motion.samples(motion.grid(24)))
    inverse = p.parameters.scale @ p.parameters.scale.T
    worst = 0.3 * Y @ inverse / np.sqrt(np.einsum("tip,pq,tiq->ti", Y, inverse, Y))[..., None]
    G0 = np.linalg.inv(p.parameters.scale).T @ np.linalg.inv(p.parameters.scale)
    assert np.allclose(
        np.einsum("tip,pq,tiq->ti", worst, G0, worst), 0.3**2, rtol=1e-6
    )  # on the surface of the ellipsoid
    for sign, side in ((1.0, 0), (-1.0, 1)):
        attained = sign * np.einsum("tip,tip->ti", Y, p.parameters.nominal + sign * worst)
        assert off(e.constraint_values(x)["torque"][side] * p.limits.torque, attained) < 1e-9


def test_torque_band_equals_that_of_the_certificate():
    e = evaluator("ur10e", uncertainty=0.3)
    p, x = e.problem, point(e)
    motion = p.fourier(x)
    nominal, width = dynamics.band(
        dynamics.regressor(p.robot, p.parameters, motion.samples(motion.grid(24))),
        p.parameters,
        0.3,
    )
    assert (
        off(
            e.constraint_values(x)["torque"] * p.limits.torque,
            np.stack([nominal + width, width - nominal]),
        )
        < 1e-9
    )
