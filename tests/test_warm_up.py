"""Recordings of one session: a joint that is warm when the next one starts."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from diagnosis_cases import (
    COULOMB,
    HELD_OUT,
    VISCOUS,
    Effect,
    at_joint,
    diagnose,
    findings_of,
    friction_sign,
    noise_ratios,
    recording_of,
)

from excite.diagnosis.diagnosis import Diagnosis
from excite.recordings import Recording

TIME_CONSTANT = 18.0
"""Time constant of the joint's warm-up [s]."""
STARTS = {2: 0.0, 3: 25.0, HELD_OUT: 50.0}
"""Start of the recording with each seed, which lasts 20.8 s, by the clock of all [s]."""


def warming(start: float) -> Effect:
    """Return friction of the first joint that falls from the start of the session on."""
    return lambda t, q, dq, tau: at_joint(
        0,
        (COULOMB[0] * friction_sign(dq[:, 0]) + VISCOUS[0] * dq[:, 0])
        * np.exp(-(start + t) / TIME_CONSTANT),
    )


def recorded_at(seed: int, start: float) -> Recording:
    """Return a recording whose time stamps are those of the clock of the session."""
    recording = recording_of(warming(STARTS[seed]), seed)
    low, high = recording.sidecar.periodic or (0.0, float(recording.t[-1]))
    return dataclasses.replace(
        recording,
        t=recording.t + start,
        row_times=recording.row_times + start,
        sidecar=dataclasses.replace(recording.sidecar, periodic=(low + start, high + start)),
    )


@cache
def session(is_one_clock: bool) -> Diagnosis:
    """Return the diagnosis of a session, with time stamps by one clock or each from zero."""
    return diagnose([recorded_at(k, start * is_one_clock) for k, start in STARTS.items()])


def test_warm_up_of_a_session_is_found_by_its_clock():
    result = session(is_one_clock=True)
    assert ("thermal_drift", 0) in findings_of(result)
    (finding,) = (f for f in result.findings if f.effect == "thermal_drift")
    assert finding.parameters["time_constant"][0] == pytest.approx(TIME_CONSTANT, rel=0.3)
    # friction begins at twice its final value
    assert finding.parameters["change"][0] == pytest.approx(-0.5, rel=0.1)


def test_saved_warm_up_predicts_the_next_recording():
    before, after = noise_ratios(session(is_one_clock=True))
    assert (after < 1.4).all() and before[0] > 1.5


@pytest.mark.slow
def test_without_a_clock_nothing_predicts_worse_than_the_base_model():
    before, after = noise_ratios(session(is_one_clock=False))
    assert (after <= 1.05 * np.maximum(before, 1.0)).all()
