"""Load robots and their limits from files, names or objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from .._system.one_or_several import one_or_several_texts
from .._types import Paths
from ..robot.limits import Limits, resolve
from ..robot.robot import GRAVITY, Payload, Robot, load

RobotSource: TypeAlias = str | Path | Robot
"""Path of a URDF, name of a built-in model, or a robot that is already loaded."""


def load_robot(
    source: RobotSource,
    *,
    joints: str | Sequence[str] | None = None,
    lock: Mapping[str, float] | None = None,
    payload: Payload | None = None,
    gravity: Sequence[float] = GRAVITY,
    mass: float | None = None,
    packages: Paths = (),
) -> Robot:
    """Load a robot.

    Args:
        source: Path of a URDF or name of a built-in model; a loaded robot is returned unchanged.
        joints: Joints that move; None: all except mimic joints. The others are locked.
        lock: Positions of locked joints [rad or m].
        payload: Body attached to a link.
        gravity: Gravity in the base frame. Shape (3,) [m/s²].
        mass: Mass of the complete robot [kg], for a robot with links that state no inertia; see
            `collision.nominal_inertia`.
        packages: Folder or folders in which `package://` meshes of these links are searched.

    Raises:
        UnusableInput: The file cannot be used, or a joint or link is unknown.
    """
    if isinstance(source, Robot):
        return source
    inertias = None
    if mass is not None:
        from ..collision.nominal_inertia import nominal_inertias  # slow to import

        inertias = nominal_inertias(str(source), mass, one_or_several_texts(packages))
    return load(
        str(source),
        joints=joints,
        lock=lock,
        payload=payload,
        gravity=gravity,
        inertias=inertias,
    )


def resolve_limits(
    robot: Robot, limits: str | Path | Limits | None, margin: float | None = None
) -> Limits:
    """Resolve the limits of a robot.

    Args:
        robot: The robot.
        limits: Limits file that overrides the URDF, or limits, which are returned unchanged; None:
            the limits of the URDF.
        margin: Share of velocity, acceleration, jerk and torque limits to keep free [1].

    Raises:
        UnusableInput: The limits file cannot be used.
        MissingLimit: A joint has no usable limit.
    """
    if isinstance(limits, Limits):
        return limits
    return resolve(robot, None if limits is None else Path(limits), margin)
