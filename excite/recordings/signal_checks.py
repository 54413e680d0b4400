"""Checks of single signals for signs of faults, which are remarked and not repaired."""

from __future__ import annotations

import dataclasses

import numpy as np

from .._types import BoolArray, FloatArray
from ..robot.limits import Limits
from ..robot.robot import Robot
from .block import Block
from .missing_values import true_runs
from .remark import Remark, RemarkKind, shown_time

ANGLE_TOLERANCE = 1e-4
"""Motion below which a revolute joint stands still, and resolution above which its position is
coarse: 16 bits per turn [rad]."""
LENGTH_TOLERANCE = 1e-5
"""The same for a prismatic joint [m]."""
RESOLUTION_ROWS = 200_000
"""Number of rows in which a grid of positions is searched."""
MIN_GRID_SHARE = 0.99
"""Share of values that must lie on the grid [1]."""
GRID_TOLERANCE = 0.05
"""Distance from the grid that is allowed, over its spacing [1]."""
MIN_GRID_STEPS = 5
"""Smallest number of different steps between values on a grid."""
MAX_DISTINCT_SHARE = 0.5
"""Largest share of distinct values on a grid, whose values repeat [1]."""
RELATIVE_ROUNDING = 1e-9
"""Difference of two values that counts as rounding, over the largest value [1]."""
MAX_EXCESS_SHARE = 0.01
"""Position beyond its limits that is not remarked, over their range [1]."""
MIN_FROZEN_TIME = 0.1
"""Shortest time of a frozen value that is remarked [s]."""
MIN_FROZEN_ROWS = 20
"""Smallest number of rows with a frozen value that is remarked."""
MIN_MOTION_SHARE = 0.01
"""Motion of the joint in that time above which a value counts as frozen, over its range [1]."""
MIN_DOUBTED_SHARE = 0.1
"""Share of the rows from which a torque that is frozen while the joint reverses is doubted [1]."""
MIN_REVERSED_SHARE = 0.05
"""Motion in either direction from which a joint counts as reversed, over its range [1]: friction
and acceleration have changed their sign, which no motion at constant speed does."""
MIN_REPEATED_SHARE = 0.03
"""Share of the rows in motion from which a torque that jumps to one value is remarked [1]. None of
the recordings of nine real machines reaches it; in one of an arm whose torque fails it is 0.45."""
MIN_JUMP_STEPS = 1.5
"""Difference of successive values over the resolution from which a signal jumps [1]."""
MIN_CLIPPED_COUNT = 5
"""Smallest number of measurements at the extreme value of a clipped signal. Where ten neighbouring
values occur once, five by chance at the extreme are rarer than 1 in 1000."""
MIN_CLIPPED_RATIO = 3.0
"""Number of measurements at the extreme value over the number at a neighbouring value above which
the signal is clipped [1]: at the turning point of a sine wave, it is 1/(√2 − 1) = 2.4 in steps of
its resolution, and less with noise."""
MIN_POSE_SHARE = 1e-3
"""Distance of a joint, over its range, from which a pose is another than that of a robot at rest,
whose torque may be constant [1]."""
NEIGHBOURING_VALUES = 10
"""Number of distinct values next to the extreme that are compared."""
MIN_DISTINCT_VALUES = 20
"""Smallest number of distinct values of a signal that can be clipped or frozen; fewer are those of
a coarse resolution."""


def check_signals(block: Block, robot: Robot, limits: Limits | None) -> list[Remark]:
    """Check all signals of a recording.

    Args:
        block: All rows.
        robot: The robot.
        limits: Its limits, None: those of the URDF.

    Returns:
        Remarks, joint by joint.
    """
    out: list[Remark | None] = []
    for i in range(robot.n):
        out += [
            check_still(block, robot, i),
            check_coarse(block, robot, i),
            check_outside(block, robot, i, limits),
            check_frozen_position(block, robot, i),
        ]
        for name in ("tau", "current"):
            if name in block.values and np.isfinite(block.values[name][:, i]).all():
                out.append(_check_torque(block, robot, i, name))
    return [remark for remark in out if remark is not None]


def _check_torque(block: Block, robot: Robot, i: int, name: str) -> Remark | None:
    """Return the most serious remark on a torque or current; None if there is none."""
    frozen = check_frozen_torque(block, robot, i, name)
    if frozen is not None and frozen.doubt:
        return frozen
    clipped = check_clipped(block, robot, i, name)
    return clipped or check_repeated_torque(block, robot, i, name) or frozen


