"""One low-pass for both sides of the equation τ = Y(q, q̇, q̈) ψ, with zero phase, and exact derivatives below it.

Torque and every column of the regressor pass the same filter (Gautier 1997, "decimate"): what it takes from one side it takes from
the other. It acts on Fourier coefficients, so that derivatives are exact multiplications by iω; a periodic signal is its own
continuation, any other is continued by reflection through its ends, and what lies within `margin` of them is dropped.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..errors import UnusableInput

Array = np.ndarray
TAPER_FRACTION = 0.2
"""Part of the band over which the gain falls to zero, for signals that are not periodic: a sharp edge rings for long."""
SETTLING_FACTOR = 1.5
"""Margin in units of 1/(taper · band): there a reflected end is felt by less than a thousandth."""
MOTION_BANDWIDTH_RATIO = 2.0
"""Positions keep this many bands: torque below the band depends on motion above it, the more so where a joint reverses."""
FRICTION_BANDWIDTH_RATIO = 10.0
"""The speed in Coulomb friction keeps this many bands: its steps are placed by it."""
MAX_FRICTION_SPEED_NOISE = 3e-3
"""Noise of a speed that a friction step can bear, about its width [rad/s]: a smoother speed would put the step at another time."""
REGRESSOR_OVERSAMPLING = 3.0
"""The regressor is sampled at this many times twice the band before it is filtered: products of motions reach beyond it."""


class Grid(enum.Enum):
    """Where samples lie: as recorded, where the regressor is evaluated, or where rows are kept."""

    RECORDED = enum.auto()
    COARSE = enum.auto()
    KEPT = enum.auto()


@dataclass(frozen=True)
class LowPassFilter:
    """A low-pass to `hertz` for a stretch of `count` samples at `rate` [Hz], and the sampling it leads to.

    Rows are kept at twice the band; of a period just as many as have harmonics in it, so that white noise stays white.
    encoder: standard deviation of positions by the coarsest encoder's steps [rad or m].
    """

    hertz: float
    rate: float
    count: int
    periodic: bool = False
    encoder: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.hertz < 0.5 * self.rate:
            raise UnusableInput(
                f"--band {self.hertz:g}: should lie between 0 and half the recording's rate, {0.5 * self.rate:g} Hz"
            )

    def steps(self, grid: Grid) -> int:
        """Samples of the recording per sample of a grid, of a stretch that is not periodic."""
        coarse = max(1, int(self.rate / (2.0 * REGRESSOR_OVERSAMPLING * self.hertz)))
        if grid is Grid.RECORDED:
            return 1
        return (
            coarse
            if grid is Grid.COARSE
            else coarse * max(1, int(self.rate / coarse / (2.0 * self.hertz) + 1e-9))
        )

    def samples(self, grid: Grid) -> int:
        """Samples on a grid."""
        if not self.periodic:
            return -(-self.count // self.steps(grid))
        length = self.count / self.rate
        fewest = 2 * int(self.hertz * length + 1e-9) + 1
        wanted = {
            Grid.RECORDED: self.count,
            Grid.COARSE: int(np.ceil(2.0 * REGRESSOR_OVERSAMPLING * self.hertz * length)),
            Grid.KEPT: fewest,
        }
        return min(self.count, wanted[grid])

    def rate_of(self, grid: Grid) -> float:
        """Samples a second on a grid [Hz]."""
        return (
            self.samples(grid) * self.rate / self.count
            if self.periodic
            else self.rate / self.steps(grid)
        )

    @property
    def margin(self) -> int:
        """Samples of the recording that an end spoils, a whole number of kept steps."""
        step = self.steps(Grid.KEPT)
        return (
            0
            if self.periodic
            else int(np.ceil(SETTLING_FACTOR / (TAPER_FRACTION * self.hertz) * self.rate / step)) * step
        )

    def gain(self, frequencies: Array, hertz: float) -> Array:
        """1 below the taper, 0 above the band, a raised cosine between; of periodic signals sharp."""
        f = np.abs(frequencies)
        if self.periodic:
            return (f <= hertz * (1.0 + 1e-9)).astype(float)
        edge = (1.0 - TAPER_FRACTION) * hertz
        return np.asarray(
            0.5 + 0.5 * np.cos(np.pi * np.clip((f - edge) / (hertz - edge), 0.0, 1.0))
        )

    def low(
        self,
        x: Array,
        to: Grid,
        order: int = 0,
        *,
        of: Grid = Grid.RECORDED,
        reach: float = 1.0,
        late: float = 0.0,
        lag: float = 0.0,
    ) -> Array:
        """The order-th derivative below the band, from one grid to a coarser one. Shapes (samples(of), …) -> (samples(to), …).

        reach: how many bands are kept, at the most what the grid can show. late: by which it comes later; lag: of a filter of first order
        that it has passed [s].
        """
        return self.transformed(x, of).low(to, order, reach, late, lag)

    def transformed(self, x: Array, of: Grid = Grid.RECORDED) -> SignalSpectrum:
        """Fourier coefficients of signals, for several filters and derivatives of the same. Shape (samples(of), …)."""
        columns = x.reshape(len(x), -1).T
        seen = np.any(columns != 0.0, axis=1)  # half of a regressor's columns are zero by structure
        lines, head = np.ascontiguousarray(columns[seen]), 0
        if not self.periodic:
            step = self.steps(Grid.KEPT) // self.steps(of)
            lines, head = _continued(
                lines, int(np.ceil(SETTLING_FACTOR / (TAPER_FRACTION * self.hertz) * self.rate_of(of))), step
            )
        return SignalSpectrum(self, of, np.fft.rfft(lines), lines.shape[1], head, seen, x.shape)


@dataclass(frozen=True)
class SignalSpectrum:
    """Fourier coefficients of continued signals. coefficients: Shape (lines, length // 2 + 1). head: samples put before each line.

    seen: which columns are lines, the others being zero. shape: of the signals.
    """

    band: LowPassFilter
    of: Grid
    coefficients: Array
    length: int
    head: int
    seen: Array
    shape: tuple[int, ...]

    def low(
        self, to: Grid, order: int = 0, reach: float = 1.0, late: float = 0.0, lag: float = 0.0
    ) -> Array:
        """See Band.low."""
        rate = self.band.rate_of(self.of)
        if self.band.periodic:
            step, kept, target = 1, self.band.samples(to), self.band.samples(to)
        else:
            step = self.band.steps(to) // self.band.steps(self.of)
            kept, target = -(-self.shape[0] // step), self.length // step
        bins = target // 2 + 1
        factor = _response(
            self.band, bins, rate / self.length, min(reach * self.band.hertz, 0.5 * rate), order
        )
        if late or lag:
            s = 2j * np.pi * np.arange(bins) * (rate / self.length)
            factor = factor * np.exp(-late * s) / (1.0 + lag * s)
        filtered = np.fft.irfft(self.coefficients[:, :bins] * factor, target) * (
            target / self.length
        )
        out = np.zeros((kept, len(self.seen)))
        out[:, self.seen] = filtered[:, self.head // step : self.head // step + kept].T
        return out.reshape(kept, *self.shape[1:])


@lru_cache(256)
def _response(band: LowPassFilter, bins: int, apart: float, hertz: float, order: int) -> Array:
    """Of a derivative below a band, at frequencies that lie `apart` [Hz]. Shape (bins,)."""
    frequencies = apart * np.arange(bins)
    return np.asarray(band.gain(frequencies, hertz) * (2j * np.pi * frequencies) ** order)


def _continued(lines: Array, least: int, step: int) -> tuple[Array, int]:
    """Lines continued at both ends by reflection through their end points and faded into a closed loop, and where they begin in it.

    A loop without a jump keeps the Fourier series from ringing at the seam. Its length is one that transforms fast, in steps.
    """
    count = lines.shape[1]
    head = -(-least // step) * step
    total = step * _fast(-(-(head + count + least) // step))
    after = total - head - count
    reach = np.minimum(np.arange(1, max(head, after) + 1), count - 1)
    before = 2.0 * lines[:, :1] - lines[:, reach[:head][::-1]]
    behind = 2.0 * lines[:, -1:] - lines[:, count - 1 - reach[:after]]
    fade = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, after + 1) / (after + 1))
    return np.concatenate(
        [before, lines, behind + fade * (before[:, :1] - behind[:, -1:])], axis=1
    ), head


def _fast(least: int) -> int:
    """The smallest product of 2, 3 and 5 that is no smaller."""
    best = 1 << (least - 1).bit_length()
    five = 1
    while five < best:
        three = five
        while three < best:
            best = min(best, three << max(0, (-(-least // three) - 1).bit_length()))
            three *= 3
        five *= 5
    return best


def friction_speed(positions: Array, band: LowPassFilter, transformed: SignalSpectrum | None = None) -> Array:
    """The speed that Coulomb friction sees, at every sample. transformed: of the positions, where it is at hand. Shapes (M, n).

    It keeps EDGE bands, or as many as leave it quieter than QUIET with a coarse encoder.
    """
    return (transformed or band.transformed(positions)).low(Grid.RECORDED, 1, _edge(band))


def _edge(band: LowPassFilter) -> float:
    """How many bands that speed may keep: white noise σ of positions makes σ 2πf √(2f/3f_s) of speed below f."""
    if band.encoder == 0.0:
        return FRICTION_BANDWIDTH_RATIO
    f = (MAX_FRICTION_SPEED_NOISE / (2.0 * np.pi * band.encoder) * np.sqrt(1.5 * band.rate)) ** (2.0 / 3.0)
    return float(np.clip(f / band.hertz, 1.0, FRICTION_BANDWIDTH_RATIO))
