"""Fourier series, ramps of constant jerk and complete motions from rest to rest."""

from __future__ import annotations

import dataclasses
import json

import msgspec
import numpy as np
import pytest
from conftest import off, slope
from hypothesis import given
from hypothesis import strategies as st

from excite.designer.ramps import reverse_profile
from excite.errors import UnusableInput
from excite.schemas import quantities
from excite.schemas.trajectory import SegmentDocument
from excite.trajectory.fourier import FourierSeries, oversampling_bound
from excite.trajectory.rest_to_rest import (
    JerkProfile,
    Motion,
    MotionSegment,
    segments_from_document,
    segments_to_document,
)


def series(seed: int, n: int = 3, harmonics: int = 4, period: float = 3.0) -> FourierSeries:
    rng = np.random.default_rng(seed)
    return FourierSeries(
        rng.normal(size=(n, harmonics)), rng.normal(size=(n, harmonics)), rng.normal(size=n), period
    )


def times(seed: int, count: int = 7) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-5, 5, count)


seeds = st.integers(0, 10**4)

# Fourier series


@given(seeds)
def test_position_equals_the_definition_of_the_series(seed):
    f, t = series(seed), times(seed)
    k = np.arange(1, 5) * 2 * np.pi / 3.0
    terms = [
        f.sine[:, i] / k[i] * np.sin(k[i] * t[:, None])
        - f.cosine[:, i] / k[i] * np.cos(k[i] * t[:, None])
        for i in range(4)
    ]
    assert np.allclose(f.at(t), f.offset + sum(terms), atol=1e-12)


@given(seeds, st.integers(0, 5))
def test_each_order_is_the_derivative_of_the_previous_order(seed, order):
    f, t = series(seed), times(seed)
    assert off(f.at(t, order + 1), slope(lambda h: f.at(t + h, order), 5e-3)) < 1e-6


@given(seeds, st.integers(-3, 3))
def test_series_is_periodic(seed, turns):
    f, t = series(seed), times(seed)
    assert np.allclose(f.at(t + turns * f.period), f.at(t), atol=1e-12)


@given(seeds, st.floats(-4, 4), st.integers(0, 3))
def test_shifted_series_starts_later(seed, shift, order):
    f, t = series(seed), times(seed)
    assert off(f.shifted(shift).at(t, order), f.at(t + shift, order)) < 1e-12


@given(seeds, st.floats(0.1, 1.0), st.integers(0, 3))
def test_slowed_series_takes_the_same_path(seed, speed, order):
    f, t = series(seed), times(seed)
    assert off(f.slowed(speed).at(t, order), f.at(t * speed, order) * speed**order) < 1e-12


def test_samples_are_position_velocity_acceleration():
    f, t = series(0), times(0)
    samples = f.samples(t)
    assert all(
        np.array_equal(part, f.at(t, order))
        for order, part in enumerate((samples.q, samples.dq, samples.ddq))
    )


@pytest.mark.parametrize("order", range(4))
def test_scalar_time_gives_one_row(delivery, order):
    motion = delivery.trajectory.motion
    ramp = motion.segments[0].profile
    for part in (motion, motion.fourier, ramp):
        for time in (0.0, 0.37, np.float64(1.0), np.array(0.2)):
            row = part.at(time, order)
            assert row.shape == (2,)
            assert np.allclose(row, part.at(np.array([float(time)]), order)[0], rtol=1e-12)


def test_grid_covers_one_period_without_its_end():
    assert np.allclose(series(0, period=3.0).grid(4), [0.0, 0.75, 1.5, 2.25])


# oversampling bound


@given(seeds, st.integers(1, 6), st.integers(1, 30), st.integers(0, 3))
def test_oversampling_bound_holds_between_samples(seed, harmonics, more, order):
    f = series(seed, harmonics=harmonics)
    count = 2 * harmonics + more
    swing = [
        np.abs(f.at(f.grid(n), order) - (f.offset if order == 0 else 0.0)).max(axis=0)
        for n in (count, 4001)
    ]
    assert (swing[1] <= oversampling_bound(count, harmonics) * swing[0] * (1 + 1e-12)).all()


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_oversampling_bound_is_attained(degree):
    count = 4 * degree
    wave = FourierSeries(np.eye(degree)[-1:], np.zeros((1, degree)), np.zeros(1), 1.0).shifted(
        0.5 / count
    )
    on_grid = np.abs(wave.at(wave.grid(count), 1)).max()
    assert np.isclose(oversampling_bound(count, degree) * on_grid, 1.0, rtol=1e-12)


def test_oversampling_bound_of_a_coarse_grid_is_infinite():
    assert oversampling_bound(10, 5) == np.inf


# profiles of constant jerk


def profile(seed: int) -> JerkProfile:
    rng = np.random.default_rng(seed)
    pieces = tuple(
        tuple(
            (float(d), float(j))
            for d, j in zip(rng.uniform(0.05, 0.4, k), rng.normal(size=k) * 9, strict=True)
        )
        for k in (3, 5)
    )
    return JerkProfile(*(rng.normal(size=2) for _ in range(3)), pieces)


