"""Limits of joints: in a trajectory, in a TOML limits file, and in MoveIt's `joint_limits.yaml`."""

from __future__ import annotations

import msgspec

from .quantities import (
    AccelerationLimit,
    JerkLimit,
    Length,
    Position,
    Share,
    Text,
    TorqueLimit,
    VelocityLimit,
    VelocityOffset,
)


class BrakingDocument(msgspec.Struct, forbid_unknown_fields=True):
    """A velocity limit that decreases towards a position stop.

    |q̇| ≤ −offset + √(rate · distance to the stop), as Franka states it for the FR3. The bound is
    never below 0 nor above `velocity`; see `robot.limits.Braking`.

    Attributes:
        offset: Reduction of the velocity at the stop [rad/s or m/s].
        rate: Increase of the squared velocity with the distance [rad/s² or m/s²].
        stop: Lower and upper stop [rad or m].
    """

    offset: VelocityOffset
    rate: AccelerationLimit
    stop: tuple[Position, Position]

    def __post_init__(self) -> None:
        require_ordered("stop", self.stop)


class PositionEntry(msgspec.Struct):
    """A position limit of a trajectory and its source."""

    value: tuple[Position, Position]
    source: Text = Text("")

    def __post_init__(self) -> None:
        require_ordered("value", self.value)


class VelocityEntry(msgspec.Struct):
    """A velocity limit of a trajectory and its source."""

    value: VelocityLimit
    source: Text = Text("")


class AccelerationEntry(msgspec.Struct):
    """An acceleration limit of a trajectory and its source."""

    value: AccelerationLimit
    source: Text = Text("")


class JerkEntry(msgspec.Struct):
    """A jerk limit of a trajectory and its source."""

    value: JerkLimit
    source: Text = Text("")


class TorqueEntry(msgspec.Struct):
    """A torque limit of a trajectory and its source."""

    value: TorqueLimit
    source: Text = Text("")


class StandLimits(msgspec.Struct, forbid_unknown_fields=True):
    """The load that the stand of the base takes, the robot's weight included.

    Attributes:
        force: Largest magnitude of the force [N].
        moment: Largest magnitude of the moment about `point` [N m].
        point: Point in the frame of the base link [m].
    """

    force: TorqueLimit | None = None
    moment: TorqueLimit | None = None
    point: tuple[Length, Length, Length] = (Length(0.0), Length(0.0), Length(0.0))

    def __post_init__(self) -> None:
        if self.force is None and self.moment is None:
            raise ValueError("has neither force [N] nor moment [N m]; say what the stand takes")


class StatedStand(StandLimits):
    """The load that a stand takes in a trajectory, with its source."""

    source: Text = Text("")


class StatedLimits(msgspec.Struct):
    """The limits in a trajectory, joint by joint; a missing key means no limit.

    `robot.limits.Limits.document` writes them.
    """

    position: dict[str, PositionEntry] = {}
    velocity: dict[str, VelocityEntry] = {}
    acceleration: dict[str, AccelerationEntry] = {}
    jerk: dict[str, JerkEntry] = {}
    torque: dict[str, TorqueEntry] = {}
    braking: dict[str, BrakingDocument] = {}
    stand: StatedStand | None = None


class JointLimits(msgspec.Struct, forbid_unknown_fields=True):
    """The limits of a joint in a TOML file; None for a limit that is not stated."""

    position: tuple[Position, Position] | None = None
    velocity: VelocityLimit | None = None
    acceleration: AccelerationLimit | None = None
    jerk: JerkLimit | None = None
    torque: TorqueLimit | None = None
    braking: BrakingDocument | None = None

    def __post_init__(self) -> None:
        if self.position is not None:
            require_ordered("position", self.position)


class Margin(msgspec.Struct, forbid_unknown_fields=True):
    """Shares of the limits that a design keeps free; None where not stated."""

    velocity: Share | None = None
    acceleration: Share | None = None
    jerk: Share | None = None
    torque: Share | None = None


class LimitsFile(msgspec.Struct, forbid_unknown_fields=True):
    """A TOML limits file: `[joints.<name>] velocity = 2.0`, …, `[margin] torque = 0.05`, and
    `[stand] moment = 80.0`.
    """

    joints: dict[str, JointLimits] = {}
    margin: Margin | None = None
    stand: StandLimits | None = None

    def __post_init__(self) -> None:
        if not self.joints and self.margin is None and self.stand is None:
            raise ValueError(
                "has no [joints.<name>] tables; write one per joint, "
                "e.g. [joints.elbow] velocity = 2.0"
            )


class Mounting(msgspec.Struct, forbid_unknown_fields=True):
    """Mounting of a built-in model.

    Attributes:
        floor: Height of the mounting plane in the base frame [m].
    """

    floor: Length


class BuiltinLimitsFile(LimitsFile, forbid_unknown_fields=True):
    """A limits file of a built-in model, with its mounting."""

    mounting: Mounting | None = None


class MoveItSwitches(msgspec.Struct):
    """The switches of a joint in MoveIt's `joint_limits.yaml`, each of which enables values."""

    has_position_limits: bool = False
    has_velocity_limits: bool = False
    has_acceleration_limits: bool = False
    has_jerk_limits: bool = False
    has_effort_limits: bool = False


class MoveItValues(msgspec.Struct):
    """The enabled values of a joint in MoveIt's `joint_limits.yaml`."""

    min_position: Position | None = None
    max_position: Position | None = None
    max_velocity: VelocityLimit | None = None
    max_acceleration: AccelerationLimit | None = None
    max_jerk: JerkLimit | None = None
    max_effort: TorqueLimit | None = None

    def __post_init__(self) -> None:
        if self.min_position is not None and self.max_position is not None:
            require_ordered("position", (self.min_position, self.max_position))


class MoveItSwitchesFile(msgspec.Struct):
    """The switches of all joints of a `joint_limits.yaml`."""

    joint_limits: dict[str, MoveItSwitches]


class MoveItValuesFile(msgspec.Struct):
    """The enabled values of all joints of a `joint_limits.yaml`."""

    joint_limits: dict[str, MoveItValues]


MOVEIT_VALUES = {
    "has_position_limits": ("min_position", "max_position"),
    "has_velocity_limits": ("max_velocity",),
    "has_acceleration_limits": ("max_acceleration",),
    "has_jerk_limits": ("max_jerk",),
    "has_effort_limits": ("max_effort",),
}
"""The values that each switch of MoveIt's `joint_limits.yaml` enables."""
MOVEIT_UNUSED = ("has_deceleration_limits", "max_deceleration", "has_soft_limits")
"""Further switches and values of MoveIt and ros2_control, which are not used.

Other keys that begin like a limit are spelling errors.
"""


def require_ordered(key: str, pair: tuple[float, float]) -> None:
    """Raise ValueError unless the first of two bounds is below the second."""
    if not pair[0] < pair[1]:
        order = f"the lower bound {pair[0]:g} is not below the upper bound {pair[1]:g}"
        raise ValueError(f"{key}: {order}; swap or widen them")
