from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.linalg
from conftest import BUILTIN, loaded, random_urdf, reframed, slope, states, text_of
from hypothesis import given
from hypothesis import strategies as st

from excite.designer import criteria
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
    """A robot, the numbers that a score needs, and the score."""

    robot: Robot
    limits: Limits
    standard: Parameters
    found: base_parameters.Base
    noise: np.ndarray

    def Y(self, motion: Samples) -> np.ndarray:
        return regressor(self.robot, self.standard, motion)

    def score(self, motion: Samples, given: np.ndarray | None = None) -> dict:
        return criteria.score(self.Y(motion), self.found, self.noise, given)


def case(robot: Robot, limits: Limits | None = None, drive: tuple[str, ...] = DRIVE) -> Case:
    limits = limits or resolve(robot)
    standard = inertial_parameters.standard(robot, limits, drive)
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


# -- an independent reading of METHOD ------------------------------------------------------------------------------


def natural_metric(c: Case) -> np.ndarray:
    """G₀ from its definition: a 10x10 block per body, 1/s² per drive parameter."""
    bodies = [metric(c.standard.nominal[10 * i : 10 * i + 10]) for i in range(c.standard.bodies)]
    scales = c.standard.scale.diagonal()[10 * c.standard.bodies :]
    return scipy.linalg.block_diag(*bodies, np.diag(1.0 / scales**2))


def eigenvalues(
    c: Case, motion: Samples, B: np.ndarray, H0_inverse: np.ndarray, more: np.ndarray | None = None
) -> np.ndarray:
    """Of I·H₀⁻¹ with I = mean Γᵀ Σ⁻¹ Γ and Γ = Y Bᵀ(BBᵀ)⁻¹."""
    gamma = c.Y(motion) @ B.T @ np.linalg.inv(B @ B.T)
    information = np.einsum("tip,i,tiq->pq", gamma, c.noise**-2.0, gamma) / len(motion)
    if more is not None:
        lift = B.T @ np.linalg.inv(B @ B.T)
        information = information + lift.T @ more @ lift
    return np.sort(np.linalg.eigvals(information @ H0_inverse).real)


def as_stated(values: np.ndarray) -> dict[str, float]:
    return {
        "a": np.sum(1 / values),
        "d": np.sum(np.log(values)),
        "e": values[0],
        "cond": values[-1] / values[0],
    }


def by_hand(
    c: Case, motion: Samples, mix: np.ndarray | None = None, more: np.ndarray | None = None
) -> dict[str, float]:
    B = c.found.matrix if mix is None else mix @ c.found.matrix
    return as_stated(eigenvalues(c, motion, B, B @ np.linalg.inv(natural_metric(c)) @ B.T, more))


@pytest.mark.parametrize("make", CASES)
def test_geometric_criteria_are_those_of_the_explicit_matrices(make):
    c = case(make())
    motion = states(c.robot.n, 80)
    assert c.score(motion)["geometric"] == pytest.approx(by_hand(c, motion), rel=1e-6)


@pytest.mark.parametrize("make", CASES)
def test_plain_criteria_are_those_of_a_base_with_orthonormal_rows(make):
    c = case(make())
    motion = states(c.robot.n, 80)
    rows = scipy.linalg.orth(c.found.matrix.T).T
    assert c.score(motion)["plain"] == pytest.approx(
        as_stated(eigenvalues(c, motion, rows, np.eye(len(rows)))), rel=1e-6
    )


@pytest.mark.parametrize("make", CASES)
def test_cond_regressor_is_the_condition_number_of_the_stacked_independent_columns(make):
    c = case(make())
    motion = states(c.robot.n, 80)
    stacked = c.Y(motion)[:, :, c.found.independent].reshape(-1, c.found.count)
    assert c.score(motion)["cond_regressor"] == pytest.approx(np.linalg.cond(stacked), rel=1e-8)


def test_criteria_are_per_sample():
    c, motion = case(load("two_link")), states(2, 40)
    twice = Samples(*(np.vstack([part, part]) for part in (motion.q, motion.dq, motion.ddq)))
    assert c.score(twice)["geometric"] == pytest.approx(c.score(motion)["geometric"], rel=1e-10)


def test_a_direction_never_seen_is_worth_nothing():
    c = case(load("two_link"))
    still = Samples(np.zeros((30, 2)), np.zeros((30, 2)), np.zeros((30, 2)))
    found = c.score(still)["geometric"]
    assert found["a"] > 1e12 and found["cond"] > 1e12 and found["e"] < 1e-12


# -- invariance ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", CASES)
def test_geometric_criteria_do_not_depend_on_the_choice_of_base(make):
    c = case(make())
    motion, count = states(c.robot.n, 80), c.found.count
    mix = np.eye(count) + 0.2 * np.random.default_rng(0).normal(size=(count, count)) / np.sqrt(
        count
    )
    assert c.score(motion)["geometric"] == pytest.approx(by_hand(c, motion, mix), rel=1e-5)


TEXTS = {
    "two_link": text_of("two_link"),
    "arm": arm(),
    "tree": random_urdf(np.random.default_rng(6), 4),
    "ur5e": text_of("ur5e"),
}


def pair(name: str, drive: tuple[str, ...] = DRIVE) -> tuple[Case, Case]:
    """One robot, its links' frames placed in two ways."""
    return case(loaded(TEXTS[name]), drive=drive), case(
        loaded(reframed(TEXTS[name], np.random.default_rng(3))), drive=drive
    )


@pytest.mark.parametrize("name", TEXTS)
def test_geometric_criteria_do_not_depend_on_the_links_frames(name):
    one, other = pair(name)
    motion = states(one.robot.n, 80)
    assert other.score(motion)["geometric"] == pytest.approx(
        one.score(motion)["geometric"], rel=1e-6
    )


