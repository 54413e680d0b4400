"""Residual curves: a joint's torque residual over time, position, speed, load and other quantities.

Every curve is linear in the residual, given by weights, so that the effect of noise on it follows
from the same weights.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..effects.recorded_motion import RecordedMotion
from ..identification.lowpass import Grid

BLOCK = 1.0
"""Length of a block [s], longer than the correlation time of a servo's noise, so that blocks are
independent."""
MIN_BLOCKS = 40
"""Blocks into which a short recording is divided."""
MIN_BLOCK_PERIODS = 5.0
"""Shortest block, in periods of the cutoff frequency."""
BINS = 14
"""Bins of a curve."""
MIN_BIN_ROWS = 8
"""Rows that a bin needs to be drawn."""
MIN_BIN_BLOCKS = 4
"""Blocks that a bin needs to be drawn."""
SLOW_SPEED_RATIO = 0.02
"""Speed over the joint's largest speed below which it has no direction."""
MAX_ORDER = 300.0
"""Largest spatial frequency [1/turn]."""
MAX_ORDERS = 400
"""Largest number of spatial frequencies."""
FREQUENCY_BANDS = 10
"""Bands of the curve over frequency."""
MAX_JOINT_DISTANCE = 3
"""Largest distance, in joints, of other joints whose speed is considered in a large robot."""
LARGE_ROBOT_JOINTS = 10
"""Number of joints above which a robot counts as large."""
MIN_TRAVEL = 1e-6
"""Range from which a joint moves [rad or m]."""


class CurveKind(enum.Enum):
    """Kind of a curve: the mean; the mean along the motion (positive: braking); or an amplitude."""

    MEAN = "mean"
    ALONG = "along the motion"
    AMPLITUDE = "amplitude"


@dataclass(frozen=True)
class ResidualCurve:
    """One joint's residual over one quantity.

    Attributes:
        joint: Index of the joint.
        against: Name of the quantity.
        unit: Its unit.
        kind: Kind of the curve.
        centres: Abscissa of the curve's points, shape (b,).
        weights: Returns the weights of some rows, shape (rows, b), or of an amplitude (rows, 2b):
            cosines, then sines.
        size: Factor by which an amplitude is multiplied to get [N m], shape (b,).
        counts: Rows of each bin, shape (b,).
        centred: Whether the mean over all bins is subtracted. That mean shows over time and
            direction.
        logarithmic: Whether the abscissa is drawn logarithmically.
    """

    joint: int
    against: str
    unit: str
    kind: CurveKind
    centres: FloatArray
    weights: Callable[[slice], FloatArray]
    size: FloatArray
    counts: IntArray | FloatArray
    centred: bool = False
    logarithmic: bool = False


@dataclass(frozen=True)
class MotionRows:
    """State of the robot at every row of some motions.

    Attributes:
        time: Time, one recording after the other [s], shape (N,).
        clock: Time since the start of the recording [s], shape (N,).
        q: Joint positions, shape (N, n).
        dq: Joint velocities, shape (N, n).
        ddq: Joint accelerations, shape (N, n).
        load: Torque of the rigid links [N m], shape (N, n).
        motor_torque: Torque of the base model [N m], shape (N, n).
        distance: Travel since the last reversal, shape (N, n).
        temperature: Joint temperatures, NaN where none was recorded [°C], shape (N, n).
        moving: Rows at which a joint is judged, shape (N, n).
        starts: First row of each block.
        begins: First row of each motion.
        rate: Rows a second [Hz].
        hertz: Cutoff frequency [Hz].
        linear: Whether each joint is prismatic.
    """

    time: FloatArray
    clock: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    load: FloatArray
    motor_torque: FloatArray
    distance: FloatArray
    temperature: FloatArray
    moving: BoolArray
    starts: IntArray
    begins: IntArray
    rate: float
    hertz: float
    linear: tuple[bool, ...]

    def __len__(self) -> int:
        return len(self.time)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    def direction(self, joint: int) -> FloatArray:
        """Return the direction of motion of a joint, −1, 0 or 1, shape (N,)."""
        speed = self.dq[:, joint]
        return np.sign(speed) * (np.abs(speed) > SLOW_SPEED_RATIO * np.abs(speed).max())

    @property
    def blocks(self) -> IntArray:
        """Block of each row, shape (N,)."""
        return np.repeat(np.arange(len(self.starts)), np.diff([*self.starts, len(self)]))


