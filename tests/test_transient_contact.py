"""Contacts are transient; torque that recurs with the period of the motion is none."""

from __future__ import annotations

import dataclasses

import numpy as np
from synthetic_recordings import perturbed_parameters, random_fourier, synthetic_recording

from excite.diagnosis import belief, diagnosis, once
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.diagnosis_file import document
from excite.diagnosis.judge import Verdict
from excite.identification.regression import IdentificationModel


def diagnose_contact(subject: IdentificationModel, recurrence: float) -> Diagnosis:
    """Return the diagnosis of a robot with a contact force on its first link.

    Args:
        subject: The robot.
        recurrence: Force in each further period over that in the first.
    """
    pair = []
    for seed in (2, 5):
        fourier = random_fourier(2, seed)
        recording = synthetic_recording(
            subject,
            perturbed_parameters(subject.parameters, np.random.default_rng(4)),
            fourier,
            2,
            0.0,
        )
        turns, within = np.divmod(recording.t, fourier.period)
        u = (within / fourier.period - 0.4) / 0.05
        push = (
            3.0
            * np.where((u > 0.0) & (u < 1.0), np.sin(np.pi * np.clip(u, 0.0, 1.0)), 0.0)
            * np.where(turns == 0, 1.0, recurrence)
        )
        noise = 0.1 * np.random.default_rng(seed).normal(size=recording.q.shape)
        pair.append(
            dataclasses.replace(
                recording,
                tau=recording.torque + noise + np.column_stack([push, 0.0 * push]),
                source=f"{seed}.csv",
            )
        )
    return diagnosis.diagnose(subject.robot, subject.parameters, subject.base, pair[:1], pair[1:])


def test_a_single_contact_is_reported(subject):
    assert {f.main.effect for f in diagnose_contact(subject, 0.0).verdict.findings} == {"contact"}


def test_torque_that_recurs_with_the_period_is_no_contact(subject, monkeypatch):
    result = diagnose_contact(subject, 1.0)
    assert "contact" not in {f.main.effect for f in result.verdict.findings} and 0 in result.unknown
    monkeypatch.setattr(once, "AGAIN", np.inf)
    assert "contact" in {f.main.effect for f in diagnose_contact(subject, 1.0).verdict.findings}


def test_a_contact_longer_than_a_period_is_reported(subject):
    """After one period the same contact still acts."""
    pair = []
    for seed in (2, 5):
        fourier = random_fourier(2, seed)
        fourier = dataclasses.replace(fourier, period=fourier.period / 2.6)
        recording = synthetic_recording(
            subject,
            perturbed_parameters(subject.parameters, np.random.default_rng(4)),
            fourier,
            20,
            0.0,
        )
        push = 3.0 * (
            (recording.t > 5.0) & (recording.t < 5.0 + 3.0 * fourier.period) & (seed == 2)
        )
        noise = 0.1 * np.random.default_rng(seed).normal(size=recording.q.shape)
        pair.append(
            dataclasses.replace(
                recording,
                tau=recording.torque + noise + np.column_stack([push, 0.0 * push]),
                source=f"{seed}.csv",
            )
        )
    options = diagnosis.DiagnosisOptions(names=("contact", "hysteresis", "load_friction"))
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, pair[:1], pair[1:], options
    )
    assert {f.main.effect for f in result.verdict.findings} == {"contact"}


def test_findings_that_worsen_the_held_out_torque_leave_it_unknown(subject):
    result = diagnose_contact(subject, 0.0)
    residuals = {
        "fitted": (10.0 * result.noise_rms, 1.2 * result.noise_rms),
        "before": 2.0 * result.expected,
    }
    for after in (1.2, 1.9):
        assert dataclasses.replace(result, after=after * result.expected, **residuals).unknown == []
    assert dataclasses.replace(result, after=9.0 * result.expected, **residuals).unknown == [0, 1]


def test_several_uncertain_findings_at_a_joint_make_it_unknown(subject):
    result = diagnose_contact(subject, 0.0)
    (first, *_) = result.verdict.findings

    def with_probabilities(*chances: float) -> Verdict:
        return dataclasses.replace(
            result.verdict,
            findings=tuple(dataclasses.replace(first, probability=p) for p in chances),
        )

    for chances, is_uncertain in (((0.6,), False), ((0.9, 0.6), False), ((0.6, 0.7), True)):
        verdict: Verdict = with_probabilities(*chances)
        assert belief.unsure(verdict, 2).tolist() == [
            j == first.main.joint and is_uncertain for j in range(2)
        ]
    prediction = next(iter(diagnose_contact(subject, 1.0).residual_predictions.values()))
    uncertain = dataclasses.replace(
        result,
        verdict=with_probabilities(0.6, 0.7),
        residual_predictions={0: prediction, 1: prediction},
    )
    assert first.main.joint in uncertain.unknown
    statements = [
        entry["where"]["statement"]
        for entry in document(dataclasses.replace(uncertain, refitted=None))["unknown"]
    ]
    assert any("probably not all right" in text for text in statements)
