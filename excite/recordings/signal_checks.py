"""Signs of trouble in single channels: remarked, not changed."""

from __future__ import annotations

import numpy as np

from ..robot.limits import Limits
from ..robot.robot import Robot
from .block import Block
from .missing_values import runs
from .remark import Kind, Remark

Array = np.ndarray
STILL = {"prismatic": 1e-5}
"""Motion below which a joint doesn't move [m]; 1e-4 rad for joints that turn."""
COARSE = {"prismatic": 1e-5}
"""Resolution above which a position counts as coarse [m]; 1e-4 rad (16 bit a turn) for joints that
turn."""
ANGLE = 1e-4
LOOK = 200_000
"""Rows looked at for the resolution."""
ON_GRID = 0.99
FROZEN = 0.1
"""Shortest time for which a value that stands still is remarked [s]."""
FEWEST = 20
MOVED = 0.01
"""Share of a joint's range that it should have moved meanwhile."""
FLAT = 5
"""Rows in a row at the extreme that make clipping."""
PILED = 3.0
"""So many times the rows of a common value pile up at the extreme."""


def look(block: Block, robot: Robot, limits: Limits | None) -> list[Remark]:
    """All signs, joint by joint."""
    out: list[Remark | None] = []
    for i in range(robot.n):
        out += [
            still(block, robot, i),
            coarse(block, robot, i),
            outside(block, robot, i, limits),
            frozen_position(block, robot, i),
        ]
        for name in ("tau", "current"):
            if name in block.values and np.isfinite(block.values[name][:, i]).all():
                flat = clipped(block, robot, i, name)
                out.append(flat or frozen_torque(block, robot, i, name))
    return [remark for remark in out if remark is not None]


def still(block: Block, robot: Robot, i: int) -> Remark | None:
    """A joint that moves by less than 1e-4 rad (1e-5 m): nothing can be learnt of it alone."""
    if np.ptp(block.values["q"][:, i]) >= STILL.get(robot.entries[i].kind, ANGLE):
        return None
    return Remark(Kind.STILL, f"joint '{robot.joints[i]}' never moves", robot.joints[i])


def resolution(values: Array) -> float | None:
    """Spacing of the values if 99 % of them lie on a grid and repeat, else None: the smallest
    difference of distinct values."""
    values = values[:LOOK]
    distinct = np.unique(values)
    steps = np.diff(distinct)
    steps = steps[
        steps > 1e-9 * max(np.abs(distinct).max(), 1e-300)
    ]  # not what rounding leaves of equal values
    if len(steps) < 5 or len(distinct) > 0.5 * len(values):
        return None
    spacing = float(np.median(steps[steps < 1.5 * steps.min()]))
    cells = (values - values[0]) / spacing
    return spacing if np.mean(np.abs(cells - np.round(cells)) < 0.05) >= ON_GRID else None


def coarse(block: Block, robot: Robot, i: int) -> Remark | None:
    """A position on a grid coarser than 1e-4 rad (1e-5 m)."""
    spacing = resolution(block.values["q"][:, i])
    if spacing is None or spacing <= COARSE.get(robot.entries[i].kind, ANGLE):
        return None
    joint = robot.joints[i]
    return Remark(
        Kind.COARSE,
        f"joint '{joint}': positions are multiples of {spacing:.3g} {robot.entries[i].unit('rad')}",
        joint,
    )


def outside(block: Block, robot: Robot, i: int, limits: Limits | None) -> Remark | None:
    """Positions beyond the limits by more than 1 % of their range."""
    stated = robot.entries[i].position if limits is None else tuple(limits.position[i])
    if stated is None or not np.isfinite(stated).all():
        return None
    q = block.values["q"][:, i]
    lower, upper = stated
    beyond = np.maximum(q - upper, lower - q)
    if beyond.max() <= 0.01 * (upper - lower):
        return None
    at = int(np.argmax(beyond))
    text = f"joint '{robot.joints[i]}' is at {q[at]:.4g}, outside its limits [{lower:.4g}, {upper:.4g}]"  # noqa: E501
    return Remark(Kind.OUTSIDE, text, robot.joints[i], float(block.t[at]), float(block.t[at]))


def _longest_constant(values: Array) -> tuple[int, int]:
    """First and last row of the longest run of one value."""
    found = runs(np.diff(values) == 0.0)
    if not len(found):
        return 0, 0
    start, end = found[np.argmax(found[:, 1] - found[:, 0])]
    return int(start), int(end)


def _stood(block: Block, values: Array) -> slice | None:
    start, end = _longest_constant(values)
    long = end - start + 1 >= FEWEST and block.t[end] - block.t[start] >= FROZEN
    return slice(start, end + 1) if long else None


def frozen_torque(block: Block, robot: Robot, i: int, name: str) -> Remark | None:
    """A torque or current that keeps its exact value for 0.1 s and 20 rows while the joint moves
    through 1 % of its range."""
    run = _stood(block, block.values[name][:, i])
    q = block.values["q"][:, i]
    if run is None or np.ptp(q[run]) <= MOVED * np.ptp(q):
        return None
    return _frozen(block, robot.joints[i], name, run)


def frozen_position(block: Block, robot: Robot, i: int) -> Remark | None:
    """A position that keeps its exact value for 0.1 s and 20 rows while qref, or the integral of
    |dq|, goes through 1 % of its range."""
    q = block.values["q"][:, i]
    run = _stood(block, q)
    if run is None:
        return None
    moved = 0.0
    if "qref" in block.values:
        moved = float(np.ptp(block.values["qref"][run, i]))
    if "dq" in block.values:
        moved = np.fmax(
            moved,
            abs(float(np.mean(block.values["dq"][run, i])))
            * float(block.t[run][-1] - block.t[run][0]),
        )
    return (
        _frozen(block, robot.joints[i], "q", run)
        if moved > MOVED * np.ptp(q) and moved > ANGLE
        else None
    )


def _frozen(block: Block, joint: str, name: str, run: slice) -> Remark:
    start, end = float(block.t[run.start]), float(block.t[run.stop - 1])
    return Remark(
        Kind.FROZEN,
        f"joint '{joint}': {name} stands still from {start:.4g} to {end:.4g} s while the joint "
        "moves",
        joint,
        start,
        end,
    )


def clipped(block: Block, robot: Robot, i: int, name: str) -> Remark | None:
    """A torque or current with a run of 5 rows exactly at its largest or smallest value, where
    three times as many rows lie as at the commonest of the ten values next to it.
    """
    values = block.values[name][:, i]
    distinct, counts = np.unique(values, return_counts=True)
    for at, near in ((-1, slice(-11, -1)), (0, slice(1, 11))):
        if len(distinct) < 20 or counts[at] < max(PILED * counts[near].max(), FLAT):
            continue
        flat = runs(values == distinct[at])
        if (flat[:, 1] - flat[:, 0]).max() >= FLAT:
            start, end = float(block.t[flat[0, 0]]), float(block.t[flat[-1, 1] - 1])
            text = f"joint '{robot.joints[i]}': {name} is clipped at {distinct[at]:.5g} in {counts[at]} rows"  # noqa: E501
            return Remark(Kind.CLIPPED, text, robot.joints[i], start, end)
    return None
