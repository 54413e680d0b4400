"""Proof that two links with up to two joints between them never touch within the joint limits.

While joint k turns by δ, the distance of two shapes changes at most by |δ| ρ_k, where ρ_k bounds
the distance of the points of one of them from the joint's axis, which is fixed to it. A box of
joint positions is free of contact if the distance at its centre exceeds Σ ρ_k h_k with half its
edge lengths h; other boxes are divided.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..robot.inertial_parameters import ranges, spread_poses
from ..robot.limits import Limits
from ..robot.robot import Robot
from . import capsule_cover
from .distance_query import Body, BodyPair, DistanceQuery
from .geometry import ShapeKind

ROUND = (ShapeKind.SPHERE, ShapeKind.CAPSULE)
"""Shapes whose distances are those of a segment minus a radius, so that it counts how the segment
moves."""
MAX_BOXES = 5000
"""Boxes of joint positions after which a proof is given up [1]. Links of the built-in robots need
up to 800, those of ten public robots with meshes up to 2,100, except for one pair of 30,000."""


def excludes_contact(robot: Robot, limits: Limits, first: Body, second: Body) -> bool:
    """Prove that two links are apart at all positions within the limits.

    Args:
        robot: Robot that moves the links.
        limits: Its limits.
        first: A link.
        second: The other link.

    Returns:
        False if they can touch, if there are more than two joints between them, or if MAX_BOXES
        boxes do not decide it.
    """
    boxes = MAX_BOXES
    for pair in itertools.product(_single_shapes(first), _single_shapes(second)):
        boxes = _boxes_left(robot, limits, pair, boxes)
        if boxes <= 0:
            return False
    return True


def _boxes_left(robot: Robot, limits: Limits, pair: tuple[Body, Body], boxes: int) -> int:
    """Divide the joint ranges until two bodies of one shape each are apart in all boxes.

    Returns:
        How many of the allowed boxes are left; 0 if the bodies are not proven to be apart.
    """
    lever_arms = _lever_arms(robot, *pair)
    moving = np.flatnonzero(lever_arms)
    query = DistanceQuery(robot, pair, (BodyPair(0, 1, 0.0),), 0.0)
    pose = spread_poses(limits, 1)[0]
    low, high = ranges(limits)[moving].T
    stack = [(low, np.minimum(high, low + _turn(robot)[moving]))]
    while stack and boxes > 0:
        low, high = stack.pop()
        boxes -= 1
        middle = 0.5 * (low + high)
        pose[moving] = middle
        changes = lever_arms[moving] * (high - middle)
        query.exact_below = float(changes.sum())
        distance = query.set_configuration(pose).distance(0)
        if distance <= 0.0:
            return 0
        if distance <= query.exact_below:
            divided = np.arange(len(moving)) == np.argmax(changes)
            stack += [
                (low, np.where(divided, middle, high)),
                (np.where(divided, middle, low), high),
            ]
    return boxes


def _turn(robot: Robot) -> FloatArray:
    """Return the change of each joint after which its links are where they were, infinite for a
    joint that slides or has followers. Shape (n,) [rad]."""
    shares = np.abs(robot.spread)
    turning = np.array([np.linalg.norm(axis[3:]) for axis in robot.axes()])
    alone = (shares.sum(axis=0) == 1.0) & (shares.T @ turning > 0.5)
    return np.where(alone, 2.0 * np.pi, np.inf)


def _single_shapes(body: Body) -> list[Body]:
    """Return a body for each shape of a body."""
    names = ("shapes", "placements", "solids", "hulls")
    return [
        dataclasses.replace(body, **{name: getattr(body, name)[k : k + 1] for name in names})
        for k in range(len(body.shapes))
    ]


def _lever_arms(robot: Robot, first: Body, second: Body) -> FloatArray:
    """Bound the speed at which two bodies approach per unit speed of each joint.

    Returns:
        Bounds, infinite for a joint whose axis is fixed to neither body. Shape (n,) [m/rad or 1].
    """
    supports = [set(robot.model.supports[body.joint]) for body in (first, second)]
    axes, out = robot.axes(), np.zeros(robot.n)
    for joint in supports[0] ^ supports[1]:
        axis, shares = axes[joint - 1], np.abs(robot.spread[joint - 1])
        radius = min(_radius(robot, body, joint, axis[3:]) for body in (first, second))
        speed = float(np.linalg.norm(axis[:3]) + np.linalg.norm(axis[3:]) * radius)
        out[shares > 0.0] += shares[shares > 0.0] * speed
    return out


def _radius(robot: Robot, body: Body, joint: int, axis: FloatArray) -> float:
    """Bound the distance of a body's points from the axis of a joint.

    Args:
        robot: The robot.
        body: The body.
        joint: Index of the model's joint.
        axis: Direction of its axis in its frame. Shape (3,).

    Returns:
        The bound, infinite unless the axis is fixed to the body [m].
    """
    if joint == body.joint:
        frame = pin.SE3.Identity()
    elif robot.model.parents[joint] == body.joint:
        frame = robot.model.jointPlacements[joint].inverse()
    else:
        return np.inf
    radius = 0.0
    for shape, placement in zip(body.shapes, body.placements, strict=True):
        link = frame * placement * shape.placement.inverse()
        for capsule in capsule_cover.cover_with_capsules(shape):
            in_joint = capsule.transformed(link.rotation, link.translation)
            offsets = np.cross([in_joint.begin, in_joint.end], axis)
            around = 0.0 if shape.kind in ROUND else capsule.radius
            radius = max(radius, float(np.linalg.norm(offsets, axis=1).max()) + around)
    return radius
