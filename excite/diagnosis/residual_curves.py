"""What a residual is looked at against: time, place, speed, load, … each as weights that turn the residual into a short curve.

Every look is linear in the residual, so that what noise would make of it follows from the same weights.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..effects.recorded_motion import RecordedMotion
from ..identification.lowpass import Grid

Array = np.ndarray
BLOCK = 1.0
"""Length of a block [s]: longer than what a servo's noise remembers, so that blocks are independent."""
BLOCKS = 40
SHORTEST = 5.0
"""Of short recordings there are BLOCKS blocks, but none shorter than this many periods of the band."""
BINS = 14
LEAST_ROWS = 8
LEAST_BLOCKS = 4
"""Rows and blocks that a bin needs to be drawn."""
SLOW = 0.02
"""Share of the largest speed below which a joint has no direction."""
HIGHEST = 300.0
"""Largest order looked at [cycles a turn]."""
ORDERS = 400
BANDS = 10
NEAR = 3
"""Joints this far away are looked at in robots of more than TEN joints."""
TEN = 10


class CurveKind(enum.Enum):
    """What a curve shows: the mean residual; its part along the motion (friction: positive brakes); or an amplitude."""

    MEAN = "mean"
    ALONG = "along the motion"
    AMPLITUDE = "amplitude"


@dataclass(frozen=True)
class ResidualCurve:
    """One joint's residual against one thing. centres: Shape (b,). weights: of some rows, Shape (rows, b), of amplitudes (rows, 2b):
    cosines, then sines. size: by which an amplitude is multiplied for [N m]. Shape (b,). counts: rows of a bin. centred: the mean over all
    bins is taken off, so that a curve is what varies; that mean shows against time and direction.
    """

    joint: int
    against: str
    unit: str
    kind: CurveKind
    centres: Array
    weights: Callable[[slice], Array]
    size: Array
    counts: Array
    centred: bool = False
    logarithmic: bool = False


@dataclass(frozen=True)
class MotionRows:
    """What the robot did at every row. time: [s], one recording after the other. clock: [s] since a recording's start. Shape (N,).

    q, dq, ddq, load, motor, distance: Shape (N, n). temperature: the same, NaN where not recorded. moves: where a joint is judged.
    starts: first row of each block. begins: first row of each stretch.
    """

    time: Array
    clock: Array
    q: Array
    dq: Array
    ddq: Array
    load: Array
    motor_torque: Array
    distance: Array
    temperature: Array
    moving: Array
    starts: Array
    begins: Array
    rate: float
    hertz: float
    linear: tuple[bool, ...]

    def __len__(self) -> int:
        return len(self.time)

    @property
    def n(self) -> int:
        return int(self.q.shape[1])

    def direction(self, joint: int) -> Array:
        """−1, 0 or 1."""
        speed = self.dq[:, joint]
        return np.sign(speed) * (np.abs(speed) > SLOW * np.abs(speed).max())

    @property
    def blocks(self) -> Array:
        """The block of each row."""
        return np.repeat(np.arange(len(self.starts)), np.diff([*self.starts, len(self)]))


def motion_rows(tracks: Sequence[RecordedMotion]) -> MotionRows:
    """Everything that looks need of some stretches."""
    parts: dict[str, list[Array]] = {}
    starts, begins, at, elapsed, length = list[Array](), list[int](), 0, 0.0, block_length(tracks)
    for track in tracks:
        for name, value in _motion(track).items():
            parts.setdefault(name, []).append(value)
        clock = track.time - track.time[0]
        parts.setdefault("time", []).append(clock + elapsed)
        starts.append(at + block_starts(clock, length))
        begins.append(at)
        at, elapsed = at + len(track), elapsed + float(clock[-1]) + length
    joined = {name: np.concatenate(values) for name, values in parts.items()}
    first = tracks[0]
    linear = tuple(entry.kind == "prismatic" for entry in first.fitted_robot.robot.entries)
    rate = first.band.rate_of(Grid.KEPT)
    return MotionRows(
        **joined,
        starts=np.concatenate(starts),
        begins=np.array(begins),
        rate=rate,
        hertz=first.band.hertz,
        linear=linear,
    )


def block_length(tracks: Sequence[RecordedMotion]) -> float:
    """Length of a block [s]: about 1 s; less of a short recording, which would else have too few of them."""
    total = sum(float(track.time[-1] - track.time[0]) for track in tracks)
    return float(min(BLOCK, max(total / BLOCKS, SHORTEST / tracks[0].band.hertz)))


def block_starts(clock: Array, length: float) -> Array:
    """First row of each block of a stretch; what is left over at the end joins the last."""
    count = max(1, int(clock[-1] / length + 0.5))
    return np.unique(np.searchsorted(clock, np.arange(count) * length))


