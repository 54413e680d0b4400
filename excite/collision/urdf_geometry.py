"""Collision shapes of the links of a URDF, its neighbouring links, and pairs of links that an SRDF
disables."""

from __future__ import annotations

import os
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Sequence
from pathlib import Path

from .. import physical_ranges as ranges
from ..errors import ExciteWarning, UnusableInput
from ..physical_ranges import Range
from ..robot import source_text, urdf, xml_file
from ..robot.robot import locate
from . import mesh_file
from .geometry import SIZE_KEYS, Shape, ShapeKind


class MissingMesh(UnusableInput):
    """A mesh file of the robot that does not exist.

    Attributes:
        mesh: File name as the URDF states it.
    """

    def __init__(self, source: str, link: str, mesh: str) -> None:
        self.mesh = mesh
        remedy = (
            "say where its package is with --packages DIR or in ROS_PACKAGE_PATH, or design with "
            "--no-collision"
        )
        super().__init__(f"{source}: link '{link}': its mesh {mesh} is not found; {remedy}")


def read(source: str, packages: Sequence[str] = (), element: str = "collision") -> list[Shape]:
    """Read the shapes of all links.

    A `<collision_checking>` element turns the cylinder that it names into a capsule, as in
    Pinocchio.

    Args:
        source: Path of a URDF or name of a built-in robot.
        packages: Folders in which `package://` meshes are searched.
        element: Element of the shapes, collision or visual.

    Returns:
        Shapes in the frames of their links; none where the URDF has no such element.

    Raises:
        MissingMesh: A mesh file does not exist.
        UnusableInput: A shape is not valid.
    """
    path = locate(source)
    root = xml_file.parse_text(path, source_text.read_urdf_text(path))
    out = []
    for link in root.findall("link"):
        name = str(link.get("name"))
        rounded = {capsule.get("name") for capsule in link.findall("collision_checking/capsule")}
        for collision in link.findall(element):
            geometry = collision.find("geometry")
            if geometry is None or not len(geometry) or _has_no_extent(geometry[0]):
                warnings.warn(
                    f"{path}: link '{name}': a <{element}> shape without extent is left out",
                    ExciteWarning,
                    stacklevel=2,
                )
                continue
            is_rounded = collision.get("name") in rounded
            out.append(_shape(path, name, collision, geometry[0], is_rounded, packages))
    mesh_file.read_all([shape.file for shape in out if shape.file is not None])
    return out


def missing_meshes(source: str, packages: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Links and file names of the collision meshes that do not exist; see `read`."""
    path = locate(source)
    root = xml_file.parse_text(path, source_text.read_urdf_text(path))
    out = []
    for link in root.findall("link"):
        for mesh in link.findall("collision/geometry/mesh"):
            try:
                _find_mesh(path, str(link.get("name")), mesh.get("filename", ""), packages)
            except MissingMesh as error:
                out.append((str(link.get("name")), error.mesh))
    return out


def neighbouring_links(source: str, links: Collection[str]) -> set[frozenset[str]]:
    """Find the pairs of links that one movable joint joins.

    Fixed joints to links without shapes, such as flanges and joint frames, may be between them, but
    no link with a shape, and no second movable joint, even if it is locked.

    Args:
        source: Path of a URDF or name of a built-in robot.
        links: Names of the links that have shapes.
    """
    joints = {joint.child: joint for joint in urdf.read(locate(source)).placements}
    out = set[frozenset[str]]()
    for link in links:
        parent, movable = link, 0
        while parent in joints and movable <= 1:
            movable += joints[parent].kind != "fixed"
            parent = joints[parent].parent
            if parent in links:
                break
        if parent in links and movable == 1:
            out.add(frozenset((link, parent)))
    return out


def _shape(
    path: Path,
    link: str,
    collision: ElementTree.Element,
    solid: ElementTree.Element,
    is_rounded: bool,
    packages: Sequence[str],
) -> Shape:
    """Read a `<collision>` element; is_rounded: a cylinder is to be read as a capsule."""
    known = [kind.value for kind in SIZE_KEYS]
    if solid.tag not in known:
        raise UnusableInput(
            f"{path}: link '{link}': a collision shape is a <{solid.tag}>; use {', '.join(known)}"
        )
    kind = ShapeKind.CAPSULE if solid.tag == "cylinder" and is_rounded else ShapeKind(solid.tag)
    file = None
    if kind is ShapeKind.MESH:
        file = str(_find_mesh(path, link, solid.get("filename", ""), packages))
        size = _numbers(path, link, solid.get("scale", "1 1 1"), 3, ranges.MESH_SCALE)
    else:
        count = 3 if kind is ShapeKind.BOX else 1
        size = tuple(
            number
            for key in SIZE_KEYS[kind]
            for number in _numbers(path, link, solid.get(key, ""), count, ranges.SIZE)
        )
    origin = collision.find("origin")
    position, rotation = (
        _numbers(path, link, "0 0 0" if origin is None else origin.get(key, "0 0 0"), 3, accepted)
        for key, accepted in (("xyz", ranges.LENGTH), ("rpy", ranges.ANGLE))
    )
    return Shape(link, kind, size, position, rotation, link, file)  # type: ignore[arg-type]


def _has_no_extent(solid: ElementTree.Element) -> bool:
    """True for a box, sphere or cylinder that has a size, but one of 0."""
    if solid.tag not in ("box", "sphere", "cylinder"):
        return False
    words = " ".join(solid.get(word, "") for word in SIZE_KEYS[ShapeKind(solid.tag)]).split()
    try:
        return any(float(word) == 0.0 for word in words)
    except ValueError:
        return False


def _numbers(path: Path, link: str, text: str, count: int, accepted: Range) -> tuple[float, ...]:
    return tuple(
        urdf.numbers(str(path), f"link '{link}', in its <collision>", text, count, accepted)
    )


def _find_mesh(path: Path, link: str, name: str, packages: Sequence[str]) -> Path:
    """Find the file of a mesh.

    `package://NAME/…` is searched in the folders of `packages` and of ROS_PACKAGE_PATH, each either
    the package NAME or a parent of it, and likewise in all parent folders of the URDF. Other names
    are paths relative to the folder of the URDF or to one of these folders.
    """
    folders = [*packages, *os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)]
    if name.startswith("package://"):
        package, _, inner = name.removeprefix("package://").partition("/")
        roots = [Path(folder) for folder in folders if folder]
        candidates = [root / package / inner for root in roots] + [
            root / inner for root in roots if root.name == package
        ]
        parents = path.resolve().parents
        candidates += [parent / package / inner for parent in parents]
        candidates += [parent / inner for parent in parents if parent.name == package]
    else:
        candidates = [path.resolve().parent / name.removeprefix("file://")]
        candidates += [Path(folder) / name for folder in folders if folder]
    for candidate in candidates:
        if os.path.isfile(candidate):
            return candidate
    raise MissingMesh(str(path), link, name)


def disabled_pairs(path: Path) -> tuple[tuple[str, str], ...]:
    """Read the pairs of links whose collisions an SRDF disables.

    Raises:
        UnusableInput: The file is no SRDF.
    """
    root = xml_file.parse(path, "an SRDF")
    return tuple(
        (str(entry.get("link1")), str(entry.get("link2")))
        for entry in root.iter("disable_collisions")
    )
