"""Probability of a rare effect next to rival effects of similar evidence."""

from __future__ import annotations

import pytest

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
