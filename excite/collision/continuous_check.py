"""Independent check of the certificate: least distances along a complete motion, also between
samples.

While bodies a and b move, their distance decreases at most at the speed Σ |q̇_k| ρ_k, summed over
the joints k between them, where ρ_k bounds the distance of the points that joint k moves from its
axis. From a distance d on, the distance therefore stays above l until the integral of that speed
has reached d − l, and only then the pair is evaluated again (conservative advancement; Mirtich &
Canny, "Impulse-based simulation of rigid bodies", Symposium on Interactive 3D Graphics, 1995).
"""

from __future__ import annotations

import dataclasses
import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..errors import UnusableInput
from ..trajectory.fourier import oversampling_bound
from ..trajectory.rest_to_rest import Motion, MotionSegment
from .batch_kinematics import KinematicTree
from .distance_query import Body, BodyPair, DistanceQuery
from .geometry import ShapeKind
from .workcell import Cell

TIME_STEP = 1e-3
"""Grid of the check [s]; a step that does not decide is subdivided."""
MIN_STEPS = 8
"""Smallest number of steps of a segment."""
ABSOLUTE_TOLERANCE = 5e-4
"""Distance by which a proven lower bound may be below the observed least distance [m]."""
MARGIN_TOLERANCE = 0.25
"""Largest such distance over the margin of the pair [1]; margins below 2 mm need it."""
RELATIVE_TOLERANCE = 0.02
"""The same as a share of the observed distance; the larger of both counts [1]."""
UNRESOLVED_EXCESS = 0.02
"""Excess over the margin above which lower bounds of all but the nearest pairs are not refined
[m]."""
REFINED_PAIRS = 12
"""Number of nearest pairs of which bounds are refined at any distance; certificates list them [1].
"""
MAX_SUBDIVISIONS = 32
"""Largest number of parts of a step."""
RAYS = np.array([[0.8141, 0.3927, 0.4273], [-0.2718, 0.9113, -0.3091], [0.1414, -0.5772, 0.8043]])
"""Directions of the point-in-mesh test, along which meshes are unlikely to have edges."""
MIN_VOLUME = 1e-300
"""Determinant below which a ray counts as parallel to a triangle."""


@dataclass(frozen=True)
class PairDistance:
    """Least distance of a pair of bodies along a motion.

    Attributes:
        pair: The pair.
        names: Names of both bodies.
        observed: Least distance at the evaluated poses [m].
        proven: Lower bound of the distance along the complete motion [m].
        time: Time of `observed` [s].
        pose: Joint positions at that time. Shape (n,) [rad or m].
    """

    pair: BodyPair
    names: str
    observed: float
    proven: float
    time: float
    pose: FloatArray

    def document(self, joints: Sequence[str]) -> dict[str, Any]:
        """Entry of the pair in a trajectory file."""
        return {
            "pair": self.names,
            "least": self.observed,
            "proven": self.proven,
            "margin": self.pair.margin,
            "time": self.time,
            "pose": dict(zip(joints, self.pose.tolist(), strict=True)),
        }


@dataclass(frozen=True)
class SampledPath:
    """A stretch of a motion at ascending times.

    Attributes:
        time: Times. Shape (N,) [s].
        q: Poses at these times. Shape (N, n).
        approach: Upper bounds of the distance by which the bodies of each pair approach each other
            over each step. Shape (N − 1, pairs) [m].
        poses: Function from times within the stretch, shape (m,), to the poses, shape (m, n).
    """

    time: FloatArray
    q: FloatArray
    approach: FloatArray
    poses: Callable[[FloatArray], FloatArray]


def least_distances(cell: Cell, motion: Motion) -> list[PairDistance]:
    """Bound the distance of every pair along a motion.

    Returns:
        One entry for each pair, the one with the least proven excess over its margin first.

    Raises:
        UnusableInput: At the start, a body is inside the closed mesh of another.
    """
    distances = least_distances_along(
        cell, (_segment_path(cell, motion, segment) for segment in motion.segments)
    )
    contained = find_contained_pair(cell, motion.at(np.zeros(1))[0])
    if contained is not None:
        raise UnusableInput(
            f"{cell.names(contained)}: one is inside the other's mesh; the motion cannot begin "
            "there"
        )
    return distances


