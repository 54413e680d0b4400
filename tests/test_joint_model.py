"""Joint model: regression with sign constraints, weights, and effects of simulated robots."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis_cases import at_joint, maxwell_slip_force, recordings_of
from hypothesis import given
from hypothesis import strategies as st

from excite.diagnosis import joint_model, posterior
from excite.diagnosis.joint_model import JointModel
from excite.diagnosis.regression import Columns, JointRegression, independent_share, rms
from excite.effects import recorded_motion
from excite.identification import identification, segments

HERTZ = 20.0


def random_regression(seed: int, nonnegative: bool) -> tuple[JointRegression, np.ndarray]:
    """Return a regression of two joints with random columns, and all its columns."""
    rng = np.random.default_rng(seed)
    base, extra = rng.normal(size=(60, 2, 3)), rng.normal(size=(60, 2, 4))
    torque = rng.normal(size=(60, 2))
    prior = np.zeros(3), 0.1 * np.eye(3)
    regression = JointRegression.of_base(
        torque, np.ones((60, 2), bool), base, prior, np.array([0.5, 2.0]), 0.7
    )
    regression.add(Columns.of(extra, np.full(4, nonnegative), np.full(4, 3.0)))
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


def test_candidate_gains_what_the_refit_gains():
    regression, _ = random_regression(3, nonnegative=False)
    columns = Columns.of(
        np.random.default_rng(8).normal(size=(60, 2, 2)), np.zeros(2, bool), np.full(2, 5.0)
    )
    before = regression.solution.objective
    fit = regression.candidate(columns)
    effect = regression.add(columns)
    assert before - regression.solution.objective == pytest.approx(fit.gain, rel=1e-6)
    np.testing.assert_allclose(
        regression.solution.coefficients[regression.slices[effect]], fit.coefficients, rtol=1e-6
    )
    assert regression.without([effect]).objective == pytest.approx(before)


def test_torque_of_effects_and_base_add_up():
    regression, columns = random_regression(5, nonnegative=True)
    predicted = regression.torque - regression.residual()
    base = columns[:, :, :3] @ regression.solution.coefficients[:3]
    parts = np.column_stack([regression.torque_of(0, j) for j in range(2)])
    np.testing.assert_allclose(base + parts, predicted, atol=1e-10)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8])
def test_independent_share_of_a_first_order_process(correlation):
    """An autoregressive process of first order has the share (1 − a)/(1 + a)."""
    noise = np.random.default_rng(0).normal(size=(40_000, 1))
    for k in range(1, len(noise)):
        noise[k] += correlation * noise[k - 1]
    share = independent_share(noise, np.ones(noise.shape, bool))
    assert share == pytest.approx((1.0 - correlation) / (1.0 + correlation), rel=0.15)


def fit_of(subject, effect) -> tuple[JointModel, np.ndarray]:
    """Fit the joint model of a two-link robot; return it and the held-out RMSE of both models."""
    train, held_out = recordings_of(subject, effect)
    options = identification.IdentificationOptions(band=HERTZ)
    identified = identification.identify(
        subject.robot, subject.parameters, subject.base, [train], (), options
    )
    robot = recorded_motion.fitted_robot(subject.robot, subject.parameters, identified.psi)
    motions = [
        recorded_motion.recorded_motions(
            identified.model,
            robot,
            subject.base.matrix @ identified.psi,
            list(segments.extract_segments([recording], average=False)),
            HERTZ,
        )
        for recording in (train, held_out)
    ]
    model = joint_model.fit(identified, motions[0])
    moving = np.concatenate([motion.moving for motion in motions[1]])
    residuals = joint_model.held_out_residuals(identified, model, motions[1])
    return model, np.array([rms(residual, moving) for residual in residuals])


def needed_effects(model: JointModel) -> dict[tuple[str, int | None], dict[str, float]]:
    """Return the needed effects whose absence is worth 0.3 of the noise, and their parameters."""
    left_out, evidence = posterior.select(model)
    return {
        (e.name, e.joint): model.models[e.effects[0]].parameters(model.coefficients(e.effects[0]))
        for e in evidence
        if not set(e.effects) <= left_out and (e.severity / model.regression.sigma).max() > 0.3
    }


def test_nothing_is_needed_where_nothing_is_missing(subject):
    model, (before, after) = fit_of(subject, None)
    assert needed_effects(model) == {}
    assert (after < 1.1 * before).all()


def test_several_frictions_at_both_joints_are_found_at_once(subject):
    reaches = np.array([0.01, 0.02, 0.04])

    def frictions(t, q, dq, torque):
        stribeck = at_joint(0, 2.0 * np.tanh(dq[:, 0] / 5e-3) * np.exp(-np.abs(dq[:, 0]) / 0.2))
        slip = at_joint(1, 2.0 * maxwell_slip_force(q[:, 1], reaches))
        sign = np.tanh(dq / 5e-3)
        load = at_joint(0, 0.1 * np.abs(torque[:, 0]) * sign[:, 0])
        return stribeck + slip + load

    model, (before, after) = fit_of(subject, frictions)
    needed = needed_effects(model)
    assert {("stribeck", 0), ("hysteresis", 1), ("load_friction", 0)} <= set(needed)
    assert len(needed) <= 4
    assert needed["stribeck", 0]["amplitude"] == pytest.approx(2.0, rel=0.3)
    assert needed["load_friction", 0]["mu"] == pytest.approx(0.1, rel=0.25)
    assert (after < 0.5 * before).all()


def test_delay_moves_into_the_time_stamps(subject):
    def delayed(t, q, dq, torque):
        return np.column_stack([np.interp(t - 0.003, t, x) for x in torque.T]) - torque

    model, _ = fit_of(subject, delayed)
    np.testing.assert_allclose(model.delays, 0.003, rtol=0.1)


def test_ripple_is_found_at_its_order(subject):
    def ripple(t, q, dq, torque):
        return at_joint(1, 0.8 * np.cos(17.3 * q[:, 1] + 0.4))

    model, _ = fit_of(subject, ripple)
    needed = needed_effects(model)
    assert set(needed) == {("torque_ripple", 1)}
    assert needed["torque_ripple", 1]["order"] == pytest.approx(17.3, rel=5e-3)
    assert needed["torque_ripple", 1]["amplitude"] == pytest.approx(0.8, rel=0.1)
