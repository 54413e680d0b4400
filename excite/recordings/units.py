"""Detection of wrong units: degrees, millimetres, milliseconds."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.limits import Limits
from ..robot.robot import Robot
from .block import Block
from .remark import Remark, RemarkKind

MAX_ANGLE_RATIO = 2.0
"""Largest position of a revolute joint over its reach [1]."""
MAX_LENGTH_RATIO = 10.0
"""Largest position of a prismatic joint over its reach [1]."""
CONVERTED_RATIO = 1.1
"""Largest position over the reach that is plausible after a conversion [1]."""
MIN_ANGLE_REACH = 1.0
"""Smallest reach of a revolute joint [rad]: a position limit that is tightened for a design says
nothing about units."""
MIN_LENGTH_REACH = 0.05
"""Smallest reach of a prismatic joint [m]."""
DEFAULT_ANGLE_REACH = 4.0 * np.pi
"""Reach of a revolute joint without position limits [rad]."""
MIN_CORRELATION = 0.7
"""Correlation of dq and the slope of q from which their ratio is compared with 1 [1]."""
UNIT_RATIOS = (
    (180.0 / np.pi, "q is in degrees but dq in rad/s; convert q to rad"),
    (np.pi / 180.0, "dq is in degrees/s but q in rad; convert dq to rad/s"),
    (1e-3, "time is in ms; divide it by 1000"),
    (1e-6, "time is in µs; divide it by 1e6"),
    (1e-9, "time is in ns; divide it by 1e9"),
)
"""Ratios of the slope of q to dq by mixed units, with their remedies."""
UNIT_RATIO_TOLERANCE = 1.2
"""Factor within which a ratio counts as one of UNIT_RATIOS [1]."""
PLAUSIBLE_RATIOS = (0.8, 1.25)
"""Ratios of the slope of q to dq that are not remarked [1]."""


def reach(robot: Robot, limits: Limits | None) -> FloatArray:
    """Return the largest |position| that the limits or the URDF allow.

    Args:
        robot: The robot.
        limits: Its limits, None: those of the URDF.

    Returns:
        At least 1 rad or 0.05 m; 4π for a revolute joint without limits, ∞ for other joints
        without. Shape (n,) [rad or m].
    """
    out = np.full(robot.n, np.inf)
    for i, entry in enumerate(robot.entries):
        stated = [*(entry.position or ()), *(() if limits is None else limits.position[i])]
        if stated and np.isfinite(stated).all():
            smallest = MIN_LENGTH_REACH if entry.kind == "prismatic" else MIN_ANGLE_REACH
            out[i] = max(np.abs(stated).max(), smallest)
        elif entry.kind == "revolute":
            out[i] = DEFAULT_ANGLE_REACH
    return out


def check_positions(
    source: str, block: Block, robot: Robot, limits: Limits | None, glitch_share: float = 0.0
) -> None:
    """Check that positions are in rad or m.

    A revolute joint beyond twice its reach is in degrees if degrees put all joints within 1.1 times
    their reach, else in another unit such as encoder counts. A prismatic joint beyond ten times its
    reach is in mm if a thousandth is within its reach.

    Args:
        source: Name of the recording, for messages.
        block: Rows of it.
        robot: The robot.
        limits: Its limits, None: those of the URDF.
        glitch_share: Share of the largest positions that may be glitches [1].

    Raises:
        UnusableInput: Positions are in another unit.
    """
    size = np.abs(block.values["q"])
    largest = np.nanmax(size, axis=0)
    if glitch_share:
        largest = np.nanquantile(size, 1.0 - glitch_share, axis=0)
    bounds = reach(robot, limits)
    is_angle = np.array([entry.kind != "prismatic" for entry in robot.entries])
    beyond = largest > np.where(is_angle, MAX_ANGLE_RATIO, MAX_LENGTH_RATIO) * bounds
    if not beyond.any():
        return
    i = int(np.argmax(beyond))
    unit = "rad" if is_angle[i] else "m"
    fault = (
        f"{source}: joint '{robot.joints[i]}' reaches {largest[i]:.4g}, far beyond "
        f"{bounds[i]:.4g} {unit}"
    )
    if is_angle[i] and (np.deg2rad(largest) <= CONVERTED_RATIO * bounds)[is_angle].all():
        raise UnusableInput(
            f"{fault}; if its positions are in degrees, convert them to rad, else correct the "
            "limits"
        )
    if not is_angle[i] and largest[i] / 1000.0 <= CONVERTED_RATIO * bounds[i]:
        raise UnusableInput(
            f"{fault}; if its positions are in mm, convert them to m, else correct the limits"
        )
    raise UnusableInput(
        f"{fault}; convert its positions from the encoder's unit, or correct the limits"
    )


def check_further_positions(source: str, block: Block, robot: Robot) -> None:
    """Check that commanded and link positions have the unit of q.

    Where both correlate by more than 0.7, their regression coefficient should not be a factor of
    units.

    Args:
        source: Name of the recording, for messages.
        block: Rows of it.
        robot: The robot.

    Raises:
        UnusableInput: qref or qlink is in degrees or mm, while q is in rad or m.
    """
    for name in ("qref", "qlink"):
        for i, joint in enumerate(robot.joints):
            if name not in block.values:
                continue
            q, other = block.values["q"][:, i], block.values[name][:, i]
            known = np.isfinite(q) & np.isfinite(other)
            if not known.any():
                continue
            q, other = q[known] - np.mean(q[known]), other[known] - np.mean(other[known])
            power, other_power = float(q @ q), float(other @ other)
            product = float(q @ other)
            if product <= MIN_CORRELATION * np.sqrt(power * other_power):
                continue
            slides = robot.entries[i].kind == "prismatic"
            factor, unit, wanted = (1e3, "mm", "m") if slides else (180.0 / np.pi, "degrees", "rad")
            ratio = product / power
            if 1 / UNIT_RATIO_TOLERANCE < ratio / factor < UNIT_RATIO_TOLERANCE:
                raise UnusableInput(
                    f"{source}: joint '{joint}': {name} moves {ratio:.4g} times as far as q, so it "
                    f"is in {unit}; convert it to {wanted}"
                )


def check_velocities(source: str, block: Block, robot: Robot) -> list[Remark]:
    """Compare dq with the slope of q, whose ratio shows mixed units.

    Where both correlate by more than 0.7, their regression coefficient should be 1.

    Args:
        source: Name of the recording, for messages.
        block: Rows of it.
        robot: The robot.

    Returns:
        A remark for each joint with a ratio outside 0.8 … 1.25.

    Raises:
        UnusableInput: A ratio is within 20 % of one of UNIT_RATIOS.
    """
    remarks: list[Remark] = []
    if "dq" not in block.values or len(block) < 3:
        return remarks
    for i, joint in enumerate(robot.joints):
        slope = np.diff(block.values["q"][:, i]) / np.diff(block.t)
        dq = 0.5 * (block.values["dq"][1:, i] + block.values["dq"][:-1, i])
        known = np.isfinite(dq) & np.isfinite(slope)
        slope, dq = slope[known], dq[known]
        dq_power, slope_power = float(dq @ dq), float(slope @ slope)
        if (
            dq_power == 0.0
            or slope_power == 0.0
            or abs(slope @ dq) < MIN_CORRELATION * np.sqrt(dq_power * slope_power)
        ):
            continue
        ratio = float(slope @ dq) / dq_power
        for unit, remedy in UNIT_RATIOS:
            if 1 / UNIT_RATIO_TOLERANCE < ratio / unit < UNIT_RATIO_TOLERANCE:
                raise UnusableInput(
                    f"{source}: joint '{joint}': the slope of q is {ratio:.4g} times dq; {remedy}"
                )
        if not PLAUSIBLE_RATIOS[0] < ratio < PLAUSIBLE_RATIOS[1]:
            text = f"joint '{joint}': the slope of q is {ratio:.4g} times dq; " + (
                "check the signs of q and dq"
                if ratio < 0.0
                else "check the units of q and dq, and that both are of the same side of the gear"
            )
            text += "; torque is computed from q alone"
            remarks.append(Remark(RemarkKind.INCONSISTENT, text, joint))
    return remarks
