"""Diagnosis of simulated two-link robots with known effects, and of unusable input."""

from __future__ import annotations

import dataclasses
import json
from functools import cache

import numpy as np
import pytest
from contract import EFFECT_NAMES
from diagnosis_cases import (
    HIDDEN,
    PSI,
    SLOW_HIDDEN,
    SUBJECT,
    at_joint,
    diagnose,
    diagnosed,
    findings_of,
    friction_sign,
    known_failures,
    motions,
    noise_ratios,
    parameters,
    recordings_of,
)
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from slow_tests import slow
from synthetic_recordings import random_fourier, synthetic_recording, write_recording

from excite import effects
from excite._types import FloatArray
from excite.cli import main as main_module
from excite.cli.diagnose import diagnosis_text
from excite.diagnosis import estimates, joint_model, posterior
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.diagnosis_file import document
from excite.effects import EFFECTS_BY_NAME, nonlinear_viscous, recorded_motion
from excite.errors import UnusableInput
from excite.robot.samples import Samples
from excite.trajectory.fourier import FourierSeries

EXPLAINED = 1.4
"""Held-out RMSE over the noise of a model that has the hidden effect."""


@pytest.mark.parametrize(
    "name",
    known_failures(
        HIDDEN,
        {
            "torque_limit": "unknown torque is reported next to it",
            "elasticity": "base compliance is found instead",
        },
        SLOW_HIDDEN,
    ),
)
def test_a_hidden_effect_is_the_only_finding(name):
    result, hidden = diagnosed(name), HIDDEN[name]
    assert findings_of(result) == [(hidden.effect, hidden.joint)] and not result.unmodelled


@pytest.mark.parametrize(
    "name",
    known_failures(
        HIDDEN,
        {
            "stribeck": "velocity 0.096, true 0.12",
            "stiffening_spring": "stiffness 14.4, true 13.5",
            "elasticity": "base compliance is found instead",
        },
        SLOW_HIDDEN,
    ),
)
def test_the_parameters_of_a_hidden_effect_are_estimated(name):
    hidden = HIDDEN[name]
    estimates = parameters(diagnosed(name), hidden.effect, hidden.joint)
    for key, (truth, tolerance) in hidden.parameters.items():
        value, std = estimates[key]
        if tolerance is None:
            assert abs(value - truth) < 2.0 * std < 2.0 * truth
        else:
            assert value == pytest.approx(truth, rel=tolerance)


@pytest.mark.parametrize(
    "name",
    known_failures(
        HIDDEN,
        {
            "thermal_drift": "1.45 noise floors",
            "torque_limit": "1.8 noise floors",
            "elasticity": "2.5 noise floors",
            "dragging_contact": "1.42 noise floors: half a sine stands for another course",
        },
        SLOW_HIDDEN,
    ),
)
def test_the_saved_model_predicts_held_out_torque_to_the_noise(name):
    before, after = noise_ratios(diagnosed(name))
    assert (after < EXPLAINED).all() and (before > 1.5).any()


def test_a_robot_without_effects_has_no_findings():
    result = diagnosed(None)
    assert result.verdict == "no-mismatch" and not findings_of(result) and not result.unmodelled
    np.testing.assert_allclose(result.held_out.rmse_after, result.noise.floor, rtol=0.25)


class Paused(FourierSeries):
    """A motion that stops for a second, twice per period."""

    def samples(self, t: FloatArray) -> Samples:
        pace = np.linspace(0.0, self.period, 20001)
        speed = np.clip(np.abs(np.sin(2.0 * np.pi * pace / self.period)) - 0.2, 0.0, None)
        speed *= self.period / np.trapezoid(speed, pace)
        clock = CubicSpline(pace, cumulative_trapezoid(speed, pace, initial=0.0))
        turns, within = np.divmod(t, self.period)
        rate, change = clock(within, 1)[:, None], clock(within, 2)[:, None]
        along = super().samples(clock(within) + turns * self.period)
        return Samples(along.q, along.dq * rate, along.ddq * rate**2 + along.dq * change)


