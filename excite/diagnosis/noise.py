"""What of a residual is noise: what differs when a motion is made again.

Noise of the torque is not all: a clock that wavers and a coarse encoder move the model's side of the equation too, so it is the
residual, measured less predicted, whose repeats are compared (after Swevers et al., IEEE TRA 1997, who compare torques).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects.recorded_motion import RecordedMotion
from ..identification.identification import Identification
from ..identification.lowpass import MOTION_BANDWIDTH_RATIO, Grid
from ..identification.regression import IdentificationModel, filtered_regressor
from ..recordings import Recording, quantization
from ..recordings.missing_values import runs
from ..recordings.padding import reflected
from .blocks import sandwiched

Array = np.ndarray
Draw = Callable[[np.random.Generator], Array]
Period = tuple[float, tuple[float, float]]
DRAWS = 3
"""Times that an encoder's steps are made anew."""
LEAST = 1.2
"""Periods that a recording must hold to show its noise by what repeats."""
SAME = 0.02
"""RMS difference of normalised positions a period apart, below which a motion is said to repeat."""
PARTS, MIDDLE, ODD, PASSES = 40, 0.6, 12.0, 4
"""Stretches that a difference of periods is cut into, the quantile of them from how many times which on one is no noise, and how often that
is asked."""
SAMPLES = 4000
"""Rows of a recording that are looked at for a period."""
SURE = 2.0
"""Standard deviations."""
BENT = 1.0
"""Of a speed's second difference, by how much it may turn more sharply: 0.6 was seen where friction is 55 rad/s², a sample every 2 ms."""
DOUBTFUL = 1.0
"""Mean square beyond the floor, over it, that may be noise at the most: what moves more than where that was seen may tell little."""
EDGE = 32
"""Rows by which a signal is continued before it is shifted."""


@dataclass(frozen=True)
class NoiseEstimate:
    """What a perfect model would leave below the band, per joint [N m], and how it was found: "periods" or "differences".

    clock: mean square beyond the floor's that a wavering clock makes where momentum is more than where the floor was seen. steps: the
    part that a coarse encoder's steps make of the model's torque: it repeats with the motion. Shapes (n,). feigned: residuals
    that the steps alone might leave, of either half in each of some draws; none where encoders are fine. sharpened: the same, of samples
    that are too rare to tell a reversal. Shapes (N, n). periods: of recordings that repeat, by source: after how long [s], and from when to
    when.
    """

    floor: Array
    method: str
    clock: Array
    steps: Array
    feigned: tuple[tuple[Array, Array], ...]
    sharpened: tuple[Array, Array]
    periods: Mapping[str, Period] = field(default_factory=dict)

    @property
    def noise_rms(self) -> Array:
        """RMS that a right model may leave, steps and a wavering clock included. Shape (n,) [N m]."""
        return np.asarray(np.sqrt(self.floor**2 + 2.0 * self.steps**2 + self.clock))

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Mean squares over the floor's between which the noise may lie: without an encoder's steps, and with twice of them and what a
        clock that wavers makes besides. Shapes (n,)."""
        steps, clock = np.square(self.steps / self.floor), self.clock / np.square(self.floor)
        return 1.0 - steps, 1.0 + np.minimum(steps + clock, DOUBTFUL)


def estimate_noise(
    identified: Identification,
    halves: Sequence[Sequence[RecordedMotion]],
    recordings: Sequence[Recording],
) -> NoiseEstimate:
    """The noise of recordings: from what does not repeat, else from the torque's density above the motion, a lower bound."""
    every = [one for half in halves for one in half]
    above = _above(identified, every[0].band.hertz)
    draws = stepped(identified.model, halves)
    rows = (
        np.concatenate([part for draw in draws for part in draw])
        if draws
        else np.zeros((1, len(above)))
    )
    steps = np.sqrt(np.mean(rows**2, axis=0))
    periods = {recording.source: found for recording in recordings if (found := _period(recording))}
    nothing_repeats = NoiseEstimate(
        _with(above, steps),
        "differences",
        np.zeros(len(above)),
        steps,
        draws,
        _sharpened(halves),
        periods,
    )
    return refine_by_repetition(nothing_repeats, every, [one.residual for one in every])


