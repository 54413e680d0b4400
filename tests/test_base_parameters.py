from __future__ import annotations

import dataclasses
import itertools
import os
import re
import warnings
from pathlib import Path

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
from excite.robot import base_parameters, exact_placement, inertial_parameters
from excite.robot.base_parameters import base_count
from excite.robot.dynamics import regressor
from excite.robot.inertial_parameters import DRIVE, Parameters
from excite.robot.limits import resolve
from excite.robot.robot import Robot, load

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
    standard = inertial_parameters.standard_parameters(robot, limits, drive)
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


@pytest.mark.filterwarnings("ignore:.*is rounded:excite.errors.ExciteWarning")
@given(seeds)
def test_structural_count_bounds_a_robot_with_mimics(rng):
    """A random angle may by chance be close to a right angle, as those of seed 910922 are."""
    robot = loaded(random_urdf(rng, 4, mimics={2: (0, 0.7, 0.1)}))
    limits = resolve(robot)
    standard = inertial_parameters.standard_parameters(robot, limits)
    base = base_parameters.find(robot, standard, limits).count
    assert base == rank(wide(robot, standard)) <= base_count(robot, standard)


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
    standard = inertial_parameters.standard_parameters(robot, limits, drive)
    return robot, standard, base_parameters.find(robot, standard, limits)


@pytest.mark.parametrize("name", ROBOTS)
def test_base_parameters_reproduce_the_torque(name):
    robot, standard, base = example(name)
    Y, B = wide(robot, standard), base.matrix
    gamma = Y @ B.T @ np.linalg.inv(B @ B.T)
    assert off(gamma @ B, Y) < 1e-8


@pytest.mark.parametrize("name", ROBOTS)
def test_independent_columns_reproduce_the_torque(name):
    robot, standard, base = example(name)
    Y = wide(robot, standard)
    assert off((Y @ base.selection) @ base.matrix, Y) < 1e-8


@pytest.mark.parametrize("name", ROBOTS)
def test_each_base_parameter_is_one_parameter_and_dependent_ones(name):
    _, _, base = example(name)
    assert np.array_equal(base.matrix[:, base.independent], np.eye(base.count))


@pytest.mark.parametrize("name", ROBOTS)
def test_plain_basis_is_orthonormal_and_spans_the_base(name):
    _, _, base = example(name)
    assert np.allclose(base.plain.T @ base.plain, np.eye(base.count), atol=1e-12)
    assert off((base.matrix @ base.plain) @ base.plain.T, base.matrix) < 1e-10


@pytest.mark.parametrize("name", ROBOTS)
def test_geometric_basis_is_orthonormal_in_the_metric(name):
    _, standard, base = example(name)
    V = np.linalg.solve(standard.scale, base.geometric)
    assert np.allclose(V.T @ V, np.eye(base.count), atol=1e-9)


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
    _, standard, base = example(name)
    said = np.array([read(text, standard.names) for text in base.expressions])
    assert np.allclose(said, base.matrix, rtol=1e-3, atol=1e-12)


def test_base_does_not_depend_on_global_randomness():
    np.random.seed(0)  # noqa: NPY002
    first = example("ur5e")[2].matrix
    np.random.seed(1)  # noqa: NPY002
    assert np.array_equal(first, example("ur5e")[2].matrix)


# -- rounded angles --------------------------------------------------------------------------------


def with_rounded_angles(text: str, decimals: int = 4) -> str:
    """A URDF whose angles have so many decimals."""

    def rounded(match: re.Match[str]) -> str:
        return 'rpy="' + " ".join(f"{float(word):.{decimals}f}" for word in match[1].split()) + '"'

    return re.sub(r'rpy="([^"]*)"', rounded, text)


def base_of(robot: Robot) -> tuple[Parameters, base_parameters.Base]:
    """Base parameters with limits of 1 where the URDF has none."""
    robot = dataclasses.replace(
        robot,
        entries=tuple(
            dataclasses.replace(
                entry,
                position=entry.position or (-1.0, 1.0),
                velocity=entry.velocity or 1.0,
                torque=entry.torque or 1.0,
            )
            for entry in robot.entries
        ),
    )
    limits = resolve(robot)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExciteWarning)
        standard = inertial_parameters.standard_parameters(robot, limits)
        return standard, base_parameters.find(robot, standard, limits)


