"""Friction that differs between sessions: reported as such, without hiding other effects."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from diagnosis_cases import EFFECTS, recordings_of
from synthetic_recordings import (
    FRICTION_WIDTH,
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    two_link_model,
)

from excite._types import FloatArray
from excite.diagnosis import course, diagnosis, equations, residual_atlas, search, session_changes
from excite.diagnosis.blocks import sandwiched
from excite.diagnosis.diagnosis import Diagnosis, DiagnosisOptions
from excite.diagnosis.diagnosis_file import document
from excite.report import diagnosis_page

CHANGE = np.array([0.25, -0.15])
"""Relative change of the friction of each joint in the second recording."""


def true_friction() -> tuple[FloatArray, FloatArray]:
    model = two_link_model()
    psi = perturbed_parameters(model.parameters, np.random.default_rng(4))
    return psi[model.parameters.block("coulomb")], psi[model.parameters.block("viscous")]


@cache
def diagnose_sessions(
    name: str | None, more: float = 1.0, names: tuple[str, ...] = ()
) -> Diagnosis:
    """Return the diagnosis of two recordings with an effect and different friction in the second.

    Args:
        name: Name of the effect; None: no effect.
        more: Factor of the change of friction.
        names: Names of the effects that are searched for; empty: all.
    """
    subject, plant = two_link_model(), None if name is None else EFFECTS[name][0]
    train, held_out = recordings_of(subject, plant)
    coulomb, viscous = true_friction()
    speed = np.gradient(held_out.q, held_out.t, axis=0)
    added = more * CHANGE * (coulomb * np.tanh(speed / FRICTION_WIDTH) + viscous * speed)
    changed = dataclasses.replace(held_out, tau=held_out.torque + added)
    return diagnosis.diagnose(
        subject.robot,
        subject.parameters,
        subject.base,
        [train],
        [changed],
        DiagnosisOptions(names=names),
    )


def test_a_change_of_friction_between_sessions_is_reported() -> None:
    result = diagnose_sessions(None)
    assert not result.verdict.chosen and result.name == "unexplained" and result.unknown == [0, 1]
    coulomb, viscous = true_friction()
    assert [(change.source, change.joint) for change in result.changes] == [
        ("5.csv", 0),
        ("5.csv", 1),
    ]
    for change in result.changes:
        j = change.joint
        truth = np.array([CHANGE[j] * coulomb[j], CHANGE[j] * viscous[j], 0.0])
        assert change.is_significant and np.all(
            np.abs(change.change - truth) < 4.0 * change.std + 0.02 * np.abs(truth)
        )
    content = document(result)
    assert {u["where"]["regime"] for u in content["unknown"]} == {"recording"}
    assert [c["joint"] for c in content["between_recordings"]] == ["joint_1", "joint_2"]
    assert content["between_recordings"][0]["viscous"]["unit"] == "N m s/rad"
    assert (
        result.after[0] > 2.0 * result.floor[0]
    )  # held-out torque is predicted without the change


def test_held_out_torque_is_predicted_with_the_mean_friction_of_the_sessions() -> None:
    """The friction of the held-out session is the mean of both training sessions."""
    subject, (coulomb, viscous) = two_link_model(), true_friction()
    psi, sessions = perturbed_parameters(subject.parameters, np.random.default_rng(4)), []
    for seed, more in ((2, 0.0), (8, 0.4), (5, 0.2)):
        recording = synthetic_recording(subject, psi, random_fourier(2, seed), 4, 0.0)
        speed = np.gradient(recording.q, recording.t, axis=0)
        added = more * (coulomb * np.tanh(speed / FRICTION_WIDTH) + viscous * speed)
        noise = 0.1 * np.random.default_rng(seed).normal(size=recording.q.shape)
        sessions.append(
            dataclasses.replace(
                recording, tau=recording.torque + added + noise, source=f"{seed}.csv"
            )
        )
    recording = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, sessions[:2], sessions[2:]
    )
    assert not recording.verdict.chosen and np.all(recording.after < 1.3 * recording.floor)
    changes = {(change.source, change.joint): change for change in recording.changes}
    assert set(changes) == {("8.csv", 0), ("8.csv", 1), ("5.csv", 0), ("5.csv", 1)}
    for (source, j), change in changes.items():  # relative to the first session
        truth = {"8.csv": 0.4, "5.csv": 0.2}[source] * np.array([coulomb[j], viscous[j], 0.0])
        assert np.all(np.abs(change.change - truth) < 4.0 * change.std + 0.02 * np.abs(truth))


@pytest.mark.parametrize("name", ["stribeck", "torque_ripple", "position_friction", "coupling"])
def test_an_effect_is_reported_although_friction_differs(name: str) -> None:
    result = diagnose_sessions(name)
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == [(name, EFFECTS[name][1])]
    assert len(result.changes) == 2


@pytest.mark.parametrize(("clear", "times"), [(course.CLEAR, 1), (0.0, 2)])
def test_session_changes_are_tried_before_a_delay(
    monkeypatch: pytest.MonkeyPatch, clear: float, times: int
) -> None:
    """Effects are tried first; otherwise separate actuator parameters are tried at once."""
    calls, followed = list[object](), course._followed
    monkeypatch.setattr(course, "CLEAR", clear)
    monkeypatch.setattr(session_changes, "differs_at_first", lambda *_: False)
    monkeypatch.setattr(
        course, "_followed", lambda begun, every: (calls.append(begun), followed(begun, every))[1]
    )
    result = diagnose_sessions.__wrapped__("stribeck", 2.0, ("stribeck", "delay"))
    assert [h.effect for h in result.verdict.chosen] == ["stribeck"] and result.changes
    assert len(calls) == times


def test_no_change_is_reported_within_one_session() -> None:
    for name in (None, "stribeck", "asymmetric_viscous"):
        assert not diagnose_sessions(name, 0.0).changes


def test_the_report_states_session_changes() -> None:
    result = diagnose_sessions(None)
    content = document(result)
    text = diagnosis_page(result, content, residual_atlas.compute_atlas(result))
    assert "Is the robot the same in all recordings?" in text and "No effect is missing" in text
    unchanged = diagnose_sessions(None, 0.0)
    assert "Is the robot the same" not in diagnosis_page(
        unchanged, document(unchanged), residual_atlas.compute_atlas(unchanged)
    )


def test_session_changes_do_not_hide_unmodelled_torque() -> None:
    result = diagnose_sessions("torque_ripple", names=("drag",))
    assert result.has_unmodelled_torque[1] and len(result.changes) == 2
    regimes = {u["joint"]: u["where"] for u in document(result)["unknown"]}
    assert (
        regimes["joint_2"]["regime"] != "recording"
        and "in addition" in regimes["joint_2"]["statement"]
    )
    assert "No effect is missing" not in diagnosis_page(
        result, document(result), residual_atlas.compute_atlas(result)
    )


@pytest.mark.parametrize("planted", [True, False])
def test_recordings_at_different_speeds_show_an_effect_and_no_session_changes(
    planted: bool,
) -> None:
    """Separate Coulomb and viscous friction of each recording would explain most of a nonlinear
    friction."""
    subject, runs = two_link_model(), []
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    for number, slower in enumerate((8.0, 4.0, 1.0, 2.0)):
        fast = random_fourier(2, 2)
        fourier = dataclasses.replace(
            fast, sine=fast.sine / slower, cosine=fast.cosine / slower, period=slower * fast.period
        )
        recording = synthetic_recording(subject, psi, fourier, 2, 0.0)
        speed = fourier.samples(recording.t).dq[:, 0]
        nonlinear_friction = (
            planted * 2.0 * np.tanh(speed / FRICTION_WIDTH) * np.sqrt(np.abs(speed))
        )
        noise = 0.1 * np.random.default_rng(number).normal(size=recording.q.shape)
        runs.append(
            dataclasses.replace(
                recording,
                tau=recording.torque
                + np.column_stack([nonlinear_friction, 0.0 * nonlinear_friction])
                + noise,
                source=f"{number}.csv",
            )
        )
    result = diagnosis.diagnose(subject.robot, subject.parameters, subject.base, runs[:3], runs[3:])
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == (
        [("nonlinear_viscous", 0)] if planted else []
    )
    assert not result.changes and not result.unknown
    assert (result.after < 1.3 * result.expected).all()


def test_the_uncertainty_of_a_change_depends_on_the_length_of_its_recording() -> None:
    """A short recording after a long one: errors are estimated between its own blocks of time."""
    subject, ratios = two_link_model(), list[float]()
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    for seed in range(6):
        rng = np.random.default_rng(seed)
        runs = [
            synthetic_recording(subject, psi, random_fourier(2, 2), periods, 0.0)
            for periods in (6.0, 0.8)
        ]
        noisy = [
            dataclasses.replace(
                r, tau=r.torque + 0.1 * rng.normal(size=r.q.shape), source=f"{len(r)}.csv"
            )
            for r in runs
        ]
        result = diagnosis.diagnose(
            subject.robot,
            subject.parameters,
            subject.base,
            noisy[:1],
            noisy[1:],
            DiagnosisOptions(names=("drag",)),
        )
        folds = [
            equations.half(motions, result.identified, {}, result.floor, result.motions)
            for motions in result.motions
        ]
        regression = search.bare(
            (folds[0], folds[1]), equations.builder(result.motions, result.floor)
        )
        ratios += [
            float(x)
            for change in session_changes.changes(regression, (), result.motions)
            for x in change.change / change.std
        ]
        assert not result.changes
    assert (
        np.sqrt(np.mean(np.square(ratios))) < 1.5
        and np.max(np.abs(ratios)) < session_changes.WALD_THRESHOLD
    )


def test_a_zero_column_has_a_zero_coefficient() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(40, 2)), rng.normal(size=40)
    wide = np.column_stack([x[:, 0], np.zeros(40), x[:, 1]])
    solution, covariance = sandwiched([(wide[:20], y[:20]), (wide[20:], y[20:])])
    expected, spread = sandwiched([(x[:20], y[:20]), (x[20:], y[20:])])
    np.testing.assert_allclose(solution, [expected[0], 0.0, expected[1]])
    np.testing.assert_allclose(covariance[np.ix_([0, 2], [0, 2])], spread)
    assert not covariance[1].any()
