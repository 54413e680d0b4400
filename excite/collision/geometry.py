"""Rigid collision shapes: links of the robot, tools that they carry, and the surroundings."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from .._types import FloatArray, IntArray
from ..errors import UnusableInput
from . import mesh_file

POLYGON_SIDES = 24
"""Sides of the polygons that replace circles. They circumscribe the circles, so that triangulated
surfaces enclose their shapes."""


MAX_NEIGHBOURS = 100
"""Triangles around a vertex of a hull; coal counts neighbours in one byte and raises an error."""


class ShapeKind(Enum):
    """Kinds of shapes, with the meaning of `Shape.size` [m].

    A shape is centred at its origin, round ones along the z axis.
    """

    SPHERE = "sphere"  # radius
    CAPSULE = "capsule"  # radius, length between the centres of its ends
    CYLINDER = "cylinder"  # radius, length
    BOX = "box"  # x, y, z
    MESH = "mesh"  # scale along x, y, z
    FLOOR = "floor"  # none: the half space below the origin


SIZE_KEYS = {
    ShapeKind.SPHERE: ("radius",),
    ShapeKind.CAPSULE: ("radius", "length"),
    ShapeKind.CYLINDER: ("radius", "length"),
    ShapeKind.BOX: ("size",),
    ShapeKind.MESH: ("scale",),
}
"""Names of the dimensions in URDFs and scene files, for each kind that they may hold. A size and a
scale are three numbers, the others one."""


@dataclass(frozen=True)
class Shape:
    """A shape in the frame of a link or in the base frame.

    Attributes:
        name: Name of the body that it is part of.
        kind: Kind of the shape.
        size: Dimensions as `ShapeKind` states them.
        position: Origin of the shape. Shape (3,) [m].
        rotation: Roll, pitch and yaw about the fixed axes. Shape (3,) [rad].
        link: Link whose frame it is fixed in; None: the base frame.
        file: Path of a mesh, None for other kinds.
    """

    name: str
    kind: ShapeKind
    size: tuple[float, ...] = ()
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    link: str | None = None
    file: str | None = None

    @property
    def placement(self) -> pin.SE3:
        """Pose in the frame of its link."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rotation), np.array(self.position))

    def solid(self) -> coal.CollisionGeometry:
        """Build the exact shape for coal.

        Raises:
            UnusableInput: A mesh cannot be read.
        """
        size = self.size
        match self.kind:
            case ShapeKind.SPHERE:
                return coal.Sphere(size[0])
            case ShapeKind.CAPSULE:
                return coal.Capsule(*size)
            case ShapeKind.CYLINDER:
                return coal.Cylinder(*size)
            case ShapeKind.BOX:
                return coal.Box(*size)
            case ShapeKind.FLOOR:
                return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        return _mesh(str(self.file), size)

    def hull(self) -> coal.CollisionGeometry:
        """Build the convex hull for coal: the shape itself unless it is a mesh that is not flat."""
        return _hull(str(self.file), self.size) if self.kind is ShapeKind.MESH else self.solid()

    def lowest(self, placement: pin.SE3) -> float:
        """Compute the height of the lowest point of the exact shape.

        Args:
            placement: Pose of the shape.

        Returns:
            Least z coordinate; of a floor, its surface [m].
        """
        R, height = placement.rotation, float(placement.translation[2])
        match self.kind:
            case ShapeKind.SPHERE:
                return height - self.size[0]
            case ShapeKind.CAPSULE:
                return height - self.size[0] - 0.5 * self.size[1] * abs(float(R[2, 2]))
            case ShapeKind.CYLINDER:
                return (
                    height
                    - self.size[0] * float(np.hypot(R[2, 0], R[2, 1]))
                    - 0.5 * self.size[1] * abs(float(R[2, 2]))
                )
            case ShapeKind.BOX:
                return height - 0.5 * float(np.abs(R[2]) @ np.array(self.size))
            case ShapeKind.FLOOR:
                return height
        return height + float((self.triangles().reshape(-1, 3) @ R[2]).min())

    def triangles(self) -> FloatArray:
        """Triangulate a surface that encloses the shape. Shape (m, 3, 3), its own frame [m]."""
        if self.kind is ShapeKind.MESH:
            return _surface(str(self.file), self.size)
        if self.kind is ShapeKind.BOX:
            square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
            heights = (self.size[2] * -0.5, self.size[2] * 0.5)
            return _prism(0.5 * square * np.array(self.size[:2]), heights)
        angle = np.arange(POLYGON_SIDES) * (2.0 * np.pi / POLYGON_SIDES)
        ring = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / POLYGON_SIDES)
        half = 0.5 * self.size[1] if self.kind is ShapeKind.CYLINDER else self.size[0]
        return _prism(self.size[0] * ring, (-half, half))

    def sha256(self) -> str | None:
        """Digest of the mesh file, None without one."""
        return (
            None if self.file is None else hashlib.sha256(Path(self.file).read_bytes()).hexdigest()
        )

    def document(self) -> dict[str, Any]:
        """Entry of the shape in a trajectory file."""
        out = dataclasses.asdict(self) | {"kind": self.kind.value, "sha256": self.sha256()}
        return {
            key: list(v) if isinstance(v, tuple) else v for key, v in out.items() if v is not None
        }


