"""The collision shapes that a URDF gives its links, and the pairs that an SRDF disables."""

from __future__ import annotations

import os
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

from .. import physical_ranges as ranges
from ..errors import ExciteWarning, UnusableInput
from ..physical_ranges import Range
from ..robot import source_text, xml_file
from ..robot.robot import locate
from ..robot.urdf import numbers
from . import mesh_file
from .geometry import WORDS, Kind, Shape


class MissingMesh(UnusableInput):
    """A mesh of the robot that is not where its URDF says; `mesh` is what the URDF calls it."""

    def __init__(self, source: str, link: str, mesh: str) -> None:
        self.mesh = mesh
        remedy = "say where its package is with --packages DIR or in ROS_PACKAGE_PATH, or design with --no-collision"  # noqa: E501
        super().__init__(f"{source}: link '{link}': its mesh {mesh} is not found; {remedy}")


def read(source: str, packages: Sequence[str] = ()) -> list[Shape]:
    """Shapes of all links of a URDF, by its path or a built-in name; none where it states none.

    A <collision_checking> element makes a capsule of the cylinder it names, as in Pinocchio. Raises
    MissingMesh for a mesh that is not there, UnusableInput for a shape that is none.
    """
    path = locate(source)
    root = xml_file.parse_text(path, source_text.read_urdf_text(path))
    out = []
    for link in root.findall("link"):
        name = str(link.get("name"))
        rounded = {capsule.get("name") for capsule in link.findall("collision_checking/capsule")}
        for collision in link.findall("collision"):
            geometry = collision.find("geometry")
            if geometry is None or not len(geometry) or _has_no_extent(geometry[0]):
                warnings.warn(
                    f"{path}: link '{name}': a <collision> shape without extent is left out",
                    ExciteWarning,
                    stacklevel=2,
                )
                continue
            out.append(
                _shape(
                    path, name, collision, geometry[0], collision.get("name") in rounded, packages
                )
            )
    mesh_file.read_all([shape.file for shape in out if shape.file is not None])
    return out


def _shape(
    path: Path,
    owner: str,
    collision: ElementTree.Element,
    solid: ElementTree.Element,
    rounded: bool,
    packages: Sequence[str],
) -> Shape:
    known = [kind.value for kind in WORDS]
    if solid.tag not in known:
        raise UnusableInput(
            f"{path}: link '{owner}': a collision shape is a <{solid.tag}>; use {', '.join(known)}"
        )
    kind = Kind.CAPSULE if solid.tag == "cylinder" and rounded else Kind(solid.tag)
    file = None
    if kind is Kind.MESH:
        file = str(_find(path, owner, solid.get("filename", ""), packages))
        size = _numbers(path, owner, solid.get("scale", "1 1 1"), 3, ranges.MESH_SCALE)
    else:
        count = 3 if kind is Kind.BOX else 1
        size = tuple(
            v
            for word in WORDS[kind]
            for v in _numbers(path, owner, solid.get(word, ""), count, ranges.SIZE)
        )
    origin = collision.find("origin")
    placing = (("xyz", ranges.LENGTH), ("rpy", ranges.ANGLE))
    place = [
        _numbers(path, owner, "0 0 0" if origin is None else origin.get(key, "0 0 0"), 3, accepted)
        for key, accepted in placing
    ]
    return Shape(owner, kind, size, place[0], place[1], owner, file)  # type: ignore[arg-type]


def _has_no_extent(solid: ElementTree.Element) -> bool:
    """True for a box, sphere or cylinder that has a size, but one of 0."""
    if solid.tag not in ("box", "sphere", "cylinder"):
        return False
    words = " ".join(solid.get(word, "") for word in WORDS[Kind(solid.tag)]).split()
    try:
        return any(float(word) == 0.0 for word in words)
    except ValueError:
        return False


def _numbers(path: Path, owner: str, text: str, count: int, accepted: Range) -> tuple[float, ...]:
    return tuple(numbers(str(path), f"link '{owner}', in its <collision>", text, count, accepted))


def _find(path: Path, owner: str, name: str, packages: Sequence[str]) -> Path:
    """A mesh's file. A package is a folder of its name: a place or in one, or a folder that the
    URDF is in or one beside such.

    Other names are paths from the URDF's folder, or from a place.
    """
    places = [*packages, *os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)]
    if name.startswith("package://"):
        package, _, rest = name.removeprefix("package://").partition("/")
        roots = [Path(place) for place in places if place]
        candidates = [root / package / rest for root in roots] + [
            root / rest for root in roots if root.name == package
        ]
        candidates += [parent / package / rest for parent in path.resolve().parents]
        candidates += [parent / rest for parent in path.resolve().parents if parent.name == package]
    else:
        candidates = [path.resolve().parent / name.removeprefix("file://")]
        candidates += [Path(place) / name for place in places if place]
    for candidate in candidates:
        if os.path.isfile(candidate):
            return candidate
    raise MissingMesh(str(path), owner, name)


def disabled(path: Path) -> tuple[tuple[str, str], ...]:
    """Pairs of links whose collisions an SRDF disables. Raises UnusableInput for a file that is
    none."""
    root = xml_file.parse(path, "an SRDF")
    found = [(entry.get("link1"), entry.get("link2")) for entry in root.iter("disable_collisions")]
    return tuple((str(one), str(other)) for one, other in found)
