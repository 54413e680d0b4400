"""Effects that only a trusted prior reveals, because a refit of the base model absorbs them."""

from __future__ import annotations

import dataclasses
import json
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from diagnosis_cases import (
    PSI,
    SUBJECT,
    TRUSTED,
    added_torque,
    at_joint,
    diagnose,
    diagnosed,
    findings_of,
    noise_ratios,
    parameters,
    recordings_of,
)
from scipy.interpolate import CubicSpline
from slow_tests import slow
from synthetic_recordings import pinocchio_model, rnea_torque

import excite
from excite._types import FloatArray
from excite.diagnosis import fitted_effects
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.diagnosis_file import document
from excite.effects import EFFECTS_BY_NAME
from excite.identification import prior
from excite.recordings import Recording
from excite.report.torque_budget import joint_budgets, known_words, prior_words
from excite.robot import dynamics
from excite.robot.samples import Samples


def parameter_torque(recording: Recording, change: FloatArray) -> FloatArray:
    """Return the torque of a change of the standard parameters, shape (N, n)."""
    spline = CubicSpline(recording.t, recording.q)
    state = Samples(recording.q, spline(recording.t, 1), spline(recording.t, 2))
    return np.asarray(dynamics.regressor(SUBJECT.robot, SUBJECT.parameters, state) @ change)


def changed(places: dict[int, float]) -> list[Recording]:
    """Return recordings of the robot with changed standard parameters."""
    change = np.zeros(len(PSI))
    for place, value in places.items():
        change[place] = value
    return [added_torque(r, parameter_torque(r, change)) for r in recordings_of(None)]


@cache
def with_true_prior() -> Diagnosis:
    """Return the diagnosis of the robot without effects, with its parameters as the prior."""
    return diagnose(recordings_of(None), prior=TRUSTED)


@cache
def with_load(mass: float) -> Diagnosis:
    """Return the diagnosis of the robot with a load of some mass [kg] on its last link."""
    load = mass * np.array([1.0, 0.05, 0.02, 0.1])  # mass and first moments
    return diagnose(changed(dict(zip(range(10, 14), load, strict=True))), prior=TRUSTED)


def test_nothing_is_found_where_the_prior_is_right():
    result = with_true_prior()
    assert result.verdict == "no-mismatch" and not findings_of(result)


def doubts(result: Diagnosis) -> str:
    """Return what the reports say against the prior."""
    return prior_words(joint_budgets(document(result), SUBJECT.robot))


HEAVIER = dict(enumerate(0.4 * PSI[:20]))
"""Change of the parameters of both links."""


def test_links_that_are_heavier_than_the_prior_says_are_a_load_and_a_spring():
    """The links are 1.4 times as heavy.

    The mass of the load stands for that of the first link as well; its first moment does not.
    """
    result = diagnose(changed(HEAVIER), prior=TRUSTED)
    assert findings_of(result) == [("payload", 1), ("spring", 0)]
    load = parameters(result, "payload", 1)
    assert load["mass"][0] * load["com_x"][0] == pytest.approx(HEAVIER[11], rel=0.05)
    assert max(noise_ratios(result)[1]) < 1.05


def test_a_prior_is_in_doubt_where_a_refit_predicts_better():
    stated = document(with_true_prior())
    joint = SUBJECT.robot.joints[1]
    stated["joints"][joint]["rmse_after"] *= 10.0
    words = prior_words(joint_budgets(stated, SUBJECT.robot))
    assert "in doubt" in words and joint in words


@pytest.mark.slow
def test_without_a_prior_no_prior_is_in_doubt():
    assert not doubts(diagnose(changed(HEAVIER)))


def test_a_prior_that_holds_is_not_in_doubt():
    assert not doubts(with_true_prior())
    assert not doubts(with_load(0.4))


@pytest.mark.slow
def test_a_joint_that_stands_still_keeps_a_finite_friction_next_to_trusted_inertias():
    """Its viscous friction, which the prior does not state, has no column in the fit."""
    moving = recordings_of(None)
    held = dataclasses.replace(moving[0], q=moving[0].q * [1.0, 0.0] + [0.0, 0.3])
    zero_speed = np.zeros_like(held.q[:, 1:])
    spline = CubicSpline(held.t, held.q[:, :1])
    dq, ddq = (np.hstack([spline(held.t, order), zero_speed]) for order in (1, 2))
    tau = rnea_torque(SUBJECT, PSI, held.q, dq, ddq)
    tau += 0.1 * np.random.default_rng(3).normal(size=tau.shape)
    inertias = prior.TrustedPrior(dict(enumerate(PSI[: 10 * SUBJECT.parameters.bodies].tolist())))
    result = diagnose([dataclasses.replace(held, tau=tau), moving[1]], prior=inertias)
    assert np.abs(result.final.motions[0].theta).max() < 100.0
    assert noise_ratios(result)[1][0] < 1.5


