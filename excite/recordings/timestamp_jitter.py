"""A clock that wavers unseen: rows stamped evenly, but read at instants that differ from their
stamps, of all joints together.

q_j = x_j + ẋ_j δ, with one error δ of the instant in all joints (a logger's loop is late, and every
encoder with it). In one joint it looks like an encoder's noise; differentiated twice it is most of
what a model can't explain. Above the motion's frequencies nothing but δ makes all joints differ in
the ratio of their speeds: there it shows, and how large it is. Below, the likeliest is taken away,

    δ̂ = argmin Σ_j ‖S_j^(-1/2) (q_j − ẋ_j δ)‖² + ‖δ‖²/σ²,

S_j the spectrum of the motion x_j, found in turn with δ (a Wiener filter along a direction that
turns, by conjugate gradients). Torque stays as it was read: its own error, τ̇ δ, is differentiated
by nobody.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from .padding import reflected
from .time_axis import pieces

Array = np.ndarray
SLOW, ABOVE, TOP = 10.0, 30.0, 45.0
"""Frequencies up to which a speed is the motion's, above which positions are no motion, and up to
which the likeliest is sought [Hz]."""
LEAST = 2.0
"""Frequency below which nothing is sought: it is the motion [Hz]."""
ROOM = 4.0
"""Times ABOVE that a recording must have rows a second."""
SHARED = 0.5
"""Share of what a joint does above the motion that the others must foretell, of two joints at the
least: of noise of its own they foretell less than nothing."""
SLIGHT, ROUNDED = 5e-6, 1e-12
"""An error of instants that nobody needs to take out [s]; and of positions, what a filter's
rounding leaves of a joint that stands."""
FAINT = 1e-3
"""Of the mean square of speeds, what is added to it: where all stand, no δ is told."""
AGAIN, ROUNDS, CLOSE = 4, 300, 1e-6
"""Times that spectra are found; steps of conjugate gradients at the most, and their residual."""
NARROW, OWN = 0.2, 0.05
"""Part of a frequency over which a spectrum is smoothed either way; and of it, what is the motion's
own at the least, to begin with."""
LOOKED = 3
"""Stretches that tell whether a clock wavers."""
REACH, LONGEST, EDGE = 1.0, 60.0, 0.2
"""How far a stretch is continued at its ends, how long it may be, and how much of its ends a filter
spoils [s]."""


@dataclass(frozen=True)
class Waver:
    """late: by how much each row was read after its stamp, as far as it is told. speed: of the
    motion then. rms: of all of it [s].

    Shapes (N,) [s], (N, n).
    """

    late: Array
    speed: Array
    rms: float

    def taken(self, q: Array) -> Array:
        """Positions at their stamps. Shape (N, n)."""
        return np.asarray(q - self.speed * self.late[:, None])


def found(t: Array, q: Array, step: float) -> Waver | None:
    """By how much rows were read late; None where joints don't agree that they were. Shapes (N,),
    (N, n)."""
    if ROOM * ABOVE * step > 1.0:
        return None
    stretches = list(_stretches(t, step))
    seen = [_Seen(q[rows], step) for rows in stretches[:LOOKED]]
    if not seen or np.sum(np.sum([one.foretold for one in seen], axis=0) > SHARED * len(seen)) < 2:
        return None
    variance = float(np.mean([one.variance for one in seen]))
    if variance < SLIGHT**2:
        return None
    late, speed = np.zeros(len(q)), np.zeros(q.shape)
    for number, rows in enumerate(stretches):
        one = seen[number] if number < LOOKED else _Seen(q[rows], step)
        late[rows], speed[rows] = one.late(variance), one.speed
    return Waver(late, speed, float(np.sqrt(variance)))


def _stretches(t: Array, step: float) -> Iterator[slice]:
    """Rows without a gap, none too long to be worked on at once."""
    for run in pieces(t, step):
        count = run.stop - run.start
        if count * step > 3.0 * REACH:
            ends = np.linspace(
                run.start, run.stop, int(np.ceil(count * step / LONGEST)) + 1
            ).astype(int)
            yield from (slice(int(a), int(b)) for a, b in pairwise(ends))


class _Seen:
    """What an even stretch shows above its motion. q: Shape (N, n). foretold: share of each joint's
    square there that the others foretell.

    variance: of δ [s²]. grain: of each joint's own noise. Shape (n,).
    """

    def __init__(self, q: Array, step: float) -> None:
        self.q, self.step = q, step
        self.speed = np.gradient(_low(q, SLOW, step), step, axis=0)
        high = q - _low(q, ABOVE, step)
        edge = int(EDGE / step)
        high[:edge] = high[-edge:] = 0.0
        square = np.mean(high**2, axis=0)
        weight = np.divide(
            1.0,
            square,
            out=np.zeros_like(square),
            where=square > (ROUNDED * np.abs(q).max(axis=0)) ** 2,
        )
        told, known = weight * self.speed * high, weight * self.speed**2
        faint = FAINT * float(known.sum(axis=1).mean()) + 1e-300
        others = (told.sum(axis=1)[:, None] - told) / (known.sum(axis=1)[:, None] - known + faint)
        self.foretold = (weight > 0.0) - np.mean(weight * (high - self.speed * others) ** 2, axis=0)
        self.above = told.sum(axis=1) / (known.sum(axis=1) + faint)
        seen = (1.0 - 2.0 * ABOVE * step) * (1.0 - 2.0 * edge / len(q))  # of white noise
        self.variance = float(
            (self.above**2) @ known.sum(axis=1) / max(float(known.sum()), 1e-300) / seen
        )
        self.grain = np.mean((high - self.speed * self.above[:, None]) ** 2, axis=0) / seen

    def late(self, variance: float) -> Array:
        """δ̂ at every row: the likeliest up to TOP, above it what the joints say together. Shape
        (N,) [s]."""
        from scipy.interpolate import CubicSpline  # slow to import

        every = max(1, int(0.4 / (TOP * self.step)))
        head = int(REACH / self.step) // every * every
        q, speed = (reflected(x, head, head) for x in (self.q, self.speed))
        fade = np.ones(len(q))
        fade[:head] = 0.5 - 0.5 * np.cos(np.pi * np.arange(head) / head)
        fade[-head:] = fade[:head][::-1]
        low = _low(q, TOP, self.step)[::every]
        low = (low - np.linspace(low[0], low[-1], len(low))) * fade[::every, None]
        below = _likeliest(
            low,
            (speed * fade[:, None])[::every],
            every * self.step,
            variance / every,
            self.grain / every,
        )
        rows = np.arange(head, head + len(self.q))
        return np.asarray(
            CubicSpline(np.arange(len(below)) * every, below)(rows)
            + self.above
            - _low(self.above, TOP, self.step)
        )


def _low(x: Array, hertz: float, step: float) -> Array:
    """Below a frequency, without phase. Shape (N, …)."""
    from scipy import signal  # slow to import

    return np.asarray(
        signal.sosfiltfilt(signal.butter(4, 2.0 * hertz * step, output="sos"), x, axis=0)
    )


def _likeliest(x: Array, speed: Array, step: float, variance: float, grain: Array) -> Array:
    """δ̂ of a closed loop of positions below TOP, spectra found in turn with it. variance, grain:
    white. Shapes (L, n) -> (L,)."""
    from scipy.sparse.linalg import LinearOperator, cg  # slow to import

    count, frequency = len(x), np.fft.rfftfreq(len(x), step)
    sought = (frequency >= LEAST) & (frequency < TOP)
    wavered, late = np.sum(speed**2, axis=0) * variance, np.zeros(count)
    for number in range(AGAIN):
        power = _smoothed(np.abs(np.fft.rfft(x - speed * late[:, None], axis=0)) ** 2)
        if number == 0:
            power = np.maximum(power - wavered, OWN * power)
        trust = np.where(sought[:, None], count / np.maximum(power, grain * count + 1e-300), 0.0)
        root = np.sqrt(
            np.sum(speed**2 * trust.max(axis=0), axis=1) + 1.0 / variance
        )  # evens out fast and slow rows

        def white(z: Array, trust: Array = trust) -> Array:
            return np.asarray(
                np.sum(speed * np.fft.irfft(trust * np.fft.rfft(z, axis=0), count, axis=0), axis=1)
            )

        def normal(y: Any, root: Array = root, white: Any = white) -> Array:
            z = np.ravel(y) / root
            return np.asarray((white(speed * z[:, None]) + z / variance) / root)

        operator = LinearOperator((count, count), matvec=normal, dtype=float)
        late = cg(operator, white(x) / root, x0=late * root, rtol=CLOSE, maxiter=ROUNDS)[0] / root
    return late


def _smoothed(power: Array) -> Array:
    """Means over a part of each frequency, that of zero left out. Shape (F, n)."""
    sums = np.vstack([np.zeros((1, power.shape[1])), np.cumsum(power, axis=0)])
    bins = np.arange(len(power))
    reach = np.maximum(3, (NARROW * bins).astype(int))
    high = np.minimum(bins + reach + 1, len(power))
    low = np.minimum(np.maximum(bins - reach, 1), high - 1)
    return np.asarray((sums[high] - sums[low]) / (high - low)[:, None])
