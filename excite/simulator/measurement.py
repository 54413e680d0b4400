"""The measurement chain: sampling times, noise and resolution of the recorded signals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from .._types import FloatArray

SPECTRUM_POINTS = 4000
"""Frequencies at which the noise spectrum is summed."""


@dataclass(frozen=True)
class MeasurementChain:
    """Sampling, noise and resolution of a recording.

    The fields are the keys of `chain` in `excite.truth/1`.

    Attributes:
        rate: Sampling rate [Hz].
        noise: Standard deviation of the torque noise, shape (n,) [N m].
        colour: Corner frequency of the noise's first-order low-pass [Hz]; None: white noise.
        encoder: Resolution of position [rad]; 0: exact.
        torque: Resolution of torque, shape (n,) [N m]; None: exact.
        jitter: Standard deviation of the sampling times, which the time stamps do not show [s].
    """

    rate: float
    noise: FloatArray
    colour: float | None = None
    encoder: float = 2e-6
    torque: FloatArray | None = None
    jitter: float = 0.0

    def clock_times(self, duration: float) -> FloatArray:
        """Return the time stamps k/rate up to `duration` [s]."""
        return np.arange(round(duration * self.rate) + 1) / self.rate

    def sampling_times(self, t: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the times at which the samples stamped `t` were really taken [s]."""
        return t + self.jitter * rng.standard_normal(len(t))

    def quantise_positions(self, q: FloatArray) -> FloatArray:
        """Round positions to the resolution of the encoder."""
        return q if self.encoder == 0.0 else np.round(q / self.encoder) * self.encoder

    def measure_torques(self, tau: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Add noise to torques and round them to their resolution. Shapes (N, n) [N m]."""
        noisy = tau + self.noise * coloured_noise(tau.shape, self.rate, self.colour, rng)
        return noisy if self.torque is None else np.round(noisy / self.torque) * self.torque

    def noise_floor(self, band: float) -> FloatArray:
        """Return the RMS of the torque noise that an ideal low-pass lets through.

        Rounding to steps s counts as white noise of variance s²/12.

        Args:
            band: Corner of the low-pass [Hz].

        Returns:
            RMS per joint, shape (n,) [N m].
        """
        nyquist = 0.5 * self.rate
        f = np.linspace(0.0, nyquist, SPECTRUM_POINTS)
        power = (
            np.ones_like(f)
            if self.colour is None
            else np.abs(
                signal.freqz(*_low_pass_coefficients(self.colour, self.rate), worN=f, fs=self.rate)[
                    1
                ]
            )
            ** 2
        )
        share = power[f <= band].sum() / power.sum()
        step = 0.0 if self.torque is None else self.torque
        return np.sqrt(share * self.noise**2 + min(1.0, band / nyquist) * np.square(step) / 12.0)


def coloured_noise(
    shape: tuple[int, ...], rate: float, corner: float | None, rng: np.random.Generator
) -> FloatArray:
    """Draw noise of variance 1 along the first axis.

    Args:
        shape: Shape of the result; time is the first axis.
        rate: Sampling rate [Hz].
        corner: Corner of a first-order low-pass [Hz]; None: white noise.
        rng: Generator of the draw.
    """
    white = rng.standard_normal(shape)
    if corner is None:
        return white
    b, a = _low_pass_coefficients(corner, rate)
    pole = -a[1]
    # the initial state is drawn from its stationary distribution
    out, _ = signal.lfilter(
        b,
        a,
        white,
        axis=0,
        zi=pole * rng.standard_normal((1, *shape[1:])) * b[0] / np.sqrt(1 - pole**2),
    )
    return out / (b[0] / np.sqrt(1.0 - pole**2))


def _low_pass_coefficients(corner: float, rate: float) -> tuple[FloatArray, FloatArray]:
    """Return numerator and denominator of a first-order low-pass."""
    pole = float(np.exp(-2.0 * np.pi * corner / rate))
    return np.array([1.0 - pole]), np.array([1.0, -pole])
