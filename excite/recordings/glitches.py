"""Single wrong readings: positions that no joint can have reached, torques far beyond the limit."""

from __future__ import annotations

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..errors import UnusableInput
from ..robot.limits import Limits
from ..robot.parameter_names import plural
from ..robot.robot import Robot
from .block import Block
from .encoder_resolution import MULTIPLE_TOLERANCE
from .missing_values import true_runs
from .position_wraps import TURN, is_plausible
from .remark import Remark, RemarkKind, shown_time

MAX_SPEED_RATIO = 2.0
"""Speed between two rows over the velocity limit that a joint cannot have [1]. Controllers stop a
joint a few per cent above its limit; the ten machines of the shared recordings stay below it."""
MAX_TORQUE_RATIO = 3.0
"""|torque| over its limit above which a single reading is no measurement [1]. Recordings of ten
real machines reach 0.9."""
MAX_GLITCH_SHARE = 0.02
"""Largest share of rows of a joint that are glitches, and of rows in one glitch [1]: a fault that
hits one row in fifty is not a rare one, and its source has to be found."""
MAX_SPEEDING_SHARE = 0.2
"""Share of rows beyond the velocity limit from which the limit, or a unit, is doubted instead
[1]."""
SHORT_STEP = 0.7
"""Time step over the usual one below which the stamp of the row before was late [1]."""
MAX_TIMING_ERROR = 1.0
"""Error of the time between two readings over the usual time step [1], where jitter of the stamps
moves many readings: each is late or early by up to half a step."""
COARSEST_STEP = TURN / 256
"""Largest change of a revolute joint at rest that is taken for a step of its encoder where it
recurs with one size [rad]: 8 bits per turn, of a potentiometer with the coarsest usual converter.
Larger ones are wrong readings of one value."""
RESOLUTION_STEPS = 2.0
"""Change of a position that its resolution may cause, over the smallest change [1]."""


def mask_glitches(
    source: str, block: Block, robot: Robot, limits: Limits | None
) -> tuple[Block, list[Remark]]:
    """Replace glitches by missing values, and remove rows that hold nothing else.

    A position is a glitch if the joint would have to move at more than twice its velocity limit to
    reach it from the rows before and behind; wrapped positions are not. A torque is one if it
    exceeds three times its limit in few rows. Where the positions of all of several joints are
    glitches, the reading failed: its torques and velocities are no measurements either, and the
    row is removed.

    Args:
        source: Name of the recording, for messages.
        block: Rows in the order of time.
        robot: The robot.
        limits: Its limits, None: those of the URDF.

    Returns:
        The rows, NaN where a value is a glitch, and remarks.

    Raises:
        UnusableInput: More than MAX_GLITCH_SHARE of a joint's positions are glitches, as where two
            publishers are mixed.
    """
    t, positions = block.t, block.values["q"]
    wrong, remarks = np.zeros(positions.shape, bool), list[Remark]()
    for i, joint in enumerate(robot.joints):
        velocity, q = _velocity_limit(robot, limits, i), positions[:, i]
        if np.isfinite(velocity) and is_plausible(q, robot, i, limits):
            is_angle = robot.entries[i].kind != "prismatic"
            wrong[:, i], jumps = _position_glitches(t, q, velocity, is_angle)
            if wrong[:, i].mean() > MAX_GLITCH_SHARE or len(jumps):
                wrong[:, i], jumps = _position_glitches(t, q, velocity, is_angle, MAX_TIMING_ERROR)
            remarks += _jump_remarks(joint, t, q, jumps, velocity)
    failed = np.asarray(wrong.all(axis=1)) if robot.n > 1 else np.zeros(len(t), bool)
    if 0 < failed.sum() <= MAX_GLITCH_SHARE * len(failed):
        remarks.append(_failed_remark(t[failed]))
        block, wrong = block.rows(~failed), wrong[~failed]
    values = dict(block.values)
    for i, joint in enumerate(robot.joints):
        velocity = _velocity_limit(robot, limits, i)
        remarks += _mask(source, values, "q", i, joint, block.t, wrong[:, i], velocity)
        torque = robot.entries[i].torque if limits is None else float(limits.torque[i])
        if torque is not None and np.isfinite(torque) and "tau" in values:
            with np.errstate(invalid="ignore"):
                is_beyond = np.abs(block.values["tau"][:, i]) > MAX_TORQUE_RATIO * torque
            if 0 < is_beyond.sum() <= MAX_GLITCH_SHARE * len(is_beyond):
                remarks += _mask(source, values, "tau", i, joint, block.t, is_beyond, torque)
    return (Block(block.t, values, block.remarks), remarks) if remarks else (block, [])


