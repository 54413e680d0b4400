"""Friction that is another on the day of the recordings held out: told as that, and no veil over what else is missing."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from made import WIDTH, perturbed, two_links
from test_diagnose import PLANTED, recordings_of

from excite.diagnose import atlas, diagnosis
from excite.diagnose.diagnosis import Diagnosis
from excite.diagnose.document import document
from excite.report import diagnosis_page

Array = np.ndarray
MORE = np.array([0.25, -0.15])
"""Of each joint's friction, in the second recording."""


def friction() -> tuple[Array, Array]:
    model = two_links()
    psi = perturbed(model.parameters, np.random.default_rng(4))
    return psi[model.parameters.block("coulomb")], psi[model.parameters.block("viscous")]


@cache
def found(name: str | None, more: float = 1.0) -> Diagnosis:
    """Of two recordings with something planted, in the second of which friction is another."""
    subject, plant = two_links(), None if name is None else PLANTED[name][0]
    train, held_out = recordings_of(subject, plant)
    coulomb, viscous = friction()
    speed = np.gradient(held_out.q, held_out.t, axis=0)
    rubs = more * MORE * (coulomb * np.tanh(speed / WIDTH) + viscous * speed)
    other = dataclasses.replace(held_out, tau=held_out.torque + rubs)
    return diagnosis.diagnose(subject.robot, subject.parameters, subject.base, [train], [other])


def test_another_days_friction_is_told_as_that() -> None:
    one = found(None)
    assert not one.verdict.chosen and one.name == "unexplained" and one.unknown == [0, 1]
    coulomb, viscous = friction()
    assert [(change.source, change.joint) for change in one.changes] == [("5.csv", 0), ("5.csv", 1)]
    for change in one.changes:
        j = change.joint
        truth = np.array([MORE[j] * coulomb[j], MORE[j] * viscous[j], 0.0])
        assert change.sure and np.all(np.abs(change.change - truth) < 4.0 * change.std + 0.02 * np.abs(truth))
    stated = document(one)
    assert {u["where"]["regime"] for u in stated["unknown"]} == {"recording"}
    assert [c["joint"] for c in stated["between_recordings"]] == ["joint_1", "joint_2"]
    assert stated["between_recordings"][0]["viscous"]["unit"] == "N m s/rad"
    assert one.after[0] > 2.0 * one.floor[0]  # no model knows the day: what is held out is foretold as if nothing had changed


@pytest.mark.parametrize("name", ["stribeck", "torque_ripple", "position_friction", "coupling"])
def test_what_is_missing_is_named_though_friction_differs(name: str) -> None:
    one = found(name)
    assert [(h.effect, h.joint) for h in one.verdict.chosen] == [(name, PLANTED[name][1])]
    assert len(one.changes) == 2


def test_the_same_robot_is_the_same_in_all_recordings() -> None:
    for name in (None, "stribeck", "asymmetric_viscous"):
        assert not found(name, 0.0).changes


def test_the_report_says_that_the_robot_is_another() -> None:
    one = found(None)
    stated = document(one)
    text = diagnosis_page(one, stated, atlas.look(one))
    assert "Is the robot the same in all recordings?" in text and "No law is missing" in text
    same = found(None, 0.0)
    assert "Is the robot the same" not in diagnosis_page(same, document(same), atlas.look(same))
