"""Recording chain: how torque is recorded, relative to the positions.

Torque may be recorded on another clock than the positions, and both may have passed different
low-pass filters. Relative to the torque that the recorded motion needs, this is one frequency
response of all joints: a delay and a Butterworth filter of one to four poles, passed forwards, or
forwards and backwards (`delay`). The delay, with that of the filter at low frequencies, is removed
from the recorded torque, and the model passes the filter: to divide by a small gain would amplify
the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .._types import FloatArray
from ..effects.delay import LowPass
from ..effects.recorded_motion import RecordedMotion, interpolated
from ..identification.lowpass import Grid
from ..recordings.padding import with_response

DELAY_STD = 0.01
"""Prior standard deviation of the delay [s]."""
MIN_DELAY = 1e-5
"""Delay below which there is none [s]."""
CORNER_STD = 1.0
"""Prior standard deviation of the logarithm of the filter's corner frequency."""
PRIOR_STD = np.array([DELAY_STD, CORNER_STD])
"""Prior standard deviations of `columns`."""
MIN_CORNER = 6.0
"""Smallest corner frequency of usual filters of torque [Hz]."""


@dataclass(frozen=True)
class RecordingChain:
    """Delay and filter of the recorded torque.

    Attributes:
        delay: Time by which all torque is recorded late, at low frequencies [s].
        has_delay: False if torque and positions are known to have the same clock.
    """

    delay: float = 0.0
    filter: LowPass | None = None
    has_delay: bool = True

    def stepped(self, seconds: float, log_corner: float) -> RecordingChain:
        """Return the chain with another delay [s] and a step of the log corner frequency."""
        if self.filter is None:
            return replace(self, delay=seconds)
        corner = max(self.filter.hertz * float(np.exp(log_corner)), MIN_CORNER)
        return replace(self, delay=seconds, filter=self.filter.with_corner(corner))

    def on_one_clock(self) -> RecordingChain:
        """Return the chain of a recording whose torque and positions have the same clock."""
        return replace(self, delay=0.0, has_delay=False)

    def without_delay(self, motion: RecordedMotion) -> RecordedMotion:
        """Return a motion with torque from which the delay was removed."""
        if not self.delay:
            return motion
        at = motion.times + self.delay
        return motion.with_torque(interpolated(at, motion.times, motion.segment.torque))

    def without_filter(self, motion: RecordedMotion, torque: FloatArray) -> FloatArray:
        """Return filtered torque at every sample of a motion without the filter, (M, n) [N m]."""
        return torque if self.filter is None else self.filter.passed(motion, torque, inverse=True)

    def passed(self, motion: RecordedMotion, rows: FloatArray) -> FloatArray:
        """Return low-passed columns at the rows of a motion after the filter, shape (N, …)."""
        return rows if self.filter is None else _passed(motion, rows, self.filter)

    def gain(self, frequencies: FloatArray) -> FloatArray:
        """Return the gain at frequencies [Hz], shape (k,)."""
        return (
            np.ones(len(frequencies))
            if self.filter is None
            else np.abs(self.filter.response(frequencies))
        )


def _passed(
    motion: RecordedMotion, rows: FloatArray, low_pass: LowPass, slope: bool = False
) -> FloatArray:
    """Columns at the rows of a motion after a filter, or their derivative by its log corner."""
    rate = motion.band.rate_of(Grid.KEPT)
    return with_response(
        rows, lambda count: _response(low_pass, slope, count, rate), motion.band.periodic
    )


@lru_cache(64)
def _response(low_pass: LowPass, slope: bool, count: int, rate: float) -> NDArray[np.complex128]:
    """Frequency response of a filter at the frequencies of `count` rows, or its slope."""
    frequencies = np.asarray(np.fft.rfftfreq(count)) * rate
    return low_pass.slope(frequencies) if slope else low_pass.response(frequencies)


def columns(motion: RecordedMotion, modelled: FloatArray, chain: RecordingChain) -> FloatArray:
    """Return the change of the torque by the delay, per second, and by the filter, (N, n, 2).

    The slope is that of the recorded torque, from which a delay was removed, as its noise is
    uncorrelated with its own slope; the filter's is that of the modelled torque of a fit, shape
    (M, n) [N m], by the logarithm of the corner frequency.
    """
    slope = -motion.torque_slope if chain.has_delay else np.zeros((len(motion), motion.n))
    if chain.filter is None:
        return np.stack([slope, np.zeros_like(slope)], axis=2)
    passed = _passed(motion, motion.lowpass(modelled), chain.filter, slope=True)
    return np.stack([slope, passed], axis=2)
