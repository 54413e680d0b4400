"""Least distances along a motion by brute force: every pair of bodies at every step, with coal.

It shares the shapes and placements of bodies with excite, but not the search for the times of
least distance.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from excite._types import FloatArray
from excite.collision.distance_query import Body
from excite.collision.geometry import ShapeKind
from excite.collision.workcell import Cell
from excite.trajectory.rest_to_rest import Motion

HULL_CLEARANCE = 0.01
"""Clearance beyond the margin above which a mesh may be replaced by its convex hull [m]."""


@dataclass(frozen=True)
class PairDistance:
    """The least distance of two bodies along a motion.

    Attributes:
        names: Names of both bodies.
        distance: Least distance [m].
        time: Time of it [s].
        margin: Distance to keep [m].
    """

    names: str
    distance: float
    time: float
    margin: float

    @property
    def room(self) -> float:
        """Distance beyond the margin [m]."""
        return self.distance - self.margin

    def words(self) -> str:
        """Return a description."""
        distance = f"{1e3 * self.distance:.1f} of {1e3 * self.margin:.0f} mm"
        return f"{distance}, {self.names} at {self.time:.2f} s"


class DistanceJudge:
    """Distances of all pairs of bodies that can move relative to each other.

    Pairs that the cell leaves out by their distances are included.
    """

    def __init__(self, cell: Cell) -> None:
        self.robot, bodies = cell.robot, cell.bodies
        known = {(pair.first, pair.second): pair.margin for pair in cell.pairs}
        left_out = {
            (pair.first, pair.second)
            for pair in cell.excepted
            if pair.why.startswith(("always", "allowed", "joined"))
        }
        self.names, self.margins, shapes, owners = (
            list[str](),
            list[float](),
            list[tuple[int, int]](),
            list[int](),
        )
        starts = np.cumsum([0, *(len(body.shapes) for body in bodies)]).tolist()
        for i, j in itertools.combinations(range(len(bodies)), 2):
            a, b = bodies[i], bodies[j]
            if a.joint == b.joint or (a.name, b.name) in left_out:
                continue
            combinations = list(
                itertools.product(range(starts[i], starts[i + 1]), range(starts[j], starts[j + 1]))
            )
            owners += [len(self.names)] * len(combinations)
            shapes += combinations
            self.names.append(f"{a.name} – {b.name}")
            # pairs that the cell excepts must not touch
            self.margins.append(known.get((i, j), 0.0))
        self.owner = np.array(owners)
        kinds = [shape.kind for body in bodies for shape in body.shapes]
        self.is_mesh = np.array(
            [ShapeKind.MESH in (kinds[first], kinds[second]) for first, second in shapes]
        )
        self.near = np.array(self.margins)[self.owner] + HULL_CLEARANCE
        self.hulls, self.exact = (_geometry(bodies, shapes, exact) for exact in (False, True))

    def at(self, q: FloatArray, data: pin.Data, best: FloatArray) -> FloatArray:
        """Return the distances of all pairs at a pose, shape (P,).

        Meshes are exact near the margin or below the best distance so far, else their hulls.
        """
        (hulls, placed), (exact, meshes) = self.hulls, self.exact
        pin.computeDistances(self.robot.model, data, hulls, placed, self.robot.expand(q))
        distances = np.array([result.min_distance for result in placed.distanceResults])
        doubtful = np.flatnonzero(
            self.is_mesh & ((distances < self.near) | (distances < best[self.owner]))
        )
        if len(doubtful):
            pin.updateGeometryPlacements(self.robot.model, data, exact, meshes)
            for k in doubtful.tolist():
                distances[k] = pin.computeDistance(exact, meshes, k).min_distance
        out = np.full(len(self.names), np.inf)
        np.minimum.at(out, self.owner, distances)
        return out

    def along(self, motion: Motion, step: float) -> list[PairDistance]:
        """Return the least distance of every pair over a motion, the least clearance first."""
        grid = np.append(np.arange(0.0, motion.duration, step), motion.duration)
        best, times_of_best = np.full(len(self.names), np.inf), np.zeros(len(self.names))
        data = self.robot.model.createData()
        for time, q in zip(grid, motion.at(grid), strict=True):
            distances = self.at(q, data, best)
            times_of_best, best = (
                np.where(distances < best, time, times_of_best),
                np.minimum(distances, best),
            )
        pairs = [
            PairDistance(*entry)
            for entry in zip(
                self.names, best.tolist(), times_of_best.tolist(), self.margins, strict=True
            )
        ]
        return sorted(pairs, key=lambda entry: entry.room)


def _geometry(
    bodies: Sequence[Body], pairs: Sequence[tuple[int, int]], exact: bool
) -> tuple[pin.GeometryModel, pin.GeometryData]:
    """Build Pinocchio's geometry of pairs of shapes, exact or as hulls."""
    model = pin.GeometryModel()
    for body in bodies:
        for number, (shape, placement) in enumerate(zip(body.shapes, body.placements, strict=True)):
            model.addGeometryObject(
                pin.GeometryObject(
                    f"{body.name}/{number}",
                    body.joint,
                    placement,
                    shape.solid() if exact else shape.hull(),
                )
            )
    for pair in pairs:
        model.addCollisionPair(pin.CollisionPair(*pair))
    return model, model.createData()
