"""Friction that is another on the day of the recordings held out: told as that, and no veil over
what else is missing."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from synthetic_recordings import (
    FRICTION_WIDTH,
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    two_link_model,
)
from test_diagnosis import PLANTED, recordings_of

from excite.diagnosis import course, diagnosis, equations, residual_atlas, search, session_changes
from excite.diagnosis.blocks import sandwiched
from excite.diagnosis.diagnosis import Diagnosis, DiagnosisOptions
from excite.diagnosis.diagnosis_file import document
from excite.report import diagnosis_page

Array = np.ndarray
MORE = np.array([0.25, -0.15])
"""Of each joint's friction, in the second recording."""


def friction() -> tuple[Array, Array]:
    model = two_link_model()
    psi = perturbed_parameters(model.parameters, np.random.default_rng(4))
    return psi[model.parameters.block("coulomb")], psi[model.parameters.block("viscous")]


@cache
def found(name: str | None, more: float = 1.0, names: tuple[str, ...] = ()) -> Diagnosis:
    """Of two recordings with something planted, in the second of which friction is another. names:
    that are looked for."""
    subject, plant = two_link_model(), None if name is None else PLANTED[name][0]
    train, held_out = recordings_of(subject, plant)
    coulomb, viscous = friction()
    speed = np.gradient(held_out.q, held_out.t, axis=0)
    rubs = more * MORE * (coulomb * np.tanh(speed / FRICTION_WIDTH) + viscous * speed)
    other = dataclasses.replace(held_out, tau=held_out.torque + rubs)
    return diagnosis.diagnose(
        subject.robot,
        subject.parameters,
        subject.base,
        [train],
        [other],
        DiagnosisOptions(names=names),
    )


def test_another_days_friction_is_told_as_that() -> None:
    one = found(None)
    assert not one.verdict.chosen and one.name == "unexplained" and one.unknown == [0, 1]
    coulomb, viscous = friction()
    assert [(change.source, change.joint) for change in one.changes] == [("5.csv", 0), ("5.csv", 1)]
    for change in one.changes:
        j = change.joint
        truth = np.array([MORE[j] * coulomb[j], MORE[j] * viscous[j], 0.0])
        assert change.is_significant and np.all(
            np.abs(change.change - truth) < 4.0 * change.std + 0.02 * np.abs(truth)
        )
    stated = document(one)
    assert {u["where"]["regime"] for u in stated["unknown"]} == {"recording"}
    assert [c["joint"] for c in stated["between_recordings"]] == ["joint_1", "joint_2"]
    assert stated["between_recordings"][0]["viscous"]["unit"] == "N m s/rad"
    assert (
        one.after[0] > 2.0 * one.floor[0]
    )  # no model knows the day: what is held out is foretold as if nothing had changed


def test_held_out_torque_is_foretold_with_the_mean_of_days() -> None:
    """The day held out is as warm as the two that teach are on the average."""
    subject, (coulomb, viscous) = two_link_model(), friction()
    psi, days = perturbed_parameters(subject.parameters, np.random.default_rng(4)), []
    for seed, more in ((2, 0.0), (8, 0.4), (5, 0.2)):
        one = synthetic_recording(subject, psi, random_fourier(2, seed), 4, 0.0)
        speed = np.gradient(one.q, one.t, axis=0)
        rubs = more * (coulomb * np.tanh(speed / FRICTION_WIDTH) + viscous * speed)
        noise = 0.1 * np.random.default_rng(seed).normal(size=one.q.shape)
        days.append(dataclasses.replace(one, tau=one.torque + rubs + noise, source=f"{seed}.csv"))
    one = diagnosis.diagnose(subject.robot, subject.parameters, subject.base, days[:2], days[2:])
    assert not one.verdict.chosen and np.all(one.after < 1.3 * one.floor)
    told = {(change.source, change.joint): change for change in one.changes}
    assert set(told) == {("8.csv", 0), ("8.csv", 1), ("5.csv", 0), ("5.csv", 1)}
    for (source, j), change in told.items():  # against the first
        truth = {"8.csv": 0.4, "5.csv": 0.2}[source] * np.array([coulomb[j], viscous[j], 0.0])
        assert np.all(np.abs(change.change - truth) < 4.0 * change.std + 0.02 * np.abs(truth))


@pytest.mark.parametrize("name", ["stribeck", "torque_ripple", "position_friction", "coupling"])
def test_what_is_missing_is_named_though_friction_differs(name: str) -> None:
    one = found(name)
    assert [(h.effect, h.joint) for h in one.verdict.chosen] == [(name, PLANTED[name][1])]
    assert len(one.changes) == 2


