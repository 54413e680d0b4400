"""Nearest points of line segments to segments, boxes and planes, many at once, a row each.

Each returns the signed distance, the unit direction in which it grows when the first body moves,
and the nearest points on both. Where bodies part smoothly, the distance's derivative is that
direction times the points' motion (Danskin 1967). Formulas: Ericson, Real-Time Collision Detection,
2005, 5.1.9 (segments).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray
TINY = 1e-12


@dataclass(frozen=True)
class Nearest:
    """Rows of distances. distance: Shape (m,) [m]. direction, first, second: Shape (m, 3), base
    frame."""

    distance: Array
    direction: Array
    first: Array
    second: Array


def segments(a: Array, b: Array, c: Array, d: Array) -> Nearest:
    """Segments a–b and c–d. Shapes (m, 3)."""
    along, across, apart = b - a, d - c, a - c
    aa, cc = np.maximum(_dot(along, along), TINY), np.maximum(_dot(across, across), TINY)
    ac, ax, cx = _dot(along, across), _dot(along, apart), _dot(across, apart)
    spread = aa * cc - ac * ac
    parallel = spread <= 1e-9 * aa * cc
    s = np.where(
        parallel, 0.5, np.clip((ac * cx - ax * cc) / np.where(parallel, 1.0, spread), 0.0, 1.0)
    )
    t = np.clip((ac * s + cx) / cc, 0.0, 1.0)
    s = np.clip((ac * t - ax) / aa, 0.0, 1.0)
    return _between(a + s[:, None] * along, c + t[:, None] * across)


def box(a: Array, b: Array, rotation: Array, centre: Array, half: Array) -> Nearest:
    """Segments a–b and boxes. Shapes (m, 3), (m, 3), (m, 3, 3), (m, 3), (m, 3).

    The squared distance to a box is convex and piecewise quadratic along a segment: its slope's
    zero lies between two of the points where the segment passes a face's plane.
    """
    start = np.einsum("mji,mj->mi", rotation, a - centre)
    along = np.einsum("mji,mj->mi", rotation, b - a)
    safe = np.where(np.abs(along) < TINY, TINY, along)
    ends = np.broadcast_to([0.0, 1.0], (len(a), 2))
    t = np.sort(
        np.clip(
            np.concatenate([ends, (half - start) / safe, (-half - start) / safe], axis=1), 0.0, 1.0
        ),
        axis=1,
    )
    x = start[:, None] + t[:, :, None] * along[:, None]
    slope = _dot(x - np.clip(x, -half[:, None], half[:, None]), along[:, None])
    rows = np.arange(len(a))
    first, last = _zero(t, slope, rows)
    middle = start + 0.5 * (first + last)[:, None] * along
    on = np.clip(middle, -half, half)
    # inside, the way out is through the nearest face
    depth = half - np.abs(middle)
    face = np.argmin(depth, axis=1)
    inside = (depth > 0.0).all(axis=1)
    out = np.zeros_like(middle)
    out[rows, face] = np.where(middle[rows, face] < 0.0, -1.0, 1.0)
    found = _between(middle, on)
    direction = np.where(inside[:, None], out, found.direction)
    distance = np.where(inside, -depth[rows, face], found.distance)

    def back(points: Array) -> Array:
        return np.asarray(np.einsum("mij,mj->mi", rotation, points))

    return Nearest(distance, back(direction), back(middle) + centre, back(on) + centre)


def plane(a: Array, b: Array, normal: Array, height: Array) -> Nearest:
    """Segments a–b above planes normal · x = height. Shapes (m, 3), (m, 3), (m, 3), (m,)."""
    heights = _dot(a, normal) - height, _dot(b, normal) - height
    lower = heights[0] <= heights[1]
    point = np.where(lower[:, None], a, b)
    distance = np.minimum(*heights)
    return Nearest(distance, normal, point, point - distance[:, None] * normal)


def _zero(t: Array, slope: Array, rows: Array) -> tuple[Array, Array]:
    """First and last zero of non-decreasing, piecewise linear functions on [t₀, t₁]; its nearer end
    where there is none."""
    below, above = (slope < -TINY).sum(axis=1), (slope <= TINY).sum(axis=1)
    last = t.shape[1] - 1

    def crossing(count: Array) -> Array:
        low, high = np.clip(count - 1, 0, last), np.clip(count, 0, last)
        f, g = slope[rows, low], slope[rows, high]
        share = np.where((g > f) & (f < 0.0) & (g > 0.0), -f / np.where(g > f, g - f, 1.0), 0.0)
        return np.asarray(t[rows, low] + share * (t[rows, high] - t[rows, low]))

    first = np.where(
        below > last,
        t[:, -1],
        np.where(below < above, t[rows, np.clip(below, 0, last)], crossing(below)),
    )
    final = np.where(below < above, t[rows, np.clip(above - 1, 0, last)], first)
    return first, final


def _between(first: Array, second: Array) -> Nearest:
    apart = first - second
    distance = np.linalg.norm(apart, axis=1)
    return Nearest(distance, apart / np.maximum(distance, TINY)[:, None], first, second)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1))
