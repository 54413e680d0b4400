"""The band that a diagnosis needs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..identification import segments
from ..identification.lowpass import MOTION_BANDWIDTH_RATIO
from ..identification.segments import RecordingSegment

BAND_HZ, REACH, HIGHEST = 20.0, 6.0, 50.0
"""The band, at the least; or so many times the highest frequency of the motion: what joints' products and reversals make there tells laws
apart. A fast servo's friction is told apart from 22 Hz on, at 5 times its motion; at 10 times, other things weigh more. What would need
more than the last [Hz] is no motion but an encoder's noise."""
FASTEST, LINE = 250.0, 30.0
"""Highest band chosen by the data [Hz]; a spectral line is so many times as high as what is between them."""
LINES = 0.15
"""Share of a joint's torque in lines above the motion, from which the band reaches them."""


def needed_hertz(pieces: Sequence[RecordingSegment]) -> float:
    """What the motion needs, or the lines that make much of the torque above it: a gear or a motor that turns steadily, at its order."""
    from scipy import signal  # slow to import

    longest = max(pieces, key=len)
    if longest.rate <= 2.5 * BAND_HZ:
        return BAND_HZ
    needed = REACH * segments.motion_bandwidth(longest)
    least = max(BAND_HZ, min(needed, 0.4 * longest.rate / MOTION_BANDWIDTH_RATIO)) if needed < HIGHEST else BAND_HZ
    frequency, power = signal.welch(
        longest.torque, longest.rate, nperseg=min(len(longest), int(2.0 * longest.rate)), axis=0
    )
    above = (frequency > least) & (frequency < min(FASTEST, 0.4 * longest.rate / MOTION_BANDWIDTH_RATIO))
    if not above.any():
        return least
    line = above[:, None] & (power > LINE * np.median(power[above], axis=0))
    share = np.where(line, power, 0.0) / np.maximum(power.sum(axis=0), 1e-300)
    if share.sum(axis=0).max() < LINES:
        return least
    further = np.cumsum(share[::-1], axis=0)[::-1].max(
        axis=1
    )  # in all lines from there on: a speed that varies spreads each over many
    return float(1.2 * frequency[np.flatnonzero(further > 0.02)[-1]])