def refine_by_repetition(
    noisy: NoiseEstimate, every: Sequence[RecordedMotion], left: Sequence[Array]
) -> NoiseEstimate:
    """The noise by what repeats of the torque that a model leaves of every stretch; as it was, where nothing does. left: Shapes (N, n)."""
    periods = noisy.periods
    pairs = [
        (one, own) for one, own in zip(every, left, strict=True) if one.segment.source in periods
    ]
    again = [
        made for one, own in pairs for made in _repeats(one, own, *periods[one.segment.source])
    ]
    if not again:
        return noisy
    spread = np.sqrt(np.mean([made.square for made in again], axis=0))
    return replace(
        noisy, floor=_with(spread, noisy.steps), method="periods", clock=_clock(again, every)
    )


def _with(spread: Array, steps: Array) -> Array:
    """Noise and the steps of encoders together. Shape (n,) each."""
    return np.asarray(np.sqrt(np.maximum(spread, 1e-12) ** 2 + steps**2))


def _above(identified: Identification, hertz: float) -> Array:
    """Noise of the density that the torque has above the motion."""
    frequency = identified.spectra.frequency
    inside = frequency <= hertz
    return np.sqrt(
        np.maximum(np.trapezoid(identified.spectra.noise[inside], frequency[inside], axis=0), 1e-24)
    )


@dataclass(frozen=True)
class _Again:
    """What differs when a motion is made again. change: of the residual, over √2. momentum: squared. Shapes (N, n).

    usual: rows that noise is told by. Shape (N,). square: mean square there, without friction that warms up. Shape (n,).
    """

    change: Array
    momentum: Array
    usual: Array
    square: Array


def _repeats(
    track: RecordedMotion, left: Array, period: float, window: tuple[float, float]
) -> list[_Again]:
    """Of a recording that repeats for long enough, else nothing. left: Shape (N, n) [N m]."""
    low, high = window
    rate = 1.0 / (track.time[1] - track.time[0])
    rows = int(np.floor(period * rate))
    later = shifted(left, period * rate - rows)[rows:]
    first = left[: len(later)]
    inside = (track.time[: len(later)] >= low) & (
        track.time[rows : rows + len(later)] + 1.0 / rate <= high
    )
    if inside.sum() < 0.15 * rows or inside.sum() < 20:
        return []
    change = (later - first)[inside] / np.sqrt(2.0)
    return [_steady(change, track, inside)]


def _momentum(track: RecordedMotion) -> Array:
    """Squared momentum of what a joint moves, rotor included. Shape (N, n) [(kg m²/s)²].

    Read δ late, positions are off by q̇ δ, and torque by (M q̇ δ)¨ to first order: in the band, as if white, by momentum.
    """
    mass, speed = track.derivatives[2], track.coarse_samples.dq
    carried = (
        np.einsum("tij,tj->ti", mass, speed) + track.fitted_robot.actuator_parameter("rotor_inertia") * speed
    )
    return np.square(track.lowpass(carried, Grid.COARSE))


