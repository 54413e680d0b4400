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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..errors import UnusableInput
from ..trajectory.fourier import oversampling_bound
from ..trajectory.rest_to_rest import Motion, MotionSegment
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
"""Excess over the margin above which lower bounds are not refined [m]."""
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


def least_distances(cell: Cell, motion: Motion) -> list[PairDistance]:
    """Bound the distance of every pair along a motion.

    Returns:
        One entry for each pair, the one with the least proven excess over its margin first.

    Raises:
        UnusableInput: At the start, a body is inside the closed mesh of another.
    """
    best, query = dict[int, PairDistance](), cell.distance_query()
    for segment in motion.segments:
        for index, entry in _segment_distances(cell, query, motion, segment):
            previous = best.get(index, entry)
            nearer = entry if entry.observed < previous.observed else previous
            proven = min(entry.proven, previous.proven)
            best[index] = dataclasses.replace(nearer, proven=proven)
    contained = find_contained_pair(cell, motion.at(np.zeros(1))[0])
    if contained is not None:
        raise UnusableInput(
            f"{cell.names(contained)}: one is inside the other's mesh; the motion cannot begin "
            "there"
        )
    return sorted(best.values(), key=lambda entry: entry.proven - entry.pair.margin)


@dataclass(frozen=True)
class _Grid:
    """Configurations of a segment at equal time steps.

    Attributes:
        time: Times. Shape (N,) [s].
        q: Joint positions. Shape (N, n).
        speed: Upper bounds of |q̇| over each step. Shape (N − 1, n).
    """

    time: FloatArray
    q: FloatArray
    speed: FloatArray


def _segment_distances(
    cell: Cell, query: DistanceQuery, motion: Motion, segment: MotionSegment
) -> Iterator[tuple[int, PairDistance]]:
    """Yield the index and the least distance of every pair along a segment."""
    grid, robot = _grid(motion, segment), cell.robot
    lever_arms = _lever_arms(cell, np.abs(robot.expand(grid.q)).max(axis=0))
    speeds = grid.speed @ np.abs(robot.spread).T
    # upper bound of the distance that each pair has approached since the segment began
    steps = speeds @ lever_arms.T * np.diff(grid.time)[:, None]
    path = np.vstack([np.zeros(len(cell.pairs)), np.cumsum(steps, axis=0)])
    last = len(grid.time) - 1
    observed, proven = np.full(len(cell.pairs), np.inf), np.full(len(cell.pairs), np.inf)
    index_of_least = np.zeros(len(cell.pairs), int)
    previous = [(0, np.inf)] * len(cell.pairs)
    queue = [(0, k) for k in range(len(cell.pairs))]
    current = -1
    while queue:
        index, k = heapq.heappop(queue)
        if index != current:
            query.set_configuration(grid.q[index])
            current = index
        distance = query.distance(k)
        if distance < observed[k]:
            observed[k], index_of_least[k] = distance, index
        margin = cell.pairs[k].margin
        absolute = min(ABSOLUTE_TOLERANCE, MARGIN_TOLERANCE * margin or ABSOLUTE_TOLERANCE)
        tolerance = max(absolute, RELATIVE_TOLERANCE * abs(observed[k]))
        level = min(observed[k] - tolerance, margin + UNRESOLVED_EXCESS)
        start, distance_before = previous[k]
        if index > 0:
            step = path[index, k] - path[start, k]
            bound = 0.5 * (distance_before + distance - step)
            if bound < level and index == start + 1 and distance > 0.0:
                times = grid.time[start : index + 1]
                poses = _subdivided_step(motion, segment, times, level, bound)
                bound = max(bound, _subdivided_bound(query, k, poses, step))
                current = -1
            proven[k] = min(proven[k], bound)
        proven[k] = min(proven[k], distance)
        previous[k] = (index, distance)
        if index < last:
            reached = path[index, k] + distance - level
            safe = int(np.searchsorted(path[:, k], reached, side="right")) - 1
            heapq.heappush(queue, (min(max(safe, index + 1), last), k))
    for k, pair in enumerate(cell.pairs):
        yield (
            k,
            PairDistance(
                pair,
                cell.names(pair),
                float(observed[k]),
                float(proven[k]),
                float(grid.time[index_of_least[k]]),
                grid.q[index_of_least[k]],
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


def _subdivided_step(
    motion: Motion, segment: MotionSegment, times: FloatArray, level: float, bound: float
) -> FloatArray:
    """Poses that divide a step, the more the further its bound is below the level. Shape (m, n)."""
    count = int(np.clip(2.0 + (level - bound) / ABSOLUTE_TOLERANCE, 2, MAX_SUBDIVISIONS))
    return _poses(motion, segment, np.linspace(times[0], times[-1], count + 1))


def _poses(motion: Motion, segment: MotionSegment, times: FloatArray) -> FloatArray:
    local = times - segment.start
    return motion.fourier.at(local) if segment.profile is None else segment.profile.at(local)


def _grid(motion: Motion, segment: MotionSegment) -> _Grid:
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
    highest = np.maximum(np.abs(velocity[:-1]), np.abs(velocity[1:]))
    speed = highest + 0.5 * (duration / count) * max_acceleration
    return _Grid(time, _poses(motion, segment, time), speed)


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