def least_distances_along(cell: Cell, paths: Iterable[SampledPath]) -> list[PairDistance]:
    """Bound the distance of every pair along stretches of a motion.

    Args:
        cell: The cell.
        paths: The stretches.

    Returns:
        One entry for each pair, the one with the least proven excess over its margin first. Bounds
        of pairs beyond the first REFINED_PAIRS may be far below what was observed.
    """
    paths, query, best = list(paths), cell.distance_query(), dict[int, PairDistance]()
    excess = dict.fromkeys(range(len(cell.pairs)), UNRESOLVED_EXCESS)
    bounds = dict.fromkeys(excess, -np.inf)
    for _ in range(2):  # all pairs, then the nearest, which are not known before
        proven = dict.fromkeys(excess, np.inf)
        for path in paths:
            for k, entry in _path_distances(cell, query, path, excess, best):
                proven[k] = min(proven[k], entry.proven)
                if k not in best or entry.observed < best[k].observed:
                    best[k] = entry
        bounds |= {k: max(bounds[k], bound) for k, bound in proven.items()}
        best = {k: dataclasses.replace(entry, proven=bounds[k]) for k, entry in best.items()}
        excess = _unresolved_excess(best)
    return sorted(best.values(), key=_proven_excess)


def _proven_excess(entry: PairDistance) -> float:
    """Lower bound of the distance beyond the margin [m]."""
    return entry.proven - entry.pair.margin


def _unresolved_excess(distances: Mapping[int, PairDistance]) -> dict[int, float]:
    """Find the nearest pairs whose bounds are below what was observed.

    The nearest are the REFINED_PAIRS first, and the first of each margin.

    Returns:
        Indices of the pairs, with the excess over the margin up to which to refine the bound [m].
    """
    excess = {k: entry.observed - entry.pair.margin for k, entry in distances.items()}
    highest = max(sorted(excess.values())[:REFINED_PAIRS], default=0.0)
    levels, out = dict[float, float](), dict[int, float]()
    for k in sorted(excess, key=excess.__getitem__):
        pair, observed = distances[k].pair, distances[k].observed
        level = levels.setdefault(pair.margin, max(excess[k], highest))
        if distances[k].proven < min(observed - _tolerance(pair, observed), pair.margin + level):
            out[k] = level
    return out


def _tolerance(pair: BodyPair, observed: float) -> float:
    """Return the distance by which the bound of a pair may be below the observed distance [m]."""
    absolute = min(ABSOLUTE_TOLERANCE, MARGIN_TOLERANCE * pair.margin or ABSOLUTE_TOLERANCE)
    return max(absolute, RELATIVE_TOLERANCE * abs(observed))


