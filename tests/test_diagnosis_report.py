"""The report of a diagnosis answers every question and states its results."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from excite.report.figures.residual_atlas import p_value
from synthetic_recordings import (
    FRICTION_WIDTH,
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    two_link_model,
)
from test_report import answer, check_page, section

from excite.diagnosis import diagnosis, residual_atlas
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.diagnosis_file import document
from excite.recordings import Recording, Remark, RemarkKind
from excite.report import diagnosis_page
from excite.report.formatting import number

QUESTIONS = {
    "missing": "Does the model lack anything?",
    "what": "Which effect is it?",
    "where": "What does the residual depend on?",
    "better": "Do the findings improve the prediction?",
    "apart": "Which effects can these recordings not distinguish?",
    "next": "What to do next?",
    "made": "How was it made?",
}


def report_of(result: Diagnosis, stated: dict[str, Any], remarks: Sequence[Remark] = ()) -> str:
    return diagnosis_page(result, stated, residual_atlas.compute_atlas(result), remarks)


def noisy(result: Recording, seed: int) -> Recording:
    """Add noise that is independent between recordings."""
    assert result.tau is not None
    return dataclasses.replace(
        result,
        tau=result.tau + 0.1 * np.random.default_rng(10 + seed).normal(size=result.tau.shape),
    )


@cache
def diagnosis_of(amplitude: float) -> Diagnosis:
    """Diagnose two links whose second joint has Stribeck friction of an amplitude [N m]."""
    model = two_link_model()
    psi = perturbed_parameters(model.parameters, np.random.default_rng(3))
    both = []
    for seed, name in ((1, "train.csv"), (2, "validate.csv")):
        result = noisy(synthetic_recording(model, psi, random_fourier(2, seed), 3.0, 0.0), seed)
        dq = np.gradient(result.q, 1.0 / result.rate, axis=0)[:, 1]
        extra = np.column_stack(
            [0.0 * dq, amplitude * np.exp(-((dq / 0.3) ** 2)) * np.tanh(dq / FRICTION_WIDTH)]
        )
        both.append(dataclasses.replace(result, source=name, tau=result.tau + extra))
    options = diagnosis.DiagnosisOptions(
        names=("stribeck", "drag", "asymmetric_viscous", "delay", "spring")
    )
    return diagnosis.diagnose(
        model.robot, model.parameters, model.base, both[:1], both[1:], options
    )


@cache
def sloshing() -> Diagnosis:
    """Diagnose two links with a sloshing liquid: an oscillator excited by acceleration."""
    model = two_link_model()
    psi = perturbed_parameters(model.parameters, np.random.default_rng(3))
    both = []
    for seed, name in ((1, "train.csv"), (2, "validate.csv")):
        result = noisy(synthetic_recording(model, psi, random_fourier(2, seed), 3.0, 0.0), seed)
        ddq = np.gradient(np.gradient(result.q[:, 1], 1.0 / result.rate), 1.0 / result.rate)
        omega, damping, place, speed, felt = 2.0 * np.pi * 0.45, 0.04, 0.0, 0.0, []
        for push in ddq:
            speed -= (push + 2.0 * damping * omega * speed + omega**2 * place) / result.rate
            place += speed / result.rate
            felt.append(omega**2 * place + 2.0 * damping * omega * speed)
        extra = np.column_stack([0.0 * ddq, 0.05 * np.array(felt) / np.std(felt)])
        both.append(dataclasses.replace(result, source=name, tau=result.tau + extra))
    return diagnosis.diagnose(model.robot, model.parameters, model.base, both[:1], both[1:])


def test_unexplained_residual_is_drawn_over_its_predictor() -> None:
    result = sloshing()
    assert (
        result.unknown == [1]
        and result.name == "unexplained"
        and result.fitted[1][1] < 1.6 * result.noise_rms[1]
    )
    stated = document(result)
    (unknown,) = stated["unknown"]
    assert (
        unknown["joint"] == "joint_2"
        and unknown["where"]["regime"].startswith("past")
        and "sharp stop" in unknown["experiment"]
    )
    json.loads(json.dumps(stated["unknown"], allow_nan=False))
    text = report_of(result, stated)
    check_page(text)
    effects = section(text, "what")
    assert "Residual that no effect explains" in effects
    assert "Unexplained residual over the quantity that predicts it" in effects
    assert "joint_2" in answer(text, "what") and unknown["experiment"] in section(text, "next")


def test_refuted_effect_is_stated() -> None:
    stated = document(diagnosis_of(0.0))
    assert "Refuted" not in report_of(diagnosis_of(0.0), stated)
    stated["considered"][0]["evidence"]["foretold"] = 9.0
    assert "residual of the others\nbecomes 3 times as large" in report_of(
        diagnosis_of(0.0), stated
    )


def test_remarks_on_recordings_are_listed() -> None:
    result = diagnosis_of(0.0)
    assert "the data-quality checks have no remark" in answer(page(0.0), "made")
    text = report_of(
        result,
        document(result),
        remarks=[Remark(RemarkKind.GAP, "a gap of 12 rows", repaired=True)],
    )
    assert "the data-quality checks have 1 remark" in answer(
        text, "made"
    ) and "a gap of 12 rows" in section(text, "made")


def test_predictable_residual_is_unknown_though_it_does_not_repeat() -> None:
    result = sloshing()
    noisier = dataclasses.replace(
        result, floor=result.floor * [1.0, 1.5], noise_rms=result.noise_rms * [1.0, 1.5]
    )  # as if periods differed by it
    assert noisier.unknown == [1]
    (unknown,) = document(noisier)["unknown"]
    assert unknown["share"] >= noisier.residual_predictions[1].share
    sights = {j: dataclasses.replace(s, share=0.0) for j, s in noisier.residual_predictions.items()}
    unpredicted = dataclasses.replace(
        noisier, residual_predictions=sights, doubted=0.0 * noisier.doubted
    )
    assert not unpredicted.unknown


@cache
def page(amplitude: float) -> str:
    return report_of(diagnosis_of(amplitude), document(diagnosis_of(amplitude)))


@pytest.mark.parametrize("amplitude", [0.0, 2.0])
def test_report_is_self_contained_and_answers_every_question(amplitude: float) -> None:
    text = page(amplitude)
    check_page(text)
    assert re.findall(r'<section id="(\w+)"', text) == list(QUESTIONS)
    for key, question in QUESTIONS.items():
        assert f"<h2>{question}</h2>" in section(text, key)
        assert answer(text, key).endswith(".") and len(answer(text, key)) > 20, key


def test_finding_is_shown_with_parameters_and_curves() -> None:
    text, stated = page(2.0), document(diagnosis_of(2.0))
    first = stated["findings"][0]
    assert (first["effect"], first["joint"]) == ("stribeck", "joint_2") and first["evidence"][
        "p_value"
    ] is None
    finding = document(diagnosis_of(2.0), residual_atlas.compute_atlas(diagnosis_of(2.0)))[
        "findings"
    ][0]
    assert finding["evidence"]["p_value"] < 0.01
    assert answer(text, "what").startswith("Stribeck at joint_2")
    assert "amplitude" in section(text, "what") and "95 % interval" in section(
        text, "what"
    ).replace("\u00a0", " ")
    assert first["experiment"] in section(text, "next")
    assert "joint_2 against speed" in answer(text, "where")
    assert answer(text, "better").startswith("Yes")
    assert "with the findings" in section(text, "where")


def test_interval_of_a_nonnegative_parameter_ends_at_zero() -> None:
    result = diagnosis_of(2.0)
    stated = document(result)
    first = stated["findings"][0]
    parameter = {"value": 0.1, "std": 0.1, "unit": ""}
    speed = {**first, "parameters": {"velocity": parameter}}
    assert ">0 … 0.296<" in report_of(result, {**stated, "findings": [speed]})
    spring = {**first, "effect": "spring", "parameters": {"stiffness": parameter}}
    assert "0 … 0.296" not in report_of(result, {**stated, "findings": [spring]}).replace(
        "−0.096 … 0.296", ""
    )


def test_same_input_gives_the_same_bytes() -> None:
    result = diagnosis_of(2.0)
    assert report_of(result, document(result)) == page(2.0)


def test_report_without_findings() -> None:
    text, stated = page(0.0), document(diagnosis_of(0.0))
    assert stated["verdict"] == "no-mismatch"
    assert answer(text, "missing").startswith("No: ")
    assert answer(text, "what").startswith("No finding: ")
    assert answer(text, "where").startswith("On nothing: ")
    assert "with the findings" not in section(text, "where")


def test_absorbed_effects_are_named_and_markup_is_escaped() -> None:
    result = dataclasses.replace(diagnosis_of(2.0), options=diagnosis.DiagnosisOptions())
    model = result.identified.model
    evil = dataclasses.replace(model.robot, name="<b>x</b>")
    changed = dataclasses.replace(result.identified, model=dataclasses.replace(model, robot=evil))
    text = report_of(dataclasses.replace(result, identified=changed), document(result))
    assert "<b>x</b>" not in text and "&lt;b&gt;x" in text
    assert "--prior" in section(text, "apart") and "payload" in section(text, "apart")


def test_numbers_in_figures() -> None:
    assert (number(0.005), number(-0.25), number(20.0)) == ("0.005", "−0.25", "20")
    assert (p_value(0.001), p_value(0.034)) == ("p ≤ 0.001", "p = 0.034")
