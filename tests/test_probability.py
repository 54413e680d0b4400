"""Probabilities of effects from their evidence, and the evidence itself."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from regression_columns import columns_on_all_joints
from scipy import stats

from excite.diagnosis import probability
from excite.diagnosis.regression import JointRegression

ROWS = 40
"""Rows of the small regressions below."""
finite = st.floats(-1e4, 1e4)
sizes = st.floats(0.0, 1e3)


robots = st.lists(st.floats(-50.0, 500.0), min_size=1, max_size=8).map(np.array)
"""Log Bayes factors of a friction at the joints of a robot."""


@given(robot=robots, more=st.floats(0.0, 1e4))
def test_more_evidence_for_a_friction_makes_it_more_probable_at_every_joint(robot, more):
    before = probability.friction_probabilities(robot)
    robot[0] += more
    after = probability.friction_probabilities(robot)
    assert (before >= 0.0).all() and (after <= 1.0).all()
    assert (after >= before - 1e-6).all()


def test_evidence_against_a_friction_counts_in_full_and_evidence_for_it_is_tempered():
    """On a robot of one joint, whose prior odds are those of the Beta prior alone."""
    a, b = probability.SHARED_COUNTS
    for factor, scale in ((-3.0, 1.0), (30.0, probability.TEMPERATURE)):
        (p,) = probability.friction_probabilities(np.array([factor]))
        assert p == pytest.approx(1.0 / (1.0 + b / a * np.exp(-factor / scale)))


@given(evidence=st.tuples(finite, finite), size=st.tuples(sizes, sizes))
def test_the_probability_of_a_rare_effect_grows_with_evidence_and_size(evidence, size):
    (low, high), (small, large) = sorted(evidence), sorted(size)
    p = probability.rare_probability(low, small).value
    assert 0.0 <= p <= probability.rare_probability(high, small).value <= 1.0
    assert p <= probability.rare_probability(low, large).value <= 1.0


def test_the_probability_without_evidence_or_size_is_zero():
    assert probability.friction_probabilities(np.array([-np.inf, 1e4]))[0] == 0.0
    assert probability.rare_probability(-np.inf, 10.0).value == 0.0
    assert probability.rare_probability(1e3, 0.0).value == pytest.approx(0.0, abs=1e-12)
    assert probability.rare_probability(1e3, 30.0).value == pytest.approx(1.0)


def test_a_friction_of_most_joints_is_more_probable_at_the_last():
    weak = 0.5 * probability.TEMPERATURE
    most, none = (
        probability.friction_probabilities(np.array([*[others] * 5, weak]))[-1]
        for others in (20.0 * probability.TEMPERATURE, -np.inf)
    )
    assert most > 0.7 and none < 0.4


def small_regression(seed: int, nonnegative: tuple[bool, ...]) -> JointRegression:
    """Return a regression of one joint with one base column and some columns of an effect."""
    rng = np.random.default_rng(seed)
    base, extra = rng.normal(size=(ROWS, 1, 1)), rng.normal(size=(ROWS, 1, len(nonnegative)))
    torque = base[:, :, 0] + 0.4 * extra.sum(axis=2) + 0.5 * rng.normal(size=(ROWS, 1))
    regression = JointRegression.of_base(
        torque,
        np.ones((ROWS, 1), bool),
        base,
        (np.array([0.7]), np.array([[0.3]])),
        np.array([0.5]),
        1.0,
    )
    regression.add(
        columns_on_all_joints(extra, np.array(nonnegative), np.full(len(nonnegative), 0.8))
    )
    return regression


@pytest.mark.parametrize("seed", range(3))
def test_log_evidence_is_the_marginal_likelihood(seed):
    """For a proper prior and no signs: the density of the torque under both Gaussian models."""
    regression = small_regression(seed, (False, False))
    x = regression._grams[0].columns
    variance = np.array([1.0 / 0.3, 0.64, 0.64])

    def density(k: int) -> float:
        covariance = 0.25 * np.eye(ROWS) + (x[:, :k] * variance[:k]) @ x[:, :k].T
        return float(
            stats.multivariate_normal(0.7 * x[:, 0], covariance).logpdf(regression.torque[:, 0])
        )

    factor = regression.log_evidence(regression.solution) - regression.log_evidence(
        regression.without([0])
    )
    assert factor == pytest.approx(density(3) - density(1), abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_log_evidence_with_signs_agrees_with_numerical_integration(seed):
    """Laplace's approximation for coefficients ≥ 0, whose prior density is twice the normal."""
    regression = small_regression(seed, (True, True))
    assert (regression.solution.coefficients[1:] > 0.3).all()  # away from zero
    x, y = regression._grams[0].columns, regression.torque[:, 0]
    theta, c = np.linspace(0.0, 2.0, 61), np.linspace(0.0, 1.2, 41)
    grid = np.array(list(itertools.product(theta, c, c)))
    error = y - grid @ x.T
    log = -0.5 * np.sum(error**2, axis=1) / 0.25
    log += stats.norm(0.7, np.sqrt(1.0 / 0.3)).logpdf(grid[:, 0])
    log += sum(stats.norm(0.0, 0.8).logpdf(grid[:, k]) + np.log(2.0) for k in (1, 2))
    cell = (theta[1] - theta[0]) * (c[1] - c[0]) ** 2
    full = float(np.log(np.sum(np.exp(log - log.max())) * cell) + log.max())
    base = -0.5 * np.sum((y - np.outer(theta, x[:, 0])) ** 2, axis=1) / 0.25
    base += stats.norm(0.7, np.sqrt(1.0 / 0.3)).logpdf(theta)
    alone = float(np.log(np.sum(np.exp(base - base.max())) * (theta[1] - theta[0])) + base.max())
    factor = regression.log_evidence(regression.solution) - regression.log_evidence(
        regression.without([0])
    )
    assert factor == pytest.approx(full - alone, abs=0.1)


def test_more_noise_means_less_evidence():
    regression = small_regression(1, (True,))
    factors = []
    for share in (1.0, 0.3, 0.05):
        weaker = dataclasses.replace(regression, independent_share=share)
        weaker.reweighted(np.array([0.5]), share)
        factors.append(
            weaker.log_evidence(weaker.solution) - weaker.log_evidence(weaker.without([0]))
        )
    assert factors == sorted(factors, reverse=True)
