"""What touches the robot once, and what comes again whenever the motion does."""

from __future__ import annotations

import dataclasses

import numpy as np
from synthetic_recordings import perturbed_parameters, random_fourier, synthetic_recording

from excite.diagnosis import belief, diagnosis, once
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.diagnosis_file import document
from excite.diagnosis.judge import Verdict
from excite.identification.regression import IdentificationModel

Array = np.ndarray


def struck(subject: IdentificationModel, again: float) -> Diagnosis:
    """A robot that something pushes at its first link for a while, and `again` times as hard in
    each further period."""
    pair = []
    for seed in (2, 5):
        fourier = random_fourier(2, seed)
        one = synthetic_recording(
            subject,
            perturbed_parameters(subject.parameters, np.random.default_rng(4)),
            fourier,
            2,
            0.0,
        )
        turns, within = np.divmod(one.t, fourier.period)
        u = (within / fourier.period - 0.4) / 0.05
        push = (
            3.0
            * np.where((u > 0.0) & (u < 1.0), np.sin(np.pi * np.clip(u, 0.0, 1.0)), 0.0)
            * np.where(turns == 0, 1.0, again)
        )
        noise = 0.1 * np.random.default_rng(seed).normal(size=one.q.shape)
        pair.append(
            dataclasses.replace(
                one,
                tau=one.torque + noise + np.column_stack([push, 0.0 * push]),
                source=f"{seed}.csv",
            )
        )
    return diagnosis.diagnose(subject.robot, subject.parameters, subject.base, pair[:1], pair[1:])


def test_a_touch_is_named(subject):
    assert {f.main.effect for f in struck(subject, 0.0).verdict.findings} == {"contact"}


def test_what_comes_again_is_no_touch(subject, monkeypatch):
    result = struck(subject, 1.0)
    assert "contact" not in {f.main.effect for f in result.verdict.findings} and 0 in result.unknown
    monkeypatch.setattr(once, "AGAIN", np.inf)
    assert "contact" in {f.main.effect for f in struck(subject, 1.0).verdict.findings}


def test_a_touch_that_lasts_for_longer_than_a_period_is_not_what_comes_again(subject):
    """A period later it is still the same."""
    pair = []
    for seed in (2, 5):
        fourier = random_fourier(2, seed)
        fourier = dataclasses.replace(fourier, period=fourier.period / 2.6)
        one = synthetic_recording(
            subject,
            perturbed_parameters(subject.parameters, np.random.default_rng(4)),
            fourier,
            20,
            0.0,
        )
        push = 3.0 * ((one.t > 5.0) & (one.t < 5.0 + 3.0 * fourier.period) & (seed == 2))
        noise = 0.1 * np.random.default_rng(seed).normal(size=one.q.shape)
        pair.append(
            dataclasses.replace(
                one,
                tau=one.torque + noise + np.column_stack([push, 0.0 * push]),
                source=f"{seed}.csv",
            )
        )
    options = diagnosis.DiagnosisOptions(names=("contact", "hysteresis", "load_friction"))
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, pair[:1], pair[1:], options
    )
    assert {f.main.effect for f in result.verdict.findings} == {"contact"}


def test_names_that_make_held_out_torque_worse_leave_it_unknown(subject):
    result = struck(subject, 0.0)
    told = {
        "fitted": (10.0 * result.noise_rms, 1.2 * result.noise_rms),
        "before": 2.0 * result.expected,
    }
    for after in (1.2, 1.9):
        assert dataclasses.replace(result, after=after * result.expected, **told).unknown == []
    assert dataclasses.replace(result, after=9.0 * result.expected, **told).unknown == [0, 1]


def test_several_names_at_a_joint_that_are_likelier_not_all_right_are_told_as_such(subject):
    result = struck(subject, 0.0)
    (first, *_) = result.verdict.findings

    def sure(*chances: float) -> Verdict:
        return dataclasses.replace(
            result.verdict,
            findings=tuple(dataclasses.replace(first, probability=p) for p in chances),
        )

    for chances, unsure in (((0.6,), False), ((0.9, 0.6), False), ((0.6, 0.7), True)):
        verdict: Verdict = sure(*chances)
        assert belief.unsure(verdict, 2).tolist() == [
            j == first.main.joint and unsure for j in range(2)
        ]
    sight = next(iter(struck(subject, 1.0).residual_predictions.values()))
    doubtful = dataclasses.replace(
        result, verdict=sure(0.6, 0.7), residual_predictions={0: sight, 1: sight}
    )
    assert first.main.joint in doubtful.unknown
    stated = [
        one["where"]["statement"]
        for one in document(dataclasses.replace(doubtful, refitted=None))["unknown"]
    ]
    assert any("probably not all right" in text for text in stated)
