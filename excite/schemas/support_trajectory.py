"""`trajectory.json` of a robot on its feet, schema excite.support_trajectory/1.

Only what a simulation needs is checked: the robot, its feet and their contact. The motion is read
from the `trajectory.csv` of the same design.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from .quantities import FrictionCoefficient, Length, Name, Size
from .trajectory import RobotDocument

SCHEMA = "excite.support_trajectory/1"


class SupportFootDocument(msgspec.Struct):
    """A foot on the ground.

    Attributes:
        frame: Name of its contact frame.
        half_length: Half of the length of its sole along the x axis of the frame [m].
        half_width: Half of its width along the y axis [m].
        centre: Centre of the sole in the world [m].
    """

    frame: Name
    half_length: Size
    half_width: Size
    centre: tuple[Length, Length, Length]


class ContactDocument(msgspec.Struct):
    """Contact of the feet with the ground."""

    friction: FrictionCoefficient


class SupportTrajectoryDocument(msgspec.Struct):
    """The file, as far as it is read."""

    schema: Literal["excite.support_trajectory/1"]
    robot: RobotDocument
    joints: list[Name]
    support: list[SupportFootDocument]
    contact: ContactDocument

    def __post_init__(self) -> None:
        if not self.support:
            raise ValueError("support: names no foot")
