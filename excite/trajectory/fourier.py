"""Finite Fourier series in joint space, exact to any derivative.

qᵢ(t) = q₀ᵢ + Σₖ aᵢₖ/(ωk) sin(ωkt) − bᵢₖ/(ωk) cos(ωkt), ω = 2π/T    (Swevers et al., IEEE TRA 1997)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robot.samples import Samples

Array = np.ndarray
DENSITY = 10
"""The certificate's grid is this many times denser than the optimiser's."""


@dataclass(frozen=True)
class Fourier:
    """A periodic motion of n joints with K harmonics.

    sine, cosine: the velocity amplitudes a, b. Shape (n, K) [rad/s].
    offset: q₀. Shape (n,) [rad]. period: T [s].
    """

    sine: Array
    cosine: Array
    offset: Array
    period: float

    @property
    def n(self) -> int:
        return len(self.offset)

    @property
    def harmonics(self) -> int:
        return int(self.sine.shape[1])

    @property
    def omega(self) -> float:
        """Base frequency ω = 2π/T [rad/s]."""
        return 2.0 * np.pi / self.period

    def at(self, t: Array, order: int = 0) -> Array:
        """The order-th time derivative at times t [s]. Shape (len(t), n)."""
        t = np.asarray(t, float)
        a, b = basis(t, self.omega, self.harmonics, order)
        out: Array = a @ self.sine.T + b @ self.cosine.T
        return out + self.offset if order == 0 else out

    def samples(self, t: Array) -> Samples:
        """Position, velocity and acceleration at times t [s]."""
        return Samples(self.at(t), self.at(t, 1), self.at(t, 2))

    def grid(self, count: int) -> Array:
        """`count` equispaced times over one period, the first at 0 [s]."""
        return np.arange(count) * (self.period / count)

    def peak(self, order: int) -> Array:
        """The largest |order-th time derivative| of each joint over a period, to rounding. Shape (n,).

        Local maxima on a grid are refined by Newton's method on the next derivative, so that the result does not depend on
        the phase at which the series begins.
        """
        times = self.grid(16 * self.harmonics + 64)
        size = np.abs(self.at(times, order))
        is_top = (size >= np.roll(size, 1, axis=0)) & (size >= np.roll(size, -1, axis=0))
        sample, joint = np.nonzero(is_top)
        time, column = times[sample], np.arange(len(joint))
        for _ in range(4):
            slope, curvature = (self.at(time, order + more)[column, joint] for more in (1, 2))
            step = np.divide(slope, curvature, out=np.zeros_like(slope), where=curvature != 0.0)
            time = np.clip(time - step, times[sample] - times[1], times[sample] + times[1])
        refined = np.abs(self.at(time, order)[column, joint])
        out: Array = size.max(axis=0)
        np.maximum.at(out, joint, refined)
        return out

    def shifted(self, time: float) -> Fourier:
        """The same motion started at `time`: shifted(s).at(t) = at(t + s)."""
        phase = self.omega * np.arange(1, self.harmonics + 1) * time
        c, s = np.cos(phase), np.sin(phase)
        # a sin(x+φ) − b cos(x+φ) = (a c + b s) sin x − (b c − a s) cos x
        return Fourier(
            self.sine * c + self.cosine * s,
            self.cosine * c - self.sine * s,
            self.offset,
            self.period,
        )

    def slowed(self, speed: float) -> Fourier:
        """The same path at `speed` times the speed."""
        return Fourier(self.sine * speed, self.cosine * speed, self.offset, self.period / speed)


def basis(t: Array, omega: float, harmonics: int, order: int) -> tuple[Array, Array]:
    """Factors of a and b in the order-th derivative of the series. Two arrays of shape (len(t), K)."""
    k = omega * np.arange(1, harmonics + 1)
    phase = np.multiply.outer(t, k)
    s, c = np.sin(phase), np.cos(phase)
    scale = k ** (order - 1.0)
    pair = ((s, -c), (c, s), (-s, c), (-c, -s))[order % 4]
    return pair[0] * scale, pair[1] * scale


def oversampling_bound(count: int, degree: int) -> float:
    """Factor by which a trigonometric polynomial may exceed its largest |value| on `count` equispaced points.

    1/cos(πK/N) for degree K < N/2 (Ehlich & Zeller 1964): exact, so a grid proves a limit between its points.
    """
    if count <= 2 * degree:
        return float("inf")
    return float(1.0 / np.cos(np.pi * degree / count))