def from_document(entry: Mapping[str, Any]) -> Shape:
    """Read an entry that `Shape.document` wrote.

    Raises:
        UnusableInput: A mesh file is missing or has another digest than the entry states.
    """
    vectors = {key: tuple(float(v) for v in entry[key]) for key in ("size", "position", "rotation")}
    out = Shape(
        str(entry["name"]),
        ShapeKind(entry["kind"]),
        link=entry.get("link"),
        file=entry.get("file"),
        **vectors,  # type: ignore[arg-type]
    )
    if out.file is not None and not Path(out.file).is_file():
        raise UnusableInput(f"{out.file}: the mesh of '{out.name}' does not exist; restore it")
    if out.sha256() != entry.get("sha256"):
        raise UnusableInput(
            f"{out.file}: is not the mesh of '{out.name}' that the motion was checked against "
            "(sha256 differs)"
        )
    return out


@lru_cache(maxsize=256)
def _scaled(file: str, scale: tuple[float, ...]) -> mesh_file.TriangleMesh:
    return mesh_file.scaled(file, scale)


def _coal_mesh(vertices: FloatArray, triangles: IntArray) -> coal.BVHModelBase:
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(triangles), len(vertices))
    mesh.addVertices(np.ascontiguousarray(vertices))
    mesh.addTriangles(np.ascontiguousarray(triangles, np.int64))
    mesh.endModel()
    return mesh


@lru_cache(maxsize=256)
def _mesh(file: str, scale: tuple[float, ...]) -> coal.BVHModelBase:
    scaled = _scaled(file, scale)
    return _coal_mesh(scaled.vertices, scaled.triangles)


@lru_cache(maxsize=256)
def _hull(file: str, scale: tuple[float, ...]) -> coal.CollisionGeometry:
    """Convex hull of a mesh; the mesh itself where it is flat.

    `coal.BVHModelBase.buildConvexHull` crashes on flat meshes.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    vertices = _scaled(file, scale).vertices
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):  # flat, or fewer than four vertices
        return _mesh(file, scale)
    if _max_neighbours(hull.simplices) > MAX_NEIGHBOURS:
        # Qhull triangulates a flat facet as a fan around one vertex; joggled input has no flat
        # facets of more than three vertices
        hull = ConvexHull(vertices, qhull_options="QJ Pp")
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    corners = np.sort(hull.vertices)
    points.extend(list(vertices[corners]))
    faces.extend(
        [coal.Triangle(*face) for face in np.searchsorted(corners, hull.simplices).tolist()]
    )
    return coal.Convex(points, faces)


def _max_neighbours(triangles: IntArray) -> int:
    """Return the largest number of triangles around a vertex. Shape of `triangles`: (m, 3)."""
    return int(np.bincount(triangles.ravel()).max())


@lru_cache(maxsize=256)
def _surface(file: str, scale: tuple[float, ...]) -> FloatArray:
    scaled = _scaled(file, scale)
    return np.asarray(scaled.vertices[scaled.triangles])


def _prism(polygon: FloatArray, heights: tuple[float, float]) -> FloatArray:
    """Triangles of a right prism over a convex polygon. Shape (m, 2) -> (4m − 4, 3, 3)."""
    count = len(polygon)
    low, high = (np.column_stack([polygon, np.full(count, h)]) for h in heights)
    following = np.roll(np.arange(count), -1)
    sides = [
        np.stack([low, low[following], high], 1),
        np.stack([high, low[following], high[following]], 1),
    ]
    fans = [
        np.stack([end[0].repeat(1)[None].repeat(count - 2, 0), end[1:-1], end[2:]], 1)
        for end in (low, high)
    ]
    return np.concatenate([*sides, *fans])
