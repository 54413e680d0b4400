"""Signed distances of line segments to segments, boxes and planes, many pairs at once.

Each function returns, for each pair, the signed distance, the unit direction in which it grows when
the first body moves, and the nearest points. Where the distance is differentiable, its derivative
is the component of the relative motion of the nearest points along that direction (Danskin 1967).
Segments: Ericson, Real-Time Collision Detection, 2005, section 5.1.9.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import FloatArray, IntArray

EPSILON = 1e-12
"""Length, or squared length, below which a divisor counts as zero [m, m²]."""
PARALLEL_TOLERANCE = 1e-9
"""Squared sine of the angle below which two segments count as parallel [1]."""


@dataclass(frozen=True)
class NearestPoints:
    """Distances of m pairs of bodies with their nearest points, in the base frame.

    Attributes:
        distance: Signed distances. Shape (m,) [m].
        direction: Unit vectors along which the distance grows with the first body. Shape (m, 3).
        first: Nearest points of the first bodies. Shape (m, 3) [m].
        second: Nearest points of the second bodies. Shape (m, 3) [m].
    """

    distance: FloatArray
    direction: FloatArray
    first: FloatArray
    second: FloatArray

    def table(self) -> FloatArray:
        """Return all columns side by side; inverse of `from_table`. Shape (m, 10)."""
        return np.column_stack([self.distance, self.direction, self.first, self.second])

    @staticmethod
    def from_table(table: FloatArray) -> NearestPoints:
        """Return the nearest points of a table. Shape (m, 10)."""
        return NearestPoints(table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7:])


def segment_to_segment(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> NearestPoints:
    """Nearest points of segments a–b and c–d. Shapes (m, 3) each [m]."""
    first, second, offset = b - a, d - c, a - c
    aa = np.maximum(_dot(first, first), EPSILON)
    cc = np.maximum(_dot(second, second), EPSILON)
    ac, ax, cx = _dot(first, second), _dot(first, offset), _dot(second, offset)
    determinant = aa * cc - ac * ac
    parallel = determinant <= PARALLEL_TOLERANCE * aa * cc
    s = np.where(
        parallel,
        0.5,
        np.clip((ac * cx - ax * cc) / np.where(parallel, 1.0, determinant), 0.0, 1.0),
    )
    t = np.clip((ac * s + cx) / cc, 0.0, 1.0)
    s = np.clip((ac * t - ax) / aa, 0.0, 1.0)
    return _between(a + s[:, None] * first, c + t[:, None] * second)


def segment_to_box(
    a: FloatArray,
    b: FloatArray,
    rotation: FloatArray,
    centre: FloatArray,
    half_size: FloatArray,
) -> NearestPoints:
    """Nearest points of segments a–b and boxes.

    The squared distance to a box is convex and piecewise quadratic along a segment: its slope has
    its zero between two neighbouring points at which the segment crosses the plane of a face. A
    segment inside the box has the negative depth under the nearest face as its distance.

    Args:
        a: Starts of the segments. Shape (m, 3) [m].
        b: Ends of the segments. Shape (m, 3) [m].
        rotation: Orientations of the boxes in the base frame. Shape (m, 3, 3).
        centre: Centres of the boxes. Shape (m, 3) [m].
        half_size: Half of the boxes' edge lengths. Shape (m, 3) [m].
    """
    start = np.einsum("mji,mj->mi", rotation, a - centre)
    along = np.einsum("mji,mj->mi", rotation, b - a)
    divisor = np.where(np.abs(along) < EPSILON, EPSILON, along)
    ends = np.broadcast_to([0.0, 1.0], (len(a), 2))
    crossings = [ends, (half_size - start) / divisor, (-half_size - start) / divisor]
    t = np.sort(np.clip(np.concatenate(crossings, axis=1), 0.0, 1.0), axis=1)
    x = start[:, None] + t[:, :, None] * along[:, None]
    slope = _dot(x - np.clip(x, -half_size[:, None], half_size[:, None]), along[:, None])
    rows = np.arange(len(a))
    first, last = _zero_interval(t, slope, rows)
    on_segment = start + 0.5 * (first + last)[:, None] * along
    on_box = np.clip(on_segment, -half_size, half_size)
    depth = half_size - np.abs(on_segment)
    face = np.argmin(depth, axis=1)
    inside = (depth > 0.0).all(axis=1)
    outward = np.zeros_like(on_segment)
    outward[rows, face] = np.where(on_segment[rows, face] < 0.0, -1.0, 1.0)
    outside = _between(on_segment, on_box)
    direction = np.where(inside[:, None], outward, outside.direction)
    distance = np.where(inside, -depth[rows, face], outside.distance)

    def in_base_frame(vectors: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("mij,mj->mi", rotation, vectors))

    return NearestPoints(
        distance,
        in_base_frame(direction),
        in_base_frame(on_segment) + centre,
        in_base_frame(on_box) + centre,
    )


def segment_to_plane(
    a: FloatArray, b: FloatArray, normal: FloatArray, height: FloatArray
) -> NearestPoints:
    """Nearest points of segments a–b and the half spaces below planes normal · x = height.

    Args:
        a: Starts of the segments. Shape (m, 3) [m].
        b: Ends of the segments. Shape (m, 3) [m].
        normal: Unit normals of the planes. Shape (m, 3).
        height: Offsets of the planes. Shape (m,) [m].
    """
    heights = _dot(a, normal) - height, _dot(b, normal) - height
    lower = heights[0] <= heights[1]
    point = np.where(lower[:, None], a, b)
    distance = np.minimum(*heights)
    return NearestPoints(distance, normal, point, point - distance[:, None] * normal)


def _zero_interval(
    t: FloatArray, slope: FloatArray, rows: IntArray
) -> tuple[FloatArray, FloatArray]:
    """First and last zero of non-decreasing piecewise linear functions on their knots `t`.

    The end with the smaller magnitude where a function has no zero.
    """
    below, above = (slope < -EPSILON).sum(axis=1), (slope <= EPSILON).sum(axis=1)
    last = t.shape[1] - 1

    def crossing(count: IntArray) -> FloatArray:
        low, high = np.clip(count - 1, 0, last), np.clip(count, 0, last)
        f, g = slope[rows, low], slope[rows, high]
        fraction = np.where((g > f) & (f < 0.0) & (g > 0.0), -f / np.where(g > f, g - f, 1.0), 0.0)
        return np.asarray(t[rows, low] + fraction * (t[rows, high] - t[rows, low]))

    first = np.where(
        below > last,
        t[:, -1],
        np.where(below < above, t[rows, np.clip(below, 0, last)], crossing(below)),
    )
    final = np.where(below < above, t[rows, np.clip(above - 1, 0, last)], first)
    return first, final


def _between(first: FloatArray, second: FloatArray) -> NearestPoints:
    offset = first - second
    distance = np.linalg.norm(offset, axis=1)
    direction = offset / np.maximum(distance, EPSILON)[:, None]
    return NearestPoints(distance, direction, first, second)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.sum(a * b, axis=-1))
