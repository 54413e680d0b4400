"""Identification against known truth: signals, estimators, consistent parameters, confidence."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from conftest import loaded, random_urdf, slope
from hypothesis import given, settings
from hypothesis import strategies as st
from made import PERIOD, RATE, WIDTH, motion, perturbed, recorded, two_links

from excite.errors import UnusableInput
from excite.identification import (
    consistency,
    estimators,
    friction_width,
    identification,
    inertia_distance,
    regression,
    segments,
)
from excite.identification.consistency import Bounds, Prior
from excite.identification.estimators import Method
from excite.identification.identification import Identification, IdentificationOptions
from excite.identification.inertia_distance import Distance
from excite.identification.lowpass import TAPER_FRACTION, Grid, LowPassFilter
from excite.identification.regression import IdentificationModel, TorqueEquations
from excite.recordings import Recording
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.robot.inertial_parameters import Parameters
from excite.trajectory.fourier import FourierSeries

Array = np.ndarray


@pytest.fixture(scope="module")
def model() -> IdentificationModel:
    return two_links()


@pytest.fixture(scope="module")
def truth(model: IdentificationModel) -> Array:
    """ψ of a robot that differs from the URDF by about 10 %, with friction."""
    return perturbed(model.parameters, np.random.default_rng(4))


def identified(model: IdentificationModel, *recordings: Recording, **options: object) -> Identification:
    return identification.identify(
        model.robot,
        model.parameters,
        model.base,
        recordings[:1],
        recordings[1:],
        IdentificationOptions(**options),
    )  # type: ignore[arg-type]


# -- band ------------------------------------------------------------------------------------------------------------


def test_periodic_derivatives_are_exact_below_the_band():
    fourier = motion(2)
    t = np.arange(round(PERIOD * RATE)) / RATE
    one = LowPassFilter(10.0, RATE, len(t), periodic=True)
    for order in range(3):
        assert np.allclose(
            one.filter(fourier.at(t), Grid.RECORDED, order), fourier.at(t, order), atol=1e-9
        )
    kept = one.filter(fourier.at(t), Grid.KEPT)
    assert np.allclose(kept, fourier.at(np.arange(len(kept)) * PERIOD / len(kept)), atol=1e-12)


def test_what_is_above_the_band_is_gone_and_what_is_below_keeps_its_phase():
    t = np.arange(4000) / RATE
    slow, fast = np.sin(2 * np.pi * 3.1 * t + 0.3), np.sin(2 * np.pi * 31.0 * t)
    one = LowPassFilter(10.0, RATE, len(t))
    inner = slice(one.margin, len(t) - one.margin)
    assert (
        np.abs(one.filter((slow + fast)[:, None], Grid.RECORDED)[inner, 0] - slow[inner]).max() < 1e-3
    )


def test_long_stretches_are_worked_on_in_chunks_without_a_seam(model, truth, monkeypatch):
    recording = recorded(model, truth, motion(2), 30, 0.0, period=None, periodic=None)
    whole = regression.build_equations(model, segments.extract_segments([recording]), 10.0)
    monkeypatch.setattr(segments, "CHUNK", 4096)
    parts = regression.build_equations(model, segments.extract_segments([recording]), 10.0)
    assert (
        len(parts) == len(whole)
        and parts.starts == whole.starts
        and np.allclose(parts.time, whole.time)
    )
    assert np.abs(parts.torque - whole.torque).max() < 1e-3 * np.abs(whole.torque).max()
    assert np.abs(parts.regressor - whole.regressor).max() < 2e-3 * np.abs(whole.regressor).max()


def test_whole_periods_are_averaged_and_their_spread_is_the_noise(model, truth):
    recording = recorded(model, truth, motion(2), 8, 0.5)
    (piece,) = segments.extract_segments([recording])
    assert (piece.periods, len(piece)) == (8, round(PERIOD * RATE))
    in_band = 0.5 * np.sqrt(20.0 / (RATE / 2))
    assert np.allclose(segments.noise_floor([piece], 20.0), in_band, rtol=0.1)
    left = np.sqrt(1.0 - TAPER_FRACTION * 5.0 / 8.0)  # mean square of half a raised cosine: 3/8
    assert np.allclose(
        segments.noise_floor([piece], 20.0, tapered=True), left * segments.noise_floor([piece], 20.0), rtol=0.02
    )


@pytest.mark.parametrize("period", [PERIOD, 5.2017])
def test_periods_that_a_gap_interrupts_are_left_out(model, truth, period):
    recording = recorded(model, truth, motion(2, period=period), 6.1, 0.01)
    turns = recording.t / period
    gone = ((turns > 2.2) & (turns < 2.3)) | ((turns > 3.9) & (turns < 3.95))
    (piece,) = segments.extract_segments([recording.rows(~gone)])
    assert piece.periods == len(piece.noise) == 4
    assert (
        np.sqrt(np.mean(np.square(piece.noise))) < 0.02
    )  # through the holes a curve would swing by newton metres


def test_a_period_without_a_window_is_that_of_all_the_recording(model, truth):
    recording = recorded(model, truth, motion(2), 4, 0.0)
    bare = dataclasses.replace(
        recording, sidecar=dataclasses.replace(recording.sidecar, periodic=None)
    )
    (one,), (other,) = segments.extract_segments([recording]), segments.extract_segments([bare])
    assert one.periods == other.periods == 4 and np.array_equal(one.torque, other.torque)


def test_a_period_that_is_no_whole_number_of_samples_is_interpolated(model, truth):
    fourier = motion(2, period=5.2017)
    (piece,) = segments.extract_segments([recorded(model, truth, fourier, 4.1, 0.0)])
    wanted = fourier.at(piece.start + np.arange(len(piece)) / piece.rate)
    assert piece.periods == 4 and np.abs(piece.q - wanted).max() < 1e-6


def test_the_band_follows_the_motion_and_the_noise(model, truth):
    calm = segments.torque_spectra(list(segments.extract_segments([recorded(model, truth, motion(2), 6, 1e-4)])))
    loud = segments.torque_spectra(list(segments.extract_segments([recorded(model, truth, motion(2), 6, 30.0)])))
    assert calm.hertz == pytest.approx(20.0) and loud.hertz < 0.8 * calm.hertz
    assert calm.motion == pytest.approx(4 / PERIOD, rel=0.5)


@pytest.mark.parametrize("hertz", [0.0, -1.0, RATE])
def test_a_band_that_cannot_be_is_refused(hertz):
    with pytest.raises(UnusableInput, match="--band"):
        LowPassFilter(hertz, RATE, 1000)


# -- estimators ------------------------------------------------------------------------------------------------------


def rows(model: IdentificationModel, recording: Recording, hertz: float = 20.0) -> TorqueEquations:
    return regression.build_equations(model, segments.extract_segments([recording]), hertz)


@pytest.mark.parametrize("method", [Method.OLS, Method.WLS, Method.FULL, Method.HUBER])
def test_without_noise_the_truth_comes_back(model, truth, method):
    recording = recorded(model, truth, motion(2), 4, 1e-6)
    found = estimators.estimate(rows(model, recording), method)
    # what is left is the aliasing of friction's steps at the recording's own rate
    assert np.abs(found.theta - model.base.matrix @ truth).max() < 2e-2


def test_weighted_least_squares_is_the_textbooks(model, truth):
    one = rows(model, recorded(model, truth, motion(2), 4, 0.3))
    found = estimators.estimate(one, Method.OLS)
    stacked = one.regressor.reshape(-1, model.base.count)
    assert np.allclose(
        found.theta, np.linalg.lstsq(stacked, one.torque.ravel(), rcond=None)[0], rtol=1e-8
    )


def test_white_noise_has_the_textbooks_covariance(model, truth):
    one = rows(model, recorded(model, truth, motion(2), 40, 0.3))
    found = estimators.estimate(one, Method.WLS)
    white = one.regressor / found.noise[:, None]
    textbook = np.linalg.inv(np.einsum("tip,tiq->pq", white, white))
    assert np.allclose(np.sqrt(np.diag(found.covariance) / np.diag(textbook)), 1.0, atol=0.25)
    assert np.allclose(np.linalg.inv(found.root.T @ found.root), found.covariance, rtol=1e-6)


def test_outliers_do_not_move_a_robust_estimate(model, truth):
    recording = recorded(model, truth, motion(2), 4, 0.1, period=None, periodic=None)
    bumped = recording.tau.copy()
    bumped[600:700] += 40.0
    hit = dataclasses.replace(recording, tau=bumped)
    exact = model.base.matrix @ truth
    plain, robust = (
        estimators.estimate(rows(model, hit), method) for method in (Method.WLS, Method.HUBER)
    )
    scale = np.sqrt(np.diag(estimators.estimate(rows(model, recording)).covariance))
    assert (
        np.abs((robust.theta - exact) / scale).max()
        < 0.3 * np.abs((plain.theta - exact) / scale).max()
    )
    assert robust.outliers > 0.01 and plain.outliers == 0.0


def coloured(rng: np.random.Generator, shape: tuple[int, int], pole: float) -> Array:
    out = rng.normal(size=shape)
    for t in range(1, len(out)):
        out[t] = pole * out[t - 1] + np.sqrt(1 - pole**2) * out[t]
    return out


@pytest.mark.parametrize("pole", [0.0, 0.97])
def test_intervals_cover_under_white_and_coloured_noise(model, truth, pole):
    """About 95 % of 95 % intervals hold the truth; pooled over 40 recordings, which pins it to a few per cent."""
    exact, inside = model.base.matrix @ truth, []
    clean = recorded(model, truth, motion(2), 5, 0.0)
    rng = np.random.default_rng(8)
    parts = rows(model, clean)
    nuisance = np.zeros((len(parts), 2, 2))
    nuisance[:, [0, 1], [0, 1]] = parts.slopes
    for _ in range(40):
        noisy = dataclasses.replace(
            clean, tau=clean.tau + 0.5 * coloured(rng, clean.tau.shape, pole)
        )
        (piece,) = segments.extract_segments([noisy])
        low = LowPassFilter(20.0, piece.rate, len(piece), periodic=True).filter(piece.torque, Grid.KEPT)
        torque_only = dataclasses.replace(
            parts, torque=low, repeats=(regression._repeats(piece, len(parts)),)
        )
        found = estimators.estimate(torque_only, nuisance=nuisance)
        inside.append(
            np.abs(found.theta - exact) <= estimators.interval_half_widths(found, np.eye(len(exact)))
        )
    assert 0.91 < np.mean(inside) < 0.985


def test_what_the_data_does_not_show_has_no_interval(model, truth):
    still = motion(2)
    still = FourierSeries(
        still.sine * np.array([[1.0], [0.0]]),
        still.cosine * np.array([[1.0], [0.0]]),
        still.offset,
        PERIOD,
    )
    found = estimators.estimate(rows(model, recorded(model, truth, still, 4, 0.1)))
    names = [model.parameters.names[i] for i in model.base.independent]
    unknown = {
        name
        for name, value in zip(names, np.diag(found.covariance), strict=True)
        if not np.isfinite(value)
    }
    assert {"Fv2", "Fc2"} <= unknown and "Fv1" not in unknown
    half = estimators.interval_half_widths(found, np.eye(len(names)))
    assert np.isinf(half[names.index("Fv2")]) and np.isfinite(half[names.index("Fv1")])


def test_friction_widths_are_found(model, truth):
    parts = list(segments.extract_segments([recorded(model, truth, motion(2), 4, 0.02)]))
    vague = dataclasses.replace(model, widths=np.full(2, 0.02))
    found = friction_width.fit_widths(vague, regression.build_equations(vague, parts, 20.0), parts)
    assert np.all(np.abs(np.log(found.widths / WIDTH)) < np.log(1.6))


# -- bodies ----------------------------------------------------------------------------------------------------------


def bodies(seed: int, count: int = 3) -> Array:
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        points = rng.normal(size=(8, 3)) * rng.uniform(0.05, 0.5)
        weights = rng.uniform(0.2, 2.0, 8)
        second, first = (points * weights[:, None]).T @ points, weights @ points
        tensor = np.trace(second) * np.eye(3) - second
        out.append(
            [
                weights.sum(),
                *first,
                tensor[0, 0],
                tensor[0, 1],
                tensor[1, 1],
                tensor[0, 2],
                tensor[1, 2],
                tensor[2, 2],
            ]
        )
    return np.array(out)


@pytest.mark.parametrize("kind", list(Distance))
def test_distances_have_exact_derivatives(kind):
    nominal, phi = bodies(1), bodies(2)
    found = inertia_distance.NominalFrames(nominal).squared_distance(kind, phi)
    for k in range(10):
        step = np.zeros(10)
        step[k] = 1.0
        numeric = slope(
            lambda h, s=step: inertia_distance.NominalFrames(nominal).squared_distance(kind, phi + h * s).value, 1e-5
        )
        assert np.allclose(
            found.gradient[:, k], numeric, rtol=1e-5, atol=1e-6 * np.abs(found.gradient).max()
        )


@pytest.mark.parametrize("kind", [Distance.RIEMANNIAN, Distance.BREGMAN, Distance.PULLBACK])
def test_geometric_distances_agree_near_the_nominal_body(kind):
    nominal = bodies(3)
    tangent = 1e-4 * np.einsum(
        "bij,bj->bi",
        np.array([inertial_parameters.inverse_root(phi) for phi in nominal]),
        np.ones((3, 10)),
    )
    found = inertia_distance.NominalFrames(nominal).squared_distance(kind, nominal + tangent)
    assert np.allclose(found.value, 10 * 1e-8, rtol=1e-2)
    assert np.allclose(
        found.hessian, 2 * inertia_distance.distance_metrics(kind, nominal), rtol=2e-2, atol=1e-2
    )


def test_the_riemannian_distance_depends_on_no_frame_or_unit():
    nominal, phi = bodies(4), bodies(5)
    place = np.eye(4)
    place[:3, :3] = pin.exp3(np.array([0.3, -1.0, 0.4])) * 1000.0  # millimetres
    place[:3, 3] = [200.0, -50.0, 20.0]

    def moved(one: Array) -> Array:
        P = place @ inertia_distance.pseudo_inertias(one) @ place.T
        second, first = P[:, :3, :3], P[:, :3, 3]
        tensor = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
        order = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
        return np.column_stack([P[:, 3, 3], first, *(tensor[:, i, j] for i, j in order)])

    before, after = (
        inertia_distance.NominalFrames(b).squared_distance(Distance.RIEMANNIAN, a).value
        for a, b in ((phi, nominal), (moved(phi), moved(nominal)))
    )
    assert np.allclose(before, after, rtol=1e-8)
    euclid = [
        inertia_distance.NominalFrames(b).squared_distance(Distance.EUCLIDEAN, a).value
        for a, b in ((phi, nominal), (moved(phi), moved(nominal)))
    ]
    assert not np.allclose(*euclid, rtol=0.1)


def prior_of(standard: Parameters, kind: Distance = Distance.BREGMAN, gamma: float = 1.0) -> Prior:
    edge = 10 * standard.bodies
    return Prior(
        consistency.consistent_nominal(standard),
        kind,
        gamma,
        np.full(standard.count - edge, gamma),
        np.diag(standard.scale)[edge:],
    )


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), kind=st.sampled_from(list(Distance)), size=st.floats(0.1, 100.0))
def test_whatever_the_data_says_the_answer_is_a_body(seed: int, kind: Distance, size: float):
    rng = np.random.default_rng(seed)
    machine = loaded(random_urdf(rng, 3)) if seed % 2 else robot.load("two_link")
    standard = inertial_parameters.standard(machine, limits.resolve(machine))
    root = rng.normal(size=(12, standard.count))
    found = consistency.maximum_a_posteriori(
        standard, root, size * rng.normal(size=12), prior_of(standard, kind)
    )
    assert consistency.is_consistent(standard, found.psi) and found.misfit >= 0.0


@pytest.mark.parametrize("kind", list(Distance))
def test_the_answer_is_the_minimum(model, kind):
    """No feasible neighbour is better."""
    standard, rng = model.parameters, np.random.default_rng(3)
    root, prior = rng.normal(size=(10, standard.count)), prior_of(model.parameters, kind)
    found = consistency.maximum_a_posteriori(standard, root, rng.normal(size=10), prior)
    problem = consistency._Problem(
        standard, root, root @ found.psi, prior, *consistency._halfspaces(standard, Bounds())
    )
    target = np.random.default_rng(3)
    target.normal(size=(10, standard.count))
    problem.target = target.normal(size=10)
    best = problem.value(found.psi, 0.0)
    for _ in range(200):
        other = found.psi + 1e-3 * standard.scale @ rng.normal(size=standard.count)
        if consistency.is_consistent(standard, other):
            assert problem.value(other, 0.0) >= best - 1e-4


def test_bounds_bind(model):
    standard = model.parameters
    mass = standard.nominal[0]
    box = np.array([[-0.01, -0.01, -0.01], [0.01, 0.01, 0.01]])
    limited = Bounds({standard.links[0]: (1.2 * mass, 1.3 * mass)}, {standard.links[1]: box})
    row = np.zeros((1, standard.count))
    row[0, 0] = 1e4
    found = consistency.maximum_a_posteriori(
        standard, row, np.array([1e4 * mass]), prior_of(standard), limited
    )
    assert 1.2 * mass <= found.psi[0] < 1.21 * mass
    assert np.all(np.abs(found.psi[11:14] / found.psi[10]) <= 0.01 + 1e-9)
    with pytest.raises(UnusableInput, match="no link"):
        consistency.maximum_a_posteriori(
            standard, row, np.array([1.0]), prior_of(standard), Bounds({"nobody": (0.0, 1.0)})
        )


# -- the whole -------------------------------------------------------------------------------------------------------


def test_held_out_torque_is_predicted_to_the_noise(model, truth):
    train, other = (
        recorded(model, truth, motion(2), 8, 0.3),
        recorded(model, truth, motion(2, seed=5), 8, 0.3),
    )
    found = identified(model, train, other)
    (prediction,) = found.validations
    assert np.all(prediction.error() <= 1.05 * prediction.noise_floor) and np.all(
        prediction.error() >= 0.95 * prediction.noise_floor
    )
    assert np.all(prediction.error("nominal") > 2.0 * prediction.noise_floor)
    assert consistency.is_consistent(model.parameters, found.psi)
    assert np.all(np.abs(found.delay.seconds) < 5 * found.delay.deviation + 2e-4)


def test_a_delay_is_found_and_taken_out(model, truth):
    recording = recorded(model, truth, motion(2), 8, 0.05)
    late = dataclasses.replace(
        recording,
        tau=np.column_stack(
            [np.interp(recording.t - 0.004, recording.t, c) for c in recording.tau.T]
        ),
    )
    window = dataclasses.replace(late.sidecar, periodic=(PERIOD, 8 * PERIOD))
    late = dataclasses.replace(late, sidecar=window)
    plain, aligned = identified(model, late), identified(model, late, align=True)
    assert np.allclose(plain.delay.seconds, 0.004, atol=6e-4)
    assert np.all(aligned.data.noise < plain.data.noise)


def test_evidence_trusts_a_nominal_robot_that_is_right(model):
    right = perturbed(model.parameters, np.random.default_rng(0), size=1e-3)
    wrong = perturbed(model.parameters, np.random.default_rng(0), size=0.15)
    gammas = [
        identified(model, recorded(model, psi, motion(2), 4, 0.5)).gamma[0]
        for psi in (right, wrong)
    ]
    assert gammas[0] > 3.0 * gammas[1]


@pytest.mark.parametrize("gamma", ["heldout", (3.0, 1e-4)])
def test_gamma_by_held_out_blocks_or_as_given(model, truth, gamma):
    found = identified(model, recorded(model, truth, motion(2), 4, 0.3), gamma=gamma)
    assert found.gamma == pytest.approx(gamma) if isinstance(gamma, tuple) else len(found.gamma_trials) > 5
    assert consistency.is_consistent(model.parameters, found.psi)


def test_what_is_trusted_stays(model, truth):
    known = dict(enumerate(truth[: 10 * model.parameters.bodies].tolist()))
    found = identified(model, recorded(model, truth, motion(2), 4, 0.3), trusted=known)
    assert np.allclose(
        found.psi[: 10 * model.parameters.bodies],
        truth[: 10 * model.parameters.bodies],
        rtol=1e-3,
        atol=1e-5,
    )
    friction = model.parameters.block("coulomb")
    assert np.allclose(found.psi[friction], truth[friction], rtol=0.1)


POOR = {
    "a joint that hardly moves": lambda f: (
        FourierSeries(f.sine * [[1.0], [1e-3]], f.cosine * [[1.0], [1e-3]], f.offset, f.period),
        4.0,
    ),
    "a robot that stands still": lambda f: (
        FourierSeries(0.0 * f.sine, 0.0 * f.cosine, f.offset + 0.4, f.period),
        4.0,
    ),
    "two seconds": lambda f: (f, 2.0 / PERIOD),
}


@pytest.mark.parametrize("case", list(POOR))
def test_poor_data_gives_a_consistent_answer_that_knows_what_it_does_not_know(model, truth, case):
    fourier, periods = POOR[case](motion(2))
    side = {"period": None, "periodic": None} if periods < 1 else {}
    poor, rich = (
        recorded(model, truth, fourier, periods, 0.1, **side),
        recorded(model, truth, motion(2), 8, 0.1),
    )
    found, best = identified(model, poor), identified(model, rich)
    assert consistency.is_consistent(model.parameters, found.psi) and np.isfinite(found.psi).all()
    assert consistency.is_consistent(model.parameters, found.reduced.psi)
    assert found.analysis.identifiable < best.analysis.identifiable
    unseen = [d for d in found.analysis.directions if not d.identifiable]
    told = " ".join(name for d in unseen for name, share in d.weights.items() if share > 0.5)
    if "hardly" in case:
        assert "Ia2" in told or "Fv2" in told
    if "still" in case:
        assert found.analysis.identifiable <= 4
    held_out = recorded(model, truth, motion(2, seed=9), 4, 0.1)
    error = [
        identified(model, poor, held_out, distance=kind).validations[0].error()
        for kind in (Distance.BREGMAN, Distance.EUCLIDEAN)
    ]
    assert np.isfinite(error).all()


def test_the_reduced_estimate_leaves_alone_what_the_data_cannot_say(model, truth):
    fourier, periods = POOR["a robot that stands still"](motion(2))
    found = identified(model, recorded(model, truth, fourier, periods, 0.1))
    edge = 10 * model.parameters.bodies
    moved = np.linalg.solve(
        model.parameters.scale[:edge, :edge],
        (found.reduced.psi - consistency.consistent_nominal(model.parameters))[:edge],
    )
    full = np.linalg.solve(
        model.parameters.scale[:edge, :edge],
        (truth - consistency.consistent_nominal(model.parameters))[:edge],
    )
    assert np.linalg.norm(moved) < np.linalg.norm(full)


# -- real machines ---------------------------------------------------------------------------------------------------

REAL = Path(__file__).resolve().parent.parent.parent / "shared" / "recordings"


def test_emps_pulses_are_predicted_to_five_per_cent():
    """Below 25 Hz on both sides; elsewhere 4.9 % was reached with symmetric friction and offset."""
    if not REAL.is_dir():
        pytest.skip(f"no real recordings at {REAL}")
    from excite import recordings

    machine = robot.load(str(REAL / "emps" / "emps.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    train, pulses = (
        recordings.read(REAL / "emps" / f"{name}.csv", machine)
        for name in ("train", "validate_pulses")
    )
    found = identification.identify(
        machine,
        standard,
        base_parameters.find(machine, standard, table),
        [train],
        [pulses],
        IdentificationOptions(band=25.0),
    )
    assert found.validations[0].relative()[0] < 0.049
