"""Friction that depends on a recorded temperature, or on heating by the joint's own power."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from diagnosis_cases import (
    at_joint,
    diagnose_effect,
    effect_entry,
    model_with_effects,
    recordings_of,
)
from scipy import integrate
from synthetic_recordings import FRICTION_WIDTH, perturbed_parameters

from excite.diagnosis import diagnosis, fitted_effects, interval
from excite.diagnosis.diagnosis_file import document
from excite.effects import EFFECTS_BY_NAME, thermal_drift
from excite.effects.effect import CandidateModel
from excite.effects.recorded_motion import Grid, RecordedMotion
from excite.errors import UnusableInput
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording

PER_DEGREE = -0.02
"""Relative change of friction per degree [1/K]."""
TEMPERATURES = (24.0, 30.0), (38.0, 33.0)
"""Temperature of the first joint at the start and at the end of both recordings [°C]."""


def warmer_recordings(subject: IdentificationModel, dry: bool) -> list[Recording]:
    """Return two recordings, the second warmer; only the first joint has a sensor.

    dry: Coulomb friction changes as viscous friction does.
    """
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    coulomb, viscous = (
        float(psi[subject.parameters.block(kind)][0]) for kind in ("coulomb", "viscous")
    )
    out = []
    for recording, (start, end) in zip(recordings_of(subject, None), TEMPERATURES, strict=True):
        degrees = start + (end - start) * (recording.t - recording.t[0]) / (
            recording.t[-1] - recording.t[0]
        )
        speed = np.gradient(recording.q[:, 0], recording.t)
        changed = (
            PER_DEGREE
            * (degrees - TEMPERATURES[0][0])
            * (viscous * speed + dry * coulomb * np.tanh(speed / FRICTION_WIDTH))
        )
        warm = np.column_stack([degrees, np.full(len(degrees), np.nan)])
        out.append(
            dataclasses.replace(
                recording, tau=recording.torque + at_joint(0, changed), temperature=warm
            )
        )
    return out


@pytest.mark.parametrize("dry", [True, False])
def test_temperature_dependent_friction_is_reported_and_predicts_a_warmer_recording(subject, dry):
    train, held_out = warmer_recordings(subject, dry)
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == [
        ("thermal_drift", 0)
    ] and not result.unknown
    assert result.after[0] < 1.3 * result.floor[0] and result.before[0] > 1.5 * result.floor[0]
    finding = document(result)["findings"][0]
    assert finding["where"]["statement"] == "joint 'joint_1': friction changes with temperature"
    assert (
        finding["where"]["regime"] == "temperature" and "time_constant" not in finding["parameters"]
    )
    change, std = interval.finding_parameters(result.design, result.verdict, 0)["change"]
    span = TEMPERATURES[1][0] - TEMPERATURES[0][0]
    if dry:
        assert change == pytest.approx(PER_DEGREE * span, rel=0.1)
    assert PER_DEGREE * span - 2.0 * std < change < 0.0


def test_without_temperature_columns_no_such_effect_is_reported(subject):
    train, held_out = (
        dataclasses.replace(recording, temperature=None)
        for recording in warmer_recordings(subject, True)
    )
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    assert all("reference" not in shape.values for shape in result.design.shapes)
    assert result.after[0] > 1.3 * result.floor[0]


def test_a_prediction_needs_the_temperature_column(subject):
    values = {"reference": 30.0, "coulomb": 1.5, "viscous": 0.8}
    model, warm = (
        model_with_effects(
            subject, (effect_entry("thermal_drift", "joint_1", values, PER_DEGREE),)
        ),
        warmer_recordings(subject, True)[1],
    )
    without = fitted_effects.predict(model_with_effects(subject, ()), warm)[1]
    assert np.abs(fitted_effects.predict(model, warm)[1] - without).max() > 0.05
    with pytest.raises(UnusableInput, match=r"5\.csv: .*no column temp\.joint_1"):
        fitted_effects.predict(model, dataclasses.replace(warm, temperature=None))


def test_self_heating_follows_the_power_of_friction(subject):
    """T ϑ̇ = p/p̄ − ϑ over motions that start and end at rest; a model of run time alone would have
    another time constant."""
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    coulomb, viscous = (
        float(psi[subject.parameters.block(kind)][0]) for kind in ("coulomb", "viscous")
    )
    constant, change, recordings, powers = 4.0, -0.5, [], []
    for recording in recordings_of(subject, None):
        speed = np.gradient(recording.q[:, 0], recording.t)
        friction = coulomb * np.tanh(speed / FRICTION_WIDTH) + viscous * speed
        recordings.append((recording, friction, friction * speed))
        powers.append(float(np.mean(friction * speed)))
    heated_recordings = []
    for recording, friction, power in recordings:
        warm = integrate.solve_ivp(
            lambda t, x, recording=recording, power=power: (
                (np.interp(t, recording.t, power) / np.mean(powers) - x) / constant
            ),
            (recording.t[0], recording.t[-1]),
            [0.0],
            t_eval=recording.t,
            max_step=0.05,
        ).y[0]
        heated_recordings.append(
            dataclasses.replace(
                recording, tau=recording.torque + at_joint(0, change * warm * friction)
            )
        )
    result = diagnosis.diagnose(
        subject.robot,
        subject.parameters,
        subject.base,
        [heated_recordings[0]],
        [heated_recordings[1]],
    )
    (finding,) = result.verdict.chosen
    assert (finding.effect, finding.joint) == (
        "thermal_drift",
        0,
    ) and "power" in result.design.shapes[finding.shape].values
    assert document(result)["findings"][0]["where"]["statement"].endswith(
        "its own power heats the joint"
    )
    estimates = interval.finding_parameters(result.design, result.verdict, 0)
    assert estimates["time_constant"][0] == pytest.approx(constant, rel=0.1) and estimates[
        "change"
    ][0] == pytest.approx(change, rel=0.1)
    assert result.after[0] < 1.3 * result.floor[0]


def heated(subject: IdentificationModel, constant: float) -> tuple[RecordedMotion, CandidateModel]:
    motion = diagnose_effect(subject, None).motions[0][0]
    shapes = EFFECTS_BY_NAME["thermal_drift"].candidates([motion])
    return motion, next(s for s in shapes if s.joint == 0 and "power" in s.values).nonlinear.at(
        constant
    )


@pytest.mark.parametrize("constant", [1.0, 4.0, 15.0])
def test_plausible_self_heating_keeps_friction_positive(subject, constant):
    """Fast at first, then slow: the joint is much warmer than at its mean power."""
    motion, _ = heated(subject, constant)
    q = motion.segment.q.copy()
    slow = len(q) // 3
    q[slow:] = q[slow] + 0.1 * (q[slow:] - q[slow])
    uneven = dataclasses.replace(motion, segment=dataclasses.replace(motion.segment, q=q))
    shapes = EFFECTS_BY_NAME["thermal_drift"].candidates([uneven])
    shape = next(s for s in shapes if s.joint == 0 and "power" in s.values).nonlinear.at(constant)
    warm = thermal_drift.warming_by_losses(uneven, shape)
    for c in np.linspace(-4.0, -0.01, 200):
        if shape.is_plausible(np.array([c])):
            assert 1.0 + c * (warm.max() - warm.mean()) > -1e-9


@pytest.mark.parametrize("power", [True, False])
def test_self_heating_continues_over_a_gap_of_the_recording(subject, power):
    motion, shape = heated(subject, 6.0)
    if not power:
        shape = dataclasses.replace(
            shape, values={k: v for k, v in shape.values.items() if k != "power"}
        )
    middle, start = len(motion.segment) // 2, motion.segment.start
    later = dataclasses.replace(
        motion.segment,
        q=motion.segment.q[middle:],
        torque=motion.segment.torque[middle:],
        start=float(motion.times[middle]),
        recording_start=start,
    )
    complete, after = (
        shape.columns(
            dataclasses.replace(
                motion, segment=piece, grid=Grid.RECORDED, kept=slice(0, len(piece))
            )
        )[:, 0, 0]
        for piece in (motion.segment, later)
    )
    inside = slice(200, -200)  # without the ends, which the filter affects
    error = complete[middle:][inside] - after[inside]
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(after[inside] ** 2))