def test_an_effect_whose_coefficients_are_all_zero_is_not_in_the_model():
    """Signs may hold all of them at zero next to other effects."""
    model = diagnosed(None).model
    friction = posterior.select(model)[0]
    at_zero = dataclasses.replace(friction, is_in_model=False)  # leaves it out of the solution
    kept = dataclasses.replace(friction, is_in_model=True)
    estimate, _ = estimates.estimate_effects(model, (), [kept, at_zero])
    assert not estimate.needed and estimate.rejection


def test_static_friction_at_rest_is_no_mismatch():
    recordings = []
    for seed in (2, 5):
        plain = random_fourier(2, seed)
        paused = Paused(plain.sine, plain.cosine, plain.offset, 2.0 * plain.period)
        recording = synthetic_recording(SUBJECT, PSI, paused, 1.3, 0.1, 500.0)
        still = np.abs(paused.samples(recording.t).dq).max(axis=1, keepdims=True) < 1e-3
        assert still.mean() > 0.1
        torque = recording.torque + 4.0 * still
        recordings.append(dataclasses.replace(recording, tau=torque, source=f"{seed}.csv"))
    result = diagnose(recordings)
    assert not findings_of(result) and not result.unmodelled
    assert (result.held_out.moving.mean(axis=0) < 0.9).all()
    assert (result.held_out.rmse_after < 1.3 * 0.1).all()


@pytest.mark.slow
@pytest.mark.parametrize("order", [9.0, 16.7])
def test_orders_of_two_waves_of_torque_ripple_are_those_of_both(order):
    """A wave that is found first is biased by the one that is not yet known."""

    def ripple(t, q, dq, tau):
        angle = order * q[:, 1]
        wave = np.cos(angle + 0.7) + 0.6 * np.cos(1.37 * angle + 1.4)
        return at_joint(1, 0.8 * wave)

    effects = diagnose(recordings_of(ripple)).final.effects
    orders = [e.shape.values["order"] for e in effects if e.shape.effect == "torque_ripple"]
    assert sorted(orders) == pytest.approx([order, 1.37 * order], rel=0.006)


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="order 3.21, true 2")
def test_an_eccentric_encoder_is_reported_with_its_first_harmonic():
    """The torque contains the second harmonic more strongly, by the square of its order."""
    recordings = []
    for recording in recordings_of(None):
        angle, q = 2.0 * recording.q[:, 1] + 0.4, recording.q.copy()
        q[:, 1] += 0.02 * (np.sin(angle) + 0.4 * np.sin(2.0 * angle))
        recordings.append(dataclasses.replace(recording, q=q))
    result = diagnose(recordings)
    assert findings_of(result) == [("encoder_error", 1)]
    estimates = parameters(result, "encoder_error", 1)
    assert estimates["order"][0] == pytest.approx(2.0, rel=0.1)
    assert estimates["amplitude"][0] == pytest.approx(0.02, rel=0.2)
    assert (result.held_out.rmse_after < 0.5 * result.held_out.rmse_before).all()


@pytest.mark.parametrize(
    ("first", "second", "train"),
    [slow("stribeck", "spring", (2, 8)), ("stribeck", "coupling", (2,))],
)
def test_two_effects_are_both_reported(first, second, train):
    """The coupling has a much larger torque than the Stribeck friction of the same joint."""
    result = diagnose(
        recordings_of(
            lambda *state: HIDDEN[first].torque(*state) + 3.0 * HIDDEN[second].torque(*state),
            (*train, 5),
        )
    )
    assert set(findings_of(result)) == {(n, HIDDEN[n].joint) for n in (first, second)}
    assert (noise_ratios(result)[1] < EXPLAINED).all()