@pytest.mark.parametrize("decimals", [2, 3, 4, 5, 6, 8])
@pytest.mark.parametrize("name", BUILTIN)
def test_base_parameters_do_not_depend_on_rounded_angles(name, decimals):
    exact, rounded = (
        loaded(with_rounded_angles(text_of(name), digits)) for digits in (15, decimals)
    )
    (_, expected), (_, base) = base_of(exact), base_of(rounded)
    assert base.count == expected.count
    assert np.array_equal(base.independent, expected.independent)
    assert np.allclose(base.matrix, expected.matrix, atol=1e-6)


def test_rounded_angles_are_reported_with_the_joint():
    machine = loaded(with_rounded_angles(text_of("ur10e")))
    limits = resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, limits)
    with pytest.warns(ExciteWarning, match=r"shoulder_lift_joint.* rounded .*exact right angles"):
        base_parameters.find(machine, standard, limits)


def test_the_dynamics_keep_the_angles_of_the_file():
    machine = loaded(with_rounded_angles(text_of("ur10e")))
    lift = machine.model.getJointId("shoulder_lift_joint")
    tilt = machine.model.jointPlacements[lift].rotation
    exact = machine.structure.jointPlacements[lift].rotation
    assert 1e-6 < np.abs(tilt - exact).max() < 1e-5


@pytest.mark.parametrize("name", BUILTIN)
def test_a_joints_friction_and_offset_are_base_parameters(name):
    standard, base = base_of(loaded(with_rounded_angles(text_of(name))))
    for kind in ("viscous", "coulomb", "offset"):
        places = range(standard.count)[standard.block(kind)]
        assert set(places) <= set(base.independent.tolist())


def test_offset_of_a_lift_stands_for_its_weight():
    standard, base = base_of(loaded(planar(1, (0, 0, 1), "prismatic")))
    assert standard.names.index("tau01") in base.independent


def test_angles_far_from_right_are_not_changed():
    assert exact_placement.exact_angles([0.7854, 1.57075, 0.3]) == [np.pi / 4, np.pi / 2, 0.3]
    assert exact_placement.exact_angles([1.571, 0.002, 0.0]) == [1.571, 0.002, 0.0]
    assert exact_placement.exact_lengths([9e-7, -2e-6, 0.1]) == [0.0, -2e-6, 0.1]


@pytest.mark.parametrize(
    ("number", "is_right"),
    [("1.57", True), ("1.571", True), ("1.5700", False), ("1.56", False), ("1.6", False)],
)
def test_an_angle_is_rounded_by_half_of_its_last_digit_at_most(number, is_right):
    text = text_of("two_link").replace('xyz="0.5 0 0" rpy="0 0 0"', f'rpy="{number} 0 0"')
    assert (loaded(text).rounded == ("joint_2",)) == is_right


def test_at_a_right_pitch_the_difference_of_yaw_and_roll_is_exact():
    roll, pitch, yaw = exact_placement.exact_angles([0.3, 1.5708, 0.3 + 1.5708])
    assert (roll, pitch, yaw) == (0.0, np.pi / 2, np.pi / 2)


def test_a_direction_near_an_axis_is_exact():
    assert exact_placement.exact_direction([0.0, 1.0, 3.67e-6]) == [0.0, 1.0, 0.0]
    assert exact_placement.exact_direction([0.6, 0.8, 0.0]) == pytest.approx([0.6, 0.8, 0.0])


# -- robots of the wheel example-robot-data --------------------------------------------------------

ZOO = Path(os.environ.get("EXCITE_ROBOT_DATA", "/tmp/erd"))
"""Where the wheel is unpacked; see scripts/base_counts.py."""
ZOO_ROBOTS = {
    "xarm_description/urdf/xarm7.urdf": 69,
    "so_arm_description/urdf/so100.urdf": 58,
    "so_arm_description/urdf/so101.urdf": 58,
    "ur_description/urdf/ur10_robot.urdf": 58,
    "kinova_description/robots/kinova.urdf": 58,
    "finger_edu_description/robots/finger_edu.urdf": 27,
}
"""Robots and their number of base parameters."""


@pytest.mark.parametrize(("path", "count"), ZOO_ROBOTS.items())
def test_robots_of_the_wheel_have_their_structural_number(path, count):
    file = next(ZOO.glob(f"**/robots/{path}"), None)
    if file is None:
        pytest.skip(f"example-robot-data is not unpacked at {ZOO}")
    text = file.read_text(encoding="utf-8")
    for variant in (text, with_rounded_angles(text)):
        standard, base = base_of(loaded(variant))
        assert base.count == count
        assert set(range(standard.count)[standard.block("offset")]) <= set(base.independent)
        assert np.linalg.cond(base.plain.T @ base.plain) < 1.0 + 1e-9
