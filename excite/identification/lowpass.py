"""Zero-phase low-pass filter for both sides of τ = Y(q, q̇, q̈) ψ, with exact derivatives.

Torque and every column of the regressor pass the same filter, so that the equation still holds
after filtering (parallel filtering: Gautier, "Dynamic identification of robots with power model",
ICRA 1997). The filter multiplies Fourier coefficients, so that a derivative is an exact
multiplication by iω. A periodic signal is its own continuation; any other signal is continued by
reflection about its end points, and the samples within `LowPassFilter.margin` of the ends are
discarded.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._types import BoolArray, FloatArray, IntArray
from ..errors import UnusableInput

TAPER_FRACTION = 0.2
"""Share of the band over which the gain falls to zero for aperiodic signals: a sharp edge rings."""
FLAT_BANDWIDTH_RATIO = 1.0 / (1.0 - TAPER_FRACTION)
"""Cutoff from which the gain is 1 in all of the band, over the cutoff of the band."""
SETTLING_FACTOR = 1.5
"""Discarded margin at an end in units of 1/(TAPER_FRACTION · cutoff) [s]: beyond it the effect of
the reflection is below a thousandth of the signal."""
MOTION_BANDWIDTH_RATIO = 2.0
"""Cutoff of positions over the cutoff of torque: torque below the band depends on motion above it,
the more so where a joint reverses."""
FRICTION_BANDWIDTH_RATIO = 10.0
"""Cutoff of the speed in Coulomb friction over the cutoff of torque, to resolve friction steps."""
MAX_FRICTION_SPEED_NOISE = 3e-3
"""Largest standard deviation of the speed in Coulomb friction due to quantization [rad/s]: about
the width of a friction step. A smoother speed would displace the steps in time."""
REGRESSOR_OVERSAMPLING = 3.0
"""Rate at which the regressor is sampled before filtering, over twice the cutoff: products of
motions reach beyond the band of each of them."""


class Grid(enum.Enum):
    """Sampling grids: as recorded, coarse for the regressor, and of the kept rows."""

    RECORDED = enum.auto()
    COARSE = enum.auto()
    KEPT = enum.auto()


def settling_time(hertz: float) -> float:
    """Return the time to discard at either end of an aperiodic stretch [s].

    Args:
        hertz: Cutoff frequency [Hz].
    """
    return SETTLING_FACTOR / (TAPER_FRACTION * hertz)


def tapered_gain(frequencies: NDArray[np.floating[Any]], hertz: float) -> FloatArray:
    """Return the gain of the filter of an aperiodic stretch at frequencies [Hz].

    It is 1 below the taper, 0 above the cutoff frequency `hertz` and a raised cosine between them.
    """
    edge = (1.0 - TAPER_FRACTION) * hertz
    share = np.clip((np.abs(frequencies) - edge) / (hertz - edge), 0.0, 1.0)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * share))


@dataclass(frozen=True)
class LowPassFilter:
    """Low-pass filter for a stretch of evenly spaced samples, with the grids that it needs.

    Rows are kept at twice the cutoff frequency. Of a period as many rows are kept as there are
    Fourier coefficients in the band, so that white noise stays white.

    Attributes:
        hertz: Cutoff frequency [Hz].
        rate: Sample rate of the stretch [Hz].
        count: Number of samples of the stretch.
        periodic: True if the stretch is one period of a periodic signal.
        encoder: Standard deviation of the quantization error of the coarsest encoder [rad or m].
    """

    hertz: float
    rate: float
    count: int
    periodic: bool = False
    encoder: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.hertz < 0.5 * self.rate:
            raise UnusableInput(
                f"--band {self.hertz:g}: must be above 0 and below half of the recording's rate, "
                f"{0.5 * self.rate:g} Hz"
            )

    def steps(self, grid: Grid) -> int:
        """Return the number of recorded samples per sample of a grid; aperiodic stretches only."""
        coarse = max(1, int(self.rate / (2.0 * REGRESSOR_OVERSAMPLING * self.hertz)))
        if grid is Grid.RECORDED:
            return 1
        return (
            coarse
            if grid is Grid.COARSE
            else coarse * max(1, int(self.rate / coarse / (2.0 * self.hertz) + 1e-9))
        )

    def samples(self, grid: Grid) -> int:
        """Return the number of samples on a grid."""
        if not self.periodic:
            return -(-self.count // self.steps(grid))
        length = self.count / self.rate
        coefficients = 2 * int(self.hertz * length + 1e-9) + 1
        samples = {
            Grid.RECORDED: self.count,
            Grid.COARSE: int(np.ceil(2.0 * REGRESSOR_OVERSAMPLING * self.hertz * length)),
            Grid.KEPT: coefficients,
        }
        return min(self.count, samples[grid])

    def rate_of(self, grid: Grid) -> float:
        """Return the sample rate of a grid [Hz]."""
        return (
            self.samples(grid) * self.rate / self.count
            if self.periodic
            else self.rate / self.steps(grid)
        )

    @property
    def margin(self) -> int:
        """Recorded samples to discard at each end: a whole number of kept steps, 0 if periodic."""
        step = self.steps(Grid.KEPT)
        return (
            0
            if self.periodic
            else int(np.ceil(settling_time(self.hertz) * self.rate / step)) * step
        )

    def needed_samples(self, rows: int) -> int:
        """Return the samples of an aperiodic stretch of which some rows are kept."""
        return 2 * self.margin + rows * self.steps(Grid.KEPT)

    def gain(self, frequencies: NDArray[np.floating[Any]], hertz: float) -> FloatArray:
        """Return the gain at frequencies [Hz] for a cutoff of `hertz`.

        That of `tapered_gain`; for periodic signals the edge is sharp.
        """
        if self.periodic:
            return (np.abs(frequencies) <= hertz * (1.0 + 1e-9)).astype(float)
        return tapered_gain(frequencies, hertz)

    def filter(
        self,
        x: FloatArray,
        to: Grid,
        order: int = 0,
        *,
        source: Grid = Grid.RECORDED,
        bandwidth_ratio: float = 1.0,
    ) -> FloatArray:
        """Filter signals and differentiate them, from one grid to a coarser one.

        Args:
            x: Signals on the grid `source`. Shape (samples(source), …).
            to: Grid of the result.
            order: Order of the time derivative.
            source: Grid of `x`.
            bandwidth_ratio: Cutoff in units of `hertz`; at most half the rate of `source`.

        Returns:
            The derivative below the cutoff. Shape (samples(to), …).
        """
        return self.transform(x, source).filter(to, order, bandwidth_ratio)

    def transform(self, x: FloatArray, source: Grid = Grid.RECORDED) -> SignalSpectrum:
        """Compute the Fourier coefficients of signals, to filter the same signals several times.

        Args:
            x: Signals on the grid `source`. Shape (samples(source), …).
            source: Grid of `x`.
        """
        columns = x.reshape(len(x), -1)
        nonzero = _nonzero(columns)  # half of a regressor is zero by structure
        if not nonzero.all():
            columns = columns[:, nonzero]
        lines, head = columns.T, 0
        if not self.periodic:
            step = self.steps(Grid.KEPT) // self.steps(source)
            margin = int(
                np.ceil(SETTLING_FACTOR / (TAPER_FRACTION * self.hertz) * self.rate_of(source))
            )
            lines, head = _continued(lines, margin, step)
        return SignalSpectrum(
            self, source, np.fft.rfft(lines), lines.shape[1], head, nonzero, x.shape
        )


@dataclass(frozen=True)
class SignalSpectrum:
    """Fourier coefficients of signals that were continued into closed loops.

    Attributes:
        band: Filter of the stretch.
        source: Grid of the signals.
        coefficients: Coefficients of the signals that are not zero. Shape (lines, length // 2 + 1).
        length: Number of samples of a continued signal.
        head: Number of samples prepended to each signal.
        nonzero: True for signals that are not zero throughout.
        shape: Shape of the array of signals.
    """

    band: LowPassFilter
    source: Grid
    coefficients: NDArray[np.complex128]
    length: int
    head: int
    nonzero: BoolArray
    shape: tuple[int, ...]

    def filter(
        self,
        to: Grid,
        order: int = 0,
        bandwidth_ratio: float = 1.0,
        time_constant: float = 0.0,
        response: Callable[[FloatArray], NDArray[np.complex128]] | None = None,
    ) -> FloatArray:
        """Filter and differentiate the signals; arguments as in `LowPassFilter.filter`.

        Args:
            time_constant: Time constant of an additional first-order lag [s].
            response: Frequency response of an additional filter, a function of frequencies [Hz].
        """
        rate = self.band.rate_of(self.source)
        if self.band.periodic:
            step, kept, target = 1, self.band.samples(to), self.band.samples(to)
        else:
            step = self.band.steps(to) // self.band.steps(self.source)
            kept, target = -(-self.shape[0] // step), self.length // step
        bins = target // 2 + 1
        cutoff = min(bandwidth_ratio * self.band.hertz, 0.5 * rate)
        factor = _response(self.band, bins, rate / self.length, cutoff, order)
        if time_constant:
            s = 2j * np.pi * np.arange(bins) * (rate / self.length)
            factor = factor / (1.0 + time_constant * s)
        if response is not None:
            factor = factor * response(np.asarray(np.arange(bins) * (rate / self.length)))
        factor = factor * (target / self.length)
        filtered = np.fft.irfft(self.coefficients[:, :bins] * factor, target)
        first = self.head // step
        if len(filtered) == len(self.nonzero):
            out = filtered[:, first : first + kept].T
        else:
            out = np.zeros((len(self.nonzero), kept)).T
            out[:, self.nonzero] = filtered[:, first : first + kept].T
        return out.reshape(kept, *self.shape[1:])


@lru_cache(256)
def _response(
    band: LowPassFilter, bins: int, spacing: float, hertz: float, order: int
) -> NDArray[np.complex128]:
    """Frequency response of a filtered derivative at multiples of `spacing` [Hz]. Shape (bins,)."""
    frequencies = spacing * np.arange(bins)
    return np.asarray(band.gain(frequencies, hertz) * (2j * np.pi * frequencies) ** order)


def _nonzero(columns: FloatArray) -> BoolArray:
    """Return True for columns that are not zero throughout; most show it in a few of their rows."""
    out = np.asarray(columns[:: 1 + len(columns) // 64].any(axis=0))
    if not out.all():
        out[~out] = columns[:, ~out].any(axis=0)
    return out


def _continued(lines: FloatArray, min_margin: int, step: int) -> tuple[FloatArray, int]:
    """Continue signals by point reflection at both ends and fade them into a closed loop.

    A loop without a jump avoids ringing at the seam. Its length is a whole number of steps with a
    fast Fourier transform.

    Returns:
        The loops, and the index at which the signals begin in them.
    """
    count = lines.shape[1]
    head, total, before, behind, fade = _continuation(count, min_margin, step)
    out = np.empty((len(lines), total))
    out[:, head : head + count] = lines
    first, last = out[:, :head], out[:, head + count :]
    np.subtract(2.0 * lines[:, :1], lines[:, before], out=first)
    np.subtract(2.0 * lines[:, -1:], lines[:, behind], out=last)
    last += fade * (first[:, :1] - last[:, -1:])
    return out, head


@lru_cache(64)
def _continuation(
    count: int, min_margin: int, step: int
) -> tuple[int, int, IntArray, IntArray, FloatArray]:
    """Samples before a signal and of its loop, the samples that both ends reflect, and the fade."""
    from scipy.fft import next_fast_len  # slow to import

    head = -(-min_margin // step) * step
    total = step * next_fast_len(-(-(head + count + min_margin) // step), real=True)
    tail = total - head - count
    offsets = np.minimum(np.arange(1, max(head, tail) + 1), count - 1)
    fade = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, tail + 1) / (tail + 1))
    return head, total, offsets[:head][::-1], count - 1 - offsets[:tail], fade


def friction_speed(
    positions: FloatArray, band: LowPassFilter, spectrum: SignalSpectrum | None = None
) -> FloatArray:
    """Compute the speed in Coulomb friction at every recorded sample.

    Its cutoff is FRICTION_BANDWIDTH_RATIO bands, or lower where a coarse encoder would make it
    noisier than MAX_FRICTION_SPEED_NOISE.

    Args:
        positions: Joint positions. Shape (M, n) [rad or m].
        band: Filter of the stretch.
        spectrum: Fourier coefficients of the positions, if they are at hand.

    Returns:
        Joint speeds. Shape (M, n) [rad/s or m/s].
    """
    return (spectrum or band.transform(positions)).filter(
        Grid.RECORDED, 1, _friction_bandwidth_ratio(band)
    )


def _friction_bandwidth_ratio(band: LowPassFilter) -> float:
    """Cutoff of the friction speed in bands.

    White noise σ of positions at rate f_s causes noise σ 2πf √(2f/3f_s) of the speed below f.
    """
    if band.encoder == 0.0:
        return FRICTION_BANDWIDTH_RATIO
    f = (MAX_FRICTION_SPEED_NOISE / (2.0 * np.pi * band.encoder) * np.sqrt(1.5 * band.rate)) ** (
        2.0 / 3.0
    )
    return float(np.clip(f / band.hertz, 1.0, FRICTION_BANDWIDTH_RATIO))
