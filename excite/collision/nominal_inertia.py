"""Inertias of links that state none, from their collision shapes and the robot's mass.

A third of the URDFs that are published have no <inertial>. Their links get the inertia of their
collision shapes with one density, so that the robot has its mass: a starting point for the metric
and for limits of torque, which an identification replaces.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot import urdf
from ..robot.link_inertia import LinkInertia
from ..robot.robot import locate
from . import urdf_geometry
from .geometry import Shape, ShapeKind


def nominal_inertias(
    source: str, mass: float, packages: Sequence[str] = ()
) -> dict[str, LinkInertia]:
    """Inertias of the links without one, whose masses add up to the mass of the robot.

    Args:
        source: Path of a URDF or name of a built-in model.
        mass: Mass of the complete robot, base included [kg].
        packages: Folders in which `package://` meshes are searched.

    Raises:
        UnusableInput: Every link has an inertia; those without one have no collision shape; or the
            others weigh as much as the robot.
    """
    document = urdf.read(locate(source))
    stated = {link: inertia for link, inertia in document.inertias.items() if not inertia.is_empty}
    remaining = mass - sum(inertia.mass for inertia in stated.values())
    if remaining <= 0.0:
        raise UnusableInput(
            f"{source}: --mass {mass:g}: its links state {mass - remaining:g} kg already; give the "
            "mass of the complete robot, or leave it out"
        )
    bodies: dict[str, list[pin.Inertia]] = defaultdict(list)
    for shape in urdf_geometry.read(source, packages):
        if shape.link not in stated:
            bodies[str(shape.link)].append(shape.placement.act(_unit_density(shape)))
    if not bodies:
        raise UnusableInput(
            f"{source}: --mass {mass:g}: no link without <inertial> has a <collision> shape; state "
            "the inertias in the URDF"
        )
    merged = {link: sum(parts[1:], parts[0]) for link, parts in bodies.items()}
    density = remaining / sum(body.mass for body in merged.values())
    return {link: _inertia(body, density) for link, body in merged.items()}


def _inertia(body: pin.Inertia, density: float) -> LinkInertia:
    tensor = density * body.inertia
    return LinkInertia(
        mass=density * float(body.mass),
        centre=tuple(float(value) for value in body.lever),  # type: ignore[arg-type]
        tensor=tuple(  # type: ignore[arg-type]
            float(tensor[i, j]) for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
        ),
    )


def _unit_density(shape: Shape) -> pin.Inertia:
    """Inertia of a shape of density 1 kg/m³, in its own frame; of a mesh, of its convex hull."""
    size = shape.size
    match shape.kind:
        case ShapeKind.SPHERE:
            return pin.Inertia.FromSphere(4.0 / 3.0 * math.pi * size[0] ** 3, size[0])
        case ShapeKind.CAPSULE:
            radius, length = size
            volume = math.pi * radius**2 * (length + 4.0 / 3.0 * radius)
            return pin.Inertia.FromCapsule(volume, radius, length)
        case ShapeKind.CYLINDER:
            return pin.Inertia.FromCylinder(math.pi * size[0] ** 2 * size[1], *size)
        case ShapeKind.BOX:
            return pin.Inertia.FromBox(math.prod(size), *size)
    return _hull_inertia(shape.triangles().reshape(-1, 3), str(shape.file))


def _hull_inertia(points: FloatArray, file: str) -> pin.Inertia:
    """Inertia of the convex hull of points, density 1 kg/m³.

    Integrals over the tetrahedra between the hull's triangles and a point inside (Tonon, Explicit
    exact formulas for the 3-D tetrahedron inertia tensor, 2004).
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError) as error:
        raise UnusableInput(
            f"{file}: the mesh is flat, so that its link has no volume; state its <inertial>"
        ) from error
    inner = points[hull.vertices].mean(axis=0)
    corners = points[hull.simplices] - inner  # (triangles, 3 corners, 3)
    volumes = np.abs(np.linalg.det(corners)) / 6.0
    volume = float(volumes.sum())
    sums = corners.sum(axis=1)
    centre = (volumes[:, None] * sums).sum(axis=0) / (4.0 * volume)
    second = (
        np.einsum("t,tci,tcj->ij", volumes, corners, corners)
        + np.einsum("t,ti,tj->ij", volumes, sums, sums)
    ) / 20.0 - volume * np.outer(centre, centre)
    tensor = np.trace(second) * np.eye(3) - second
    return pin.Inertia(volume, centre + inner, tensor)