def _tolerance(robot: Robot, i: int) -> float:
    return LENGTH_TOLERANCE if robot.entries[i].kind == "prismatic" else ANGLE_TOLERANCE


def check_still(block: Block, robot: Robot, i: int) -> Remark | None:
    """Remark a joint that moves by less than 1e-4 rad or 1e-5 m and cannot be identified alone."""
    if np.ptp(block.values["q"][:, i]) >= _tolerance(robot, i):
        return None
    return Remark(RemarkKind.STILL, f"joint '{robot.joints[i]}' never moves", robot.joints[i])


def grid_spacing(values: FloatArray) -> float | None:
    """Find the spacing of a grid on which 99 % of the values lie, with repetitions.

    Args:
        values: A signal. Shape (N,).

    Returns:
        The smallest difference of distinct values; None if they lie on no grid.
    """
    values = values[:RESOLUTION_ROWS]
    distinct = np.unique(values)
    steps = np.diff(distinct)
    steps = steps[steps > RELATIVE_ROUNDING * max(np.abs(distinct).max(), 1e-300)]
    if len(steps) < MIN_GRID_STEPS or len(distinct) > MAX_DISTINCT_SHARE * len(values):
        return None
    spacing = float(np.median(steps[steps < 1.5 * steps.min()]))
    multiple = (values - values[0]) / spacing
    on_grid = np.abs(multiple - np.round(multiple)) < GRID_TOLERANCE
    return spacing if np.mean(on_grid) >= MIN_GRID_SHARE else None


def check_coarse(block: Block, robot: Robot, i: int) -> Remark | None:
    """Remark a position with a resolution coarser than 1e-4 rad or 1e-5 m."""
    spacing = grid_spacing(block.values["q"][:, i])
    if spacing is None or spacing <= _tolerance(robot, i):
        return None
    joint, unit = robot.joints[i], robot.entries[i].unit("rad")
    text = f"joint '{joint}': positions are multiples of {spacing:.3g} {unit}"
    return Remark(RemarkKind.COARSE, text, joint)


def check_outside(block: Block, robot: Robot, i: int, limits: Limits | None) -> Remark | None:
    """Remark positions beyond the limits by more than 1 % of their range."""
    stated = robot.entries[i].position if limits is None else tuple(limits.position[i])
    if stated is None or not np.isfinite(stated).all():
        return None
    q = block.values["q"][:, i]
    lower, upper = stated
    excess = np.maximum(q - upper, lower - q)
    if excess.max() <= MAX_EXCESS_SHARE * (upper - lower):
        return None
    row = int(np.argmax(excess))
    joint, time = robot.joints[i], float(block.t[row])
    text = f"joint '{joint}' is at {q[row]:.4g}, outside its limits [{lower:.4g}, {upper:.4g}]"
    return Remark(RemarkKind.OUTSIDE, text, joint, time, time)


def _longest_constant_run(values: FloatArray) -> tuple[int, int]:
    """First and last row of the longest run of the same value."""
    runs = true_runs(np.diff(values) == 0.0)
    if not len(runs):
        return 0, 0
    start, end = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    return int(start), int(end)


def _frozen_rows(block: Block, values: FloatArray) -> slice | None:
    """Rows of the longest run of the same value, None if it is short."""
    start, end = _longest_constant_run(values)
    is_long = (
        end - start + 1 >= MIN_FROZEN_ROWS and block.t[end] - block.t[start] >= MIN_FROZEN_TIME
    )
    return slice(start, end + 1) if is_long else None