def _path_distances(
    cell: Cell,
    query: DistanceQuery,
    stretch: SampledPath,
    excess: Mapping[int, float],
    known: Mapping[int, PairDistance],
) -> Iterator[tuple[int, PairDistance]]:
    """Yield the index and the least distance of pairs along a stretch.

    Args:
        cell: The cell.
        query: Query of its distances.
        stretch: The stretch.
        excess: Indices of the pairs, with the excess over the margin up to which to refine bounds
            [m].
        known: Distances that were observed before.
    """
    # upper bound of the distance that each pair has approached since the stretch began
    path = np.vstack([np.zeros(len(cell.pairs)), np.cumsum(stretch.approach, axis=0)])
    last = len(stretch.time) - 1
    observed, proven = np.full(len(cell.pairs), np.inf), np.full(len(cell.pairs), np.inf)
    index_of_least = np.zeros(len(cell.pairs), int)
    previous = [(0, np.inf)] * len(cell.pairs)
    queue = [(0, k) for k in excess]
    current = -1
    while queue:
        index, k = heapq.heappop(queue)
        if index != current:
            query.set_configuration(stretch.q[index])
            current = index
        distance, pair = query.distance(k), cell.pairs[k]
        if distance < observed[k]:
            observed[k], index_of_least[k] = distance, index
        least = min(observed[k], known[k].observed) if k in known else observed[k]
        level = min(least - _tolerance(pair, least), pair.margin + excess[k])
        start, distance_before = previous[k]
        if index > 0:
            step = path[index, k] - path[start, k]
            bound = 0.5 * (distance_before + distance - step)
            if bound < level and index == start + 1 and distance > 0.0:
                poses = _subdivided_step(stretch, start, level, bound)
                bound = max(bound, _subdivided_bound(query, k, poses, step))
                current = -1
            proven[k] = min(proven[k], bound)
        proven[k] = min(proven[k], distance)
        previous[k] = (index, distance)
        if index < last:
            reached = path[index, k] + distance - level
            safe = int(np.searchsorted(path[:, k], reached, side="right")) - 1
            heapq.heappush(queue, (min(max(safe, index + 1), last), k))
    for k in excess:
        yield (
            k,
            PairDistance(
                cell.pairs[k],
                cell.names(cell.pairs[k]),
                float(observed[k]),
                float(proven[k]),
                float(stretch.time[index_of_least[k]]),
                stretch.q[index_of_least[k]],
            ),
        )


def _subdivided_bound(query: DistanceQuery, pair: int, poses: FloatArray, path: float) -> float:
    """Lower bound of a distance within one step of the grid, from evaluations at its parts.

    Args:
        query: Query of distances.
        pair: Index of the pair.
        poses: Poses that divide the step. Shape (m, n).
        path: Upper bound of the approach of the pair over the step [m].
    """
    d = np.empty(len(poses))
    for i, q in enumerate(poses):
        query.set_configuration(q)
        d[i] = query.distance(pair)
    return float((0.5 * (d[:-1] + d[1:] - path / (len(poses) - 1))).min())


def _subdivided_step(stretch: SampledPath, index: int, level: float, bound: float) -> FloatArray:
    """Poses that divide a step, the more the further its bound is below the level. Shape (m, n)."""
    count = int(np.clip(2.0 + (level - bound) / ABSOLUTE_TOLERANCE, 2, MAX_SUBDIVISIONS))
    return stretch.poses(np.linspace(stretch.time[index], stretch.time[index + 1], count + 1))


def _segment_path(cell: Cell, motion: Motion, segment: MotionSegment) -> SampledPath:
    """Sample a segment; the Fourier part over a single period."""
    fourier = motion.fourier
    duration = fourier.period if segment.profile is None else segment.end - segment.start
    count = max(int(np.ceil(duration / TIME_STEP)), MIN_STEPS)
    time = segment.start + np.linspace(0.0, duration, count + 1)
    local = time - segment.start
    if segment.profile is None:
        velocity = fourier.at(local, 1)
        max_acceleration = np.abs(fourier.at(local, 2)).max(axis=0)
        max_acceleration = max_acceleration * oversampling_bound(count, fourier.harmonics)
    else:
        velocity = segment.profile.at(local, 1)
        max_acceleration = segment.profile.max_acceleration(duration)

    def poses(times: FloatArray) -> FloatArray:
        part = fourier if segment.profile is None else segment.profile
        return part.at(times - segment.start)

    highest = np.maximum(np.abs(velocity[:-1]), np.abs(velocity[1:]))
    speed = highest + 0.5 * (duration / count) * max_acceleration
    robot, q = cell.robot, poses(time)
    lever_arms = _lever_arms(cell, np.abs(robot.expand(q)).max(axis=0))
    approach = speed @ np.abs(robot.spread).T @ lever_arms.T * np.diff(time)[:, None]
    return SampledPath(time, q, approach, poses)


