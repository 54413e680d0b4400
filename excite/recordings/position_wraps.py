"""Positions of revolute joints that are wrapped to ±π or [0, 2π), or a whole turn off."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from ..robot.limits import Limits
from ..robot.parameter_names import plural
from ..robot.robot import Robot
from .block import Block
from .remark import Remark, RemarkKind, shown_time

TURN = 2.0 * np.pi
"""One turn [rad]."""
WRAP_TOLERANCE = 0.1 * TURN
"""Difference of a step from whole turns that is taken for motion within one row [rad]: at 30 rows a
second 19 rad/s, more than any arm reaches, and far from the half turn where a step is ambiguous."""
LIMIT_TOLERANCE = 0.1
"""Distance by which positions may exceed their limits after a shift by whole turns [rad]: robots
stop a few degrees beyond a soft limit."""


def is_plausible(q: FloatArray, robot: Robot, i: int, limits: Limits | None) -> bool:
    """Return True if positions are within a turn of their limits, and so not in degrees.

    Args:
        q: Positions of one joint. Shape (N,) [rad or m].
        robot: The robot.
        i: Index of the joint.
        limits: Limits of the robot, None: those of the URDF.
    """
    stated = _limits(robot, i, limits)
    if robot.entries[i].kind == "prismatic" or stated is None:
        return True
    known = q[np.isfinite(q)]
    return not len(known) or bool(
        known.min() >= stated[0] - TURN - LIMIT_TOLERANCE
        and known.max() <= stated[1] + TURN + LIMIT_TOLERANCE
    )


def unwrap_positions(
    block: Block, robot: Robot, limits: Limits | None
) -> tuple[Block, list[Remark]]:
    """Unwrap positions, and shift them by whole turns into their limits.

    A step of whole turns between two rows is no motion. Torque does not depend on whole turns.

    Args:
        block: Rows in the order of time, without glitches.
        robot: The robot.
        limits: Its limits, None: those of the URDF.
    """
    values = dict(block.values)
    remarks: list[Remark] = []
    for i, joint in enumerate(robot.joints):
        if robot.entries[i].kind == "prismatic":
            continue
        q = block.values["q"][:, i]
        if not is_plausible(q, robot, i, limits):
            continue
        unwrapped, wraps = unwrap_steps(q)
        turns = _turns_into_limits(unwrapped, _limits(robot, i, limits))
        q = unwrapped + TURN * turns if turns else unwrapped
        others = _aligned(block, q, robot, i, limits)
        for name, column in {**others, "q": q}.items():
            values[name] = values[name].copy()
            values[name][:, i] = column
        if not len(wraps) and not turns:
            remarks += [_aligned_remark(joint, name) for name in others]
            continue
        done = []
        if len(wraps):
            done.append(
                f"{plural(len(wraps), 'step')} of a whole turn from one row to the next "
                f"(the first at {shown_time(block.t[wraps[0]])} s) are unwrapped"
            )
        if turns:
            shift = f"{turns:+d} turn{'s' if abs(turns) > 1 else ''}"
            done.append(f"positions are shifted by {shift} into their limits")
        text = f"joint '{joint}': {'; '.join(done)}"
        start, end = (
            (float(block.t[wraps[0]]), float(block.t[wraps[-1]])) if len(wraps) else (None, None)
        )
        remarks.append(Remark(RemarkKind.WRAPPED, text, joint, start, end, repaired=True))
    return (Block(block.t, values, block.remarks), remarks) if remarks else (block, [])


def _aligned(
    block: Block, q: FloatArray, robot: Robot, i: int, limits: Limits | None
) -> dict[str, FloatArray]:
    """Commanded and link positions of a joint that are unwrapped, or on another turn than q.

    Args:
        block: Rows as they were recorded.
        q: Positions of the joint, unwrapped. Shape (N,) [rad].
        robot: The robot.
        i: Index of the joint.
        limits: Limits of the robot, None: those of the URDF.

    Returns:
        Columns that differ from the recorded ones, by name of the quantity.
    """
    out: dict[str, FloatArray] = {}
    for name in ("qref", "qlink"):
        column = block.values[name][:, i] if name in block.values else q
        known = np.isfinite(q) & np.isfinite(column)
        if column is q or not known.any():
            continue
        unwrapped, wraps = unwrap_steps(column)
        turns = np.round(np.median((q - unwrapped)[known]) / TURN)
        aligned = unwrapped + TURN * turns
        if (len(wraps) or turns) and is_plausible(aligned, robot, i, limits):
            out[name] = aligned
    return out


def _aligned_remark(joint: str, name: str) -> Remark:
    text = f"joint '{joint}': {name} is moved by whole turns to the turn of q"
    return Remark(RemarkKind.WRAPPED, text, joint, repaired=True)


def unwrap_steps(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions without steps of whole turns, and the rows behind such a step.

    Args:
        q: Positions of a revolute joint, NaN where one is missing. Shape (N,) [rad].

    Returns:
        The positions, shape (N,) [rad], and the indices of the rows behind each step. Shape (W,).
    """
    known = np.flatnonzero(np.isfinite(q))
    steps = np.diff(q[known])
    turns = np.round(steps / TURN)
    turns[np.abs(steps - TURN * turns) > WRAP_TOLERANCE] = 0.0
    wraps = known[1:][turns != 0.0]
    if not len(wraps):
        return q, wraps
    out = q.copy()
    out[known[1:]] -= TURN * np.cumsum(turns)
    return out, wraps


def _turns_into_limits(q: FloatArray, stated: tuple[float, float] | None) -> int:
    """Smallest number of turns that brings positions into their limits; 0 if none does."""
    known = q[np.isfinite(q)]
    if stated is None or not len(known):
        return 0
    low = np.ceil((stated[0] - LIMIT_TOLERANCE - known.min()) / TURN)
    high = np.floor((stated[1] + LIMIT_TOLERANCE - known.max()) / TURN)
    return 0 if low > high else int(np.clip(0, low, high))


def _limits(robot: Robot, i: int, limits: Limits | None) -> tuple[float, float] | None:
    """Position limits of a joint, None where it has none."""
    stated = robot.entries[i].position if limits is None else tuple(limits.position[i])
    if stated is None or not np.isfinite(stated).all():
        return None
    return float(stated[0]), float(stated[1])
