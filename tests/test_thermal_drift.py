"""Friction that depends on a recorded temperature, or on heating by the joint's own power."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from diagnosis_cases import (
    COULOMB,
    VISCOUS,
    added_torque,
    at_joint,
    diagnose,
    effect_entry,
    findings_of,
    friction_sign,
    model_with_effects,
    motions,
    noise_ratios,
    parameters,
    recordings_of,
)
from scipy import integrate, signal
from slow_tests import slow

from excite._types import FloatArray
from excite.diagnosis import fitted_effects
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.diagnosis_file import document
from excite.effects import EFFECTS_BY_NAME, thermal_drift
from excite.effects.effect import CandidateModel
from excite.effects.recorded_motion import Grid, RecordedMotion
from excite.errors import UnusableInput
from excite.recordings import Recording

PER_DEGREE = -0.02
"""Relative change of friction per degree [1/K]."""
TEMPERATURES = {2: (24.0, 30.0), 8: (30.0, 33.0), 5: (38.0, 33.0)}
"""Temperature of the first joint at start and end of each recording, by its seed [°C]."""


def speed_of(recording: Recording) -> FloatArray:
    """Return the speed of the first joint, shape (N,)."""
    return np.asarray(np.gradient(recording.q[:, 0], recording.t))


def warmer_recordings(dry: bool) -> list[Recording]:
    """Return recordings, the last of which is the warmest; only the first joint has a sensor.

    dry: Coulomb friction changes as viscous friction does.
    """
    out = []
    for recording, (start, end) in zip(
        recordings_of(None, tuple(TEMPERATURES)), TEMPERATURES.values(), strict=True
    ):
        degrees = start + (end - start) * recording.t / recording.t[-1]
        speed = speed_of(recording)
        friction = VISCOUS[0] * speed + dry * COULOMB[0] * friction_sign(speed)
        changed = PER_DEGREE * (degrees - TEMPERATURES[2][0]) * friction
        warm = np.column_stack([degrees, np.full(len(degrees), np.nan)])
        out.append(
            dataclasses.replace(added_torque(recording, at_joint(0, changed)), temperature=warm)
        )
    return out


@cache
def diagnosed_warmer(dry: bool) -> Diagnosis:
    """Return the diagnosis of recordings at several temperatures."""
    return diagnose(warmer_recordings(dry))


@pytest.mark.parametrize("dry", [True, slow(False)])
def test_temperature_dependent_friction_predicts_a_warmer_recording(dry):
    result = diagnosed_warmer(dry)
    before, after = noise_ratios(result)
    assert findings_of(result) == [("thermal_drift", 0)] and not result.unmodelled
    assert after[0] < 1.3 and before[0] > 1.5


@pytest.mark.parametrize("dry", [True, slow(False)])
def test_the_temperature_and_not_time_is_the_cause(dry):
    (finding, *_) = document(diagnosed_warmer(dry))["findings"]
    assert finding["where"]["statement"] == "joint 'joint_1': friction changes with temperature"
    assert finding["where"]["regime"] == "temperature"
    assert "time_constant" not in finding["parameters"]
    change = finding["parameters"]["change"]
    span = 33.0 - 24.0  # of the training recordings
    assert PER_DEGREE * span - 2.0 * change["std"] < change["value"] < 0.0
    if dry:
        assert change["value"] == pytest.approx(PER_DEGREE * span, rel=0.1)


def test_a_prediction_needs_the_temperature_column():
    values = {"reference": 30.0, "coulomb": 1.5, "viscous": 0.8}
    model = model_with_effects(effect_entry("thermal_drift", "joint_1", values, PER_DEGREE))
    warm = warmer_recordings(True)[-1]
    without = fitted_effects.predict(model_with_effects(), warm)[1]
    assert np.abs(fitted_effects.predict(model, warm)[1] - without).max() > 0.05
    with pytest.raises(UnusableInput, match=r"5\.csv: .*no column temp\.joint_1"):
        fitted_effects.predict(model, dataclasses.replace(warm, temperature=None))


@pytest.mark.slow
def test_self_heating_follows_the_power_of_friction():
    """T ϑ̇ = p/p̄ − ϑ over motions that start and end at rest; a model of run time alone would have
    another time constant."""
    constant, change, heated = 4.0, -0.5, []
    recordings = recordings_of(None)
    frictions = [COULOMB[0] * friction_sign(v) + VISCOUS[0] * v for v in map(speed_of, recordings)]
    powers = [f * speed_of(r) for f, r in zip(frictions, recordings, strict=True)]
    usual = float(np.mean(np.concatenate(powers)))
    for recording, friction, power in zip(recordings, frictions, powers, strict=True):
        t = recording.t
        warm = integrate.solve_ivp(
            lambda at, x, t=t, power=power: (np.interp(at, t, power) / usual - x) / constant,
            (t[0], t[-1]),
            [0.0],
            t_eval=t,
            max_step=0.05,
        ).y[0]
        heated.append(added_torque(recording, at_joint(0, change * warm * friction)))
    result = diagnose(heated)
    assert findings_of(result) == [("thermal_drift", 0)] and noise_ratios(result)[1][0] < 1.3
    statement = document(result)["findings"][0]["where"]["statement"]
    assert statement.endswith("its own power heats the joint")
    estimates = parameters(result, "thermal_drift", 0)
    assert estimates["time_constant"][0] == pytest.approx(constant, rel=0.1)


def self_heating(motion: RecordedMotion, constant: float) -> CandidateModel:
    """Return the model of self-heating of the first joint with a time constant [s]."""
    shapes = EFFECTS_BY_NAME["thermal_drift"].candidates([motion])
    shape = next(s for s in shapes if s.joint == 0 and "power" in s.values)
    assert shape.nonlinear is not None
    return shape.nonlinear.at(constant)


@pytest.mark.slow
def test_friction_that_follows_its_power_within_half_a_second_is_no_thermal_drift():
    """Heat takes longer: the cause is not known."""
    recordings = recordings_of(None)
    speeds = [speed_of(recording) for recording in recordings]
    frictions = [COULOMB[0] * friction_sign(v) + VISCOUS[0] * v for v in speeds]
    usual = float(np.mean(np.concatenate([f * v for f, v in zip(frictions, speeds, strict=True)])))
    changed = []
    for recording, friction, speed in zip(recordings, frictions, speeds, strict=True):
        decay = np.exp(-1.0 / (recording.rate * 0.5))
        warm = signal.lfilter([0.0, 1.0 - decay], [1.0, -decay], friction * speed / usual)
        changed.append(added_torque(recording, at_joint(0, 0.5 * warm * friction)))
    result = diagnose(changed)
    assert all(effect != "thermal_drift" for effect, _ in findings_of(result))
    assert 0 in [finding.joint for finding in result.unmodelled]


@pytest.mark.parametrize("constant", [1.0, 4.0, 15.0])
def test_plausible_self_heating_keeps_friction_positive(constant):
    """Fast at first, then slow: the joint is much warmer than at its mean power."""
    motion = motions()[0]
    q = motion.segment.q.copy()
    slow = len(q) // 3
    q[slow:] = q[slow] + 0.1 * (q[slow:] - q[slow])
    uneven = dataclasses.replace(motion, segment=dataclasses.replace(motion.segment, q=q))
    shape = self_heating(uneven, constant)
    warm = thermal_drift.warming_by_losses(uneven, shape)
    for c in np.linspace(-4.0, -0.01, 200):
        if shape.is_plausible(np.array([c])):
            assert 1.0 + c * (warm.max() - warm.mean()) > -1e-9


@pytest.mark.parametrize("power", [True, False])
def test_self_heating_continues_over_a_gap_of_the_recording(power):
    motion = motions()[0]
    shape = self_heating(motion, 6.0)
    if not power:
        values = {key: value for key, value in shape.values.items() if key != "power"}
        shape = dataclasses.replace(shape, values=values)
    segment, middle = motion.segment, len(motion.segment) // 2
    later = dataclasses.replace(
        segment,
        q=segment.q[middle:],
        torque=segment.torque[middle:],
        start=float(motion.times[middle]),
        recording_start=segment.start,
    )
    complete, after = (
        shape.columns(dataclasses.replace(motion, segment=piece, grid=Grid.RECORDED))[:, 0, 0]
        for piece in (segment, later)
    )
    inside = slice(80, -80)  # without the ends, which the filter affects
    error = complete[middle:][inside] - after[inside]
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(after[inside] ** 2))
