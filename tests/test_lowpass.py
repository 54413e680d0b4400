"""The low-pass filter: exact derivatives below the cutoff, zero phase, sensible cutoffs only."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_recordings import PERIOD, RATE, random_fourier

from excite.errors import UnusableInput
from excite.identification.lowpass import Grid, LowPassFilter


def test_derivatives_of_periodic_signals_are_exact_below_the_cutoff():
    fourier = random_fourier(2)
    t = np.arange(round(PERIOD * RATE)) / RATE
    band = LowPassFilter(10.0, RATE, len(t), periodic=True)
    for order in range(3):
        assert np.allclose(
            band.filter(fourier.at(t), Grid.RECORDED, order), fourier.at(t, order), atol=1e-9
        )
    kept = band.filter(fourier.at(t), Grid.KEPT)
    assert np.allclose(kept, fourier.at(np.arange(len(kept)) * PERIOD / len(kept)), atol=1e-12)


def test_aperiodic_signals_lose_what_is_above_the_cutoff_and_keep_their_phase_below():
    t = np.arange(4000) / RATE
    slow, fast = np.sin(2 * np.pi * 3.1 * t + 0.3), np.sin(2 * np.pi * 31.0 * t)
    band = LowPassFilter(10.0, RATE, len(t))
    inner = slice(band.margin, len(t) - band.margin)
    filtered = band.filter((slow + fast)[:, None], Grid.RECORDED)
    assert np.abs(filtered[inner, 0] - slow[inner]).max() < 1e-3


@pytest.mark.parametrize("hertz", [0.0, -1.0, RATE])
def test_a_cutoff_outside_zero_and_the_nyquist_frequency_is_refused(hertz):
    with pytest.raises(UnusableInput, match="--band"):
        LowPassFilter(hertz, RATE, 1000)
