"""Positions of locked joints in a recording, compared with those at which the robot locks them.

A model of joints that are locked elsewhere than they stood may fit the recording, but holds gravity
and inertia of another pose.
"""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.robot import LockedJoint, Robot
from .block import Block
from .position_wraps import TURN
from .remark import Remark, RemarkKind

TOLERANCE = {"rad": 0.01, "m": 0.005}
"""Distance from the stated position that counts as none, times the share of the mass that the joint
carries [rad or m]. It changes the gravity torque of bodies with a lever arm of half a metre by at
most 1 %, and is more than servos yield or encoders are off: the fingers of a gripper are free."""
OUTLIER_SHARE = 0.01
"""Share of positions at either end of their range that may be glitches [1]."""


class LockedPositions:
    """Ranges of the recorded positions of locked joints, block by block."""

    def __init__(self, robot: Robot) -> None:
        """Begin without any positions."""
        self._joints = {joint.name: joint for joint in robot.locked}
        self._can_be_locked = bool(robot.options.get("locked"))
        self._ranges: dict[str, list[FloatArray]] = {}

    def watched(self, block: Block) -> Block:
        """Take the positions of a block into account, and return it."""
        for name, positions in block.locked.items():
            known = positions[np.isfinite(positions)]
            if len(known):
                shares = (OUTLIER_SHARE, 0.5, 1.0 - OUTLIER_SHARE)
                self._ranges.setdefault(name, []).append(np.quantile(known, shares))
        return block

    def check(self, source: str) -> list[Remark]:
        """Compare the recorded positions with the stated ones, up to whole turns of angles.

        Args:
            source: Name of the recording, for messages.

        Returns:
            A doubt for each locked joint that moves.

        Raises:
            UnusableInput: A joint stands elsewhere than it is locked.
        """
        remarks = []
        for name, ranges in self._ranges.items():
            joint = self._joints[name]
            low, high = float(np.min(ranges, axis=0)[0]), float(np.max(ranges, axis=0)[2])
            if (high - low) * joint.share > TOLERANCE[joint.unit]:
                remarks.append(_moving(joint, low, high))
                continue
            position = float(np.median(ranges, axis=0)[1])
            if _distance(position, joint) * joint.share > TOLERANCE[joint.unit]:
                remedy = "lock it there" if self._can_be_locked else "identify the robot"
                raise UnusableInput(
                    f"{source}: joint '{name}' is locked at {joint.position:.4g} {joint.unit}, but "
                    f"stands at {position:.4g} {joint.unit} in the recording; {remedy} with "
                    f"--lock {name}={position:.6g}"
                )
        return remarks


def _distance(position: float, joint: LockedJoint) -> float:
    """Distance of a position from the stated one [rad or m]."""
    difference = position - joint.position
    return abs(difference - TURN * round(difference / TURN) if joint.unit == "rad" else difference)


def _moving(joint: LockedJoint, low: float, high: float) -> Remark:
    text = (
        f"joint '{joint.name}' is locked at {joint.position:.4g} {joint.unit}, but moves from "
        f"{low:.4g} to {high:.4g} {joint.unit} in the recording; name it in --joints, or remove it "
        "from --lock"
    )
    return Remark(RemarkKind.LOCKED, text, joint.name, doubt=True)
