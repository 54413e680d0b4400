"""Recording chain: how torque is recorded, relative to the positions.

Torque may be recorded later than the positions, on another clock, and both may have passed
different low-pass filters: those of the drives, of the logger, of whoever stored the file. Relative
to the torque that the recorded motion needs, this is one frequency response of all joints. Up to
the cutoff frequency f_c its logarithm is a polynomial of x = f/f_c (the cumulants of its impulse
response),

    ln H(f) = −2πi f d + a x² − i p x³ + b x⁴,   a ≤ 0, a + 2b ≤ 0: the gain falls,

with the delay d; p = 0 for a filter without phase. Without the filter, torque whose steps were
smoothed would be taken for presliding hysteresis of every joint. The delay is removed from the
recorded torque, and the model passes the filter: to divide by a small gain would amplify the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._types import FloatArray
from ..effects import delay
from ..effects.recorded_motion import RecordedMotion
from ..identification.lowpass import Grid
from ..recordings.padding import with_response
from ..schemas.effects import FILTER_COEFFICIENTS
from .regression import FIXED_STD

DELAY_STD = 0.01
"""Prior standard deviation of the delay [s]."""
MIN_DELAY = 1e-5
"""Delay below which there is none [s]."""
FILTER_HERTZ = 20.0
"""Frequency at which the prior standard deviation of the filter, by a, p or b, is a factor of e
[Hz]: no one filters a robot's torque at much less."""
COLUMNS = 1 + FILTER_COEFFICIENTS
"""Columns of a recording chain: the delay, then the filter."""


@dataclass(frozen=True)
class RecordingChain:
    """Delay and filter of the recorded torque.

    Attributes:
        delay: Time by which all torque is recorded late [s].
        filter: Coefficients a, p and b.
    """

    delay: float = 0.0
    filter: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def is_filtered(self) -> bool:
        """True if the torque has passed a filter."""
        return any(self.filter)

    def without_delay(self, motion: RecordedMotion) -> FloatArray:
        """Return the recorded torque of a motion without the delay, shape (M, n) [N m].

        Args:
            motion: The motion as it is recorded.
        """
        torque, t = motion.segment.torque, motion.times
        if self.delay:
            torque = motion.torque_spline(np.clip(t + self.delay, t[0], t[-1]))
        return np.asarray(torque)

    def without_filter(self, motion: RecordedMotion, torque: FloatArray) -> FloatArray:
        """Return torque at every sample of a motion without the filter, shape (M, n) [N m].

        Args:
            motion: The motion.
            torque: Torque that has passed the filter, shape (M, n) [N m].
        """
        if not self.is_filtered:
            return torque
        return delay.filtered(motion, torque, -np.array(self.filter), motion.band.hertz)

    def passed(self, motion: RecordedMotion, rows: FloatArray) -> FloatArray:
        """Return columns at the rows of a motion after the filter, shape (N, …).

        Args:
            motion: The motion.
            rows: Low-passed columns, shape (N, …).
        """
        if not self.is_filtered:
            return rows
        rate = motion.band.rate_of(Grid.KEPT)

        def response(frequency: FloatArray) -> NDArray[np.complex128]:
            return delay.filter_response(
                np.array(self.filter), frequency * rate / motion.band.hertz
            )

        return with_response(rows, response, motion.band.periodic)

    def gain(self, frequencies: FloatArray, hertz: float) -> FloatArray:
        """Return the gain at frequencies up to the cutoff frequency, shape (k,).

        Args:
            frequencies: The frequencies [Hz], shape (k,).
            hertz: The cutoff frequency [Hz].
        """
        return np.abs(delay.filter_response(np.array(self.filter), frequencies / hertz))


def columns(
    motion: RecordedMotion, modelled: FloatArray | None, chain: RecordingChain
) -> FloatArray:
    """Return the change of the torque by the delay, per second, and by a, p and b, (N, n, 4).

    The slope is that of the recorded torque, whose noise is uncorrelated with its own slope; it is
    correlated with even derivatives, so that the filter's columns are those of modelled torque.

    Args:
        motion: The motion, with the torque from which a delay was removed.
        modelled: Torque of a fit, shape (M, n) [N m]; of the base model if None.
        chain: The present recording chain.
    """
    slope = -motion.band.filter(motion.segment.torque, Grid.KEPT, 1)[motion.kept]
    torque = motion.motor_torque if modelled is None else modelled
    of_filter = delay.filter_columns(motion, torque, motion.band.hertz)
    return np.concatenate([slope[:, :, None], chain.passed(motion, of_filter)], axis=2)


def prior_std(joints: int, hertz: float) -> FloatArray:
    """Return the prior standard deviations of the columns, shape (4,).

    The filter of a single joint cannot be told from the dynamics of the joint, and is none.

    Args:
        joints: Number of joints.
        hertz: Cutoff frequency [Hz].
    """
    of_filter = (hertz / FILTER_HERTZ) ** np.arange(2.0, 5.0)
    if joints == 1:
        of_filter = np.full(len(of_filter), FIXED_STD)
    return np.array([DELAY_STD, *of_filter])


def low_pass(coefficients: FloatArray, information: FloatArray) -> FloatArray:
    """Return the most probable coefficients of a low-pass filter, shape (3,).

    Args:
        coefficients: Coefficients of either sign, shape (3,).
        information: Their information, shape (3, 3).
    """
    from scipy.optimize import lsq_linear  # slow to import

    root = np.linalg.cholesky(information + 1e-12 * np.diag(np.diag(information) + 1e-300)).T
    of_slopes = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.5, 0.0, 0.5]])  # a, p, a + 2b
    bounds = (-np.inf, [0.0, np.inf, 0.0])
    slopes = lsq_linear(root @ of_slopes, root @ coefficients, bounds).x
    if slopes[0] + slopes[2] > -1e-6:  # on both bounds, but for rounding
        return np.zeros(FILTER_COEFFICIENTS)
    return np.asarray(of_slopes @ slopes)
