"""Frequency up to which recorded positions carry the acceleration that the torque shows.

Two derivatives amplify errors of the positions with the square of the frequency: timestamp jitter,
a low sampling rate, a logger that interpolates. The nominal torque computed from the positions then
exceeds the measured torque, at all joints and the more the higher the frequency, by factors of 10
to 10⁵ in power. That needs no estimate of the noise, and a nominal model that is wrong by a factor
is wrong by it at low frequencies, too.
"""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from ..robot.robot import Robot
from ..robot.samples import Samples
from .lowpass import Grid, LowPassFilter
from .nominal_comparison import nominal_torque
from .segments import RecordingSegment, motion_bandwidth

MAX_POWER_RATIO = 5.0
"""Power of the nominal over that of the measured torque, over the same ratio within the bandwidth
of the motion, above which positions carry no acceleration [1]. It stays below 2 on recordings with
even stamps (EMPS, TX40, KR300, simulated arms); where positions jitter it passes 5 within a band
and reaches 50 to 10⁵."""
MIN_JOINT_SHARE = 0.5
"""Share of the joints at which it must be exceeded [1]: jitter and interpolation act on all."""
TORQUE_SHARE = 0.95
"""Share of the torque's power that bounds the bandwidth of the motion [1]."""
BIN_RATIO = 1.25
"""Ratio of the edges of a band, a third of an octave [1]."""
MAX_SAMPLES = 16_384
"""Number of samples of the segment that are compared, which bounds the time to a second."""
LOWEST_HZ = 0.5
"""Lowest frequency of a band [Hz]."""
MAX_RATE_SHARE = 0.4
"""Highest frequency over the sampling rate [1]."""
HIGHEST_HZ = 50.0
"""Highest frequency [Hz]: above it links and gears of an arm are not rigid."""


def position_bandwidth(segment: RecordingSegment, robot: Robot) -> float:
    """Return the frequency up to which positions carry accelerations, ∞ without a limit [Hz].

    Args:
        segment: A segment of a recording.
        robot: The robot with its nominal parameters.
    """
    from scipy import signal  # slow to import

    part = segment if segment.periodic else segment.head(MAX_SAMPLES)
    top = min(MAX_RATE_SHARE * part.rate, HIGHEST_HZ)
    spectrum = LowPassFilter(top, part.rate, len(part), part.periodic).transform(part.q)
    motion = Samples(*(spectrum.filter(Grid.RECORDED, order) for order in range(3)))
    gravity, dynamic = nominal_torque(robot, motion)
    nominal = gravity + dynamic
    size = min(len(part), max(256, int(4.0 * part.rate)))
    frequency, measured_power = signal.welch(part.torque, part.rate, nperseg=size, axis=0)
    _, nominal_power = signal.welch(nominal, part.rate, nperseg=size, axis=0)
    # positions that jitter much show motion at all frequencies, the torque does not
    bandwidth = min(motion_bandwidth(part), _torque_bandwidth(frequency, measured_power))
    slow = (frequency > 0.0) & (frequency <= max(bandwidth, LOWEST_HZ))
    if not slow.any():
        return float(np.inf)
    reference = np.maximum(_ratio(nominal_power[slow], measured_power[slow]), 1.0)
    edges = LOWEST_HZ * BIN_RATIO ** np.arange(np.log(top / LOWEST_HZ) / np.log(BIN_RATIO) + 1e-9)
    previous: float | None = None
    for low, high in zip(edges, [*edges[1:], top], strict=True):
        rows = (frequency >= low) & (frequency < high)
        if not rows.any():
            continue
        ratio = _ratio(nominal_power[rows], measured_power[rows])
        if np.mean(ratio > MAX_POWER_RATIO * reference) < MIN_JOINT_SHARE:
            previous = None
        elif previous is not None:  # in two bands in a row: a single one may be a gap of the motion
            return max(previous, bandwidth)
        else:
            previous = float(low)
    return float(np.inf)


def _torque_bandwidth(frequency: FloatArray, power: FloatArray) -> float:
    """Frequency below which TORQUE_SHARE of the torque's power lies, mean over the joints [Hz]."""
    share = np.cumsum(power[1:] / np.maximum(power[1:].sum(axis=0), 1e-300), axis=0).mean(axis=1)
    place = min(int(np.searchsorted(share, TORQUE_SHARE)), len(share) - 1)
    return float(frequency[1:][place])


def _ratio(nominal: FloatArray, measured: FloatArray) -> FloatArray:
    """Nominal over measured power per joint, 0 where neither has any. Shapes (F, n) -> (n,)."""
    above, below = nominal.sum(axis=0), measured.sum(axis=0)
    return np.where(above > 0.0, above / np.maximum(below, 1e-300), 0.0)
