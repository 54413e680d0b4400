"""Friction that differs between sessions: reported as such, without hiding other effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest
from diagnosis_cases import (
    COULOMB,
    HIDDEN,
    PSI,
    RATE,
    SUBJECT,
    VISCOUS,
    added_torque,
    at_joint,
    diagnose,
    diagnosed,
    findings_of,
    friction_sign,
    noise_ratios,
    recording_of,
)
from slow_tests import slow
from synthetic_recordings import random_fourier, synthetic_recording

from excite._types import FloatArray
from excite.cli.diagnose import diagnosis_text
from excite.diagnosis import session_changes
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.diagnosis_file import document
from excite.diagnosis.session_changes import block_numbers, sandwiched
from excite.recordings import Recording
from excite.report import diagnosis_page

CHANGE = np.array([0.25, -0.15])
"""Relative change of the friction of each joint in a session."""
HELD_OUT_CHANGES: Mapping[int, FloatArray] = {2: 0.0 * CHANGE, 5: CHANGE}
"""Change of the held-out session alone, by the seed of each recording."""


def with_friction(recording: Recording, change: FloatArray) -> Recording:
    """Return a recording with a relative change of the friction of each joint."""
    speed = np.gradient(recording.q, recording.t, axis=0)
    return added_torque(recording, change * (COULOMB * friction_sign(speed) + VISCOUS * speed))


@cache
def diagnosed_sessions(name: str | None) -> Diagnosis:
    """Return the diagnosis of a robot whose friction differs in the held-out session.

    Args:
        name: Hidden effect; None: none.
    """
    effect = None if name is None else HIDDEN[name].torque
    changes = HELD_OUT_CHANGES.items()
    return diagnose([with_friction(recording_of(effect, s), c) for s, c in changes])


def assert_changes(result: Diagnosis, expected: Mapping[tuple[str, int], float]) -> None:
    """Assert relative changes of Coulomb and viscous friction, by recording and joint."""
    found_changes = {(change.source, change.joint): change for change in result.changes}
    assert set(found_changes) == set(expected)
    for (source, j), relative in expected.items():
        change = found_changes[source, j]
        truth = relative * np.array([COULOMB[j], VISCOUS[j], 0.0])
        error = np.abs(change.change - truth)
        assert (error < 4.0 * change.std + 0.02 * np.abs(truth)).all()


def assert_offsets(result: Diagnosis, expected: Mapping[str, float]) -> None:
    """Assert changes of the offset of every joint alone, by recording [N m]."""
    assert {change.source for change in result.changes} == set(expected)
    for change in result.changes:
        np.testing.assert_allclose(change.change, [0.0, 0.0, expected[change.source]], atol=0.05)


def test_a_change_of_the_held_out_session_is_reported_and_no_effect():
    result = diagnosed_sessions(None)
    assert not findings_of(result)
    assert_changes(result, {("5.csv", 0): CHANGE[0], ("5.csv", 1): CHANGE[1]})
    stated = document(result)["between_recordings"]
    assert [change["joint"] for change in stated] == ["joint_1", "joint_2"]
    assert stated[0]["viscous"]["unit"] == "N m s/rad"
    for change in stated:  # without effects there is one model
        assert change["error_share_before"] == pytest.approx(change["error_share"], abs=0.05)
    # held-out torque is predicted without the change
    assert noise_ratios(result)[1][0] > 2.0


@pytest.mark.slow
def test_held_out_torque_is_predicted_with_the_mean_friction_of_the_sessions():
    """The friction of the held-out session is the mean of both training sessions."""
    recordings = [
        with_friction(recording_of(None, seed), np.full(2, change))
        for seed, change in ((2, 0.0), (8, 0.4), (5, 0.2))
    ]
    result = diagnose(recordings)
    assert not findings_of(result) and (noise_ratios(result)[1] < 1.3).all()
    truth = {"2.csv": -0.2, "8.csv": 0.2}  # from their mean
    assert_changes(result, {(s, j): c for s, c in truth.items() for j in range(2)})
    assert (result.model.change_scale > 0.3).all()


@pytest.mark.parametrize(
    "name", ["stribeck", *map(slow, ("torque_ripple", "position_friction", "coupling"))]
)
def test_an_effect_is_reported_although_friction_differs(name):
    result = diagnosed_sessions(name)
    assert findings_of(result) == [(name, HIDDEN[name].joint)]
    assert {change.joint for change in result.changes} == {0, 1}
    change = document(result)["between_recordings"][HIDDEN[name].joint or 0]
    assert change["error_share_before"] < change["error_share"] - 0.05


@pytest.mark.parametrize("change", [0.0, 0.5])
@pytest.mark.slow
def test_a_recording_in_which_a_joint_creeps_does_not_change_its_friction(change):
    """At one slow speed in one direction, offset and friction cannot be told apart.

    Nor do they differ because those of the other joint do, by `change` of its friction.
    """
    recordings = [recording_of(None, seed) for seed in (2, 5)]
    fourier = random_fourier(2, 8, period=20.0)
    sine, cosine = fourier.sine.copy(), fourier.cosine.copy()
    sine[0], cosine[0] = 0.0, [0.05, 0.0, 0.0, 0.0]  # one way in half a period
    slow = dataclasses.replace(fourier, sine=sine, cosine=cosine)
    recording = synthetic_recording(SUBJECT, PSI, slow, 0.5, 0.0, RATE, period=None, periodic=None)
    noise = 0.1 * np.random.default_rng(8).normal(size=recording.q.shape)
    recording = added_torque(dataclasses.replace(recording, source="8.csv"), noise)
    changed = [
        with_friction(unchanged, np.array([0.0, sign * change]))
        for unchanged, sign in ((recordings[0], -1.0), (recording, 1.0))
    ]
    result = diagnose([*changed, recordings[1]])
    assert not findings_of(result) and noise_ratios(result)[1][0] < 1.1
    assert (result.model.change_scale > 0.4).tolist() == [False, change > 0.0]
    coulomb = result.final.motions[0].fitted_robot.actuator_parameter("coulomb")
    assert coulomb[0] == pytest.approx(COULOMB[0], rel=0.01)


@pytest.mark.parametrize("name", ["stribeck", "position_friction"])
@pytest.mark.slow
def test_an_effect_is_reported_and_saved_although_offsets_differ_between_sessions(name):
    """The mean error of a session to which a model is not fitted says nothing about an effect."""
    recordings = [
        added_torque(recording_of(HIDDEN[name].torque, seed), np.full(2, offset))
        for seed, offset in ((2, 0.0), (8, 3.0), (5, 1.5))
    ]
    result = diagnose(recordings)
    assert findings_of(result) == [(name, HIDDEN[name].joint)]
    assert (noise_ratios(result)[1] < 1.3).all()
    assert_offsets(result, {"2.csv": -1.5, "8.csv": 1.5})


@pytest.mark.parametrize("name", [None, "stribeck", slow("asymmetric_viscous")])
def test_no_change_is_reported_within_one_session(name):
    assert not diagnosed(name).changes


def test_the_report_states_session_changes():
    result = diagnosed_sessions(None)
    assert "5.csv" in diagnosis_page(result, document(result))
    assert result.verdict in ("no-mismatch", "unexplained")


@pytest.mark.parametrize("planted", [True, slow(False)])
def test_recordings_at_different_speeds_show_an_effect_and_no_session_changes(planted):
    """Separate Coulomb and viscous friction of each recording would explain most of a nonlinear
    friction."""
    recordings = []
    for number, slower in enumerate((8.0, 4.0, 1.0, 2.0)):
        fast = random_fourier(2, 2)
        fourier = dataclasses.replace(
            fast, sine=fast.sine / slower, cosine=fast.cosine / slower, period=slower * fast.period
        )
        recording = synthetic_recording(SUBJECT, PSI, fourier, 1, 0.0, RATE / 2.0)
        speed = fourier.samples(recording.t).dq[:, 0]
        friction = 2.0 * planted * friction_sign(speed) * np.sqrt(np.abs(speed))
        noise = 0.1 * np.random.default_rng(number).normal(size=recording.q.shape)
        named = dataclasses.replace(recording, source=f"{number}.csv")
        recordings.append(added_torque(named, at_joint(0, friction) + noise))
    result = diagnose(recordings)
    assert findings_of(result) == ([("nonlinear_viscous", 0)] if planted else [])
    assert not result.changes and not result.unmodelled
    assert (noise_ratios(result)[1] < 1.3).all()


@pytest.mark.slow
def test_the_uncertainty_of_a_change_is_that_of_its_recording():
    """Changes of friction of a robot that does not change are within their standard errors."""
    ratios = list[float]()
    for seed in range(3):
        recordings = [recording_of(None, seed), recording_of(None, seed + 10)]
        result = diagnose(recordings)
        assert not result.changes
        held_out = result.held_out
        changes = session_changes.changes(held_out.motions, held_out.final, held_out.moving)
        ratios += [float(x) for change in changes for x in change.change / change.std]
    assert np.sqrt(np.mean(np.square(ratios))) < 2.0


@pytest.mark.parametrize("seconds", [5, 8, 12])
def test_coloured_noise_of_a_short_recording_is_no_change(seconds):
    """White noise that was averaged over half a second hardly ever looks like a change."""
    rng = np.random.default_rng(seconds)
    held_out = diagnosed(None).held_out
    time = np.concatenate([motion.time for motion in held_out.motions])
    moving = held_out.moving & (time - time[0] < seconds)[:, None]
    width, significant = int(0.5 / np.median(np.diff(time))), list[bool]()
    for _ in range(100):
        noise = rng.normal(size=(len(time) + width - 1, moving.shape[1]))
        noise = np.apply_along_axis(np.convolve, 0, noise, np.ones(width) / width, "valid")
        estimates = session_changes.changes(held_out.motions, noise, moving)
        significant += [change.is_significant for change in estimates]
    assert len(significant) == 200 and sum(significant) <= 2


@pytest.mark.parametrize(("change", "verdict"), [slow(0.0, "same"), (2.0, "undecided")])
def test_a_change_that_a_short_recording_cannot_show_is_undecided(change, verdict):
    """Four seconds, without the ends of the filter, are four blocks, and one more than there are
    parameters."""
    short = recording_of(None, 5).between(0.0, 5.0)
    result = diagnose([recording_of(None, 2), with_friction(short, change * CHANGE)])
    stated = document(result)
    page = diagnosis_page(result, stated)
    text = diagnosis_text(stated, SUBJECT.robot, [])
    assert not stated["between_recordings"]
    entries = [] if verdict == "same" else [("5.csv", joint, 4.0) for joint in SUBJECT.robot.joints]
    undecided = stated["undecided_between_recordings"]
    assert [(c["recording"], c["joint"], c["seconds"]) for c in undecided] == entries
    words = "of 5.csv at both joints, with 4 s of motion to judge by at most"
    for report in (page, text):
        assert (words in report) is bool(entries)
    assert ("Is the robot the same in all recordings?" in page) is bool(entries)


def test_a_zero_column_has_a_zero_coefficient():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(40, 2)), rng.normal(size=40)
    wide = np.column_stack([x[:, 0], np.zeros(40), x[:, 1]])
    solution, covariance = sandwiched([(wide[:20], y[:20]), (wide[20:], y[20:])])
    expected, spread = sandwiched([(x[:20], y[:20]), (x[20:], y[20:])])
    np.testing.assert_allclose(solution, [expected[0], 0.0, expected[1]])
    np.testing.assert_allclose(covariance[np.ix_([0, 2], [0, 2])], spread)
    assert not covariance[1].any()


@pytest.mark.parametrize("error", [0.05, 1.0, 20.0])
def test_standard_errors_hold_with_a_prior_that_matters_or_not(error):
    """Coefficients drawn from the prior, coloured noise: errors over standard errors."""
    rng = np.random.default_rng(3)
    time, std = np.arange(0.0, 60.0, 0.02), np.array([2.0, 0.3, 1.0])
    x = np.column_stack([np.sign(np.sin(2.0 * time)), np.sin(2.0 * time), np.ones(len(time))])
    block, ratios = block_numbers(time), []
    for _ in range(150):
        truth, noise = std * rng.normal(size=3), rng.normal(size=len(time))
        noise = np.convolve(noise, np.ones(10), "same") / np.sqrt(10.0)
        y = x @ truth + error * noise
        parts = [(x[block == k], y[block == k]) for k in np.unique(block)]
        # rows are correlated over ten samples: each counts a tenth
        solution, covariance = sandwiched(parts, std, error * np.sqrt(10.0))
        ratios.append((solution - truth) / np.sqrt(np.diag(covariance)))
    assert 0.8 < np.sqrt(np.mean(np.square(ratios))) < 1.25


def test_a_block_lasts_a_second_by_the_clock():
    """Also of a joint that moves for a tenth of the time: few rows are few blocks."""
    time = 100.0 + np.arange(0.0, 20.3, 0.01)
    block = block_numbers(time)
    assert block[0] == 0
    assert block[-1] == 19
    assert min(np.ptp(time[block == k]) for k in range(20)) > 0.98
    assert len(np.unique(block[(time - 100.0) % 10.0 < 1.0])) == 3
