"""Distances between bodies of a robot on its feet: the robot in the world, ground and scene.

The base link moves along six joints, so that the ground and other surroundings are fixed, and all
functions for distances apply to poses (b, q) of base coordinates and joint positions.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..collision import scene_file
from ..collision.distance_query import BodyPair
from ..collision.scene_file import Scene
from ..collision.workcell import Cell, ExceptedPair
from ..errors import UnusableInput
from ..robot.floating_base import FloatingRobot
from ..robot.limits import QUANTITIES, Limits
from ..robot.robot import Robot
from .support_problem import BASE_REACH
from .support_stance import Stance

BASE_NAMES = tuple(f"base.{name}" for name in ("x", "y", "z", "roll", "pitch", "yaw"))
"""Names of the base coordinates."""

GROUND = "floor"
"""Name of the body that is the ground."""

BASE_JOINTS = (
    ("base.x", pin.JointModelPX()),
    ("base.y", pin.JointModelPY()),
    ("base.z", pin.JointModelPZ()),
    ("base.yaw", pin.JointModelRZ()),
    ("base.pitch", pin.JointModelRY()),
    ("base.roll", pin.JointModelRX()),
)
"""Joints between the world and the base link: Rz(yaw)·Ry(pitch)·Rx(roll) at (x, y, z)."""

BASE_RANGE = 3.0
"""Range of the base coordinates either way over their units [1]: poses within it decide which pairs
of bodies can meet. What they miss, the certificate finds."""

STANDING_RATIO = 2.0
"""Distance in the standing pose over the clearance below which half of that distance is the
clearance of a pair [1]: the optimiser needs room to begin with."""


@dataclass(frozen=True)
class Surroundings:
    """Surroundings that a robot on its feet keeps clear of, apart from itself and the ground.

    Attributes:
        scene: Shapes fixed in the world or to a link, clearance, and pairs that may touch.
        packages: Folders of `package://` meshes.
        required: Fail if no link has a shape.
    """

    scene: Scene = dataclasses.field(default_factory=Scene)
    packages: tuple[str, ...] = ()
    required: bool = False


def robot_in_world(robot: FloatingRobot) -> Robot:
    """Return the robot with six joints between the world and its base link.

    Its joint positions are (b, q) with the base coordinates b = (x, y, z, roll, pitch, yaw).
    """
    fixed = robot.joint_robot
    flyer, last = pin.Model(), 0
    for name, joint in BASE_JOINTS:
        last = flyer.addJoint(last, joint, pin.SE3.Identity(), name)
    frame = flyer.addFrame(
        pin.Frame("free flyer", last, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME)
    )
    model = pin.appendModel(flyer, fixed.model, frame, pin.SE3.Identity())
    names = (*BASE_NAMES, *fixed.joints)
    base_size = len(BASE_JOINTS)
    spread = np.zeros((model.nv, len(names)))
    for row, (name, _) in enumerate(BASE_JOINTS):
        spread[row, names.index(name)] = 1.0
    spread[base_size:, base_size:] = fixed.spread
    return dataclasses.replace(
        fixed,
        model=model,
        structure=model,
        joints=names,
        spread=spread,
        shift=np.concatenate([np.zeros(base_size), fixed.shift]),
        links=(*[""] * (base_size - 1), robot.base_link, *fixed.links),
    )


def limits_in_world(limits: Limits, stance: Stance) -> Limits:
    """Return the limits with ranges of the base coordinates around the standing pose."""
    reach = BASE_RANGE * np.array(BASE_REACH)
    absent = np.full(len(BASE_NAMES), np.inf)
    others: dict[str, Any] = {
        quantity: np.concatenate([absent, getattr(limits, quantity)])
        for quantity in QUANTITIES
        if quantity != "position"
    }
    position = np.column_stack([stance.base - reach, stance.base + reach])
    return dataclasses.replace(
        limits,
        joints=(*BASE_NAMES, *limits.joints),
        position=np.vstack([position, limits.position]),
        **others,
        braking=(*[None] * len(BASE_NAMES), *limits.braking),
        sources={q: (*[""] * len(BASE_NAMES), *limits.sources[q]) for q in QUANTITIES},
    )


def find_cell(
    robot: FloatingRobot, limits: Limits, stance: Stance, surroundings: Surroundings
) -> tuple[Cell | None, str]:
    """Build the cell of a robot on its feet unless no link has a shape.

    Args:
        robot: The robot.
        limits: Limits of its joints.
        stance: The feet and the standing pose.
        surroundings: What else to keep clear of.

    Returns:
        The cell and ""; or None and a sentence that says why distances are not checked.

    Raises:
        MissingMesh: A mesh file does not exist.
        UnusableInput: A file cannot be used, or bodies touch in the standing pose.
    """
    world = robot_in_world(robot)
    scene = surroundings.scene.overridden(floor=0.0)
    scene = dataclasses.replace(scene, ignored=(*scene.ignored, *_standing_links(world, stance)))
    cell, reason = scene_file.find_cell(
        world,
        limits_in_world(limits, stance),
        scene,
        surroundings.packages,
        required=surroundings.required,
    )
    return (None if cell is None else _around(cell, stance)), reason


def rebuild_cell(
    robot: FloatingRobot,
    limits: Limits,
    stance: Stance,
    document: Mapping[str, Any],
    packages: Sequence[str] = (),
) -> tuple[Cell | None, str | None]:
    """Build the cell that a trajectory states again, from the files as they are now.

    Args:
        robot: The robot.
        limits: Limits of its joints, from their sources.
        stance: The feet and the standing pose.
        document: `Cell.document` of the cell that the motions were designed for.
        packages: Further folders of `package://` meshes.

    Returns:
        The cell and None; or None and a sentence that says why it cannot be built or how it differs
        from the stated one.
    """
    world = robot_in_world(robot)
    cell, fault = scene_file.rebuild_cell(
        world,
        limits_in_world(limits, stance),
        document,
        packages,
        ignored=_standing_links(world, stance),
    )
    if cell is None:
        return None, fault
    try:
        return _around(cell, stance), None
    except UnusableInput as error:
        return None, str(error)


def _standing_links(world: Robot, stance: Stance) -> tuple[tuple[str, str], ...]:
    """Return the pairs of the ground and a link that moves with a foot on it."""
    feet = {int(world.model.frames[world.frame(foot.frame)].parentJoint) for foot in stance.feet}
    return tuple(
        (GROUND, frame.name)
        for frame in world.model.frames
        if frame.type == pin.FrameType.BODY and int(frame.parentJoint) in feet
    )


def _around(cell: Cell, stance: Stance) -> Cell:
    """Return the cell with less clearance for pairs that are close in the standing pose.

    Raises:
        UnusableInput: A pair touches there.
    """
    pose = np.concatenate([stance.base, stance.pose])
    query = cell.distance_query().set_configuration(pose)
    pairs, excepted = list[BodyPair](), list(cell.excepted)
    for number, pair in enumerate(cell.pairs):
        distance = query.distance(number)
        if distance >= STANDING_RATIO * pair.margin:
            pairs.append(pair)
            continue
        names = cell.bodies[pair.first].name, cell.bodies[pair.second].name
        if distance <= 0.0:
            raise UnusableInput(
                f"{cell.robot.source}: '{names[0]}' touches '{names[1]}' in the standing pose; "
                "disable the pair in an SRDF (--srdf FILE) if their shapes are too large, narrow "
                "the ranges of joints between them with --limits, or --no-collision"
            )
        margin = 0.5 * distance
        pairs.append(dataclasses.replace(pair, margin=margin))
        reason = f"close in the standing pose: {1e3 * margin:.0f} mm, half of the distance there"
        excepted.append(ExceptedPair(*names, reason))
    return dataclasses.replace(cell, pairs=tuple(pairs), excepted=tuple(excepted), pose=pose)