def approach_speeds(cell: Cell, q: FloatArray, dq: FloatArray) -> FloatArray:
    """Bound the speed at which each pair of bodies approaches at single poses.

    Seen from one of the bodies, each point of the other moves at most at |u| + |ω| ρ, with the
    relative velocity u of the centre of a ball of radius ρ around it and the relative angular
    velocity ω. The lesser bound of both bodies counts.

    Args:
        cell: The cell.
        q: Poses. Shape (N, n).
        dq: Their rates. Shape (N, n).

    Returns:
        Speeds. Shape (N, pairs) [m/s].
    """
    tree = KinematicTree.from_robot(cell.robot)
    R, p = tree.poses(q)
    rates = np.hstack([np.zeros((len(q), 1)), dq @ tree.spread.T])
    twists = tree.support @ (tree.joint_twists(R, p) * rates[:, :, None])
    out = np.empty((len(q), len(cell.pairs)))
    balls = [_bounding_ball(body) for body in cell.bodies]
    for number, pair in enumerate(cell.pairs):
        bounds = []
        joints = [cell.bodies[i].joint for i in (pair.first, pair.second)]
        relative = twists[:, joints[0]] - twists[:, joints[1]]
        turn = np.linalg.norm(relative[:, :3], axis=1)
        for joint, (centre, radius) in zip(
            joints, (balls[pair.first], balls[pair.second]), strict=True
        ):
            if np.isfinite(radius):
                at = R[:, joint] @ centre + p[:, joint]
                u = relative[:, 3:] + np.cross(relative[:, :3], at)
                bounds.append(np.linalg.norm(u, axis=1) + radius * turn)
        out[:, number] = np.minimum.reduce(bounds)
    return out


def find_near_pairs(cell: Cell, q: FloatArray) -> list[int]:
    """Return the indices of the pairs that violate their margin at one of some poses.

    Args:
        cell: The cell.
        q: Poses. Shape (N, n).
    """
    R, p = KinematicTree.from_robot(cell.robot).poses(q)
    balls = [_bounding_ball(body) for body in cell.bodies]
    joints = [body.joint for body in cell.bodies]
    centres = np.stack(
        [R[:, j] @ centre + p[:, j] for j, (centre, _) in zip(joints, balls, strict=True)], axis=1
    )
    radii = np.array([radius for _, radius in balls])
    first, second = np.array([(pair.first, pair.second) for pair in cell.pairs]).T
    gap = np.linalg.norm(centres[:, first] - centres[:, second], axis=2)
    is_near = gap - radii[first] - radii[second] < np.array([pair.margin for pair in cell.pairs])
    query, near = cell.distance_query(), set[int]()
    for pose, candidates in zip(q, is_near, strict=True):
        query.set_configuration(pose)
        for pair in set(np.flatnonzero(candidates).tolist()) - near:
            if query.distance(pair) < cell.pairs[pair].margin:
                near.add(pair)
    return sorted(near)


def _bounding_ball(body: Body) -> tuple[FloatArray, float]:
    """Return centre, in the joint's frame, and radius of a ball around a body [m].

    The radius is infinite for a half space.
    """
    if any(shape.kind is ShapeKind.FLOOR for shape in body.shapes):
        return np.zeros(3), np.inf
    centres, radii = [], []
    for solid, placement in zip(body.solids, body.placements, strict=True):
        solid.computeLocalAABB()
        centres.append(placement.act(np.array(solid.aabb_center)))
        radii.append(float(solid.aabb_radius))
    middle = np.mean(centres, axis=0)
    return middle, float(np.max(np.linalg.norm(centres - middle, axis=1) + radii))