def motion_rows(motions: Sequence[RecordedMotion]) -> MotionRows:
    """Concatenate the rows of some motions."""
    parts: dict[str, list[Any]] = {}
    starts, begins, at, elapsed = list[IntArray](), list[int](), 0, 0.0
    length = block_length(motions)
    for motion in motions:
        for name, value in _state(motion).items():
            parts.setdefault(name, []).append(value)
        clock = motion.time - motion.time[0]
        parts.setdefault("time", []).append(clock + elapsed)
        starts.append(at + block_starts(clock, length))
        begins.append(at)
        at, elapsed = at + len(motion), elapsed + float(clock[-1]) + length
    joined = {name: np.concatenate(values) for name, values in parts.items()}
    first = motions[0]
    return MotionRows(
        **joined,
        starts=np.concatenate(starts),
        begins=np.array(begins),
        rate=first.band.rate_of(Grid.KEPT),
        hertz=first.band.hertz,
        linear=tuple(entry.kind == "prismatic" for entry in first.fitted_robot.robot.entries),
    )


def block_length(motions: Sequence[RecordedMotion]) -> float:
    """Return the length of a block [s]: about 1 s, and less in short recordings."""
    total = sum(float(motion.time[-1] - motion.time[0]) for motion in motions)
    return float(min(BLOCK, max(total / MIN_BLOCKS, MIN_BLOCK_PERIODS / motions[0].band.hertz)))


def block_starts(clock: FloatArray, length: float) -> IntArray:
    """Return the first row of each block of a motion; a remainder joins the last block."""
    count = max(1, int(clock[-1] / length + 0.5))
    return np.unique(np.searchsorted(clock, np.arange(count) * length))


def _state(motion: RecordedMotion) -> dict[str, FloatArray | BoolArray]:
    """Fields of `MotionRows` of one motion."""
    s = motion.coarse_samples
    t = motion.segment.start + np.arange(len(s)) / motion.band.rate_of(Grid.COARSE)

    def at_rows(x: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(motion.time, t, column) for column in x.T])

    distance = np.column_stack(
        [travel_since_reversal(q, dq) for q, dq in zip(s.q.T, s.dq.T, strict=True)]
    )
    return {
        "clock": motion.time - motion.segment.start,
        "q": at_rows(s.q),
        "dq": at_rows(s.dq),
        "ddq": at_rows(s.ddq),
        "load": at_rows(motion.rigid_torque),
        "motor_torque": motion.lowpass(motion.motor_torque),
        "distance": at_rows(distance),
        "temperature": np.column_stack(
            [np.interp(motion.time, motion.times, column) for column in motion.temperature.T]
        ),
        "moving": motion.moving,
    }


def travel_since_reversal(q: FloatArray, dq: FloatArray) -> FloatArray:
    """Return the travel since the last reversal, shape (C,).

    Reversals within very slow motion do not count.
    """
    sign = np.sign(dq) * (np.abs(dq) > SLOW_SPEED_RATIO * np.abs(dq).max(initial=0.0))
    index = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(q)), 0))
    last_sign = sign[index]
    reversals = np.flatnonzero(np.diff(last_sign, prepend=last_sign[:1]) != 0.0)
    origin = np.zeros(len(q), int)
    origin[reversals] = reversals
    return np.abs(q - q[np.maximum.accumulate(origin)])


