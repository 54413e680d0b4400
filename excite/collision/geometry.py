"""Rigid shapes: links of the robot, tools that they carry, and what stands around."""

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

from ..errors import UnusableInput
from . import mesh_file

Array = np.ndarray
SIDES = 24
"""Corners of the polygons that stand for circles; they are drawn around them, so that nothing of
the shape is outside."""


class Kind(Enum):
    """What a shape's `size` means [m]: along its own z axis, centred."""

    SPHERE = "sphere"  # radius
    CAPSULE = "capsule"  # radius, length between the two centres
    CYLINDER = "cylinder"  # radius, length
    BOX = "box"  # x, y, z
    MESH = "mesh"  # scale along x, y, z
    FLOOR = "floor"  # none: all below its origin's height


WORDS = {
    Kind.SPHERE: ("radius",),
    Kind.CAPSULE: ("radius", "length"),
    Kind.CYLINDER: ("radius", "length"),
    Kind.BOX: ("size",),
    Kind.MESH: ("scale",),
}
"""What URDFs and scenes call a shape's `size`, of all kinds that they may state. A size and a scale
are three numbers."""


@dataclass(frozen=True)
class Shape:
    """A shape in the frame of `link`, or, where that is None, in the base frame.

    name: of the body that it is part of. file: of a mesh. position: Shape (3,) [m].
    rotation: roll, pitch, yaw about the fixed axes. Shape (3,) [rad].
    """

    name: str
    kind: Kind
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
        """The shape as coal knows it. Raises UnusableInput for a mesh that cannot be read."""
        size = self.size
        match self.kind:
            case Kind.SPHERE:
                return coal.Sphere(size[0])
            case Kind.CAPSULE:
                return coal.Capsule(*size)
            case Kind.CYLINDER:
                return coal.Cylinder(*size)
            case Kind.BOX:
                return coal.Box(*size)
            case Kind.FLOOR:
                return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        return _mesh(str(self.file), size)

    def hull(self) -> coal.CollisionGeometry:
        """A convex shape that encloses it: of all but meshes, and of flat meshes, the shape
        itself."""
        return _hull(str(self.file), self.size) if self.kind is Kind.MESH else self.solid()

    def lowest(self, placement: pin.SE3) -> float:
        """Least height of the exact shape, placed as given; of a floor, its own height [m]."""
        R, height = placement.rotation, float(placement.translation[2])
        match self.kind:
            case Kind.SPHERE:
                return height - self.size[0]
            case Kind.CAPSULE:
                return height - self.size[0] - 0.5 * self.size[1] * abs(float(R[2, 2]))
            case Kind.CYLINDER:
                return (
                    height
                    - self.size[0] * float(np.hypot(R[2, 0], R[2, 1]))
                    - 0.5 * self.size[1] * abs(float(R[2, 2]))
                )
            case Kind.BOX:
                return height - 0.5 * float(np.abs(R[2]) @ np.array(self.size))
            case Kind.FLOOR:
                return height
        return height + float((self.triangles().reshape(-1, 3) @ R[2]).min())

    def triangles(self) -> Array:
        """A surface that encloses the shape, in its own frame. Shape (m, 3, 3) [m]."""
        if self.kind is Kind.MESH:
            return _surface(str(self.file), self.size)
        if self.kind is Kind.BOX:
            profile, heights = (
                np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]),
                (-0.5, 0.5),
            )
            return _prism(
                0.5 * profile * np.array(self.size[:2]), [self.size[2] * h for h in heights]
            )
        angle = np.arange(SIDES) * (2.0 * np.pi / SIDES)
        ring = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / SIDES)
        half = 0.5 * self.size[1] if self.kind is Kind.CYLINDER else self.size[0]
        return _prism(self.size[0] * ring, (-half, half))

    def sha256(self) -> str | None:
        """Of the mesh's file, None without."""
        return (
            None if self.file is None else hashlib.sha256(Path(self.file).read_bytes()).hexdigest()
        )

    def document(self) -> dict[str, Any]:
        """As a trajectory states it."""
        out = dataclasses.asdict(self) | {"kind": self.kind.value, "sha256": self.sha256()}
        return {
            key: list(v) if isinstance(v, tuple) else v for key, v in out.items() if v is not None
        }


def from_document(entry: Mapping[str, Any]) -> Shape:
    """Read back what `document` wrote. Raises UnusableInput where a mesh is no longer the one that
    was stated."""
    vectors = {key: tuple(float(v) for v in entry[key]) for key in ("size", "position", "rotation")}
    out = Shape(
        str(entry["name"]),
        Kind(entry["kind"]),
        link=entry.get("link"),
        file=entry.get("file"),
        **vectors,  # type: ignore[arg-type]
    )
    if out.file is not None and not Path(out.file).is_file():
        raise UnusableInput(f"{out.file}: the mesh of '{out.name}' is not there; put it back")
    if out.sha256() != entry.get("sha256"):
        raise UnusableInput(
            f"{out.file}: is not the mesh of '{out.name}' that the motion was checked against "
            "(sha256 differs)"
        )
    return out


@lru_cache(maxsize=256)
def _scaled(file: str, scale: tuple[float, ...]) -> mesh_file.Mesh:
    return mesh_file.scaled(file, scale)


def _built(vertices: Array, triangles: Array) -> coal.BVHModelBase:
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(triangles), len(vertices))
    mesh.addVertices(np.ascontiguousarray(vertices))
    mesh.addTriangles(np.ascontiguousarray(triangles, np.int64))
    mesh.endModel()
    return mesh


@lru_cache(maxsize=256)
def _mesh(file: str, scale: tuple[float, ...]) -> coal.BVHModelBase:
    scaled = _scaled(file, scale)
    return _built(scaled.vertices, scaled.triangles)


@lru_cache(maxsize=256)
def _hull(file: str, scale: tuple[float, ...]) -> coal.CollisionGeometry:
    """The convex hull of a mesh; the mesh itself where it is flat. (`BVHModelBase.buildConvexHull`
    crashes on flat meshes.)"""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    vertices = _scaled(file, scale).vertices
    try:
        found = ConvexHull(vertices)
    except (QhullError, ValueError):  # flat, or fewer than four corners
        return _mesh(file, scale)
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    corners = np.sort(found.vertices)
    points.extend(list(vertices[corners]))
    faces.extend(
        [coal.Triangle(*face) for face in np.searchsorted(corners, found.simplices).tolist()]
    )
    return coal.Convex(points, faces)


@lru_cache(maxsize=256)
def _surface(file: str, scale: tuple[float, ...]) -> Array:
    scaled = _scaled(file, scale)
    return np.asarray(scaled.vertices[scaled.triangles])


def _prism(profile: Array, heights: Any) -> Array:
    """Triangles of a right prism over a convex polygon. Shape (m, 2) -> (4m − 4, 3, 3)."""
    count = len(profile)
    low, high = (np.column_stack([profile, np.full(count, h)]) for h in heights)
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
