"""Least distances along a motion by brute force: every pair of bodies on different links at every step, with coal.

It shares the bodies' shapes and places with excite and nothing of its search for the nearest moments.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from excite.collision.distance_query import Body
from excite.collision.geometry import Kind
from excite.collision.workcell import Cell
from excite.trajectory.rest_to_rest import Motion

Array = np.ndarray
CLEARLY = 0.01
"""Hulls stand for meshes that are further beyond the margin than this [m]."""


@dataclass(frozen=True)
class Least:
    """The least distance of two bodies [m], when [s], and what they should keep [m]."""

    names: str
    distance: float
    time: float
    margin: float

    @property
    def room(self) -> float:
        return self.distance - self.margin

    def words(self) -> str:
        return f"{1e3 * self.distance:.1f} of {1e3 * self.margin:.0f} mm, {self.names} at {self.time:.2f} s"


class Judge:
    """Brute force over all pairs of bodies that move against each other, the ones that the cell leaves out too."""

    def __init__(self, cell: Cell) -> None:
        self.robot, bodies = cell.robot, cell.bodies
        known = {(pair.first, pair.second): pair.margin for pair in cell.pairs}
        meant = {frozenset(pair) for pair in cell.disabled}
        meant |= {
            frozenset((one.first, one.second))
            for one in cell.excepted
            if one.why.startswith("always")
        }
        parents = list(cell.robot.model.parents)
        self.names, self.margins, shapes, owner = (
            list[str](),
            list[float](),
            list[tuple[int, int]](),
            list[int](),
        )
        starts = np.cumsum([0, *(len(body.shapes) for body in bodies)]).tolist()
        for i, j in itertools.combinations(range(len(bodies)), 2):
            a, b = bodies[i], bodies[j]
            hinged = (parents[a.joint] == b.joint or parents[b.joint] == a.joint) and not (
                a.around or b.around
            )
            if a.joint == b.joint or hinged or frozenset((a.name, b.name)) in meant:
                continue
            both = list(
                itertools.product(range(starts[i], starts[i + 1]), range(starts[j], starts[j + 1]))
            )
            owner += [len(self.names)] * len(both)
            shapes += both
            self.names.append(f"{a.name} – {b.name}")
            self.margins.append(
                known.get((i, j), 0.0)
            )  # what is said never to touch should not touch
        self.owner = np.array(owner)
        kinds = [one.kind for body in bodies for one in body.shapes]
        self.is_mesh = np.array(
            [Kind.MESH in (kinds[first], kinds[second]) for first, second in shapes]
        )
        self.near = np.array(self.margins)[self.owner] + CLEARLY
        self.hulls, self.exact = (_geometry(bodies, shapes, exact) for exact in (False, True))

    def at(self, q: Array, data: pin.Data, best: Array) -> Array:
        """Distances of all pairs at one pose, exact where they are near their margin or less than the best so far. Shape (P,)."""
        (hulls, placed), (exact, meshes) = self.hulls, self.exact
        pin.computeDistances(self.robot.model, data, hulls, placed, self.robot.expand(q))
        found = np.array([one.min_distance for one in placed.distanceResults])
        doubtful = np.flatnonzero(self.is_mesh & ((found < self.near) | (found < best[self.owner])))
        if len(doubtful):
            pin.updateGeometryPlacements(self.robot.model, data, exact, meshes)
            for k in doubtful.tolist():
                found[k] = pin.computeDistance(exact, meshes, k).min_distance
        out = np.full(len(self.names), np.inf)
        np.minimum.at(out, self.owner, found)
        return out

    def along(self, motion: Motion, step: float) -> list[Least]:
        """Least distance of every pair over the whole motion, the one with least room first."""
        times = np.append(np.arange(0.0, motion.duration, step), motion.duration)
        best, when = np.full(len(self.names), np.inf), np.zeros(len(self.names))
        data = self.robot.model.createData()
        for moment, q in zip(times, motion.at(times), strict=True):
            found = self.at(q, data, best)
            when, best = np.where(found < best, moment, when), np.minimum(found, best)
        whole = [
            Least(*one)
            for one in zip(self.names, best.tolist(), when.tolist(), self.margins, strict=True)
        ]
        return sorted(whole, key=lambda one: one.room)


def _geometry(
    bodies: Sequence[Body], pairs: Sequence[tuple[int, int]], exact: bool
) -> tuple[pin.GeometryModel, pin.GeometryData]:
    model = pin.GeometryModel()
    for body in bodies:
        for number, (one, placement) in enumerate(zip(body.shapes, body.placements, strict=True)):
            model.addGeometryObject(
                pin.GeometryObject(
                    f"{body.name}/{number}",
                    body.joint,
                    placement,
                    one.solid() if exact else one.hull(),
                )
            )
    for pair in pairs:
        model.addCollisionPair(pin.CollisionPair(*pair))
    return model, model.createData()
