"""Finite Fourier series in joint space, with exact derivatives of any order.

qᵢ(t) = q₀ᵢ + Σₖ aᵢₖ/(ωk) sin(ωkt) − bᵢₖ/(ωk) cos(ωkt), ω = 2π/T    (Swevers et al., IEEE TRA 1997)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..robot.samples import Samples

VERIFICATION_DENSITY = 10
"""Samples of the certificate per sample of the optimiser, both over one period [1]."""

NEWTON_ITERATIONS = 4
"""Iterations that refine a peak found on a grid of 16 samples per harmonic to rounding [1]."""


@dataclass(frozen=True)
class FourierSeries:
    """Periodic motion of n joints with K harmonics.

    Attributes:
        sine: Velocity amplitudes a. Shape (n, K) [rad/s].
        cosine: Velocity amplitudes b. Shape (n, K) [rad/s].
        offset: Mean positions q₀. Shape (n,) [rad].
        period: Period T [s].
    """

    sine: FloatArray
    cosine: FloatArray
    offset: FloatArray
    period: float

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.offset)

    @property
    def harmonics(self) -> int:
        """Number of harmonics K."""
        return int(self.sine.shape[1])

    @property
    def omega(self) -> float:
        """Base frequency ω = 2π/T [rad/s]."""
        return 2.0 * np.pi / self.period

    def at(self, t: float | FloatArray, order: int = 0) -> FloatArray:
        """Evaluate the motion or one of its time derivatives.

        Args:
            t: Times [s]. Shape () or (N,).
            order: Order of the derivative, 0 for positions.

        Returns:
            Positions [rad] or derivatives [rad/s^order]. Shape (n,) or (N, n).
        """
        a, b = fourier_basis(np.asarray(t, float), self.omega, self.harmonics, order)
        out: FloatArray = a @ self.sine.T + b @ self.cosine.T
        return out + self.offset if order == 0 else out

    def samples(self, t: FloatArray) -> Samples:
        """Return position, velocity and acceleration at times `t` [s]. Shape of `t`: (N,)."""
        return Samples(self.at(t), self.at(t, 1), self.at(t, 2))

    def grid(self, count: int) -> FloatArray:
        """Return `count` equispaced times over one period, beginning at 0 [s]. Shape (count,)."""
        return np.arange(count, dtype=np.float64) * (self.period / count)

    def peak(self, order: int) -> FloatArray:
        """Find the largest absolute value of a time derivative over one period, to rounding.

        Local maxima on a grid are refined by Newton's method on the next derivative, so that the
        result does not depend on the phase at which the series begins.

        Returns:
            One value per joint [rad/s^order]. Shape (n,).
        """
        times = self.grid(16 * self.harmonics + 64)
        size = np.abs(self.at(times, order))
        is_top = (size >= np.roll(size, 1, axis=0)) & (size >= np.roll(size, -1, axis=0))
        sample, joint = np.nonzero(is_top)
        time, column = times[sample], np.arange(len(joint))
        for _ in range(NEWTON_ITERATIONS):
            slope, curvature = (self.at(time, order + more)[column, joint] for more in (1, 2))
            step = np.divide(slope, curvature, out=np.zeros_like(slope), where=curvature != 0.0)
            time = np.clip(time - step, times[sample] - times[1], times[sample] + times[1])
        refined = np.abs(self.at(time, order)[column, joint])
        out: FloatArray = size.max(axis=0)
        np.maximum.at(out, joint, refined)
        return out

    def shifted(self, time: float) -> FourierSeries:
        """Return the same motion started at `time` [s]: shifted(s).at(t) = at(t + s)."""
        phase = self.omega * np.arange(1, self.harmonics + 1) * time
        c, s = np.cos(phase), np.sin(phase)
        # a sin(x+φ) − b cos(x+φ) = (a c + b s) sin x − (b c − a s) cos x
        return FourierSeries(
            self.sine * c + self.cosine * s,
            self.cosine * c - self.sine * s,
            self.offset,
            self.period,
        )

    def slowed(self, speed: float) -> FourierSeries:
        """Return the same path at `speed` times the speed [1]."""
        return FourierSeries(
            self.sine * speed, self.cosine * speed, self.offset, self.period / speed
        )


def fourier_basis(
    t: FloatArray, omega: float, harmonics: int, order: int
) -> tuple[FloatArray, FloatArray]:
    """Return the factors of the coefficients a and b in a time derivative of the series.

    Args:
        t: Times [s]. Shape () or (N,).
        omega: Base frequency ω [rad/s].
        harmonics: Number of harmonics K.
        order: Order of the derivative, 0 for positions.

    Returns:
        Factors of a, and factors of b. Shape (K,) or (N, K) each.
    """
    k = omega * np.arange(1, harmonics + 1)
    phase = np.multiply.outer(t, k)
    s, c = np.sin(phase), np.cos(phase)
    scale = k ** (order - 1.0)
    pair = ((s, -c), (c, s), (-s, c), (-c, -s))[order % 4]
    return pair[0] * scale, pair[1] * scale


def oversampling_bound(count: int, degree: int) -> float:
    """Bound a trigonometric polynomial between the samples of an equispaced grid.

    The bound 1/cos(πK/N) for degree K < N/2 (Ehlich and Zeller 1964) is exact, so a grid proves
    a limit between its points.

    Args:
        count: Samples N over one period.
        degree: Degree K of the polynomial.

    Returns:
        Factor by which the polynomial may exceed its largest absolute sample; infinite for N ≤ 2K.
    """
    if count <= 2 * degree:
        return float("inf")
    return float(1.0 / np.cos(np.pi * degree / count))
