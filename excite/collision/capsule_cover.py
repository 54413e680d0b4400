"""Covers: capsules and boxes that enclose a shape, for the optimiser, which needs distances in
closed form."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .geometry import Kind, Shape

Array = np.ndarray
MOST = 4
"""Capsules for one shape of a link, at most."""
BOXES = 24
"""Boxes for one mesh around the robot, at most."""
WORTH = 0.85
"""Each capsule more must leave less than this share of the volume."""
DENSE, CELLS = 2000, 40
"""Meshes of more triangles than this are covered by way of a grid of so many cells a side."""
FINE = 6
"""Edges of triangles are at most this many times shorter than the surface is long, so that it can
be split."""


@dataclass(frozen=True)
class Capsule:
    """All points within `radius` of the segment from `begin` to `end`. Shapes (3,), (3,), ()
    [m]."""

    begin: Array
    end: Array
    radius: float

    @property
    def volume(self) -> float:
        length = float(np.linalg.norm(self.end - self.begin))
        return float(np.pi * self.radius**2 * (length + 4.0 / 3.0 * self.radius))

    def moved(self, rotation: Array, position: Array) -> Capsule:
        """In another frame."""
        return Capsule(
            rotation @ self.begin + position, rotation @ self.end + position, self.radius
        )


@lru_cache(maxsize=512)
def capsules(shape: Shape) -> tuple[Capsule, ...]:
    """Capsules that enclose a shape of a link, in its link's frame; spheres and capsules enclose
    themselves."""
    if shape.kind in (Kind.SPHERE, Kind.CAPSULE):
        half = np.array([0.0, 0.0, 0.5 * shape.size[1] if shape.kind is Kind.CAPSULE else 0.0])
        own = [Capsule(-half, half, shape.size[0])]
    else:
        triangles, off = _coarse(shape.triangles())
        own = [Capsule(one.begin, one.end, one.radius + off) for one in _split(triangles)]
    placement = shape.placement
    return tuple(one.moved(placement.rotation, placement.translation) for one in own)


def boxes(shape: Shape) -> list[tuple[Array, Array]]:
    """Corners (lower, upper) of boxes, along the shape's own axes, that enclose a shape around the
    robot. Shapes (3,) [m]."""
    if shape.kind is Kind.BOX:
        half = 0.5 * np.array(shape.size)
        return [(-half, half)]
    coarse, off = _coarse(shape.triangles())
    whole = [_fine(coarse)]
    parts = list(whole)
    while len(parts) < BOXES:
        i = int(np.argmax([np.prod(_extent(part)) for part in parts]))
        halves = _halves(parts[i], np.eye(3)[int(np.argmax(_extent(parts[i])))])
        if halves is None:
            break
        parts[i : i + 1] = halves
    # one split alone may gain nothing where several do
    kept = (
        parts
        if sum(np.prod(_extent(part)) for part in parts) < WORTH * np.prod(_extent(whole[0]))
        else whole
    )
    return [(part.min(axis=(0, 1)) - off, part.max(axis=(0, 1)) + off) for part in kept]


def _coarse(triangles: Array) -> tuple[Array, float]:
    """A large mesh with its corners moved to the middles of cells, and how far its surface may have
    moved at most [m]."""
    if len(triangles) <= DENSE:
        return triangles, 0.0
    points = triangles.reshape(-1, 3)
    low, size = points.min(axis=0), float(_extent(triangles).max()) / CELLS
    cells = np.floor((points - low) / size).astype(np.int64)
    keys = cells @ np.array([1, CELLS + 1, (CELLS + 1) ** 2])
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    faces = np.unique(np.sort(which.reshape(-1, 3), axis=1), axis=0)
    return (low + (cells[first] + 0.5) * size)[faces], 0.5 * np.sqrt(3.0) * size


def _split(triangles: Array) -> list[Capsule]:
    """One capsule, or one for each of several slabs across a principal axis, if that wastes much
    less room."""
    whole = triangles.reshape(-1, 3)
    best, least = [whole], _rough(whole).volume
    for axis in np.linalg.svd(whole - whole.mean(axis=0), full_matrices=False)[2]:
        for count in range(2, MOST + 1):
            slabs = _slabs(triangles, axis, count)
            score = sum(_rough(slab).volume for slab in slabs) / WORTH ** (len(slabs) - 1)
            if score < least:
                best, least = slabs, score
    return [enclosing(part) for part in best]


def _slabs(triangles: Array, axis: Array, count: int) -> list[Array]:
    """Corners of what slabs of equal thickness cut out of a surface."""
    height = triangles @ axis
    edges = np.linspace(height.min(), height.max(), count + 1)
    cuts = []
    following, above = np.roll(triangles, -1, axis=1), np.roll(height, -1, axis=1)
    for edge in edges[1:-1]:
        crosses = (height < edge) != (above < edge)
        share = (edge - height[crosses]) / (above[crosses] - height[crosses])
        cuts.append(triangles[crosses] + share[:, None] * (following[crosses] - triangles[crosses]))
    points, at = triangles.reshape(-1, 3), height.ravel()
    slabs = []
    for k in range(count):
        inside = (at >= edges[k]) & (at <= edges[k + 1])
        slabs.append(np.concatenate([points[inside], *cuts[max(k - 1, 0) : k + 1]]))
    return [slab for slab in slabs if len(slab)]


def _rough(points: Array) -> Capsule:
    """The best of the capsules along many axes."""
    corners = _corners(points)
    return _around(corners, _axis(corners), None)[0]


def _axis(points: Array) -> Array:
    """Of many directions the one along which a capsule, around the middle of the extents across, is
    smallest."""
    centred = points - points.mean(axis=0)
    axes = np.vstack([np.linalg.eigh(centred.T @ centred)[1].T, np.eye(3), _HEMISPHERE])
    sides = np.array([_sides(axis) for axis in axes])
    flat, height = np.einsum("kij,mj->kmi", sides, points), axes @ points.T
    away = flat - 0.5 * (flat.max(axis=1) + flat.min(axis=1))[:, None]
    square = np.einsum("kmi,kmi->km", away, away)
    radius = square.max(axis=1)
    reach = np.sqrt(radius[:, None] - square)
    length = np.maximum((height - reach).max(axis=1) - (height + reach).min(axis=1), 0.0)
    return np.asarray(axes[int(np.argmin(radius * (length + 4.0 / 3.0 * np.sqrt(radius))))])


def _spiral(count: int) -> Array:
    """Directions that fill half a sphere evenly. Shape (count, 3)."""
    z = (np.arange(count) + 0.5) / count
    turn = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - z**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


_HEMISPHERE = _spiral(32)


def enclosing(points: Array) -> Capsule:
    """A small capsule around points: along the best of many axes, improved. Shape (m, 3)."""
    from scipy import optimize

    corners = _corners(points)
    axis = _axis(corners)
    first, offset = _around(corners, axis, None)
    side = _sides(axis)

    def tilted(z: Array) -> Capsule:
        turned = axis + z[:2] @ side
        return _around(corners, turned / np.sqrt(turned @ turned), offset + z[2:])[0]

    size = max(float(np.ptp(corners, axis=0).max()), 1e-9)
    simplex = np.vstack([np.zeros(4), np.diag([0.1, 0.1, 0.05 * size, 0.05 * size])])
    found = optimize.minimize(
        lambda z: tilted(z).volume,
        np.zeros(4),
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": 50},
    )
    return min((tilted(found.x), first), key=lambda one: one.volume)


def _around(points: Array, axis: Array, offset: Array | None) -> tuple[Capsule, Array]:
    """The smallest capsule with an axis of this direction, through `offset` in the plane across
    (None: the circle's own middle)."""
    side = _sides(axis)
    flat, height = points @ side.T, points @ axis
    middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0)) if offset is None else offset
    away = np.sum((flat - middle) ** 2, axis=1)
    radius = float(np.sqrt(away.max())) * (1.0 + 1e-9) + 1e-9
    reach = np.sqrt(radius**2 - away)
    # a point at a height is inside while the nearest centre is no further along than the ball there
    # reaches
    low, high = float((height + reach).min()), float((height - reach).max())
    if low > high:
        low = high = 0.5 * (low + high)
    foot = middle @ side
    return Capsule(foot + low * axis, foot + high * axis, radius), middle


