"""Enclose shapes in capsules and boxes, whose distances the optimiser computes in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .._types import FloatArray
from .geometry import Shape, ShapeKind

MAX_CAPSULES = 4
"""Largest number of capsules for one shape of a link."""
MAX_BOXES = 24
"""Largest number of boxes for one mesh around the robot."""
SPLIT_VOLUME_RATIO = 0.85
"""A further capsule must reduce the enclosed volume at least to this fraction."""
MAX_EXACT_TRIANGLES = 2000
"""Meshes with more triangles are simplified on a grid before they are covered."""
GRID_CELLS = 40
"""Cells of that grid along the longest side of the mesh."""
TRIANGLES_PER_LENGTH = 6
"""Triangles are refined until their edges are shorter than the surface's length over this number,
so that the surface can be split between boxes."""
MAX_REFINED_TRIANGLES = 20_000
"""Number of triangles above which a surface is not refined further."""
MAX_REFINEMENTS = 8
"""Largest number of bisections of an edge."""
CANDIDATE_DIRECTIONS = 32
"""Directions, besides principal and coordinate axes, that are tried as the axis of a capsule."""
RELATIVE_ROUNDING = 1e-9
"""Relative enlargement of a capsule's radius, so that rounding leaves no point outside [1]."""
ABSOLUTE_ROUNDING = 1e-9
"""Absolute enlargement of a capsule's radius, for the same reason [m]."""


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a segment.

    Attributes:
        begin: Start of the segment. Shape (3,) [m].
        end: End of the segment. Shape (3,) [m].
        radius: Radius [m].
    """

    begin: FloatArray
    end: FloatArray
    radius: float

    @property
    def volume(self) -> float:
        """Volume of the capsule [m³]."""
        length = float(np.linalg.norm(self.end - self.begin))
        return float(np.pi * self.radius**2 * (length + 4.0 / 3.0 * self.radius))

    def transformed(self, rotation: FloatArray, position: FloatArray) -> Capsule:
        """Return the capsule in another frame, x ↦ rotation · x + position."""
        return Capsule(
            rotation @ self.begin + position, rotation @ self.end + position, self.radius
        )


@lru_cache(maxsize=512)
def cover_with_capsules(shape: Shape) -> tuple[Capsule, ...]:
    """Enclose a shape of a link in capsules; a sphere or a capsule encloses itself.

    Returns:
        Up to MAX_CAPSULES capsules in the frame of the shape's link.
    """
    if shape.kind in (ShapeKind.SPHERE, ShapeKind.CAPSULE):
        height = 0.5 * shape.size[1] if shape.kind is ShapeKind.CAPSULE else 0.0
        half_axis = np.array([0.0, 0.0, height])
        capsules = [Capsule(-half_axis, half_axis, shape.size[0])]
    else:
        triangles, displacement = _simplified(shape.triangles())
        capsules = [
            Capsule(capsule.begin, capsule.end, capsule.radius + displacement)
            for capsule in _cover_surface(triangles)
        ]
    placement = shape.placement
    return tuple(
        capsule.transformed(placement.rotation, placement.translation) for capsule in capsules
    )


def cover_with_boxes(shape: Shape) -> list[tuple[FloatArray, FloatArray]]:
    """Enclose a shape around the robot in boxes along the shape's own axes.

    Returns:
        Lower and upper corner of each box in the shape's frame. Shape (3,) each [m].
    """
    if shape.kind is ShapeKind.BOX:
        half_size = 0.5 * np.array(shape.size)
        return [(-half_size, half_size)]
    surface, displacement = _simplified(shape.triangles())
    undivided = [_refined(surface)]
    parts = list(undivided)
    while len(parts) < MAX_BOXES:
        i = int(np.argmax([np.prod(_extent(part)) for part in parts]))
        halves = _bisected(parts[i], np.eye(3)[int(np.argmax(_extent(parts[i])))])
        if halves is None:
            break
        parts[i : i + 1] = halves
    # a single split may gain nothing where several do: compare the volumes at the end only
    volume = sum(np.prod(_extent(part)) for part in parts)
    if volume >= SPLIT_VOLUME_RATIO * np.prod(_extent(undivided[0])):
        parts = undivided
    return [
        (part.min(axis=(0, 1)) - displacement, part.max(axis=(0, 1)) + displacement)
        for part in parts
    ]


def _simplified(triangles: FloatArray) -> tuple[FloatArray, float]:
    """Move the vertices of a large mesh to the centres of grid cells and merge equal triangles.

    Returns:
        Triangles, shape (m, 3, 3), and an upper bound of the displacement of the surface [m].
    """
    if len(triangles) <= MAX_EXACT_TRIANGLES:
        return triangles, 0.0
    points = triangles.reshape(-1, 3)
    low, size = points.min(axis=0), float(_extent(triangles).max()) / GRID_CELLS
    cells = np.floor((points - low) / size).astype(np.int64)
    keys = cells @ np.array([1, GRID_CELLS + 1, (GRID_CELLS + 1) ** 2])
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    faces = np.unique(np.sort(inverse.reshape(-1, 3), axis=1), axis=0)
    return (low + (cells[first] + 0.5) * size)[faces], 0.5 * np.sqrt(3.0) * size


def _cover_surface(triangles: FloatArray) -> list[Capsule]:
    """Enclose a surface in one capsule, or in one per slab across a principal axis.

    A split is accepted where it reduces the volume by SPLIT_VOLUME_RATIO per capsule.
    """
    points = triangles.reshape(-1, 3)
    best, least_volume = [points], _rough_capsule(points).volume
    for axis in np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]:
        for count in range(2, MAX_CAPSULES + 1):
            slabs = _slabs(triangles, axis, count)
            volume = sum(_rough_capsule(slab).volume for slab in slabs)
            penalized = volume / SPLIT_VOLUME_RATIO ** (len(slabs) - 1)
            if penalized < least_volume:
                best, least_volume = slabs, penalized
    return [enclosing_capsule(part) for part in best]


def _slabs(triangles: FloatArray, axis: FloatArray, count: int) -> list[FloatArray]:
    """Vertices of the parts of a surface in slabs of equal thickness. Shape (m, 3) each."""
    height = triangles @ axis
    edges = np.linspace(height.min(), height.max(), count + 1)
    cuts = []
    next_vertex, next_height = np.roll(triangles, -1, axis=1), np.roll(height, -1, axis=1)
    for edge in edges[1:-1]:
        crosses = (height < edge) != (next_height < edge)
        fraction = (edge - height[crosses]) / (next_height[crosses] - height[crosses])
        cuts.append(
            triangles[crosses] + fraction[:, None] * (next_vertex[crosses] - triangles[crosses])
        )
    points, heights = triangles.reshape(-1, 3), height.ravel()
    slabs = []
    for k in range(count):
        inside = (heights >= edges[k]) & (heights <= edges[k + 1])
        slabs.append(np.concatenate([points[inside], *cuts[max(k - 1, 0) : k + 1]]))
    return [slab for slab in slabs if len(slab)]


def _rough_capsule(points: FloatArray) -> Capsule:
    """Smallest of the capsules along the candidate axes. Shape (m, 3)."""
    vertices = _hull_vertices(points)
    return _capsule_along(vertices, _best_axis(vertices), None)[0]


def _best_axis(points: FloatArray) -> FloatArray:
    """Candidate axis with the smallest capsule around the centre of the projected extents."""
    centred = points - points.mean(axis=0)
    axes = np.vstack([np.linalg.eigh(centred.T @ centred)[1].T, np.eye(3), _HEMISPHERE])
    normals = np.array([_normals(axis) for axis in axes])
    projected, height = np.einsum("kij,mj->kmi", normals, points), axes @ points.T
    offset = projected - 0.5 * (projected.max(axis=1) + projected.min(axis=1))[:, None]
    squared = np.einsum("kmi,kmi->km", offset, offset)
    squared_radius = squared.max(axis=1)
    reach = np.sqrt(squared_radius[:, None] - squared)
    length = np.maximum((height - reach).max(axis=1) - (height + reach).min(axis=1), 0.0)
    volumes = squared_radius * (length + 4.0 / 3.0 * np.sqrt(squared_radius))
    return np.asarray(axes[int(np.argmin(volumes))])


def _golden_spiral(count: int) -> FloatArray:
    """Directions spread evenly over a hemisphere. Shape (count, 3)."""
    z = (np.arange(count) + 0.5) / count
    angle = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - z**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])


_HEMISPHERE = _golden_spiral(CANDIDATE_DIRECTIONS)


def enclosing_capsule(points: FloatArray) -> Capsule:
    """Find a small capsule around points: the best candidate axis, refined by Nelder–Mead.

    Args:
        points: Points to enclose. Shape (m, 3) [m].
    """
    from scipy import optimize

    vertices = _hull_vertices(points)
    axis = _best_axis(vertices)
    initial, centre = _capsule_along(vertices, axis, None)
    normals = _normals(axis)

    def tilted(z: FloatArray) -> Capsule:
        direction = axis + z[:2] @ normals
        unit = direction / np.sqrt(direction @ direction)
        return _capsule_along(vertices, unit, centre + z[2:])[0]

    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    simplex = np.vstack([np.zeros(4), np.diag([0.1, 0.1, 0.05 * size, 0.05 * size])])
    result = optimize.minimize(
        lambda z: tilted(z).volume,
        np.zeros(4),
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": 50},
    )
    return min((tilted(result.x), initial), key=lambda capsule: capsule.volume)


def _capsule_along(
    points: FloatArray, axis: FloatArray, centre: FloatArray | None
) -> tuple[Capsule, FloatArray]:
    """Smallest capsule around points with an axis of a given direction.

    Args:
        points: Points to enclose. Shape (m, 3) [m].
        axis: Unit direction of the axis. Shape (3,).
        centre: Where the axis crosses the plane normal to it, in the coordinates of `_normals`;
            None: the centre of the projected extents. Shape (2,) [m].

    Returns:
        The capsule and `centre`.
    """
    normals = _normals(axis)
    projected, height = points @ normals.T, points @ axis
    if centre is None:
        centre = 0.5 * (projected.min(axis=0) + projected.max(axis=0))
    squared = np.sum((projected - centre) ** 2, axis=1)
    radius = float(np.sqrt(squared.max())) * (1.0 + RELATIVE_ROUNDING) + ABSOLUTE_ROUNDING
    reach = np.sqrt(radius**2 - squared)
    # a point is inside the capsule if the segment comes within `reach` of its height
    low, high = float((height + reach).min()), float((height - reach).max())
    if low > high:
        low = high = 0.5 * (low + high)
    foot = centre @ normals
    return Capsule(foot + low * axis, foot + high * axis, radius), centre


def _normals(axis: FloatArray) -> FloatArray:
    """Two unit vectors normal to an axis, continuous for small rotations of it. Shape (2, 3)."""
    x, y, z = axis
    first = np.array([0.0, z, -y]) if abs(x) < 0.6 else np.array([-z, 0.0, x])
    first /= np.sqrt(first @ first)
    u, v, w = first
    return np.array([first, [y * w - z * v, z * u - x * w, x * v - y * u]])


def _hull_vertices(points: FloatArray) -> FloatArray:
    """Vertices of the convex hull; all distinct points where the hull is flat. Shape (m, 3)."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 5:
        return points
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return np.unique(points, axis=0)


