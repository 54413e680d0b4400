from __future__ import annotations

import itertools
import re
import warnings

import numpy as np
import pytest
from conftest import (
    BUILTIN,
    document,
    joint,
    link,
    loaded,
    off,
    random_link,
    random_urdf,
    seeds,
    states,
    text_of,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from excite.errors import ExciteWarning
from excite.robot import base_parameters, inertial_parameters
from excite.robot.dynamics import regressor
from excite.robot.inertial_parameters import DRIVE, Parameters
from excite.robot.limits import resolve
from excite.robot.robot import Robot, load
from excite.robot.structural_count import base_count

COMBINATIONS = [
    tuple(kind for kind, on in zip(DRIVE, flags, strict=True) if on)
    for flags in itertools.product((0, 1), repeat=4)
]
GRAVITIES = [(0, 0, -9.81), (0, 0, 0), (9.81, 0, 0), (2.0, -3.0, 8.0)]


def rank(Y: np.ndarray) -> int:
    """Rank of stacked rows by the widest gap among the singular values that could matter."""
    rows = Y.reshape(-1, Y.shape[2])
    norms = np.linalg.norm(rows, axis=0)
    seen = norms > 1e-12 * norms.max()
    values = np.linalg.svd(np.linalg.qr(rows[:, seen] / norms[seen], mode="r"), compute_uv=False)
    logs = np.log(np.maximum(np.append(values, 0.0), 1e-14 * values[0]))
    small = np.exp(logs[1:]) < 1e-7 * values[0]
    return int(np.argmax(np.where(small, logs[:-1] - logs[1:], -1.0))) + 1


def wide(robot: Robot, standard: Parameters) -> np.ndarray:
    """Far more states than parameters, from another distribution than excite's own."""
    return regressor(
        robot, standard, states(robot.n, max(40, 4 * standard.count // robot.n), seed=7, speed=1.5)
    )


def counts(robot: Robot, drive: tuple[str, ...]) -> tuple[int, int, int]:
    limits = resolve(robot)
    standard = inertial_parameters.standard(robot, limits, drive)
    return (
        base_parameters.find(robot, standard, limits).count,
        base_count(robot, standard),
        rank(wide(robot, standard)),
    )


# -- counting --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BUILTIN)
def test_builtin_rank_is_the_structural_count_for_all_drive_parameters(name):
    robot = load(name)
    assert all(len(set(counts(robot, drive))) == 1 for drive in COMBINATIONS)


@pytest.mark.parametrize("gravity", GRAVITIES)
@pytest.mark.parametrize("name", ["two_link", "ur10e", "panda"])
def test_rank_is_the_structural_count_wherever_gravity_points(name, gravity):
    assert len(set(counts(load(name, gravity=gravity), ("offset",)))) == 1


@settings(max_examples=40)
@given(
    seeds,
    st.integers(1, 5),
    st.booleans(),
    st.booleans(),
    st.sampled_from(COMBINATIONS),
    st.sampled_from(GRAVITIES),
)
def test_rank_of_any_robot_is_the_structural_count(rng, count, tree, tidy, drive, gravity):
    robot = loaded(random_urdf(rng, count, tree=tree, tidy=tidy), gravity=gravity)
    assert len(set(counts(robot, drive))) == 1


def planar(count: int, axis: tuple[float, ...], kind: str = "revolute", roll: float = 0.0) -> str:
    """A chain in one plane with parallel joints, moving bodies of no symmetry; its first frame is
    rolled about x."""
    rng, parts = np.random.default_rng(0), [link("l")]
    for i in range(count):
        parts.append(random_link(rng, f"l{i}"))
        rolled = (roll if i == 0 else 0.0, 0.0, 0.0)
        parts.append(
            joint(
                f"j{i}",
                "l" if i == 0 else f"l{i - 1}",
                f"l{i}",
                kind,
                (0.4 * (i > 0), 0, 0),
                rolled,
                axis,
            )
        )
    return document(*parts)


@pytest.mark.parametrize(
    ("robot", "expected"),
    [
        (lambda: load("ur10e"), 36),
        (lambda: load("ur5e"), 36),
        (lambda: load("tx40"), 36),
        (lambda: load("panda"), 43),
        (lambda: load("iiwa14"), 43),
        (lambda: load("fr3"), 43),
        (lambda: loaded(planar(1, (0, 1, 0))), 3),  # a pendulum: I, m cx, m cz
        (lambda: loaded(planar(1, (0, 0, 1))), 1),  # the same lying flat: I
        (lambda: loaded(planar(2, (0, 1, 0))), 6),  # a vertical double pendulum
        (
            lambda: loaded(planar(2, (0, 0, 1))),
            4,
        ),  # lying flat: gravity no longer shows the first link's centre
        (
            lambda: loaded(planar(3, (0, 1, 0), roll=np.pi / 2)),
            7,
        ),  # three flat joints, whose frames stand upright
        (lambda: loaded(planar(1, (0, 0, 1), "prismatic")), 1),  # a lift: m
        (lambda: load("two_link"), 6),
    ],
)
def test_counts_known_from_the_literature(robot, expected):
    assert counts(robot(), ()) == (expected,) * 3


def test_viscous_and_coulomb_friction_are_always_seen():
    robot = load("ur10e")
    assert counts(robot, ("viscous", "coulomb"))[0] == 36 + 12


def test_offset_of_a_lift_cannot_be_told_from_its_weight_at_rest_alone():
    lift = loaded(planar(1, (0, 0, 1), "prismatic"))
    assert counts(lift, ("offset",))[0] == 2
    assert counts(lift, ("rotor_inertia",))[0] == 2
    assert counts(lift, ("rotor_inertia", "offset"))[0] == 2  # mass, rotor and offset: two numbers


@given(seeds)
def test_structural_count_bounds_a_robot_with_mimics(rng):
    robot = loaded(random_urdf(rng, 4, mimics={2: (0, 0.7, 0.1)}))
    limits = resolve(robot)
    standard = inertial_parameters.standard(robot, limits)
    found = base_parameters.find(robot, standard, limits).count
    assert found == rank(wide(robot, standard)) <= base_count(robot, standard)


# -- the base itself -------------------------------------------------------------------------------

ROBOTS = [*BUILTIN, 0, 1, 2]


def example(
    name: str | int, drive: tuple[str, ...] = DRIVE
) -> tuple[Robot, Parameters, base_parameters.Base]:
    robot = (
        load(name)
        if isinstance(name, str)
        else loaded(random_urdf(np.random.default_rng(name), 5, tidy=name == 2))
    )
    limits = resolve(robot)
    standard = inertial_parameters.standard(robot, limits, drive)
    return robot, standard, base_parameters.find(robot, standard, limits)


@pytest.mark.parametrize("name", ROBOTS)
def test_base_parameters_reproduce_the_torque(name):
    robot, standard, found = example(name)
    Y, B = wide(robot, standard), found.matrix
    gamma = Y @ B.T @ np.linalg.inv(B @ B.T)
    assert off(gamma @ B, Y) < 1e-8


@pytest.mark.parametrize("name", ROBOTS)
def test_independent_columns_reproduce_the_torque(name):
    robot, standard, found = example(name)
    Y = wide(robot, standard)
    assert off((Y @ found.selection) @ found.matrix, Y) < 1e-8


@pytest.mark.parametrize("name", ROBOTS)
def test_each_base_parameter_is_one_parameter_and_dependent_ones(name):
    _, _, found = example(name)
    assert np.array_equal(found.matrix[:, found.independent], np.eye(found.count))


@pytest.mark.parametrize("name", ROBOTS)
def test_plain_basis_is_orthonormal_and_spans_the_base(name):
    _, _, found = example(name)
    assert np.allclose(found.plain.T @ found.plain, np.eye(found.count), atol=1e-12)
    assert off((found.matrix @ found.plain) @ found.plain.T, found.matrix) < 1e-10


@pytest.mark.parametrize("name", ROBOTS)
def test_geometric_basis_is_orthonormal_in_the_metric(name):
    _, standard, found = example(name)
    V = np.linalg.solve(standard.scale, found.geometric)
    assert np.allclose(V.T @ V, np.eye(found.count), atol=1e-9)


def read(expression: str, names: tuple[str, ...]) -> np.ndarray:
    """Coefficients of "m3 + 0.613*mcx2 - Izz1"."""
    row = np.zeros(len(names))
    tokens = re.findall(r"(?:^|\s)([+-]\s)?(?:([\d.e+-]+)\*)?(\w+)", expression)
    for sign, factor, name in tokens:
        row[names.index(name)] = (-1.0 if sign.strip() == "-" else 1.0) * float(factor or 1.0)
    assert " ".join(expression.split()) and sum(
        len("".join(t).replace(" ", "")) for t in tokens
    ) + expression.count("*") == len(expression.replace(" ", ""))
    return row


@pytest.mark.parametrize("name", ROBOTS)
def test_expressions_say_what_the_matrix_does(name):
    _, standard, found = example(name)
    said = np.array([read(text, standard.names) for text in found.expressions])
    assert np.allclose(said, found.matrix, rtol=1e-3, atol=1e-12)


def test_base_does_not_depend_on_global_randomness():
    np.random.seed(0)  # noqa: NPY002
    first = example("ur5e")[2].matrix
    np.random.seed(1)  # noqa: NPY002
    assert np.array_equal(first, example("ur5e")[2].matrix)


def test_a_rounded_right_angle_makes_no_parameter():
    exact = text_of("ur10e")
    rounded = re.sub(r"1\.570796\d*", "1.5708", exact)
    assert rounded != exact
    machine = loaded(rounded)
    standard = inertial_parameters.standard(machine, resolve(machine))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExciteWarning)
        assert base_parameters.find(machine, standard, resolve(machine)).count == 58
