"""The measurement chain: when a value is sampled, and what noise, resolution and clock make of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from .._types import FloatArray


@dataclass(frozen=True)
class MeasurementChain:
    """rate [Hz]. noise: torque's standard deviation, Shape (n,) [N m]; colour: corner of its low-pass [Hz], None: white.

    encoder: resolution of position [rad]. torque: resolution of torque, Shape (n,) [N m]. jitter: standard deviation of the times of
    sampling, which the recording's clock does not show [s].
    """

    rate: float
    noise: FloatArray
    colour: float | None = None
    encoder: float = 2e-6
    torque: FloatArray | None = None
    jitter: float = 0.0

    def clock_times(self, duration: float) -> FloatArray:
        """What the clock shows: k/rate, to the end [s]."""
        return np.arange(round(duration * self.rate) + 1) / self.rate

    def sampling_times(self, t: FloatArray, rng: np.random.Generator) -> FloatArray:
        """When the samples really were taken."""
        return t + self.jitter * rng.standard_normal(len(t))

    def quantise_positions(self, q: FloatArray) -> FloatArray:
        """Positions on the encoder's grid."""
        return q if self.encoder == 0.0 else np.round(q / self.encoder) * self.encoder

    def measure_torques(self, tau: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Torques with noise, on the converter's grid."""
        noisy = tau + self.noise * coloured_noise(tau.shape, self.rate, self.colour, rng)
        return noisy if self.torque is None else np.round(noisy / self.torque) * self.torque

    def noise_floor(self, band: float) -> FloatArray:
        """RMS of the torque's noise below `band` [Hz], as a brick wall would leave it. Shape (n,) [N m]."""
        nyquist = 0.5 * self.rate
        f = np.linspace(0.0, nyquist, 4000)
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
    """Noise of variance 1 along the first axis: white, or first-order low-passed at `corner` [Hz]."""
    white = rng.standard_normal(shape)
    if corner is None:
        return white
    b, a = _low_pass_coefficients(corner, rate)
    pole = -a[1]
    out, _ = signal.lfilter(
        b,
        a,
        white,
        axis=0,
        zi=pole * rng.standard_normal((1, *shape[1:])) * b[0] / np.sqrt(1 - pole**2),
    )
    return out / (b[0] / np.sqrt(1.0 - pole**2))


def _low_pass_coefficients(corner: float, rate: float) -> tuple[FloatArray, FloatArray]:
    pole = float(np.exp(-2.0 * np.pi * corner / rate))
    return np.array([1.0 - pole]), np.array([1.0, -pole])
