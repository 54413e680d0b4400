"""Noise of the recorded positions, and coarse encoders, give no effect."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from diagnosis_cases import (
    HIDDEN,
    diagnose,
    diagnosed,
    findings_of,
    known_failures,
    motions,
    recordings_of,
)

from excite._types import FloatArray
from excite.diagnosis import position_errors
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.estimates import Rejection
from excite.diagnosis.position_errors import PositionErrors
from excite.recordings import Recording

NOISE = {"noise of 3e-5 rad": 3e-5, "noise of 1e-4 rad": 1e-4}
"""Standard deviations of white noise of the positions [rad]."""
STEPS = {"14 bits": 4e-4, "12 bits": 1.5e-3}
"""Steps of encoders [rad]."""

SLOW = ("noise of 3e-5 rad", "14 bits", "12 bits")
"""Errors of positions whose tests are slow."""


def recorded(kind: str, effect: str | None = None, seed: int = 0) -> list[Recording]:
    """Return recordings whose positions have noise, or steps."""
    rng = np.random.default_rng(seed)

    def disturbed(q: FloatArray) -> FloatArray:
        if kind in NOISE:
            return q + NOISE[kind] * rng.normal(size=q.shape)
        return np.round(q / STEPS[kind] + rng.uniform()) * STEPS[kind]

    recordings = recordings_of(None if effect is None else HIDDEN[effect].torque)
    return [dataclasses.replace(r, q=disturbed(r.q)) for r in recordings]


@cache
def without_effects(kind: str) -> Diagnosis:
    """Return the diagnosis of a robot without effects."""
    return diagnose(recorded(kind))


@pytest.mark.parametrize("kind", known_failures([*NOISE, *STEPS], {}, SLOW))
def test_errors_of_positions_are_no_effect(kind):
    assert findings_of(without_effects(kind)) == []


@pytest.mark.parametrize(
    "kind",
    known_failures(
        [*NOISE, *STEPS],
        {"12 bits": "what repeats differs between draws of the encoders' origins"},
        SLOW,
    ),
)
def test_errors_of_positions_are_no_unknown_torque(kind):
    assert without_effects(kind).unmodelled == ()


def test_noise_of_positions_is_found():
    motion = motions()[0]
    rng, std = np.random.default_rng(0), np.array([3e-5, 2e-4])
    noisy = motion.segment.q + std * rng.normal(size=motion.segment.q.shape)
    segment = dataclasses.replace(motion.segment, q=noisy)
    estimate = position_errors.position_noise(dataclasses.replace(motion, segment=segment))
    np.testing.assert_allclose(estimate, std, rtol=0.1)


def test_positions_without_noise_have_none():
    assert (position_errors.position_noise(motions()[0]) < 1e-7).all()


def test_exact_positions_are_no_evidence():
    result = diagnosed("stribeck")
    errors = PositionErrors(result.identified, result.model.motions)
    assert errors.evidence((), result.model) == {}


@pytest.mark.parametrize("kind", known_failures([*NOISE, *STEPS], {}, SLOW))
def test_reason_is_stated(kind):
    considered = without_effects(kind).considered
    assert Rejection.ERRORS_OF_POSITIONS in [e.rejection for e in considered]
