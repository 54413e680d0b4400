"""Robots and their limits, from what a caller has at hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from ..robot.limits import Limits, resolve
from ..robot.robot import GRAVITY, Payload, Robot, load

RobotSource: TypeAlias = "str | Path | Robot"
"""A URDF's path, the name of a built-in model, or a robot that is loaded already."""


def load_robot(
    source: RobotSource,
    *,
    joints: Sequence[str] | None = None,
    lock: Mapping[str, float] | None = None,
    payload: Payload | None = None,
    gravity: Sequence[float] = GRAVITY,
    mass: float | None = None,
    packages: Sequence[str] = (),
) -> Robot:
    """Load a robot.

    Args:
        source: Path of a URDF or name of a built-in model; a loaded robot is returned as it is.
        joints: Joints that move; all that are not mimic joints when None. The others are locked.
        lock: Positions of locked joints [rad or m].
        payload: Body attached to a link.
        gravity: Gravity in the base frame. Shape (3,) [m/s²].
        mass: Mass of the complete robot [kg], for a robot with links that state no inertia; see
            `collision.nominal_inertia`.
        packages: Folders in which `package://` meshes of these links are searched.

    Raises:
        UnusableInput: The file cannot be used, or a joint or link is unknown.
    """
    if isinstance(source, Robot):
        return source
    inertias = None
    if mass is not None:
        from ..collision.nominal_inertia import nominal_inertias  # slow to import

        inertias = nominal_inertias(str(source), mass, packages)
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
    """Resolve the limits of a robot, overridden by a limits file or given as they are."""
    if isinstance(limits, Limits):
        return limits
    return resolve(robot, None if limits is None else Path(limits), margin)