@pytest.mark.parametrize("criterion", ["a", "e", "cond"])
@pytest.mark.parametrize("name", TEXTS)
def test_plain_criteria_do_depend_on_the_links_frames(name, criterion):
    one, other = pair(name, drive=())  # friction and offsets know no frames and would hide it
    motion = states(one.robot.n, 80)
    assert (
        abs(other.score(motion)["plain"][criterion] / one.score(motion)["plain"][criterion] - 1)
        > 1e-2
    )


@pytest.mark.parametrize("name", TEXTS)
def test_plain_d_ranks_motions_alike_in_all_frames(name):
    one, other = pair(name)
    motions = states(one.robot.n, 80), states(one.robot.n, 80, seed=9, speed=1.0)
    differences = [np.subtract(*(c.score(m)["plain"]["d"] for m in motions)) for c in (one, other)]
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
        return lambda found: (
            found[1] + " ".join(repr(float(v) * factor) for v in found[2].split()) + '"'
        )

    text = re.sub(r'(<origin[^>]*xyz=")([^"]*)"', times(1e3), text)
    text = re.sub(r'(<mass value=")([^"]*)"', times(1e3), text)
    return re.sub(r'(i[xyz][xyz]=")([^"]*)"', times(1e9), text)


@pytest.mark.parametrize("name", ["two_link", "arm", "ur5e"])
def test_geometric_criteria_do_not_depend_on_the_units(name):
    one = case(loaded(TEXTS[name]))
    robot = loaded(in_grams_and_millimetres(TEXTS[name]), gravity=(0, 0, -9810.0))
    other = case(robot, dataclasses.replace(one.limits, torque=one.limits.torque * 1e9))
    motion = states(robot.n, 80)
    assert other.score(motion)["geometric"] == pytest.approx(
        one.score(motion)["geometric"], rel=1e-5
    )
    assert abs(other.score(motion)["plain"]["a"] / one.score(motion)["plain"]["a"] - 1) > 1e-2


# -- information already there -------------------------------------------------------------------------------------


def test_given_information_adds():
    c, motion, earlier = case(load("two_link")), states(2, 80), states(2, 50, seed=9)
    more = criteria.standard_information(c.Y(earlier), c.noise) / len(motion)
    assert c.score(motion, more)["geometric"] == pytest.approx(
        by_hand(c, motion, more=more), rel=1e-6
    )


def test_standard_information_is_the_sum_of_outer_products():
    c, motion = case(load("two_link")), states(2, 5)
    Y = c.Y(motion)
    summed = sum(
        np.outer(row, row) / s**2 for sample in Y for row, s in zip(sample, c.noise, strict=True)
    )
    assert np.allclose(criteria.standard_information(Y, c.noise), summed, rtol=1e-12)


@pytest.mark.parametrize("name", BUILTIN)
def test_given_information_never_hurts(name):
    c = case(load(name))
    motion = states(c.robot.n, 60)
    more = criteria.standard_information(c.Y(states(c.robot.n, 60, seed=9)), c.noise) / 60
    alone, together = c.score(motion)["geometric"], c.score(motion, more)["geometric"]
    assert together["a"] < alone["a"] and together["d"] > alone["d"] and together["e"] >= alone["e"]


# -- the smooth family ---------------------------------------------------------------------------------------------


def some_rows(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (
        rng.normal(size=(20, 6)) @ np.diag(10.0 ** rng.uniform(-1, 1, 6)) @ rng.normal(size=(6, 6))
    )


@pytest.mark.parametrize("criterion", list(Criterion))
@given(seed=st.integers(0, 1000), sharpness=st.sampled_from([4.0, 25.0]))
def test_smooth_gradient_is_the_derivative(criterion, seed, sharpness):
    rows, direction = some_rows(seed), some_rows(seed + 1)
    direction *= np.linalg.norm(rows) / np.linalg.norm(direction)
    _, gradient = criteria.smooth(criterion, rows, sharpness)
    low = np.linalg.svd(rows, compute_uv=False)[-1] / np.linalg.norm(rows)
    measured = slope(
        lambda h: criteria.smooth(criterion, rows + h * direction, sharpness)[0], 2e-3 * low
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
def test_sharp_smooth_criterion_is_the_exact_one(criterion, seed):
    rows = some_rows(seed)
    values = np.sort(np.linalg.eigvalsh(rows.T @ rows))
    assert criteria.smooth(criterion, rows, 1e6)[0] == pytest.approx(
        EXACT[criterion](values), abs=1e-4
    )


@pytest.mark.parametrize("criterion", [Criterion.E, Criterion.COND])
def test_smooth_criterion_bounds_the_exact_one_from_above(criterion):
    rows = np.random.default_rng(0).normal(
        size=(40, 6)
    )  # eigenvalues of like size: the smoothing shows
    exact = EXACT[criterion](np.sort(np.linalg.eigvalsh(rows.T @ rows)))
    rising = [criteria.smooth(criterion, rows, sharpness)[0] for sharpness in (4.0, 25.0, 100.0)]
    assert rising[0] > rising[1] > rising[2] >= exact


@pytest.mark.parametrize("criterion", list(Criterion))
def test_value_is_the_one_METHOD_states(criterion):
    values = np.array([0.5, 2.0, 8.0])
    expected = {"a": 2.625, "d": np.log(8.0), "e": 0.5, "cond": 16.0, "cond_regressor": 4.0}
    assert criteria.value(criterion, values) == pytest.approx(expected[criterion.value])


def test_spectrum_counts_directions_without_rows():
    assert criteria.spectrum(np.array([[3.0, 0.0, 0.0]])).tolist() == [0.0, 0.0, 9.0]