def _velocity_limit(robot: Robot, limits: Limits | None, i: int) -> float:
    """Return the velocity limit of a joint, NaN without one [rad/s or m/s]."""
    velocity = robot.entries[i].velocity if limits is None else float(limits.velocity[i])
    return np.nan if velocity is None else velocity


def _failed_remark(t: FloatArray) -> Remark:
    """Remark rows in which the positions of all joints are glitches."""
    text = (
        f"{plural(len(t), 'row')} (the first at {shown_time(t[0])} s) "
        f"{'is' if len(t) == 1 else 'are'} removed as failed: no motion below {MAX_SPEED_RATIO:g} "
        "times the velocity limits reaches the position of any joint in them"
    )
    return Remark(RemarkKind.GLITCH, text, None, float(t[0]), float(t[-1]), repaired=True)


def _position_glitches(
    t: FloatArray, q: FloatArray, velocity: float, is_angle: bool, timing_error: float = 0.0
) -> tuple[BoolArray, IntArray]:
    """Find short runs that cannot be reached from the longest stretch of possible motion.

    Args:
        t: Times. Shape (N,) [s].
        q: Positions of a joint. Shape (N,) [rad or m].
        velocity: Its velocity limit [rad/s or m/s].
        is_angle: True if whole turns do not count.
        timing_error: Error of the time between two readings over the usual time step [1].

    Returns:
        True for rows of such runs, shape (N,), and the rows at which longer runs begin, which are
        kept.
    """
    out, jumps = np.zeros(len(q), bool), list[int]()
    known = np.flatnonzero(np.isfinite(q))
    if len(known) < 2:
        return out, np.array(jumps, int)
    change = _distance(q[known[1:]], q[known[:-1]], is_angle)
    slack = RESOLUTION_STEPS * _smallest_step(q[known], change, is_angle)
    steps = np.diff(t[known])
    usual = float(np.median(steps))
    slack += MAX_SPEED_RATIO * velocity * timing_error * usual
    # a short step follows a late stamp: the motion of two usual steps
    steps = np.where(steps < SHORT_STEP * usual, 2.0 * usual, steps)
    allowed = MAX_SPEED_RATIO * velocity * steps + slack
    is_jump = change > allowed
    if not is_jump.any():
        return out, np.array(jumps, int)
    if is_jump.mean() > MAX_SPEEDING_SHARE and not _repeats(q[known]):
        return out, known[1:][is_jump]
    bounds = np.concatenate([[0], np.flatnonzero(is_jump) + 1, [len(known)]])
    lengths = np.diff(bounds)
    longest = int(np.argmax(lengths))
    for order in (range(longest + 1, len(lengths)), range(longest - 1, -1, -1)):
        forward = order.step > 0
        trusted = known[bounds[longest + 1] - 1] if forward else known[bounds[longest]]
        for run in order:
            rows = known[bounds[run] : bounds[run + 1]]
            near, far = (rows[0], rows[-1]) if forward else (rows[-1], rows[0])
            reach = MAX_SPEED_RATIO * velocity * max(abs(t[near] - t[trusted]), usual) + slack
            if _distance(q[near], q[trusted], is_angle) <= reach:
                trusted = far
            elif len(rows) > MAX_GLITCH_SHARE * len(q):
                trusted = far
                jumps.append(int(rows[0] if forward else rows[-1] + 1))
            else:
                out[rows] = True
    return out, np.array(sorted(jumps), int)


