"""Segments of recordings: mean periods, their noise, gaps, and the choice of the cutoff."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from synthetic_recordings import (
    PERIOD,
    RATE,
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    two_link_model,
)

from excite._types import FloatArray
from excite.identification import regression, segments
from excite.identification.lowpass import TAPER_FRACTION
from excite.identification.regression import IdentificationModel


@pytest.fixture(scope="module")
def model() -> IdentificationModel:
    return two_link_model()


@pytest.fixture(scope="module")
def truth(model: IdentificationModel) -> FloatArray:
    """ψ of a robot that differs from the URDF by about 10 %, with friction."""
    return perturbed_parameters(model.parameters, np.random.default_rng(4))


def test_long_segments_give_the_same_equations_in_chunks(model, truth, monkeypatch):
    recording = synthetic_recording(
        model, truth, random_fourier(2), 30, 0.0, period=None, periodic=None
    )
    complete = regression.build_equations(model, segments.extract_segments([recording]), 10.0)
    monkeypatch.setattr(segments, "CHUNK_SAMPLES", 4096)
    chunked = regression.build_equations(model, segments.extract_segments([recording]), 10.0)
    assert len(chunked) == len(complete) and chunked.starts == complete.starts
    assert np.allclose(chunked.time, complete.time)
    assert (
        0.0 < np.abs(chunked.torque - complete.torque).max() < 1e-3 * np.abs(complete.torque).max()
    )
    assert (
        np.abs(chunked.regressor - complete.regressor).max()
        < 2e-3 * np.abs(complete.regressor).max()
    )


def test_periods_are_averaged_and_their_deviations_give_the_noise_floor(model, truth):
    recording = synthetic_recording(model, truth, random_fourier(2), 8, 0.5)
    (segment,) = segments.extract_segments([recording])
    assert (segment.periods, len(segment)) == (8, round(PERIOD * RATE))
    in_band = 0.5 * np.sqrt(20.0 / (RATE / 2))
    assert np.allclose(segments.noise_floor([segment], 20.0), in_band, rtol=0.1)
    passed = np.sqrt(1.0 - TAPER_FRACTION * 5.0 / 8.0)  # mean square of half a raised cosine: 3/8
    assert np.allclose(
        segments.noise_floor([segment], 20.0, tapered=True),
        passed * segments.noise_floor([segment], 20.0),
        rtol=0.02,
    )


@pytest.mark.parametrize("period", [PERIOD, 5.2017])
def test_periods_interrupted_by_a_gap_are_left_out(model, truth, period):
    recording = synthetic_recording(model, truth, random_fourier(2, period=period), 6.1, 0.01)
    turns = recording.t / period
    gap = ((turns > 2.2) & (turns < 2.3)) | ((turns > 3.9) & (turns < 3.95))
    (segment,) = segments.extract_segments([recording.rows(~gap)])
    assert segment.periods == len(segment.noise) == 4
    # interpolation across a gap would deviate by newton metres
    assert np.sqrt(np.mean(np.square(segment.noise))) < 0.02


def test_a_period_without_a_window_applies_to_the_whole_recording(model, truth):
    recording = synthetic_recording(model, truth, random_fourier(2), 4, 0.0)
    without_window = dataclasses.replace(
        recording, sidecar=dataclasses.replace(recording.sidecar, periodic=None)
    )
    (first,) = segments.extract_segments([recording])
    (second,) = segments.extract_segments([without_window])
    assert first.periods == second.periods == 4
    assert np.array_equal(first.torque, second.torque)


def test_a_period_of_a_fractional_number_of_samples_is_interpolated(model, truth):
    fourier = random_fourier(2, period=5.2017)
    (segment,) = segments.extract_segments([synthetic_recording(model, truth, fourier, 4.1, 0.0)])
    expected = fourier.at(segment.start + np.arange(len(segment)) / segment.rate)
    assert segment.periods == 4 and np.abs(segment.q - expected).max() < 1e-6


def test_the_cutoff_follows_the_motion_and_the_noise(model, truth):
    low_noise, high_noise = (
        segments.torque_spectra(
            list(
                segments.extract_segments(
                    [synthetic_recording(model, truth, random_fourier(2), 6, noise)]
                )
            )
        )
        for noise in (1e-4, 30.0)
    )
    assert low_noise.hertz == pytest.approx(20.0)
    assert high_noise.hertz < 0.8 * low_noise.hertz
    assert low_noise.motion == pytest.approx(4 / PERIOD, rel=0.5)
