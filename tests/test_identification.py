"""The complete identification against known truth, and on a recording of a real machine."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from slow_tests import slow
from synthetic_recordings import (
    PERIOD,
    perturbed_parameters,
    random_fourier,
    rest_to_rest,
    rnea_torque,
    synthetic_recording,
    two_link_model,
)

from excite._types import FloatArray
from excite.diagnosis import fitted_effects
from excite.errors import UnusableInput
from excite.identification import consistency, identification, identified_model
from excite.identification.identification import Identification, IdentificationOptions
from excite.identification.inertia_distance import Distance
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording, Sidecar
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.trajectory.fourier import FourierSeries

REAL_RECORDINGS = Path(__file__).resolve().parent.parent.parent / "shared" / "recordings"


@pytest.fixture(scope="module")
def model() -> IdentificationModel:
    return two_link_model()


@pytest.fixture(scope="module")
def truth(model: IdentificationModel) -> FloatArray:
    """ψ of a robot that differs from the URDF by about 10 %, with friction."""
    return perturbed_parameters(model.parameters, np.random.default_rng(4))


def identify(
    model: IdentificationModel, *recordings: Recording, **options: object
) -> Identification:
    """Identify from the first recording, validate on the others."""
    return identification.identify(
        model.robot,
        model.parameters,
        model.base,
        recordings[:1],
        recordings[1:],
        IdentificationOptions(**options),  # type: ignore[arg-type]
    )


def test_validation_torque_is_predicted_to_within_the_noise(model, truth):
    train, validation = (
        synthetic_recording(model, truth, random_fourier(2), 8, 0.3),
        synthetic_recording(model, truth, random_fourier(2, seed=5), 8, 0.3),
    )
    result = identify(model, train, validation)
    (prediction,) = result.validations
    ratio = prediction.error() / prediction.noise_floor
    assert np.all(ratio <= 1.05) and np.all(ratio >= 0.95)
    assert np.all(prediction.error("nominal") > 2.0 * prediction.noise_floor)
    assert consistency.is_consistent(model.parameters, result.psi)
    assert np.all(np.abs(result.delay.seconds) < 5 * result.delay.deviation + 2e-4)


def resting_recording(
    model: IdentificationModel, psi: FloatArray, seed: int, held_joint: int | None = None
) -> Recording:
    """Return a recording of moves between rests, at which friction takes any value up to ±F."""
    rng, rate, moves = np.random.default_rng(seed), 250.0, 40
    phase = np.linspace(0.0, 1.0, 250)[:, None]
    share = rest_to_rest(phase)
    poses = rng.uniform(-1.5, 1.5, (moves + 1, model.robot.n))
    if held_joint is not None:
        poses[:, held_joint] = 0.3
    still = np.ones((150, 1))
    q = np.concatenate([np.vstack([a * still, a + share * (b - a)]) for a, b in pairwise(poses)])
    dq, ddq = np.gradient(q, axis=0) * rate, np.gradient(np.gradient(q, axis=0), axis=0) * rate**2
    held = np.repeat(rng.uniform(-1.0, 1.0, (moves, model.robot.n)), 400, axis=0)
    held[np.arange(len(q)) % 400 >= 150] = 0.0
    tau = rnea_torque(model, psi, q, dq, ddq) + held * psi[model.parameters.block("coulomb")]
    tau += 0.02 * rng.normal(size=tau.shape)
    t = np.arange(len(q)) / rate
    return Recording("rests.csv", model.robot.joints, t, q, tau=tau, sidecar=Sidecar(), row_times=t)


def test_friction_at_rest_is_neither_fitted_nor_judged(model, truth):
    recordings = [resting_recording(model, truth, seed) for seed in (1, 2)]
    result = identify(model, *recordings)
    (prediction,) = result.validations
    assert (prediction.error() < 0.03).all() and not prediction.moving.all(axis=0).any()
    exact = model.base.matrix @ truth
    spread = np.sqrt(np.diag(result.data.covariance))
    assert (np.abs(result.data.theta - exact) < 4.0 * spread + 1e-3).all()
    assert (spread < 0.02 * np.abs(exact) + 0.02).all()
    assert (np.abs(result.delay.seconds) < 1e-3).all()


def test_rests_of_a_joint_count_if_it_hardly_moves_or_has_no_coulomb_friction(model, truth):
    recording = resting_recording(model, truth, 1, held_joint=1)
    moving = identify(model, recording).equations.moving
    assert moving[:, 1].all() and 0.3 < moving[:, 0].mean() < 0.8
    table = limits.resolve(model.robot)
    inertial = inertial_parameters.standard_parameters(model.robot, table, ())
    base = base_parameters.find(model.robot, inertial, table)
    without = dataclasses.replace(model, parameters=inertial, base=base)
    assert identify(without, recording).equations.moving.all()


def test_a_torque_delay_is_estimated_and_compensated(model, truth):
    recording = synthetic_recording(model, truth, random_fourier(2), 8, 0.05)
    delayed = dataclasses.replace(
        recording,
        tau=np.column_stack(
            [np.interp(recording.t - 0.004, recording.t, c) for c in recording.tau.T]
        ),
    )
    window = dataclasses.replace(delayed.sidecar, periodic=(PERIOD, 8 * PERIOD))
    delayed = dataclasses.replace(delayed, sidecar=window)
    unaligned, aligned = identify(model, delayed), identify(model, delayed, align=True)
    assert np.allclose(unaligned.delay.seconds, 0.004, atol=6e-4)
    assert np.all(aligned.data.noise < unaligned.data.noise)
    # the saved model predicts the torque as it was recorded
    document = identified_model.model_document(aligned, [delayed])
    predicted = fitted_effects.predict(fitted_effects.read_back(document), delayed)[1]
    shifts, inside = np.arange(-0.006, 0.0065, 0.001), slice(100, -100)
    for joint in range(model.robot.n):
        shifted = [np.interp(delayed.t + d, delayed.t, predicted[:, joint]) for d in shifts]
        errors = [np.std((torque - delayed.torque[:, joint])[inside]) for torque in shifted]
        assert abs(shifts[np.argmin(errors)]) < 0.0011


def test_motors_that_brake_are_not_said_to_have_inverted_torque(model, truth):
    recording = synthetic_recording(model, truth, random_fourier(2), 2, 0.0)
    speed = np.gradient(recording.q, recording.t, axis=0)
    noise = 0.01 * np.random.default_rng(1).normal(size=speed.shape)
    braking = dataclasses.replace(recording, tau=-0.5 * speed + noise)
    with pytest.raises(UnusableInput, match=r"feeds in .*; if motors brake what something else"):
        identify(model, braking)
    inverted = dataclasses.replace(recording, tau=-recording.torque + noise)
    with pytest.raises(UnusableInput, match="the sign of the torque is inverted, turn it"):
        identify(model, inverted)


def test_evidence_gives_a_correct_nominal_robot_more_weight(model):
    right = perturbed_parameters(model.parameters, np.random.default_rng(0), size=1e-3)
    wrong = perturbed_parameters(model.parameters, np.random.default_rng(0), size=0.15)
    gammas = [
        identify(model, synthetic_recording(model, psi, random_fourier(2), 4, 0.5)).gamma[0]
        for psi in (right, wrong)
    ]
    assert gammas[0] > 3.0 * gammas[1]


@pytest.mark.parametrize("gamma", [slow("heldout"), (3.0, 1e-4)])
def test_gamma_is_chosen_by_validation_or_used_as_given(model, truth, gamma):
    result = identify(
        model, synthetic_recording(model, truth, random_fourier(2), 4, 0.3), gamma=gamma
    )
    if isinstance(gamma, tuple):
        assert result.gamma == pytest.approx(gamma)
    else:
        assert len(result.gamma_trials) > 5
    assert consistency.is_consistent(model.parameters, result.psi)


def test_trusted_parameters_keep_their_values(model, truth):
    edge = 10 * model.parameters.bodies
    trusted = dict(enumerate(truth[:edge].tolist()))
    result = identify(
        model, synthetic_recording(model, truth, random_fourier(2), 4, 0.3), trusted=trusted
    )
    assert np.allclose(result.psi[:edge], truth[:edge], rtol=1e-3, atol=1e-5)
    friction = model.parameters.block("coulomb")
    assert np.allclose(result.psi[friction], truth[friction], rtol=0.1)


def one_sided(model: IdentificationModel, psi: FloatArray, noise: float) -> Recording:
    """Recording in which joint 1 turns in one direction: its friction looks like an offset."""
    t = np.arange(2001) / 100.0
    motion = random_fourier(2).samples(t)
    omega = 2.0 * np.pi / PERIOD
    first = np.column_stack(
        [
            0.8 * t + 0.3 / omega * np.sin(omega * t),
            0.8 + 0.3 * np.cos(omega * t),
            -0.3 * omega * np.sin(omega * t),
        ]
    )
    q, dq, ddq = (
        np.column_stack([turning, x[:, 1]])
        for turning, x in zip(first.T, (motion.q, motion.dq, motion.ddq), strict=True)
    )
    tau = rnea_torque(model, psi, q, dq, ddq)
    tau += noise * np.random.default_rng(1).normal(size=tau.shape)
    return Recording("one_sided.csv", model.robot.joints, t, q, tau=tau, row_times=t)


@pytest.mark.parametrize("noise", [0.3, 1e-3])
def test_a_trusted_prior_leaves_undetermined_friction_near_nominal(model, truth, noise):
    trusted = dict(enumerate(truth[: 10 * model.parameters.bodies].tolist()))
    result = identify(model, one_sided(model, truth, noise), trusted=trusted)
    std = np.sqrt(np.diag(result.posterior.covariance))
    for kind in ("coulomb", "offset"):
        place = model.parameters.block(kind).start
        assert abs(result.psi[place] - truth[place]) < 2.0 * std[place]
        assert std[place] > 0.1
    both = [model.parameters.block(kind).start for kind in ("coulomb", "offset")]
    assert result.psi[both].sum() == pytest.approx(truth[both].sum(), abs=0.1)


def test_variances_are_honest_where_the_data_know_other_directions_far_better(model):
    """The data know a sum of two parameters; the prior knows each of them, 10⁹ times worse."""
    nominal = consistency.consistent_nominal(model.parameters)
    count, edge = model.parameters.count, 10 * model.parameters.bodies
    places = [model.parameters.block(kind).start for kind in ("coulomb", "offset")]
    root = np.zeros((1, count))
    root[0, places] = 1e9
    ones = np.ones(count - edge)
    prior = consistency.Prior(nominal, Distance.PULLBACK, 1.0, 0.5 * ones, ones)
    result = consistency.maximum_a_posteriori(model.parameters, root, root @ nominal, prior)
    variance = np.diag(result.covariance)[places]
    np.testing.assert_allclose(variance, 0.5, rtol=1e-3)


POOR_DATA = {
    "a joint that hardly moves": lambda f: (
        FourierSeries(f.sine * [[1.0], [1e-3]], f.cosine * [[1.0], [1e-3]], f.offset, f.period),
        4.0,
    ),
    "a resting robot": lambda f: (
        FourierSeries(0.0 * f.sine, 0.0 * f.cosine, f.offset + 0.4, f.period),
        4.0,
    ),
    "two seconds": lambda f: (f, 2.0 / PERIOD),
}


@pytest.mark.parametrize("case", list(POOR_DATA))
def test_poor_data_give_a_consistent_model_with_fewer_identified_directions(model, truth, case):
    fourier, periods = POOR_DATA[case](random_fourier(2))
    sidecar = {"period": None, "periodic": None} if periods < 1 else {}
    poor, rich = (
        synthetic_recording(model, truth, fourier, periods, 0.1, **sidecar),
        synthetic_recording(model, truth, random_fourier(2), 8, 0.1),
    )
    result, reference = identify(model, poor), identify(model, rich)
    assert consistency.is_consistent(model.parameters, result.psi)
    assert np.isfinite(result.psi).all()
    assert consistency.is_consistent(model.parameters, result.reduced.psi)
    counts = [sum(d.identifiable for d in run.analysis.directions) for run in (result, reference)]
    assert counts[0] < counts[1]
    unidentified = " ".join(
        name
        for direction in result.analysis.directions
        if not direction.identifiable
        for name, share in direction.weights.items()
        if share > 0.5
    )
    if "hardly" in case:
        assert "Ia2" in unidentified or "Fv2" in unidentified
    if "resting" in case:
        assert counts[0] <= 4
    validation = synthetic_recording(model, truth, random_fourier(2, seed=9), 4, 0.1)
    for kind in (Distance.BREGMAN, Distance.EUCLIDEAN):
        error = identify(model, poor, validation, distance=kind).validations[0].error()
        assert np.isfinite(error).all()


def test_the_reduced_estimate_keeps_unidentified_directions_nominal(model, truth):
    fourier, periods = POOR_DATA["a resting robot"](random_fourier(2))
    result = identify(model, synthetic_recording(model, truth, fourier, periods, 0.1))
    edge = 10 * model.parameters.bodies
    nominal = consistency.consistent_nominal(model.parameters)
    change, true_change = (
        np.linalg.norm(
            np.linalg.solve(model.parameters.scale[:edge, :edge], (psi - nominal)[:edge])
        )
        for psi in (result.reduced.psi, truth)
    )
    assert change < true_change


def slow_and_fast(model: IdentificationModel, truth: FloatArray) -> list[Recording]:
    """Recordings at 20 and at 500 Hz."""
    return [
        dataclasses.replace(
            synthetic_recording(model, truth, random_fourier(2, seed), 8, 0.1, rate),
            source=f"{rate:g}.csv",
        )
        for seed, rate in ((5, 20.0), (2, 500.0))
    ]


def test_the_band_is_one_that_the_slowest_recording_permits(model, truth):
    slow, fast = slow_and_fast(model, truth)
    result = identification.identify(
        model.robot, model.parameters, model.base, [fast, slow], (), IdentificationOptions()
    )
    assert 5.0 < result.spectra.hertz <= 0.4 * slow.rate
    with pytest.raises(UnusableInput, match=r"--band 15: .* 10 Hz at 20.csv; lower it, or leave"):
        identification.identify(
            *(model.robot, model.parameters, model.base, [fast, slow], ()),
            IdentificationOptions(band=15.0),
        )


def test_a_slow_validation_recording_is_compared_below_its_own_band(model, truth):
    slow, fast = slow_and_fast(model, truth)
    result = identify(model, fast, slow)
    (prediction,) = result.validations
    assert result.spectra.hertz > 0.5 * slow.rate
    assert np.all(prediction.error() < 1.5 * prediction.noise_floor)


def test_a_validation_recording_of_short_stretches_is_refused(model, truth):
    whole = synthetic_recording(model, truth, random_fourier(2, 5), 3, 0.3)
    rows = np.concatenate([np.arange(12) + 32 * k for k in range(4)])
    short = dataclasses.replace(whole.rows(rows), source="short.csv", sidecar=Sidecar())
    with pytest.raises(UnusableInput, match=r"short.csv: has no gap-free stretch that is long"):
        identify(model, whole, short)


def test_recordings_that_are_too_short_are_refused_by_the_longest(model, truth):
    whole = synthetic_recording(model, truth, random_fourier(2, 5), 3, 0.3)
    recordings = [
        dataclasses.replace(whole.rows(np.arange(rows)), source=f"{rows}.csv", sidecar=Sidecar())
        for rows in (40, 20)
    ]
    message = r"^40\.csv: no gap-free stretch is longer than the .* s that a band"
    with pytest.raises(UnusableInput, match=message):
        identification.identify(
            model.robot, model.parameters, model.base, recordings, [], IdentificationOptions()
        )


def test_torque_of_the_emps_pulses_is_predicted_to_five_percent():
    """EMPS, pulses of torque that the fit has not seen, both sides filtered below 25 Hz."""
    if not REAL_RECORDINGS.is_dir():
        pytest.skip(f"no real recordings at {REAL_RECORDINGS}")
    from excite import recordings

    machine = robot.load(str(REAL_RECORDINGS / "emps" / "emps.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, table)
    train, pulses = (
        recordings.read(REAL_RECORDINGS / "emps" / f"{name}.csv", machine)
        for name in ("train", "validate_pulses")
    )
    result = identification.identify(
        machine,
        standard,
        base_parameters.find(machine, standard, table),
        [train],
        [pulses],
        IdentificationOptions(band=25.0),
    )
    assert result.validations[0].relative()[0] < 0.049
