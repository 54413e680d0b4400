"""Stretches of motion and torque that an identification can use: whole periods averaged, anything else as it is.

The mean over P periods has 1/P of the noise variance, and the spread about it is the noise, with no model in between (Swevers et al.,
IEEE TRA 1997): what repeats is physics.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..recordings import Recording
from ..recordings.recording import SHORTEST
from .lowpass import Band

Array = np.ndarray
BAND_HZ = 20.0
DROWNED = 4.0
"""Power of torque over its noise, below which there is nothing left to fit."""
REACH = 10.0
"""Torque reaches to this many times the highest frequency of the motion: products of joints, reversals of friction."""
HIGHEST = 50.0
"""Above this a rigid body is no model of an arm [Hz]."""
CHUNK = 1 << 17
"""Rows of a long stretch that are worked on at a time."""


@dataclass(frozen=True)
class Piece:
    """An evenly sampled stretch. q, torque: Shape (N, n) [rad, N m]. start: its time [s]. source: the recording's name.

    periods: how many were averaged; 0: not periodic. noise: each period's torque less the mean's. Shape (periods, N, n). encoder: standard
    deviation of positions by the encoders' steps, as they were read. smoothed: joints whose positions are the smoothest within these.
    Shape (n,) or, where none are, (1,). temperature: Shape (N, n), NaN where a joint's was not recorded; None where no joint's was [°C].
    began: when its recording did, where that is another time than its own [s].
    """

    source: str
    start: float
    rate: float
    q: Array
    torque: Array
    periods: int = 0
    noise: Array | None = None
    encoder: Array = field(default_factory=lambda: np.zeros(1))
    smoothed: Array = field(default_factory=lambda: np.zeros(1, bool))
    temperature: Array | None = None
    began: float | None = None

    def __len__(self) -> int:
        return len(self.q)

    def head(self, count: int) -> Piece:
        """The first rows, of a stretch that is not periodic."""
        temperature = None if self.temperature is None else self.temperature[:count]
        return dataclasses.replace(
            self, q=self.q[:count], torque=self.torque[:count], temperature=temperature
        )

    @property
    def periodic(self) -> bool:
        return self.periods > 0

    def band(self, hertz: float) -> Band:
        """The low-pass to `hertz` of this stretch."""
        return Band(hertz, self.rate, len(self), self.periodic, float(self.encoder.max()))


def pieces(recordings: Iterable[Recording], *, average: bool = True) -> Iterator[Piece]:
    """The stretches of recordings, in order: the mean period of those that repeat, else every stretch without a gap."""
    for recording in recordings:
        if average and recording.repeats is not None:
            mean = averaged(recording, *recording.repeats)
            if mean is not None:
                yield mean
                continue
        for part in recording.segments():
            whole = (recording.source, float(part.t[0]), part.rate, part.q, part.torque)
            yield Piece(
                *whole,
                encoder=recording.encoder,
                smoothed=recording.smoothed,
                temperature=part.temperature,
                began=float(recording.t[0]),
            )


def first(parts: Sequence[Piece], samples: int) -> list[Piece]:
    """The pieces from the beginning until there are that many samples; all where there are no more, in parts where one is long."""
    out: list[Piece] = []
    for piece in parts:
        left = samples - sum(len(one) for one in out)
        if left <= 0:
            break
        whole = piece.periodic or len(piece) <= 2 * left
        out.append(piece if whole else piece.head(left))
    return out


def averaged(recording: Recording, period: float, window: tuple[float, float]) -> Piece | None:
    """The mean over the whole periods within a window, on a grid of a whole number of samples; None where fewer than two are, or where a
    period has fewer than SHORTEST samples.

    Periods that a gap interrupts are left out.
    """
    first = float(
        recording.t[min(int(np.searchsorted(recording.t, window[0] - 1e-9)), len(recording) - 1)]
    )
    last = min(window[1], float(recording.t[-1]) + 1.0 / recording.rate)
    samples = round(period * recording.rate)
    if samples < SHORTEST or (last - first) / period + 1e-6 < 2.0:
        return None
    starts = first + period * np.arange(int((last - first) / period + 1e-6))
    inside = np.arange(samples) * (period / samples)
    found = [
        _folded(part, starts[whole, None] + inside)
        for part in recording.segments()
        if (
            whole := (starts > part.t[0] - 0.5 * part.step)
            & (starts + inside[-1] < part.t[-1] + 0.5 * part.step)
        ).any()
    ]
    count = sum(len(q) for q, _ in found)
    if count < 2:
        return None
    q, torque = (np.concatenate(values) for values in zip(*found, strict=True))
    mean = torque.mean(axis=0)
    told = (recording.encoder / np.sqrt(count), recording.smoothed)
    return Piece(
        recording.source, first, samples / period, q.mean(axis=0), mean, count, torque - mean, *told
    )


def _folded(part: Recording, wanted: Array) -> tuple[Array, Array]:
    """Positions and torque of a stretch without a gap, at times. Shapes (count, samples) -> (count, samples, n)."""
    both, step = (part.q, part.torque), wanted[0, 1] - wanted[0, 0]
    index = np.searchsorted(part.t, wanted - 0.25 * step)
    if index.max() < len(part) and np.abs(part.t[index] - wanted).max() < 1e-3 * step:
        return both[0][index], both[1][index]
    from scipy.interpolate import CubicSpline  # slow to import

    q, torque = (np.asarray(CubicSpline(part.t, values, axis=0)(wanted)) for values in both)
    return q, torque


# -- noise and band --------------------------------------------------------------------------------------------------


def floor(parts: Sequence[Piece], hertz: float, *, tapered: bool = False) -> Array | None:
    """Standard deviation of the torque noise below `hertz`, from the spread between periods; None without. Shape (n,) [N m].

    What the means of periods differ by may be warming up, and is left out. tapered: what the filter leaves of it in
    torque that was not averaged over periods, where the band has no sharp edge.
    """
    power, weight = 0.0, 0
    for piece in parts:
        if piece.noise is None:
            continue
        spectrum = np.fft.rfft(piece.noise, axis=1)
        gain = Band(hertz, piece.rate, len(piece), periodic=not tapered).gain(
            np.fft.rfftfreq(len(piece), 1.0 / piece.rate), hertz
        )
        sides = np.where(np.arange(len(gain)) > 0, 2.0, 0.0) * gain**2
        square = np.sum(sides[:, None] * np.abs(spectrum) ** 2, axis=1) / len(piece) ** 2
        power = power + square.sum(axis=0)
        weight += piece.periods - 1
    return None if weight == 0 else np.sqrt(np.asarray(power) / weight)


@dataclass(frozen=True)
class Spectra:
    """Power densities, joint by joint, that a band is chosen by. frequency: Shape (F,) [Hz]. torque, noise: (F, n) [(N m)²/Hz].

    motion: see `motion` [Hz]. hertz: the band chosen.
    """

    frequency: Array
    torque: Array
    noise: Array
    motion: float
    hertz: float


def spectra(parts: Sequence[Piece], hertz: float | None = None) -> Spectra:
    """The band, from the data: 20 Hz, more where the motion is faster, less where torque drowns in its noise before.

    The noise is that between periods where there are some, else the median density above half of the highest frequency.
    """
    from scipy import signal  # slow to import

    longest = first([max(parts, key=len)], CHUNK)[0]
    rate, size = longest.rate, _window(longest)
    frequency, torque = signal.welch(longest.torque, rate, nperseg=size, axis=0, detrend="linear")
    if longest.noise is not None:
        noise = np.mean(
            [signal.welch(one, rate, nperseg=size, axis=0)[1] for one in longest.noise], axis=0
        )
        noise *= longest.periods / (longest.periods - 1)
    else:
        noise = np.tile(np.median(torque[frequency >= 0.25 * rate], axis=0), (len(frequency), 1))
    moved = motion(longest)
    chosen = _chosen(frequency, torque, noise, moved, rate) if hertz is None else hertz
    return Spectra(frequency, torque, noise, moved, chosen)


def motion(piece: Piece) -> float:
    """The frequency below which 99 % of the joint velocities' power lies [Hz]."""
    from scipy import signal  # slow to import

    size = _window(piece)
    frequency, speed = signal.welch(
        np.gradient(piece.q, 1.0 / piece.rate, axis=0), piece.rate, nperseg=size, axis=0
    )
    share = np.cumsum((speed / np.maximum(speed.sum(axis=0), 1e-300)).sum(axis=1)) / speed.shape[1]
    return float(frequency[np.searchsorted(share, 0.99 * share[-1])])