def _smallest_step(q: FloatArray, change: FloatArray, is_angle: bool) -> float:
    """Return the smallest change of a position that is not one to a possible glitch.

    A few readings between two equal ones may be wrong, as a single zero of a joint at rest, and
    tell nothing of the resolution; where they are many, or recur with the size of one step of an
    encoder, they are its steps.

    Args:
        q: Positions. Shape (N,) [rad or m].
        change: Distances of successive positions. Shape (N − 1,) [rad or m].
        is_angle: True if whole turns do not count.

    Returns:
        0 if there is none [rad or m].
    """
    starts = np.concatenate([[0], np.flatnonzero(change > 0.0) + 1])
    lengths = np.diff([*starts, len(q)])
    most = MAX_GLITCH_SHARE * len(q)
    returns = np.zeros(len(starts), bool)
    returns[1:-1] = _distance(q[starts[2:]], q[starts[:-2]], is_angle) == 0.0
    returns &= lengths <= most
    steps = change[starts[1:] - 1]
    excursions = starts[returns]
    if lengths[returns].sum() <= most and not _are_encoder_steps(
        q[excursions], change[excursions - 1], is_angle
    ):
        steps = steps[~(returns[1:] | returns[:-1])]
    return float(steps.min()) if len(steps) else 0.0


def _are_encoder_steps(readings: FloatArray, sizes: FloatArray, is_angle: bool) -> bool:
    """Return True if the smallest excursions of an angle recur with the size of an encoder's step.

    Zeros are those of failed readings.

    Args:
        readings: First reading of each excursion. Shape (E,) [rad or m].
        sizes: Distance from the reading before. Shape (E,) [rad or m].
        is_angle: True for a revolute joint.
    """
    smallest = float(sizes.min(initial=np.inf))
    if not is_angle or smallest > COARSEST_STEP:
        return False
    is_step = sizes <= (1.0 + MULTIPLE_TOLERANCE) * smallest
    return bool(is_step.sum() > 1 and readings[is_step].all())


def _jump_remarks(
    joint: str, t: FloatArray, q: FloatArray, jumps: IntArray, velocity: float
) -> list[Remark]:
    """Remark steps between stretches that no motion connects."""
    if not len(jumps):
        return []
    row = int(jumps[np.argmax(np.abs(q[jumps] - q[jumps - 1]))])
    speed = abs(q[row] - q[row - 1]) / max(t[row] - t[row - 1], 1e-12)
    text = (
        f"joint '{joint}': position steps by {q[row] - q[row - 1]:.4g} at {shown_time(t[row])} s, "
        f"{speed / velocity:.3g} times the velocity limit {velocity:.4g}, and at {len(jumps)} "
        "places in all; check the unit of time and position, and the velocity limit"
    )
    return [Remark(RemarkKind.SPEED, text, joint, float(t[row - 1]), float(t[row]), doubt=True)]


def _repeats(q: FloatArray) -> bool:
    """Return True if one value alone makes up a twentieth of a signal, as filled-in zeros do."""
    return bool(np.unique(q, return_counts=True)[1].max() > 0.05 * len(q))


def _distance(a: FloatArray, b: FloatArray, is_angle: bool) -> FloatArray:
    """|a − b|, for angles up to whole turns."""
    change = np.asarray(a - b)
    if is_angle:
        change = change - TURN * np.round(change / TURN)
    return np.abs(change)


def _mask(
    source: str,
    values: dict[str, FloatArray],
    name: str,
    i: int,
    joint: str,
    t: FloatArray,
    wrong: BoolArray,
    limit: float,
) -> list[Remark]:
    """Replace wrong values of a joint by NaN, and say so."""
    count = int(wrong.sum())
    if not count:
        return []
    runs = true_runs(wrong)
    sample = float(values[name][runs[0, 0], i])
    reason = (
        f"beyond any motion below {MAX_SPEED_RATIO:g} times the velocity limit {limit:.4g}"
        if name == "q"
        else f"beyond {MAX_TORQUE_RATIO:g} times the torque limit {limit:.4g}"
    )
    example = f"the first {sample:.4g} at {shown_time(t[runs[0, 0]])} s"
    place = f"{plural(count, 'reading')} of {name} ({example})"
    if count > MAX_GLITCH_SHARE * len(wrong):
        raise UnusableInput(
            f"{source}: joint '{joint}': {place} of {len(wrong)} are impossible: {reason}; "
            "record one publisher alone, or correct the velocity limit with --limits"
        )
    values[name] = np.where(
        (np.arange(values[name].shape[1]) == i) & wrong[:, None], np.nan, values[name]
    )
    verb = "is" if count == 1 else "are"
    text = (
        f"joint '{joint}': {place} {verb} removed as glitch{'' if count == 1 else 'es'}: {reason}"
    )
    first, last = np.flatnonzero(wrong)[[0, -1]]
    return [Remark(RemarkKind.GLITCH, text, joint, float(t[first]), float(t[last]), repaired=True)]