def check_frozen_torque(block: Block, robot: Robot, i: int, name: str) -> Remark | None:
    """Remark a torque or current that is constant for 0.1 s and 20 rows while the joint moves by 1
    % of its range.

    It is doubted if it is constant in a tenth of all rows, in which the joint reverses, and neither
    its resolution is coarse nor is its drive off: 0 while the commanded position stands.
    """
    rows = _frozen_rows(block, block.values[name][:, i])
    q = block.values["q"][:, i]
    if rows is None or np.ptp(q[rows]) <= MIN_MOTION_SHARE * np.ptp(q):
        return None
    remark = _frozen_remark(block, robot.joints[i], name, rows)
    is_doubtful = (
        len(q[rows]) >= MIN_DOUBTED_SHARE * len(q)
        and _reverses(q[rows], MIN_REVERSED_SHARE * float(np.ptp(q)))
        and len(np.unique(block.values[name][:, i])) >= MIN_DISTINCT_VALUES
        and not _is_off(block, rows, i, name)
    )
    if not is_doubtful:
        return remark
    share = f"{100.0 * len(q[rows]) / len(q):.0f} % of the rows"
    text = f"{remark.text} and reverses, in {share}; check the measurement, and cut these rows out"
    return dataclasses.replace(remark, text=text, doubt=True)


def check_repeated_torque(block: Block, robot: Robot, i: int, name: str) -> Remark | None:
    """Remark a torque or current that has one value in several per cent of the rows in which the
    joint moves, as in a dead band or where the measurement fails.

    They must be three times as many as at any other value. Around a turning point of the torque its
    resolution repeats a value, too, but the values before and after it are the next ones: only
    stretches to which the torque jumps count. Neither do rows in which the joint is commanded to
    stand, as it has no torque where the drive is off.
    """
    q, values = block.values["q"][:, i], block.values[name][:, i]
    moving = _is_moving(block.t, q, _tolerance(robot, i))
    if "qref" in block.values:
        moving &= _is_moving(block.t, block.values["qref"][:, i], _tolerance(robot, i))
    distinct, place, counts = np.unique(values[moving], return_inverse=True, return_counts=True)
    if len(distinct) < MIN_DISTINCT_VALUES:
        return None
    jumps = np.abs(np.diff(values, prepend=np.inf, append=np.inf))
    starts = np.flatnonzero(jumps[:-1])
    edges = np.minimum(jumps[starts], jumps[np.append(starts[1:], len(values))])
    lengths = np.diff(np.append(starts, len(values)))
    apart = np.repeat(edges > MIN_JUMP_STEPS * np.diff(distinct).min(), lengths)
    count_apart = np.bincount(place[apart[moving]], minlength=len(distinct))
    k = int(np.argmax(count_apart))
    count, others = int(count_apart[k]), int(np.delete(counts, k).max())
    smallest = max(MIN_FROZEN_ROWS, MIN_REPEATED_SHARE * moving.sum())
    if count < max(smallest, MIN_CLIPPED_RATIO * others):
        return None
    value = float(distinct[k]) + 0.0  # no −0
    joint, rows = robot.joints[i], np.flatnonzero(moving & apart & (values == value))
    unit = "A" if name == "current" else robot.entries[i].unit("N m")
    text = (
        f"joint '{joint}': {name} is {value:.5g} {unit} in {count} rows of its motion "
        f"({100.0 * count / moving.sum():.2g} %), and no other value in more than {others}; if "
        "that is a dead band or a fault of the measurement, cut these rows out"
    )
    start, end = (float(block.t[row]) for row in rows[[0, -1]])
    return Remark(RemarkKind.REPEATED_TORQUE, text, joint, start, end)


def _is_moving(t: FloatArray, q: FloatArray, tolerance: float) -> BoolArray:
    """Mark rows around which a joint moves within 0.1 s. Shape (N,).

    By 0.1 % of its range, and by twice a tolerance, which a joint that stands still does not reach.
    """
    before = q[np.searchsorted(t, t - 0.5 * MIN_FROZEN_TIME)]
    after = q[np.minimum(np.searchsorted(t, t + 0.5 * MIN_FROZEN_TIME), len(t) - 1)]
    distance = np.minimum(np.abs(q - before), np.abs(after - q))
    return np.asarray(distance > max(0.5 * MIN_POSE_SHARE * float(np.ptp(q)), tolerance))


def _is_off(block: Block, rows: slice, i: int, name: str) -> bool:
    """Return True if a joint has no torque, and is commanded to stand."""
    if "qref" not in block.values or block.values[name][rows, i].any():
        return False
    commanded = float(np.ptp(block.values["qref"][rows, i]))
    return commanded < MIN_MOTION_SHARE * float(np.ptp(block.values["q"][:, i]))


def _reverses(q: FloatArray, distance: float) -> bool:
    """Return True if positions move by more than a distance in either direction."""
    rise = float((q - np.minimum.accumulate(q)).max())
    fall = float((np.maximum.accumulate(q) - q).max())
    return min(rise, fall) > distance