def residual_curves(rows: MotionRows, joints: Sequence[str]) -> Iterator[ResidualCurve]:
    """Yield all curves of all joints that move.

    Args:
        rows: The motion.
        joints: Names of the joints.
    """
    for j in range(rows.n):
        if float(np.ptp(rows.q[:, j])) < MIN_TRAVEL:
            continue
        unit = "m" if rows.linear[j] else "rad"
        force = "N" if rows.linear[j] else "N m"
        q, way = rows.q[:, j], rows.direction(j)
        time_bins = max(3, min(12, len(rows.starts) // 5))
        curves = [
            _binned(rows, j, "time", "s", rows.time, bins=time_bins),
            _binned(rows, j, "position", unit, q),
            _binned(rows, j, "position, along the motion", unit, q, way),
            _over_order(rows, j),
            _binned(rows, j, "speed", f"{unit}/s", rows.dq[:, j]),
            _over_phase(rows, j),
            _binned(rows, j, "load", force, rows.load[:, j]),
            _binned(rows, j, "load, along the motion", force, rows.load[:, j], way),
            _binned(
                rows, j, "distance since reversal", unit, rows.distance[:, j], way, logarithmic=True
            ),
            _over_frequency(rows, j),
            _binned(
                rows,
                j,
                "run time, along the motion",
                "s",
                rows.clock,
                way,
                bins=max(3, time_bins // 2),
            ),
            _binned(rows, j, "temperature, along the motion", "°C", rows.temperature[:, j], way),
        ]
        curves += [
            _binned(
                rows,
                j,
                f"speed of {joints[i]}",
                "m/s" if rows.linear[i] else "rad/s",
                rows.dq[:, i],
            )
            for i in range(rows.n)
            if i != j and (rows.n <= LARGE_ROBOT_JOINTS or abs(i - j) <= MAX_JOINT_DISTANCE)
        ]
        yield from (curve for curve in curves if curve is not None)


def _binned(
    rows: MotionRows,
    joint: int,
    against: str,
    unit: str,
    x: FloatArray,
    way: FloatArray | None = None,
    *,
    bins: int = BINS,
    logarithmic: bool = False,
) -> ResidualCurve | None:
    """Means in bins of equally many rows; None if x is unknown or does not vary.

    Args:
        rows: The motion.
        joint: Index of the joint.
        against: Name of x.
        unit: Unit of x.
        x: Quantity, shape (N,).
        way: Direction of motion, for a curve along the motion.
        bins: Number of bins.
        logarithmic: Whether x is positive and drawn logarithmically.
    """
    use = (
        rows.moving[:, joint]
        & np.isfinite(x)
        & (np.ones(len(x), bool) if way is None else way != 0.0)
    )
    if logarithmic:
        use &= x > 0.0
    if use.sum() < 3 * MIN_BIN_ROWS or np.ptp(x[use]) <= 1e-9 * max(
        1.0, float(np.abs(x[use]).max())
    ):
        return None
    bins = max(3, min(bins, len(rows.starts) // 2, int(use.sum()) // MIN_BIN_ROWS))
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
    index: IntArray,
    x: FloatArray,
    way: FloatArray | None = None,
    logarithmic: bool = False,
) -> ResidualCurve | None:
    """Means over the rows of each bin that has enough; `index` is the bin of each row, or −1."""
    kept = [
        b
        for b in range(index.max() + 1)
        if (index == b).sum() >= MIN_BIN_ROWS
        and len(np.unique(rows.blocks[index == b])) >= MIN_BIN_BLOCKS
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


def _over_phase(rows: MotionRows, joint: int) -> ResidualCurve | None:
    """Means by direction and phase: −2 and 2 while accelerating, −1 and 1 while decelerating."""
    way = rows.direction(joint)
    accelerating = np.sign(rows.ddq[:, joint]) == way
    x = way * np.where(accelerating, 2.0, 1.0)
    index = np.select([x == v for v in (-2.0, -1.0, 1.0, 2.0)], [0, 1, 2, 3], -1)
    index[~rows.moving[:, joint]] = -1
    return _averaged(rows, joint, ("direction", ""), index, x)


def _over_order(rows: MotionRows, joint: int) -> ResidualCurve | None:
    """Amplitude at each spatial frequency of the joint position, where below the cutoff."""
    q, speed = rows.q[:, joint], np.abs(rows.dq[:, joint])
    step = 2.0 * np.pi / float(np.ptp(q)) / 1.5
    grid = np.arange(
        max(1.0, 3.0 * step), max(MAX_ORDER, 30.0 * step) if rows.linear[joint] else MAX_ORDER, step
    )[:MAX_ORDERS]
    max_frequency = 2.0 * np.pi * 0.8 * rows.hertz
    moving = rows.moving[:, joint] & (rows.direction(joint) != 0.0)
    sorted_speed = np.sort(speed[moving])
    counts = np.array([np.searchsorted(sorted_speed, max_frequency / k) for k in grid])
    enough = counts >= max(0.05 * len(q), 5 * MIN_BIN_ROWS)
    grid, counts = grid[enough], counts[enough]
    if len(grid) < 3:
        return None

    def weights(part: slice) -> FloatArray:
        angle = q[part, None] * grid
        frequency = speed[part, None] * grid
        inside = (moving[part, None] & (frequency < max_frequency)) * (2.0 / counts)
        return np.hstack([np.cos(angle) * inside, np.sin(angle) * inside])

    name = ("order", "cycles/m") if rows.linear[joint] else ("order", "cycles/turn")
    centres = grid / (2.0 * np.pi) if rows.linear[joint] else grid
    return ResidualCurve(
        joint,
        *name,
        CurveKind.AMPLITUDE,
        centres,
        weights,
        np.ones(len(grid)),
        counts,
        logarithmic=True,
    )


def _over_frequency(rows: MotionRows, joint: int) -> ResidualCurve | None:
    """Transfer of the model's torque to the residual, in phase and out of phase, by bands.

    It shows delays, resonances and gains.
    """
    torque = rows.motor_torque[:, joint] - rows.motor_torque[:, joint].mean()
    ends = [*rows.starts[1:], len(rows)]
    length = float(np.median(np.diff([*rows.starts, len(rows)]))) / rows.rate
    edges = np.geomspace(0.75 / length, rows.hertz, FREQUENCY_BANDS + 1)
    weights = np.zeros((len(rows), 2 * FREQUENCY_BANDS))
    power, lines, duration = np.zeros(FREQUENCY_BANDS), np.zeros(FREQUENCY_BANDS), 0.0
    for start, end in zip(rows.starts, ends, strict=True):
        size = end - start
        if size < MIN_BIN_ROWS:
            continue
        line = np.arange(1, size // 2)
        fourier = (
            np.exp(-2j * np.pi * np.outer(np.arange(size), line) / size)
            * np.hanning(size + 2)[1:-1, None]
        )
        x = torque[start:end] @ fourier
        band = np.searchsorted(edges, line * rows.rate / size, side="right") - 1
        duration += size
        for b in np.unique(band[(band >= 0) & (band < FREQUENCY_BANDS)]):
            inside = band == b
            cross = fourier[:, inside] @ np.conj(x[inside])
            weights[start:end, b] += cross.real
            weights[start:end, FREQUENCY_BANDS + b] += cross.imag
            power[b] += float(np.sum(np.abs(x[inside]) ** 2))
            lines[b] += int(inside.sum())
    kept = np.flatnonzero(power > 1e-12 * max(power.max(), 1e-300))
    if len(kept) < 2:
        return None
    columns = np.concatenate([kept, FREQUENCY_BANDS + kept])
    weights = weights[:, columns] / np.tile(power[kept], 2)
    # RMS torque of the band: Hann's window has 3/8 of the power
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
