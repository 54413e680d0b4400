"""A held-out motion that is faster than the recordings to which friction was fitted."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from diagnosis_cases import PSI, RATE, SUBJECT, at_joint, diagnose, diagnosed
from slow_tests import slow
from synthetic_recordings import random_fourier, synthetic_recording

from excite.diagnosis.diagnosis_file import document
from excite.recordings import Recording
from excite.report import diagnosis as report
from excite.report.torque_budget import JointBudget, joint_budgets
from excite.trajectory.fourier import FourierSeries

SLOWER = 2.0
"""Period of the fitted motions over that of the held-out one."""


def recorded(seed: int, slower: float, friction: float) -> Recording:
    """Return a recording with friction of the first joint above the speeds of the slow motion."""
    series = random_fourier(2, seed)
    motion = FourierSeries(  # coefficients of the speed
        series.sine / slower, series.cosine / slower, series.offset, slower * series.period
    )
    recording = synthetic_recording(SUBJECT, PSI, motion, 2.0, 0.1, RATE)
    speed = motion.samples(recording.t).dq[:, 0]
    above = np.maximum(np.abs(speed) - np.abs(speed).max() / SLOWER, 0.0) * np.sign(speed)
    torque = recording.torque + at_joint(0, friction * above)
    return dataclasses.replace(recording, tau=torque, source=f"{seed}.csv")


@cache
def faster() -> tuple[dict[str, Any], list[JointBudget], str]:
    """Return document, budgets and page of a diagnosis whose held-out motion is twice as fast."""
    result = diagnose([recorded(2, SLOWER, 0.0), recorded(2, 1.0, 2.0)])
    content = document(result)
    return content, joint_budgets(content, SUBJECT.robot), report.diagnosis_page(result, content)


def test_ratio_of_the_speeds_is_stated():
    content, _, _ = faster()
    ratios = [entry["speed_ratio"] for entry in content["joints"].values()]
    assert ratios == pytest.approx([SLOWER] * 2, rel=0.05)


def test_error_at_higher_speeds_is_no_change_of_the_robot():
    _, (first, _), page = faster()
    assert first.is_extrapolated and not first.is_changed
    ratios = "speeds 2.0 and accelerations 4.0 times those of the fitted recordings"
    assert ratios in first.causes
    assert "record training motion as fast as the motion that is to be predicted" in page
    assert "in one session" not in page


@pytest.mark.parametrize("name", [None, "stribeck", slow("dragging_contact")])
def test_motions_of_one_speed_are_not_extrapolated(name):
    content = document(diagnosed(name))
    assert not any(b.is_extrapolated for b in joint_budgets(content, SUBJECT.robot))
