"""The search of a diagnosis against first principles: marginal likelihoods, noise floors, wind-up,
and what joins the model."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
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
from test_diagnosis import PLANTED, found, on, recordings_of

from excite.diagnosis import diagnosis, equations, hypothesis, interval, judge, noise, search
from excite.diagnosis.columns import Columns
from excite.diagnosis.diagnosis_file import document
from excite.diagnosis.half import whitened
from excite.effects import EFFECTS_BY_NAME, recorded_motion
from excite.effects.effect import CandidateModel, grid_candidates, variants_within
from excite.recordings import Recording
from excite.robot import dynamics
from excite.robot.samples import Samples

Array = np.ndarray


class Upright(types.SimpleNamespace):
    """As much of a track as gravity's shapes ask for."""

    def __init__(self) -> None:
        model = pin.Model()
        super().__init__(fitted_robot=types.SimpleNamespace(model=model))


def test_the_gain_is_the_quotient_of_marginal_likelihoods():
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
    known = (1e-2 * np.eye(p), np.zeros(p))  # a proper prior, so that densities exist
    first, second = (
        single_joint_fold(g, t[:, None], known) for g, t in zip(gammas, torques, strict=True)
    )
    one = search.design(
        (first, second),
        [CandidateModel("drag", 0, unexpected_columns)],
        lambda _: single_joint_columns(*columns),
    )
    gain = search.trial(one, [0]).gain

    def evidence(parts: tuple[int, ...], wide: bool) -> float:
        G = np.vstack([np.hstack([gammas[i], columns[i]]) if wide else gammas[i] for i in parts])
        y = np.concatenate([torques[i] for i in parts])
        variance = np.concatenate([np.full(p, 1e4), 1.0 / one.prior if wide else []])
        return float(
            stats.multivariate_normal(
                np.zeros(len(y)), np.eye(len(y)) + G @ np.diag(variance) @ G.T
            ).logpdf(y)
        )

    def predictive(wide: bool) -> float:
        return 2.0 * evidence((0, 1), wide) - evidence((0,), wide) - evidence((1,), wide)

    assert gain == pytest.approx(predictive(True) - predictive(False), abs=1e-6)
    assert search.trial(one, []).gain == 0.0


def test_all_gains_at_once_are_those_of_one_after_the_other():
    rng = np.random.default_rng(7)
    gammas, torques = ([rng.normal(size=(m, k)) for m in (60, 50)] for k in (3, 1))
    first, second = (
        single_joint_fold(g, t, (np.eye(3), np.zeros(3)))
        for g, t in zip(gammas, torques, strict=True)
    )
    columns = {width: [rng.normal(size=(m, width)) for m in (60, 50)] for width in (1, 2, 4)}
    columns[5] = [np.column_stack([4.0 * c, c[:, :1]]) for c in columns[4]]  # the same once more
    shapes = [
        CandidateModel("spring", 0, unexpected_columns, {"width": float(width)})
        for width in columns
    ]
    one = search.design(
        (first, second), shapes, lambda shape: single_joint_columns(*columns[shape.values["width"]])
    )
    for beside_ in ((), (0,), (2, 1)):
        told, own = search.fits(one, beside_)
        for i in set(range(len(one.shapes))) - set(beside_):
            alone = search.trial(one, [*beside_, i])
            assert told[i] == pytest.approx(alone.gain, abs=1e-7)
            np.testing.assert_allclose(
                own[i], one.split(alone.shapes, alone.coefficients)[-1], atol=1e-7
            )