def _motion(track: RecordedMotion) -> dict[str, Array]:
    s = track.coarse_samples
    t = track.segment.start + np.arange(len(s)) / track.band.rate_of(Grid.COARSE)

    def at(x: Array) -> Array:
        return np.column_stack([np.interp(track.time, t, column) for column in x.T])

    distance = np.column_stack(
        [_since_reversal(q, dq) for q, dq in zip(s.q.T, s.dq.T, strict=True)]
    )
    return {
        "clock": track.time - track.segment.start,
        "q": at(s.q),
        "dq": at(s.dq),
        "ddq": at(s.ddq),
        "load": at(track.rigid_torque),
        "motor_torque": track.lowpass(track.motor_torque),
        "distance": at(distance),
        "temperature": np.column_stack(
            [np.interp(track.time, track.times, column) for column in track.temperature.T]
        ),
        "moving": track.moving,
    }


def _since_reversal(q: Array, dq: Array) -> Array:
    """Distance travelled since the speed last changed sign; a crawl does not count as a change. Shape (C,)."""
    sign = np.sign(dq) * (np.abs(dq) > SLOW * np.abs(dq).max(initial=0.0))
    index = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(q)), 0))
    held = sign[index]
    turns = np.flatnonzero(np.diff(held, prepend=held[:1]) != 0.0)
    origin = np.zeros(len(q), int)
    origin[turns] = turns
    return np.abs(q - q[np.maximum.accumulate(origin)])


# -- the looks -------------------------------------------------------------------------------------------------------