@given(seeds, st.integers(0, 2))
def test_profile_orders_are_derivatives_of_each_other(seed, order):
    p = profile(seed)
    knots = p.knots()
    t = np.sort(np.concatenate([knots[:-1] + share * np.diff(knots) for share in (0.3, 0.6)]))
    h = 0.05 * np.diff(knots).min()
    assert off(p.at(t, order + 1), slope(lambda h: p.at(t + h, order), h)) < 1e-6


@given(seeds, st.integers(0, 2))
def test_profile_is_continuous_at_its_knots(seed, order):
    p = profile(seed)
    knots = p.knots()[1:]
    assert np.allclose(p.at(knots - 1e-11, order), p.at(knots + 1e-11, order), atol=1e-8)


def test_profile_starts_in_its_initial_state():
    p = profile(0)
    assert all(
        np.array_equal(p.at(np.zeros(1), order)[0], state)
        for order, state in enumerate((p.position, p.velocity, p.acceleration))
    )


@given(seeds)
def test_reversed_profile_runs_backwards(seed):
    p, duration = profile(seed), 2.5
    t = np.linspace(0, duration, 9)
    for order in range(3):
        assert np.allclose(
            reverse_profile(p, duration).at(t, order),
            (-1) ** order * p.at(duration - t, order),
            atol=1e-9,
        )


# complete motions


def test_motion_goes_from_approach_to_return(delivery):
    assert [s.kind for s in delivery.trajectory.motion.segments] == [
        "approach",
        "ramp_in",
        "fourier",
        "ramp_out",
        "return",
    ]


def test_motion_begins_and_ends_at_the_start_pose(delivery):
    motion = delivery.trajectory.motion
    assert np.allclose(motion.at(np.array([0.0, motion.duration])), [-1.5, 0.3], atol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_first_and_last_sample_are_exactly_at_rest(delivery, braked, order):
    for motion in (
        delivery.trajectory.motion,
        braked.trajectory.motion,
        delivery.trajectory.motion.slowed(0.3),
    ):
        for rate in (100.0, 125.0, 1000.0, 333.0):
            assert not motion.at(motion.grid(rate)[[0, -1]], order).any()


def test_motion_rests_before_and_after(delivery):
    motion = delivery.trajectory.motion
    outside = np.array([-1.0, motion.duration + 1.0])
    assert (
        np.array_equal(motion.at(outside), np.array(motion.end_poses))
        and not motion.at(outside, 1).any()
    )


def test_motion_is_continuous_to_its_acceleration(delivery, braked):
    for motion in (delivery.trajectory.motion, braked.trajectory.motion):
        fine = np.linspace(0, motion.duration, 60001)
        for order in range(3):
            step = np.abs(np.diff(motion.at(fine, order), axis=0))
            assert (
                step <= 1.01 * fine[1] * np.abs(motion.at(fine, order + 1)).max(axis=0) + 1e-7
            ).all()


def test_periods_of_the_fourier_part_are_equal(delivery):
    motion = delivery.trajectory.motion
    part = motion.segment("fourier")
    t = part.start + motion.fourier.grid(50)[1:]
    assert part.end - part.start == pytest.approx(2 * motion.fourier.period)
    assert np.allclose(motion.at(t), motion.at(t + motion.fourier.period), atol=1e-9)


def test_segments_lie_on_the_sampling_grid(delivery):
    motion = delivery.trajectory.motion
    ticks = np.array([edge * 100.0 for s in motion.segments for edge in (s.start, s.end)])
    assert np.allclose(ticks, np.round(ticks), atol=1e-9)


def test_grid_ends_at_or_after_the_motion(delivery):
    motion = delivery.trajectory.motion
    for rate in (100.0, 333.0):
        assert 0 <= motion.grid(rate)[-1] - motion.duration + 1e-6 < 1.001 / rate


def test_segments_survive_json_exactly(delivery):
    motion = delivery.trajectory.motion
    document = msgspec.convert(
        json.loads(json.dumps(segments_to_document(motion))),
        list[SegmentDocument],
        dec_hook=quantities.converted,
    )
    segments = segments_from_document(document, motion.joints, motion.fourier)
    again = dataclasses.replace(motion, segments=segments)
    t = motion.grid(1000.0)
    assert all(np.array_equal(again.at(t, order), motion.at(t, order)) for order in range(4))


@given(speed=st.floats(0.1, 1.0))
def test_slowed_motion_takes_the_same_path(delivery, speed):
    motion = delivery.trajectory.motion
    t = np.linspace(0.01, motion.duration - 0.01, 97) + 1e-4
    slow = motion.slowed(speed)
    for order in range(3):
        assert np.allclose(slow.at(t / speed, order), motion.at(t, order) * speed**order, atol=1e-7)


@pytest.mark.parametrize("speed", [0.0, -1.0, 1.5, np.nan])
def test_speed_out_of_range_is_refused(delivery, speed):
    with pytest.raises(UnusableInput, match="--speed"):
        delivery.trajectory.motion.slowed(speed)


def test_missing_segment_is_named():
    motion = Motion(("a", "b", "c"), series(0), 2, (MotionSegment("fourier", 0.0, 6.0),))
    with pytest.raises(KeyError, match="ramp_in"):
        motion.segment("ramp_in")
