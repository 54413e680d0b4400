"""Optimality criteria against an independent implementation of their definitions."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.linalg
from conftest import (
    BUILTIN,
    QUICK,
    information_of,
    loaded,
    random_urdf,
    reframed,
    slope,
    states,
    text_of,
)
from hypothesis import given
from hypothesis import strategies as st

from excite.designer import criteria, optimize
from excite.designer.criteria import Criterion
from excite.robot import base_parameters, inertial_parameters
from excite.robot.dynamics import regressor
from excite.robot.inertial_parameters import DRIVE, Parameters, metric
from excite.robot.limits import Limits, resolve
from excite.robot.robot import Robot, load
from excite.robot.samples import Samples

GEOMETRIC = ("a", "d", "e", "cond")


@dataclass(frozen=True)
class Case:
    """Robot with the quantities that its criteria need."""

    robot: Robot
    limits: Limits
    standard: Parameters
    base: base_parameters.Base
    noise: np.ndarray

    def Y(self, motion: Samples) -> np.ndarray:
        return regressor(self.robot, self.standard, motion)

    def score(self, motion: Samples, earlier: np.ndarray | None = None) -> dict:
        return criteria.evaluate_criteria(self.Y(motion), self.base, self.noise, earlier)


def case(robot: Robot, limits: Limits | None = None, drive: tuple[str, ...] = DRIVE) -> Case:
    limits = limits or resolve(robot)
    standard = inertial_parameters.standard_parameters(robot, limits, drive)
    return Case(
        robot, limits, standard, base_parameters.find(robot, standard, limits), 0.01 * limits.torque
    )


def arm(seed: int = 1) -> str:
    return random_urdf(np.random.default_rng(seed), 3, kinds=("revolute",), tree=False)


CASES = [
    pytest.param(lambda: load("two_link"), id="two_link"),
    pytest.param(lambda: loaded(arm()), id="arm"),
    pytest.param(lambda: load("ur5e"), id="ur5e"),
]


# an independent implementation of the definitions


def natural_metric(c: Case) -> np.ndarray:
    """Compute G₀ from its definition: a 10x10 block per body, 1/s² per actuator parameter."""
    bodies = [metric(c.standard.nominal[10 * i : 10 * i + 10]) for i in range(c.standard.bodies)]
    scales = c.standard.scale.diagonal()[10 * c.standard.bodies :]
    return scipy.linalg.block_diag(*bodies, np.diag(1.0 / scales**2))


def eigenvalues(
    c: Case, motion: Samples, B: np.ndarray, H0_inverse: np.ndarray, more: np.ndarray | None = None
) -> np.ndarray:
    """Return the eigenvalues of I·H₀⁻¹ with I = mean Γᵀ Σ⁻¹ Γ and Γ = Y Bᵀ(BBᵀ)⁻¹."""
    gamma = c.Y(motion) @ B.T @ np.linalg.inv(B @ B.T)
    information = np.einsum("tip,i,tiq->pq", gamma, c.noise**-2.0, gamma) / len(motion)
    if more is not None:
        lift = B.T @ np.linalg.inv(B @ B.T)
        information = information + lift.T @ more @ lift
    return np.sort(np.linalg.eigvals(information @ H0_inverse).real)


def criteria_of_eigenvalues(values: np.ndarray) -> dict[str, float]:
    return {
        "a": np.sum(1 / values),
        "d": np.sum(np.log(values)),
        "e": values[0],
        "cond": values[-1] / values[0],
    }


def geometric_criteria(
    c: Case, motion: Samples, mix: np.ndarray | None = None, more: np.ndarray | None = None
) -> dict[str, float]:
    B = c.base.matrix if mix is None else mix @ c.base.matrix
    return criteria_of_eigenvalues(
        eigenvalues(c, motion, B, B @ np.linalg.inv(natural_metric(c)) @ B.T, more)
    )


@pytest.mark.parametrize("make", CASES)
def test_geometric_criteria_equal_their_definition(make):
    c = case(make())
    motion = states(c.robot.n, 80)
    assert c.score(motion)["geometric"] == pytest.approx(geometric_criteria(c, motion), rel=1e-6)


@pytest.mark.parametrize("make", CASES)
def test_plain_criteria_equal_those_of_an_orthonormal_base(make):
    c = case(make())
    motion = states(c.robot.n, 80)
    rows = scipy.linalg.orth(c.base.matrix.T).T
    assert c.score(motion)["plain"] == pytest.approx(
        criteria_of_eigenvalues(eigenvalues(c, motion, rows, np.eye(len(rows)))), rel=1e-6
    )


@pytest.mark.parametrize("make", CASES)
def test_cond_regressor_is_the_condition_number_of_independent_columns(make):
    c = case(make())
    motion = states(c.robot.n, 80)
    stacked = c.Y(motion)[:, :, c.base.independent].reshape(-1, c.base.count)
    assert c.score(motion)["cond_regressor"] == pytest.approx(np.linalg.cond(stacked), rel=1e-8)


def test_criteria_are_per_sample():
    c, motion = case(load("two_link")), states(2, 40)
    twice = Samples(*(np.vstack([part, part]) for part in (motion.q, motion.dq, motion.ddq)))
    assert c.score(twice)["geometric"] == pytest.approx(c.score(motion)["geometric"], rel=1e-10)


def test_unexcited_direction_gives_the_worst_value():
    c = case(load("two_link"))
    resting = Samples(np.zeros((30, 2)), np.zeros((30, 2)), np.zeros((30, 2)))
    values = c.score(resting)["geometric"]
    assert values["a"] > 1e12 and values["cond"] > 1e12 and values["e"] < 1e-12


# invariance


@pytest.mark.parametrize("make", CASES)
def test_geometric_criteria_do_not_depend_on_the_choice_of_base(make):
    c = case(make())
    motion, count = states(c.robot.n, 80), c.base.count
    mix = np.eye(count) + 0.2 * np.random.default_rng(0).normal(size=(count, count)) / np.sqrt(
        count
    )
    assert c.score(motion)["geometric"] == pytest.approx(
        geometric_criteria(c, motion, mix), rel=1e-5
    )


TEXTS = {
    "two_link": text_of("two_link"),
    "arm": arm(),
    "tree": random_urdf(np.random.default_rng(6), 4),
    "ur5e": text_of("ur5e"),
}


def pair(name: str, drive: tuple[str, ...] = DRIVE) -> tuple[Case, Case]:
    """Return the same robot with two choices of link frames."""
    return case(loaded(TEXTS[name]), drive=drive), case(
        loaded(reframed(TEXTS[name], np.random.default_rng(3))), drive=drive
    )


@pytest.mark.parametrize("name", TEXTS)
def test_geometric_criteria_do_not_depend_on_link_frames(name):
    original, moved = pair(name)
    motion = states(original.robot.n, 80)
    assert moved.score(motion)["geometric"] == pytest.approx(
        original.score(motion)["geometric"], rel=1e-6
    )


@pytest.mark.parametrize("criterion", ["a", "e", "cond"])
@pytest.mark.parametrize("name", TEXTS)
def test_plain_criteria_depend_on_link_frames(name, criterion):
    original, moved = pair(name, drive=())  # joint parameters do not depend on frames
    motion = states(original.robot.n, 80)
    assert (
        abs(
            moved.score(motion)["plain"][criterion] / original.score(motion)["plain"][criterion] - 1
        )
        > 1e-2
    )


@pytest.mark.parametrize("name", TEXTS)
def test_plain_d_ranking_does_not_depend_on_link_frames(name):
    original, moved = pair(name)
    motions = states(original.robot.n, 80), states(original.robot.n, 80, seed=9, speed=1.0)
    differences = [
        np.subtract(*(c.score(m)["plain"]["d"] for m in motions)) for c in (original, moved)
    ]
    assert differences[1] == pytest.approx(differences[0], rel=1e-7)


@pytest.mark.parametrize("name", TEXTS)
def test_plain_and_geometric_d_differ_by_a_constant(name):
    c = case(loaded(TEXTS[name]))
    scores = [c.score(states(c.robot.n, 80, seed=s)) for s in (0, 9)]
    assert scores[0]["plain"]["d"] - scores[0]["geometric"]["d"] == pytest.approx(
        scores[1]["plain"]["d"] - scores[1]["geometric"]["d"], rel=1e-7
    )


def in_grams_and_millimetres(text: str) -> str:
    """The same URDF with lengths x 1e3, masses x 1e3 and inertias x 1e9."""

    def times(factor):
        return lambda match: (
            match[1] + " ".join(repr(float(v) * factor) for v in match[2].split()) + '"'
        )

    text = re.sub(r'(<origin[^>]*xyz=")([^"]*)"', times(1e3), text)
    text = re.sub(r'(<mass value=")([^"]*)"', times(1e3), text)
    return re.sub(r'(i[xyz][xyz]=")([^"]*)"', times(1e9), text)


@pytest.mark.parametrize("name", ["two_link", "arm", "ur5e"])
def test_geometric_criteria_do_not_depend_on_the_units(name):
    original = case(loaded(TEXTS[name]))
    robot = loaded(in_grams_and_millimetres(TEXTS[name]), gravity=(0, 0, -9810.0))
    scaled = case(robot, dataclasses.replace(original.limits, torque=original.limits.torque * 1e9))
    motion = states(robot.n, 80)
    assert scaled.score(motion)["geometric"] == pytest.approx(
        original.score(motion)["geometric"], rel=1e-5
    )
    assert abs(scaled.score(motion)["plain"]["a"] / original.score(motion)["plain"]["a"] - 1) > 1e-2


# earlier information


def test_earlier_information_adds():
    c, motion, earlier = case(load("two_link")), states(2, 80), states(2, 50, seed=9)
    more = information_of(c.Y(earlier), c.noise) / len(motion)
    assert c.score(motion, more)["geometric"] == pytest.approx(
        geometric_criteria(c, motion, more=more), rel=1e-6
    )


@pytest.mark.parametrize("name", BUILTIN)
def test_earlier_information_never_worsens_a_criterion(name):
    c = case(load(name))
    motion = states(c.robot.n, 60)
    more = information_of(c.Y(states(c.robot.n, 60, seed=9)), c.noise) / 60
    alone, together = c.score(motion)["geometric"], c.score(motion, more)["geometric"]
    assert together["a"] < alone["a"] and together["d"] > alone["d"] and together["e"] >= alone["e"]


# smooth criteria


def some_rows(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (
        rng.normal(size=(20, 6)) @ np.diag(10.0 ** rng.uniform(-1, 1, 6)) @ rng.normal(size=(6, 6))
    )


@pytest.mark.parametrize("criterion", list(Criterion))
@given(seed=st.integers(0, 1000), sharpness=st.sampled_from([4.0, 25.0]))
def test_smooth_gradient_equals_finite_differences(criterion, seed, sharpness):
    rows, direction = some_rows(seed), some_rows(seed + 1)
    direction *= np.linalg.norm(rows) / np.linalg.norm(direction)
    _, gradient = criteria.smooth_objective(criterion, rows, sharpness)
    low = np.linalg.svd(rows, compute_uv=False)[-1] / np.linalg.norm(rows)
    measured = slope(
        lambda h: criteria.smooth_objective(criterion, rows + h * direction, sharpness)[0],
        2e-3 * low,
    )
    change = rows.T @ direction + direction.T @ rows
    scale = np.linalg.norm(gradient @ rows.T) * np.linalg.norm(direction)
    assert abs(np.sum(gradient * change) - measured) < 1e-6 * scale


EXACT = {
    Criterion.A: lambda v: np.log(np.sum(1 / v)),
    Criterion.D: lambda v: -np.mean(np.log(v)),
    Criterion.E: lambda v: -np.log(v[0]),
    Criterion.COND: lambda v: np.log(v[-1] / v[0]),
    Criterion.COND_REGRESSOR: lambda v: np.log(v[-1] / v[0]),
}


@pytest.mark.parametrize("criterion", list(Criterion))
@given(seed=st.integers(0, 1000))
def test_smooth_criterion_converges_to_the_exact_one(criterion, seed):
    rows = some_rows(seed)
    values = np.sort(np.linalg.eigvalsh(rows.T @ rows))
    assert criteria.smooth_objective(criterion, rows, 1e6)[0] == pytest.approx(
        EXACT[criterion](values), abs=1e-4
    )


@pytest.mark.parametrize("criterion", [Criterion.E, Criterion.COND])
def test_smooth_criterion_is_an_upper_bound(criterion):
    rows = np.random.default_rng(0).normal(
        size=(40, 6)
    )  # eigenvalues of like size: the smoothing shows
    exact = EXACT[criterion](np.sort(np.linalg.eigvalsh(rows.T @ rows)))
    rising = [
        criteria.smooth_objective(criterion, rows, sharpness)[0] for sharpness in (4.0, 25.0, 100.0)
    ]
    assert rising[0] > rising[1] > rising[2] >= exact


@pytest.mark.parametrize("criterion", list(Criterion))
def test_criterion_values_equal_their_definition(criterion):
    values = np.array([0.5, 2.0, 8.0])
    expected = {"a": 2.625, "d": np.log(8.0), "e": 0.5, "cond": 16.0, "cond_regressor": 4.0}
    assert criteria.criterion_value(criterion, values) == pytest.approx(expected[criterion.value])


def test_eigenvalues_include_zeros_for_directions_without_rows():
    assert criteria.information_eigenvalues(np.array([[3.0, 0.0, 0.0]])).tolist() == [0.0, 0.0, 9.0]


# numerical shortcuts


@pytest.mark.parametrize("name", ["two_link", "panda"])
def test_support_changes_only_the_cost(name):
    robot = load(name)
    problem = optimize.set_up(robot, resolve(robot), QUICK).problem
    motion = states(robot.n, 40)
    function = problem.functions.regressor
    Y = np.array(
        [
            np.asarray(function(*state)).T
            for state in zip(motion.q, motion.dq, motion.ddq, strict=True)
        ]
    )
    sparse, dense = problem.weighting, dataclasses.replace(problem.weighting, support=None)
    assert sparse.support is not None
    gradient = np.eye(sparse.columns.shape[1])
    assert np.allclose(
        sparse.rows(Y), dense.rows(Y), rtol=1e-12, atol=1e-12 * np.abs(dense.rows(Y)).max()
    )
    supported = np.zeros(Y.shape, bool)
    for j, columns in enumerate(sparse.support):
        supported[:, j, columns] = True
    assert not Y[~supported].any()
    assert np.allclose(
        sparse.regressor_gradient(Y, gradient)[supported],
        dense.regressor_gradient(Y, gradient)[supported],
        rtol=1e-9,
        atol=1e-12,
    )


@pytest.mark.parametrize("name", ["two_link", "panda"])
def test_norms_by_blocks_equal_the_dense_quadratic_form(name):
    c = case(load(name))
    rows = c.Y(states(c.robot.n, 40)).reshape(-1, c.standard.count)
    dense = np.einsum("rp,pq,rq->r", rows, c.standard.scale @ c.standard.scale.T, rows)
    assert np.allclose(c.standard.norms(rows), dense, rtol=1e-9)


def test_objective_is_the_same_from_rows_and_from_their_square(monkeypatch):
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(80, 6)) * np.geomspace(1.0, 30.0, 6)
    results = {}
    for ratio in (1e-6, 1.0):  # squared; from the rows themselves
        monkeypatch.setattr(criteria, "MIN_SPECTRUM_RATIO", ratio)
        results[ratio] = [criteria.smooth_objective(c, rows, 4.0) for c in Criterion]
    for (value, gradient), (other_value, other_gradient) in zip(*results.values(), strict=True):
        assert value == pytest.approx(other_value, rel=1e-10)
        assert np.allclose(gradient, other_gradient, rtol=1e-8, atol=1e-12 * np.abs(gradient).max())
