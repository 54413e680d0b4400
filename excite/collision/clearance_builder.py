"""Build the clearance constraint of a cell: cover all bodies, and select the pairs of covers that
can come near each other."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..robot.inertial_parameters import spread_poses
from . import capsule_cover
from .batch_kinematics import KinematicTree
from .capsule_cover import Capsule
from .clearance_constraint import EXACT_BELOW, ClearanceConstraint, CoverPairKind, PlacedHull
from .distance_query import Body, BodyPair
from .geometry import ShapeKind
from .workcell import CONSTANT_DISTANCE, Cell

POSES = 1000
"""Poses, spread over the position ranges, at which pairs of covers are selected."""
HULL_POSES = POSES // 10
"""Poses at which pairs of hulls are selected, which take longer."""
MAX_FALSE_SHARE = 0.05
"""Share of poses in which covers may violate a clearance that the bodies keep [1]."""
EXACT_POSES = 15
"""Number of poses with a violation at which the bodies themselves are evaluated."""
MAX_FALSE_HULL_SHARE = 0.2
"""Share of poses in which hulls may violate a clearance that the meshes keep [1]; meshes take about
a hundred times longer."""


POSE_RATIO = 1.7
"""Distance of hulls in `Cell.pose` over the margin of their pair below which they are too loose:
the bodies keep twice the margin there, and the optimiser asks for up to 1.6 times of it before a
constraint leaves its working set."""


@dataclass
class _Covers:
    """Covers of all bodies.

    Attributes:
        capsules: Capsules in their joints' frames, with the joints.
        boxes: Orientation, centre and half edge lengths of boxes in the base frame.
        planes: Normal and offset of planes.
        of_bodies: For each body the indices of its capsules, boxes and planes.
    """

    capsules: list[tuple[Capsule, int]] = field(default_factory=list)
    boxes: list[tuple[FloatArray, FloatArray, FloatArray]] = field(default_factory=list)
    planes: list[tuple[FloatArray, float]] = field(default_factory=list)
    of_bodies: list[tuple[range, range, range]] = field(default_factory=list)

    def add(self, body: Body) -> None:
        """Cover another body."""
        before = self._counts()
        for shape, placement in zip(body.shapes, body.placements, strict=True):
            if shape.kind is ShapeKind.FLOOR:
                normal = placement.rotation[:, 2]
                self.planes.append((normal, float(normal @ placement.translation)))
            elif body.joint == 0 and shape.kind in (ShapeKind.BOX, ShapeKind.MESH):
                for low, high in capsule_cover.cover_with_boxes(shape):
                    self.boxes.append(
                        (placement.rotation, placement.act(0.5 * (low + high)), 0.5 * (high - low))
                    )
            else:
                # capsules are in the frame of the shape's link; transform them to the joint's frame
                link_placement = placement * shape.placement.inverse()
                self.capsules += [
                    (
                        capsule.transformed(link_placement.rotation, link_placement.translation),
                        body.joint,
                    )
                    for capsule in capsule_cover.cover_with_capsules(shape)
                ]
        capsules, boxes, planes = (range(a, b) for a, b in zip(before, self._counts(), strict=True))
        self.of_bodies.append((capsules, boxes, planes))

    def _counts(self) -> tuple[int, int, int]:
        return len(self.capsules), len(self.boxes), len(self.planes)

    def pairs_of(self, pair: BodyPair) -> Iterator[tuple[int, int, int]]:
        """Yield kind, index of the capsule and index of the other cover for a pair of bodies.

        A body may have capsules and boxes at once, as a base of cylinders and boxes has.
        """
        first, second = self.of_bodies[pair.first], self.of_bodies[pair.second]
        for with_capsules, other in ((first, second), (second, first)):
            for kind in (CoverPairKind.CAPSULE_BOX, CoverPairKind.CAPSULE_PLANE):
                yield from ((kind, a, b) for a in with_capsules[0] for b in other[kind])
        yield from ((CoverPairKind.CAPSULES, a, b) for a in first[0] for b in second[0])


@lru_cache(maxsize=2)
def build_constraint(cell: Cell) -> ClearanceConstraint | None:
    """Cover the bodies of a cell and select the pairs of covers that can come near each other.

    Convex hulls replace the covers of a pair where these are too loose, and meshes replace hulls
    that are too loose as well, so that every pair that can come near each other is constrained.

    Returns:
        The constraint; None if no pair can come near each other.
    """
    covers = _Covers()
    for body in cell.bodies:
        covers.add(body)
    rows = [
        (*row, number) for number, pair in enumerate(cell.pairs) for row in covers.pairs_of(pair)
    ]
    if not rows:
        return None
    kind, first, second, pair = np.array(rows, int).T
    constraint = dataclasses.replace(
        _without_pairs(cell, covers),
        kind=kind,
        first=first,
        second=second,
        required=np.array([cell.pairs[k].margin for k in pair]),
        names=tuple(cell.names(cell.pairs[k]) for k in pair),
    )
    return _select_pairs(constraint, cell, pair)


def build_hull_constraint(cell: Cell, pairs: Sequence[BodyPair]) -> ClearanceConstraint:
    """Build the constraint of some pairs of bodies, with their convex hulls or meshes.

    Args:
        cell: The cell.
        pairs: Pairs of it.
    """
    return _with_hulls(_without_pairs(cell, _Covers()), cell, pairs)


def _without_pairs(cell: Cell, covers: _Covers) -> ClearanceConstraint:
    """Return a constraint with the covers of a cell, but no pairs of them."""
    capsules = [capsule for capsule, _ in covers.capsules]
    return ClearanceConstraint(
        tree=KinematicTree.from_robot(cell.robot),
        joint=np.array([joint for _, joint in covers.capsules], int),
        begin=np.array([capsule.begin for capsule in capsules]).reshape(-1, 3),
        end=np.array([capsule.end for capsule in capsules]).reshape(-1, 3),
        radius=np.array([capsule.radius for capsule in capsules], float),
        box_pose=np.array([rotation for rotation, _, _ in covers.boxes]).reshape(-1, 3, 3),
        box_centre=np.array([centre for _, centre, _ in covers.boxes]).reshape(-1, 3),
        box_half=np.array([half for _, _, half in covers.boxes]).reshape(-1, 3),
        normal=np.array([normal for normal, _ in covers.planes]).reshape(-1, 3),
        height=np.array([height for _, height in covers.planes], float),
        hulls=(),
        kind=np.zeros(0, int),
        first=np.zeros(0, int),
        second=np.zeros(0, int),
        required=np.zeros(0),
        names=(),
    )


def _select_pairs(
    constraint: ClearanceConstraint, cell: Cell, pair: IntArray
) -> ClearanceConstraint | None:
    """Remove covers that stay apart at all poses, and replace covers that are too loose by hulls.

    Args:
        constraint: All pairs of covers.
        cell: The cell.
        pair: Index of the pair of bodies of each pair of covers. Shape (P,).
    """
    poses = spread_poses(cell.limits, POSES)
    excess = constraint.evaluate(poses).distances() - constraint.required
    # the motion does not change distances that are the same at all poses
    constant = (np.ptp(excess, axis=0) < CONSTANT_DISTANCE) & (excess.min(axis=0) >= 0.0)
    dropped = np.asarray((excess.min(axis=0) >= EXACT_BELOW) | constant)
    loose, query = list[BodyPair](), cell.distance_query()
    for number, bodies in enumerate(cell.pairs):
        rows = pair == number
        violated = (excess[:, rows] < 0.0).any(axis=1)
        if violated.mean() <= MAX_FALSE_SHARE:
            continue
        sample = poses[violated][:: max(int(violated.sum()) // EXACT_POSES, 1)]
        false_share = float(
            np.mean([query.set_configuration(q).distance(number) >= bodies.margin for q in sample])
        )
        if false_share * violated.mean() > MAX_FALSE_SHARE:
            dropped |= rows
            loose.append(bodies)
    selected = _with_hulls(constraint.without_pairs(dropped), cell, loose)
    return selected if len(selected) else None


def _too_near_in_pose(constraint: ClearanceConstraint, cell: Cell) -> BoolArray:
    """Return which hulls are too loose in the pose of a cell, none without one. Shape (P,)."""
    if cell.pose is None:
        return np.zeros(len(constraint), bool)
    distances = constraint.evaluate(cell.pose[None]).distances()[0]
    return np.asarray(distances < POSE_RATIO * constraint.required)


def _with_hulls(
    constraint: ClearanceConstraint, cell: Cell, pairs: Sequence[BodyPair]
) -> ClearanceConstraint:
    """Add the hulls of pairs of bodies, or their meshes where the hulls are too loose."""
    numbers = sorted({i for pair in pairs for i in (pair.first, pair.second)})
    hulls, of_bodies = list[PlacedHull](), dict[int, range]()
    for i in numbers:
        body, begin = cell.bodies[i], len(hulls)
        hulls += [
            PlacedHull(shape, body.joint, placement.rotation, placement.translation)
            for shape, placement in zip(body.shapes, body.placements, strict=True)
        ]
        of_bodies[i] = range(begin, len(hulls))
    rows = [
        (*indices, pair)
        for pair in pairs
        for indices in itertools.product(of_bodies[pair.first], of_bodies[pair.second])
    ]
    extended = dataclasses.replace(
        constraint,
        hulls=tuple(hulls),
        kind=np.append(constraint.kind, np.full(len(rows), CoverPairKind.HULLS)),
        first=np.append(constraint.first, [row[0] for row in rows]).astype(int),
        second=np.append(constraint.second, [row[1] for row in rows]).astype(int),
        required=np.append(constraint.required, [row[2].margin for row in rows]),
        names=(*constraint.names, *(cell.names(row[2]) for row in rows)),
    )
    poses = spread_poses(cell.limits, HULL_POSES)
    violated = extended.evaluate(poses).distances() - extended.required < 0.0
    kind = extended.kind.copy()
    too_near = _too_near_in_pose(extended, cell)
    for row in np.flatnonzero((kind == CoverPairKind.HULLS) & (violated.any(axis=0) | too_near)):
        if not any(hulls[i].has_mesh for i in (extended.first[row], extended.second[row])):
            continue
        if too_near[row]:
            kind[row] = CoverPairKind.MESHES
            continue
        exact = _with_meshes_only(extended, int(row))
        sample = poses[violated[:, row]][:: max(int(violated[:, row].sum()) // EXACT_POSES, 1)]
        kept = exact.evaluate(sample).distances()[:, 0] >= exact.required[0]
        if np.mean(kept) * np.mean(violated[:, row]) > MAX_FALSE_HULL_SHARE:
            kind[row] = CoverPairKind.MESHES
    return dataclasses.replace(extended, kind=kind)


def _with_meshes_only(constraint: ClearanceConstraint, row: int) -> ClearanceConstraint:
    """Return the constraint with a single pair of hulls, whose meshes are evaluated."""
    others = np.arange(len(constraint)) != row
    single = constraint.without_pairs(others)
    return dataclasses.replace(single, kind=np.array([CoverPairKind.MESHES], int))
