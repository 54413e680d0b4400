"""The certificate's own check: least distances along a whole motion, between the moments looked at
too.

While bodies a and b move, their distance falls no faster than Σ |q̇_k| ρ_k over the joints k
between them, ρ_k the furthest that a point of what k moves can be from k's axis. So from a distance
d nothing comes nearer than l before the integral of that speed has reached d − l: one looks again
only then (conservative advancement; Mirtich & Canny 1995).
"""

from __future__ import annotations

import dataclasses
import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import UnusableInput
from ..trajectory.fourier import oversampling_bound
from ..trajectory.rest_to_rest import Motion, MotionSegment
from .distance_query import Body, Pair, Probe
from .geometry import Kind
from .workcell import Cell

Array = np.ndarray
STEP = 1e-3
"""Grid of the check [s]; where it does not decide, the step is divided."""
TOLERANCE = 5e-4
SHARE = 0.02
"""How far what is proven may stay behind what was found [m], and as a share of it."""
AMPLE = 0.02
"""Beyond the margin by this much [m], nobody asks how far."""
DIVIDED = 32
RAYS = np.array([[0.8141, 0.3927, 0.4273], [-0.2718, 0.9113, -0.3091], [0.1414, -0.5772, 0.8043]])
"""Directions that no mesh is likely to have an edge along."""


@dataclass(frozen=True)
class Near:
    """How near the two bodies of a pair come. found: least distance seen [m], at `time` [s] and
    `pose`; proven: never less [m]."""

    pair: Pair
    names: str
    found: float
    proven: float
    time: float
    pose: Array

    def document(self, joints: Sequence[str]) -> dict[str, Any]:
        """As a trajectory states it."""
        return {
            "pair": self.names,
            "least": self.found,
            "proven": self.proven,
            "margin": self.pair.margin,
            "time": self.time,
            "pose": dict(zip(joints, self.pose.tolist(), strict=True)),
        }


def along(cell: Cell, motion: Motion) -> list[Near]:
    """Least distance of every pair over a motion, the one nearest to its margin first."""
    best, probe = dict[int, Near](), cell.probe()
    for segment in motion.segments:
        for index, near in _segment(cell, probe, motion, segment):
            held = best.get(index, near)
            nearer = near if near.found < held.found else held
            best[index] = dataclasses.replace(nearer, proven=min(near.proven, held.proven))
    inside = contained(cell, motion.at(np.zeros(1))[0])
    if inside is not None:
        raise UnusableInput(
            f"{cell.names(inside)}: one is inside the other's mesh; the motion cannot begin there"
        )
    return sorted(best.values(), key=lambda near: near.proven - near.pair.margin)


@dataclass(frozen=True)
class _Grid:
    """Configurations of a segment at equal steps. speed: bound of |q̇| over each step. Shapes (N,
    n), (N − 1, n)."""

    time: Array
    q: Array
    speed: Array


def _segment(
    cell: Cell, probe: Probe, motion: Motion, segment: MotionSegment
) -> Iterator[tuple[int, Near]]:
    grid, robot = _grid(motion, segment), cell.robot
    reach = _reach(cell, np.abs(robot.expand(grid.q)).max(axis=0))
    speeds = grid.speed @ np.abs(robot.spread).T
    # how far each pair may have moved since the segment began
    way = np.vstack(
        [
            np.zeros(len(cell.pairs)),
            np.cumsum(speeds @ reach.T * np.diff(grid.time)[:, None], axis=0),
        ]
    )
    last = len(grid.time) - 1
    found, proven = np.full(len(cell.pairs), np.inf), np.full(len(cell.pairs), np.inf)
    where = np.zeros(len(cell.pairs), int)
    before = [(0, np.inf)] * len(cell.pairs)
    queue = [(0, k) for k in range(len(cell.pairs))]
    now = -1
    while queue:
        index, k = heapq.heappop(queue)
        if index != now:
            probe.to(grid.q[index])
            now = index
        distance = probe.distance(k)
        if distance < found[k]:
            found[k], where[k] = distance, index
        level = min(found[k] - max(TOLERANCE, SHARE * abs(found[k])), cell.pairs[k].margin + AMPLE)
        start, ahead = before[k]
        if index > 0:
            between = 0.5 * (ahead + distance - (way[index, k] - way[start, k]))
            if between < level and index == start + 1 and distance > 0.0:
                step, poses = (
                    way[index, k] - way[start, k],
                    _parts(motion, segment, grid.time[start : index + 1], level, between),
                )
                between = max(between, _divided(probe, k, poses, step))
                now = -1
            proven[k] = min(proven[k], between)
        proven[k] = min(proven[k], distance)
        before[k] = (index, distance)
        if index < last:
            safe = (
                int(np.searchsorted(way[:, k], way[index, k] + distance - level, side="right")) - 1
            )
            heapq.heappush(queue, (min(max(safe, index + 1), last), k))
    for k, pair in enumerate(cell.pairs):
        yield (
            k,
            Near(
                pair,
                cell.names(pair),
                float(found[k]),
                float(proven[k]),
                float(grid.time[where[k]]),
                grid.q[where[k]],
            ),
        )