def _sides(axis: Array) -> Array:
    """Two unit vectors across an axis, which do not jump as it turns a little. Shape (2, 3)."""
    x, y, z = axis
    # the component left out is not the largest one
    first = np.array([0.0, z, -y]) if abs(x) < 0.6 else np.array([-z, 0.0, x])
    first /= np.sqrt(first @ first)
    u, v, w = first
    return np.array([first, [y * w - z * v, z * u - x * w, x * v - y * u]])


def _corners(points: Array) -> Array:
    """Corners of the convex hull; all points where it is flat."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 5:
        return points
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return np.unique(points, axis=0)


def _fine(triangles: Array) -> Array:
    """The same surface in smaller triangles."""
    longest = float(_extent(triangles).max()) / FINE
    for _ in range(8):
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        worst = edges.max(axis=1)
        cut = worst > longest
        if not cut.any() or len(triangles) > 20_000:
            break
        rows = np.flatnonzero(cut)
        side = np.argmax(edges[rows], axis=1)
        a, b, c = (triangles[rows, (side + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        triangles = np.concatenate(
            [triangles[~cut], np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)]
        )
    return triangles


def _halves(triangles: Array, axis: Array) -> list[Array] | None:
    along = triangles.mean(axis=1) @ axis
    first = along < 0.5 * (along.min() + along.max())
    return None if first.all() or not first.any() else [triangles[first], triangles[~first]]


def _extent(triangles: Array) -> Array:
    return np.asarray(np.ptp(triangles.reshape(-1, 3), axis=0))
