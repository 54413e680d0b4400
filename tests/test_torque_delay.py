"""Delays and filters of the recorded torque."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from diagnosis_cases import EFFECTS, at_joint, diagnose_effect, maxwell_slip_force, recordings_of
from scipy import signal
from synthetic_recordings import validated

from excite.diagnosis import diagnosis, fitted_effects, interval, late, search
from excite.diagnosis.diagnosis import Diagnosis
from excite.effects import EFFECTS_BY_NAME
from excite.effects.effect import RecordingDelay
from excite.identification.lowpass import Grid, LowPassFilter
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording


@pytest.fixture(scope="module")
def without_effects(subject: IdentificationModel) -> Diagnosis:
    return diagnose_effect(subject, None)


@pytest.mark.parametrize("periodic", [True, False])
def test_a_signal_below_the_cutoff_is_delayed_exactly(periodic):
    t, seconds = np.arange(4000) / 500.0, 0.0137
    lowpass = LowPassFilter(20.0, 500.0, len(t), periodic)

    def wave(t):
        return np.sin(2.0 * np.pi * 3.0 * t) + 0.3 * np.cos(2.0 * np.pi * 11.25 * t + 1.0)

    moved = lowpass.filter(wave(t), Grid.RECORDED, delay=seconds)
    kept = slice(lowpass.margin, len(t) - lowpass.margin)
    np.testing.assert_allclose(
        moved[kept], wave(t - seconds)[kept], atol=1e-9 if periodic else 2e-3
    )


@pytest.mark.parametrize("periodic", [True, False])
def test_a_signal_below_the_cutoff_passes_a_first_order_filter(periodic):
    t, lag = np.arange(4000) / 500.0, 0.0137
    lowpass = LowPassFilter(20.0, 500.0, len(t), periodic)
    wave = lambda f, phase: np.sin(2.0 * np.pi * f * t - phase)  # noqa: E731
    passed = lowpass.filter(
        wave(3.0, 0.0) + 0.3 * wave(11.25, 0.0), Grid.RECORDED, time_constant=lag
    )
    angles = [2.0 * np.pi * f * lag for f in (3.0, 11.25)]
    expected = sum(
        size * wave(f, np.arctan(a)) / np.hypot(1.0, a)
        for size, f, a in zip((1.0, 0.3), (3.0, 11.25), angles, strict=True)
    )
    kept = slice(lowpass.margin, len(t) - lowpass.margin)
    np.testing.assert_allclose(passed[kept], expected[kept], atol=1e-9 if periodic else 3e-3)


def test_a_delay_at_a_joint_does_not_affect_others(without_effects):
    motion, seconds = without_effects.motions[0][0], 0.011
    complete = dataclasses.replace(
        motion, grid=Grid.RECORDED, kept=slice(0, len(motion.segment)), time=motion.times
    )
    shapes = list(EFFECTS_BY_NAME["elasticity"].candidates([motion]))
    shape = next(s for s in shapes if s.joint == 0)
    columns, delayed_columns = (
        shape.columns(complete),
        shape.delayed(RecordingDelay(seconds), 0).columns(complete),
    )
    expected = np.column_stack(
        [np.interp(motion.times - seconds, motion.times, column) for column in columns[:, 0].T]
    )
    inner = slice(500, -500)
    np.testing.assert_allclose(
        delayed_columns[inner, 0], expected[inner], atol=2e-3 * np.abs(columns[:, 0]).max()
    )
    np.testing.assert_array_equal(delayed_columns[:, 1], columns[:, 1])
    assert np.abs(columns[:, 1]).max() > 0.0


def test_delayed_motions_share_cached_quantities(without_effects):
    motion = dataclasses.replace(without_effects.motions[0][0])  # with an empty cache
    assert not motion.cache
    delayed_motions = [
        motion.delayed(seconds, lagging) for seconds, lagging in ((0.004, False), (0.006, True))
    ]
    assert (
        delayed_motions[0].link_jacobians
        is delayed_motions[1].link_jacobians
        is motion.link_jacobians
    )
    assert not dataclasses.replace(
        motion, fitted_robot=motion.fitted_robot
    ).cache  # they depend on the base model


def test_variants_of_a_delayed_model_are_delayed(without_effects):
    shape = next(
        s
        for s in EFFECTS_BY_NAME["hysteresis"].candidates(without_effects.motions[0])
        if s.joint == 1
    )
    delayed_model = shape.delayed(RecordingDelay(0.004), 1)
    assert delayed_model.nonlinear is not None
    variants = [parameter.at(parameter.value) for parameter in delayed_model.variants()]
    for model in (
        delayed_model.nonlinear.at(1.3 * delayed_model.nonlinear.value),
        *variants,
        *(variant.delayed(RecordingDelay(0.004), None) for variant in variants),
    ):
        assert model.values["late"] == 0.004
    assert variants and {model.values["springs"] for model in variants} == {3.0, 5.0}


def delayed(recording: Recording, seconds: float, joint: int) -> Recording:
    """Return a recording with a delayed torque of a joint, noise included."""
    tau = recording.torque.copy()
    tau[:, joint] = np.interp(recording.t - seconds, recording.t, tau[:, joint])
    return dataclasses.replace(recording, tau=tau)


def filtered(recording: Recording, lag: float) -> Recording:
    """Return a recording whose torque has passed a first-order filter of the controller."""
    keep = np.exp(-1.0 / (recording.rate * lag))
    tau, start = recording.torque, keep * recording.torque[:1]
    return dataclasses.replace(
        recording,
        tau=np.asarray(signal.lfilter([1.0 - keep], [1.0, -keep], tau, axis=0, zi=start)[0]),
    )


@pytest.mark.parametrize("effect", [None, "stribeck"])
def test_filtered_torque_is_reported_as_a_delay_and_hides_no_effect(subject, effect):
    train, held_out = (
        filtered(recording, 0.015)
        for recording in recordings_of(subject, None if effect is None else EFFECTS[effect][0])
    )
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    reported = [(f.main.effect, f.main.joint) for f in result.verdict.findings]
    assert (
        reported == [("delay", None), *([(effect, EFFECTS[effect][1])] if effect else [])]
        and not result.unknown
    )
    value, std = interval.finding_parameters(result.design, result.verdict, 0)["seconds"]
    keep = np.exp(-1.0 / (500.0 * 0.015))
    assert (
        abs(value - keep / (1.0 - keep) / 500.0) < 2.0 * std and std < 0.003
    )  # of the discrete filter
    assert (result.after < 1.6 * result.expected).all()
    restored = [
        fitted_effects.restored(validated(fitted_effects.entry(part, subject.robot)), subject.robot)
        for part in result.parts
    ]
    motion = result.motions[1][0]
    np.testing.assert_allclose(
        fitted_effects.torque(restored, motion), fitted_effects.torque(result.parts, motion)
    )


@pytest.mark.parametrize(
    ("effect", "seconds", "plant"),
    [
        (
            "torque_ripple",
            0.02,
            lambda t, q, dq, tau: at_joint(1, 2.5 * np.cos(17.0 * q[:, 1] + 0.4)),
        ),
        (
            "hysteresis",
            0.015,
            lambda t, q, dq, tau: at_joint(1, 4.0 * maxwell_slip_force(q[:, 1], np.array([0.02]))),
        ),
    ],
)
def test_a_delayed_effect_is_reported_jointly_with_the_delay(subject, effect, seconds, plant):
    train, held_out = (
        delayed(recording, seconds, 1) for recording in recordings_of(subject, plant)
    )
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    reported = [(f.main.effect, f.main.joint) for f in result.verdict.findings[:2]]
    assert set(reported) == {(effect, 1), ("delay", 1)} and not result.unknown
    value, std = interval.finding_parameters(
        result.design, result.verdict, reported.index(("delay", 1))
    )["seconds"]
    assert abs(value - seconds) < 2.0 * std < 0.3 * seconds
    assert (result.after < 1.6 * result.expected).all()
    together = result.verdict.together
    assert together is not None
    delays = [
        s.values["late"]
        for s in (result.design.shapes[i] for i in together.shapes)
        if s.effect != "delay"
    ]
    restored = [
        fitted_effects.restored(validated(fitted_effects.entry(part, subject.robot)), subject.robot)
        for part in result.parts
    ]
    motion = result.motions[1][0]
    np.testing.assert_allclose(
        fitted_effects.torque(restored, motion), fitted_effects.torque(result.parts, motion)
    )
    assert delays and delays == pytest.approx([value] * len(delays), rel=0.15)


def test_no_further_delay_is_added(subject):
    result = diagnose_effect(subject, EFFECTS["delay"][0])
    assert [h.effect for h in result.verdict.chosen] == ["delay"]
    assert late.followed(result.design, result.verdict) == (result.design, result.verdict)


def test_a_delay_is_tried_that_hysteresis_could_fit(without_effects):
    """Only at joints with a residual and without a delay."""
    regression = without_effects.design
    hysteresis = next(
        i
        for i, shape in enumerate(regression.shapes)
        if shape.effect == "hysteresis" and shape.joint == 1
    )
    hidden = late._hidden(regression, search.trial(regression, [hysteresis]))
    assert late._worth(hidden, {0, 1}) == {1: RecordingDelay(late.USUAL)}
    assert late._worth(hidden, {0}) == {} == late._hidden(regression, search.trial(regression, []))