@pytest.mark.slow
def test_an_offset_is_found_that_a_refit_absorbs():
    recordings = changed({SUBJECT.parameters.block("offset").start + 1: 1.0})
    assert not findings_of(diagnose(recordings))
    result = diagnose(recordings, prior=TRUSTED)
    assert findings_of(result) == [("torque_offset", 1)]
    assert parameters(result, "torque_offset", 1)["offset"][0] == pytest.approx(1.0, rel=0.05)


def test_a_rotor_inertia_is_found_that_a_refit_absorbs():
    recordings = changed({SUBJECT.parameters.block("rotor_inertia").start: 0.2})
    result = diagnose(recordings, prior=TRUSTED)
    assert findings_of(result) == [("rotor_inertia", 0)]
    assert parameters(result, "rotor_inertia", 0)["inertia"][0] == pytest.approx(0.2, rel=0.05)


@pytest.mark.parametrize("change", [-0.08, slow(0.25)])
def test_a_torque_gain_is_found_and_predicted(change):
    recordings = recordings_of(lambda t, q, dq, tau: at_joint(1, change * tau[:, 1]))
    result = diagnose(recordings, prior=TRUSTED)
    assert findings_of(result) == [("torque_gain", 1)]
    gain = 1.0 / (1.0 + change)
    assert parameters(result, "torque_gain", 1)["gain"][0] == pytest.approx(gain, rel=0.01)
    assert noise_ratios(result)[1].max() < 1.2


@pytest.mark.parametrize("mass", [-0.3, 0.0])
@pytest.mark.slow
def test_a_tool_that_was_taken_off_or_turned_is_a_payload(mass):
    """The last link lost a body, or carries it elsewhere: only its first moments differ."""
    moments = mass * np.array([0.05, 0.02, 0.1]) if mass else np.array([0.06, -0.05, 0.0])
    change = dict(zip(range(10, 14), [mass, *moments], strict=True))
    result = diagnose(changed(change), prior=TRUSTED)
    assert findings_of(result) == [("payload", 1)]
    reported = parameters(result, "payload", 1)
    assert reported["mass"][0] == pytest.approx(mass, abs=0.05)
    assert ("com_x" in reported) is (mass != 0.0)
    assert noise_ratios(result)[1].max() < 1.2


def test_a_model_as_prior_keeps_its_widths_of_coulomb_friction():
    """They belong to its friction: other ones would change the torque that it states."""
    saved = diagnosed(None)
    model = dataclasses.replace(
        fitted_effects.read_back(saved.document), widths=np.array([0.05, 0.1])
    )
    known = prior.TrustedPrior.of_model(model)
    result = diagnose(recordings_of(None), prior=known)
    np.testing.assert_array_equal(result.final.motions[0].widths, model.widths)
    stated = result.document["coulomb_width"]
    assert list(stated.values()) == model.widths.tolist()


@pytest.mark.parametrize("mass", [0.4, slow(4.0)])
def test_a_payload_is_found_and_trusted_parameters_are_kept(mass):
    result = with_load(mass)
    assert findings_of(result) == [("payload", 1)]
    assert parameters(result, "payload", 1)["mass"][0] == pytest.approx(mass, rel=0.1)
    (saved,) = (e for e in result.final.effects if e.shape.effect == "payload")
    assert saved.coefficients[0] == pytest.approx(mass, rel=0.1)
    stated = document(result)["findings"][0]["parameters"]
    assert stated["mass"]["value"] == pytest.approx(saved.coefficients[0], rel=1e-9)
    centre = saved.coefficients[1] / saved.coefficients[0]
    assert stated["com_x"]["value"] == pytest.approx(centre, rel=1e-9)
    # no base parameter is refit that could have a part of it
    for shares in document(result)["budget"].values():
        assert shares["payload"]["share"] > 0.9 and abs(shares["base_parameters"]["share"]) < 0.01
    np.testing.assert_allclose(result.final.motions[0].theta, SUBJECT.base.matrix @ PSI, atol=1e-12)


def test_effects_of_the_prior_are_no_findings(tmp_path):
    """A robot with Stribeck friction, diagnosed once; then it takes a payload."""

    def friction(t, q, dq, tau):
        return at_joint(1, 3.0 * np.exp(-((dq[:, 1] / 0.1) ** 2)) * np.tanh(dq[:, 1] / 0.01))

    first = diagnose(recordings_of(friction))
    assert findings_of(first) == [("stribeck", 1)]
    path = tmp_path / "model.json"
    path.write_text(json.dumps(dict(first.document)))
    known = prior.read_prior(path, SUBJECT.robot, SUBJECT.parameters)
    seeds = (5, 6)
    second = diagnose(recordings_of(friction, seeds), prior=known)
    assert not findings_of(second)
    # what is not asserted does not change what is known
    assert second.document["effects"] == first.document["effects"]
    change = np.zeros(len(PSI))
    change[10:14] = 0.3 * np.array([1.0, 0.1, 0.0, 0.02])
    loaded = [added_torque(r, parameter_torque(r, change)) for r in recordings_of(friction, seeds)]
    third = diagnose(loaded, prior=known)
    assert {name for name, _ in findings_of(third)} == {"payload"}
    assert "Stribeck friction" in known_words(document(third))
    # the file holds both
    saved = {entry["effect"] for entry in third.document["effects"]}
    assert saved >= {"stribeck", "payload"}
    assert (third.held_out.rmse_after < 1.2 * second.held_out.rmse_after).all()