def check_frozen_position(block: Block, robot: Robot, i: int) -> Remark | None:
    """Remark a position that is constant for 0.1 s and 20 rows while qref, or the integral of |dq|,
    changes by 1 % of the range."""
    q = block.values["q"][:, i]
    rows = _frozen_rows(block, q)
    if rows is None:
        return None
    motions = {}
    if "qref" in block.values:
        motions["its command moves"] = float(np.ptp(block.values["qref"][rows, i]))
    if "dq" in block.values:
        duration = float(block.t[rows][-1] - block.t[rows][0])
        speed = abs(float(np.nan_to_num(np.mean(block.values["dq"][rows, i]))))
        motions["its velocity is not zero"] = speed * duration
    cause, motion = max(motions.items(), key=lambda item: item[1], default=("", 0.0))
    is_frozen = motion > MIN_MOTION_SHARE * np.ptp(q) and motion > ANGLE_TOLERANCE
    return _frozen_remark(block, robot.joints[i], "q", rows, cause) if is_frozen else None


def _frozen_remark(
    block: Block, joint: str, name: str, rows: slice, motion: str = "the joint moves"
) -> Remark:
    start, end = float(block.t[rows.start]), float(block.t[rows.stop - 1])
    text = (
        f"joint '{joint}': {name} is constant from {shown_time(start)} to {shown_time(end)} s "
        f"while {motion}"
    )
    return Remark(RemarkKind.FROZEN, text, joint, start, end)


def check_clipped(block: Block, robot: Robot, i: int, name: str) -> Remark | None:
    """Remark a torque or current that is clipped at its largest or smallest value."""
    values = block.values[name][:, i]
    rows = np.flatnonzero(_is_clipped(values, block.values["q"]))
    if not len(rows):
        return None
    joint = robot.joints[i]
    unit = "A" if name == "current" else robot.entries[i].unit("N m")
    extremes = " and ".join(f"{value:.5g}" for value in np.unique(values[rows]))
    text = (
        f"joint '{joint}': {name} is clipped at {extremes} {unit}, in "
        f"{100.0 * len(rows) / len(values):.2g} % of the rows; if that is the range of the "
        "measurement and not the limit of the drive, cut these rows out"
    )
    start, end = block.t[rows[[0, -1]]].tolist()
    return Remark(RemarkKind.CLIPPED, text, joint, start, end)


def _is_clipped(values: FloatArray, q: FloatArray) -> BoolArray:
    """Mark rows at which a signal is clipped at its largest or smallest value.

    A clipped signal has five measurements at the extreme value, at least three times as many as at
    the most frequent of the ten values next to it. Consecutive rows with the same value are one
    measurement that is held, where they are no more than in the longest run at another value. Rows
    in one pose do not count: a torque is constant at rest. Nor does 0, which is no end of a range
    but the value of a drive or a measurement that is off.

    Args:
        values: The signal. Shape (N,).
        q: Positions of all joints. Shape (N, n) [rad or m].
    """
    starts = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    lengths, runs = np.diff(starts, append=len(values)), values[starts]
    distinct, counts = np.unique(runs, return_counts=True)
    out = np.zeros(len(values), bool)
    if len(distinct) < MIN_DISTINCT_VALUES:
        return out
    longest = lengths[(runs != distinct[0]) & (runs != distinct[-1])].max()
    run_of_row, k = np.repeat(np.arange(len(runs)), lengths), NEIGHBOURING_VALUES
    for extreme, neighbours in (
        (distinct[0], counts[1 : 1 + k]),
        (distinct[-1], counts[-1 - k : -1]),
    ):
        if extreme == 0.0:
            continue
        rows = np.flatnonzero(values == extreme)
        distance = np.abs(q[rows] - np.median(q[rows], axis=0))
        in_motion = (distance > MIN_POSE_SHARE * np.ptp(q, axis=0)).any(axis=1)
        _, rows_in_run = np.unique(run_of_row[rows[in_motion]], return_counts=True)
        count = np.ceil(rows_in_run / longest).sum()
        out[rows] = count >= max(MIN_CLIPPED_RATIO * neighbours.max(), MIN_CLIPPED_COUNT)
    return out