def _refined(triangles: FloatArray) -> FloatArray:
    """Bisect long edges of a surface. Shapes (m, 3, 3) -> (M, 3, 3)."""
    longest = float(_extent(triangles).max()) / TRIANGLES_PER_LENGTH
    for _ in range(MAX_REFINEMENTS):
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        is_long = edges.max(axis=1) > longest
        if not is_long.any() or len(triangles) > MAX_REFINED_TRIANGLES:
            break
        rows = np.flatnonzero(is_long)
        side = np.argmax(edges[rows], axis=1)
        a, b, c = (triangles[rows, (side + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        triangles = np.concatenate(
            [triangles[~is_long], np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)]
        )
    return triangles


def _bisected(triangles: FloatArray, axis: FloatArray) -> list[FloatArray] | None:
    """Split a surface in the middle of its extent along an axis; None if one part is empty."""
    centre = triangles.mean(axis=1) @ axis
    is_lower = centre < 0.5 * (centre.min() + centre.max())
    if is_lower.all() or not is_lower.any():
        return None
    return [triangles[is_lower], triangles[~is_lower]]


def _extent(triangles: FloatArray) -> FloatArray:
    """Edge lengths of the bounding box. Shape (3,) [m]."""
    return np.asarray(np.ptp(triangles.reshape(-1, 3), axis=0))