def test_another_residual_is_judged_as_if_it_had_been_measured():
    rng = np.random.default_rng(3)
    gammas, columns, torques = ([rng.normal(size=(m, k)) for m in (50, 30)] for k in (3, 2, 1))
    known = (np.eye(3), np.zeros(3))

    def designed(own: list[Array]) -> search.EffectRegression:
        first, second = (single_joint_fold(g, t, known) for g, t in zip(gammas, own, strict=True))
        return search.design(
            (first, second),
            [CandidateModel("drag", 0, unexpected_columns)],
            lambda _: single_joint_columns(*columns),
        )

    others = [c[:, :1] - g[:, :1] for c, g in zip(columns, gammas, strict=True)]
    told = search.pretended(designed(torques), (others[0].ravel(), others[1].ravel()))
    direct = designed(others)
    assert search.trial(told, [0]).gain == pytest.approx(search.trial(direct, [0]).gain)
    np.testing.assert_allclose(
        search.trial(told, [0]).coefficients, search.trial(direct, [0]).coefficients
    )
    residual, quiet = (others[0].ravel(), others[1].ravel()), (np.zeros(50), np.zeros(30))
    best = next(hypothesis.ranked(direct)).trial.gain
    assert best > 10.0
    by_steps, by_rare_samples = (
        judge.warned(designed(torques), *told, 0.3, None)
        for told in (([residual], quiet), ([], residual))
    )
    usual = search.NATS + 0.3 * search.STEPPED
    assert by_steps.bar(0) == pytest.approx(usual + judge.AT_ALL + judge.ARTEFACT_FACTOR * best)
    assert by_rare_samples.bar(0) == pytest.approx(usual + best)


def test_what_an_encoder_feigns_at_one_joint_raises_the_bar_there_and_a_little_elsewhere():
    rng = np.random.default_rng(7)
    apart = [
        np.linalg.qr(rng.normal(size=(m, 5)))[0] * np.sqrt(m) for m in (60, 40)
    ]  # what one gains, no other does
    first, second = (
        single_joint_fold(q[:, :2], rng.normal(size=(len(q), 1)), (np.eye(2), np.zeros(2)))
        for q in apart
    )
    shapes = [
        CandidateModel("drag", 0, unexpected_columns),
        CandidateModel("drag", 1, unexpected_columns),
        CandidateModel("spring", 1, unexpected_columns),
    ]
    columns = {
        judge.who(shape): [q[:, 2 + k : 3 + k] for q in apart] for k, shape in enumerate(shapes)
    }
    one = search.design(
        (first, second), shapes, lambda shape: single_joint_columns(*columns[judge.who(shape)])
    )
    drawn = tuple(5.0 * c.ravel() for c in columns["drag", 0])
    warned = judge.warned(one, [drawn], (np.zeros(60), np.zeros(40)), 0.0, None)  # type: ignore[list-item]
    bars = {judge.who(shape): warned.bar(i) - search.NATS for i, shape in enumerate(warned.shapes)}
    assert bars["drag", 0] > bars["drag", 1] + 100.0
    assert bars["drag", 1] == pytest.approx(judge.AT_ALL)
    assert bars["spring", 1] == 0.0
    assert warned.measured.artefact_gain("drag", 2) == pytest.approx(
        bars["drag", 0]
    )  # a joint not looked at: as where it is most


def test_a_reversal_that_falls_on_a_sample_may_have_either_sign():
    """Friction makes a speed turn where it reverses: how sharply, samples cannot tell, and near
    zero that decides friction's sign."""

    def left(first: float) -> np.ndarray:
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
        return np.asarray(noise._reversal_error(track))[:, 0]

    assert np.abs(left(0.1)).max() < 1e-9  # between samples
    assert (
        left(-0.02)[5] == pytest.approx(6.0, rel=0.01)
        and np.abs(np.delete(left(-0.02), 5)).max() < 1e-9
    )


