"""Distances of meshes, found fast where a pair is evaluated at a sequence of similar poses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import coal

from .._types import FloatArray

ROUNDING = 1e-7
"""Distance that is added to an upper bound [m], above the rounding errors of the transforms."""


class MeshDistance:
    """Distances of exact shapes; a query of meshes begins with an upper bound from the one before.

    The distance of the two points that were nearest at the previous pose is an upper bound at the
    next one. With it the traversal of the bounding volumes skips most of their pairs (at 100 poses
    of a motion by a factor of 1.5 to 4 for meshes of 250 to 5500 triangles), and finds the same
    distance.
    """

    def __init__(self, solids: Sequence[coal.CollisionGeometry]) -> None:
        """Store the shapes that the indices of `nearest` refer to."""
        self._solids = solids
        self._is_mesh = [isinstance(solid, coal.BVHModelBase) for solid in solids]
        self._request = coal.DistanceRequest()
        self._points: dict[tuple[int, int], tuple[FloatArray, FloatArray]] = {}

    def nearest(
        self,
        pair: tuple[int, int],
        first: coal.Transform3s,
        second: coal.Transform3s,
        result: coal.DistanceResult,
        resolved: float = math.inf,
    ) -> float:
        """Find the distance and the nearest points of two shapes.

        Args:
            pair: Indices of the shapes.
            first: Pose of the first shape.
            second: Pose of the second shape.
            result: Result that is overwritten; its points are not numbers beyond `resolved`.
            resolved: Distance up to which the distance of meshes is needed [m].

        Returns:
            Distance, not positive for shapes in contact; `resolved` where it is larger [m].
        """
        solids = self._solids[pair[0]], self._solids[pair[1]]
        result.clear()
        if not (self._is_mesh[pair[0]] or self._is_mesh[pair[1]]):
            return float(coal.distance(solids[0], first, solids[1], second, self._request, result))
        bound, points = resolved, self._points.get(pair)
        if points is not None:
            ends = first.transform(points[0]), second.transform(points[1])
            bound = min(bound, math.dist(*ends) + ROUNDING)
        if bound < math.inf:
            result.min_distance = bound
        distance = coal.distance(solids[0], first, solids[1], second, self._request, result)
        nearest = result.getNearestPoint1(), result.getNearestPoint2()
        if math.isnan(nearest[0][0]):  # nothing was below the bound
            if bound == resolved:
                return resolved
            result.clear()
            distance = coal.distance(solids[0], first, solids[1], second, self._request, result)
            nearest = result.getNearestPoint1(), result.getNearestPoint2()
        if distance > 0.0 and not math.isnan(nearest[0][0]):
            self._points[pair] = (
                first.inverse().transform(nearest[0]),
                second.inverse().transform(nearest[1]),
            )
        return float(distance)
