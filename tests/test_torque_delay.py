"""What is recorded late, as a whole."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import signal
from synthetic_recordings import validated
from test_diagnosis import PLANTED, found, on, recordings_of, slips

from excite.diagnosis import diagnosis, fitted_effects, interval, late, search
from excite.diagnosis.diagnosis import Diagnosis
from excite.effects import EFFECTS_BY_NAME
from excite.effects.effect import RecordingDelay
from excite.identification.lowpass import Grid, LowPassFilter
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording

Array = np.ndarray


@pytest.fixture(scope="module")
def nothing(subject: IdentificationModel) -> Diagnosis:
    return found(subject, None)


@pytest.mark.parametrize("periodic", [True, False])
def test_a_signal_below_the_band_comes_later_by_what_is_asked(periodic):
    t, seconds = np.arange(4000) / 500.0, 0.0137
    band = LowPassFilter(20.0, 500.0, len(t), periodic)
    wave = lambda t: np.sin(2.0 * np.pi * 3.0 * t) + 0.3 * np.cos(2.0 * np.pi * 11.25 * t + 1.0)  # noqa: E731
    moved = band.filter(wave(t), Grid.RECORDED, delay=seconds)
    kept = slice(band.margin, len(t) - band.margin)
    np.testing.assert_allclose(
        moved[kept], wave(t - seconds)[kept], atol=1e-9 if periodic else 2e-3
    )


@pytest.mark.parametrize("periodic", [True, False])
def test_a_signal_below_the_band_passes_a_filter_of_first_order(periodic):
    t, lag = np.arange(4000) / 500.0, 0.0137
    band = LowPassFilter(20.0, 500.0, len(t), periodic)
    wave = lambda f, late: np.sin(2.0 * np.pi * f * t - late)  # noqa: E731
    passed = band.filter(wave(3.0, 0.0) + 0.3 * wave(11.25, 0.0), Grid.RECORDED, time_constant=lag)
    angles = [2.0 * np.pi * f * lag for f in (3.0, 11.25)]
    expected = sum(
        size * wave(f, np.arctan(a)) / np.hypot(1.0, a)
        for size, f, a in zip((1.0, 0.3), (3.0, 11.25), angles, strict=True)
    )
    kept = slice(band.margin, len(t) - band.margin)
    np.testing.assert_allclose(passed[kept], expected[kept], atol=1e-9 if periodic else 3e-3)


def test_what_is_late_at_one_joint_is_in_time_at_others(nothing):
    one, seconds = nothing.motions[0][0], 0.011
    every = dataclasses.replace(
        one, grid=Grid.RECORDED, kept=slice(0, len(one.segment)), time=one.times
    )
    shapes = list(EFFECTS_BY_NAME["elasticity"].candidates([one]))
    shape = next(s for s in shapes if s.joint == 0)
    now, then = shape.columns(every), shape.delayed(RecordingDelay(seconds), 0).columns(every)
    moved = np.column_stack(
        [np.interp(one.times - seconds, one.times, column) for column in now[:, 0].T]
    )
    inner = slice(500, -500)
    np.testing.assert_allclose(then[inner, 0], moved[inner], atol=2e-3 * np.abs(now[:, 0]).max())
    np.testing.assert_array_equal(then[:, 1], now[:, 1])
    assert np.abs(now[:, 1]).max() > 0.0


def test_what_a_track_remembers_is_found_once_for_all_that_see_it_later(nothing):
    one = dataclasses.replace(nothing.motions[0][0])  # remembers nothing yet
    assert not one.cache
    later = [one.delayed(seconds, lagging) for seconds, lagging in ((0.004, False), (0.006, True))]
    assert later[0].link_jacobians is later[1].link_jacobians is one.link_jacobians
    assert not dataclasses.replace(
        one, fitted_robot=one.fitted_robot
    ).cache  # another base model's are others


def test_what_is_turned_stays_as_late(nothing):
    shape = next(
        s for s in EFFECTS_BY_NAME["hysteresis"].candidates(nothing.motions[0]) if s.joint == 1
    )
    then = shape.delayed(RecordingDelay(0.004), 1)
    assert then.nonlinear is not None
    kin = [knob.at(knob.value) for knob in then.variants()]
    for other in (
        then.nonlinear.at(1.3 * then.nonlinear.value),
        *kin,
        *(own.delayed(RecordingDelay(0.004), None) for own in kin),
    ):
        assert other.values["late"] == 0.004
    assert kin and {other.values["springs"] for other in kin} == {3.0, 5.0}


def delayed(one: Recording, seconds: float, joint: int) -> Recording:
    """A recording whose torque of a joint comes late, with the noise of a sensor that does not."""
    tau = one.torque.copy()
    tau[:, joint] = np.interp(one.t - seconds, one.t, tau[:, joint])
    return dataclasses.replace(one, tau=tau)


def filtered(one: Recording, lag: float) -> Recording:
    """A recording whose torque has passed a filter of first order, as controllers log it, with the
    noise of a sensor that does not."""
    keep = np.exp(-1.0 / (one.rate * lag))
    tau, start = one.torque, keep * one.torque[:1]
    return dataclasses.replace(
        one, tau=np.asarray(signal.lfilter([1.0 - keep], [1.0, -keep], tau, axis=0, zi=start)[0])
    )


@pytest.mark.parametrize("effect", [None, "stribeck"])
def test_torque_that_was_filtered_is_told_as_that_and_hides_nothing(subject, effect):
    train, held_out = (
        filtered(one, 0.015)
        for one in recordings_of(subject, None if effect is None else PLANTED[effect][0])
    )
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    named = [(f.main.effect, f.main.joint) for f in result.verdict.findings]
    assert (
        named == [("delay", None), *([(effect, PLANTED[effect][1])] if effect else [])]
        and not result.unknown
    )
    value, std = interval.finding_parameters(result.design, result.verdict, 0)["seconds"]
    keep = np.exp(-1.0 / (500.0 * 0.015))
    assert (
        abs(value - keep / (1.0 - keep) / 500.0) < 2.0 * std and std < 0.003
    )  # of steps, not of the continuous filter
    assert (result.after < 1.6 * result.expected).all()
    again = [
        fitted_effects.restored(validated(fitted_effects.entry(part, subject.robot)), subject.robot)
        for part in result.parts
    ]
    along = result.motions[1][0]
    np.testing.assert_allclose(
        fitted_effects.torque(again, along), fitted_effects.torque(result.parts, along)
    )


@pytest.mark.parametrize(
    ("effect", "seconds", "plant"),
    [
        ("torque_ripple", 0.02, lambda t, q, dq, tau: on(1, 2.5 * np.cos(17.0 * q[:, 1] + 0.4))),
        ("hysteresis", 0.015, lambda t, q, dq, tau: on(1, 4.0 * slips(q[:, 1], np.array([0.02])))),
    ],
)
def test_an_effect_that_comes_late_with_all_the_rest_is_named_beside_the_delay(
    subject, effect, seconds, plant
):
    train, held_out = (delayed(one, seconds, 1) for one in recordings_of(subject, plant))
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    named = [(f.main.effect, f.main.joint) for f in result.verdict.findings[:2]]
    assert set(named) == {(effect, 1), ("delay", 1)} and not result.unknown
    value, std = interval.finding_parameters(
        result.design, result.verdict, named.index(("delay", 1))
    )["seconds"]
    assert abs(value - seconds) < 2.0 * std < 0.3 * seconds
    assert (result.after < 1.6 * result.expected).all()
    together = result.verdict.together
    assert together is not None
    ways = [
        s.values["late"]
        for s in (result.design.shapes[i] for i in together.shapes)
        if s.effect != "delay"
    ]
    again = [
        fitted_effects.restored(validated(fitted_effects.entry(part, subject.robot)), subject.robot)
        for part in result.parts
    ]
    along = result.motions[1][0]
    np.testing.assert_allclose(
        fitted_effects.torque(again, along), fitted_effects.torque(result.parts, along)
    )
    assert ways and ways == pytest.approx([value] * len(ways), rel=0.15)


def test_what_is_in_time_stays_so(subject):
    result = found(subject, PLANTED["delay"][0])
    assert [h.effect for h in result.verdict.chosen] == ["delay"]
    assert late.followed(result.design, result.verdict) == (result.design, result.verdict)


def test_a_delay_that_friction_s_memory_bends_to_is_tried(nothing):
    """Only where that leaves something, and no delay was found."""
    one = nothing.design
    hysteresis = next(
        i for i, shape in enumerate(one.shapes) if shape.effect == "hysteresis" and shape.joint == 1
    )
    told = late._hidden(one, search.trial(one, [hysteresis]))
    assert late._worth(told, {0, 1}) == {1: RecordingDelay(late.USUAL)}
    assert late._worth(told, {0}) == {} == late._hidden(one, search.trial(one, []))