def _window(piece: Piece) -> int:
    """Samples of which a spectrum is made, one after the other."""
    return min(len(piece), max(256, int(4.0 * piece.rate)))


def _chosen(frequency: Array, torque: Array, noise: Array, motion: float, rate: float) -> float:
    least = min(max(REACH * motion, 5.0), HIGHEST, 0.4 * rate)
    above = (torque > DROWNED * noise).any(axis=1)
    drowned = float(frequency[np.flatnonzero(above)[-1]]) if above.any() else least
    return float(min(max(least, min(BAND_HZ, drowned)), 0.4 * rate, max(BAND_HZ, least)))


def chunks(piece: Piece, overlap: int, multiple: int) -> Iterator[tuple[slice, slice]]:
    """Parts of a long stretch: the rows to work on, and of those the ones that are not overlap. Starts are multiples of `multiple`."""
    if piece.periodic or len(piece) <= CHUNK + 2 * overlap:
        yield slice(0, len(piece)), slice(0, len(piece))
        return
    size, reach = CHUNK // multiple * multiple, -(-overlap // multiple) * multiple
    starts = list(range(0, len(piece), size))
    if len(piece) - starts[-1] <= 2 * overlap:
        starts.pop()
    for k, start in enumerate(starts):
        stop = len(piece) if k == len(starts) - 1 else start + size
        begin, end = max(0, start - reach), min(len(piece), stop + reach)
        yield slice(begin, end), slice(start - begin, stop - begin)