def _steady(change: Array, track: RecordedMotion, inside: Array) -> _Again:
    """A change between periods, without what friction that warms up makes of it."""
    t = np.linspace(-1.0, 1.0, len(change))[:, None]
    groups = []
    for j in range(change.shape[1]):
        friction = track.lowpass(np.column_stack([track.sign(j), track.samples.dq[:, j]]))[
            : len(inside)
        ][inside]
        columns = np.hstack([friction, friction * t])
        groups.append(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
    usual, rest = np.ones(len(change), bool), np.empty(change.shape)
    for _ in range(PASSES):
        for j, columns in enumerate(groups):
            rest[:, j] = (
                change[:, j]
                - columns @ np.linalg.lstsq(columns[usual], change[usual, j], rcond=1e-8)[0]
            )
        usual = _usual(np.square(rest))
    count = int(usual.sum())
    square = np.mean(np.square(rest[usual]), axis=0) * count / max(count - groups[0].shape[1], 1)
    return _Again(rest, _momentum(track)[: len(inside)][inside], usual, square)


def _clock(again: Sequence[_Again], tracks: Sequence[RecordedMotion]) -> Array:
    """What a clock that wavers may make of all recordings beyond what it makes of the floor. Shape (n,).

    Its noise grows with the square of momentum, and does not repeat.
    """
    change, momentum = (
        np.concatenate([getattr(one, name) for one in again]) for name in ("change", "momentum")
    )
    every, seen = (
        np.concatenate([_momentum(one) for one in tracks]),
        np.concatenate([one.momentum[one.usual] for one in again]),
    )
    out = np.zeros(change.shape[1])
    for j in range(len(out)):
        mean = max(float(every[:, j].mean()), 1e-300)
        out[j] = _growth(momentum[:, j] / mean, change[:, j] ** 2) * max(
            1.0 - float(seen[:, j].mean()) / mean, 0.0
        )
    return out


def _growth(x: Array, y: Array) -> float:
    """At the most, by how much noise y grows with x: SURE standard deviations above what is seen of it, but no more than all of it.

    Each row weighs less the larger its x, so that a few do not say all. Errors are told between stretches, as noise is coloured.
    """
    columns, right = np.column_stack([np.ones(len(x)), x]) / (1.0 + x)[:, None], y / (1.0 + x)
    count = max(2, min(PARTS, len(x) // 8))
    found, covariance = sandwiched(
        list(zip(np.array_split(columns, count), np.array_split(right, count), strict=True))
    )
    error = float(np.sqrt(covariance[1, 1]))
    return float(np.clip(found[1] + SURE * error, 0.0, y.mean() / max(x.mean(), 1e-300)))


def _usual(square: Array) -> Array:
    """Rows without the two longest runs of stretches loud on some joint: what touched the robot once is not noise. Shape (N, n) -> (N,).

    A period differs from the one before and the one after. A clock that wavers is loud wherever the motion is fast, in short stretches, and
    is noise.
    """
    parts = np.array_split(square, max(1, min(PARTS, len(square) // 8)))
    means = np.array([part.mean(axis=0) for part in parts])
    loud = (means > ODD * np.quantile(means, MIDDLE, axis=0)).any(axis=1)
    kept = np.ones(len(parts), bool)
    for start, end in sorted(runs(loud).tolist(), key=lambda e: e[0] - e[1])[:2]:
        kept[start:end] = False
    return np.repeat(kept, [len(part) for part in parts])


def shifted(x: Array, by: float) -> Array:
    """x at times a part of a row later, by its Fourier series, the ends continued by reflection. Shape (N, n)."""
    if by < 1e-6:
        return x
    reach = min(EDGE, len(x) - 1)
    whole = reflected(x, reach, reach)
    turned = (
        np.fft.rfft(whole, axis=0) * np.exp(2j * np.pi * np.fft.rfftfreq(len(whole)) * by)[:, None]
    )
    return np.asarray(np.fft.irfft(turned, len(whole), axis=0)[reach : reach + len(x)])


def _period(recording: Recording) -> Period | None:
    """After how long a recording repeats [s], and from when to when: as its sidecar says, else as its positions show."""
    if recording.repeats is not None:
        period, (start, end) = recording.repeats
        return recording.repeats if end - start >= LEAST * period else None
    lag = _lag(recording.q, recording.rate)
    return None if lag is None else (lag, (float(recording.t[0]), float(recording.t[-1])))


def _lag(q: Array, rate: float) -> float | None:
    """The shortest time after which all positions are the same again, for as long as a fifth of it [s]; None where there is none."""
    step = max(1, len(q) // SAMPLES)
    moving = np.ptp(q, axis=0) > 1e-6
    x = q[::step, moving]
    if not moving.any() or len(x) < 16:
        return None
    x = (x - x.mean(axis=0)) / x.std(axis=0)
    most = int(len(x) / LEAST)
    apart = np.array([np.sqrt(np.mean((x[k:] - x[:-k]) ** 2)) for k in range(1, most)])
    gone = np.flatnonzero(apart > 0.5)
    if not len(gone):
        return None
    back = np.flatnonzero(apart[gone[0] :] < SAME) + gone[0]
    if not len(back):
        return None
    run = back[: int(np.argmax(np.diff(back, append=len(apart) + 2) > 1)) + 1]  # the first dip
    return _refined(q[:, moving], step * (int(run[np.argmin(apart[run])]) + 1), step) / rate


def _refined(q: Array, rows: int, step: int) -> float:
    """The lag in rows to which a recording repeats best, near a coarse one; by a parabola through the least three."""
    near = [k for k in range(rows - 2 * step, rows + 2 * step + 1) if 0 < k < len(q) - 2]
    apart = np.array([np.mean((q[k:] - q[:-k]) ** 2) for k in near])
    i = int(np.argmin(apart))
    if not 0 < i < len(near) - 1:
        return float(near[i])
    a, b, c = apart[i - 1 : i + 2]
    return float(near[i] + 0.5 * (a - c) / max(a - 2.0 * b + c, 1e-300))


def _sharpened(halves: Sequence[Sequence[RecordedMotion]]) -> tuple[Array, Array]:
    """The residual of either half if speed turned more sharply than its samples can tell: friction makes it turn where it reverses.

    Where a reversal falls on a sample, its sign is then another; and a motion that repeats in step with the samples repeats that.
    """
    first, second = (np.concatenate([_reversing(one) for one in half]) for half in halves)
    return first, second


def _reversing(one: RecordedMotion) -> Array:
    """F_c (tanh(v/w) − tanh(q̇/w)), v = q̇ − Δ²q̇: of a stretch, below the band. Shape (N, n) [N m]."""
    speed, ends = one.samples.dq, np.zeros((1, one.n))
    sharper = speed - BENT * np.vstack([ends, np.diff(speed, 2, axis=0), ends])
    return one.lowpass(
        one.fitted_robot.actuator_parameter("coulomb")
        * (np.tanh(sharper / one.widths) - np.tanh(speed / one.widths))
    )


def stepped(
    model: IdentificationModel, halves: Sequence[Sequence[RecordedMotion]]
) -> tuple[tuple[Array, Array], ...]:
    """Residuals that coarse encoders alone would leave of the base model, of each half, drawn anew; none where all are fine.

    Which error each reading has is not known, only how errors come about: smooth positions are rounded once more, from another origin.
    """
    if not any(one.segment.encoder.any() for half in halves for one in half):
        return ()
    rng = np.random.default_rng(0)
    first, second = ([_misled(model, one) for one in half] for half in halves)
    return tuple((_rounded(first, rng), _rounded(second, rng)) for _ in range(DRAWS))


def _rounded(half: Sequence[Draw], rng: np.random.Generator) -> Array:
    """One such residual of a half, below the band. Shape (N, n) [N m]."""
    return np.concatenate([draw(rng) for draw in half])


def _misled(model: IdentificationModel, one: RecordedMotion) -> Draw:
    """What draws such residuals of a stretch: only what is rounded has to be filtered anew."""
    step = one.steps
    coarse = step > 0.0
    if not coarse.any():
        return lambda rng: np.zeros((len(one), one.n))
    smooth = np.where(
        one.segment.smoothed,
        one.segment.q,
        one.band.transform(one.segment.q).filter(Grid.RECORDED, 0, MOTION_BANDWIDTH_RATIO),
    )
    right = filtered_regressor(model, smooth, one.band)[0]

    def draw(rng: np.random.Generator) -> Array:
        told, origin = smooth.copy(), rng.uniform(size=one.n) * step
        told[:, coarse] = (
            np.round((smooth + origin)[:, coarse] / step[coarse]) * step[coarse]
        ) - origin[coarse]
        for j in np.flatnonzero(one.segment.smoothed):
            told[:, j] = quantization.unrounded(told[:, j], float(step[j]), 1.0 / one.segment.rate)
        wrong = filtered_regressor(model, told, one.band)[0]
        return np.asarray((right - wrong)[one.kept] @ one.theta)

    return draw
