"""Bodies, and their distances at one configuration after another, by coal."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from ..robot.robot import Robot
from . import mesh_file
from .geometry import Kind, Shape

Array = np.ndarray


@dataclass(frozen=True)
class Body:
    """Shapes that move as one: of a link, a tool, or a thing that stands around.

    joint: the model's joint that moves it, 0 for what stands. placements: of its shapes in that
        joint's frame. solids, hulls: for coal, exactly and convex. around: part of the
        surroundings.
    """

    name: str
    joint: int
    shapes: tuple[Shape, ...]
    placements: tuple[pin.SE3, ...]
    solids: tuple[coal.CollisionGeometry, ...]
    hulls: tuple[coal.CollisionGeometry, ...]
    around: bool

    @property
    def is_mesh(self) -> bool:
        """Whether any of its shapes is one."""
        return any(one.kind is Kind.MESH for one in self.shapes)


@dataclass(frozen=True)
class Pair:
    """Two bodies, by their numbers, that keep at least `margin` apart [m]."""

    first: int
    second: int
    margin: float


def bodies(robot: Robot, shapes: Sequence[Shape]) -> tuple[Body, ...]:
    """Shapes of one name together, placed. Raises UnusableInput for a link that the robot has
    not."""
    mesh_file.read_all([one.file for one in shapes if one.file is not None])
    grouped: dict[str, list[Shape]] = {}
    for one in shapes:
        grouped.setdefault(one.name, []).append(one)
    out = []
    for name, own in grouped.items():
        joint, placement = 0, pin.SE3.Identity()
        if own[0].link is not None:
            frame = robot.model.frames[robot.frame(own[0].link)]
            joint, placement = int(frame.parentJoint), frame.placement
        placements = tuple(placement * one.placement for one in own)
        solids, hulls = tuple(one.solid() for one in own), tuple(one.hull() for one in own)
        out.append(Body(name, joint, tuple(own), placements, solids, hulls, own[0].link is None))
    return tuple(out)


class Probe:
    """Distances of pairs of bodies at one configuration after another."""

    def __init__(
        self, robot: Robot, bodies: Sequence[Body], pairs: Sequence[Pair], near: float
    ) -> None:
        """near: distance from which convex hulls will do [m]."""
        self.robot, self.near = robot, near
        self.data = robot.model.createData()
        starts = np.cumsum([0, *(len(body.shapes) for body in bodies)])
        both = [
            [(i, range(starts[i], starts[i + 1])) for i in (pair.first, pair.second)]
            for pair in pairs
        ]
        combined = [list(itertools.product(one[1], other[1])) for one, other in both]
        ends = np.cumsum([0, *(len(some) for some in combined)])
        self._own = [range(a, b) for a, b in itertools.pairwise(ends.tolist())]
        self._meshes = [bodies[pair.first].is_mesh or bodies[pair.second].is_mesh for pair in pairs]
        every = [shapes for some in combined for shapes in some]
        self._convex, self._exact = (_geometry(bodies, every, exact) for exact in (False, True))

    def to(self, q: Array) -> Probe:
        """Go to a configuration of the moving joints. Shape (n,)."""
        pin.forwardKinematics(self.robot.model, self.data, self.robot.expand(q))
        pin.updateGeometryPlacements(self.robot.model, self.data, *self._convex)
        if any(self._meshes):
            pin.updateGeometryPlacements(self.robot.model, self.data, *self._exact)
        return self

    def distance(self, pair: int) -> float:
        """Of a pair by its number; ≤ 0 where the bodies meet [m].

        Of meshes further apart than `near` it is that of their convex hulls, which is never larger
        and a hundred times cheaper.
        """
        least = np.inf
        for number in self._own[pair]:
            here = float(pin.computeDistance(*self._convex, number).min_distance)
            if self._meshes[pair] and here < self.near:
                here = float(pin.computeDistance(*self._exact, number).min_distance)
            least = min(least, here)
        return least


def _geometry(
    bodies: Sequence[Body], pairs: Sequence[tuple[int, int]], exact: bool
) -> tuple[pin.GeometryModel, pin.GeometryData]:
    model = pin.GeometryModel()
    for body in bodies:
        for number, (placement, solid) in enumerate(
            zip(body.placements, body.solids if exact else body.hulls, strict=True)
        ):
            model.addGeometryObject(
                pin.GeometryObject(f"{body.name}/{number}", body.joint, placement, solid)
            )
    for first, second in pairs:
        model.addCollisionPair(pin.CollisionPair(first, second))
    return model, model.createData()
