"""Clearance constraints of the optimiser: distances of many pairs of convex covers at many poses,
with exact gradients.

Capsules enclose links and tools; capsules, boxes and half spaces enclose the surroundings. The
distances of the covers are therefore lower bounds of the distances of the bodies.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import coal
import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from . import segment_distance
from .batch_kinematics import KinematicTree
from .geometry import Shape, ShapeKind
from .mesh_distance import MeshDistance
from .segment_distance import NearestPoints

SCALE_RATIO = 20.0
"""Scale of a constraint over the required clearance [1]. The working set of the optimiser takes a
constraint up within a quarter of its scale."""
MIN_SCALE = 0.04
"""Smallest scale of a constraint [m]."""
MAX_SCALE = 0.4
"""Largest scale of a constraint [m]."""
SAMPLING_ALLOWANCE = 4e-3
"""Clearance that is added at the samples for what happens between them [m]; less for pairs whose
required clearance is less than five times this."""
MESH_BELOW = 0.03
"""Excess of a distance of hulls over the required clearance below which meshes are evaluated [m];
beyond it the constraint is inactive, and the distance of the hulls is a lower bound."""
MESH_RESOLVED = 4e-3
"""Excess of a distance of meshes over what its constraint asks up to which it is resolved [m].
Beyond it the constraint is constant and inactive, which spares most of the work (parallel surfaces
of 9,000 and 13,000 triangles take 3 ms otherwise). With 1 to 1.5 mm, motions of a leg were found
that collide between their samples."""
MIN_CONTACT_DEPTH = 1e-4
"""Least depth that is stated for meshes in contact, whose own distance has no gradient [m]."""
MAX_CONTACT_DEPTH = 2e-3
"""Largest depth that is stated for them [m]. The depth of their hulls would jump by centimetres
where the meshes begin to touch, and the search would reject all steps near there (PR2 arm: A 4e11
instead of 2e4)."""
EXACT_BELOW = 0.15
"""Excess over the required clearance up to which distances are exact [m]; beyond it they are lower
bounds."""


class CoverPairKind(IntEnum):
    """Kinds of pairs of covers, by which distances are computed."""

    CAPSULES = 0
    CAPSULE_BOX = 1
    CAPSULE_PLANE = 2
    HULLS = 3
    MESHES = 4


HULL_KINDS = (CoverPairKind.HULLS, CoverPairKind.MESHES)
"""Kinds whose indices refer to `ClearanceConstraint.hulls`."""


@dataclass(frozen=True)
class ClearanceConstraint:
    """Pairs of covers that must keep a distance, as arrays that other processes can receive.

    C capsules, B boxes and P pairs.

    Attributes:
        tree: Kinematic tree of the robot.
        joint: Joint that moves each capsule. Shape (C,).
        begin: Starts of the capsules' segments in the joints' frames. Shape (C, 3) [m].
        end: Ends of the capsules' segments. Shape (C, 3) [m].
        radius: Radii of the capsules. Shape (C,) [m].
        box_pose: Orientations of the boxes in the base frame. Shape (B, 3, 3).
        box_centre: Centres of the boxes. Shape (B, 3) [m].
        box_half: Half of the boxes' edge lengths. Shape (B, 3) [m].
        normal: Normals of the planes that bound half spaces. Shape (planes, 3).
        height: Offsets of these planes along their normals. Shape (planes,) [m].
        hulls: Convex hulls of bodies whose capsules are too loose.
        kind: Kind of each pair, a `CoverPairKind`. Shape (P,).
        first: Index of each pair's first cover among those of its kind. Shape (P,).
        second: Index of its second cover. Shape (P,).
        required: Required clearance. Shape (P,) [m].
        names: Names of the bodies of each pair.
        extra: Clearance added where SAMPLING_ALLOWANCE was not enough. Shape () or (P,) [m].
        scale_ratio: Scale of a constraint over the required clearance [1].
    """

    tree: KinematicTree
    joint: IntArray
    begin: FloatArray
    end: FloatArray
    radius: FloatArray
    box_pose: FloatArray
    box_centre: FloatArray
    box_half: FloatArray
    normal: FloatArray
    height: FloatArray
    hulls: tuple[PlacedHull, ...]
    kind: IntArray
    first: IntArray
    second: IntArray
    required: FloatArray
    names: tuple[str, ...]
    extra: float | FloatArray = 0.0
    scale_ratio: float = SCALE_RATIO

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def scale(self) -> FloatArray:
        """Distance by which each constraint is divided. Shape (P,) [m]."""
        return np.clip(self.scale_ratio * self.required, MIN_SCALE, MAX_SCALE)

    @cached_property
    def asked(self) -> FloatArray:
        """Distance that each constraint asks for at the samples. Shape (P,) [m]."""
        allowance = SAMPLING_ALLOWANCE * np.minimum(self.required / (5.0 * SAMPLING_ALLOWANCE), 1.0)
        return np.asarray(self.required + (allowance + self.extra))

    @cached_property
    def resolved(self) -> FloatArray:
        """Distance up to which meshes are resolved. Shape (P,) [m]."""
        return self.asked + MESH_RESOLVED

    @cached_property
    def bounding_radius(self) -> FloatArray:
        """Radius of the ball around the middle of each capsule that encloses it. Shape (C,) [m]."""
        return np.asarray(0.5 * np.linalg.norm(self.end - self.begin, axis=1) + self.radius)

    @cached_property
    def hull_arrays(self) -> HullArrays:
        """Data of all hulls as arrays."""
        centre, radius = zip(*(hull.bounding_ball() for hull in self.hulls), strict=True)
        joint, rotation, position = (
            np.array([getattr(hull, name) for hull in self.hulls])
            for name in ("joint", "rotation", "position")
        )
        return HullArrays(joint, rotation, position, np.array(centre), np.array(radius))

    def evaluate(self, q: FloatArray) -> ClearanceEvaluation:
        """Evaluate all pairs at poses. Shape (N, n) [rad or m]."""
        return ClearanceEvaluation(self, *self.tree.poses(q))

    def least_excess(self, q: FloatArray) -> tuple[FloatArray, IntArray]:
        """Find the pair with the least clearance beyond the required one at each pose.

        Args:
            q: Poses. Shape (N, n) [rad or m].

        Returns:
            Distance minus required clearance, negative where it is violated, shape (N,) [m], and
            index of the pair, shape (N,).
        """
        excess = self.evaluate(q).distances() - self.required
        pair = np.argmin(excess, axis=1)
        return excess[np.arange(len(q)), pair], pair

    def without_pairs(self, dropped: BoolArray) -> ClearanceConstraint:
        """Return the constraint without the marked pairs. Shape (P,)."""
        arrays = {
            name: getattr(self, name)[~dropped] for name in ("kind", "first", "second", "required")
        }
        return dataclasses.replace(
            self, names=tuple(np.array(self.names, object)[~dropped]), **arrays
        )


@dataclass(frozen=True)
class PlacedHull:
    """Convex hull of a shape that a joint moves.

    Attributes:
        shape: The shape.
        joint: Index of the joint, 0 for a fixed body.
        rotation: Orientation in the joint's frame. Shape (3, 3).
        position: Origin in the joint's frame. Shape (3,) [m].
    """

    shape: Shape
    joint: int
    rotation: FloatArray
    position: FloatArray

    @property
    def has_mesh(self) -> bool:
        """True if the hull may differ from the shape."""
        return self.shape.kind is ShapeKind.MESH

    def bounding_ball(self) -> tuple[FloatArray, float]:
        """Centre in the joint's frame, shape (3,) [m], and radius [m] of an enclosing ball."""
        if self.shape.kind is ShapeKind.FLOOR:
            return self.position, np.inf
        solid = self.shape.hull()
        solid.computeLocalAABB()
        return self.rotation @ np.array(solid.aabb_center) + self.position, float(solid.aabb_radius)