@pytest.mark.slow
def test_several_frictions_at_both_joints_are_found_at_once():
    names = ("stribeck", "hysteresis", "load_friction")
    result = diagnose(recordings_of(lambda *s: sum(HIDDEN[n].torque(*s) for n in names), (2, 8, 5)))
    assert set(findings_of(result)) == {(name, HIDDEN[name].joint) for name in names}
    assert parameters(result, "load_friction", 0)["mu"][0] == pytest.approx(0.1, rel=0.25)
    assert (noise_ratios(result)[1] < EXPLAINED).all()


# -- what the catalogue does not contain ----------------------------------------------------------


@cache
def outside_the_catalogue(name: str) -> Diagnosis:
    """Return the diagnosis of a robot with a repeatable torque that is not in the catalogue."""
    rng = np.random.default_rng(3)
    waves, phases = rng.normal(0.0, 9.0, (60, 2)), rng.uniform(0.0, 6.28, 60)
    torques = {
        "random function of both positions": lambda t, q, dq, tau: at_joint(
            0, 0.6 * np.cos(q @ waves.T + phases).sum(axis=1) / np.sqrt(30.0)
        ),
        "friction that depends on the other joint's position": lambda t, q, dq, tau: at_joint(
            0, friction_sign(dq[:, 0]) * np.cos(2.0 * q[:, 1])
        ),
    }
    return diagnose(recordings_of(torques[name], (2, 8, 5)))


OUTSIDE = (
    "random function of both positions",
    "friction that depends on the other joint's position",
)


@pytest.mark.parametrize("name", known_failures(OUTSIDE, {}, OUTSIDE[:1]))
def test_torque_outside_the_catalogue_is_unknown(name):
    result = outside_the_catalogue(name)
    assert [unknown.joint for unknown in result.unmodelled] == [0]
    assert result.verdict in ("partly-explained", "unexplained")


def test_an_effect_that_is_too_small_to_be_named_is_considered():
    small = recordings_of(lambda t, q, dq, tau: at_joint(1, 0.05 * np.abs(dq[:, 1])))
    stated = document(diagnose(small))
    (entry,) = (e for e in stated["considered"] if e["effect"] == "asymmetric_viscous")
    assert entry["joint"] == "joint_2" and entry["reason"] == estimates.Rejection.TOO_SMALL
    assert entry["probability"] < 0.5 and entry["evidence"]["log_bayes_factor"] > 50.0
    (unknown,) = stated["unknown"]
    assert unknown["joint"] == "joint_2" and "asymmetric_viscous" in unknown["too_small"]
    text = diagnosis_text(stated, SUBJECT.robot, [])
    assert "viscous friction that differs by direction" in text and "too small to be sure" in text


@pytest.mark.parametrize("name", known_failures(OUTSIDE, {}, OUTSIDE[:1]))
def test_torque_outside_the_catalogue_is_not_named(name):
    assert not findings_of(outside_the_catalogue(name))


@pytest.mark.parametrize(
    "name",
    known_failures(
        [*HIDDEN, *OUTSIDE],
        {"elasticity": "2.49 noise floors at joint 1, base model 1.35"},
        (*SLOW_HIDDEN, OUTSIDE[0]),
    ),
)
def test_no_joint_is_predicted_worse_than_by_the_base_model(name):
    result = diagnosed(name) if name in HIDDEN else outside_the_catalogue(name)
    before, after = noise_ratios(result)
    assert (after <= 1.05 * np.maximum(before, 1.0)).all()


def test_a_large_held_out_error_is_not_called_explained():
    result = diagnosed("torque_ripple")
    assert result.verdict == "explained"
    held_out = result.held_out
    in_floors = held_out.final * (result.noise.floor / held_out.rmse_after)
    for floors, verdict in ((1.19, "explained"), (1.21, "partly-explained")):
        errors = dataclasses.replace(held_out, final=floors * in_floors)
        assert dataclasses.replace(result, held_out=errors).verdict == verdict


# -- document, command and catalogue --------------------------------------------------------------


