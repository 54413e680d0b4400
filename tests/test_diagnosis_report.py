"""The report of a diagnosis: every question answered, with and without findings, and what it says is what was found."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from made import WIDTH, motion, perturbed, recorded, two_links
from test_report import answer, check_page, section

from excite.diagnosis import diagnosis, residual_atlas
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.diagnosis_file import document
from excite.recordings import Kind, Recording, Remark
from excite.report import diagnosis as pages
from excite.report import diagnosis_page
from excite.report.figures.residual_atlas import plain, probability

QUESTIONS = {
    "missing": "Is anything missing?",
    "what": "What is it?",
    "where": "Where does it show?",
    "better": "Does the model with it predict better?",
    "apart": "What cannot be told apart by these recordings?",
    "next": "What to do next?",
    "made": "How was it made?",
}


def drawn(one: Diagnosis, stated: dict[str, Any], remarks: Sequence[Remark] = ()) -> str:
    return diagnosis_page(one, stated, residual_atlas.compute_atlas(one), remarks)


def noisy(one: Recording, seed: int) -> Recording:
    """With noise of its own: what is the same in two recordings can be foreseen."""
    assert one.tau is not None
    return dataclasses.replace(
        one, tau=one.tau + 0.1 * np.random.default_rng(10 + seed).normal(size=one.tau.shape)
    )


@cache
def found(amplitude: float) -> Diagnosis:
    """Two links whose second joint has Stribeck friction of that amplitude."""
    model = two_links()
    psi = perturbed(model.parameters, np.random.default_rng(3))
    both = []
    for seed, name in ((1, "train.csv"), (2, "validate.csv")):
        one = noisy(recorded(model, psi, motion(2, seed), 3.0, 0.0), seed)
        dq = np.gradient(one.q, 1.0 / one.rate, axis=0)[:, 1]
        extra = np.column_stack(
            [0.0 * dq, amplitude * np.exp(-((dq / 0.3) ** 2)) * np.tanh(dq / WIDTH)]
        )
        both.append(dataclasses.replace(one, source=name, tau=one.tau + extra))
    options = diagnosis.DiagnosisOptions(names=("stribeck", "drag", "asymmetric_viscous", "delay", "spring"))
    return diagnosis.diagnose(
        model.robot, model.parameters, model.base, both[:1], both[1:], options
    )


@cache
def ringing() -> Diagnosis:
    """Two links with a liquid in the second: an oscillator that its acceleration excites, no louder than noise."""
    model = two_links()
    psi = perturbed(model.parameters, np.random.default_rng(3))
    both = []
    for seed, name in ((1, "train.csv"), (2, "validate.csv")):
        one = noisy(recorded(model, psi, motion(2, seed), 3.0, 0.0), seed)
        ddq = np.gradient(np.gradient(one.q[:, 1], 1.0 / one.rate), 1.0 / one.rate)
        omega, damping, place, speed, felt = 2.0 * np.pi * 0.45, 0.04, 0.0, 0.0, []
        for push in ddq:
            speed -= (push + 2.0 * damping * omega * speed + omega**2 * place) / one.rate
            place += speed / one.rate
            felt.append(omega**2 * place + 2.0 * damping * omega * speed)
        extra = np.column_stack([0.0 * ddq, 0.05 * np.array(felt) / np.std(felt)])
        both.append(dataclasses.replace(one, source=name, tau=one.tau + extra))
    return diagnosis.diagnose(model.robot, model.parameters, model.base, both[:1], both[1:])


def test_what_no_name_takes_is_drawn_over_what_foresees_it() -> None:
    one = ringing()
    assert (
        one.unknown == [1] and one.name == "unexplained" and one.fitted[1][1] < 1.6 * one.noise_rms[1]
    )
    stated = document(one)
    (unknown,) = stated["unknown"]
    assert (
        unknown["joint"] == "joint_2"
        and unknown["where"]["regime"].startswith("past")
        and "sharp stop" in unknown["experiment"]
    )
    json.loads(json.dumps(stated["unknown"], allow_nan=False))
    text = drawn(one, stated)
    check_page(text)
    assert "Left without a name" in section(
        text, "what"
    ) and "What is left without a name, over what foresees it" in section(text, "what")
    assert "joint_2" in answer(text, "what") and unknown["experiment"] in section(text, "next")


def test_what_held_out_recordings_refute_is_told() -> None:
    stated = document(found(0.0))
    assert "Refuted" not in drawn(found(0.0), stated)
    stated["considered"][0]["evidence"]["foretold"] = 9.0
    assert "makes what is left of the others 3 times as large" in drawn(found(0.0), stated)


def test_what_the_health_check_did_to_the_recordings_is_told() -> None:
    one = found(0.0)
    assert "the health check had nothing to remark" in answer(page(0.0), "made")
    text = drawn(
        one,
        document(one),
        remarks=[Remark(Kind.WAVER, "read 0.05 ms off their stamps", repaired=True)],
    )
    assert "the health check had 1 remark" in answer(
        text, "made"
    ) and "read 0.05 ms off their stamps" in section(text, "made")


def test_what_is_foreseen_is_no_noise_though_it_never_repeats() -> None:
    one = ringing()
    loud = dataclasses.replace(
        one, floor=one.floor * [1.0, 1.5], noise_rms=one.noise_rms * [1.0, 1.5]
    )  # as if periods differed by it
    assert loud.unknown == [1]
    (unknown,) = document(loud)["unknown"]
    assert unknown["share"] >= loud.residual_predictions[1].share
    sights = {j: dataclasses.replace(s, share=0.0) for j, s in loud.residual_predictions.items()}
    deaf = dataclasses.replace(loud, residual_predictions=sights, doubted=0.0 * loud.doubted)
    assert not deaf.unknown


@cache
def page(amplitude: float) -> str:
    return drawn(found(amplitude), document(found(amplitude)))


@pytest.mark.parametrize("amplitude", [0.0, 2.0])
def test_it_stands_alone_and_answers_every_question(amplitude: float) -> None:
    text = page(amplitude)
    check_page(text)
    assert re.findall(r'<section id="(\w+)"', text) == list(QUESTIONS)
    for key, question in QUESTIONS.items():
        assert f"<h2>{question}</h2>" in section(text, key)
        assert answer(text, key).endswith(".") and len(answer(text, key)) > 20, key


def test_a_finding_is_told_with_its_parameters_and_its_picture() -> None:
    text, stated = page(2.0), document(found(2.0))
    first = stated["findings"][0]
    assert (first["effect"], first["joint"]) == ("stribeck", "joint_2") and first["evidence"][
        "p_value"
    ] is None
    looked = document(found(2.0), residual_atlas.compute_atlas(found(2.0)))["findings"][0]
    assert looked["evidence"]["p_value"] < 0.01
    assert answer(text, "what").startswith("Stribeck at joint_2")
    assert "amplitude" in section(text, "what") and "95 % interval" in section(
        text, "what"
    ).replace("\u00a0", " ")
    assert first["experiment"] in section(text, "next")
    assert "joint_2 against speed" in answer(text, "where")
    assert answer(text, "better").startswith("Yes")
    assert "with the findings" in section(text, "where")


def test_the_interval_of_a_size_ends_at_zero() -> None:
    first = document(found(2.0))["findings"][0]
    told = {"value": 0.1, "std": 0.1, "unit": ""}
    assert ">0 … 0.296<" in pages._finding({**first, "parameters": {"velocity": told}})
    assert "0 … 0.296" not in pages._finding(
        {**first, "effect": "spring", "parameters": {"stiffness": told}}
    )


def test_nothing_missing_is_said_and_nothing_else_is_claimed() -> None:
    text, stated = page(0.0), document(found(0.0))
    assert stated["verdict"] == "no-mismatch"
    assert answer(text, "missing").startswith("No: ")
    assert answer(text, "what").startswith("Nothing is asserted")
    assert answer(text, "where").startswith("Nowhere: ")
    assert "with the findings" not in section(text, "where")


def test_what_a_refit_absorbs_is_named_and_names_that_are_markup_stay_text() -> None:
    one = dataclasses.replace(found(2.0), options=diagnosis.DiagnosisOptions())
    model = one.identified.model
    evil = dataclasses.replace(model.robot, name="<b>x</b>")
    changed = dataclasses.replace(one.identified, model=dataclasses.replace(model, robot=evil))
    text = drawn(dataclasses.replace(one, identified=changed), document(one))
    assert "<b>x</b>" not in text and "&lt;b&gt;x" in text
    assert "--prior" in section(text, "apart") and "payload" in section(text, "apart")


def test_small_numbers_survive_the_drawing() -> None:
    assert (plain(0.005), plain(-0.25), plain(20.0)) == (".005", "−.25", "20")
    assert (probability(0.001), probability(0.034)) == ("p ≤ .001", "p = .034")