def residual_curves(rows: MotionRows, joints: Sequence[str]) -> Iterator[ResidualCurve]:
    """Every look at every joint that moves."""
    for j in range(rows.n):
        if float(np.ptp(rows.q[:, j])) < 1e-6:
            continue
        unit = "m" if rows.linear[j] else "rad"
        force = "N" if rows.linear[j] else "N m"
        q, way = rows.q[:, j], rows.direction(j)
        parts = max(3, min(12, len(rows.starts) // 5))
        made = [
            _binned(rows, j, "time", "s", rows.time, bins=parts),
            _binned(rows, j, "position", unit, q),
            _binned(rows, j, "position, along the motion", unit, q, way),
            _orders(rows, j),
            _binned(rows, j, "speed", f"{unit}/s", rows.dq[:, j]),
            _phase(rows, j),
            _binned(rows, j, "load", force, rows.load[:, j]),
            _binned(rows, j, "load, along the motion", force, rows.load[:, j], way),
            _binned(
                rows, j, "distance since reversal", unit, rows.distance[:, j], way, logarithmic=True
            ),
            _frequencies(rows, j),
            _binned(
                rows, j, "run time, along the motion", "s", rows.clock, way, bins=max(3, parts // 2)
            ),
            _binned(rows, j, "temperature, along the motion", "°C", rows.temperature[:, j], way),
        ]
        near = [i for i in range(rows.n) if i != j and (rows.n <= TEN or abs(i - j) <= NEAR)]
        made += [
            _binned(
                rows,
                j,
                f"speed of {joints[i]}",
                "m/s" if rows.linear[i] else "rad/s",
                rows.dq[:, i],
            )
            for i in near
        ]
        yield from (one for one in made if one is not None)


def _binned(
    rows: MotionRows,
    joint: int,
    against: str,
    unit: str,
    x: Array,
    way: Array | None = None,
    *,
    bins: int = BINS,
    logarithmic: bool = False,
) -> ResidualCurve | None:
    """Means in bins of as many rows each; None where x is not known or does not vary. way: direction, for the part along the motion."""
    use = (
        rows.moving[:, joint]
        & np.isfinite(x)
        & (np.ones(len(x), bool) if way is None else way != 0.0)
    )
    if logarithmic:
        use &= x > 0.0
    if use.sum() < 3 * LEAST_ROWS or np.ptp(x[use]) <= 1e-9 * max(1.0, float(np.abs(x[use]).max())):
        return None
    bins = max(3, min(bins, len(rows.starts) // 2, int(use.sum()) // LEAST_ROWS))
    edges = np.unique(np.quantile(x[use], np.linspace(0.0, 1.0, bins + 1)))
    return _averaged(
        rows,
        joint,
        (against, unit),
        np.where(use, np.searchsorted(edges[1:-1], x, side="right"), -1),
        x,
        way,
        logarithmic,
    )


def _averaged(
    rows: MotionRows,
    joint: int,
    names: tuple[str, str],
    index: Array,
    x: Array,
    way: Array | None = None,
    logarithmic: bool = False,
) -> ResidualCurve | None:
    """Means over the rows of each bin that has enough. index: of each row, −1 for none."""
    kept = [
        b
        for b in range(index.max() + 1)
        if (index == b).sum() >= LEAST_ROWS
        and len(np.unique(rows.blocks[index == b])) >= LEAST_BLOCKS
    ]
    if len(kept) < 2:
        return None
    inside = index[:, None] == np.array(kept)
    counts = inside.sum(axis=0)
    weights = inside / counts * (1.0 if way is None else way[:, None])
    centres = np.array([x[index == b].mean() for b in kept])
    kind = CurveKind.MEAN if way is None else CurveKind.ALONG
    centred = way is not None or names[0].startswith("speed of ")
    return ResidualCurve(
        joint,
        *names,
        kind,
        centres,
        weights.__getitem__,
        np.ones(len(kept)),
        counts,
        centred,
        logarithmic,
    )


def _phase(rows: MotionRows, joint: int) -> ResidualCurve | None:
    """Down and up, slowing and speeding up: −2, −1, 1, 2."""
    way = rows.direction(joint)
    speeding = np.sign(rows.ddq[:, joint]) == way
    x = way * np.where(speeding, 2.0, 1.0)
    index = np.select([x == v for v in (-2.0, -1.0, 1.0, 2.0)], [0, 1, 2, 3], -1)
    index[~rows.moving[:, joint]] = -1
    return _averaged(rows, joint, ("direction", ""), index, x)


def _orders(rows: MotionRows, joint: int) -> ResidualCurve | None:
    """Amplitude at each order of the joint's own angle, by the rows where it lies below the band."""
    q, speed = rows.q[:, joint], np.abs(rows.dq[:, joint])
    step = 2.0 * np.pi / float(np.ptp(q)) / 1.5
    grid = np.arange(
        max(1.0, 3.0 * step), max(HIGHEST, 30.0 * step) if rows.linear[joint] else HIGHEST, step
    )[:ORDERS]
    highest = 2.0 * np.pi * 0.8 * rows.hertz
    moving = rows.moving[:, joint] & (rows.direction(joint) != 0.0)  # at rest no angle passes
    slow = np.sort(speed[moving])
    seen = np.array([np.searchsorted(slow, highest / k) for k in grid])
    enough = seen >= max(0.05 * len(q), 5 * LEAST_ROWS)
    grid, seen = grid[enough], seen[enough]
    if len(grid) < 3:
        return None

    def weights(part: slice) -> Array:
        angle = q[part, None] * grid
        fast = speed[part, None] * grid
        inside = (moving[part, None] & (fast < highest)) * (2.0 / seen)
        return np.hstack([np.cos(angle) * inside, np.sin(angle) * inside])

    name = ("order", "cycles/m") if rows.linear[joint] else ("order", "cycles/turn")
    centres = grid / (2.0 * np.pi) if rows.linear[joint] else grid
    return ResidualCurve(
        joint, *name, CurveKind.AMPLITUDE, centres, weights, np.ones(len(grid)), seen, logarithmic=True
    )


def _frequencies(rows: MotionRows, joint: int) -> ResidualCurve | None:
    """What of the residual goes with the model's torque, in phase or out of it, by bands: a delay, a resonance or a gain shows here."""
    torque = rows.motor_torque[:, joint] - rows.motor_torque[:, joint].mean()
    ends = [*rows.starts[1:], len(rows)]
    length = float(np.median(np.diff([*rows.starts, len(rows)]))) / rows.rate
    edges = np.geomspace(0.75 / length, rows.hertz, BANDS + 1)
    weights = np.zeros((len(rows), 2 * BANDS))
    power, lines, duration = np.zeros(BANDS), np.zeros(BANDS), 0.0
    for start, end in zip(rows.starts, ends, strict=True):
        size = end - start
        if size < LEAST_ROWS:
            continue
        line = np.arange(1, size // 2)
        turn = (
            np.exp(-2j * np.pi * np.outer(np.arange(size), line) / size)
            * np.hanning(size + 2)[1:-1, None]
        )
        x = torque[start:end] @ turn
        band = np.searchsorted(edges, line * rows.rate / size, side="right") - 1
        duration += size
        for b in np.unique(band[(band >= 0) & (band < BANDS)]):
            own = band == b
            cross = turn[:, own] @ np.conj(x[own])
            weights[start:end, b] += cross.real
            weights[start:end, BANDS + b] += cross.imag
            power[b] += float(np.sum(np.abs(x[own]) ** 2))
            lines[b] += int(own.sum())
    kept = np.flatnonzero(power > 1e-12 * max(power.max(), 1e-300))
    if len(kept) < 2:
        return None
    both = np.concatenate([kept, BANDS + kept])
    weights = weights[:, both] / np.tile(power[kept], 2)
    # RMS torque of the band: Hann's window takes 3/8 of the power
    rms = np.sqrt(2.0 * power[kept] / (0.375 * duration * rows.rate * length))
    centres = np.sqrt(edges[kept] * edges[kept + 1])
    return ResidualCurve(
        joint,
        "frequency",
        "Hz",
        CurveKind.AMPLITUDE,
        centres,
        weights.__getitem__,
        rms,
        lines[kept],
        logarithmic=True,
    )
