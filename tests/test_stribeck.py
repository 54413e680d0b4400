"""Stribeck friction of a joint that moves slowly around reversals."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest
from diagnosis_cases import at_joint
from scipy.interpolate import CubicSpline
from synthetic_recordings import (
    FRICTION_WIDTH,
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    unexpected_columns,
    validated,
)

from excite._types import FloatArray
from excite.diagnosis import diagnosis, fitted_effects, interval
from excite.effects import EFFECTS_BY_NAME
from excite.effects.effect import CandidateModel, NonlinearParameterSet, RecordingDelay
from excite.recordings import Recording
from excite.robot.samples import Samples
from excite.trajectory.fourier import FourierSeries

HEIGHT, VELOCITY, CREEP = 1.5, 0.12, 0.15


class SlowReversals(FourierSeries):
    """A motion with slow reversals: a speed v becomes v³/(v² + c²)."""

    def samples(self, t: FloatArray) -> Samples:
        pace = np.linspace(0.0, self.period, 20001)
        speed = super().samples(pace).dq
        speed[-1] = speed[0]
        slowed = CubicSpline(pace, speed**3 / (speed**2 + CREEP**2), bc_type="periodic")
        gone, within = slowed.antiderivative(), np.mod(t, self.period)
        drift = gone(self.period) / self.period
        return Samples(
            gone(within) - within[:, None] * drift, slowed(within) - drift, slowed(within, 1)
        )


def recordings_with_slow_reversals(subject, friction) -> list[Recording]:
    psi, out = perturbed_parameters(subject.parameters, np.random.default_rng(4)), []
    for seed in (2, 5):
        plain = random_fourier(2, seed)
        slow = SlowReversals(plain.sine, plain.cosine, plain.offset, plain.period)
        recording = synthetic_recording(subject, psi, slow, 4, 0.0)
        noise = 0.02 * np.random.default_rng(seed).normal(size=recording.q.shape)
        out.append(
            dataclasses.replace(
                recording,
                tau=recording.tau
                + at_joint(0, friction(slow.samples(recording.t).dq[:, 0]))
                + noise,
                source=f"{seed}.csv",
            )
        )
    return out


FORMS = {
    "exponential": lambda x: np.exp(-x),
    "gaussian": lambda x: np.exp(-(x**2)),
    "rational": lambda x: 1.0 / (1.0 + (np.e - 1.0) * x**2),
}


@pytest.mark.parametrize("form", list(FORMS))
def test_slow_reversals_determine_the_amplitude_of_stribeck_friction(subject, form):
    """The base fit without Stribeck friction estimates a five times smaller friction width, and
    absorbs half of the effect."""
    train, held_out = recordings_with_slow_reversals(
        subject, lambda v: HEIGHT * np.tanh(v / FRICTION_WIDTH) * FORMS[form](np.abs(v) / VELOCITY)
    )
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    assert [(f.main.effect, f.main.joint) for f in result.verdict.findings] == [("stribeck", 0)]
    assert result.identified.model.widths[0] < 0.3 * FRICTION_WIDTH
    estimates = interval.finding_parameters(result.design, result.verdict, 0)
    assert estimates["amplitude"][0] == pytest.approx(HEIGHT, rel=0.05)
    assert estimates["velocity"][0] == pytest.approx(VELOCITY, rel=0.05)
    restored = [
        fitted_effects.restored(validated(fitted_effects.entry(part, subject.robot)), subject.robot)
        for part in result.parts
    ]
    np.testing.assert_allclose(
        fitted_effects.torque(restored, result.motions[1][0]),
        fitted_effects.torque(result.parts, result.motions[1][0]),
    )


def test_correlated_nonlinear_parameters_are_optimised_jointly():
    """Along a narrow ridge, a search in one parameter after the other would hardly move."""
    calls = []

    def gain(shape: CandidateModel) -> float:
        x, y = np.log([shape.values["a"], shape.values["b"]])
        calls.append(shape)
        return -1e3 * (x + y - 0.5) ** 2 - 2.0 * (x - y + 1.0) ** 2

    def shape(values: Mapping[str, float]) -> CandidateModel:
        return CandidateModel("drag", 0, unexpected_columns, dict(values))

    best, largest_gain = NonlinearParameterSet(
        {"a": (2.0, 0.1, 4.0), "b": (1.0, 0.1, 4.0)}, shape
    ).maximise(gain, -1e9)
    assert largest_gain > -0.1 and len(calls) < 150
    assert np.log([best.values["a"], best.values["b"]]) == pytest.approx([-0.25, 0.75], abs=0.05)
    bounded, _ = NonlinearParameterSet(
        {"a": (2.0, 1.0, 4.0), "b": (1.0, 0.1, 4.0)}, shape
    ).maximise(gain, -1e9)
    assert bounded.values["a"] == pytest.approx(1.0, abs=0.02)
    start = shape({"a": 2.0, "b": 1.0})
    assert NonlinearParameterSet({"a": (2.0, 0.1, 4.0), "b": (1.0, 0.1, 4.0)}, shape).maximise(
        gain, 1.0
    ) == (
        start,
        1.0,
    )


def test_variants_of_stribeck_friction_keep_the_delay_and_no_unresolved_width(subject):
    train, held_out = recordings_with_slow_reversals(subject, lambda v: 0.0 * v)
    motions = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    ).motions[0]
    first = next(s for s in EFFECTS_BY_NAME["stribeck"].candidates(motions))
    assert [set(variant.current.values) for variant in first.variants()] == [
        {"velocity", "exponent", "width", "usual"},
        {"velocity", "exponent", "width", "usual", "rational"},
    ]
    delayed = first.delayed(RecordingDelay(0.004), 0)
    assert all(
        variant.current.values["late"] == 0.004
        and variant.current.nonlinear.at(0.1).values["late"] == 0.004
        for variant in delayed.variants()
    )
    coarse = [
        dataclasses.replace(t, segment=dataclasses.replace(t.segment, encoder=np.full(2, 1e-3)))
        for t in motions
    ]
    hidden = next(s for s in EFFECTS_BY_NAME["stribeck"].candidates(coarse))
    assert [set(variant.current.values) for variant in hidden.variants()] == [
        {"velocity", "exponent"},
        {"velocity", "exponent", "rational"},
    ]