def test_what_remains_is_what_least_squares_leaves():
    rng = np.random.default_rng(5)
    gammas, columns = ([rng.normal(size=(m, k)) for m in (60, 40)] for k in (3, 1))
    torques = [
        rng.normal(size=(len(g), 1)) + 50.0 * c for g, c in zip(gammas, columns, strict=True)
    ]
    first, second = (
        single_joint_fold(g, t, (np.zeros((0, 3)), np.zeros(0)))
        for g, t in zip(gammas, torques, strict=True)
    )
    one = search.design(
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
        np.testing.assert_allclose(search.remaining(one, chosen), expected, atol=0.05)


def test_an_encoders_steps_raise_the_bar_most_for_what_they_look_like(subject):
    train, held_out = (
        dataclasses.replace(r, q=np.round(r.q / 2e-4) * 2e-4) for r in recordings_of(subject, None)
    )
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    assert not result.verdict.chosen and not result.unknown
    bars = {shape.effect: result.design.bar(i) for i, shape in enumerate(result.design.shapes)}
    assert (
        bars["stribeck"] > search.NATS + judge.AT_ALL
        and bars["base_compliance"] > 16.0 * search.NATS
    )
    assert (
        search.NATS < bars["spring"] < search.NATS + search.STEPPED
    )  # nothing that any steps feign


def test_a_grid_is_left_for_the_value_between_its_neighbours(monkeypatch):
    rng = np.random.default_rng(1)
    x = np.linspace(0.0, 1.0, 400)
    halves = [
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
    one = search.design((halves[0], halves[1]), shapes, build)
    coarse = max(range(4), key=lambda i: search.trial(one, [i]).gain)
    finer, (best,) = search.refined(one, [coarse])
    assert finer.shapes[best].values["power"] == pytest.approx(1.7, abs=0.05)
    assert search.trial(finer, [best]).gain > search.trial(one, [coarse]).gain
    settled, (last,) = search.refined(finer, [best], sweeps=20)
    monkeypatch.setattr(
        search, "_joint_gain", lambda small, shape: pytest.fail("what was tuned is tuned again")
    )
    assert search.refined(settled, [last])[1] == [last]
    louder = search.rescaled(settled, np.array([2.0]))
    with pytest.raises(pytest.fail.Exception):  # over another scale it may be another
        search.refined(louder, [last])


def test_a_value_that_no_grid_has_is_found_from_kin_to_kin():
    x = np.linspace(0.0, 1.0, 400)
    noise_of = np.random.default_rng(1).normal(size=(400, 1))
    halves = [
        single_joint_fold(
            np.ones((400, 1)),
            5.0 * np.exp(-4.0 * x[:, None]) * np.sin(9.0 * x[:, None]) + 0.1 * noise_of,
            NO_KNOWN_COLUMNS,
            0.1,
        )
    ] * 2

    def rung(damping: float) -> Callable[[float], CandidateModel]:
        def shape(speed: float) -> CandidateModel:
            near = (0.5 * damping, 2.0 * damping)
            return CandidateModel(
                "drag",
                0,
                unexpected_columns,
                {"speed": speed, "damping": damping},
                variants=lambda: variants_within(speed, 1.2, map(rung, near)),
            )

        return shape

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        column = (
            np.exp(-shape.values["damping"] * x[:, None])
            * np.sin(shape.values["speed"] * x[:, None])
            / 0.1
        )
        return single_joint_columns(column, column)

    one = search.design(
        (halves[0], halves[1]), list(grid_candidates((4.0, 6.0, 10.0, 16.0), rung(1.0))), build
    )
    finer, (best,) = search.refined(
        one, [max(range(len(one.shapes)), key=lambda i: search.trial(one, [i]).gain)]
    )
    assert finer.shapes[best].values == pytest.approx({"speed": 9.0, "damping": 4.0}, rel=0.05)


def test_options_name_what_is_looked_for(subject):
    train, validate = recordings_of(subject, None)
    done = diagnosis.diagnose(
        subject.robot,
        subject.parameters,
        subject.base,
        [train],
        [validate],
        diagnosis.DiagnosisOptions(names=("drag",)),
    )
    assert {shape.effect for shape in done.design.shapes} == {"drag"}


def force_along_x(model: pin.Model, q: Array) -> Array:
    """Torque of a unit force along x on the centre of the second of two links in a vertical plane,
    by Pinocchio's Jacobian."""
    data = model.createData()
    out = np.empty((len(q), 2))
    for k, place in enumerate(q):
        pin.computeJointJacobians(model, data, place)
        J = pin.getJointJacobian(model, data, 2, pin.LOCAL_WORLD_ALIGNED)
        arm = data.oMi[2].rotation @ np.array(model.inertias[2].lever)
        out[k] = (J[:3] - pin.skew(arm) @ J[3:])[0]
    return out


COURSES = {
    "swelling": lambda u: np.sin(np.pi * u),
    "dragging": lambda u: np.minimum(1.0, 3.0 * u) * (1.0 - 0.8 * u),
}
"""Of a force, over the time it lasts; the second is none of the catalogue's plain ones."""


@pytest.mark.parametrize("course", list(COURSES))
def test_a_push_is_found_in_its_time(subject, course):
    def pushed(t: Array, q: Array, dq: Array, tau: Array) -> Array:
        inside = np.where((t > 4.0) & (t < 6.0), COURSES[course]((t - 4.0) / 2.0), 0.0)
        return -inside[:, None] * force_along_x(subject.robot.model, q) * 12.0

    result = found(subject, pushed)
    first = result.verdict.chosen[0]
    assert first.effect == "contact" and first.joint == 1
    low, high = result.design.shapes[first.shape].interval
    assert abs(low - 4.0) < 0.6 and abs(high - 6.0) < 0.6
    largest = 12.0 * COURSES[course](np.linspace(0.0, 1.0, 50)).max()
    assert interval.finding_parameters(result.design, result.verdict, 0)["force"][
        0
    ] == pytest.approx(largest, rel=0.25)
    # what touches the robot in one period is not noise
    np.testing.assert_allclose(result.floor, found(subject, None).floor, rtol=0.2)


def test_a_push_that_lasts_for_half_a_period_is_no_noise_either(subject):
    def pushed(t: Array, q: Array, dq: Array, tau: Array) -> Array:
        inside = np.where((t > 3.0) & (t < 8.0), np.sin(np.pi * (t - 3.0) / 5.0), 0.0)
        return -inside[:, None] * force_along_x(subject.robot.model, q) * 30.0

    result, quiet = found(subject, pushed), found(subject, None).floor
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == [("contact", 1)]
    assert np.all(result.floor < 4.0 * quiet)
    force, std = interval.finding_parameters(result.design, result.verdict, 0)["force"]
    assert force == pytest.approx(30.0, rel=0.1) and abs(force - 30.0) < 2.0 * std


def test_levers_are_the_jacobians_of_the_links_centres(subject):
    (track, *_), _ = found(subject, None).motions
    np.testing.assert_allclose(
        track.link_jacobians[::50, 1, 0],
        force_along_x(track.fitted_robot.model, track.coarse_samples.q[::50]),
        atol=1e-9,
    )


def test_what_hides_behind_another_effect_is_found_beside_it(subject):
    """A slight Stribeck effect under a strong coupling: alone, another velocity fits best, and it
    is a hundredth of the whole gain."""

    def both(t: Array, q: Array, dq: Array, tau: Array) -> Array:
        out = PLANTED["stribeck"][0](t, q, dq, tau)
        speed = dq[:, 0] - 0.7 * dq[:, 1]
        out[:, 0] += 3.0 * np.tanh(speed / FRICTION_WIDTH) + 0.5 * speed
        return out

    result = found(subject, both)
    assert {h.effect for h in result.verdict.chosen} == {
        "coupling",
        "stribeck",
    } and not result.unknown


def test_friction_that_warms_up_to_a_tenth_is_named(subject):
    def warmed(t: Array, q: Array, dq: Array, tau: Array) -> Array:
        friction = 1.5 * np.tanh(dq[:, 0] / FRICTION_WIDTH) + 0.4 * dq[:, 0]
        return on(0, friction * np.exp(-t / t[-1] * 2.0))

    first = found(subject, warmed).verdict.chosen[0]
    assert first.effect == "thermal_drift" and first.joint == 0


def test_what_is_trusted_is_kept_to_the_digit(subject):
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    load = np.zeros(len(psi))
    load[10:14] = 0.4 * np.array([1.0, 0.05, 0.02, 0.1])

    def more(recording: Recording) -> Recording:
        band_free = (
            dynamics.regressor(subject.robot, subject.parameters, derivatives(recording)) @ load
        )
        return dataclasses.replace(recording, tau=recording.tau + band_free)

    train, held_out = (more(one) for one in recordings_of(subject, None))
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
def test_a_base_that_leans_is_told_with_its_sign(subject, roll, pitch):
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))

    def leant(recording: Recording) -> Recording:
        body = recorded_motion.fitted_robot(subject.robot, subject.parameters, psi)
        turned = body.model.copy()
        turned.gravity.linear = pin.rpy.rpyToMatrix(roll, pitch, 0.0).T @ turned.gravity.linear
        torque = [
            [pin.rnea(m, m.createData(), q, 0.0 * q, 0.0 * q) for q in recording.q]
            for m in (turned, body.model)
        ]
        return dataclasses.replace(
            recording, tau=recording.tau + np.subtract(*map(np.array, torque))
        )

    train, held_out = (leant(one) for one in recordings_of(subject, None))
    options = diagnosis.DiagnosisOptions(
        trusted=dict(enumerate(psi.tolist())), names=("gravity_tilt",)
    )
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out], options
    )
    values = interval.finding_parameters(result.design, result.verdict, 0)
    # two links in one plane feel the lean within it alone, and how much of gravity is left there
    assert set(values) == {"pitch"}
    assert document(result)["findings"][0]["not_shown"] == ["roll"]
    assert values["pitch"][0] == pytest.approx(
        np.arctan(np.tan(pitch) / np.cos(roll)), rel=0.1 if abs(pitch) < 0.1 else 0.01
    )
    assert len(result.verdict.named) == 1 and np.all(result.after < 1.3 * result.floor)


