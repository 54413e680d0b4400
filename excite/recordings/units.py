"""Wrong units: degrees, millimetres, milliseconds."""

from __future__ import annotations

import numpy as np

from ..errors import UnusableInput
from ..robot.limits import Limits
from ..robot.robot import Robot
from .block import Block
from .remark import Kind, Remark

Array = np.ndarray
FAR = 2.0
"""A revolute joint is far beyond its limits at twice their larger magnitude; a prismatic one at ten
times."""
FAR_LENGTH = 10.0
SLACK = 1.1
"""Converted positions may exceed the limits by a tenth."""
LEAST, LEAST_LENGTH = 1.0, 0.05
"""Reach of a joint whose limits are narrower [rad], [m]: a limit tightened for a design says
nothing of units."""
TURNS = 4.0 * np.pi
"""Reach of a revolute joint without position limits [rad]."""
CLEAR = 0.7
"""Correlation above which a slope and a velocity can be compared."""
RATIOS = (
    (180.0 / np.pi, "q is in degrees but dq in rad/s; convert q to rad"),
    (np.pi / 180.0, "dq is in degrees/s but q in rad; convert dq to rad/s"),
    (1e-3, "time is in ms; divide it by 1000"),
    (1e-6, "time is in µs; divide it by 1e6"),
    (1e-9, "time is in ns; divide it by 1e9"),
)


def reach(robot: Robot, limits: Limits | None) -> Array:
    """Largest |position| that the limits or the URDF allow, at least 1 rad or 0.05 m. Shape (n,)
    [rad or m].

    4π for a revolute joint without limits; inf for other joints without.
    """
    out = np.full(robot.n, np.inf)
    for i, entry in enumerate(robot.entries):
        stated = [*(entry.position or ()), *(() if limits is None else limits.position[i])]
        if stated and np.isfinite(stated).all():
            out[i] = max(np.abs(stated).max(), LEAST_LENGTH if entry.kind == "prismatic" else LEAST)
        elif entry.kind == "revolute":
            out[i] = TURNS
    return out


def check_positions(source: str, block: Block, robot: Robot, limits: Limits | None) -> None:
    """UnusableInput where positions are not in rad or m.

    Rule: a revolute joint beyond twice its reach is in degrees when that brings every joint within
        1.1 times its reach, else in a unit of its own, encoder counts say. A prismatic joint beyond
        ten times its reach is in mm when a thousandth lies within it.
    """
    largest = np.nanmax(np.abs(block.values["q"]), axis=0)
    bounds = reach(robot, limits)
    turning = np.array([entry.kind != "prismatic" for entry in robot.entries])
    far = np.flatnonzero(largest > np.where(turning, FAR, FAR_LENGTH) * bounds)
    if not len(far):
        return
    i = far[0]
    said = f"{source}: joint '{robot.joints[i]}' reaches {largest[i]:.4g}, far beyond {bounds[i]:.4g} {'rad' if turning[i] else 'm'}"  # noqa: E501
    if turning[i] and (np.deg2rad(largest) <= SLACK * bounds)[turning].all():
        raise UnusableInput(f"{said}; its positions are in degrees, convert them to rad")
    if not turning[i] and largest[i] / 1000.0 <= SLACK * bounds[i]:
        raise UnusableInput(f"{said}; its positions are in mm, convert them to m")
    raise UnusableInput(
        f"{said}; convert its positions from the encoder's unit, or correct the limits"
    )


def check_velocities(source: str, block: Block, robot: Robot) -> list[Remark]:
    """Compare dq with the slope of q: their ratio betrays mixed units.

    Rule: where slope and dq of a joint correlate by more than 0.7, their regression coefficient
        should be 1. Within 20 % of 180/π, π/180, 1e-3, 1e-6 or 1e-9 it is a unit: UnusableInput.
        Else, outside 0.8 … 1.25, a remark.
    """
    remarks: list[Remark] = []
    if "dq" not in block.values or len(block) < 3:
        return remarks
    for i, joint in enumerate(robot.joints):
        slope = np.diff(block.values["q"][:, i]) / np.diff(block.t)
        dq = 0.5 * (block.values["dq"][1:, i] + block.values["dq"][:-1, i])
        fine = np.isfinite(dq) & np.isfinite(slope)
        slope, dq = slope[fine], dq[fine]
        power, size = float(dq @ dq), float(slope @ slope)
        if power == 0.0 or size == 0.0 or abs(slope @ dq) < CLEAR * np.sqrt(power * size):
            continue
        ratio = float(slope @ dq) / power
        for unit, remedy in RATIOS:
            if 1 / 1.2 < ratio / unit < 1.2:
                raise UnusableInput(
                    f"{source}: joint '{joint}': the slope of q is {ratio:.4g} times dq; {remedy}"
                )
        if not 0.8 < ratio < 1.25:
            remarks.append(
                Remark(
                    Kind.INCONSISTENT,
                    f"joint '{joint}': the slope of q is {ratio:.4g} times dq",
                    joint,
                )
            )
    return remarks
