"""Regression of the joint model: sign constraints, weights, candidates and torque."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from regression_columns import columns_on_all_joints
from scipy import optimize

from excite.diagnosis import joint_model
from excite.diagnosis.regression import CandidateBatch, Columns, JointRegression, independent_share


def random_regression(seed: int, nonnegative: bool) -> tuple[JointRegression, np.ndarray]:
    """Return a regression of two joints with random columns, and all its columns."""
    rng = np.random.default_rng(seed)
    base, extra = rng.normal(size=(60, 2, 3)), rng.normal(size=(60, 2, 4))
    torque = rng.normal(size=(60, 2))
    prior = np.zeros(3), 0.1 * np.eye(3)
    regression = JointRegression.of_base(
        torque, np.ones((60, 2), bool), base, prior, np.array([0.5, 2.0]), 0.7
    )
    regression.add(columns_on_all_joints(extra, np.full(4, nonnegative), np.full(4, 3.0)))
    return regression, np.concatenate([base, extra], axis=2)


@given(seed=st.integers(0, 1000))
def test_solution_without_constraints_is_least_squares(seed):
    regression, columns = random_regression(seed, nonnegative=False)
    weight = np.sqrt(np.repeat(regression.weights[None], 60, axis=0)).ravel()
    prior = np.sqrt(np.diag([0.1] * 3 + [1.0 / 9.0] * 4))
    rows = np.vstack([columns.reshape(-1, 7) * weight[:, None], prior])
    target = np.concatenate([regression.torque.ravel() * weight, np.zeros(7)])
    expected = np.linalg.lstsq(rows, target, rcond=None)[0]
    np.testing.assert_allclose(regression.solution.coefficients, expected, rtol=1e-6, atol=1e-8)
    objective = 0.5 * np.sum((rows @ expected - target) ** 2)
    assert regression.solution.objective == pytest.approx(objective)


def test_a_joint_without_torque_has_a_finite_weight():
    """As one at rest, which friction holds: its residual is zero."""
    rng = np.random.default_rng(0)
    base, torque = rng.normal(size=(60, 2, 3)), rng.normal(size=(60, 2))
    base[:, 1], torque[:, 1] = 0.0, 0.0
    regression = JointRegression.of_base(
        torque, np.ones((60, 2), bool), base, (np.zeros(3), np.eye(3)), np.ones(2), 0.7
    )
    joint_model.reweight(regression)
    assert np.isfinite(regression.weights).all()


@given(seed=st.integers(0, 1000))
def test_information_of_the_data_is_not_lost_next_to_a_strong_prior(seed):
    """A prior 10²⁰ times as strong as the data must not leave its rounding errors."""
    rng = np.random.default_rng(seed)
    base, extra = rng.normal(size=(60, 2, 3)), rng.normal(size=(60, 2, 4))
    torque, prior = rng.normal(size=(60, 2)), (np.ones(3), 1e22 * np.eye(3))
    regression = JointRegression.of_base(
        torque, np.ones((60, 2), bool), base, prior, np.array([0.5, 2.0]), 0.7
    )
    regression.add(columns_on_all_joints(extra, np.zeros(4, bool), np.full(4, 1e6)))
    information, score, follow = regression.data_information(3)
    weight = np.sqrt(np.repeat(regression.weights[None], 60, axis=0)).ravel()
    first, others = (x.reshape(120, -1) * weight[:, None] for x in (base, extra))
    fitted = np.linalg.lstsq(others, first, rcond=None)[0]
    residual = first - others @ fitted
    np.testing.assert_allclose(information, residual.T @ residual, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(score, residual.T @ (torque.ravel() * weight), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(follow, -fitted, rtol=1e-6, atol=1e-6)


@given(seed=st.integers(0, 1000))
def test_constrained_solution_satisfies_the_optimality_conditions(seed):
    """Karush-Kuhn-Tucker: the gradient vanishes at active coefficients, and is ≥ 0 at zero."""
    regression, columns = random_regression(seed, nonnegative=True)
    x = regression.solution.coefficients
    residual = regression.residual() * regression.weights
    gradient = -np.einsum("njk,nj->k", columns, residual)
    gradient += np.array([0.1] * 3 + [1.0 / 9.0] * 4) * x
    assert (x[3:] >= 0.0).all()
    np.testing.assert_allclose(gradient[regression.solution.active], 0.0, atol=1e-5)
    assert (gradient[~regression.solution.active] >= -1e-5).all()


@given(seed=st.integers(0, 1000), slowest=st.floats(0.05, 1.0))
def test_constrained_solution_of_nearly_collinear_columns_is_that_of_nnls(seed, slowest):
    """Exponentials are so alike that exchanges of the active set may cycle."""
    rng = np.random.default_rng(seed)
    rates = np.linspace(slowest, 3.0, 30)
    columns = np.exp(-np.outer(np.linspace(0.0, 5.0, 80), rates))[:, None]
    torque = columns @ np.maximum(rng.normal(size=30), 0.0) + 0.1 * rng.normal(size=(80, 1))
    regression = JointRegression.of_base(
        torque,
        np.ones((80, 1), bool),
        np.ones((80, 1, 1)),
        (np.zeros(1), np.eye(1)),
        np.ones(1),
        1.0,
    )
    regression.add(columns_on_all_joints(columns, np.ones(30, bool), np.full(30, 3.0)))
    x = regression.solution.coefficients
    a = np.column_stack([np.ones(80), -np.ones(80), columns[:, 0]])
    prior = np.hstack([np.zeros((30, 2)), np.eye(30) / 3.0])
    rows = np.vstack([a, [1.0, -1.0, *np.zeros(30)], prior])
    reference, least = optimize.nnls(rows, np.concatenate([torque[:, 0], np.zeros(31)]))
    residual = regression.residual()[:, 0]
    objective = residual @ residual + x[0] ** 2 + np.sum((x[1:] / 3.0) ** 2)
    assert (x[1:] >= 0.0).all()
    assert objective == pytest.approx(least**2, rel=1e-6)
    assert x[0] == pytest.approx(reference[0] - reference[1], rel=1e-3, abs=1e-3)


@given(seed=st.integers(0, 1000))
def test_parameters_of_the_base_model_can_be_constrained_as_well(seed):
    """Friction of the base model cannot be negative to make room for an effect."""
    rng = np.random.default_rng(seed)
    base, extra = rng.normal(size=(60, 2, 3)), rng.normal(size=(60, 2, 4))
    torque = rng.normal(size=(60, 2))
    nonnegative = np.array([True, False, True])
    regression = JointRegression.of_base(
        torque,
        np.ones((60, 2), bool),
        base,
        (np.zeros(3), 0.1 * np.eye(3)),
        np.array([0.5, 2.0]),
        0.7,
        nonnegative,
    )
    regression.add(columns_on_all_joints(extra, np.ones(4, bool), np.full(4, 3.0)))
    solution = regression.solution
    x, active = solution.coefficients, solution.active
    columns = np.concatenate([base, extra], axis=2)
    gradient = -np.einsum("njk,nj->k", columns, regression.residual() * regression.weights)
    gradient += np.array([0.1] * 3 + [1.0 / 9.0] * 4) * x
    bounded = np.append(nonnegative, np.ones(4, bool))
    assert (x[bounded] >= 0.0).all() and active[~bounded].all()
    np.testing.assert_allclose(gradient[active], 0.0, atol=1e-5)
    assert (gradient[~active] >= -1e-5).all()


@given(seed=st.integers(0, 1000))
def test_coefficients_of_either_sign_stay_free_next_to_constrained_ones(seed):
    """An effect with both kinds: only those that cannot be negative may be held at zero."""
    rng = np.random.default_rng(seed)
    regression, columns = random_regression(seed, nonnegative=True)
    nonnegative = np.array([True, False, True, False])
    extra = rng.normal(size=(60, 2, 4)) - 0.5 * regression.torque[:, :, None]
    regression.add(columns_on_all_joints(extra, nonnegative, np.full(4, 3.0)))
    x, active = regression.solution.coefficients, regression.solution.active
    gradient = -np.einsum(
        "njk,nj->k",
        np.concatenate([columns, extra], axis=2),
        regression.residual() * regression.weights,
    )
    gradient += np.array([0.1] * 3 + [1.0 / 9.0] * 8) * x
    assert active[7:][~nonnegative].all()
    assert (x[7:][nonnegative] >= 0.0).all()
    np.testing.assert_allclose(gradient[active], 0.0, atol=1e-5)
    assert (gradient[~active] >= -1e-5).all()


def test_effects_are_added_together_as_one_by_one_and_only_to_the_copy():
    rng = np.random.default_rng(7)
    regression, _ = random_regression(7, nonnegative=True)
    before = regression.solution
    effects = [
        Columns(joints, tuple(rng.normal(size=(60, 2)) for _ in joints), np.ones(2, bool), std)
        for joints, std in (((1,), np.array([1.0, 2.0])), ((0, 1), np.array([3.0, 0.5])))
    ]
    together, singly = regression.copy(), regression.copy()
    together.add(*effects)
    for columns in effects:
        singly.add(columns)
    assert together.slices == singly.slices
    np.testing.assert_allclose(
        together.solution.coefficients, singly.solution.coefficients, rtol=1e-9, atol=1e-12
    )
    assert regression.solution is before
    assert len(regression.slices) == 1


def test_candidate_gains_what_the_refit_gains():
    regression, _ = random_regression(3, nonnegative=False)
    columns = columns_on_all_joints(
        np.random.default_rng(8).normal(size=(60, 2, 2)), np.zeros(2, bool), np.full(2, 5.0)
    )
    before = regression.solution.objective
    fit = regression.candidate(columns)
    (effect,) = regression.add(columns)
    assert before - regression.solution.objective == pytest.approx(fit.gain, rel=1e-6)
    np.testing.assert_allclose(
        regression.solution.coefficients[regression.slices[effect]], fit.coefficients, rtol=1e-6
    )
    assert regression.without([effect]).objective == pytest.approx(before)


def test_candidate_gains_by_the_variance_that_remains():
    regression, _ = random_regression(3, nonnegative=False)
    columns = columns_on_all_joints(
        np.random.default_rng(8).normal(size=(60, 2, 2)), np.zeros(2, bool), np.full(2, 5.0)
    )
    (fit,) = regression.candidates(CandidateBatch.of([columns], regression.moving), log_gains=True)
    before = regression.residual_rms(regression.solution)
    regression.add(columns)
    after = regression.residual_rms(regression.solution)
    prior = 0.5 * np.sum(fit.coefficients**2 / 5.0**2)
    expected = regression.independent_share * 60 * np.log(before / after).sum() - prior
    assert fit.log_gain == pytest.approx(expected, rel=1e-6)


def test_candidates_of_a_batch_are_fitted_one_by_one():
    """Candidates of different sizes, on one joint or on both, do not see each other."""
    rng = np.random.default_rng(4)
    regression, _ = random_regression(6, nonnegative=True)
    candidates = [
        Columns(joints, tuple(rng.normal(size=(60, k)) for _ in joints), np.zeros(k, bool), std)
        for joints, k, std in (
            ((0,), 1, np.array([2.0])),
            ((0, 1), 2, np.array([1.0, 5.0])),
            ((1,), 1, np.array([0.3])),
            ((1,), 2, np.array([4.0, 0.1])),
        )
    ]
    moving = np.ones((60, 2), bool)
    fits = regression.candidates(CandidateBatch.of(candidates, moving))
    assert len(fits) == len(candidates)
    for columns, fit in zip(candidates, fits, strict=True):
        alone = regression.candidate(columns)
        np.testing.assert_allclose(fit.coefficients, alone.coefficients, rtol=1e-9)
        assert fit.gain == pytest.approx(alone.gain)
        assert fit.log_occam_factor == pytest.approx(alone.log_occam_factor)


@given(seed=st.integers(0, 1000), powers=st.tuples(*[st.integers(-6, 6)] * 3), twins=st.booleans())
def test_evidence_of_a_candidate_does_not_depend_on_the_units_of_its_columns(seed, powers, twins):
    """A spring q, q², q³ of a short sliding joint has columns of very different sizes."""
    rng = np.random.default_rng(seed)
    regression, _ = random_regression(seed, nonnegative=False)
    x = rng.normal(size=(60, 3))
    if twins:
        x[:, 2] = x[:, 1]  # the data determine only the sum of their coefficients
    units, std = 10.0 ** np.array(powers), np.array([2.0, 0.5, 3.0])
    signs = np.zeros(3, bool)
    plain = regression.candidate(Columns((0,), (x,), signs, std))
    scaled = regression.candidate(Columns((0,), (x * units,), signs, std / units))
    np.testing.assert_allclose(scaled.coefficients * units, plain.coefficients, rtol=1e-6)
    assert scaled.gain == pytest.approx(plain.gain, rel=1e-6)
    assert scaled.log_occam_factor == pytest.approx(plain.log_occam_factor, rel=1e-6)
    assert plain.log_occam_factor > 0.0
    if twins:
        total = np.hypot(std[1], std[2])
        merged = Columns((0,), (x[:, :2],), signs[:2], np.array([2.0, total]))
        expected = regression.candidate(merged)
        assert plain.gain == pytest.approx(expected.gain, rel=1e-6)
        assert plain.log_occam_factor == pytest.approx(expected.log_occam_factor, rel=1e-6)


@given(seed=st.integers(0, 1000))
def test_minimum_does_not_depend_on_the_problems_solved_before(seed):
    """The active set of one problem is where the search for that of the next begins."""
    rng = np.random.default_rng(seed)
    extra = [rng.normal(size=(60, 2, 6)) + rng.normal(size=(60, 2, 1)) for _ in range(3)]

    def regression() -> JointRegression:
        out, _ = random_regression(seed, nonnegative=True)
        for torque in extra:
            out.add(columns_on_all_joints(torque, np.ones(6, bool), np.full(6, 2.0)))
        return out

    used = regression()
    for left_out in ((), (0,), (1, 2), (3,), (0, 1, 2), (2,)):
        fresh = regression().without(left_out)
        solution = used.without(left_out)
        np.testing.assert_allclose(solution.coefficients, fresh.coefficients, rtol=1e-6, atol=1e-9)
        assert solution.objective == pytest.approx(fresh.objective)
        assert solution.log_determinant == pytest.approx(fresh.log_determinant, abs=1e-6)


def test_torque_of_effects_and_base_add_up():
    regression, columns = random_regression(5, nonnegative=True)
    predicted = regression.torque - regression.residual()
    base = columns[:, :, :3] @ regression.solution.coefficients[:3]
    of_effect = np.zeros(len(regression.solution.coefficients))
    of_effect[regression.slices[0]] = regression.solution.coefficients[regression.slices[0]]
    parts = regression.torque_along(of_effect)
    np.testing.assert_allclose(base + parts, predicted, atol=1e-10)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8])
def test_independent_share_of_a_first_order_process(correlation):
    """An autoregressive process of first order has the share (1 − a)/(1 + a)."""
    noise = np.random.default_rng(0).normal(size=(40_000, 1))
    for k in range(1, len(noise)):
        noise[k] += correlation * noise[k - 1]
    share = independent_share(noise, np.ones(noise.shape, bool))
    assert share == pytest.approx((1.0 - correlation) / (1.0 + correlation), rel=0.15)


@given(seed=st.integers(0, 1000))
def test_eliminated_coefficients_solve_the_same_system(seed):
    """A Schur complement of the normal equations, with some coefficients at zero by their sign."""
    regression, _ = random_regression(seed, nonnegative=True)
    solution = regression.solution
    score = np.random.default_rng(seed).normal(size=(int(solution.active.sum()), 2))
    matrix = solution.information[np.ix_(solution.active, solution.active)]
    np.testing.assert_allclose(
        solution.solve(score), np.linalg.solve(matrix, score), rtol=1e-6, atol=1e-8
    )
    assert solution.log_determinant == pytest.approx(np.linalg.slogdet(matrix)[1], abs=1e-6)


def test_rows_at_standstill_have_no_influence():
    regression, columns = random_regression(4, nonnegative=False)
    moving = np.ones((60, 2), bool)
    moving[::3, 0] = False
    fits = []
    for disturbance in (0.0, 9.0):
        other = JointRegression.of_base(
            regression.torque + disturbance * ~moving,
            moving,
            columns[:, :, :3],
            (np.zeros(3), 0.1 * np.eye(3)),
            np.ones(2),
            0.7,
        )
        other.add(columns_on_all_joints(columns[:, :, 3:], np.zeros(4, bool), np.full(4, 3.0)))
        fits.append(other.solution.coefficients)
    np.testing.assert_allclose(fits[0], fits[1])


@pytest.mark.parametrize("nonnegative", [False, True])
def test_residual_rms_is_that_of_the_residual(nonnegative):
    regression, _ = random_regression(5, nonnegative)
    solution = regression.without([0])
    expected = np.sqrt(np.mean(regression.residual(solution) ** 2, axis=0))
    np.testing.assert_allclose(regression.residual_rms(solution), expected, rtol=1e-9)


@pytest.mark.parametrize("nonnegative", [False, True])
@pytest.mark.parametrize("judged", [np.ones(60, bool), np.arange(60) % 7 > 1])
def test_cross_validation_is_a_refit_without_the_fold(nonnegative, judged):
    regression, columns = random_regression(6, nonnegative)
    folds = [np.arange(60) % 3 == k for k in range(3)]
    errors = regression.cross_validated(
        folds, [(), (0,)], np.zeros(7, bool), slice(0, 0), judged=judged
    )
    expected = np.zeros((3, 2, 2))
    for k, fold in enumerate(folds):
        other = JointRegression.of_base(
            regression.torque[~fold],
            np.ones((40, 2), bool),
            columns[~fold, :, :3],
            (np.zeros(3), 0.1 * np.eye(3)),
            regression.sigma,
            0.7,
        )
        other.add(
            columns_on_all_joints(columns[~fold, :, 3:], np.full(4, nonnegative), np.full(4, 3.0))
        )
        for variant, left_out in enumerate([(), (0,)]):
            x = other.without(left_out).coefficients
            counted = fold & judged
            residual = regression.torque[counted] - columns[counted] @ x
            expected[k, variant] = np.sum(residual**2, axis=0)
    np.testing.assert_allclose(errors, expected, rtol=1e-6)


@pytest.mark.parametrize("change", [None, 7.0])
def test_coefficients_of_a_fold_of_its_own_are_fitted_to_its_errors(change):
    regression, columns = random_regression(6, nonnegative=False)
    fold = np.arange(60) % 3 == 0
    unused = np.arange(7) < 1
    factor = None if change is None else np.array([[change], [1.0]])
    errors = regression.cross_validated([fold, ~fold], [()], unused, slice(0, 1), factor)
    other = JointRegression.of_base(
        regression.torque[~fold],
        np.ones((40, 2), bool),
        columns[~fold, :, 1:3],
        (np.zeros(2), 0.1 * np.eye(2)),
        regression.sigma,
        0.7,
    )
    other.add(columns_on_all_joints(columns[~fold, :, 3:], np.zeros(4, bool), np.full(4, 3.0)))
    left = regression.torque[fold] - columns[fold, :, 1:] @ other.solution.coefficients
    for j in range(2):  # the prior of the coefficient is that of the joint model
        x, prior = columns[fold, j, 0], 0.1 * (change or 1.0)
        c = x @ left[:, j] / (x @ x + prior / regression.weights[j])
        expected = left[:, j] @ left[:, j] - c * (x @ left[:, j])
        np.testing.assert_allclose(errors[0, 0, j], expected, rtol=1e-6)
