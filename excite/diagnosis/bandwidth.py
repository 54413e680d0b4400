"""Choice of the cutoff frequency of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..identification import position_bandwidth, segments
from ..identification.lowpass import MOTION_BANDWIDTH_RATIO
from ..identification.segments import RecordingSegment
from ..robot.robot import Robot

MIN_CUTOFF = 20.0
"""Smallest cutoff frequency [Hz]."""
MOTION_MULTIPLE = 6.0
"""Cutoff over the highest frequency of the motion. Products of joint motions and reversals create
harmonics that distinguish friction models: those of a fast servo need 22 Hz, 5 times its motion;
at 10 times, other errors dominate."""
MAX_MOTION_CUTOFF = 50.0
"""Largest cutoff by the motion [Hz]; what would need more is encoder noise."""
MAX_CUTOFF = 250.0
"""Largest cutoff chosen from the data [Hz]."""
LINE_RATIO = 30.0
"""Power of a spectral line over the median power above the motion."""
MIN_LINE_SHARE = 0.15
"""Share of a joint's torque power in lines above the motion from which the cutoff includes them."""
MIN_REMAINING_SHARE = 0.02
"""Share of the power in lines that may remain above the cutoff."""
CUTOFF_MARGIN = 1.2
"""Cutoff over the frequency of the highest line."""
MAX_RATE_SHARE = 0.4
"""Largest cutoff, or bandwidth of the motion, over the sample rate."""


def chosen_hertz(
    train: Sequence[RecordingSegment], validate: Sequence[RecordingSegment], robot: Robot
) -> float:
    """Return the cutoff frequency that the longest segment needs and its positions permit [Hz].

    Args:
        train: Segments of the training recordings.
        validate: Segments of the held-out recordings, of which only length and rate count.
        robot: The robot.
    """
    longest = max(train, key=len)
    carried = position_bandwidth.position_bandwidth(longest, robot)
    usable = max(segments.usable_from_hertz(group) for group in (train, validate))
    slowest = min(segment.rate for segment in (*train, *validate))
    return min(_needed_hertz(longest), max(carried, usable), MAX_RATE_SHARE * slowest)


def _needed_hertz(longest: RecordingSegment) -> float:
    """Cutoff frequency that a segment needs [Hz].

    It includes the harmonics of the motion, and spectral lines above it that carry much of a
    joint's torque, as of a gear or motor that turns steadily.
    """
    from scipy import signal  # slow to import

    if longest.rate <= 2.5 * MIN_CUTOFF:
        return MIN_CUTOFF
    needed = MOTION_MULTIPLE * segments.motion_bandwidth(longest)
    rate_limit = MAX_RATE_SHARE * longest.rate / MOTION_BANDWIDTH_RATIO
    cutoff = max(MIN_CUTOFF, min(needed, rate_limit)) if needed < MAX_MOTION_CUTOFF else MIN_CUTOFF
    frequency, power = signal.welch(
        longest.torque, longest.rate, nperseg=min(len(longest), int(2.0 * longest.rate)), axis=0
    )
    above = (frequency > cutoff) & (frequency < min(MAX_CUTOFF, rate_limit))
    if not above.any():
        return cutoff
    line = above[:, None] & (power > LINE_RATIO * np.median(power[above], axis=0))
    share = np.where(line, power, 0.0) / np.maximum(power.sum(axis=0), 1e-300)
    if share.sum(axis=0).max() < MIN_LINE_SHARE:
        return cutoff
    # a varying speed spreads a line over many frequencies, so that their sum counts
    remaining = np.cumsum(share[::-1], axis=0)[::-1].max(axis=1)
    return float(CUTOFF_MARGIN * frequency[np.flatnonzero(remaining > MIN_REMAINING_SHARE)[-1]])