@dataclass(frozen=True)
class HullArrays:
    """Data of H hulls.

    Attributes:
        joint: Joints that move the hulls. Shape (H,).
        rotation: Orientations in the joints' frames. Shape (H, 3, 3).
        position: Origins in the joints' frames. Shape (H, 3) [m].
        centre: Centres of enclosing balls in the joints' frames. Shape (H, 3) [m].
        radius: Radii of these balls. Shape (H,) [m].
    """

    joint: IntArray
    rotation: FloatArray
    position: FloatArray
    centre: FloatArray
    radius: FloatArray


class ClearanceEvaluation:
    """Distances of all pairs of a clearance constraint at N poses, and their gradients."""

    def __init__(
        self, constraint: ClearanceConstraint, rotation: FloatArray, origin: FloatArray
    ) -> None:
        """Place the capsules.

        Args:
            constraint: Pairs of covers.
            rotation: Orientations of the joint frames. Shape (N, J, 3, 3).
            origin: Origins of the joint frames. Shape (N, J, 3) [m].
        """
        self.constraint, self.rotation, self.origin = constraint, rotation, origin
        self._cached_twists: FloatArray | None = None
        self._mesh_points: dict[tuple[int, int], FloatArray] = {}
        R, p = rotation[:, constraint.joint], origin[:, constraint.joint]
        self.ends = [
            (R @ end[:, :, None])[..., 0] + p for end in (constraint.begin, constraint.end)
        ]

    def constraint_values(self) -> FloatArray:
        """Scaled constraints of the design problem, satisfied where ≤ 1. Shape (N, P)."""
        c = self.constraint
        return np.asarray(1.0 + (c.asked - self.distances()) / c.scale)

    def distances(self) -> FloatArray:
        """Distances of all pairs. Shape (N, P) [m].

        They are lower bounds beyond EXACT_BELOW, those of meshes beyond MESH_RESOLVED.
        """
        c = self.constraint
        out = np.empty((len(self.origin), len(c)))
        for kind in CoverPairKind:
            pairs = np.flatnonzero(c.kind == kind)
            if not len(pairs):
                continue
            distance = self._lower_bound(kind, pairs)
            sample, column = np.nonzero(distance < c.required[pairs] + EXACT_BELOW)
            if len(sample):
                nearest = self._nearest_points(kind, sample, pairs[column])
                distance[sample, column] = nearest.distance
            out[:, pairs] = distance
        return out

    def gradients(self, sample: IntArray, pair: IntArray) -> FloatArray:
        """Compute gradients of single constraints with respect to the joint positions.

        Both nearest points lie on a line along the direction n of the distance, so that x × n is
        the same for both.

        Args:
            sample: Indices of poses. Shape (m,).
            pair: Indices of pairs. Shape (m,).

        Returns:
            Gradients of `constraint_values`. Shape (m, n).
        """
        c = self.constraint
        wrench = np.zeros((len(sample), 6))
        moves = np.zeros((len(sample), len(c.tree.parent)))
        for kind in CoverPairKind:
            rows = np.flatnonzero(c.kind[pair] == kind)
            if not len(rows):
                continue
            nearest = self._nearest_points(kind, sample[rows], pair[rows])
            moment = np.cross(nearest.first, nearest.direction)
            wrench[rows] = np.hstack([moment, nearest.direction])
            joints = c.hull_arrays.joint if kind in HULL_KINDS else c.joint
            moves[rows] = c.tree.support[joints[c.first[pair[rows]]]]
            if kind not in (CoverPairKind.CAPSULE_BOX, CoverPairKind.CAPSULE_PLANE):
                moves[rows] -= c.tree.support[joints[c.second[pair[rows]]]]
        rates = (self._joint_twists()[sample] @ wrench[:, :, None])[..., 0] * moves
        return np.asarray(-(rates[:, 1:] @ c.tree.spread) / c.scale[pair, None])

    def _joint_twists(self) -> FloatArray:
        if self._cached_twists is None:
            self._cached_twists = self.constraint.tree.joint_twists(self.rotation, self.origin)
        return self._cached_twists

    def _lower_bound(self, kind: CoverPairKind, pairs: IntArray) -> FloatArray:
        """Distances of balls around the covers. Shape (N, pairs of the kind) [m]."""
        c = self.constraint
        a, b = c.first[pairs], c.second[pairs]
        if kind in HULL_KINDS:
            h = c.hull_arrays
            R, p = self.rotation[:, h.joint], self.origin[:, h.joint]
            centre = (R @ h.centre[:, :, None])[..., 0] + p
            return np.asarray(_norm(centre[:, a] - centre[:, b]) - h.radius[a] - h.radius[b])
        middle = 0.5 * (self.ends[0] + self.ends[1])
        centre, radius = middle[:, a], c.bounding_radius
        if kind == CoverPairKind.CAPSULES:
            return np.asarray(_norm(centre - middle[:, b]) - radius[a] - radius[b])
        if kind == CoverPairKind.CAPSULE_BOX:
            offset = centre - c.box_centre[b]
            bound = np.asarray(_norm(offset) - _norm(c.box_half[b]) - radius[a])
            # the box itself where the ball around it is near
            sample, column = np.nonzero(bound < c.required[pairs] + EXACT_BELOW)
            near = b[column]
            in_box_frame = np.einsum("mji,mj->mi", c.box_pose[near], offset[sample, column])
            outside = np.maximum(np.abs(in_box_frame) - c.box_half[near], 0.0)
            bound[sample, column] = _norm(outside) - radius[a[column]]
            return bound
        return np.asarray(np.sum(centre * c.normal[b], axis=2) - c.height[b] - radius[a])

    def _nearest_points(
        self, kind: CoverPairKind, sample: IntArray, pair: IntArray
    ) -> NearestPoints:
        """Nearest points of pairs of one kind, each at its own pose.

        Points are on the axes of capsules, distances are those of their surfaces.
        """
        c = self.constraint
        a, b = c.first[pair], c.second[pair]
        if kind == CoverPairKind.HULLS:
            return self._nearest_points_of_hulls(sample, a, b)
        if kind == CoverPairKind.MESHES:
            return self._nearest_points_of_meshes(sample, pair)
        segment = self.ends[0][sample, a], self.ends[1][sample, a]
        if kind == CoverPairKind.CAPSULES:
            nearest = segment_distance.segment_to_segment(
                *segment, self.ends[0][sample, b], self.ends[1][sample, b]
            )
            distance = nearest.distance - c.radius[a] - c.radius[b]
            return dataclasses.replace(nearest, distance=distance)
        if kind == CoverPairKind.CAPSULE_BOX:
            nearest = segment_distance.segment_to_box(
                *segment, c.box_pose[b], c.box_centre[b], c.box_half[b]
            )
        else:
            nearest = segment_distance.segment_to_plane(*segment, c.normal[b], c.height[b])
        return dataclasses.replace(nearest, distance=nearest.distance - c.radius[a])

    def _nearest_points_of_hulls(
        self, sample: IntArray, a: IntArray, b: IntArray, resolved: FloatArray | None = None
    ) -> NearestPoints:
        """Nearest points of hulls, or of the exact shapes, each pair at its own pose.

        Args:
            sample: Indices of poses. Shape (m,).
            a: Indices of hulls. Shape (m,).
            b: Indices of the other hulls. Shape (m,).
            resolved: Distances up to which the exact shapes are resolved; None: the hulls are
                evaluated. Shape (m,) [m].
        """
        shapes = [hull.shape for hull in self.constraint.hulls]
        if resolved is not None:
            search = MeshDistance([shape.solid() for shape in shapes])
        else:
            hulls = [shape.hull() for shape in shapes]
        placements = [self._hull_placements(sample, hull) for hull in (a, b)]
        out = np.empty((len(sample), 10))
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        for row, (i, j) in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
            first, second = (coal.Transform3s(R[row], p[row]) for R, p in placements)
            if resolved is not None:
                distance = search.nearest((i, j), first, second, result, float(resolved[row]))
            else:
                result.clear()
                distance = coal.distance(hulls[i], first, hulls[j], second, request, result)
            # coal's normal points from the first body to the second
            out[row] = (
                distance,
                *(-result.normal),
                *result.getNearestPoint1(),
                *result.getNearestPoint2(),
            )
        return NearestPoints.from_table(out)

    def _nearest_points_of_meshes(self, sample: IntArray, pair: IntArray) -> NearestPoints:
        """Nearest points of meshes; of their hulls where these are far apart or the meshes touch.

        Results are kept, as gradients are evaluated where distances were.
        """
        c, cache = self.constraint, self._mesh_points
        missing = np.array(
            [key not in cache for key in zip(sample.tolist(), pair.tolist(), strict=True)]
        )
        if missing.any():
            at, rows = sample[missing], pair[missing]
            a, b = c.first[rows], c.second[rows]
            table = self._nearest_points_of_hulls(at, a, b).table()
            near = np.flatnonzero(table[:, 0] < c.required[rows] + MESH_BELOW)
            if len(near):
                exact = self._nearest_points_of_hulls(
                    at[near], a[near], b[near], c.resolved[rows[near]]
                ).table()
                apart = exact[:, 0] > 0.0
                beyond = np.isnan(exact).any(axis=1)  # not resolved: no gradient
                exact[beyond, 1:] = 0.0
                # coal states no normal for meshes
                exact[apart, 1:4] = (exact[apart, 4:7] - exact[apart, 7:]) / exact[apart, :1]
                table[near[apart]] = exact[apart]
                touching = near[~apart]
                table[touching, 0] = np.clip(
                    table[touching, 0], -MAX_CONTACT_DEPTH, -MIN_CONTACT_DEPTH
                )
            keys = zip(at.tolist(), rows.tolist(), strict=True)
            cache.update(zip(keys, table, strict=True))
        rows_of_table = [cache[key] for key in zip(sample.tolist(), pair.tolist(), strict=True)]
        return NearestPoints.from_table(np.array(rows_of_table).reshape(-1, 10))

    def _hull_placements(self, sample: IntArray, hull: IntArray) -> tuple[FloatArray, FloatArray]:
        """Orientations and origins of hulls in the base frame. Shapes (m, 3, 3), (m, 3)."""
        h = self.constraint.hull_arrays
        R, p = self.rotation[sample, h.joint[hull]], self.origin[sample, h.joint[hull]]
        return R @ h.rotation[hull], (R @ h.position[hull][:, :, None])[..., 0] + p


def _norm(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.sum(vectors * vectors, axis=-1)))