def test_gravity_may_be_turned_but_not_longer():
    large = next(
        shape
        for shape in EFFECTS_BY_NAME["gravity_tilt"].candidates([Upright()])
        if shape.values["large"]
    )
    leans = large.is_plausible
    roll, pitch = 0.3, -0.2
    gx, gy, gz = pin.rpy.rpyToMatrix(roll, pitch, 0.0).T @ [0.0, 0.0, -1.0]
    exact = np.array([-gy, gx, -1.0 - gz])
    assert (
        leans(exact)
        and not leans(exact + np.array([0.0, 0.0, 0.2]))
        and not leans(exact - np.array([0.0, 0.0, 0.3]))
    )
    assert large.parameters(exact) == pytest.approx({"roll": roll, "pitch": pitch})


def test_rows_that_do_not_count_change_nothing():
    rng = np.random.default_rng(7)
    gamma, column, torque = (
        rng.normal(size=(60, 3)),
        rng.normal(size=(60, 1)),
        rng.normal(size=(60, 1)),
    )
    counts = np.arange(60) % 4 > 0

    def designed(g: Array, c: Array, t: Array, seen: Array) -> search.EffectRegression:
        half = whitened(
            [g[:, None, :]], [t], [seen[:, None]], np.ones(1), (np.zeros((0, 3)), np.zeros(0))
        )
        return search.design(
            (half, half),
            [CandidateModel("drag", 0, unexpected_columns)],
            lambda _: single_joint_columns(c * seen[:, None], c * seen[:, None]),
        )

    part = designed(gamma, column, torque + 9.0 * ~counts[:, None], counts)
    short = designed(gamma[counts], column[counts], torque[counts], counts[counts])
    np.testing.assert_allclose(
        search.level(part, [0]), search.level(short, [0]), rtol=1e-3
    )  # the prior's width is of all rows
    np.testing.assert_allclose(search.level(part, []), search.level(short, []))
    assert search.level(part, []) < 0.5 * np.mean((torque + 9.0 * ~counts[:, None]) ** 2)


def test_columns_of_listed_shapes_are_made_once_and_no_more_are_kept_than_there_is_room(
    subject, monkeypatch
):
    one_track, calls = found(subject, None).motions[0][0], list[str]()

    def add(t: recorded_motion.RecordedMotion, s: CandidateModel) -> Array:
        calls.append(s.effect)
        return np.ones((len(t), t.n, 1)) * s.values["x"]

    one, other, nothing = (CandidateModel("drag", 0, add, {"x": x}) for x in (1.0, 2.0, 0.0))
    build = equations.builder(([one_track], [one_track]), np.ones(one_track.n), [one, nothing])
    assert (
        build(one) is build(one)
        and build(nothing) is None
        and build(nothing) is None
        and len(calls) == 4
    )  # of both halves each
    assert build(other) is not build(other) and len(calls) == 8
    monkeypatch.setattr(equations, "ROOM", 0)
    build = equations.builder(([one_track], [one_track]), np.ones(one_track.n), [one])
    assert build(one) is not build(one)
