"""Distances between covers of all bodies, many poses at once, with exact gradients: the optimiser's
side of a cell.

Capsules enclose links and tools; capsules, boxes and half spaces enclose what stands around. So the
true distance is never less.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import coal
import numpy as np

from . import segment_distance
from .batch_kinematics import Chain
from .geometry import Kind, Shape
from .segment_distance import Nearest

Array = np.ndarray
SCALE = 20.0
LEAST, MOST = 0.04, 0.4
"""A row's unit is so many margins, within these bounds [m]: rows join the optimisation when a
quarter of it is left."""
SLACK = 4e-3
"""Clearance beyond the margin for what happens between samples, at first [m]; less where the margin
is under five times that."""
FAR = 0.15
"""Beyond the margin by more than this, bounds of distances do [m]."""


@dataclass(frozen=True)
class Clearance:
    """Pairs of covers that keep apart; arrays and shapes only, so that it goes to other processes.

    joint, begin, end, radius: of the capsules, ends in the joint's frame. Shapes (C,), (C, 3), (C,
    3), (C,). box_pose, box_centre, box_half: of the boxes, base frame. Shapes (B, 3, 3), (B, 3),
    (B, 3). normal, height: of the planes. hulls: bodies that capsules enclose too loosely, with the
    joint and placement of each; their convex hulls stand for them. kind: 0 capsules, 1 capsule and
    box, 2 capsule and plane, 3 hulls. first, second: their numbers. need: clearance. Shapes (P,).
    names: of the bodies of each pair. more: clearance beyond SLACK, where that did not do between
    samples [m].
    """

    chain: Chain
    joint: Array
    begin: Array
    end: Array
    radius: Array
    box_pose: Array
    box_centre: Array
    box_half: Array
    normal: Array
    height: Array
    hulls: tuple[Hull, ...]
    kind: Array
    first: Array
    second: Array
    need: Array
    names: tuple[str, ...]
    more: float | Array = 0.0

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def unit(self) -> Array:
        """Distance that a row's unit stands for. Shape (P,) [m]."""
        return np.clip(SCALE * self.need, LEAST, MOST)

    @cached_property
    def reach(self) -> Array:
        """Radius of a ball around each capsule. Shape (C,) [m]."""
        return np.asarray(0.5 * np.linalg.norm(self.end - self.begin, axis=1) + self.radius)

    @cached_property
    def stack(self) -> Stack:
        """The hulls as arrays, as every look needs them."""
        centre, radius = zip(*(hull.ball() for hull in self.hulls), strict=True)
        joint, rotation, position = (
            np.array([getattr(hull, name) for hull in self.hulls])
            for name in ("joint", "rotation", "position")
        )
        return Stack(joint, rotation, position, np.array(centre), np.array(radius))

    def at(self, q: Array) -> Look:
        """Look at many poses. Shape (N, n)."""
        return Look(self, *self.chain.poses(q))

    def least(self, q: Array) -> tuple[Array, Array]:
        """Clearance beyond what is needed at each pose, and the pair that has least. Shapes (N, n)
        -> (N,) [m], (N,)."""
        room = self.at(q).distances() - self.need
        pair = np.argmin(room, axis=1)
        return room[np.arange(len(q)), pair], pair

    def without(self, dropped: Array) -> Clearance:
        """The same with fewer pairs. Shape (P,), bool."""
        arrays = {
            name: getattr(self, name)[~dropped] for name in ("kind", "first", "second", "need")
        }
        return dataclasses.replace(
            self, names=tuple(np.array(self.names, object)[~dropped]), **arrays
        )


@dataclass(frozen=True)
class Hull:
    """A body as coal's convex solid, where a joint moves it. rotation, position: in the joint's
    frame. Shapes (3, 3), (3,)."""

    shape: Shape
    joint: int
    rotation: Array
    position: Array

    def ball(self) -> tuple[Array, float]:
        """Centre in the joint's frame and radius of a ball around it. Shape (3,) [m]."""
        if self.shape.kind is Kind.FLOOR:
            return self.position, np.inf
        solid = self.shape.hull()
        solid.computeLocalAABB()
        return self.rotation @ np.array(solid.aabb_center) + self.position, float(solid.aabb_radius)


@dataclass(frozen=True)
class Stack:
    """What `Hull` says of each, and the ball around it. Shapes (H,), (H, 3, 3), (H, 3), (H, 3),
    (H,)."""

    joint: Array
    rotation: Array
    position: Array
    centre: Array
    radius: Array


