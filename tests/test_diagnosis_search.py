"""Search for effects against first principles: marginal likelihoods, noise bounds, estimates."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from diagnosis_cases import EFFECTS, at_joint, diagnose_effect, recordings_of
from scipy import stats
from scipy.interpolate import CubicSpline
from synthetic_recordings import (
    FRICTION_WIDTH,
    NO_KNOWN_COLUMNS,
    perturbed_parameters,
    single_joint_columns,
    single_joint_fold,
    unexpected_columns,
)

from excite._types import FloatArray
from excite.diagnosis import diagnosis, equations, hypothesis, interval, judge, noise, search
from excite.diagnosis.columns import Columns
from excite.diagnosis.diagnosis_file import document
from excite.diagnosis.half import whitened
from excite.effects import EFFECTS_BY_NAME, recorded_motion
from excite.effects.effect import CandidateModel, grid_candidates, variants_within
from excite.recordings import Recording
from excite.robot import dynamics
from excite.robot.samples import Samples


class UprightMotion(types.SimpleNamespace):
    """The attributes of a recorded motion that the candidates of a gravity tilt need."""

    def __init__(self) -> None:
        model = pin.Model()
        super().__init__(fitted_robot=types.SimpleNamespace(model=model))


def test_gain_is_the_ratio_of_marginal_likelihoods():
    rng = np.random.default_rng(0)
    rows, p, k = (40, 30), 3, 2
    gammas, columns = (
        [rng.normal(size=(m, p)) for m in rows],
        [rng.normal(size=(m, k)) for m in rows],
    )
    torques = [
        g @ [1.0, -2.0, 0.5] + c @ [0.4, 0.1] + rng.normal(size=len(g))
        for g, c in zip(gammas, columns, strict=True)
    ]
    known = (1e-2 * np.eye(p), np.zeros(p))  # a proper prior, so that the densities exist
    first, second = (
        single_joint_fold(g, t[:, None], known) for g, t in zip(gammas, torques, strict=True)
    )
    regression = search.design(
        (first, second),
        [CandidateModel("drag", 0, unexpected_columns)],
        lambda _: single_joint_columns(*columns),
    )
    gain = search.trial(regression, [0]).gain

    def evidence(parts: tuple[int, ...], wide: bool) -> float:
        G = np.vstack([np.hstack([gammas[i], columns[i]]) if wide else gammas[i] for i in parts])
        y = np.concatenate([torques[i] for i in parts])
        variance = np.concatenate([np.full(p, 1e4), 1.0 / regression.prior if wide else []])
        return float(
            stats.multivariate_normal(
                np.zeros(len(y)), np.eye(len(y)) + G @ np.diag(variance) @ G.T
            ).logpdf(y)
        )

    def predictive(wide: bool) -> float:
        return 2.0 * evidence((0, 1), wide) - evidence((0,), wide) - evidence((1,), wide)

    assert gain == pytest.approx(predictive(True) - predictive(False), abs=1e-6)
    assert search.trial(regression, []).gain == 0.0


def test_gains_of_all_candidates_equal_those_of_single_trials():
    rng = np.random.default_rng(7)
    gammas, torques = ([rng.normal(size=(m, k)) for m in (60, 50)] for k in (3, 1))
    first, second = (
        single_joint_fold(g, t, (np.eye(3), np.zeros(3)))
        for g, t in zip(gammas, torques, strict=True)
    )
    columns = {width: [rng.normal(size=(m, width)) for m in (60, 50)] for width in (1, 2, 4)}
    columns[5] = [np.column_stack([4.0 * c, c[:, :1]]) for c in columns[4]]  # equal columns
    shapes = [
        CandidateModel("spring", 0, unexpected_columns, {"width": float(width)})
        for width in columns
    ]
    regression = search.design(
        (first, second), shapes, lambda shape: single_joint_columns(*columns[shape.values["width"]])
    )
    for others in ((), (0,), (2, 1)):
        gains, coefficients = search.fits(regression, others)
        for i in set(range(len(regression.shapes))) - set(others):
            trial = search.trial(regression, [*others, i])
            assert gains[i] == pytest.approx(trial.gain, abs=1e-7)
            np.testing.assert_allclose(
                coefficients[i], regression.split(trial.shapes, trial.coefficients)[-1], atol=1e-7
            )


def test_a_replaced_residual_gives_the_results_of_a_measured_one():
    rng = np.random.default_rng(3)
    gammas, columns, torques = ([rng.normal(size=(m, k)) for m in (50, 30)] for k in (3, 2, 1))
    known = (np.eye(3), np.zeros(3))

    def regression_of(torque: list[FloatArray]) -> search.EffectRegression:
        first, second = (
            single_joint_fold(g, t, known) for g, t in zip(gammas, torque, strict=True)
        )
        return search.design(
            (first, second),
            [CandidateModel("drag", 0, unexpected_columns)],
            lambda _: single_joint_columns(*columns),
        )

    other_torques = [c[:, :1] - g[:, :1] for c, g in zip(columns, gammas, strict=True)]
    replaced = search.pretended(
        regression_of(torques), (other_torques[0].ravel(), other_torques[1].ravel())
    )
    direct = regression_of(other_torques)
    assert search.trial(replaced, [0]).gain == pytest.approx(search.trial(direct, [0]).gain)
    np.testing.assert_allclose(
        search.trial(replaced, [0]).coefficients, search.trial(direct, [0]).coefficients
    )
    residual, zero = (
        (other_torques[0].ravel(), other_torques[1].ravel()),
        (np.zeros(50), np.zeros(30)),
    )
    best = next(hypothesis.ranked(direct)).trial.gain
    assert best > 10.0
    by_steps, by_rare_samples = (
        judge.warned(regression_of(torques), *replaced, 0.3, None)
        for replaced in (([residual], zero), ([], residual))
    )
    usual = search.NATS + 0.3 * search.STEPPED
    assert by_steps.bar(0) == pytest.approx(usual + judge.AT_ALL + judge.ARTEFACT_FACTOR * best)
    assert by_rare_samples.bar(0) == pytest.approx(usual + best)


def test_quantization_raises_the_threshold_at_its_joint_and_slightly_elsewhere():
    rng = np.random.default_rng(7)
    orthogonal = [
        np.linalg.qr(rng.normal(size=(m, 5)))[0] * np.sqrt(m) for m in (60, 40)
    ]  # orthogonal columns
    first, second = (
        single_joint_fold(q[:, :2], rng.normal(size=(len(q), 1)), (np.eye(2), np.zeros(2)))
        for q in orthogonal
    )
    shapes = [
        CandidateModel("drag", 0, unexpected_columns),
        CandidateModel("drag", 1, unexpected_columns),
        CandidateModel("spring", 1, unexpected_columns),
    ]
    columns = {
        judge.who(shape): [q[:, 2 + k : 3 + k] for q in orthogonal]
        for k, shape in enumerate(shapes)
    }
    regression = search.design(
        (first, second), shapes, lambda shape: single_joint_columns(*columns[judge.who(shape)])
    )
    drawn = tuple(5.0 * c.ravel() for c in columns["drag", 0])
    warned = judge.warned(regression, [drawn], (np.zeros(60), np.zeros(40)), 0.0, None)
    thresholds = {
        judge.who(shape): warned.bar(i) - search.NATS for i, shape in enumerate(warned.shapes)
    }
    assert thresholds["drag", 0] > thresholds["drag", 1] + 100.0
    assert thresholds["drag", 1] == pytest.approx(judge.AT_ALL)
    assert thresholds["spring", 1] == 0.0
    assert warned.measured.artefact_gain("drag", 2) == pytest.approx(
        thresholds["drag", 0]
    )  # a joint without estimate: as the largest one


def test_friction_has_either_sign_if_a_reversal_coincides_with_a_sample():
    """Samples do not determine how sharply a speed reverses, which determines the sign of friction
    near zero speed."""

    def reversal_error(first: float) -> np.ndarray:
        speed = first + 0.2 * np.arange(-5.0, 6.0) * np.where(np.arange(-5, 6) < 0, 1.0, 0.6)
        track = types.SimpleNamespace(
            samples=types.SimpleNamespace(dq=speed[:, None]),
            n=1,
            widths=np.array([0.005]),
            lowpass=lambda x: x,
        )
        track.fitted_robot = types.SimpleNamespace(
            actuator_parameter=lambda name: {"coulomb": np.array([3.0])}[name]
        )
        return np.asarray(noise.reversal_error(track))[:, 0]

    assert np.abs(reversal_error(0.1)).max() < 1e-9  # between two samples
    assert (
        reversal_error(-0.02)[5] == pytest.approx(6.0, rel=0.01)
        and np.abs(np.delete(reversal_error(-0.02), 5)).max() < 1e-9
    )


def test_remaining_torque_is_the_least_squares_residual():
    rng = np.random.default_rng(5)
    gammas, columns = ([rng.normal(size=(m, k)) for m in (60, 40)] for k in (3, 1))
    torques = [
        rng.normal(size=(len(g), 1)) + 50.0 * c for g, c in zip(gammas, columns, strict=True)
    ]
    first, second = (
        single_joint_fold(g, t, (np.zeros((0, 3)), np.zeros(0)))
        for g, t in zip(gammas, torques, strict=True)
    )
    regression = search.design(
        (first, second),
        [CandidateModel("drag", 0, unexpected_columns)],
        lambda _: single_joint_columns(*columns),
    )
    y = np.concatenate(torques)
    for chosen, wide in (
        ((), gammas),
        ((0,), [np.hstack(pair) for pair in zip(gammas, columns, strict=True)]),
    ):
        G = np.concatenate(wide)
        expected = y - G @ np.linalg.lstsq(G, y, rcond=None)[0]
        np.testing.assert_allclose(search.remaining(regression, chosen), expected, atol=0.05)


def test_quantization_raises_the_threshold_most_for_effects_that_it_mimics(subject):
    train, held_out = (
        dataclasses.replace(r, q=np.round(r.q / 2e-4) * 2e-4) for r in recordings_of(subject, None)
    )
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    assert not result.verdict.chosen and not result.unknown
    thresholds = {
        shape.effect: result.design.bar(i) for i, shape in enumerate(result.design.shapes)
    }
    assert (
        thresholds["stribeck"] > search.NATS + judge.AT_ALL
        and thresholds["base_compliance"] > 16.0 * search.NATS
    )
    assert (
        search.NATS < thresholds["spring"] < search.NATS + search.STEPPED
    )  # no effect that quantisation mimics


def test_a_nonlinear_parameter_is_refined_between_grid_values(monkeypatch):
    rng = np.random.default_rng(1)
    x = np.linspace(0.0, 1.0, 400)
    folds = [
        single_joint_fold(
            np.ones((400, 1)),
            5.0 * x[:, None] ** 1.7 + 0.1 * rng.normal(size=(400, 1)),
            NO_KNOWN_COLUMNS,
            0.1,
        )
    ] * 2

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        column = x[:, None] ** shape.values["power"] / 0.1
        return single_joint_columns(column, column)

    shapes = list(
        grid_candidates(
            (1.0, 1.4, 2.0, 2.8),
            lambda power: CandidateModel("drag", 0, unexpected_columns, {"power": power}),
        )
    )
    regression = search.design((folds[0], folds[1]), shapes, build)
    coarse = max(range(4), key=lambda i: search.trial(regression, [i]).gain)
    finer, (best,) = search.refined(regression, [coarse])
    assert finer.shapes[best].values["power"] == pytest.approx(1.7, abs=0.05)
    assert search.trial(finer, [best]).gain > search.trial(regression, [coarse]).gain
    settled, (last,) = search.refined(finer, [best], sweeps=20)
    monkeypatch.setattr(
        search,
        "_joint_gain",
        lambda small, shape: pytest.fail("an optimised effect is optimised again"),
    )
    assert search.refined(settled, [last])[1] == [last]
    rescaled = search.rescaled(settled, np.array([2.0]))
    with pytest.raises(pytest.fail.Exception):  # another scale requires another optimum
        search.refined(rescaled, [last])


def test_a_value_outside_the_grid_is_reached_by_model_variants():
    x = np.linspace(0.0, 1.0, 400)
    noise_of = np.random.default_rng(1).normal(size=(400, 1))
    folds = [
        single_joint_fold(
            np.ones((400, 1)),
            5.0 * np.exp(-4.0 * x[:, None]) * np.sin(9.0 * x[:, None]) + 0.1 * noise_of,
            NO_KNOWN_COLUMNS,
            0.1,
        )
    ] * 2

    def with_damping(damping: float) -> Callable[[float], CandidateModel]:
        def shape(speed: float) -> CandidateModel:
            dampings = (0.5 * damping, 2.0 * damping)
            return CandidateModel(
                "drag",
                0,
                unexpected_columns,
                {"speed": speed, "damping": damping},
                variants=lambda: variants_within(speed, 1.2, map(with_damping, dampings)),
            )

        return shape

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        column = (
            np.exp(-shape.values["damping"] * x[:, None])
            * np.sin(shape.values["speed"] * x[:, None])
            / 0.1
        )
        return single_joint_columns(column, column)

    regression = search.design(
        (folds[0], folds[1]),
        list(grid_candidates((4.0, 6.0, 10.0, 16.0), with_damping(1.0))),
        build,
    )
    finer, (best,) = search.refined(
        regression,
        [max(range(len(regression.shapes)), key=lambda i: search.trial(regression, [i]).gain)],
    )
    assert finer.shapes[best].values == pytest.approx({"speed": 9.0, "damping": 4.0}, rel=0.05)


def test_options_select_the_effects(subject):
    train, validate = recordings_of(subject, None)
    result = diagnosis.diagnose(
        subject.robot,
        subject.parameters,
        subject.base,
        [train],
        [validate],
        diagnosis.DiagnosisOptions(names=("drag",)),
    )
    assert {shape.effect for shape in result.design.shapes} == {"drag"}


def force_along_x(model: pin.Model, q: FloatArray) -> FloatArray:
    """Return the torque of a unit force along x on the centre of mass of the second link.

    By Pinocchio's Jacobian.
    """
    data = model.createData()
    out = np.empty((len(q), 2))
    for k, pose in enumerate(q):
        pin.computeJointJacobians(model, data, pose)
        J = pin.getJointJacobian(model, data, 2, pin.LOCAL_WORLD_ALIGNED)
        lever = data.oMi[2].rotation @ np.array(model.inertias[2].lever)
        out[k] = (J[:3] - pin.skew(lever) @ J[3:])[0]
    return out


TIME_COURSES = {
    "swelling": lambda u: np.sin(np.pi * u),
    "dragging": lambda u: np.minimum(1.0, 3.0 * u) * (1.0 - 0.8 * u),
}
"""Force over its duration; the second is outside the catalogue."""


@pytest.mark.parametrize("course", list(TIME_COURSES))
def test_a_contact_is_located_in_time(subject, course):
    def pushed(t: FloatArray, q: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
        inside = np.where((t > 4.0) & (t < 6.0), TIME_COURSES[course]((t - 4.0) / 2.0), 0.0)
        return -inside[:, None] * force_along_x(subject.robot.model, q) * 12.0

    result = diagnose_effect(subject, pushed)
    first = result.verdict.chosen[0]
    assert first.effect == "contact" and first.joint == 1
    low, high = result.design.shapes[first.shape].interval
    assert abs(low - 4.0) < 0.6 and abs(high - 6.0) < 0.6
    largest = 12.0 * TIME_COURSES[course](np.linspace(0.0, 1.0, 50)).max()
    assert interval.finding_parameters(result.design, result.verdict, 0)["force"][
        0
    ] == pytest.approx(largest, rel=0.25)
    # a contact in one period does not count as noise
    np.testing.assert_allclose(result.floor, diagnose_effect(subject, None).floor, rtol=0.2)


def test_a_contact_of_half_a_period_is_not_taken_for_noise(subject):
    def pushed(t: FloatArray, q: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
        inside = np.where((t > 3.0) & (t < 8.0), np.sin(np.pi * (t - 3.0) / 5.0), 0.0)
        return -inside[:, None] * force_along_x(subject.robot.model, q) * 30.0

    result, floor = diagnose_effect(subject, pushed), diagnose_effect(subject, None).floor
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == [("contact", 1)]
    assert np.all(result.floor < 4.0 * floor)
    force, std = interval.finding_parameters(result.design, result.verdict, 0)["force"]
    assert force == pytest.approx(30.0, rel=0.1) and abs(force - 30.0) < 2.0 * std


def test_link_jacobians_are_those_of_the_centres_of_mass(subject):
    (track, *_), _ = diagnose_effect(subject, None).motions
    np.testing.assert_allclose(
        track.link_jacobians[::50, 1, 0],
        force_along_x(track.fitted_robot.model, track.coarse_samples.q[::50]),
        atol=1e-9,
    )


def test_a_weak_effect_is_reported_in_the_presence_of_a_strong_one(subject):
    """A weak Stribeck effect and a strong coupling: alone, another velocity fits best, with a
    hundredth of the gain."""

    def both(t: FloatArray, q: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
        out = EFFECTS["stribeck"][0](t, q, dq, tau)
        speed = dq[:, 0] - 0.7 * dq[:, 1]
        out[:, 0] += 3.0 * np.tanh(speed / FRICTION_WIDTH) + 0.5 * speed
        return out

    result = diagnose_effect(subject, both)
    assert {h.effect for h in result.verdict.chosen} == {
        "coupling",
        "stribeck",
    } and not result.unknown


def test_thermal_drift_of_friction_is_reported(subject):
    def warmed(t: FloatArray, q: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
        friction = 1.5 * np.tanh(dq[:, 0] / FRICTION_WIDTH) + 0.4 * dq[:, 0]
        return at_joint(0, friction * np.exp(-t / t[-1] * 2.0))

    first = diagnose_effect(subject, warmed).verdict.chosen[0]
    assert first.effect == "thermal_drift" and first.joint == 0


def test_trusted_parameters_are_not_changed(subject):
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    load = np.zeros(len(psi))
    load[10:14] = 0.4 * np.array([1.0, 0.05, 0.02, 0.1])

    def with_load(recording: Recording) -> Recording:
        added = dynamics.regressor(subject.robot, subject.parameters, derivatives(recording)) @ load
        return dataclasses.replace(recording, tau=recording.tau + added)

    train, held_out = (with_load(recording) for recording in recordings_of(subject, None))
    options = diagnosis.DiagnosisOptions(trusted=dict(enumerate(psi.tolist())))
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out], options
    )
    assert result.verdict.chosen[0].effect == "payload" and result.verdict.chosen[0].joint == 1
    np.testing.assert_allclose(result.motions[0][0].theta, subject.base.matrix @ psi, atol=1e-12)
    assert interval.finding_parameters(result.design, result.verdict, 0)["mass"][
        0
    ] == pytest.approx(0.4, rel=0.1)


def derivatives(recording: Recording) -> Samples:
    spline = CubicSpline(recording.t, recording.q)
    return Samples(recording.q, spline(recording.t, 1), spline(recording.t, 2))


@pytest.mark.parametrize(("roll", "pitch"), [(0.004, -0.006), (0.2, -0.3), (-0.3, 0.2)])
def test_the_tilt_of_the_base_is_estimated_with_its_sign(subject, roll, pitch):
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))

    def tilted(recording: Recording) -> Recording:
        body = recorded_motion.fitted_robot(subject.robot, subject.parameters, psi)
        rotated = body.model.copy()
        rotated.gravity.linear = pin.rpy.rpyToMatrix(roll, pitch, 0.0).T @ rotated.gravity.linear
        torque = [
            [pin.rnea(m, m.createData(), q, 0.0 * q, 0.0 * q) for q in recording.q]
            for m in (rotated, body.model)
        ]
        return dataclasses.replace(
            recording, tau=recording.tau + np.subtract(*map(np.array, torque))
        )

    train, held_out = (tilted(recording) for recording in recordings_of(subject, None))
    options = diagnosis.DiagnosisOptions(
        trusted=dict(enumerate(psi.tolist())), names=("gravity_tilt",)
    )
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out], options
    )
    values = interval.finding_parameters(result.design, result.verdict, 0)
    # a planar arm observes the tilt in its plane and the gravity component in that plane
    assert set(values) == {"pitch"}
    assert document(result)["findings"][0]["not_shown"] == ["roll"]
    assert values["pitch"][0] == pytest.approx(
        np.arctan(np.tan(pitch) / np.cos(roll)), rel=0.1 if abs(pitch) < 0.1 else 0.01
    )
    assert len(result.verdict.named) == 1 and np.all(result.after < 1.3 * result.floor)


def test_a_tilt_keeps_the_magnitude_of_gravity():
    large = next(
        shape
        for shape in EFFECTS_BY_NAME["gravity_tilt"].candidates([UprightMotion()])
        if shape.values["large"]
    )
    is_plausible = large.is_plausible
    roll, pitch = 0.3, -0.2
    gx, gy, gz = pin.rpy.rpyToMatrix(roll, pitch, 0.0).T @ [0.0, 0.0, -1.0]
    exact = np.array([-gy, gx, -1.0 - gz])
    assert (
        is_plausible(exact)
        and not is_plausible(exact + np.array([0.0, 0.0, 0.2]))
        and not is_plausible(exact - np.array([0.0, 0.0, 0.3]))
    )
    assert large.parameters(exact) == pytest.approx({"roll": roll, "pitch": pitch})


def test_excluded_rows_have_no_influence():
    rng = np.random.default_rng(7)
    gamma, column, torque = (
        rng.normal(size=(60, 3)),
        rng.normal(size=(60, 1)),
        rng.normal(size=(60, 1)),
    )
    counts = np.arange(60) % 4 > 0

    def regression_of(
        g: FloatArray, c: FloatArray, t: FloatArray, included: FloatArray
    ) -> search.EffectRegression:
        fold = whitened(
            [g[:, None, :]], [t], [included[:, None]], np.ones(1), (np.zeros((0, 3)), np.zeros(0))
        )
        return search.design(
            (fold, fold),
            [CandidateModel("drag", 0, unexpected_columns)],
            lambda _: single_joint_columns(c * included[:, None], c * included[:, None]),
        )

    part = regression_of(gamma, column, torque + 9.0 * ~counts[:, None], counts)
    short = regression_of(gamma[counts], column[counts], torque[counts], counts[counts])
    np.testing.assert_allclose(
        search.level(part, [0]), search.level(short, [0]), rtol=1e-3
    )  # the prior's width depends on all rows
    np.testing.assert_allclose(search.level(part, []), search.level(short, []))
    assert search.level(part, []) < 0.5 * np.mean((torque + 9.0 * ~counts[:, None]) ** 2)


def test_columns_of_candidates_are_cached_within_a_memory_limit(subject, monkeypatch):
    motion, calls = diagnose_effect(subject, None).motions[0][0], list[str]()

    def add(t: recorded_motion.RecordedMotion, s: CandidateModel) -> FloatArray:
        calls.append(s.effect)
        return np.ones((len(t), t.n, 1)) * s.values["x"]

    first, unlisted, zero = (CandidateModel("drag", 0, add, {"x": x}) for x in (1.0, 2.0, 0.0))
    build = equations.builder(([motion], [motion]), np.ones(motion.n), [first, zero])
    assert (
        build(first) is build(first)
        and build(zero) is None
        and build(zero) is None
        and len(calls) == 4
    )  # two folds each
    assert build(unlisted) is not build(unlisted) and len(calls) == 8
    monkeypatch.setattr(equations, "ROOM", 0)
    build = equations.builder(([motion], [motion]), np.ones(motion.n), [first])
    assert build(first) is not build(first)
