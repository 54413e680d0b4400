"""Contacts are transient; torque that recurs with the period of the motion is none."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from diagnosis_cases import (
    COULOMB,
    HELD_OUT,
    VISCOUS,
    added_torque,
    at_joint,
    diagnose,
    diagnosed,
    findings_of,
    force_along_x,
    motions,
    noise_ratios,
    pushed,
    recording_of,
)
from slow_tests import slow
from synthetic_recordings import FRICTION_WIDTH, PERIOD

from excite.diagnosis.diagnosis import Diagnosis


@cache
def recurring_push() -> Diagnosis:
    """Return the diagnosis of a robot that is pushed at the same place in every period."""
    recordings = []
    for seed in (2, HELD_OUT):
        recording = recording_of(None, seed)
        u = (np.mod(recording.t, PERIOD) / PERIOD - 0.4) / 0.05
        push = np.where((u > 0.0) & (u < 1.0), 3.0 * np.sin(np.pi * np.clip(u, 0.0, 1.0)), 0.0)
        recordings.append(added_torque(recording, at_joint(0, push)))
    return diagnose(recordings)


def test_a_contact_is_located_in_time():
    finding = next(f for f in diagnosed("contact").findings if f.effect == "contact")
    intervals = [model.interval for model in finding.models if model.interval is not None]
    low, high = min(low for low, _ in intervals), max(high for _, high in intervals)
    assert abs(low - 4.0) < 0.1 and abs(high - 6.0) < 0.1
    assert {model.source for model in finding.models} == {"2.csv"}


@pytest.mark.slow
def test_a_lasting_contact_in_the_only_recording_is_found():
    """A refit of the base model takes much of its torque: the residual hardly stands out."""
    start, end = 2.0, 8.0
    touched = recording_of(pushed(start, end, 1.0, np.ones_like), 2)
    result = diagnose([touched, recording_of(None, HELD_OUT)])
    (finding,) = result.findings
    assert (finding.effect, finding.joint) == ("contact", 1)
    (model,) = finding.models
    assert model.interval == pytest.approx((start, end), abs=0.1)


def test_friction_that_is_larger_for_some_time_is_no_contact():
    """No friction has exactly the form of its model: between two reversals it may be larger."""

    def larger(t, q, dq, tau):
        friction = COULOMB[0] * np.tanh(dq[:, 0] / FRICTION_WIDTH) + VISCOUS[0] * dq[:, 0]
        return at_joint(0, np.where((t > 2.365) & (t < 3.15), 0.15, 0.0) * friction)

    recordings = [recording_of(larger, 2, 0.01), recording_of(None, HELD_OUT, 0.01)]
    assert "contact" not in {effect for effect, _ in findings_of(diagnose(recordings))}


@pytest.mark.parametrize(
    "name", ["contact", *map(slow, ("dragging_contact", "contact_of_a_period"))]
)
def test_a_contact_is_one_finding_of_one_model(name):
    (finding,) = diagnosed(name).findings
    assert len(finding.models) == 1


@pytest.mark.parametrize(
    ("name", "largest_ratio"), [("contact", 1.2), slow("contact_of_a_period", 4.0)]
)
def test_a_contact_does_not_count_as_noise(name, largest_ratio):
    floor = diagnosed(None).noise.floor
    assert (diagnosed(name).noise.floor < largest_ratio * floor).all()


@pytest.mark.slow
def test_torque_that_recurs_with_the_period_is_no_contact():
    assert "contact" not in {effect for effect, _ in findings_of(recurring_push())}


@pytest.mark.slow
@pytest.mark.xfail(
    strict=True, reason="named spring and position friction; 105 noise floors, base model 13"
)
def test_torque_that_recurs_is_unknown_and_not_named():
    result = recurring_push()
    assert not findings_of(result) and [unknown.joint for unknown in result.unmodelled] == [0]
    before, after = noise_ratios(result)
    assert (after <= 1.05 * np.maximum(before, 1.0)).all()


def test_link_jacobians_are_those_of_the_centres_of_mass():
    motion = motions()[0]
    expected = force_along_x(motion.coarse_samples.q[::50], motion.fitted_robot.model)
    np.testing.assert_allclose(motion.link_jacobians[::50, 1, 0], expected, atol=1e-9)