def _lever_arms(cell: Cell, max_position: FloatArray) -> FloatArray:
    """Upper bounds of the speed at which a pair approaches per unit speed of each model joint.

    Args:
        cell: The cell.
        max_position: Largest |position| of each model joint. Shape (nv,) [rad or m].

    Returns:
        Bounds. Shape (P, nv) [m/rad or 1].
    """
    model = cell.robot.model
    axes = cell.robot.axes()
    length = [0.0] * model.njoints
    for i in range(1, model.njoints):
        sliding = float(np.linalg.norm(axes[i - 1][:3]))
        length[i] = (
            float(np.linalg.norm(model.jointPlacements[i].translation))
            + sliding * max_position[i - 1]
        )
    out = np.zeros((len(cell.pairs), model.nv))
    for row, pair in enumerate(cell.pairs):
        first, second = cell.bodies[pair.first], cell.bodies[pair.second]
        first_chain, second_chain = (
            list(model.supports[body.joint])[1:] for body in (first, second)
        )
        for body, chain, other_chain in (
            (first, first_chain, second_chain),
            (second, second_chain, first_chain),
        ):
            radius = _bounding_radius(body)
            for joint in reversed([j for j in chain if j not in other_chain]):
                axis = axes[joint - 1]
                out[row, joint - 1] = np.linalg.norm(axis[3:]) * radius + np.linalg.norm(axis[:3])
                radius += length[joint]
    return out


def _bounding_radius(body: Body) -> float:
    """Upper bound of the distance of a body's points from its joint's origin [m]."""
    out = 0.0
    for shape, solid, placement in zip(body.shapes, body.solids, body.placements, strict=True):
        if shape.kind is not ShapeKind.FLOOR:
            solid.computeLocalAABB()
            centre_distance = float(np.linalg.norm(placement.act(np.array(solid.aabb_center))))
            out = max(out, centre_distance + float(solid.aabb_radius))
    return out


def find_contained_pair(cell: Cell, q: FloatArray) -> BodyPair | None:
    """Find a pair of which one body is inside the closed mesh of the other.

    The distance to the mesh's surface does not show that.

    Args:
        cell: The cell.
        q: Pose. Shape (n,) [rad or m].
    """
    robot, data = cell.robot, cell.robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.expand(q))
    for pair in cell.pairs:
        bodies = cell.bodies[pair.first], cell.bodies[pair.second]
        for outer, inner in (bodies, bodies[::-1]):
            point = data.oMi[inner.joint].act(inner.placements[0].act(_point_of(inner)))
            for shape, placement in zip(outer.shapes, outer.placements, strict=True):
                if shape.kind is not ShapeKind.MESH or inner.shapes[0].kind is ShapeKind.FLOOR:
                    continue
                local = (data.oMi[outer.joint] * placement).actInv(point)
                if _encloses_origin(shape.triangles() - local):
                    return pair
    return None


def _point_of(body: Body) -> FloatArray:
    """A point of a body in the frame of its first shape. Shape (3,) [m]."""
    shape = body.shapes[0]
    is_mesh = shape.kind is ShapeKind.MESH
    return np.asarray(shape.triangles()[0, 0]) if is_mesh else np.zeros(3)


def _encloses_origin(triangles: FloatArray) -> bool:
    """Return True if a closed surface encloses the origin, by the parity of ray crossings.

    Rays from the origin cross it an odd number of times; the majority of RAYS decides.

    Args:
        triangles: Vertices of the triangles. Shape (m, 3, 3) [m].
    """
    a = triangles[:, 0]
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    votes = 0
    for ray in RAYS:
        # Möller & Trumbore, J. Graphics Tools 2(1), 1997
        p = np.cross(ray, second)
        determinant = np.einsum("mi,mi->m", first, p)
        divisor = np.where(np.abs(determinant) < MIN_VOLUME, MIN_VOLUME, determinant)
        u = -np.einsum("mi,mi->m", a, p) / divisor
        q = np.cross(-a, first)
        v, distance = q @ ray / divisor, np.einsum("mi,mi->m", second, q) / divisor
        hits = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0)
        votes += int(np.sum(hits)) % 2
    return 2 * votes > len(RAYS)
