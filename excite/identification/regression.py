"""The equations τ = Γ θ of recordings, both sides below one band (Lee, Wensing & Park, eq. 9): what every estimator works on."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ..errors import UnusableInput
from ..robot.base_parameters import Base
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from ..robot.samples import Samples
from .lowpass import MOTION_BANDWIDTH_RATIO, Grid, LowPassFilter, friction_speed
from .segments import Segment, split_into_chunks

Array = np.ndarray
BLOCK_ROWS = 4096


@dataclass(frozen=True)
class IdentificationModel:
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
        return {
            k: int(place) - block.start
            for k, place in enumerate(self.base.independent)
            if block.start <= place < block.stop
        }


@dataclass(frozen=True)
class TorqueEquations:
    """Rows of τ = Γ θ, twice the band a second.

    torque: Shape (N, n) [N m]. regressor: Γ. Shape (N, n, p). slopes: of torque by the log of Coulomb friction's width, over the
    friction. Shape (N, n). motion: of the rows. time: of each row [s]. starts: rows at
    which a stretch begins, the first being 0. sources: name of each stretch's recording. hertz: the band. rate: rows a second.
    periods: how many periods each stretch is the mean of, 0 where it is none. repeats: per stretch what distinguishes its periods' torque
    from their mean, Fourier coefficients at the rows' frequencies above 0. Shape (periods, (N − 1)/2, n), or None.
    """

    torque: Array
    regressor: Array
    slopes: Array
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

    def rows(self, which: slice) -> TorqueEquations:
        """Some rows, as one stretch."""
        part = dataclasses.replace(
            self,
            torque=self.torque[which],
            regressor=self.regressor[which],
            slopes=self.slopes[which],
        )
        part = dataclasses.replace(part, motion=self.motion.rows(which))
        return dataclasses.replace(
            part,
            time=self.time[which],
            starts=(0,),
            sources=self.sources[:1],
            periods=(0,),
            repeats=(None,),
        )

    def predicted(self, theta: Array) -> Array:
        """Γ θ. Shape (N, n) [N m]."""
        out: Array = self.regressor @ theta
        return out


def build_equations(model: IdentificationModel, pieces: Iterable[Segment], hertz: float) -> TorqueEquations:
    """The equations of all stretches below `hertz`. Raises UnusableInput when no row is left."""
    parts, starts, count, shortest = list[TorqueEquations](), list[tuple[int, Segment, int]](), 0, 0.0
    for piece in pieces:
        band = piece.band(hertz)
        own = list(_chunked(model, piece, band))
        if own:
            starts.append((count, piece, sum(map(len, own))))
            count += starts[-1][2]
            parts += own
        shortest = 2.0 * band.margin / piece.rate
    if not parts:
        raise UnusableInput(
            f"recordings: no stretch is longer than the {shortest:.2g} s that a band of {hertz:g} Hz takes at its ends"
        )
    return TorqueEquations(
        torque=np.concatenate([part.torque for part in parts]),
        regressor=np.concatenate([part.regressor for part in parts]),
        slopes=np.concatenate([part.slopes for part in parts]),
        motion=Samples(
            *(
                np.concatenate([getattr(part.motion, name) for part in parts])
                for name in ("q", "dq", "ddq")
            )
        ),
        time=np.concatenate([part.time for part in parts]),
        starts=tuple(start for start, _, _ in starts),
        sources=tuple(piece.source for _, piece, _ in starts),
        periods=tuple(piece.periods for _, piece, _ in starts),
        repeats=tuple(_repeats(piece, rows) for _, piece, rows in starts),
        hertz=hertz,
        rate=parts[-1].rate,
    )


def _repeats(piece: Segment, rows: int) -> Array | None:
    """Fourier coefficients of each period's torque less the mean's, as those of a period of so many rows."""
    if piece.noise is None:
        return None
    return np.asarray(
        np.fft.rfft(piece.noise, axis=1)[:, 1 : (rows - 1) // 2 + 1] * (rows / len(piece))
    )


def kept_rows(piece: Segment, band: LowPassFilter) -> Iterator[tuple[slice, slice]]:
    """Chunks of a stretch, and which of a chunk's kept rows count: not those that an end spoils or another chunk has."""
    step = band.steps(Grid.KEPT)
    for rows, own in split_into_chunks(piece, 3 * band.margin, step):
        low = max(own.start, band.margin if rows.start == 0 else 0)
        high = min(
            own.stop, len(piece) - rows.start - (band.margin if rows.stop == len(piece) else 0)
        )
        kept = (
            slice(0, None) if piece.periodic else slice(-(-low // step), max(-(-high // step), 0))
        )
        if piece.periodic or kept.stop > kept.start:
            yield rows, kept


def _chunked(model: IdentificationModel, piece: Segment, band: LowPassFilter) -> Iterator[TorqueEquations]:
    for rows, kept in kept_rows(piece, band):
        part = dataclasses.replace(band, count=rows.stop - rows.start)
        torque = part.low(piece.torque[rows], Grid.KEPT)[kept]
        time = (
            piece.start
            + rows.start / piece.rate
            + np.arange(part.samples(Grid.KEPT))[kept] / band.rate_of(Grid.KEPT)
        )
        gamma, slopes, motion = filtered_regressor(model, piece.q[rows], part)
        stretch = ((0,), (piece.source,), (piece.periods,), (None,))
        yield TorqueEquations(
            torque,
            gamma[kept],
            slopes[kept],
            motion.rows(kept),
            time,
            *stretch,
            band.hertz,
            band.rate_of(Grid.KEPT),
        )


def filtered_regressor(model: IdentificationModel, q: Array, band: LowPassFilter) -> tuple[Array, Array, Samples]:
    """Γ along positions, filtered and thinned, friction's slopes and the motion at its rows. Shapes (M, n, p), (M, n), M rows."""
    position = band.transformed(q)
    samples = Samples(*(position.low(Grid.COARSE, order, MOTION_BANDWIDTH_RATIO) for order in range(3)))
    blocks = [
        regressor(model.robot, model.parameters, samples.rows(slice(start, start + BLOCK_ROWS)))[
            :, :, model.base.independent
        ]
        for start in range(0, len(samples), BLOCK_ROWS)
    ]
    gamma = band.low(np.concatenate(blocks), Grid.KEPT, of=Grid.COARSE)
    slopes = np.zeros(gamma.shape[:2])
    columns = model.friction_columns()
    if columns:  # from every sample of the recording: their steps are too short for the coarse grid
        coulomb, slopes = filtered_friction(model.widths, friction_speed(q, band, position), band)
        for k, joint in columns.items():
            gamma[:, :, k] = 0.0
            gamma[:, joint, k] = coulomb[:, joint]
    return gamma, slopes, Samples(*(position.low(Grid.KEPT, order) for order in range(3)))


def filtered_friction(widths: Array, speed: Array, band: LowPassFilter) -> tuple[Array, Array]:
    """Filtered tanh(q̇/width), and its slope by log width: what an error of a width adds to a joint's torque. Shapes (M, n)."""
    step = np.tanh(speed / widths)
    both = band.low(np.concatenate([step, -(speed / widths) * (1.0 - step**2)], axis=1), Grid.KEPT)
    return both[:, : len(widths)], both[:, len(widths) :]