@pytest.mark.parametrize(("clear", "times"), [(course.CLEAR, 1), (0.0, 2)])
def test_what_another_day_explains_is_not_first_taken_for_late(
    monkeypatch: pytest.MonkeyPatch, clear: float, times: int
) -> None:
    """Where laws come first; else drives of their own are tried at once."""
    asked, followed = list[object](), course._followed
    monkeypatch.setattr(course, "CLEAR", clear)
    monkeypatch.setattr(session_changes, "differs_at_first", lambda *_: False)
    monkeypatch.setattr(
        course, "_followed", lambda begun, every: (asked.append(begun), followed(begun, every))[1]
    )
    one = found.__wrapped__("stribeck", 2.0, ("stribeck", "delay"))
    assert [h.effect for h in one.verdict.chosen] == ["stribeck"] and one.changes
    assert len(asked) == times


def test_the_same_robot_is_the_same_in_all_recordings() -> None:
    for name in (None, "stribeck", "asymmetric_viscous"):
        assert not found(name, 0.0).changes


def test_the_report_says_that_the_robot_is_another() -> None:
    one = found(None)
    stated = document(one)
    text = diagnosis_page(one, stated, residual_atlas.compute_atlas(one))
    assert "Is the robot the same in all recordings?" in text and "No effect is missing" in text
    same = found(None, 0.0)
    assert "Is the robot the same" not in diagnosis_page(
        same, document(same), residual_atlas.compute_atlas(same)
    )


def test_another_day_does_not_excuse_what_has_no_name() -> None:
    one = found("torque_ripple", names=("drag",))
    assert one.has_unmodelled_torque[1] and len(one.changes) == 2
    regimes = {u["joint"]: u["where"] for u in document(one)["unknown"]}
    assert (
        regimes["joint_2"]["regime"] != "recording"
        and "in addition" in regimes["joint_2"]["statement"]
    )
    assert "No effect is missing" not in diagnosis_page(
        one, document(one), residual_atlas.compute_atlas(one)
    )


@pytest.mark.parametrize("planted", [True, False])
def test_a_recording_of_each_speed_shows_a_law_and_not_other_drives(planted: bool) -> None:
    """A ladder of speeds: Coulomb and viscous friction of each file by itself would take most of a
    law over speed."""
    subject, runs = two_link_model(), []
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    for number, slower in enumerate((8.0, 4.0, 1.0, 2.0)):
        fast = random_fourier(2, 2)
        fourier = dataclasses.replace(
            fast, sine=fast.sine / slower, cosine=fast.cosine / slower, period=slower * fast.period
        )
        one = synthetic_recording(subject, psi, fourier, 2, 0.0)
        speed = fourier.samples(one.t).dq[:, 0]
        bent = planted * 2.0 * np.tanh(speed / FRICTION_WIDTH) * np.sqrt(np.abs(speed))
        noise = 0.1 * np.random.default_rng(number).normal(size=one.q.shape)
        runs.append(
            dataclasses.replace(
                one,
                tau=one.torque + np.column_stack([bent, 0.0 * bent]) + noise,
                source=f"{number}.csv",
            )
        )
    result = diagnosis.diagnose(subject.robot, subject.parameters, subject.base, runs[:3], runs[3:])
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == (
        [("nonlinear_viscous", 0)] if planted else []
    )
    assert not result.changes and not result.unknown
    assert (result.after < 1.3 * result.expected).all()


def test_a_change_is_as_sure_as_its_recording_is_long() -> None:
    """Of a short recording beside a long one: errors are told between its own stretches of time."""
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
        one = diagnosis.diagnose(
            subject.robot,
            subject.parameters,
            subject.base,
            noisy[:1],
            noisy[1:],
            DiagnosisOptions(names=("drag",)),
        )
        halves = [
            equations.half(half, one.identified, {}, one.floor, one.motions) for half in one.motions
        ]
        design = search.bare((halves[0], halves[1]), equations.builder(one.motions, one.floor))
        ratios += [
            float(x)
            for change in session_changes.changes(design, (), one.motions)
            for x in change.change / change.std
        ]
        assert not one.changes
    assert (
        np.sqrt(np.mean(np.square(ratios))) < 1.5
        and np.max(np.abs(ratios)) < session_changes.WALD_THRESHOLD
    )


def test_a_column_of_nothing_is_nothing() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(40, 2)), rng.normal(size=40)
    wide = np.column_stack([x[:, 0], np.zeros(40), x[:, 1]])
    found, covariance = sandwiched([(wide[:20], y[:20]), (wide[20:], y[20:])])
    plain, spread = sandwiched([(x[:20], y[:20]), (x[20:], y[20:])])
    np.testing.assert_allclose(found, [plain[0], 0.0, plain[1]])
    np.testing.assert_allclose(covariance[np.ix_([0, 2], [0, 2])], spread)
    assert not covariance[1].any()
