"""Candidates for rare effects, and their probability next to rivals of similar evidence."""

from __future__ import annotations

import pytest
from diagnosis_cases import diagnosed

from excite.diagnosis.rare_candidates import CandidateColumns
from excite.diagnosis.selection import RareEffect


def rare_effect(effect: str, rivals: dict[tuple[str, int | None], float]) -> RareEffect:
    """Return an effect of joint 3 with a log Bayes factor of 100, and what else was tried."""
    return RareEffect((effect, 3), 100.0, rivals, {}, 100.0)


def test_a_load_on_another_link_is_the_same_load():
    share, equivalents = rare_effect(
        "payload", {("payload", 4): 99.0, ("payload", 5): 98.0}
    ).share()
    assert share == pytest.approx(1.0) and not equivalents


def test_a_spring_of_another_joint_is_another_effect():
    share, equivalents = rare_effect("spring", {("spring", 4): 99.0}).share()
    assert share < 0.6 and not equivalents


def test_another_effect_of_the_same_joint_is_an_equivalent():
    share, equivalents = rare_effect("spring", {("position_friction", 3): 99.0}).share()
    assert share == pytest.approx(1.0) and equivalents == ("position_friction",)


def test_another_effect_of_the_whole_robot_shares_the_probability_of_a_load_without_being_one():
    share, equivalents = rare_effect("payload", {("kinematic_error", 4): 100.0}).share()
    assert share == pytest.approx(0.5, abs=0.01) and not equivalents


def test_a_shape_that_the_model_has_is_no_candidate():
    """A second one of the same columns would have evidence by its wider prior."""
    model = diagnosed("spring").model
    rankings = CandidateColumns(model, trusted=False).scored(model)[1]
    tried = {candidate.model.form for r in rankings.values() for candidate in r.plausible}
    springs = {shape.form for shape in model.models if shape.effect == "spring"}
    assert springs and not springs & tried
    assert any(candidate.model.effect == "spring" for candidate in rankings["spring", 1].plausible)
