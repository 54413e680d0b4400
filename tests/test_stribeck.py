"""Stribeck's curve of a joint that creeps as it turns back."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from synthetic_recordings import (
    FRICTION_WIDTH,
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    unexpected_columns,
    validated,
)
from test_diagnosis import on

from excite.diagnosis import diagnosis, fitted_effects, interval
from excite.effects import EFFECTS_BY_NAME
from excite.effects.effect import CandidateModel, NonlinearParameterSet, RecordingDelay
from excite.recordings import Recording
from excite.robot.samples import Samples
from excite.trajectory.fourier import FourierSeries

Array = np.ndarray
HEIGHT, VELOCITY, CREEP = 1.5, 0.12, 0.15


class Creeping(FourierSeries):
    """A motion whose joints go slowly about where they turn back: at a speed v of the usual, by
    v³/(v² + c²)."""

    def samples(self, t: Array) -> Samples:
        pace = np.linspace(0.0, self.period, 20001)
        speed = super().samples(pace).dq
        speed[-1] = speed[0]
        slowed = CubicSpline(pace, speed**3 / (speed**2 + CREEP**2), bc_type="periodic")
        gone, within = slowed.antiderivative(), np.mod(t, self.period)
        drift = gone(self.period) / self.period
        return Samples(
            gone(within) - within[:, None] * drift, slowed(within) - drift, slowed(within, 1)
        )


def creeping(subject, law) -> list[Recording]:
    psi, out = perturbed_parameters(subject.parameters, np.random.default_rng(4)), []
    for seed in (2, 5):
        plain = random_fourier(2, seed)
        slow = Creeping(plain.sine, plain.cosine, plain.offset, plain.period)
        one = synthetic_recording(subject, psi, slow, 4, 0.0)
        noise = 0.02 * np.random.default_rng(seed).normal(size=one.q.shape)
        out.append(
            dataclasses.replace(
                one,
                tau=one.tau + on(0, law(slow.samples(one.t).dq[:, 0])) + noise,
                source=f"{seed}.csv",
            )
        )
    return out


LAWS = {
    "exponential": lambda x: np.exp(-x),
    "gaussian": lambda x: np.exp(-(x**2)),
    "rational": lambda x: 1.0 / (1.0 + (np.e - 1.0) * x**2),
}


@pytest.mark.parametrize("law", list(LAWS))
def test_a_joint_that_creeps_as_it_turns_back_tells_how_high_stribecks_curve_is(subject, law):
    """The base fit, which knows nothing of it, takes friction's step for five times as sharp as it
    is, and half of the curve with it."""
    train, held_out = creeping(
        subject, lambda v: HEIGHT * np.tanh(v / FRICTION_WIDTH) * LAWS[law](np.abs(v) / VELOCITY)
    )
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    assert [(f.main.effect, f.main.joint) for f in result.verdict.findings] == [("stribeck", 0)]
    assert result.identified.model.widths[0] < 0.3 * FRICTION_WIDTH
    told = interval.finding_parameters(result.design, result.verdict, 0)
    assert told["amplitude"][0] == pytest.approx(HEIGHT, rel=0.05)
    assert told["velocity"][0] == pytest.approx(VELOCITY, rel=0.05)
    again = [
        fitted_effects.restored(validated(fitted_effects.entry(part, subject.robot)), subject.robot)
        for part in result.parts
    ]
    np.testing.assert_allclose(
        fitted_effects.torque(again, result.motions[1][0]),
        fitted_effects.torque(result.parts, result.motions[1][0]),
    )


def test_values_that_make_up_for_each_other_are_turned_together():
    """Along a narrow ridge, one by one, they would hardly move."""
    asked = []

    def gain(shape: CandidateModel) -> float:
        x, y = np.log([shape.values["a"], shape.values["b"]])
        asked.append(shape)
        return -1e3 * (x + y - 0.5) ** 2 - 2.0 * (x - y + 1.0) ** 2

    def shape(values: Mapping[str, float]) -> CandidateModel:
        return CandidateModel("drag", 0, unexpected_columns, dict(values))

    best, most = NonlinearParameterSet(
        {"a": (2.0, 0.1, 4.0), "b": (1.0, 0.1, 4.0)}, shape
    ).maximise(gain, -1e9)
    assert most > -0.1 and len(asked) < 150
    assert np.log([best.values["a"], best.values["b"]]) == pytest.approx([-0.25, 0.75], abs=0.05)
    bounded, _ = NonlinearParameterSet(
        {"a": (2.0, 1.0, 4.0), "b": (1.0, 0.1, 4.0)}, shape
    ).maximise(gain, -1e9)
    assert bounded.values["a"] == pytest.approx(1.0, abs=0.02)
    where = shape({"a": 2.0, "b": 1.0})
    assert NonlinearParameterSet({"a": (2.0, 0.1, 4.0), "b": (1.0, 0.1, 4.0)}, shape).maximise(
        gain, 1.0
    ) == (
        where,
        1.0,
    )


def test_stribecks_curve_turned_is_as_late_and_has_no_width_that_an_encoder_hides(subject):
    train, held_out = creeping(subject, lambda v: 0.0 * v)
    tracks = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    ).motions[0]
    first = next(s for s in EFFECTS_BY_NAME["stribeck"].candidates(tracks))
    assert [set(near.current.values) for near in first.variants()] == [
        {"velocity", "exponent", "width", "usual"},
        {"velocity", "exponent", "width", "usual", "rational"},
    ]
    late = first.delayed(RecordingDelay(0.004), 0)
    assert all(
        near.current.values["late"] == 0.004
        and near.current.nonlinear.at(0.1).values["late"] == 0.004
        for near in late.variants()
    )
    coarse = [
        dataclasses.replace(t, segment=dataclasses.replace(t.segment, encoder=np.full(2, 1e-3)))
        for t in tracks
    ]
    hidden = next(s for s in EFFECTS_BY_NAME["stribeck"].candidates(coarse))
    assert [set(near.current.values) for near in hidden.variants()] == [
        {"velocity", "exponent"},
        {"velocity", "exponent", "rational"},
    ]