class Look:
    """Distances at N poses, and their slopes. rotation, origin: of all joint frames. Shapes (N, J,
    3, 3), (N, J, 3)."""

    def __init__(self, clearance: Clearance, rotation: Array, origin: Array) -> None:
        self.clearance, self.rotation, self.origin = clearance, rotation, origin
        self._speeds: Array | None = None
        turned, moved = rotation[:, clearance.joint], origin[:, clearance.joint]
        self.ends = [
            (turned @ end[:, :, None])[..., 0] + moved for end in (clearance.begin, clearance.end)
        ]

    def values(self) -> Array:
        """Rows of the design problem, satisfied where ≤ 1. Shape (N, P)."""
        c = self.clearance
        slack = SLACK * np.minimum(c.need / (5.0 * SLACK), 1.0) + c.more
        return np.asarray(1.0 + (c.need + slack - self.distances()) / c.unit)

    def distances(self) -> Array:
        """Of every pair; a lower bound where they are further apart than matters. Shape (N, P)
        [m]."""
        c = self.clearance
        out = np.empty((len(self.origin), len(c)))
        for kind in range(4):
            pairs = np.flatnonzero(c.kind == kind)
            if not len(pairs):
                continue
            bound = self._bound(kind, c.first[pairs], c.second[pairs])
            sample, column = np.nonzero(bound < c.need[pairs] + FAR)
            if len(sample):
                bound[sample, column] = self._nearest(kind, sample, pairs[column]).distance
            out[:, pairs] = bound
        return out

    def slopes(self, sample: Array, pair: Array) -> Array:
        """Derivatives of single rows by the joints' positions. Shapes (m,), (m,) -> (m, n).

        The nearest points differ along the direction n of the distance, so that x × n is the same
        for both.
        """
        c = self.clearance
        wrench, moved = np.zeros((len(sample), 6)), np.zeros((len(sample), len(c.chain.parent)))
        for kind in range(4):
            at = np.flatnonzero(c.kind[pair] == kind)
            if not len(at):
                continue
            found = self._nearest(kind, sample[at], pair[at])
            wrench[at] = np.hstack([np.cross(found.first, found.direction), found.direction])
            joints = c.stack.joint if kind == 3 else c.joint
            moved[at] = c.chain.above[joints[c.first[pair[at]]]]
            if kind in (0, 3):
                moved[at] -= c.chain.above[joints[c.second[pair[at]]]]
        each = (self._screws()[sample] @ wrench[:, :, None])[..., 0] * moved
        return np.asarray(-(each[:, 1:] @ c.chain.spread) / c.unit[pair, None])

    def _screws(self) -> Array:
        if self._speeds is None:
            self._speeds = self.clearance.chain.screws(self.rotation, self.origin)
        return self._speeds

    def _bound(self, kind: int, a: Array, b: Array) -> Array:
        """Least that distances can be, from balls around the bodies. Shape (N, P')."""
        c = self.clearance
        if kind == 3:
            h = c.stack
            centre = (self.rotation[:, h.joint] @ h.centre[:, :, None])[..., 0] + self.origin[
                :, h.joint
            ]
            return np.asarray(_length(centre[:, a] - centre[:, b]) - h.radius[a] - h.radius[b])
        middle = 0.5 * (self.ends[0] + self.ends[1])
        centre = middle[:, a]
        if kind == 0:
            return np.asarray(_length(centre - middle[:, b]) - c.reach[a] - c.reach[b])
        if kind == 1:
            inside = (np.swapaxes(c.box_pose[b], 1, 2) @ (centre - c.box_centre[b])[..., None])[
                ..., 0
            ]
            return np.asarray(_length(np.maximum(np.abs(inside) - c.box_half[b], 0.0)) - c.reach[a])
        return np.asarray(np.sum(centre * c.normal[b], axis=2) - c.height[b] - c.reach[a])

    def _nearest(self, kind: int, sample: Array, pair: Array) -> Nearest:
        """Pairs of one kind, each at a sample of its own; distances of the capsules, not of their
        axes."""
        c = self.clearance
        a, b = c.first[pair], c.second[pair]
        if kind == 3:
            return self._hulls(sample, a, b)
        one = self.ends[0][sample, a], self.ends[1][sample, a]
        if kind == 0:
            found = segment_distance.segments(
                *one, self.ends[0][sample, b], self.ends[1][sample, b]
            )
            return dataclasses.replace(found, distance=found.distance - c.radius[a] - c.radius[b])
        if kind == 1:
            found = segment_distance.box(*one, c.box_pose[b], c.box_centre[b], c.box_half[b])
        else:
            found = segment_distance.plane(*one, c.normal[b], c.height[b])
        return dataclasses.replace(found, distance=found.distance - c.radius[a])

    def _hulls(self, sample: Array, a: Array, b: Array) -> Nearest:
        solids = [hull.shape.hull() for hull in self.clearance.hulls]
        placed = [self._placed(sample, which) for which in (a, b)]
        out = np.empty((len(sample), 10))
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        for row, (i, j) in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
            one, other = (coal.Transform3s(R[row], p[row]) for R, p in placed)
            result.clear()
            least = coal.distance(solids[i], one, solids[j], other, request, result)
            # coal's normal points from the first body to the second
            out[row] = (
                least,
                *(-result.normal),
                *result.getNearestPoint1(),
                *result.getNearestPoint2(),
            )
        return Nearest(out[:, 0], out[:, 1:4], out[:, 4:7], out[:, 7:])

    def _placed(self, sample: Array, which: Array) -> tuple[Array, Array]:
        """Rotations and positions of hulls, a row each. Shapes (m, 3, 3), (m, 3)."""
        h = self.clearance.stack
        R, p = self.rotation[sample, h.joint[which]], self.origin[sample, h.joint[which]]
        return R @ h.rotation[which], (R @ h.position[which][:, :, None])[..., 0] + p


def _length(vectors: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(vectors * vectors, axis=-1)))
