"""Estimators of base parameters against known truth: values, covariances, intervals, widths."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import signal
from scipy.interpolate import CubicSpline
from synthetic_recordings import (
    FRICTION_WIDTH,
    PERIOD,
    perturbed_parameters,
    random_fourier,
    rnea_torque,
    synthetic_recording,
    two_link_model,
)

from excite._types import FloatArray
from excite.identification import (
    consistency,
    estimators,
    friction_width,
    identification,
    regression,
    segments,
    torque_delay,
)
from excite.identification.estimators import Method
from excite.identification.regression import IdentificationModel, TorqueEquations
from excite.recordings import Recording
from excite.trajectory.fourier import FourierSeries


@pytest.fixture(scope="module")
def model() -> IdentificationModel:
    return two_link_model()


@pytest.fixture(scope="module")
def truth(model: IdentificationModel) -> FloatArray:
    """ψ of a robot that differs from the URDF by about 10 %, with friction."""
    return perturbed_parameters(model.parameters, np.random.default_rng(4))


def equations_of(
    model: IdentificationModel, recording: Recording, hertz: float = 20.0
) -> TorqueEquations:
    return regression.build_equations(model, segments.extract_segments([recording]), hertz)


@pytest.mark.parametrize("method", [Method.OLS, Method.WLS, Method.FULL, Method.HUBER])
def test_estimators_recover_the_truth_without_noise(model, truth, method):
    recording = synthetic_recording(model, truth, random_fourier(2), 4, 1e-6)
    estimate = estimators.estimate(equations_of(model, recording), method)
    # the remaining error is aliasing of the friction steps at the recording's rate
    assert np.abs(estimate.theta - model.base.matrix @ truth).max() < 2e-2


def test_ordinary_least_squares_agrees_with_lstsq(model, truth):
    equations = equations_of(model, synthetic_recording(model, truth, random_fourier(2), 4, 0.3))
    estimate = estimators.estimate(equations, Method.OLS)
    stacked = equations.regressor.reshape(-1, model.base.count)
    expected = np.linalg.lstsq(stacked, equations.torque.ravel(), rcond=None)[0]
    assert np.allclose(estimate.theta, expected, rtol=1e-8)
    weighted = estimators.estimate(equations, Method.WLS)
    np.testing.assert_allclose(estimate.noise, weighted.noise, rtol=0.05)


def test_white_noise_gives_the_covariance_of_weighted_least_squares(model, truth):
    equations = equations_of(model, synthetic_recording(model, truth, random_fourier(2), 40, 0.3))
    estimate = estimators.estimate(equations, Method.WLS)
    white = equations.regressor / estimate.noise[:, None]
    expected = np.linalg.inv(np.einsum("tip,tiq->pq", white, white))
    assert np.allclose(np.sqrt(np.diag(estimate.covariance) / np.diag(expected)), 1.0, atol=0.25)
    information = estimate.information_root.T @ estimate.information_root
    assert np.allclose(np.linalg.inv(information), estimate.covariance, rtol=1e-6)


@pytest.mark.parametrize("method", [Method.WLS, Method.IV])
@pytest.mark.parametrize(
    "mixture",
    [
        [[0.0, 0.0], [0.0, 1.0]],  # a joint at rest, or a width at its lower bound: a zero column
        [[1.0, 1e6, 0.0], [0.0, 0.0, 1.0]],  # two columns in proportion, of very different units
        [[0.0, 1e-12, 1.0, 1.0], [0.0, 0.0, 1.0, -1.0]],
        [[0.0], [0.0]],
    ],
)
def test_information_is_the_inverse_covariance_with_dependent_nuisances(
    model, truth, mixture, method
):
    equations = equations_of(model, synthetic_recording(model, truth, random_fourier(2), 4, 0.3))
    slopes = np.zeros((len(equations), 2, 2))
    slopes[:, [0, 1], [0, 1]] = equations.slopes
    estimate = estimators.estimate(
        equations, method, instruments=equations.regressor, nuisance=slopes @ mixture
    )
    information = estimate.information_root.T @ estimate.information_root
    inverse = np.linalg.inv(information)
    assert np.allclose(inverse, estimate.covariance, rtol=1e-6, atol=1e-6 * np.diag(inverse).min())


def test_outliers_hardly_change_the_robust_estimate(model, truth):
    recording = synthetic_recording(
        model, truth, random_fourier(2), 4, 0.1, period=None, periodic=None
    )
    disturbed_torque = recording.tau.copy()
    disturbed_torque[600:700] += 40.0
    disturbed = dataclasses.replace(recording, tau=disturbed_torque)
    exact = model.base.matrix @ truth
    weighted, robust = (
        estimators.estimate(equations_of(model, disturbed), method)
        for method in (Method.WLS, Method.HUBER)
    )
    deviation = np.sqrt(np.diag(estimators.estimate(equations_of(model, recording)).covariance))
    errors = [np.abs((estimate.theta - exact) / deviation).max() for estimate in (weighted, robust)]
    assert errors[1] < 0.3 * errors[0]
    assert robust.outliers > 0.01 and weighted.outliers == 0.0


def held_joint(
    model: IdentificationModel, truth: FloatArray, torque: float, noise: float = 0.1
) -> Recording:
    """Recording in which joint 2 stands still and its recorded torque is constant."""
    fourier = random_fourier(2)
    t = np.arange(1201) / 100.0
    motion = fourier.samples(t)
    q, dq, ddq = motion.q.copy(), motion.dq.copy(), motion.ddq.copy()
    q[:, 1], dq[:, 1], ddq[:, 1] = 0.3, 0.0, 0.0
    tau = rnea_torque(model, truth, q, dq, ddq)
    tau[:, 0] += noise * np.random.default_rng(5).normal(size=len(t))
    tau[:, 1] = torque
    return Recording("held.csv", model.robot.joints, t, q, tau=tau, row_times=t)


@pytest.mark.parametrize("torque", [0.0, 7.0])
@pytest.mark.parametrize("method", [Method.OLS, Method.WLS, Method.FULL, Method.HUBER])
def test_constant_torque_of_a_joint_at_rest_has_finite_weight(model, truth, method, torque):
    equations = equations_of(model, held_joint(model, truth, torque))
    estimate = estimators.estimate(equations, method)
    residual = equations.torque - equations.predicted(estimate.theta)
    assert np.abs(residual[:, 1]).max() < 1e-2
    assert 0.05 < estimate.noise[0] < 0.2
    whitened = estimators.whiten(residual, estimate.noise_root)
    assert np.abs(whitened).max() < 1e4
    scale = np.linalg.norm(estimate.information_root, axis=0).max()
    assert np.isfinite(scale) and scale < 1e9


@pytest.mark.parametrize("torque", [0.0, 7.0])
def test_robot_with_constant_torque_of_a_joint_at_rest_is_identified(model, truth, torque):
    identified = identification.identify(
        model.robot, model.parameters, model.base, [held_joint(model, truth, torque)]
    )
    assert consistency.is_consistent(model.parameters, identified.psi)
    assert identified.fits[0].error()[0] < 0.5


def autoregressive_noise(
    rng: np.random.Generator, shape: tuple[int, int], pole: float
) -> FloatArray:
    """Noise of unit variance; white for pole 0."""
    out = rng.normal(size=shape)
    for t in range(1, len(out)):
        out[t] = pole * out[t - 1] + np.sqrt(1 - pole**2) * out[t]
    return out


@pytest.mark.parametrize("pole", [0.0, 0.97])
def test_95_percent_intervals_cover_the_truth_under_white_and_coloured_noise(model, truth, pole):
    exact, covered = model.base.matrix @ truth, []
    clean = synthetic_recording(model, truth, random_fourier(2), 5, 0.0)
    rng = np.random.default_rng(8)
    for _ in range(40):
        noise = 0.5 * autoregressive_noise(rng, clean.tau.shape, pole)
        equations = equations_of(model, dataclasses.replace(clean, tau=clean.tau + noise))
        nuisance = np.zeros((len(equations), 2, 2))
        nuisance[:, [0, 1], [0, 1]] = equations.slopes
        estimate = estimators.estimate(equations, nuisance=nuisance)
        half = estimators.interval_half_widths(estimate, np.eye(len(exact)))
        covered.append(np.abs(estimate.theta - exact) <= half)
    assert 0.91 < np.mean(covered) < 0.985


def test_parameters_that_the_motion_does_not_excite_have_no_interval(model, truth):
    fourier = random_fourier(2)
    resting_joint = np.array([[1.0], [0.0]])
    fourier = FourierSeries(
        fourier.sine * resting_joint, fourier.cosine * resting_joint, fourier.offset, PERIOD
    )
    estimate = estimators.estimate(
        equations_of(model, synthetic_recording(model, truth, fourier, 4, 0.1))
    )
    names = [model.parameters.names[i] for i in model.base.independent]
    variances = np.diag(estimate.covariance)
    hidden = {name for name, value in zip(names, variances, strict=True) if not np.isfinite(value)}
    assert {"Fv2", "Fc2"} <= hidden and "Fv1" not in hidden
    half = estimators.interval_half_widths(estimate, np.eye(len(names)))
    assert np.isinf(half[names.index("Fv2")]) and np.isfinite(half[names.index("Fv1")])


def test_friction_widths_are_estimated(model, truth):
    parts = list(
        segments.extract_segments([synthetic_recording(model, truth, random_fourier(2), 4, 0.02)])
    )
    wide = dataclasses.replace(model, widths=np.full(2, 0.02))
    fitted = friction_width.fit_widths(wide, regression.build_equations(wide, parts, 20.0), parts)
    assert np.all(np.abs(np.log(fitted.widths / FRICTION_WIDTH)) < np.log(1.6))


@pytest.mark.parametrize("rates", [(1000.0, 100.0), (100.0, 1000.0)])
def test_the_delay_of_recordings_of_different_rates_is_found(model, truth, rates):
    """Each recording has a torque that is 4 ms late."""
    fourier, late = random_fourier(2), 4e-3
    parts = []
    for rate in rates:
        recording = synthetic_recording(model, truth, fourier, 2, 0.05, rate)
        torque = CubicSpline(recording.t, recording.torque)(recording.t - late)
        parts.append(dataclasses.replace(recording, tau=torque, source=f"{rate:g}.csv"))
    extracted = segments.extract_segments(parts)
    equations = regression.build_equations(model, extracted, 20.0)
    delay = torque_delay.estimate_delay(equations, estimators.estimate(equations))
    np.testing.assert_allclose(delay.seconds, late, rtol=0.05)


def test_the_standard_error_of_a_delay_holds_under_coloured_noise(model, truth):
    errors = []
    for seed in range(12):
        recording = synthetic_recording(model, truth, random_fourier(2, seed), 2, 0.0, 250.0)
        white = np.random.default_rng(seed).normal(size=recording.torque.shape)
        noise = signal.lfilter([0.2], [1.0, -0.98], white, axis=0)
        noisy = dataclasses.replace(recording, tau=recording.torque + noise)
        equations = equations_of(model, noisy)
        delay = torque_delay.estimate_delay(equations, estimators.estimate(equations))
        errors.append(delay.seconds / delay.deviation)
    assert 0.5 < float(np.std(errors)) < 1.5
