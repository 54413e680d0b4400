"""Timestamp jitter: rows with even stamps whose positions were read at other times, the same for
all joints.

    q_j = x_j + ẋ_j δ,

with motion x_j and one timing error δ per row for all joints, as where the loop of a logger is
late. In a single joint it looks like encoder noise; after two derivatives it dominates the residual
of a model. Above the frequencies of the motion only δ moves all joints in the ratio of their
velocities; there it is detected and its variance σ² estimated. Below, its maximum a posteriori
estimate is

    δ̂ = argmin Σ_j ‖S_j^(-1/2) (q_j − ẋ_j δ)‖² + ‖δ‖²/σ²,

with the spectra S_j of the motion, which are estimated in turn with δ (a Wiener filter along a
time-varying direction, solved by conjugate gradients). Torque is not corrected: its error τ̇ δ is
not amplified by derivatives.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from .._types import FloatArray
from .padding import pad_by_reflection
from .time_axis import gap_free_slices

MOTION_HZ = 10.0
"""Frequency up to which velocities are estimated [Hz]."""
NOISE_HZ = 30.0
"""Frequency above which positions hold no motion [Hz]."""
MAX_CORRECTED_HZ = 45.0
"""Frequency up to which the maximum a posteriori estimate is computed [Hz]."""
MIN_CORRECTED_HZ = 2.0
"""Frequency below which no jitter is estimated, as it cannot be told from the motion [Hz]."""
MIN_RATE_RATIO = 4.0
"""Smallest sampling rate over NOISE_HZ [1]."""
MIN_PREDICTED_SHARE = 0.5
"""Share of a joint's power above NOISE_HZ that the other joints must predict, in two joints at
least [1]. Of independent noise they predict less than nothing."""
MIN_JITTER = 5e-6
"""Standard deviation of jitter that is not worth a correction [s]."""
RELATIVE_ROUNDING = 1e-12
"""High-pass filtered positions over the largest position below which they are rounding errors
[1]."""
VELOCITY_REGULARIZATION = 1e-3
"""Term added to the squared velocities, as a share of their mean: where all joints stand, δ is not
observable [1]."""
SPECTRUM_ITERATIONS = 4
"""Number of times that the spectra are estimated."""
MAX_CG_ITERATIONS = 300
"""Largest number of conjugate gradient iterations."""
CG_TOLERANCE = 1e-6
"""Relative residual at which they stop [1]."""
SMOOTHING_BANDWIDTH = 0.2
"""Half width over which a spectrum is smoothed, as a share of the frequency [1]."""
MIN_MOTION_SHARE = 0.05
"""Share of a spectrum that is attributed to the motion at least, in the first iteration [1]."""
TESTED_STRETCHES = 3
"""Number of stretches in which jitter is detected."""
PADDING_TIME = 1.0
"""Time by which a stretch is continued at its ends [s]."""
MAX_STRETCH_TIME = 60.0
"""Longest stretch that is processed at once [s]."""
EDGE_TIME = 0.2
"""Time at the ends of a stretch that filters distort [s]."""
TINY = 1e-300
"""Term that keeps divisors positive."""


@dataclass(frozen=True)
class TimestampJitter:
    """Estimated timing error of each row.

    Attributes:
        delay: Time by which each row was read after its stamp. Shape (N,) [s].
        velocity: Velocities of the motion. Shape (N, n) [rad/s or m/s].
        rms: Standard deviation of the error, including what `delay` does not resolve [s].
    """

    delay: FloatArray
    velocity: FloatArray
    rms: float

    def corrected(self, q: FloatArray) -> FloatArray:
        """Return positions at their stamps. Shape (N, n) [rad or m]."""
        return np.asarray(q - self.velocity * self.delay[:, None])


def estimate_jitter(t: FloatArray, q: FloatArray, step: float) -> TimestampJitter | None:
    """Estimate timestamp jitter.

    Args:
        t: Stamps, even but for gaps. Shape (N,) [s].
        q: Positions. Shape (N, n) [rad or m].
        step: Time step [s].

    Returns:
        The jitter; None if it is insignificant or the joints do not agree on it.
    """
    if MIN_RATE_RATIO * NOISE_HZ * step > 1.0:
        return None
    stretches = list(_stretches(t, step))
    tested = [_StretchJitter(q[rows], step) for rows in stretches[:TESTED_STRETCHES]]
    if not tested:
        return None
    predicted_share = np.sum([stretch.predicted_share for stretch in tested], axis=0)
    if np.sum(predicted_share > MIN_PREDICTED_SHARE * len(tested)) < 2:
        return None
    variance = float(np.mean([stretch.variance for stretch in tested]))
    if variance < MIN_JITTER**2:
        return None
    delay, velocity = np.zeros(len(q)), np.zeros(q.shape)
    for number, rows in enumerate(stretches):
        stretch = tested[number] if number < len(tested) else _StretchJitter(q[rows], step)
        delay[rows], velocity[rows] = stretch.estimate_delay(variance), stretch.velocity
    return TimestampJitter(delay, velocity, float(np.sqrt(variance)))


def _stretches(t: FloatArray, step: float) -> Iterator[slice]:
    """Slices without a gap and not longer than MAX_STRETCH_TIME."""
    for run in gap_free_slices(t, step):
        count = run.stop - run.start
        if count * step > 3.0 * PADDING_TIME:
            parts = int(np.ceil(count * step / MAX_STRETCH_TIME))
            ends = np.linspace(run.start, run.stop, parts + 1).astype(int)
            yield from (slice(int(a), int(b)) for a, b in pairwise(ends))


class _StretchJitter:
    """Jitter in a stretch of even rows, estimated above the frequencies of the motion.

    Attributes:
        q: Positions. Shape (N, n) [rad or m].
        step: Time step [s].
        velocity: Velocities of the motion. Shape (N, n).
        predicted_share: Share of each joint's power above NOISE_HZ that the other joints predict.
            Shape (n,) [1].
        fast_delay: δ above NOISE_HZ. Shape (N,) [s].
        variance: Variance of δ [s²].
        noise: Variance of each joint's independent noise. Shape (n,).
    """

    def __init__(self, q: FloatArray, step: float) -> None:
        self.q, self.step = q, step
        self.velocity = np.gradient(_low_pass(q, MOTION_HZ, step), step, axis=0)
        high = q - _low_pass(q, NOISE_HZ, step)
        edge = int(EDGE_TIME / step)
        high[:edge] = high[-edge:] = 0.0
        power = np.mean(high**2, axis=0)
        rounding = RELATIVE_ROUNDING * np.abs(q).max(axis=0)
        weight = np.divide(1.0, power, out=np.zeros_like(power), where=power > rounding**2)
        # weighted least squares of δ at each row: its right-hand side and matrix, per joint
        target, matrix = weight * self.velocity * high, weight * self.velocity**2
        regularization = VELOCITY_REGULARIZATION * float(matrix.sum(axis=1).mean()) + TINY
        by_others = (target.sum(axis=1)[:, None] - target) / (
            matrix.sum(axis=1)[:, None] - matrix + regularization
        )
        residual = high - self.velocity * by_others
        self.predicted_share = (weight > 0.0) - np.mean(weight * residual**2, axis=0)
        self.fast_delay = target.sum(axis=1) / (matrix.sum(axis=1) + regularization)
        # share of the power of white noise that is above NOISE_HZ and not at the edges
        white_share = (1.0 - 2.0 * NOISE_HZ * step) * (1.0 - 2.0 * edge / len(q))
        information = matrix.sum(axis=1)
        self.variance = float(
            (self.fast_delay**2) @ information / max(float(matrix.sum()), TINY) / white_share
        )
        independent = high - self.velocity * self.fast_delay[:, None]
        self.noise = np.mean(independent**2, axis=0) / white_share

    def estimate_delay(self, variance: float) -> FloatArray:
        """Estimate δ at every row: a posteriori up to MAX_CORRECTED_HZ, above by least squares.

        Args:
            variance: Variance of δ [s²].

        Returns:
            δ̂. Shape (N,) [s].
        """
        from scipy.interpolate import CubicSpline  # slow to import

        decimation = max(1, int(0.4 / (MAX_CORRECTED_HZ * self.step)))
        head = int(PADDING_TIME / self.step) // decimation * decimation
        q, velocity = (pad_by_reflection(x, head, head) for x in (self.q, self.velocity))
        window = np.ones(len(q))
        window[:head] = 0.5 - 0.5 * np.cos(np.pi * np.arange(head) / head)
        window[-head:] = window[:head][::-1]
        low = _low_pass(q, MAX_CORRECTED_HZ, self.step)[::decimation]
        low = (low - np.linspace(low[0], low[-1], len(low))) * window[::decimation, None]
        slow_delay = _maximum_a_posteriori(
            low,
            velocity[::decimation] * window[::decimation, None],
            decimation * self.step,
            variance / decimation,
            self.noise / decimation,
        )
        rows = np.arange(head, head + len(self.q))
        spline = CubicSpline(np.arange(len(slow_delay)) * decimation, slow_delay)
        resolved = _low_pass(self.fast_delay, MAX_CORRECTED_HZ, self.step)
        return np.asarray(spline(rows) + self.fast_delay - resolved)


def _low_pass(x: FloatArray, hertz: float, step: float) -> FloatArray:
    """Zero-phase low-pass filter along the first axis. Shape (N, …)."""
    from scipy import signal  # slow to import

    return np.asarray(
        signal.sosfiltfilt(signal.butter(4, 2.0 * hertz * step, output="sos"), x, axis=0)
    )


def _maximum_a_posteriori(
    x: FloatArray, velocity: FloatArray, step: float, variance: float, noise: FloatArray
) -> FloatArray:
    """Estimate δ̂ of a periodic stretch, with spectra of the motion estimated in turn.

    Args:
        x: Positions below MAX_CORRECTED_HZ. Shape (L, n).
        velocity: Velocities of the motion. Shape (L, n).
        step: Time step [s].
        variance: Variance of δ per row [s²].
        noise: Variance of each joint's noise per row. Shape (n,).

    Returns:
        δ̂. Shape (L,) [s].
    """
    from scipy.sparse.linalg import LinearOperator, cg  # slow to import

    count, frequency = len(x), np.fft.rfftfreq(len(x), step)
    in_band = (frequency >= MIN_CORRECTED_HZ) & (frequency < MAX_CORRECTED_HZ)
    jitter_power, delay = np.sum(velocity**2, axis=0) * variance, np.zeros(count)
    for iteration in range(SPECTRUM_ITERATIONS):
        motion = x - velocity * delay[:, None]
        power = _smoothed_spectrum(np.abs(np.fft.rfft(motion, axis=0)) ** 2)
        if iteration == 0:
            power = np.maximum(power - jitter_power, MIN_MOTION_SHARE * power)
        inverse = count / np.maximum(power, noise * count + TINY)
        precision = np.where(in_band[:, None], inverse, 0.0)
        # diagonal preconditioner: rows differ in their velocities
        scale = np.sqrt(np.sum(velocity**2 * precision.max(axis=0), axis=1) + 1.0 / variance)

        def projected(z: FloatArray, precision: FloatArray = precision) -> FloatArray:
            filtered = np.fft.irfft(precision * np.fft.rfft(z, axis=0), count, axis=0)
            return np.asarray(np.sum(velocity * filtered, axis=1))

        def normal_equations(
            y: Any, scale: FloatArray = scale, projected: Any = projected
        ) -> FloatArray:
            z = np.ravel(y) / scale
            return np.asarray((projected(velocity * z[:, None]) + z / variance) / scale)

        operator = LinearOperator((count, count), matvec=normal_equations, dtype=float)
        solution, _ = cg(
            operator,
            projected(x) / scale,
            x0=delay * scale,
            rtol=CG_TOLERANCE,
            maxiter=MAX_CG_ITERATIONS,
        )
        delay = solution / scale
    return delay


def _smoothed_spectrum(power: FloatArray) -> FloatArray:
    """Mean of a power spectrum over a share of each frequency, without frequency 0. Shape (F,
    n)."""
    sums = np.vstack([np.zeros((1, power.shape[1])), np.cumsum(power, axis=0)])
    bins = np.arange(len(power))
    half_width = np.maximum(3, (SMOOTHING_BANDWIDTH * bins).astype(int))
    high = np.minimum(bins + half_width + 1, len(power))
    low = np.minimum(np.maximum(bins - half_width, 1), high - 1)
    return np.asarray((sums[high] - sums[low]) / (high - low)[:, None])