@pytest.mark.parametrize(("curve", "convex"), [(k, k >= 6) for k in range(8)])
def test_a_curve_of_viscous_friction_is_a_power_that_opposes_motion(curve, convex):
    shape = nonlinear_viscous.NONLINEAR_VISCOUS.dense_model(motions(), 0)
    coefficients = np.full(len(shape.nonnegative), 0.05)
    coefficients[curve] = 1.0
    estimate = shape.parameters(coefficients, motions()[0].fitted_robot)
    assert estimate["coefficient"] > 0.0 and (estimate["exponent"] > 1.0) == convex


def test_the_catalogue_has_the_effects_of_the_contract():
    assert sorted(EFFECTS_BY_NAME) == sorted(EFFECT_NAMES)
    assert len(effects.EFFECTS) == len(EFFECT_NAMES)
    for effect in effects.EFFECTS:
        assert effect.units and effect.signature and effect.experiment and effect.equation


def test_the_document_has_the_keys_of_the_contract():
    stated = json.loads(json.dumps(document(diagnosed("torque_ripple")), allow_nan=False))
    assert stated["schema"] == "excite.diagnosis/1" and stated["verdict"] == "explained"
    (finding,) = stated["findings"]
    assert (finding["effect"], finding["joint"]) == ("torque_ripple", "joint_2")
    assert 0.5 <= finding["probability"] <= 1.0 and finding["where"]["regime"] == "order"
    assert set(finding["parameters"]) == {"amplitude", "order"}
    assert finding["parameters"]["amplitude"]["unit"] == "N m"
    assert {"equivalents", "evidence", "experiment"} <= finding.keys()
    low, high = finding["evidence"]["severity_interval"]
    assert low < finding["evidence"]["severity"] < high
    keys = {"noise_floor", "noise_floor_method", "rmse_before", "rmse_after", "unexplained_share"}
    assert keys <= stated["joints"]["joint_1"].keys()
    assert stated["band_hz"] == 20.0 and stated["unknown"] == []


def test_the_command_writes_its_files_and_refuses_unusable_recordings(tmp_path, capsys):
    train, held_out = recordings_of(HIDDEN["asymmetric_viscous"].torque)
    first = write_recording(train, tmp_path / "a.csv")
    second = write_recording(held_out, tmp_path / "b.csv")
    command = ["diagnose", "two_link", str(first), "-o"]
    assert main_module.main([*command, str(tmp_path / "out"), "--validate", str(second)]) == 0
    assert "verdict: explained" in capsys.readouterr().out
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"diagnosis.json", "model.json", "report.html"}
    for arguments, message in (
        ([], "--validate"),
        (["--validate", str(first)], "same motion"),
        (["--validate", str(tmp_path / "no.csv")], "no.csv"),
    ):
        assert main_module.main([*command, str(tmp_path / "none"), *arguments]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_a_short_recording_is_refused():
    train, held_out = recordings_of(None)
    sidecar = dataclasses.replace(held_out.sidecar, period=None, periodic=None)
    short = dataclasses.replace(held_out.between(0.0, 0.6), sidecar=sidecar)
    with pytest.raises(UnusableInput, match=r"short|stretch"):
        diagnose([train, short])


def test_a_stretch_of_more_than_the_stated_length_is_used():
    identified, segment = diagnosed(None).identified, motions()[0].segment
    needed = segment.band(10.0).needed_samples(recorded_motion.MIN_KEPT_ROWS)
    for count, used in ((needed, 0), (needed + 1, 1)):
        parts = joint_model.identified_motions(identified, [segment.head(count)], 10.0)
        assert len(parts) == used


def test_a_recording_without_a_long_enough_stretch_is_refused():
    train, held_out = recordings_of(None)
    t = held_out.t[:60] + 0.5 * (np.arange(60) // 15)  # a gap after every 15 rows
    sidecar = dataclasses.replace(held_out.sidecar, period=None, periodic=None)
    pieces = dataclasses.replace(held_out.rows(slice(0, 60)), t=t, sidecar=sidecar)
    for recordings in ([train, pieces], [pieces, held_out]):
        with pytest.raises(UnusableInput, match="gap-free stretch"):
            diagnose(recordings)