def _divided(probe: Probe, pair: int, poses: Array, way: float) -> float:
    """A bound within one step of the grid, from distances at its parts."""
    d = np.empty(len(poses))
    for i, q in enumerate(poses):
        probe.to(q)
        d[i] = probe.distance(pair)
    return float((0.5 * (d[:-1] + d[1:] - way / (len(poses) - 1))).min())


def _parts(
    motion: Motion, segment: MotionSegment, ends: Array, level: float, bound: float
) -> Array:
    """Poses within a step, as many as its bound falls short of the level in tolerances."""
    count = int(np.clip(2.0 + (level - bound) / TOLERANCE, 2, DIVIDED))
    return _poses(motion, segment, np.linspace(ends[0], ends[-1], count + 1))


def _poses(motion: Motion, segment: MotionSegment, times: Array) -> Array:
    local = times - segment.start
    return motion.fourier.at(local) if segment.profile is None else segment.profile.at(local)


def _grid(motion: Motion, segment: MotionSegment) -> _Grid:
    """One period of the Fourier part stands for all."""
    fourier = motion.fourier
    length = fourier.period if segment.profile is None else segment.end - segment.start
    count = max(int(np.ceil(length / STEP)), 8)
    time = segment.start + np.linspace(0.0, length, count + 1)
    if segment.profile is None:
        speed, steepest = (
            fourier.at(time - segment.start, 1),
            np.abs(fourier.at(time - segment.start, 2)).max(axis=0),
        )
        steepest = steepest * oversampling_bound(count, fourier.harmonics)
    else:
        speed = segment.profile.at(time - segment.start, 1)
        # linear between knots: extreme at them
        steepest = np.abs(segment.profile.at(segment.profile.knots(), 2)).max(axis=0)
    highest = np.maximum(np.abs(speed[:-1]), np.abs(speed[1:])) + 0.5 * (length / count) * steepest
    return _Grid(time, _poses(motion, segment, time), highest)


def _reach(cell: Cell, most: Array) -> Array:
    """Speed of a pair's approach per speed of each of the model's joints, at most. most: |q| of
    those. Shape (P, nv)."""
    model = cell.robot.model
    axes = cell.robot.axes()
    length = [0.0] * model.njoints
    for i in range(1, model.njoints):
        sliding = float(np.linalg.norm(axes[i - 1][:3]))
        length[i] = (
            float(np.linalg.norm(model.jointPlacements[i].translation)) + sliding * most[i - 1]
        )
    out = np.zeros((len(cell.pairs), model.nv))
    for row, pair in enumerate(cell.pairs):
        both = cell.bodies[pair.first], cell.bodies[pair.second]
        ways = [list(model.supports[body.joint])[1:] for body in both]
        for body, mine, other in ((both[0], ways[0], ways[1]), (both[1], ways[1], ways[0])):
            radius = _radius(body)
            for joint in reversed([j for j in mine if j not in other]):
                axis = axes[joint - 1]
                out[row, joint - 1] = np.linalg.norm(axis[3:]) * radius + np.linalg.norm(axis[:3])
                radius += length[joint]
    return out


def _radius(body: Body) -> float:
    """The furthest that a point of a body is from its joint's origin."""
    out = 0.0
    for one, solid, placement in zip(body.shapes, body.solids, body.placements, strict=True):
        if one.kind is not Kind.FLOOR:
            solid.computeLocalAABB()
            out = max(
                out,
                float(np.linalg.norm(placement.act(np.array(solid.aabb_center))))
                + float(solid.aabb_radius),
            )
    return out


def contained(cell: Cell, q: Array) -> Pair | None:
    """A pair of which one body lies inside the other's closed mesh, where distances to its surface
    say nothing. Shape (n,)."""
    robot, data = cell.robot, cell.robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.expand(q))
    for pair in cell.pairs:
        both = cell.bodies[pair.first], cell.bodies[pair.second]
        for outer, inner in (both, both[::-1]):
            point = data.oMi[inner.joint].act(inner.placements[0].act(_point(inner)))
            for one, placement in zip(outer.shapes, outer.placements, strict=True):
                if one.kind is not Kind.MESH or inner.shapes[0].kind is Kind.FLOOR:
                    continue
                if _encloses(one.triangles() - (data.oMi[outer.joint] * placement).actInv(point)):
                    return pair
    return None


def _point(body: Body) -> Array:
    one = body.shapes[0]
    return np.asarray(one.triangles()[0, 0]) if one.kind is Kind.MESH else np.zeros(3)


def _encloses(triangles: Array) -> bool:
    """Whether a closed surface goes round the origin: rays out of it pass it an odd number of
    times. Shape (m, 3, 3)."""
    a, first, second = (
        triangles[:, 0],
        triangles[:, 1] - triangles[:, 0],
        triangles[:, 2] - triangles[:, 0],
    )
    votes = 0
    for ray in RAYS:
        across = np.cross(ray, second)
        volume = np.einsum("mi,mi->m", first, across)
        safe = np.where(np.abs(volume) < 1e-300, 1e-300, volume)
        u = -np.einsum("mi,mi->m", a, across) / safe
        beside = np.cross(-a, first)
        v, way = beside @ ray / safe, np.einsum("mi,mi->m", second, beside) / safe
        votes += int(np.sum((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (way > 0.0))) % 2
    return 2 * votes > len(RAYS)
