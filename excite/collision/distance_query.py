"""Rigid bodies, and distances between pairs of them at given configurations, computed by coal."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..robot.robot import Robot
from . import mesh_file
from .geometry import Shape, ShapeKind
from .mesh_distance import MeshDistance


@dataclass(frozen=True)
class Body:
    """Rigidly connected shapes: a link, a tool, or an object of the surroundings.

    Attributes:
        name: Name of the link or the object.
        joint: Index of the model's joint that moves it, 0 for a fixed body.
        shapes: Its shapes.
        placements: Poses of the shapes in the joint's frame.
        solids: Exact shapes for coal.
        hulls: Convex hulls of the shapes for coal.
        is_surrounding: True for a body that is not fixed to a link.
    """

    name: str
    joint: int
    shapes: tuple[Shape, ...]
    placements: tuple[pin.SE3, ...]
    solids: tuple[coal.CollisionGeometry, ...]
    hulls: tuple[coal.CollisionGeometry, ...]
    is_surrounding: bool

    @property
    def is_link(self) -> bool:
        """True for a link of the robot, False for a tool or an object of the surroundings."""
        return self.name == self.shapes[0].link

    @property
    def has_mesh(self) -> bool:
        """True if one of its shapes is a mesh."""
        return any(shape.kind is ShapeKind.MESH for shape in self.shapes)


@dataclass(frozen=True)
class BodyPair:
    """Two bodies that must keep a distance.

    Attributes:
        first: Index of a body.
        second: Index of the other body.
        margin: Required distance [m].
    """

    first: int
    second: int
    margin: float


def group_bodies(robot: Robot, shapes: Sequence[Shape]) -> tuple[Body, ...]:
    """Combine shapes with the same name into bodies.

    Raises:
        UnusableInput: A shape is fixed to a link that the robot does not have, or a mesh cannot be
            read.
    """
    mesh_file.read_all([shape.file for shape in shapes if shape.file is not None])
    groups: dict[str, list[Shape]] = {}
    for shape in shapes:
        groups.setdefault(shape.name, []).append(shape)
    out = []
    for name, parts in groups.items():
        joint, placement = 0, pin.SE3.Identity()
        if parts[0].link is not None:
            frame = robot.model.frames[robot.frame(parts[0].link)]
            joint, placement = int(frame.parentJoint), frame.placement
        placements = tuple(placement * shape.placement for shape in parts)
        solids = tuple(shape.solid() for shape in parts)
        hulls = tuple(shape.hull() for shape in parts)
        is_surrounding = parts[0].link is None
        out.append(Body(name, joint, tuple(parts), placements, solids, hulls, is_surrounding))
    return tuple(out)


class DistanceQuery:
    """Distances of pairs of bodies at a configuration that can be changed."""

    def __init__(
        self,
        robot: Robot,
        bodies: Sequence[Body],
        pairs: Sequence[BodyPair],
        exact_below: float,
    ) -> None:
        """Build the geometry of the pairs.

        Args:
            robot: Robot that moves the bodies.
            bodies: All bodies.
            pairs: Pairs whose distances can be queried.
            exact_below: Distance of the convex hulls below which meshes are queried exactly [m].
        """
        self.robot, self.exact_below = robot, exact_below
        self.data = robot.model.createData()
        starts = np.cumsum([0, *(len(body.shapes) for body in bodies)])
        shape_ranges = [
            [range(starts[i], starts[i + 1]) for i in (pair.first, pair.second)] for pair in pairs
        ]
        shape_pairs = [list(itertools.product(first, second)) for first, second in shape_ranges]
        ends = np.cumsum([0, *(len(combinations) for combinations in shape_pairs)])
        self._entries = [range(a, b) for a, b in itertools.pairwise(ends.tolist())]
        self._has_mesh = [bodies[p.first].has_mesh or bodies[p.second].has_mesh for p in pairs]
        flat = [indices for combinations in shape_pairs for indices in combinations]
        self._convex, self._exact = (_geometry(bodies, flat, exact) for exact in (False, True))
        self._shape_pairs = [(int(first), int(second)) for first, second in flat]
        self._meshes = MeshDistance([solid for body in bodies for solid in body.solids])
        self._result = coal.DistanceResult()

    def set_configuration(self, q: FloatArray) -> DistanceQuery:
        """Move all bodies to a configuration of the robot's joints. Shape (n,) [rad or m]."""
        pin.forwardKinematics(self.robot.model, self.data, self.robot.expand(q))
        pin.updateGeometryPlacements(self.robot.model, self.data, *self._convex)
        if any(self._has_mesh):
            pin.updateGeometryPlacements(self.robot.model, self.data, *self._exact)
        return self

    def distance(self, pair: int) -> float:
        """Compute the distance of a pair at the current configuration.

        Meshes whose hulls are further apart than `exact_below` get the distance of their hulls,
        which is a lower bound and a hundred times cheaper.

        Args:
            pair: Index of the pair.

        Returns:
            Distance, not positive for bodies in contact [m].
        """
        least = np.inf
        for number in self._entries[pair]:
            distance = float(pin.computeDistance(*self._convex, number).min_distance)
            if self._has_mesh[pair] and distance < self.exact_below:
                distance = self._exact_distance(number)
            least = min(least, distance)
        return least

    def _exact_distance(self, number: int) -> float:
        """Distance of a pair of exact shapes [m]."""
        pair = self._shape_pairs[number]
        placements = (self._exact[1].oMg[shape] for shape in pair)
        first, second = (coal.Transform3s(m.rotation, m.translation) for m in placements)
        return self._meshes.nearest(pair, first, second, self._result)


def _geometry(
    bodies: Sequence[Body], shape_pairs: Sequence[tuple[int, int]], exact: bool
) -> tuple[pin.GeometryModel, pin.GeometryData]:
    """Build Pinocchio's geometry of pairs of shapes, exact or as convex hulls."""
    model = pin.GeometryModel()
    for body in bodies:
        for number, (placement, solid) in enumerate(
            zip(body.placements, body.solids if exact else body.hulls, strict=True)
        ):
            model.addGeometryObject(
                pin.GeometryObject(f"{body.name}/{number}", body.joint, placement, solid)
            )
    for first, second in shape_pairs:
        model.addCollisionPair(pin.CollisionPair(first, second))
    return model, model.createData()