@pytest.mark.parametrize(("roll", "pitch"), [(0.004, -0.006), slow(-0.3, 0.2)])
def test_the_tilt_of_the_base_is_estimated_with_its_sign(roll, pitch):
    upright = pinocchio_model(SUBJECT, PSI)
    tilted = upright.copy()
    tilted.gravity.linear = pin.rpy.rpyToMatrix(roll, pitch, 0.0).T @ upright.gravity.linear
    recordings = []
    for recording in recordings_of(None):
        torque = [
            [pin.computeGeneralizedGravity(m, m.createData(), q) for q in recording.q]
            for m in (tilted, upright)
        ]
        recordings.append(added_torque(recording, np.subtract(*map(np.array, torque))))
    result = diagnose(recordings, prior=TRUSTED)
    assert findings_of(result) == [("gravity_tilt", None)] and (noise_ratios(result)[1] < 1.3).all()
    # a planar arm observes the tilt in its plane and the gravity component in that plane
    (finding,) = document(result)["findings"]
    assert set(finding["parameters"]) == {"pitch"} and finding["not_shown"] == ["roll"]
    truth = np.arctan(np.tan(pitch) / np.cos(roll))
    assert finding["parameters"]["pitch"]["value"] == pytest.approx(
        truth, rel=0.1 if abs(pitch) < 0.1 else 0.01
    )


def test_a_tilt_keeps_the_magnitude_of_gravity():
    tracks = diagnosed(None).model.motions
    (large,) = (
        shape
        for shape in EFFECTS_BY_NAME["gravity_tilt"].candidates(tracks)
        if shape.values["large"]
    )
    gravity = SUBJECT.robot.model.gravity.linear / 9.81
    roll, pitch = 0.3, -0.2
    gx, gy, gz = pin.rpy.rpyToMatrix(roll, pitch, 0.0).T @ gravity
    exact = np.array([-gy, gx, -1.0 - gz])
    assert large.is_plausible(exact)
    assert not large.is_plausible(exact + np.array([0.0, 0.0, 0.2]))
    assert not large.is_plausible(exact - np.array([0.0, 0.0, 0.3]))
    estimate = large.parameters(exact, tracks[0].fitted_robot)
    assert estimate == pytest.approx({"roll": roll, "pitch": pitch})


@pytest.mark.parametrize("name", ["two_link", "ur10e"])
@pytest.mark.slow
def test_a_payload_is_no_rotor_inertia(name, tmp_path):
    """Only a payload is hidden; the prior file states the joint actuators exactly."""
    pytest.importorskip("mujoco")
    from simulated_robots import record_robot

    from excite.simulator.effect_instance import EffectInstance
    from excite.simulator.effects import EFFECT_TYPES
    from excite.simulator.experiment import ExperimentSettings

    def payload(robot, motion, rng):
        values = {"mass": 0.5, "com_x": 0.02, "com_y": 0.0, "com_z": 0.06, "radius": 0.03}
        names = {parameter.name for parameter in EFFECT_TYPES["payload"].parameters}
        kept = {key: value for key, value in values.items() if key in names}
        return [EffectInstance("payload", robot.joints[-1], "tuning", kept)]

    settings = ExperimentSettings(seed=3, rate=200.0, noise=0.002, model_error=0.0)
    case = record_robot(name, payload, tmp_path, 3, settings)
    actuators = case.robot.actuators
    stated = {"coulomb": "coulomb", "viscous": "viscous", "rotor_inertia": "inertia"}
    joints = {
        joint: {key: float(getattr(actuators, of)[i]) for key, of in stated.items()}
        | {"offset": float(actuators.offset[i])}
        for i, joint in enumerate(case.robot.joints)
    }
    prior = {"schema": "excite.prior/1", "trust_prior": True, "joints": joints}
    (tmp_path / "prior.json").write_text(json.dumps(prior))
    result = excite.diagnose(
        name, case.files[:2], case.files[2:], prior=tmp_path / "prior.json", with_report=False
    )
    (finding,) = result.findings
    assert (finding["effect"], finding["joint"]) == ("payload", case.robot.joints[-1])
    assert finding["parameters"]["mass"]["value"] == pytest.approx(0.5, rel=0.1)
