"""The equations τ = Γ θ of recordings, both sides below one band (METHOD eq. 9): what every estimator works on."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ..base import Base
from ..dynamics import regressor
from ..errors import UnusableInput
from ..parameters import Parameters
from ..robot import Robot
from ..trajectory import Samples
from .band import EDGE, WIDER, Band, Grid
from .signals import Piece, chunks

Array = np.ndarray
BLOCK = 4096


@dataclass(frozen=True)
class Model:
    """What an identification is about: a robot's parameters and which of them motion can show.

    widths: of each joint's smooth Coulomb friction tanh(q̇/width). Shape (n,) [rad/s or m/s].
    """

    robot: Robot
    parameters: Parameters
    base: Base
    widths: Array

    def friction_columns(self) -> dict[int, int]:
        """Columns of Γ that are Coulomb friction alone -> their joints."""
        if "coulomb" not in self.parameters.drive:
            return {}
        block = self.parameters.block("coulomb")
        return {k: int(place) - block.start for k, place in enumerate(self.base.independent) if block.start <= place < block.stop}


@dataclass(frozen=True)
class Equations:
    """Rows of τ = Γ θ, twice the band a second.

    torque: Shape (N, n) [N m]. regressor: Γ. Shape (N, n, p). motion: of the rows. time: of each row [s]. starts: rows at
    which a stretch begins, the first being 0. sources: name of each stretch's recording. hertz: the band. rate: rows a second.
    periods: how many periods each stretch is the mean of, 0 where it is none. repeats: per stretch what distinguishes its periods' torque
    from their mean, Fourier coefficients at the rows' frequencies above 0. Shape (periods, (N − 1)/2, n), or None.
    """

    torque: Array
    regressor: Array
    motion: Samples
    time: Array
    starts: tuple[int, ...]
    sources: tuple[str, ...]
    periods: tuple[int, ...]
    repeats: tuple[Array | None, ...]
    hertz: float
    rate: float

    def __len__(self) -> int:
        return len(self.torque)

    @property
    def n(self) -> int:
        return int(self.torque.shape[1])

    def stretches(self) -> Iterator[slice]:
        """Rows of each stretch."""
        for start, stop in zip(self.starts, (*self.starts[1:], len(self)), strict=True):
            yield slice(start, stop)

    def rows(self, which: slice) -> Equations:
        """Some rows, as one stretch."""
        part = dataclasses.replace(self, torque=self.torque[which], regressor=self.regressor[which], motion=self.motion.rows(which))
        return dataclasses.replace(part, time=self.time[which], starts=(0,), sources=self.sources[:1], periods=(0,), repeats=(None,))

    def predicted(self, theta: Array) -> Array:
        """Γ θ. Shape (N, n) [N m]."""
        out: Array = self.regressor @ theta
        return out


def build(model: Model, pieces: Iterable[Piece], hertz: float) -> Equations:
    """The equations of all stretches below `hertz`. Raises UnusableInput when no row is left."""
    torque, gamma, motions, times = [], [], [], []
    starts, sources, periods, repeats, count, rate = [], [], [], [], 0, 2.0 * hertz
    shortest = 0.0
    for piece in pieces:
        band = Band(hertz, piece.rate, len(piece), piece.periodic)
        rate = band.rate_of(Grid.KEPT)
        begin = count
        for one in _chunked(model, piece, band):
            torque.append(one[0])
            gamma.append(one[1])
            motions.append(one[2])
            times.append(one[3])
            count += len(one[0])
        if count > begin:
            starts.append(begin)
            sources.append(piece.source)
            periods.append(piece.periods)
            repeats.append(_repeats(piece, count - begin))
        shortest = 2.0 * band.margin / piece.rate
    if not count:
        raise UnusableInput(f"recordings: no stretch is longer than the {shortest:.2g} s that a band of {hertz:g} Hz takes at its ends")
    joined = Samples(*(np.concatenate([getattr(m, name) for m in motions]) for name in ("q", "dq", "ddq")))
    stretches = (tuple(starts), tuple(sources), tuple(periods), tuple(repeats))
    return Equations(np.concatenate(torque), np.concatenate(gamma), joined, np.concatenate(times), *stretches, hertz, rate)


def _repeats(piece: Piece, rows: int) -> Array | None:
    """Fourier coefficients of each period's torque less the mean's, as those of a period of so many rows."""
    if piece.noise is None:
        return None
    return np.asarray(np.fft.rfft(piece.noise, axis=1)[:, 1 : (rows - 1) // 2 + 1] * (rows / len(piece)))


def kept_rows(piece: Piece, band: Band) -> Iterator[tuple[slice, slice]]:
    """Chunks of a stretch, and which of a chunk's kept rows count: not those that an end spoils or another chunk has."""
    step = band.steps(Grid.KEPT)
    for rows, own in chunks(piece, 3 * band.margin, step):
        low = max(own.start, band.margin if rows.start == 0 else 0)
        high = min(own.stop, len(piece) - rows.start - (band.margin if rows.stop == len(piece) else 0))
        kept = slice(0, None) if piece.periodic else slice(-(-low // step), max(-(-high // step), 0))
        if piece.periodic or kept.stop > kept.start:
            yield rows, kept


def _chunked(model: Model, piece: Piece, band: Band) -> Iterator[tuple[Array, Array, Samples, Array]]:
    for rows, kept in kept_rows(piece, band):
        part = dataclasses.replace(band, count=rows.stop - rows.start)
        torque = part.low(piece.torque[rows], Grid.KEPT)
        time = piece.start + rows.start / piece.rate + np.arange(len(torque)) / band.rate_of(Grid.KEPT)
        gamma, motion = filtered(model, piece.q[rows], part)
        yield torque[kept], gamma[kept], motion.rows(kept), time[kept]


def filtered(model: Model, q: Array, band: Band) -> tuple[Array, Samples]:
    """Γ along positions, filtered and thinned, and the motion at its rows. Shapes (M, n, p), M rows."""
    samples = Samples(*(band.low(q, Grid.COARSE, order, reach=WIDER) for order in range(3)))
    blocks = [
        regressor(model.robot, model.parameters, samples.rows(slice(start, start + BLOCK)))[:, :, model.base.independent]
        for start in range(0, len(samples), BLOCK)
    ]
    gamma = band.low(np.concatenate(blocks), Grid.KEPT, of=Grid.COARSE)
    columns = model.friction_columns()
    if columns:  # from every sample of the recording: their steps are too short for the coarse grid
        speed = band.low(q, Grid.RECORDED, 1, reach=EDGE)
        coulomb = band.low(np.tanh(speed / model.widths), Grid.KEPT)
        for k, joint in columns.items():
            gamma[:, :, k] = 0.0
            gamma[:, joint, k] = coulomb[:, joint]
    return gamma, Samples(*(band.low(q, Grid.KEPT, order) for order in range(3)))
